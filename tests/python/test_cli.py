"""The command line in its own process: exit codes, sentences, files; with the fake daemon and the real one."""

import json
import os
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse
from conftest import real_daemon_path
from running import BAD_ADDRESSES, COMMAND, run, run_on_terminal, write_box, write_pose
from shapes import BOX_QUADS, box_vertices, obj_text, points_inside

from barycast import Binding, load_model


@pytest.fixture
def box(tmp_path):
    return write_box(tmp_path)


def bound(environment, tmp_path, box, *more):
    out = tmp_path / "bind.npz"
    done = run(environment, "bind", *box, "-o", out, *more)
    assert done.returncode == 0, done.stderr
    return out, done


def test_bind_deform_inspect(daemon, environment, tmp_path, box):
    out, done = bound(environment, tmp_path, box, "--gradients")
    assert done.stderr == ""
    assert "50 points, 8 control vertices, harmonic, predicted, 12 samples per point" in done.stdout
    for words in ("seconds:", "walk steps", "linear-precision error", "coordinates per row", "rows flagged"):
        assert words in done.stdout
    assert scipy.sparse.load_npz(out).shape == (50, 8)
    binding = Binding.load(out)
    assert binding.gradients.shape == (binding.matrix.nnz, 3)

    posed = tmp_path / "posed.obj"
    done = run(environment, "deform", out, write_pose(tmp_path), box[1], "-o", posed)
    assert (done.returncode, done.stderr) == (0, "")
    np.testing.assert_allclose(load_model(posed).points, points_inside(50) * [2, 1, 1], atol=1e-5)

    done = run(environment, "inspect", out, "--cage", box[0], "--model", box[1], "--json")
    assert (done.returncode, done.stderr) == (0, "")
    shown = json.loads(done.stdout)
    assert shown["linear_precision_error_stored"] < 1e-6 and shown["points"] == 50
    assert shown["cage_digest"] == binding.cage_digest and shown["options"]["coordinates"] == "harmonic"
    text = run(environment, "inspect", out, "--cage", box[0], "--model", box[1]).stdout
    assert "of the stored rows" in text and "walk steps max" in text and "is not the cage" not in text


def test_a_cage_in_the_plane(daemon, environment, tmp_path):
    cage, model, posed = tmp_path / "cage.obj", tmp_path / "model.obj", tmp_path / "posed.obj"
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    cage.write_text(obj_text(corners, []) + "l 1 2 3 4 1\n")
    points = points_inside(20) * [1, 1, 0]
    model.write_text(obj_text(points, []))
    out, _ = bound(environment, tmp_path, (cage, model))
    pose = tmp_path / "pose.obj"
    pose.write_text(obj_text(corners * [2, 3, 1], []))
    assert run(environment, "deform", out, pose, model, "-o", posed).returncode == 0
    np.testing.assert_allclose(load_model(posed).points, points * [2, 3, 0], atol=1e-5)
    model.write_text(obj_text(points + [0, 0, 1], []))
    refused(run(environment, "bind", cage, model, "-o", out), 3, "model.obj", "two-dimensional")


def test_quiet_and_json(fake_daemon, environment, tmp_path, box):
    _, done = bound(environment, tmp_path, box, "--quiet")
    assert (done.stdout, done.stderr) == ("", "")
    _, done = bound(environment, tmp_path, box, "--json", "--dtype", "float64")
    assert json.loads(done.stdout)["options"]["dtype"] == "float64"


def test_an_address(fake, environment, tmp_path, box):
    environment["BARYCASTD"] = "/nowhere"
    bound(environment, tmp_path, box, "--server", fake.address)
    assert fake.service.behaviour.log == ["capabilities", "digest", "upload", "digest"]


def test_web_proxies_are_ignored(fake, environment, tmp_path, box):
    for name in ("http_proxy", "https_proxy", "grpc_proxy"):
        environment[name] = "http://127.0.0.1:1"
    environment.pop("no_proxy", None), environment.pop("no_grpc_proxy", None), environment.pop("NO_PROXY", None)
    bound(environment, tmp_path, box, "--server", fake.address, "--retry-seconds", "0")


def test_progress_on_a_terminal_only(fake_daemon, environment, tmp_path, box):
    environment["FAKE_ROW_SECONDS"] = "0.2"
    _, done = bound(environment, tmp_path, box)
    assert done.stderr == "" and "%" not in done.stdout
    code, shown = run_on_terminal(environment, "bind", *box, "-o", tmp_path / "b.npz")
    assert code == 0 and "sampling   50%|" in shown


@pytest.mark.parametrize("arguments", [
    [], ["bind"], ["bind", "a.obj", "b.obj"], ["bind", "a.obj", "b.obj", "-o", "c.npz", "--coordinates", "no"],
    ["bind", "a.obj", "b.obj", "-o", "c.npz", "--samples", "many"], ["view"], ["inspect", "a.npz", "--cage", "b.obj"],
    ["bind", "a.obj", "b.obj", "-o", "c.npz", "--sample", "20"], ["inspect", "a.npz", "--js"], ["--vers"],
])
def test_usage_errors(environment, arguments):
    done = run(environment, *arguments)
    assert done.returncode == 2 and done.stderr.startswith("usage: barycast") and done.stdout == ""


def refused(done, code, *words):
    assert done.returncode == code, done.stderr
    assert done.stdout == "" and done.stderr.startswith("barycast: ") and done.stderr.count("\n") == 1
    for word in words:
        assert str(word) in done.stderr


def test_input_errors(fake_daemon, environment, tmp_path, box):
    cage, model = box
    out = tmp_path / "bind.npz"
    refused(run(environment, "bind", tmp_path / "absent.obj", model, "-o", out), 3, "absent.obj", "No such file")
    refused(run(environment, "bind", cage, model, "-o", tmp_path / "absent" / "b.npz"), 3, "cannot be written")
    before = Path(model).read_bytes()
    refused(run(environment, "bind", cage, model, "-o", model), 3, "must end in .npz")
    assert Path(model).read_bytes() == before
    refused(run(environment, "bind", model, model, "-o", out), 3, "model.obj", "no cage")
    bad = tmp_path / "bad.obj"
    bad.write_text("v 0 0 0\nf 1 1 9\n")
    refused(run(environment, "bind", bad, model, "-o", out), 3, "bad.obj:2: ", "vertex 9")
    refused(run(environment, "bind", cage, model, "-o", out, "--samples", "-5"), 3, "options.samples")
    refused(run(environment, "bind", cage, model, "-o", out, "--samples", "200000"), 3, "options.samples", "> 100000")
    assert not out.exists()


@pytest.mark.parametrize("verb, address", [("bind", ""), *(("capabilities", address) for address in BAD_ADDRESSES[:6])])
def test_bad_addresses_are_refused_at_once(environment, tmp_path, verb, address):
    arguments = ["absent.obj", "absent.obj", "-o", tmp_path / "b.npz"] if verb == "bind" else []
    started = time.monotonic()
    done = run(environment, verb, *arguments, "--server", address)
    refused(done, 3, f'server: "{address}" is no address', "HOST:PORT", "from 1 to 65535", "[::1]:PORT", "unix:PATH")
    assert time.monotonic() - started < 8  # it would wait for 15


def test_the_output_is_no_input(fake_daemon, environment, tmp_path, box):
    cage, model = box
    out, _ = bound(environment, tmp_path, box)
    pose = write_pose(tmp_path)
    (tmp_path / "folder").mkdir()
    linked, bound_link, model_link = tmp_path / "linked.obj", tmp_path / "linked.npz", tmp_path / "model.npz"
    linked.symlink_to(model), bound_link.symlink_to(out), model_link.symlink_to(model)
    before = {path: path.read_bytes() for path in (cage, model, out, pose)}
    for output in (model, tmp_path / "folder" / ".." / "model.obj", linked, pose, out, bound_link):
        refused(run(environment, "deform", out, pose, model, "-o", output), 3, f"{output}: would overwrite the input",
                "choose another name")
    refused(run(environment, "deform", out, pose, linked, "-o", model), 3, "would overwrite the input", "another name")
    refused(run(environment, "bind", cage, model, "-o", model_link), 3, "model.npz: would overwrite", "another name")
    for archive in ("cage", "model"):  # a binding's ending is a model's, too
        np.savez(tmp_path / f"{archive}s.npz", points=box_vertices(), quads=BOX_QUADS)
        inputs = {"cage": cage, "model": model, archive: tmp_path / f"{archive}s.npz"}
        before[inputs[archive]] = inputs[archive].read_bytes()
        refused(run(environment, "bind", inputs["cage"], inputs["model"], "-o", inputs[archive]), 3,
                f"{archive}s.npz: would overwrite", "choose another name")
    assert {path: path.read_bytes() for path in before} == before
    posed = tmp_path / "posed.obj"  # an output that is there may be overwritten
    for _ in range(2):
        assert run(environment, "deform", out, pose, model, "-o", posed).returncode == 0


@pytest.mark.parametrize("kind", ["mean-value", "positive-mean-value"])
def test_kinds_that_the_server_lacks(fake_daemon, environment, tmp_path, box, kind):
    out = tmp_path / "bind.npz"
    refused(run(environment, "bind", *box, "-o", out, "--coordinates", kind), 3, "options.coordinates", "not built yet")
    assert not out.exists()


def test_every_kind_is_computed_or_refused(real_daemon, environment, tmp_path, box):
    computed = json.loads(run(environment, "capabilities", "--json").stdout)["coordinates"]
    assert "harmonic" in computed
    for kind in ("mean-value", "positive-mean-value"):
        done = run(environment, "bind", *box, "-o", tmp_path / "bind.npz", "--coordinates", kind)
        if kind in computed:
            assert done.returncode == 0 and kind in done.stdout
        else:
            refused(done, 3, "coordinates")


def test_influences(real_daemon, environment, tmp_path, box):
    out, _ = bound(environment, tmp_path, box, "--influences", "5", "--json")
    assert np.diff(Binding.load(out).matrix.indptr).max() == 5
    assert Binding.load(out).report["options"]["influences_max"] == 5
    refused(run(environment, "bind", *box, "-o", out, "--influences", "3"), 3, "influences_max")
    refused(run(environment, "bind", *box, "-o", out, "--influences", "-1"), 3, "output.influences_max")


def test_estimate(fake, behaviour, environment, box):
    done = run(environment, "bind", *box, "--estimate", "--server", fake.address, "--samples", "20")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == "5.0 MB of the server's memory, 1,000 samples, 0.0 MB of rows\n"
    assert behaviour.log == ["estimate", "digest", "upload", "estimate", "digest"]
    done = run(environment, "bind", *box, "--estimate", "--server", fake.address, "--json")
    assert json.loads(done.stdout) == {"memory_bytes": 5_000_000, "samples": 600, "output_bytes": 5000}
    behaviour.estimates = False
    refused(run(environment, "bind", *box, "--estimate", "--server", fake.address), 3, "does not estimate costs")


def test_capabilities(daemon, environment):
    done = run(environment, "capabilities")
    assert (done.returncode, done.stderr) == (0, "")
    for words in ("barycastd 0.", "numerics version ", "coordinates: harmonic", "samples per point"):
        assert words in done.stdout
    shown = json.loads(run(environment, "capabilities", "--json").stdout)
    assert "harmonic" in shown["coordinates"] and shown["limits"]["points_max"] > 0
    refused(run(environment, "capabilities", "--server", "unix:/nowhere/socket", "--retry-seconds", "0.2"), 4)


def test_version_and_no_progress_bar_package(environment, tmp_path, box, fake_daemon):
    assert run(environment, "--version").stdout.startswith("barycast 0.")
    (tmp_path / "tqdm.py").write_text("raise ImportError")
    environment["PYTHONPATH"] = f"{tmp_path}{os.pathsep}{environment['PYTHONPATH']}"
    assert run_on_terminal(environment, "bind", *box, "-o", tmp_path / "b.npz")[0] == 0


def test_deform_refuses_what_does_not_fit(fake_daemon, environment, tmp_path, box):
    out, _ = bound(environment, tmp_path, box)
    cage, model = box
    other = tmp_path / "other.obj"
    other.write_text(obj_text(np.zeros((9, 3)), []))
    posed = tmp_path / "posed.obj"
    refused(run(environment, "deform", out, other, model, "-o", posed), 3, "other.obj", "9 vertices", "8")
    refused(run(environment, "deform", out, cage, other, "-o", posed), 3, "other.obj", "9 points", "50 rows")
    refused(run(environment, "deform", out, cage, model, "-o", tmp_path / "posed.ply"), 3, "must end in .obj")
    refused(run(environment, "deform", cage, cage, model, "-o", posed), 3, "cage.obj", "is not a binding")
    refused(run(environment, "inspect", out, "--cage", cage, "--model", cage), 3, "do not fit")
    assert not posed.exists()
    flipped = tmp_path / "flipped.obj"  # other faces, same vertices: only positions matter
    flipped.write_text(obj_text(box_vertices(), BOX_QUADS[:, ::-1]))
    assert run(environment, "deform", out, flipped, model, "-o", posed).returncode == 0
    done = run(environment, "inspect", out, "--cage", flipped, "--model", model)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith(f"warning: {flipped}: is not the cage that was bound\n50 points, ")
    done = run(environment, "inspect", out, "--cage", flipped, "--model", model, "--json")
    assert json.loads(done.stdout)["warnings"][0] == {"field": str(flipped),
                                                       "message": "is not the cage that was bound"}


def test_server_errors(environment, tmp_path, box):
    program = tmp_path / "daemon"
    program.write_text("#!/bin/sh\necho no luck; exit 1\n")
    program.chmod(0o755)
    environment["BARYCASTD"] = str(program)
    refused(run(environment, "bind", *box, "-o", tmp_path / "b.npz"), 4, "status 1: no luck")
    refused(run(environment, "bind", *box, "-o", tmp_path / "b.npz", "--server", f"unix:{tmp_path}/none",
                "--retry-seconds", "0.3"), 4)


def test_waiting_for_a_server_is_said_on_a_terminal(environment, tmp_path, box):
    where = f"unix:{tmp_path}/none"
    arguments = ("bind", *box, "-o", tmp_path / "b.npz", "--server", where, "--retry-seconds", "3.5")
    line = f"waiting for a server at {where} (up to 3.5 s)"
    code, shown = run_on_terminal(environment, *arguments)
    assert code == 4 and shown.count(line) == 1 and "%" not in shown
    assert shown.index(line) < shown.index("is barycastd running, and the address right?")
    assert line in run_on_terminal(environment, "capabilities", *arguments[5:])[1]
    assert "waiting for a server" not in run_on_terminal(environment, *arguments, "--quiet")[1]
    refused(run(environment, *arguments), 4, "is barycastd running, and the address right?")


def test_no_waiting_line_while_a_server_works(fake, behaviour, environment, tmp_path):
    cage, model = write_box(tmp_path, 2500)
    behaviour.row_seconds = 1.0
    code, shown = run_on_terminal(environment, "bind", cage, model, "-o", tmp_path / "b.npz", "--server", fake.address)
    assert code == 0 and "waiting for a server" not in shown


@pytest.mark.parametrize("number, code", [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_interrupted(fake_daemon, environment, tmp_path, number, code):
    cage, model = write_box(tmp_path, 5000)
    environment["FAKE_ROW_SECONDS"] = "1"
    assert_interrupted(environment, tmp_path, [cage, model], number, code, lambda _: time.sleep(0.5))


def test_interrupted_real(real_daemon, environment, tmp_path):
    cage, model = write_box(tmp_path, 20000)
    assert_interrupted(environment, tmp_path, [cage, model, "--samples", 100000], signal.SIGINT, 130,
                       lambda _: time.sleep(1))


def assert_interrupted(environment, tmp_path, arguments, number, code, wait):
    """The process ends with code, and leaves neither daemon nor folder nor output."""
    private = tmp_path / "private"
    private.mkdir()
    environment["TMPDIR"] = str(private)
    out = tmp_path / "bind.npz"
    process = subprocess.Popen([*COMMAND, "bind", *map(str, arguments), "-o", str(out)], env=environment,
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 30
    while not list(private.glob("*/port")) and time.monotonic() < deadline:
        time.sleep(0.01)
    try:
        wait(process)
        children = subprocess.run(["ps", "-o", "pid=", "--ppid", str(process.pid)], capture_output=True,
                                  text=True).stdout
        assert process.poll() is None and children.strip()
        process.send_signal(number)
        _, errors = process.communicate(timeout=20)
        assert process.returncode == code, errors
    finally:
        process.kill()  # its daemon ends with it
    assert "Traceback" not in errors
    assert not out.exists() and not list(private.iterdir())
    for child in map(int, children.split()):
        assert not os.path.exists(f"/proc/{child}")


def test_the_builds_wrapper(environment):
    wrapper = real_daemon_path().with_name("barycast")
    if not wrapper.exists():
        pytest.skip(f"no wrapper {wrapper} (environment variable BARYCAST_BIN_DIR)")
    environment.pop("PYTHONPATH")
    done = subprocess.run([str(wrapper), "--help"], env=environment, capture_output=True, text=True)
    assert done.returncode == 0 and "bind|deform|inspect" in done.stdout
