"""Where things are. BARYCAST_PYTHON_PROTO: the folder with the generated modules (<build>/python).
BARYCAST_BIN_DIR: the build's bin folder; tests of the daemon are skipped without it. BARYCAST_DATA: third-party
meshes; tests that read them are skipped without."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "client_examples" / "python"
PROTO = Path(os.environ.get("BARYCAST_PYTHON_PROTO", ROOT / "build" / "python")).resolve()
SUPPORT = Path(__file__).resolve().parent / "support"

if not (PROTO / "barycast" / "v1" / "cage_pb2.py").exists():
    raise pytest.UsageError(f"no generated modules in {PROTO}: build the target barycast_python_proto and let the "
                            "environment variable BARYCAST_PYTHON_PROTO name <build>/python")
# Children would inherit an interrupt that is ignored, as it is for a run in the background.
signal.signal(signal.SIGINT, signal.default_int_handler)

sys.path[:0] = [str(PACKAGE), str(PROTO), str(SUPPORT)]

import barycast  # noqa: E402, F401  (found on the path above; before grpc, so that forks are safe)
import fake_server  # noqa: E402


@pytest.fixture
def data_folder() -> Path:
    folder = Path(os.environ.get("BARYCAST_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no third-party meshes in {folder} (environment variable BARYCAST_DATA)")
    return folder


@pytest.fixture
def behaviour() -> fake_server.Behaviour:
    return fake_server.Behaviour()


@pytest.fixture
def fake(behaviour):
    """A fake server in this process; `fake.address` is where."""
    server = fake_server.start("127.0.0.1:0", behaviour)
    server.address = f"127.0.0.1:{server.port}"
    yield server
    server.stop(None)


@pytest.fixture
def environment() -> dict:
    """For programs that run in their own process."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (PACKAGE, PROTO, SUPPORT)))}


@pytest.fixture
def fake_daemon(tmp_path, environment, monkeypatch) -> Path:
    """A program that takes the daemon's flags, named in BARYCASTD."""
    program = tmp_path / "fake_barycastd"
    program.write_text(f'#!/bin/sh\nPYTHONPATH="{environment["PYTHONPATH"]}" exec {sys.executable} '
                       f'{SUPPORT / "fake_server.py"} "$@"\n')
    program.chmod(0o755)
    monkeypatch.setenv("BARYCASTD", str(program))
    environment["BARYCASTD"] = str(program)
    return program


def real_daemon_path() -> Path:
    return Path(os.environ.get("BARYCAST_BIN_DIR", ROOT / "build" / "bin")).resolve() / "barycastd"


@pytest.fixture
def real_daemon(environment, monkeypatch) -> Path:
    """The daemon of the build, named in BARYCASTD."""
    program = real_daemon_path()
    if not program.exists():
        pytest.skip(f"no daemon {program} (environment variable BARYCAST_BIN_DIR)")
    monkeypatch.setenv("BARYCASTD", str(program))
    environment["BARYCASTD"] = str(program)
    return program


@pytest.fixture(params=["fake", "real"])
def daemon(request) -> Path:
    """Both daemons in turn."""
    return request.getfixturevalue(f"{request.param}_daemon")


def built_program(name) -> Path:
    path = real_daemon_path().with_name(name)
    if not path.exists():
        pytest.skip(f"no program {path} (environment variable BARYCAST_BIN_DIR)")
    return path


@pytest.fixture
def program() -> Path:
    """barycast_bind, the C++ client's program."""
    return built_program("barycast_bind")


@pytest.fixture
def barycast_bench() -> Path:
    return built_program("barycast_bench")


@pytest.fixture
def cpp(program, environment):
    """Runs the program; environment may still change."""
    def call(*arguments):
        return subprocess.run([str(program), *map(str, arguments)], env=environment, capture_output=True, text=True,
                              timeout=120)
    return call


@pytest.fixture
def tcp_daemon(real_daemon, tmp_path):
    """Starts daemons on free ports with the given flags; returns the port."""
    processes = []

    def start(*flags):
        port_file = tmp_path / f"port{len(processes)}"
        process = subprocess.Popen([str(real_daemon), "--listen", "127.0.0.1:0", "--port-file", str(port_file),
                                    "--exit-on-stdin-close", "--log-level", "error", "--threads", "2", *flags],
                                   stdin=subprocess.PIPE)
        processes.append(process)
        deadline = time.monotonic() + 30
        while not port_file.exists() and time.monotonic() < deadline:
            time.sleep(0.01)
        return int(port_file.read_text().rsplit(":", 1)[1])

    yield start
    for process in processes:
        process.kill()
        process.communicate(timeout=20)
