"""Estimators other than sampling, through the service and the command line."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from running import run, write_box
from shapes import box_cage, grid_text, obj_text, points_inside, trilinear

from barycast import Cage, Client, InputError, load_cage, load_model
from barycast.options import compute_options, output_options

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "support"))
import reference_error  # noqa: E402  (found on the path above)


@pytest.fixture
def client(real_daemon):
    with Client(threads=2) as client:
        yield client


def cut_box() -> Cage:
    quads = box_cage().quads.reshape(-1, 4)
    return Cage(box_cage().control_vertices, triangles=np.r_[quads[:, :3], quads[:, [0, 2, 3]]])


def arrays(binding) -> list:
    """All bytes of the rows."""
    matrix = binding.matrix
    return [part.tobytes() for part in (matrix.indptr, matrix.indices, matrix.data, binding.flags)] + (
        [] if binding.gradients is None else [binding.gradients.tobytes()])


def blocks_of(rows):
    output = output_options("float64", True)
    output.block_rows = rows
    return output


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


def test_a_corrected_prediction_in_a_box(client):
    """A dozen walks to correct it are better than a hundred that sample, and the prediction is made once."""
    points = points_inside(300)
    binding = client.bind(box_cage(), points, estimator="predicted", dtype="float64", gradients=True)
    sampled = client.bind(box_cage(), points, estimator="sampling", samples=100, dtype="float64")

    def rms(rows):
        return np.sqrt(((rows.matrix.toarray() - trilinear(points))**2).sum(axis=1).mean())

    assert rms(binding) < 1e-3 < 0.1 * rms(sampled)
    options = binding.report["options"]
    assert (options["estimator"], options["panels"], options["samples"]) == ("predicted", 0, 12)
    assert (options["walk_steps_max"], options["thickness"]) == (300, 1e-3)
    assert binding.report["samples"] == 12 * 300 and binding.report["walk_steps"] > 0
    assert binding.report["linear_precision_error_max"] < 1e-12
    assert client.bind(box_cage(), points, estimator="predicted", samples=3).report["samples"] == 900


def test_a_corrected_prediction_depends_on_the_point_alone(client):
    """Not on what was asked for before, on how rows are cut into blocks, or on the points beside it."""
    points = np.r_[points_inside(80), 3 * points_inside(80) - 1]
    options = compute_options(estimator="predicted", seed=3)
    first, again, blocks = (client.bind_with(box_cage(), points, None, options, output) for output in (
        output_options("float64", True), output_options("float64", True), blocks_of(7)))
    assert arrays(first) == arrays(again) == arrays(blocks)
    part = client.bind_with(box_cage(), points[50:100], None, options, output_options("float64", True))
    assert (part.matrix != first.matrix[50:100]).nnz == 0
    other = client.bind_with(box_cage(), points, None, compute_options(estimator="predicted", seed=4),
                             output_options("float64", True))
    assert arrays(other) != arrays(first)


def test_a_corrected_prediction_is_denoised_over_a_mesh(client, tmp_path):
    (tmp_path / "model.obj").write_text(grid_text(30))
    model = load_model(str(tmp_path / "model.obj"))
    denoised, noisy = (client.bind(box_cage(), model.points, model.faces, estimator="predicted", denoise=denoise,
                                   dtype="float64") for denoise in ("auto", "none"))
    options = denoised.report["options"]
    assert (options["denoise"], noisy.report["options"]["denoise"]) == ("mesh", "none")
    assert options["smoothing_time"] > 0
    errors = [np.square(rows.matrix.toarray() - trilinear(model.points)).sum() for rows in (denoised, noisy)]
    assert errors[0] < errors[1]
    again = client.bind(box_cage(), model.points, model.faces, estimator="predicted", dtype="float64")
    assert arrays(again) == arrays(denoised)


def test_exact_is_what_rays_converge_to(client):
    points = np.r_[points_inside(40), 3 * points_inside(40) - 1]
    exact = client.bind(cut_box(), points, coordinates="mean-value", estimator="exact", dtype="float64").matrix.toarray()
    rays = client.bind(cut_box(), points, coordinates="mean-value", samples=20000, dtype="float64").matrix.toarray()
    assert np.abs(exact - rays).max() < 2e-3


def too_large() -> Cage:
    """A box whose sides are grids: 2,400 quads."""
    at = np.linspace(0, 1, 21)
    u, v = (axis.ravel() for axis in np.meshgrid(at, at, indexing="ij"))
    vertices, quads = [], []
    corner = (21 * np.arange(20)[:, None] + np.arange(20)).ravel()
    for axis in range(3):
        for side in (0, 1):
            face = np.roll(np.stack([np.full_like(u, side), u, v], axis=1), axis, axis=1)
            quads.append(len(vertices) * 441 + np.stack([corner, corner + 21, corner + 22, corner + 1], axis=1))
            vertices.append(face)
    return Cage(np.concatenate(vertices), quads=np.concatenate(quads))


def square() -> Cage:
    return Cage(np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]), segments=np.array([[0, 1], [1, 2], [2, 3], [3, 0]]))


@pytest.mark.parametrize("options, cage, field", [
    ({"estimator": "predicted", "coordinates": "mean-value"}, box_cage(), "header.options.estimator"),
    ({"estimator": "predicted", "preset": "paper"}, box_cage(), "header.options.estimator"),
    ({"estimator": "predicted", "panels": 100}, box_cage(), "header.options.panels"),
    ({"estimator": "predicted", "samples": 0}, box_cage(), "header.options.samples"),
    ({"estimator": "predicted"}, square(), "header.options.estimator"),
    ({"estimator": "predicted"}, too_large(), "header.options.estimator"),
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
        client.bind(cage, points_inside(10)[:, :cage.dimension], **options)
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


def test_estimate_counts_the_prediction(client):
    sampled, predicted = (client.estimate(box_cage(), 10, options=compute_options(estimator=estimator))
                          for estimator in ("sampling", "predicted"))
    assert (sampled.samples, predicted.samples) == (500, 120)
    assert predicted.memory_bytes > sampled.memory_bytes + 900 * 900 / 2 * 8


def test_command_line_of_predictions(cpp, real_daemon, environment, tmp_path):
    """Both programs: how many walks, and what was asked for, is in what they print and in the file."""
    cage, model = write_box(tmp_path, 50)
    for name, call in (("py", lambda *a: run(environment, "bind", *a)), ("cpp", cpp)):
        done = call(cage, model, "-o", tmp_path / f"{name}.npz", "--estimator", "predicted", "--samples", 20)
        assert done.returncode == 0, done.stderr
        assert "harmonic, predicted, 20 samples per point, preset default, denoise none, seed 0" in done.stdout
        done = run(environment, "inspect", tmp_path / f"{name}.npz")
        assert done.returncode == 0 and "predicted, 20 samples" in done.stdout
        done = call(cage, model, "-o", tmp_path / "no.npz", "--estimator", "predicted", "--preset", "paper")
        assert done.returncode == 3 and "options.estimator" in done.stderr and done.stderr.count("\n") == 1
    assert "predicted" in run(environment, "capabilities").stdout


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


@pytest.mark.parametrize("flags", [["--estimator", "predicted", "--gradients", "--samples", "5"],
                                   ["--estimator", "boundary-element", "--panels", "100", "--gradients"],
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
def test_corrected_predictions_are_the_reference(name, data_folder, client):
    """A dozen walks, denoised; sampling with 50 has 0.0156 and 0.0034."""
    reference = np.load(data_folder / "reference" / f"{name}.npz")
    cage = load_cage(str(data_folder / "qmvc" / f"{name}_Cage.obj"))
    model = load_model(str(data_folder / "qmvc" / f"{name}.obj"))
    rows = client.bind(cage, model.points, model.faces, estimator="predicted").matrix[reference["index"]]
    assert reference_error.summary(reference_error.point_errors(rows, reference))["rms"] <= 0.0025


@pytest.mark.parametrize("name", ["FireHydrant", "SpikyBox"])
def test_boundary_elements_are_the_reference(name, data_folder, client):
    """The reference's own error is about 0.001; the default number of panels stays within twice that."""
    reference = np.load(data_folder / "reference" / f"{name}.npz")
    cage = load_cage(str(data_folder / "qmvc" / f"{name}_Cage.obj"))
    points = load_model(str(data_folder / "qmvc" / f"{name}.obj")).points[reference["index"]]
    rows = client.bind(cage, points, estimator="boundary-element").matrix
    assert reference_error.summary(reference_error.point_errors(rows, reference))["rms"] <= 0.002
