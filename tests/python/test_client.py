"""The client against the fake server: arrays, digests and uploads, retries, blocks, refusals."""

import socket
import time

import fake_server
import numpy as np
import pytest
from running import BAD_ADDRESSES
from shapes import BOX_QUADS, box_cage, box_vertices, points_inside

from barycast import AsyncClient, Cage, Client, InputError, ServerError
from barycast.options import COORDINATES, compute_options, output_options


@pytest.fixture
def client(fake):
    with Client(fake.address) as client:
        yield client


@pytest.mark.parametrize("dtype", ["float32", "float64", np.float64])
def test_bind(client, dtype):
    points = points_inside(2500)
    binding = client.bind(box_cage(), points, gradients=True, dtype=dtype, samples=7, seed=3)
    assert binding.matrix.shape == (2500, 8) and binding.matrix.dtype == np.dtype(dtype)
    assert binding.matrix.indices.dtype == binding.matrix.indptr.dtype == np.int32
    assert binding.gradients.shape == (binding.matrix.nnz, 3) and binding.gradients.dtype == np.dtype(dtype)
    assert binding.flags.shape == (2500,) and binding.flags.dtype == np.uint8
    tolerance = 1e-6 if np.dtype(dtype) == np.float32 else 1e-13
    np.testing.assert_allclose(binding.deform(box_vertices()), points, atol=tolerance)
    assert binding.cage_digest == box_cage().digest.sha256.hex()
    report = binding.report
    assert (report["points"], report["control_vertices"], report["options"]["samples"], report["options"]["seed"]) == (
        2500, 8, 7, 3)
    assert report["warnings"] == [{"field": "cage.control_vertices[1]", "message": "is not used"}]
    assert report["build_version"] == "0.0.0" and report["seconds"]["total"] > 0


def test_blocks_of_rows_and_progress(client):
    seen = []
    computation = client.compute(box_cage(), points_inside(2500), output=output_options("float64"),
                                 progress=lambda *arguments: seen.append(arguments))
    assert [(rows.first_row, len(rows.flags)) for rows in computation] == [(0, 1000), (1000, 1000), (2000, 500)]
    assert seen == [("sampling", 1, 2)]
    assert computation.header.options.coordinates == COORDINATES["harmonic"]
    assert computation.summary.row_count == 2500


def test_uploads_once_when_missing(client, behaviour):
    client.bind(box_cage(), points_inside(3))
    client.bind(box_cage(), points_inside(3))
    assert behaviour.log == ["capabilities", "digest", "upload", "digest", "digest"]


def test_reuploads_after_an_eviction(client, fake, behaviour):
    client.bind(box_cage(), points_inside(3))
    fake.service.cages.clear()
    client.bind(box_cage(), points_inside(3))
    assert behaviour.log[-3:] == ["digest", "upload", "digest"]


def test_inline_when_still_missing(client, behaviour):
    behaviour.uploads_ignored = True
    client.bind(box_cage(), points_inside(3))
    assert behaviour.log == ["capabilities", "digest", "upload", "digest", "inline"]


def test_retries_before_the_first_row(fake, behaviour):
    behaviour.unavailable, behaviour.busy = 1, 1
    with Client(fake.address) as client:
        assert client.bind(box_cage(), points_inside(3)).matrix.shape == (3, 8)
    behaviour.unavailable = 1000
    for seconds in (0.3, 0.0):
        with Client(fake.address, retry_seconds=seconds) as client, pytest.raises(ServerError) as caught:
            client.bind(box_cage(), points_inside(3))
        assert caught.value.code == "UNAVAILABLE"
    assert 900 < behaviour.unavailable < 998


def test_no_retry_of_other_failures(client, behaviour):
    behaviour.break_after_blocks = 1
    with pytest.raises(ServerError):
        client.bind(box_cage(), points_inside(2500))
    assert behaviour.log.count("digest") == 2  # missing, then held


def test_nobody_there():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with Client(f"127.0.0.1:{port}", retry_seconds=0.3) as client, pytest.raises(ServerError) as caught:
        client.bind(box_cage(), points_inside(3))
    assert caught.value.code == "UNAVAILABLE"


@pytest.mark.parametrize("address", [*BAD_ADDRESSES, 50051])
def test_bad_addresses_are_refused_at_once(address):
    for make in (Client, AsyncClient):
        with pytest.raises(InputError) as caught:
            make(address)
        assert caught.value.field == "server" and "HOST:PORT" in caught.value.message


@pytest.mark.parametrize("form", ["127.0.0.1:{}", "localhost:{}", "dns:localhost:{}", "dns:///127.0.0.1:{}",
                                  "ipv4:127.0.0.1:{}", "ipv4:127.0.0.1:1,127.0.0.1:{}", "ipv4:///127.0.0.1:{}"])
def test_addresses_that_reach_a_server(fake, form):
    with Client(form.format(fake.port)) as client:
        assert client.capabilities().build_version == "0.0.0"


@pytest.mark.parametrize("address", ["[::1]:50051", "ipv6:[::1]:50051", "ipv6:%5B::1%5D:50051", "dns:///[::1]:1",
                                     "dns://8.8.8.8/host.domain:65535", "unix:socket", "unix:///a/b", "unix:/a b",
                                     "unix-abstract:name", "vsock:2:50051", "xds:///service", "my_host:50051"])
def test_other_addresses_are_taken(address):
    Client(address).close()


def test_deadline(fake, behaviour):
    behaviour.row_seconds = 1.0
    with Client(fake.address, timeout_seconds=0.2) as client, pytest.raises(ServerError) as caught:
        client.bind(box_cage(), points_inside(3))
    assert caught.value.code == "DEADLINE_EXCEEDED"


def test_the_deadline_covers_all_attempts(fake, behaviour):
    behaviour.unavailable = 1000
    started = time.monotonic()
    with Client(fake.address, timeout_seconds=0.5, retry_seconds=60) as client, pytest.raises(ServerError):
        client.bind(box_cage(), points_inside(3))
    assert time.monotonic() - started < 5


def test_server_restart_between_calls():
    first = fake_server.start("127.0.0.1:0")
    address = f"127.0.0.1:{first.port}"
    with Client(address) as client:
        client.bind(box_cage(), points_inside(3))
        first.stop(None).wait()
        second = fake_server.start(address)
        assert client.bind(box_cage(), points_inside(3)).matrix.shape == (3, 8)
        assert "upload" in second.service.behaviour.log
        second.stop(None).wait()


def test_blocks_respect_the_servers_limit(client, behaviour):
    behaviour.message_bytes_max = 16384
    points = points_inside(3000)
    faces = [list(range(5 * i, 5 * i + 3 + i % 3)) for i in range(590)] + [list(range(2500))]
    client.bind(box_cage(), points, faces)
    assert max(behaviour.request_bytes) <= behaviour.message_bytes_max
    assert len(behaviour.request_bytes) == 8  # 72,000 bytes of points in 12,288 each; many faces, one large face


def test_float32_points_travel_as_float32(client, behaviour):
    points = points_inside(1000)
    client.bind(box_cage(), points)
    client.bind(box_cage(), points.astype(np.float32))
    wide, narrow = behaviour.request_bytes
    assert 23000 < wide < 25000 and 11500 < narrow < 12500


@pytest.mark.parametrize("change, field", [
    (dict(points=[[0, 0, np.inf]]), "points[0]"),
    (dict(points=[[0.5, 0.5]]), "points"),
    (dict(points=np.zeros((0, 3))), "points"),
    (dict(faces=[[0, 1, 3]]), "faces.corners[2]"),
    (dict(faces=[[0, 1]]), "faces[0]"),
    (dict(coordinates="harmonica"), "options.coordinates"),
    (dict(samples=-1), "options.samples"),
    (dict(seed=2**64), "options.seed"),
    (dict(dtype="float16"), "output.type"),
    (dict(samples=200000), "options.samples"),  # refused by the server
])
def test_refusals_name_the_field(client, change, field):
    arguments = {"points": np.full((3, 3), 0.5), **change}
    with pytest.raises(InputError) as caught:
        client.bind(box_cage(), **arguments)
    assert caught.value.field == field


def test_leaving_the_loop_cancels(client, behaviour):
    behaviour.row_seconds = 0.05
    for rows in client.compute(box_cage(), points_inside(100_000)):
        assert rows.first_row == 0
        break
    assert client.bind(box_cage(), points_inside(3)).matrix.shape == (3, 8)


def test_a_cage_in_the_plane(client):
    cage = Cage([[0, 0], [1, 0], [1, 1], [0, 1]], segments=[[0, 1], [1, 2], [2, 3], [3, 0]])
    points = points_inside(10)[:, :2]
    binding = client.bind(cage, points, gradients=True)
    assert binding.gradients.shape == (40, 2) and binding.report["dimension"] == 2
    np.testing.assert_allclose(binding.deform(cage.control_vertices), points, atol=1e-6)


def test_upload_and_capabilities(client):
    assert client.capabilities().numerics_version == 1
    cage = Cage.from_faces(np.r_[box_vertices(), [[0.5, 0.5, 2]]], np.r_[BOX_QUADS])
    assert client.upload(cage).digest.sha256 == cage.digest.sha256


def test_estimate(client, behaviour):
    cost = client.estimate(box_cage(), 7, [[0, 1, 2]], compute_options(samples=10))
    assert (cost.samples, cost.output_bytes) == (70, 700)
    assert behaviour.log == ["estimate", "digest", "upload", "estimate", "digest"]
    behaviour.uploads_ignored = True
    client.estimate(Cage.from_faces(box_vertices() * 2, BOX_QUADS), 7)
    assert behaviour.log[-3:] == ["digest", "estimate", "inline"]
    behaviour.estimates = False
    with pytest.raises(InputError, match="does not estimate") as caught:
        client.estimate(box_cage(), 7)
    assert caught.value.code == "UNIMPLEMENTED"


def test_rows_lie_in_place(client):
    """The matrix is made over the gathered arrays, and they hold nothing beyond their rows."""
    binding = client.bind(box_cage(), points_inside(2500), gradients=True)
    for part in (binding.matrix.data, binding.matrix.indices, binding.gradients):
        assert part.base is None or part.base.nbytes == part.nbytes
    rows = next(iter(client.compute(box_cage(), points_inside(10))))
    assert not rows.values.flags.owndata and not rows.values.flags.writeable


def test_option_names():
    assert list(COORDINATES) == ["harmonic", "mean-value", "positive-mean-value"]
    assert compute_options("positive_mean_value").coordinates == COORDINATES["positive-mean-value"]
    assert not compute_options().HasField("samples") and compute_options(samples=0).HasField("samples")
