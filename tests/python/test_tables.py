"""Predicted coordinates with the cage's tables, through the service, both clients and their command lines."""

import asyncio
import json

import numpy as np
import pytest
from daemon import Daemon
from running import run, write_box
from shapes import BOX_QUADS, box_cage, box_vertices, grid_text, obj_text, points_inside, trilinear

from barycast import AsyncClient, Cage, Client, InputError, ServerError, load_model
from barycast.options import compute_options

TABLES = {"estimator": "predicted", "tables": True}


@pytest.fixture
def client(real_daemon):
    with Client(threads=2) as client:
        yield client


SIZE = np.array([1, 0.024, 0.024])  # of a bar: a second fills it, where a box has a hundred thousand tables


def bar() -> Cage:
    return Cage.from_faces(box_vertices() * SIZE, BOX_QUADS)


def in_bar(count: int) -> np.ndarray:
    """Further from its sides than points that walk: 0.0096."""
    return (0.4 + 0.2 * np.random.default_rng(1).random((count, 3))) * SIZE


def around(count: int) -> np.ndarray:
    """Points on the bar, next to it, inside, and outside."""
    return np.r_[[[0.5, 0.012, 0.0], [0.5, 0.012, 0.008]], in_bar(count), 3 * in_bar(count) - 1]


def arrays(binding) -> list:
    matrix = binding.matrix
    return [part.tobytes() for part in (matrix.indptr, matrix.indices, matrix.data, binding.flags)]


def test_rows_are_those_of_harmonic_coordinates(client):
    points = points_inside(300)
    binding = client.bind(box_cage(), points, dtype="float64", **TABLES)
    off = np.linalg.norm(binding.matrix.toarray() - trilinear(points), axis=1)
    assert np.median(off) < 2e-3 and off.max() < 2e-2
    assert binding.report["options"]["tables"] is True and binding.report["samples"] == 0
    assert binding.report["options"]["estimator"] == "predicted"


def test_which_tables_are_there_changes_no_bit(real_daemon, client):
    """Cold, warm, by another client and in parts; and where they were filled ahead."""
    points = around(60)
    cold = client.bind(bar(), points, dtype="float64", **TABLES)
    assert arrays(client.bind(bar(), points, dtype="float64", **TABLES)) == arrays(cold)
    part = client.bind(bar(), points[20:40], dtype="float64", **TABLES)
    assert (part.matrix != cold.matrix[20:40]).nnz == 0

    async def bind():
        async with AsyncClient(threads=2) as other:
            uploaded = await other.upload(bar(), fill_tables=True)
            return uploaded.tables, await other.bind(bar(), points, dtype="float64", **TABLES)

    tables, filled = asyncio.run(bind())
    assert tables > 500 and filled.report["cage_cache_hit"] and arrays(filled) == arrays(cold)


def test_seed_and_samples_matter_only_near_the_cage(client):
    points = points_inside(100)
    first, second = (client.bind(box_cage(), points, seed=seed, samples=samples, **TABLES)
                     for seed, samples in ((0, 12), (1, 50)))
    assert arrays(first) == arrays(second)
    near = np.column_stack([points[:, :2], np.full(100, 0.008)])
    first, second = (client.bind(box_cage(), near, seed=seed, **TABLES) for seed in (0, 1))
    assert arrays(first) != arrays(second) and first.report["samples"] > 0


def test_a_model_is_not_denoised(client, tmp_path):
    (tmp_path / "model.obj").write_text(grid_text(10))
    model = load_model(str(tmp_path / "model.obj"))
    binding = client.bind(box_cage(), model.points, model.faces, **TABLES)
    assert binding.report["options"]["denoise"] == "none"
    assert arrays(binding) == arrays(client.bind(box_cage(), model.points, **TABLES))
    assert client.bind(box_cage(), model.points, model.faces, denoise="mesh", **TABLES).report["options"]["tables"]


def test_filling_counts_them(client):
    assert client.upload(bar()).tables == 0
    filled = client.upload(bar(), fill_tables=True)
    assert filled.tables > 500 and filled.digest.sha256 == bar().digest.sha256
    assert client.upload(bar()).tables == client.upload(bar(), fill_tables=True).tables == filled.tables


def test_cages_that_have_none_are_refused(client):
    flat = Cage([[0, 0], [1, 0], [1, 1], [0, 1]], segments=[[0, 1], [1, 2], [2, 3], [3, 0]])
    for cage in (Cage.from_faces(box_vertices(), BOX_QUADS[:5]), flat):
        with pytest.raises(InputError) as refused:
            client.upload(cage, fill_tables=True)
        assert refused.value.field == "fill_tables" and refused.value.code == "INVALID_ARGUMENT"
        assert client.upload(cage).tables == 0


@pytest.mark.parametrize("options", [
    {"estimator": "sampling"},
    {"estimator": "boundary-element"},
    {"estimator": "auto", "preset": "paper"},
    {"estimator": "auto", "coordinates": "mean-value"},
])
def test_refusals(client, options):
    with pytest.raises(InputError) as refused:
        client.bind(box_cage(), points_inside(10), **{**TABLES, **options})
    assert refused.value.field == "header.options.tables"
    with pytest.raises(InputError) as refused:
        client.estimate(box_cage(), 10, options=compute_options(**{**TABLES, **options}))
    assert refused.value.field == "header.options.tables"


def test_filled_tables_count_in_the_cache(real_daemon, tmp_path):
    """Those that a request filled, and those that an upload did."""
    held = []
    with Daemon(real_daemon, tmp_path) as daemon, Client(daemon.address) as client:
        for ask in (lambda: client.bind(bar(), in_bar(200), estimator="predicted"),
                    lambda: client.bind(bar(), in_bar(200), **TABLES),
                    lambda: client.bind(bar(), in_bar(200), **TABLES),
                    lambda: client.upload(bar(), fill_tables=True)):
            ask()
            held.append(daemon.settled_metrics()["barycastd_cage_cache_bytes"])
    assert held[0] < held[1] - 10_000 and held[2] == held[1] < held[3] - 100_000


def test_both_command_lines(cpp, real_daemon, environment, tmp_path):
    """Equal bytes, equal words, and what inspect shows."""
    cage, model = write_box(tmp_path, 50)
    shown = {}
    for name, call in (("py", lambda *a: run(environment, "bind", *a)), ("cpp", cpp)):
        done = call(cage, model, "-o", tmp_path / f"{name}.npz", "--tables")
        assert (done.returncode, done.stderr) == (0, ""), done.stderr
        assert ("predicted with tables, 12 samples per point that no table serves, preset default, denoise none, seed 0"
                in done.stdout)
        inspected = run(environment, "inspect", tmp_path / f"{name}.npz").stdout
        assert inspected.startswith(done.stdout) and "tables True" in inspected
        shown[name] = [line for line in done.stdout.splitlines() if not line.startswith("seconds")]
        refused = call(cage, model, "-o", tmp_path / "no.npz", "--tables", "--estimator", "sampling")
        assert refused.returncode == 3 and "options.tables" in refused.stderr and refused.stderr.count("\n") == 1
    assert shown["py"] == shown["cpp"]
    ours, theirs = np.load(tmp_path / "cpp.npz"), np.load(tmp_path / "py.npz")
    for name in set(ours.files) - {"report"}:
        assert ours[name].tobytes() == theirs[name].tobytes(), name
    reports = [json.loads(str(file["report"])) for file in (ours, theirs)]
    assert reports[0]["options"] == reports[1]["options"]
    done = run(environment, "bind", cage, model, "--estimate", "--tables")
    assert done.returncode == 0 and "at most 600 samples" in done.stdout


def test_a_server_that_knows_no_tables_is_found_out(fake, behaviour):
    behaviour.knows_tables = False
    with Client(fake.address) as client, pytest.raises(ServerError) as caught:
        client.bind(box_cage(), points_inside(3), tables=True)
    assert caught.value.field == "header.options.tables"
