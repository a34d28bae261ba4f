"""barycast_bind, the C++ client's program, against the Python client: equal bytes, equal refusals."""

import fcntl
import json
import os
import pty
import re
import signal
import struct
import subprocess
import termios
import time
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse
from running import BAD_ADDRESSES, run, run_on_terminal, write_box
from shapes import BOX_QUADS, box_vertices, grid_text, obj_text, points_inside, polygon_cage_text

from barycast import Binding, load_cage
from barycast.retry import RETRY_SECONDS


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
    (tmp_path / "folder.npz").mkdir()
    refused(cpp(cage, model, "-o", tmp_path / "folder.npz"), 3, "no regular file")
    before = Path(model).read_bytes()
    refused(cpp(cage, model, "-o", model), 3, "must end in .npz")
    assert Path(model).read_bytes() == before
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
    ["a.obj", "b.obj", "c.obj", "-o", "c.npz"], ["a.obj", "b.obj", "-o", "c.npz", "--sample", "20"],
])
def test_usage_errors(cpp, arguments):
    refused(cpp(*arguments), 2, "--help")


def test_help(cpp):
    done = cpp("--help")
    assert done.returncode == 0 and "--server" in done.stdout and done.stderr == ""
    assert re.search(rf"--retry-seconds [^\n]*[=\[]{RETRY_SECONDS:g}\b", done.stdout)  # as the Python client's


@pytest.mark.parametrize("address", BAD_ADDRESSES)
def test_bad_addresses_are_refused_at_once(cpp, tmp_path, address):
    started = time.monotonic()
    done = cpp("absent.obj", "absent.obj", "-o", tmp_path / "b.npz", "--server", address)
    refused(done, 3, f'server: "{address}" is no address', "HOST:PORT", "from 1 to 65535", "[::1]:PORT", "unix:PATH")
    assert time.monotonic() - started < 8  # it would wait for 15


@pytest.mark.parametrize("form", ["127.0.0.1:{}", "dns:///localhost:{}", "ipv4:127.0.0.1:1,127.0.0.1:{}"])
def test_addresses_that_reach_a_server(cpp, fake, tmp_path, form):
    done = cpp(*write_box(tmp_path), "-o", tmp_path / "b.npz", "--server", form.format(fake.port))
    assert (done.returncode, done.stderr) == (0, "")


def test_the_output_is_no_input(cpp, real_daemon, tmp_path):
    cage, model = write_box(tmp_path)
    for name, path in (("c.npz", cage), ("m.npz", model)):
        (tmp_path / name).symlink_to(path)
        before = path.read_bytes()
        refused(cpp(cage, model, "-o", tmp_path / name), 3, f"{name}: would overwrite the input {path}", "another name")
        assert path.read_bytes() == before


def test_waiting_for_a_server_is_said_on_a_terminal(cpp, program, environment, tmp_path):
    where = f"unix:{tmp_path}/none"
    arguments = (*write_box(tmp_path), "-o", tmp_path / "b.npz", "--server", where, "--retry-seconds", "6")
    line = f"waiting for a server at {where} (up to 6 s)"
    # It gives up when the next wait, at most 3.2 s, would end too late: not before the line is due.
    code, shown = run_on_terminal(environment, *arguments, command=[program])
    assert code == 4 and shown.count(line) == 1
    assert shown.index(line) < shown.index("is barycastd running, and the address right?")
    assert "waiting for a server" not in run_on_terminal(environment, *arguments, "--quiet", command=[program])[1]
    refused(cpp(*arguments), 4, "is barycastd running, and the address right?")


def test_no_waiting_line_while_a_server_works(fake, behaviour, program, environment, tmp_path):
    behaviour.row_seconds = 1.0
    arguments = (*write_box(tmp_path, 2500), "-o", tmp_path / "b.npz", "--server", fake.address)
    code, shown = run_on_terminal(environment, *arguments, command=[program])
    assert code == 0 and "waiting for a server" not in shown


def test_server_errors(cpp, environment, tmp_path):
    cage, model = write_box(tmp_path)
    daemon = tmp_path / "daemon"
    daemon.write_text("#!/bin/sh\necho no luck; exit 1\n")
    daemon.chmod(0o755)
    environment["BARYCASTD"] = str(daemon)
    refused(cpp(cage, model, "-o", tmp_path / "b.npz"), 4, "status 1: no luck")
    environment["BARYCASTD"] = "/nowhere"
    refused(cpp(cage, model, "-o", tmp_path / "b.npz"), 3, "BARYCASTD", "/nowhere")


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
