"""The installed CMake package: the README's program and project, built outside the tree and run against a daemon."""

import os
import re
import shutil
import subprocess

import pytest
from conftest import ROOT, real_daemon_path

from barycast.local_server import LocalServer

README = ROOT / "client_examples" / "cpp" / "README.md"


def block(language: str) -> str:
    """The README's only code of a language."""
    found = re.findall(rf"```{language}\n(.*?)```", README.read_text(), re.DOTALL)
    assert len(found) == 1
    return found[0]


def call(*command: object, **options: object) -> str:
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, timeout=300, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture
def prefix(tmp_path):
    """The package, installed from the build that is tested."""
    build = real_daemon_path().parents[1]
    if not (build / "client_examples" / "cpp" / "libbarycast_client.a").exists():
        pytest.skip(f"no built C++ client in {build} (environment variable BARYCAST_BIN_DIR)")
    call("cmake", "--install", build, "--prefix", tmp_path / "prefix", "--component", "client")
    return tmp_path / "prefix"


def test_a_project_outside(prefix, real_daemon, tmp_path):
    app, build = tmp_path / "app", tmp_path / "build"
    app.mkdir()
    (app / "app.cpp").write_text(block("cpp"))
    (app / "CMakeLists.txt").write_text(block("cmake"))
    environment = {**os.environ, "CMAKE_PREFIX_PATH": str(prefix)}
    generator = ["-G", "Ninja"] if shutil.which("ninja") else []
    call("cmake", "-S", app, "-B", build, *generator, env=environment)
    call("cmake", "--build", build)
    server = LocalServer(2)
    try:
        assert call(build / "app", server.address) == "0.400 0.200 0.200\n"
    finally:
        server.close()


def test_nothing_of_this_machine_is_installed(prefix):
    """No path of the source or build tree in what consumers read, and headers without gRPC or protobuf."""
    for path in [*prefix.rglob("*.cmake"), *prefix.rglob("*.h")]:
        text = path.read_text()
        assert str(ROOT) not in text, path
        if path.suffix == ".h":
            assert "#include <g" not in text and ".pb.h" not in text, path
    assert (prefix / "bin" / "barycast_bind").exists()
