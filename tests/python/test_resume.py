"""Computations whose connection breaks go on from the next row, to the same bits; blocking and asynchronous."""

import asyncio

import numpy as np
import pytest
from cutting_proxy import CuttingProxy
from running import serving
from shapes import box_cage, points_inside

from barycast import AsyncClient, Client, ServerError
from barycast.options import compute_options

GRID = 80


def grid():
    """Points on a plane through the box, and the quads between them."""
    line = np.linspace(0.15, 0.85, GRID)
    points = np.stack([*np.meshgrid(line, line), np.full((GRID, GRID), 0.4)], axis=-1).reshape(-1, 3)
    corner = (np.arange(GRID - 1)[:, None] * GRID + np.arange(GRID - 1)).reshape(-1, 1)
    return points, corner + [0, 1, GRID + 1, GRID]


def bind(mode, address, *arguments, **options):
    if mode == "sync":
        with Client(address, retry_seconds=30) as client:
            return client.bind(*arguments, **options)

    async def run():
        async with AsyncClient(address, retry_seconds=30) as client:
            return await client.bind(*arguments, **options)

    return asyncio.run(run())


def compute(mode, address, *arguments, **options):
    """(computation, blocks)"""
    if mode == "sync":
        with Client(address, retry_seconds=30) as client:
            computation = client.compute(*arguments, **options)
            return computation, list(computation)

    async def run():
        async with AsyncClient(address, retry_seconds=30) as client:
            computation = client.compute(*arguments, **options)
            return computation, [rows async for rows in computation]

    return asyncio.run(run())


def bits(binding):
    matrix = binding.matrix
    return [part.tobytes() for part in (matrix.data, matrix.indices, matrix.indptr, binding.gradients, binding.flags)]


@pytest.fixture(scope="module")
def port():
    from conftest import real_daemon_path
    if not real_daemon_path().exists():
        pytest.skip(f"no daemon {real_daemon_path()} (environment variable BARYCAST_BIN_DIR)")
    # A block must pass within one message of the proxy's cuts; there are then many places to break at.
    with serving(real_daemon_path(), "--threads", 2, "--block-rows-max", 500) as port:
        yield port


@pytest.mark.parametrize("mode", ["sync", "async"])
@pytest.mark.parametrize("denoise", ["none", "mesh"])
def test_the_same_bits(port, mode, denoise):
    points, faces = grid()
    options = dict(gradients=True, denoise=denoise, dtype="float64", samples=5)
    whole = bind(mode, f"127.0.0.1:{port}", box_cage(), points, faces, **options)
    assert whole.report["resumed_rows"] == []
    all_resumed = []
    for cuts in ([700_000], [300, 500_000, 30_000, 800_000, 400_000], [900_000] * 6):
        with CuttingProxy(port, cuts) as proxy:
            pieced = bind(mode, proxy.address, box_cage(), points, faces, **options)
            assert not proxy.cuts or pieced.report["resumed_rows"]
        assert bits(pieced) == bits(whole)
        resumed = pieced.report["resumed_rows"]
        assert resumed == sorted(resumed) and all(row < len(points) for row in resumed)
        all_resumed += resumed  # none, where a busy machine was cut before its first rows and after its last
        assert pieced.report["rows"] == whole.report["rows"] and pieced.report["entries"] == whole.matrix.nnz
    assert all_resumed


def test_rows_of_compute_have_no_gaps(port):
    points = points_inside(20000)
    for mode in ("sync", "async"):
        with CuttingProxy(port, [200_000, 400_000]) as proxy:
            computation, blocks = compute(mode, proxy.address, box_cage(), points, options=compute_options(samples=5))
        assert computation.resumed_rows
        assert [rows.first_row for rows in blocks] == [
            0, *np.cumsum([len(rows.flags) for rows in blocks])[:-1]]
        assert sum(len(rows.flags) for rows in blocks) == len(points)


def test_the_budget_ends(port):
    """Every connection is cut before a row arrives."""
    with CuttingProxy(port, [2000] * 1000) as proxy:
        with Client(proxy.address, retry_seconds=1.0) as client, pytest.raises(ServerError) as caught:
            client.bind(box_cage(), points_inside(20000), samples=5)
    assert caught.value.code == "UNAVAILABLE"


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_rows_of_the_fake(fake, behaviour, mode):
    behaviour.unavailable_after_blocks = [1, 0, 2]
    binding = bind(mode, fake.address, box_cage(), points_inside(4500), gradients=True)
    assert behaviour.resumes == [1000, 1000, 3000] == binding.report["resumed_rows"]
    assert bits(binding) == bits(bind(mode, fake.address, box_cage(), points_inside(4500), gradients=True))


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_only_the_summary_is_lost(fake, behaviour, mode):
    behaviour.unavailable_after_blocks = [3]
    binding = bind(mode, fake.address, box_cage(), points_inside(2500), gradients=True)
    assert behaviour.resumes == [2499]
    assert bits(binding) == bits(bind(mode, fake.address, box_cage(), points_inside(2500), gradients=True))


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_another_build_answers(fake, behaviour, mode):
    behaviour.unavailable_after_blocks, behaviour.numerics_versions = [1], [1, 2]
    binding = bind(mode, fake.address, box_cage(), points_inside(2500), gradients=True)
    assert behaviour.resumes == [] and binding.report["numerics_version"] == 2
    assert binding.report["resumed_rows"] == []
    assert bits(binding) == bits(bind(mode, fake.address, box_cage(), points_inside(2500), gradients=True))

    behaviour.unavailable_after_blocks, behaviour.numerics_versions = [1], [1, 2]
    with pytest.raises(ServerError, match="after 1000 of 2500 rows.*start over") as caught:
        compute(mode, fake.address, box_cage(), points_inside(2500))
    assert caught.value.code == "FAILED_PRECONDITION"


def test_builds_that_change_for_ever(fake, behaviour):
    behaviour.unavailable_after_blocks, behaviour.numerics_versions = [1] * 50, list(range(1, 60))
    with pytest.raises(ServerError, match="start over"):
        bind("sync", fake.address, box_cage(), points_inside(2500))
    assert len(behaviour.unavailable_after_blocks) == 46
