"""The benchmark program at a tiny size: that it runs, and says what its help promises. Nothing is timed here."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

import shapes

STAGES = ["build", "walk", "moments", "solve", "smooth_factor", "smooth_solve", "prune", "encode"]


@pytest.fixture
def files(tmp_path):
    (tmp_path / "cage.obj").write_text(shapes.obj_text(shapes.box_vertices(), shapes.BOX_QUADS))
    (tmp_path / "model.obj").write_text(shapes.grid_text(12))
    return ["--cage", tmp_path / "cage.obj", "--model", tmp_path / "model.obj"]


def run(program, *arguments):
    return subprocess.run([program, *arguments], capture_output=True, text=True, timeout=120)


def test_every_combination_is_a_variant(barycast_bench, files):
    done = run(barycast_bench, *files, "--engine", "grid,embree", "--isa", "avx2", "--threads", "1,2", "--samples", "20",
               "--repeats", "2", "--json")
    assert done.returncode == 0, done.stderr
    variants = [json.loads(line) for line in done.stdout.splitlines()]
    assert [(v["engine"], v["threads"]) for v in variants] == [("grid", 1), ("grid", 2), ("embree", 1), ("embree", 2)]
    for variant in variants:
        assert (variant["points"], variant["control_vertices"], variant["isa"]) == (144, 8, "avx2")
        assert list(variant["stages"]) == STAGES
        assert variant["walks_per_second"] > 0 and variant["peak_bytes"] > 0
        assert 0 < variant["total_s_least"] <= variant["total_s"] <= variant["total_s_most"]


def test_estimators_are_variants(barycast_bench, files):
    done = run(barycast_bench, *files, "--estimator", "sampling,predicted,boundary-element", "--threads", "1")
    assert done.returncode == 0, done.stderr
    variants = [json.loads(line) for line in done.stdout.splitlines()]
    assert [(v["estimator"], v["samples"]) for v in variants] == [("sampling", 50), ("predicted", 12),
                                                                  ("boundary-element", 0)]
    assert [v["walks_per_second"] > 0 for v in variants] == [True, True, False]


def test_cages_are_cold_or_warm(barycast_bench, files):
    for more in ([], ["--no-gradients"], ["--warm"], ["--warm", "--no-gradients"]):
        done = run(barycast_bench, *files, "--estimator", "predicted", "--threads", "2", "--tables", *more)
        assert done.returncode == 0, done.stderr
        [variant] = [json.loads(line) for line in done.stdout.splitlines()]
        assert variant["tables"] > 0 and (variant["stages"]["build"] > 0) == ("--warm" not in more)
        assert list(variant["stages"]) == STAGES


def test_refuses_what_it_cannot_read(barycast_bench, files, tmp_path):
    done = run(barycast_bench, *files[:3], tmp_path / "missing.obj")
    assert done.returncode == 2 and "missing.obj" in done.stderr


def test_the_sweep_runs(barycast_bench, tmp_path):
    sweep = Path(__file__).resolve().parents[1] / "benchmarks/sweep.py"
    done = run(sys.executable, sweep, "--bench", barycast_bench, "--axes", "cages", "--most", "12", "--repeats", "1",
               "--json", tmp_path / "sweep.json")
    assert done.returncode == 0, done.stderr
    head, line = done.stdout.splitlines()
    assert head.split()[:4] == ["triangles", "elements", "vertices", "points"]
    assert line.split()[:4] == ["12", "12", "8", "30,010"]
    [record] = json.loads((tmp_path / "sweep.json").read_text())
    assert record["elements"] == 12 and record["total_s"] > 0
