"""The client with the real daemon: coordinates of a box against their closed form, and what clients rely on."""

import numpy as np
import pytest
from fake_server import server_digest
from running import run
from shapes import BOX_QUADS, box_cage, box_vertices, points_inside, trilinear

from barycast import Cage, Client, InputError
from barycast.options import FLAGS
from barycast.report import linear_precision_error, statistics


@pytest.fixture
def client(real_daemon):
    with Client(threads=2) as client:
        yield client


def rms_error(rows: np.ndarray, points: np.ndarray) -> float:
    return float(np.sqrt(((rows - trilinear(points)) ** 2).sum(axis=1).mean()))


def test_box_is_trilinear(client):
    """Error against the closed form is small, and shrinks with the samples."""
    points = points_inside(400)
    few = client.bind(box_cage(), points, samples=50).matrix.toarray()
    many = client.bind(box_cage(), points, samples=5000).matrix.toarray()
    # Plain Monte Carlo has variance (1 - sum a^2) / m before the projection: at most 0.13 and 0.013 here.
    assert rms_error(few, points) < 0.13
    assert rms_error(many, points) < 0.013 + 0.002  # and the bias of the thickness, 1e-3


def test_float64_rows_keep_the_promise(client):
    cage = Cage.from_faces(box_vertices() * [3, 1, 2] + [100, 0, -50], BOX_QUADS)
    points = np.r_[points_inside(200), 3 * points_inside(200) - 1] * [3, 1, 2] + [100, 0, -50]
    binding = client.bind(cage, points, dtype="float64", gradients=True)
    # 1e-12 is promised in diagonals; forming the points and this check round at 100 / 3.7 diagonals.
    assert linear_precision_error(binding, cage, points) < 2e-12
    sums = np.asarray(binding.matrix.sum(axis=1)).ravel()
    assert np.abs(sums - 1).max() < 2e-12
    for row in range(0, len(points), 37):
        part = slice(*binding.matrix.indptr[row:row + 2])
        corners = cage.control_vertices[binding.matrix.indices[part]]
        np.testing.assert_allclose(binding.gradients[part].T @ corners, np.eye(3), atol=1e-9)
        np.testing.assert_allclose(binding.gradients[part].sum(axis=0), 0, atol=1e-9)


def test_flags_and_counts(client):
    points = np.array([[0.5, 0.5, 0.5], [2.0, 0.5, 0.5], [1.0, 0.25, 0.5]])
    binding = client.bind(box_cage(), points)
    assert not binding.flags[0] & (FLAGS["outside"] | FLAGS["on-cage"])
    assert binding.flags[1] & FLAGS["outside"]
    assert binding.flags[2] & FLAGS["on-cage"]
    np.testing.assert_allclose(binding.matrix[2].toarray()[0], trilinear(points[2:])[0], atol=1e-6)
    assert statistics(binding)["rows"] == binding.report["rows"]
    assert binding.report["entries"] == binding.matrix.nnz


def test_rows_repeat_and_do_not_depend_on_order(client):
    points = points_inside(300)
    first = client.bind(box_cage(), points, seed=5, dtype="float64").matrix.toarray()
    order = np.random.default_rng(0).permutation(300)
    again = client.bind(box_cage(), points[order], seed=5, dtype="float64").matrix.toarray()
    assert np.array_equal(first[order], again)
    assert not np.array_equal(first, client.bind(box_cage(), points, seed=6, dtype="float64").matrix.toarray())


def test_denoising_over_faces(client):
    grid = np.stack(np.meshgrid(*[np.linspace(0.2, 0.8, 20)] * 2), axis=-1).reshape(-1, 2)
    points = np.c_[grid, np.full(len(grid), 0.5)]
    faces = [[20 * i + j, 20 * i + j + 1, 20 * i + j + 21, 20 * i + j + 20] for i in range(19) for j in range(19)]
    rough = client.bind(box_cage(), points, faces, denoise="none", preset="paper").matrix.toarray()
    smooth = client.bind(box_cage(), points, faces, preset="paper").matrix.toarray()
    assert rms_error(smooth, points) < 0.8 * rms_error(rough, points)


def test_a_square_in_the_plane(client):
    cage = Cage([[0, 0], [1, 0], [1, 1], [0, 1]], segments=[[0, 1], [1, 2], [2, 3], [3, 0]])
    points = points_inside(200)[:, :2]
    binding = client.bind(cage, points, samples=2000)
    x, y = points.T
    exact = np.stack([(1 - x) * (1 - y), x * (1 - y), x * y, (1 - x) * y], axis=1)
    assert np.sqrt(((binding.matrix.toarray() - exact) ** 2).sum(axis=1).mean()) < 0.025


def test_digests_agree(client):
    cage = Cage.from_faces(np.r_[box_vertices(), [[-0.0, 3.0, 0.5]]], [[0, 2, 3, 1], [4, 5, 7], [0, 1, 5, 4, 8]])
    response = client.upload(cage)
    assert response.digest == cage.digest and cage.digest.sha256 == server_digest(cage.to_message())


def test_unused_control_vertices_are_reported(client):
    cage = Cage.from_faces(np.r_[box_vertices(), [[9, 9, 9.0]]], BOX_QUADS)
    binding = client.bind(cage, points_inside(10))
    assert binding.matrix.shape == (10, 9) and binding.matrix[:, 8].nnz == 0
    assert binding.report["warnings"]


@pytest.mark.parametrize("change, field", [
    (dict(samples=0), "samples"), (dict(thickness=0.5), "thickness"), (dict(prune_below=0.5), "prune_below"),
    (dict(walk_steps_max=0), "walk_steps_max"), (dict(denoise="mesh"), "denoise"),
])
def test_refusals_name_the_field(client, change, field):
    with pytest.raises(InputError) as caught:
        client.bind(box_cage(), points_inside(3), **change)
    assert caught.value.field.endswith(field)


def test_flat_cages_are_refused(client):
    with pytest.raises(InputError) as caught:
        client.bind(Cage([[0, 0, 0], [1, 0, 0], [0, 1, 0]], triangles=[[0, 1, 2]]), points_inside(3))
    assert caught.value.field.startswith("cage")


def test_a_model_in_the_wild(real_daemon, environment, data_folder, tmp_path):
    """FireHydrant, bound and posed by the command line."""
    folder = data_folder / "qmvc"
    bind, posed = tmp_path / "bind.npz", tmp_path / "posed.obj"
    done = run(environment, "bind", folder / "FireHydrant_Cage.obj", folder / "FireHydrant.obj", "-o", bind)
    assert (done.returncode, done.stderr) == (0, "")
    pose = folder / "FireHydrant_Cage_Deformed.obj"
    done = run(environment, "deform", bind, pose, folder / "FireHydrant.obj", "-o", posed)
    assert (done.returncode, done.stderr) == (0, "") and posed.stat().st_size > 1e6
