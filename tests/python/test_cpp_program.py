"""barycast_bind, the C++ client's program, against the Python client: equal bytes, equal refusals, equal endurance."""

import fcntl
import json
import os
import pty
import signal
import struct
import subprocess
import termios
import threading
import time

import fake_server
import grpc
import numpy as np
import pytest
import scipy.sparse
from conftest import real_daemon_path
from cutting_proxy import CuttingProxy
from running import run, write_box
from shapes import BOX_QUADS, box_cage, box_vertices, obj_text, points_inside

from barycast import Binding, Client, load_cage, load_model
from barycast.v1 import barycast_pb2 as pb
from barycast.v1 import barycast_pb2_grpc


@pytest.fixture
def program():
    path = real_daemon_path().with_name("barycast_bind")
    if not path.exists():
        pytest.skip(f"no program {path} (environment variable BARYCAST_BIN_DIR)")
    return path


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


def grid_text(size):
    """A square of quads inside the unit box, with one triangle and one pentagon."""
    axis = np.linspace(0.2, 0.8, size)
    points = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    lines = [f"v {x!r} {y!r} {0.5 + 0.1 * np.sin(7 * x)!r}" for x, y in points.tolist()]
    for i in range(size - 1):
        for j in range(size - 1):
            a = size * i + j + 1
            corners = [a, a + 1, a + size + 1, a + size]
            lines.append("f " + " ".join(map(str, corners[:3] if (i, j) == (3, 3) else corners)))
    return "\n".join(lines + [f"f 1 2 3 {size + 3} {size + 1}"]) + "\n"


def polygon_cage_text():
    """The unit box: two triangles, two quads and a hexagon, which has a vertex more than the box needs."""
    vertices = np.r_[box_vertices(), [[0.5, 0, 1], [0.5, 1, 1]]]
    faces = [[0, 2, 3], [0, 3, 1], [0, 1, 5, 8, 4], [2, 6, 9, 7, 3], [4, 8, 5, 7, 9, 6], [0, 4, 6, 2], [1, 3, 7, 5]]
    return "\n".join(["v " + " ".join(map(repr, v)) for v in vertices.tolist()]
                     + ["f " + " ".join(str(c + 1) for c in f) for f in faces]) + "\n"


def assert_equal(first, second):
    """Every byte of two bindings but their timings."""
    ours, theirs = np.load(first), np.load(second)
    assert ours.files == theirs.files
    for name in ours.files:
        if name != "report":
            assert ours[name].dtype == theirs[name].dtype and ours[name].shape == theirs[name].shape, name
            assert ours[name].tobytes() == theirs[name].tobytes(), name
    reports = [json.loads(str(file["report"])) for file in (ours, theirs)]
    assert reports[0].keys() == reports[1].keys() and reports[0]["seconds"].keys() == reports[1]["seconds"].keys()
    for name in set(reports[0]) - {"seconds", "cage_cache_hit"}:
        assert reports[0][name] == reports[1][name], name


@pytest.mark.parametrize("flags", [
    ["--gradients", "--dtype", "float64"],
    ["--gradients"],
    ["--denoise", "none", "--samples", "37", "--seed", "18446744073709551615"],
    ["--preset", "paper", "--dtype", "float64", "--thickness", "0.01", "--walk-steps-max", "50", "--prune-below", "1e-3"],
])
def test_equal_bytes(cpp, real_daemon, environment, tmp_path, flags):
    cage, model = tmp_path / "cage.obj", tmp_path / "model.obj"
    cage.write_text(polygon_cage_text())
    model.write_text(grid_text(30))
    for out, call in (("cpp.npz", lambda *a: cpp("--quiet", *a)), ("py.npz", lambda *a: run(environment, "bind", *a))):
        done = call(cage, model, "-o", tmp_path / out, *flags)
        assert (done.returncode, done.stderr) == (0, ""), done.stderr
    assert_equal(tmp_path / "cpp.npz", tmp_path / "py.npz")
    assert Binding.load(tmp_path / "cpp.npz").cage_digest == load_cage(cage).digest.sha256.hex()


def test_equal_bytes_in_the_plane(cpp, real_daemon, environment, tmp_path):
    cage, model = tmp_path / "cage.obj", tmp_path / "model.obj"
    cage.write_text("v 0 0 0\nv 1 0 -0.0\nv 1 1 0\nv -0.0 1 0\nl 1 2 3 4 1\n")
    model.write_text(obj_text(points_inside(40) * [1, 1, 0], []))
    assert cpp(cage, model, "-o", tmp_path / "cpp.npz", "--gradients").returncode == 0
    assert run(environment, "bind", cage, model, "-o", tmp_path / "py.npz", "--gradients").returncode == 0
    assert_equal(tmp_path / "cpp.npz", tmp_path / "py.npz")


def test_the_python_command_line_goes_on(cpp, real_daemon, environment, tmp_path):
    cage, model = write_box(tmp_path)
    out, posed = tmp_path / "bind.npz", tmp_path / "posed.obj"
    done = cpp(cage, model, "-o", out)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == run(environment, "inspect", out).stdout.split("cage: ")[0]
    assert scipy.sparse.load_npz(out).shape == (50, 8)
    assert run(environment, "deform", out, cage, model, "-o", posed).returncode == 0
    assert run(environment, "inspect", out, "--cage", cage, "--model", model).returncode == 0


def test_influences(cpp, real_daemon, tmp_path):
    cage, model = write_box(tmp_path)
    assert cpp(cage, model, "-o", tmp_path / "b.npz", "--influences", 5).returncode == 0
    matrix = scipy.sparse.load_npz(tmp_path / "b.npz")
    assert np.diff(matrix.indptr).max() <= 5
    refused(cpp(cage, model, "-o", tmp_path / "b.npz", "--influences", 2), 3, "influences_max")


def test_many_ways_to_write_obj(cpp, real_daemon, environment, tmp_path):
    cage, model = write_box(tmp_path)
    strange = ["# a comment \\", "mtllib x.mtl", "vt 0 0", "vn 0 0 1", "o thing", ""]
    strange += [f"  v\t{x:+.17g} {y:.3e} \\\r\n {z!r} 0.5 0.25 1" for x, y, z in box_vertices().tolist()]
    corners = iter(["{0}", "{0}/1", "{0}//1", "{0}/1/1"] * 6)
    for face in BOX_QUADS.tolist():
        strange.append("f " + " ".join(next(corners).format(c - 8 if c % 2 else c + 1) for c in face) + " # face")
    other = tmp_path / "strange.obj"
    other.write_bytes("\r\n".join(strange).encode())
    assert load_cage(other).digest == load_cage(cage).digest
    assert cpp(other, model, "-o", tmp_path / "b.npz").returncode == 0
    assert Binding.load(tmp_path / "b.npz").cage_digest == load_cage(cage).digest.sha256.hex()


def refused(done, code, *words):
    assert done.returncode == code, done.stderr
    assert done.stdout == "" and done.stderr.startswith("barycast_bind: ") and done.stderr.count("\n") == 1
    for word in words:
        assert str(word) in done.stderr


@pytest.mark.parametrize("text, words", [
    ("v 0 0 0\nf 1 1 9\n", ["bad.obj:2: ", "vertex 9", "has 1"]),
    ("v 0 0\n", ["bad.obj:1: ", "three numbers"]),
    ("v 0 0 0\nv 0 0 x\n", ["bad.obj:2: ", "three numbers"]),
    ("v 0 0 0\nv 0 1e999 0\n", ["bad.obj:2: ", "not finite"]),
    ("v 0 0 nan\n", ["bad.obj:1: ", "not finite"]),
    ("v 0 0 0\nf 1 1 0\n", ["bad.obj:2: ", "start at 1"]),
    ("v 0 0 0\nf -1 -2 -1\n", ["bad.obj:2: ", "before the first"]),
    ("v 0 0 0\nf 1 1\n", ["bad.obj:2: ", "at least 3"]),
    ("v 0 0 0\nf 1 1 1.5\n", ["bad.obj:2: ", "whole numbers"]),
    ("v 0 0 0\nf 1 1 99999999999\n", ["bad.obj:2: ", "vertex 99999999999"]),
    ("v 0 0 0\n\n# x\nf 1 \\\n 1 \\\n7\n", ["bad.obj:4: ", "vertex 7"]),
    ("", ["bad.obj: ", "no vertices"]),
    ("v 0 0 0\n", ["bad.obj: ", "no cage"]),
])
def test_bad_cages(cpp, tmp_path, text, words):
    model = write_box(tmp_path)[1]
    bad = tmp_path / "bad.obj"
    bad.write_text(text)
    refused(cpp(bad, model, "-o", tmp_path / "b.npz"), 3, *words)
    assert not (tmp_path / "b.npz").exists()


def test_bad_input(cpp, real_daemon, tmp_path):
    cage, model = write_box(tmp_path)
    out = tmp_path / "b.npz"
    refused(cpp(tmp_path / "absent.obj", model, "-o", out), 3, "absent.obj", "No such file")
    refused(cpp(tmp_path, model, "-o", out), 3, "does not end in .obj")
    refused(cpp(cage, model, "-o", tmp_path / "absent" / "b.npz"), 3, "cannot be written")
    refused(cpp(cage, model, "-o", tmp_path), 3, "no regular file")
    refused(cpp(cage, model, "-o", out, "--samples", 2000000000), 3, "options.samples")
    flat = tmp_path / "flat.obj"
    flat.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    refused(cpp(flat, model, "-o", out), 3, "cage")
    plane = tmp_path / "plane.obj"
    plane.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nl 1 2 3 1\n")
    refused(cpp(plane, model, "-o", out), 3, "model.obj", "two-dimensional")
    assert not out.exists()


@pytest.mark.parametrize("arguments", [
    [], ["a.obj"], ["a.obj", "b.obj"], ["a.obj", "b.obj", "-o", "c.npz", "--coordinates", "no"],
    ["a.obj", "b.obj", "-o", "c.npz", "--samples", "many"], ["a.obj", "b.obj", "-o", "c.npz", "--samples", "-5"],
    ["a.obj", "b.obj", "c.obj", "-o", "c.npz"],
])
def test_usage_errors(cpp, arguments):
    refused(cpp(*arguments), 2, "--help")


def test_help(cpp):
    done = cpp("--help")
    assert done.returncode == 0 and "--server" in done.stdout and done.stderr == ""


def test_server_errors(cpp, environment, tmp_path):
    cage, model = write_box(tmp_path)
    daemon = tmp_path / "daemon"
    daemon.write_text("#!/bin/sh\necho no luck; exit 1\n")
    daemon.chmod(0o755)
    environment["BARYCASTD"] = str(daemon)
    refused(cpp(cage, model, "-o", tmp_path / "b.npz"), 4, "status 1: no luck")
    environment["BARYCASTD"] = "/nowhere"
    refused(cpp(cage, model, "-o", tmp_path / "b.npz"), 3, "BARYCASTD", "/nowhere")


@pytest.mark.parametrize("flags", [["--denoise", "none"], []])
def test_resumes_across_cut_connections(cpp, tcp_daemon, environment, tmp_path, flags):
    cage, model = tmp_path / "cage.obj", tmp_path / "model.obj"
    cage.write_text(polygon_cage_text())
    model.write_text(grid_text(150))
    port = tcp_daemon()
    common = [cage, model, "--samples", 10, "--gradients", "--dtype", "float64", *flags]
    done = run(environment, "bind", *common, "-o", tmp_path / "py.npz", "--server", f"127.0.0.1:{port}")
    assert done.returncode == 0, done.stderr
    # 22,500 rows of 10 entries of 36 bytes: 8 MB in blocks of 4096 rows.
    with CuttingProxy(port, [2_000_000, 3_500_000]) as proxy:
        done = cpp(*common, "-o", tmp_path / "cpp.npz", "--server", proxy.address)
    assert done.returncode == 0, done.stderr
    assert proxy.connections == 3
    ours, theirs = np.load(tmp_path / "cpp.npz"), np.load(tmp_path / "py.npz")
    for name in set(ours.files) - {"report"}:
        assert ours[name].tobytes() == theirs[name].tobytes(), name
    reports = [json.loads(str(file["report"])) for file in (ours, theirs)]
    for name in ("points", "entries", "rows", "options"):
        assert reports[0][name] == reports[1][name]
    assert "connection broke" in reports[0]["warnings"][0]["message"]


class Rebuilt(fake_server.FakeService):
    """Breaks the first answer after a block, and then has another numerics_version."""

    version = 1

    def ComputeCoordinates(self, request_iterator, context):
        requests = list(request_iterator)
        resume = requests[0].header.resume
        if resume.first_row and resume.numerics_version != self.version:
            self.behaviour.log.append("refused")
            fake_server.abort(context, grpc.StatusCode.FAILED_PRECONDITION, "another build",
                              fake_server.bad_request("header.resume.numerics_version", "another build"))
        for response in super().ComputeCoordinates(iter(requests), context):
            if response.WhichOneof("message") == "header":
                response.header.numerics_version = self.version
            yield response
            if self.version == 1 and response.WhichOneof("message") == "rows":
                self.version = 2
                context.abort(grpc.StatusCode.UNAVAILABLE, "gone")


@pytest.fixture
def rebuilt(monkeypatch):
    monkeypatch.setattr(fake_server, "FakeService", Rebuilt)
    server = fake_server.start("127.0.0.1:0")
    server.address = f"127.0.0.1:{server.port}"
    yield server
    server.stop(None)


def test_starts_over_with_another_build(cpp, rebuilt, tmp_path):
    cage, model = write_box(tmp_path, 2500)
    done = cpp(cage, model, "-o", tmp_path / "b.npz", "--server", rebuilt.address)
    assert done.returncode == 0, done.stderr
    assert rebuilt.service.behaviour.log.count("refused") == 1
    binding = Binding.load(tmp_path / "b.npz")
    assert binding.report["numerics_version"] == 2 and binding.matrix.shape == (2500, 8)
    np.testing.assert_allclose(binding.deform(box_vertices()), points_inside(2500), atol=1e-6)


def test_uploads_once_then_inline(cpp, fake, behaviour, tmp_path):
    cage, model = write_box(tmp_path)
    arguments = [cage, model, "-o", tmp_path / "b.npz", "--server", fake.address]
    assert cpp(*arguments).returncode == 0
    assert behaviour.log == ["capabilities", "digest", "upload", "digest"]
    fake.service.cages.clear()
    behaviour.log.clear()
    behaviour.uploads_ignored = True
    assert cpp(*arguments).returncode == 0
    assert behaviour.log == ["capabilities", "digest", "upload", "digest", "inline"]


def test_blocks_respect_the_servers_limit(cpp, fake, behaviour, tmp_path):
    cage, model = write_box(tmp_path)
    model.write_text(grid_text(60))
    sent = []
    for limit in (16384, 4 << 20):
        behaviour.message_bytes_max = limit
        behaviour.request_bytes.clear()
        assert cpp(cage, model, "-o", tmp_path / "b.npz", "--server", fake.address).returncode == 0
        assert max(behaviour.request_bytes) <= limit
        sent.append(list(behaviour.request_bytes))
        behaviour.request_bytes.clear()
        with Client(fake.address) as client:
            parsed = load_model(model)
            client.bind(box_cage(), parsed.points, parsed.faces)
        assert behaviour.request_bytes == sent[-1]  # the same cuts
    assert len(sent[0]) > 10 and len(sent[1]) == 2


def test_waits_for_a_busy_server(cpp, tcp_daemon, tmp_path):
    cage, model = write_box(tmp_path)
    address = f"127.0.0.1:{tcp_daemon('--requests-max', '1')}"
    release = threading.Event()

    def holding():
        header = pb.ComputeHeader(inline_cage=box_cage().to_message(), queries=pb.QuerySet(point_count=1))
        yield pb.ComputeCoordinatesRequest(header=header)
        release.wait(30)

    with grpc.insecure_channel(address) as channel:
        call = barycast_pb2_grpc.BarycastServiceStub(channel).ComputeCoordinates(holding(), timeout=60)
        time.sleep(0.5)
        threading.Timer(1.5, lambda: (release.set(), call.cancel())).start()
        started = time.monotonic()
        done = cpp(cage, model, "-o", tmp_path / "b.npz", "--server", address)
        assert done.returncode == 0, done.stderr
        assert time.monotonic() - started > 0.9  # the server asks for a second


def test_progress_on_a_terminal_only(program, fake_daemon, environment, tmp_path):
    cage, model = write_box(tmp_path)
    leader, follower = pty.openpty()
    fcntl.ioctl(follower, termios.TIOCSWINSZ, struct.pack("4H", 24, 80, 0, 0))
    done = subprocess.run([str(program), str(cage), str(model), "-o", str(tmp_path / "b.npz")], env=environment,
                          stdout=follower, stderr=follower, timeout=60)
    os.close(follower)
    shown = os.read(leader, 65536).decode()
    os.close(leader)
    assert done.returncode == 0 and "sampling   50%|" in shown


@pytest.mark.parametrize("number, code", [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_interrupted(program, real_daemon, environment, tmp_path, number, code):
    """Ends soon, and leaves neither daemon nor folder nor output."""
    cage, model = write_box(tmp_path, 20000)
    private = tmp_path / "private"
    private.mkdir()
    environment["TMPDIR"] = str(private)
    process = subprocess.Popen([str(program), str(cage), str(model), "-o", str(tmp_path / "b.npz"), "--samples",
                                "100000"], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 30
    while not list(private.glob("*/port")) and time.monotonic() < deadline:
        time.sleep(0.01)
    time.sleep(0.5)
    children = subprocess.run(["ps", "-o", "pid=", "--ppid", str(process.pid)], capture_output=True, text=True).stdout
    assert process.poll() is None and children.strip()
    process.send_signal(number)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == code and errors.count("\n") == 1, errors
    assert not (tmp_path / "b.npz").exists() and not list(private.iterdir())
    for child in map(int, children.split()):
        assert not os.path.exists(f"/proc/{child}")


def runs(process_id):
    """Not so for a process that ended and was not waited for."""
    try:
        with open(f"/proc/{process_id}/stat") as file:
            return file.read().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def test_killed_leaves_no_daemon(program, real_daemon, environment, tmp_path):
    cage, model = write_box(tmp_path, 20000)
    environment["TMPDIR"] = str(tmp_path)
    process = subprocess.Popen([str(program), str(cage), str(model), "-o", str(tmp_path / "b.npz"), "--samples",
                                "100000"], env=environment, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 30
    while not list(tmp_path.glob("barycast-*/port")) and time.monotonic() < deadline:
        time.sleep(0.01)
    children = subprocess.run(["ps", "-o", "pid=", "--ppid", str(process.pid)], capture_output=True, text=True).stdout
    process.kill()
    process.wait(10)
    for child in map(int, children.split()):
        while runs(child) and time.monotonic() < deadline + 20:
            time.sleep(0.05)
        assert not runs(child)
