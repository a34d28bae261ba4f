"""tests/accuracy/accuracy.py at a tiny size: a sphere in a box, against references that the service solves."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from shapes import BOX_QUADS, box_vertices, obj_text

ACCURACY = Path(__file__).resolve().parents[1] / "accuracy"
BOX_TRIANGLES = np.concatenate([BOX_QUADS[:, [0, 1, 2]], BOX_QUADS[:, [0, 2, 3]]])


def sphere_text(rings: int = 12, sides: int = 20) -> str:
    """A band of a sphere in the middle of the unit box."""
    down, around = np.meshgrid(np.linspace(0.2, 2.9, rings), np.arange(sides) * 2 * np.pi / sides, indexing="ij")
    points = np.stack([np.sin(down) * np.cos(around), np.sin(down) * np.sin(around), np.cos(down)], axis=-1)
    i, j = (index.ravel() for index in np.meshgrid(np.arange(rings - 1), np.arange(sides), indexing="ij"))
    k = (j + 1) % sides
    faces = np.stack([i * sides + j, (i + 1) * sides + j, (i + 1) * sides + k, i * sides + k], axis=1)
    return obj_text(0.5 + 0.3 * points.reshape(-1, 3), faces)


@pytest.fixture
def program(real_daemon, environment, tmp_path):
    """Runs a program of tests/accuracy on the box."""
    def run(name, faces, *options):
        cage, model = tmp_path / "cage.obj", tmp_path / "model.obj"
        cage.write_text(obj_text(box_vertices(), faces))
        model.write_text(sphere_text())
        environment.update(BARYCAST_BIN_DIR=str(real_daemon.parent), BARYCAST_PYTHON_PROTO=environment["PYTHONPATH"]
                           .split(":")[1])
        return subprocess.run([sys.executable, ACCURACY / name, cage, model, "--cache", tmp_path / "cache", *options],
                              env=environment, capture_output=True, text=True, timeout=120)
    return run


@pytest.fixture
def measured(program, tmp_path):
    """Runs accuracy.py; returns what it did and its records."""
    def run(faces, *options):
        out = tmp_path / "out.json"
        done = program("accuracy.py", faces, "--json", out, "--points", "12", "--surface-points", "500", *options)
        return done, json.loads(out.read_text()) if out.exists() else None
    return run


def test_harmonic(measured, tmp_path):
    options = ["--coordinates", "harmonic", "--samples", "20", "--seeds", "2", "--panels", "300",
               "--plot", tmp_path / "out.png"]
    options += ["--preset", "paper", "sampling", "predicted"]
    done, records = measured(BOX_QUADS, *options, "--estimator", "boundary-element", "--estimator-panels", "100")
    assert done.returncode == 0, done.stderr
    # Four sets; two presets and the corrected prediction, denoised and not; and the boundary elements.
    assert len(records) == 4 * (3 * 2 + 1) == len(done.stdout.splitlines()) - 1
    assert (tmp_path / "out.png").stat().st_size > 0
    assert {r["set"] for r in records} == {"inside", "near", "on", "outside"}
    keys = {"cage", "model", "coordinates", "preset", "m", "panels", "denoise", "set", "E_rms", "E_median", "E_p99",
            "E_worst", "bias", "bias_below", "noise", "reference", "reference_error", "gradient_error",
            "gradient_error_median", "linear_precision_error", "seconds", "samples", "seeds", "points", "points_bound",
            "whole_mesh", "rows_flagged", "options"}
    for record in records:
        assert keys <= record.keys()
        assert record["linear_precision_error"] < 1e-12 and record["points"] == 12
        assert record["whole_mesh"] == (record["denoise"] == "auto") == (record["points_bound"] > 12)
        if record["m"]:
            assert record["noise"] ** 2 + record["bias"] ** 2 == pytest.approx(record["E_rms"] ** 2, rel=1e-6) \
                or record["bias"] == 0
    error = {(r["set"], r["preset"], r["denoise"]): r["E_rms"] for r in records}
    for name in ("inside", "outside"):
        assert error[name, "boundary-element", "none"] < 0.1 * error[name, "sampling", "none"]
        assert error[name, "predicted", "none"] < 0.2 * error[name, "sampling", "none"]
    assert error["on", "sampling", "none"] < 1e-12

    # References are kept, and the same run gives the same figures.
    files = {path: path.stat().st_mtime_ns for path in (tmp_path / "cache").iterdir()}
    assert len(files) == 4
    _, again = measured(BOX_QUADS, *options)
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "cache").iterdir()} == files
    assert [r["E_rms"] for r in again] == [r["E_rms"] for r in records if r["m"]]


def test_exact_mean_value(measured):
    done, records = measured(BOX_TRIANGLES, "--coordinates", "mean-value", "--samples", "20", "--denoise", "none",
                             "--preset", "paper", "paper-300", "predicted", "--estimator", "exact", "boundary-element")
    assert done.returncode == 0, done.stderr
    assert "paper-300 differs from paper in walks only" in done.stderr
    assert "mean-value is not predicted" in done.stderr
    assert "boundary-element does not compute mean-value" in done.stderr
    assert {(r["preset"], r["m"]) for r in records} == {("paper", 20), ("exact", None)}
    for record in records:
        if record["preset"] == "exact":  # pruned rows against unpruned ones
            assert record["E_rms"] < 1e-3 and record["reference"] in ("closed form", "basis")
        elif record["set"] in ("inside", "outside"):
            assert record["E_rms"] > 1e-3 and record["gradient_error"] > 1e-3


@pytest.mark.parametrize("option", ["--json", "--plot"])
def test_outputs_are_checked_before_measuring(measured, tmp_path, option):
    done, _ = measured(BOX_QUADS, "--coordinates", "harmonic", option, tmp_path / "absent" / "out")
    assert done.returncode == 1 and done.stdout == "" and done.stderr.count("\n") == 1
    assert done.stderr.startswith(f"accuracy.py: {tmp_path / 'absent' / 'out'}: cannot be written: ")
    assert not (tmp_path / "cache").exists()


def test_says_how_to_build_what_is_missing(measured):
    done, records = measured(BOX_QUADS, "--coordinates", "mean-value", "positive-mean-value", "--reference-rows",
                             "/nowhere/rows", "--denoise", "none", "--sets", "inside")
    assert records is None and done.returncode == 1
    for kind in ("mean-value", "positive-mean-value"):
        assert f"note: {kind}: there is no program /nowhere/rows; build it by `cmake --build build --target " \
            "reference_rows` or " in done.stderr


def test_the_readme_s_example(measured, environment, tmp_path):
    """Its options are understood; its files are the demo's."""
    text = (ACCURACY / "README.md").read_text()
    assert "cmake --build build --target reference_rows" in text
    command = re.search(r"^/usr/bin/python3 tests/accuracy/accuracy.py (.*?[^\\])$", text, re.MULTILINE | re.DOTALL)
    files = command.group(1).replace("\\\n", " ").split()
    demo = (ROOT / "deploy" / "demo.sh").read_text() + (ROOT / "deploy" / "demo" / "generate.py").read_text()
    assert all(f"{Path(name).name}" in demo and name.startswith("build/demo/") for name in files[:2])
    options = files[2:files.index("--json")]
    done, records = measured(BOX_QUADS, *options, "--points", "5", "--samples", "5", "--panels", "100", "--plot",
                             tmp_path / "out.png")
    assert done.returncode == 0 and records and (tmp_path / "out.png").exists(), done.stderr


def test_errors_are_sentences(measured):
    done, records = measured(BOX_QUADS, "--coordinates", "harmonic", "--panels", "3")
    assert records is None and done.returncode == 1
    assert done.stderr.startswith("accuracy.py: ") and "panels" in done.stderr and "Traceback" not in done.stderr


def test_intervals(program):
    """How often stated errors hold: of few points, so that it can only be nearly always."""
    done = program("intervals.py", BOX_QUADS, "--points", "40", "--samples", "2000", "--panels", "300")
    assert done.returncode == 0, done.stderr
    lines = [line.split() for line in done.stdout.splitlines()[1:]]
    assert [line[0] for line in lines] == ["inside"] * 2 + ["near"] * 2 + ["outside"] * 2
    for name, target, points, walks, within, noise, stated, bias in lines:
        assert int(points) == 40 and int(walks) >= 96 and float(within) > 80
        assert float(stated) <= float(target) and float(bias) < 0.01
        assert 0.5 * float(stated) < float(noise) < 2 * float(stated) + 1e-5
