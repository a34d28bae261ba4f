"""Estimators without samples, through the service and the command line."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from running import run, write_box
from shapes import box_cage, obj_text, points_inside, trilinear

from barycast import Cage, Client, InputError, load_cage, load_model
from barycast.options import compute_options

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "support"))
import reference_error  # noqa: E402  (found on the path above)


@pytest.fixture
def client(real_daemon):
    with Client(threads=2) as client:
        yield client


def cut_box() -> Cage:
    quads = box_cage().quads.reshape(-1, 4)
    return Cage(box_cage().control_vertices, triangles=np.r_[quads[:, :3], quads[:, [0, 2, 3]]])


def test_boundary_elements_in_a_box(client):
    points = points_inside(300)
    seen = []
    binding = client.bind(box_cage(), points, estimator="boundary-element", dtype="float64", gradients=True,
                          progress=lambda stage, done, total: seen.append(stage))
    error = binding.matrix.toarray() - trilinear(points)
    assert np.sqrt((error**2).sum(axis=1).mean()) < 1e-3
    options = binding.report["options"]
    assert (options["estimator"], options["panels"], options["samples"]) == ("boundary-element", 1000, 0)
    assert binding.report["samples"] == 0 and binding.report["seconds"]["solving"] > 0
    assert binding.report["linear_precision_error_max"] < 1e-12
    assert "solving" in seen
    fewer = client.bind(box_cage(), points, estimator="boundary-element", panels=48)
    assert np.abs(fewer.matrix.toarray() - trilinear(points)).max() > np.abs(error).max()


def test_exact_is_what_rays_converge_to(client):
    points = np.r_[points_inside(40), 3 * points_inside(40) - 1]
    exact = client.bind(cut_box(), points, coordinates="mean-value", estimator="exact", dtype="float64").matrix.toarray()
    rays = client.bind(cut_box(), points, coordinates="mean-value", samples=20000, dtype="float64").matrix.toarray()
    assert np.abs(exact - rays).max() < 2e-3


@pytest.mark.parametrize("options, cage, field", [
    ({"estimator": "exact"}, box_cage(), "header.options.estimator"),
    ({"estimator": "exact", "coordinates": "mean-value"}, box_cage(), "header.options.estimator"),
    ({"estimator": "boundary-element", "coordinates": "mean-value"}, box_cage(), "header.options.estimator"),
    ({"estimator": "boundary-element", "samples": 50}, box_cage(), "header.options.samples"),
    ({"estimator": "boundary-element", "panels": 16}, box_cage(), "header.options.panels"),
    ({"panels": 100}, box_cage(), "header.options.panels"),
])
def test_refusals(client, options, cage, field):
    """The same for the computation and for its estimate, cage sent along or known to the server."""
    with pytest.raises(InputError) as refused:
        client.bind(cage, points_inside(10), **options)
    assert refused.value.field == field
    for _ in range(2):
        with pytest.raises(InputError) as refused:
            client.estimate(cage, 10, options=compute_options(**options))
        assert refused.value.field == field
        client.upload(cage)


def test_estimate_counts_the_matrix(client):
    few, many = (client.estimate(box_cage(), 10, options=compute_options(estimator="boundary-element", panels=panels))
                 for panels in (100, 2000))
    assert few.samples == many.samples == 0
    assert many.memory_bytes > 6000 * 6000 / 2 * 8 > 100 * few.memory_bytes


def test_command_line(real_daemon, environment, tmp_path):
    cage, model = write_box(tmp_path, 50)
    done = run(environment, "bind", cage, model, "-o", tmp_path / "b.npz", "--estimator", "boundary-element",
               "--panels", 200)
    assert done.returncode == 0, done.stderr
    assert "boundary-element, at most 200 panels" in done.stdout and "samples" not in done.stdout
    done = run(environment, "inspect", tmp_path / "b.npz")
    assert done.returncode == 0 and "boundary-element" in done.stdout
    done = run(environment, "bind", cage, model, "-o", tmp_path / "c.npz", "--estimator", "exact")
    assert done.returncode == 3 and "closed form" in done.stderr and done.stderr.count("\n") == 1
    assert "boundary-element" in run(environment, "capabilities").stdout


@pytest.mark.parametrize("flags", [["--estimator", "boundary-element", "--panels", "100", "--gradients"],
                                   ["--estimator", "exact", "--coordinates", "mean-value", "--dtype", "float64"]])
def test_equal_bytes_from_both_clients(cpp, real_daemon, environment, tmp_path, flags):
    cage, model = tmp_path / "cage.obj", tmp_path / "model.obj"
    cage.write_text(obj_text(cut_box().control_vertices, cut_box().triangles.reshape(-1, 3)))
    model.write_text(obj_text(points_inside(60), []))
    for out, call in (("cpp.npz", lambda *a: cpp("--quiet", *a)), ("py.npz", lambda *a: run(environment, "bind", *a))):
        done = call(cage, model, "-o", tmp_path / out, *flags)
        assert (done.returncode, done.stderr) == (0, ""), done.stderr
    ours, theirs = np.load(tmp_path / "cpp.npz"), np.load(tmp_path / "py.npz")
    for name in set(ours.files) - {"report"}:
        assert ours[name].tobytes() == theirs[name].tobytes(), name
    assert json.loads(str(ours["report"]))["options"] == json.loads(str(theirs["report"]))["options"]


@pytest.mark.parametrize("name", ["FireHydrant", "SpikyBox"])
def test_boundary_elements_are_the_reference(name, data_folder, client):
    """The reference's own error is about 0.001; the default number of panels stays within twice that."""
    reference = np.load(data_folder / "reference" / f"{name}.npz")
    cage = load_cage(str(data_folder / "qmvc" / f"{name}_Cage.obj"))
    points = load_model(str(data_folder / "qmvc" / f"{name}.obj")).points[reference["index"]]
    rows = client.bind(cage, points, estimator="boundary-element").matrix
    assert reference_error.summary(reference_error.point_errors(rows, reference))["rms"] <= 0.002
