"""barycast_bind when the network and the server misbehave: broken connections, other builds, busy and forgetful servers."""

import json
import threading
import time

import fake_server
import grpc
import numpy as np
import pytest
from cutting_proxy import CuttingProxy
from running import run, write_box
from shapes import box_cage, box_vertices, grid_text, points_inside, polygon_cage_text

from barycast import Binding, Client, arrays, load_model
from barycast.v1 import barycast_pb2 as pb
from barycast.v1 import barycast_pb2_grpc


@pytest.mark.parametrize("flags", [["--denoise", "none"], []])
def test_resumes_across_cut_connections(cpp, tcp_daemon, environment, tmp_path, flags):
    cage, model = tmp_path / "cage.obj", tmp_path / "model.obj"
    cage.write_text(polygon_cage_text())
    model.write_text(grid_text(150))
    port = tcp_daemon()
    common = [cage, model, "--samples", 10, "--gradients", "--dtype", "float64", *flags]
    done = run(environment, "bind", *common, "-o", tmp_path / "py.npz", "--server", f"127.0.0.1:{port}")
    assert done.returncode == 0, done.stderr
    # 22,500 rows of 10 entries of 36 bytes: 8 MB in blocks of 4096 rows.
    with CuttingProxy(port, [2_000_000, 3_500_000]) as proxy:
        done = cpp(*common, "-o", tmp_path / "cpp.npz", "--server", proxy.address)
    assert done.returncode == 0, done.stderr
    assert proxy.connections == 3
    ours, theirs = np.load(tmp_path / "cpp.npz"), np.load(tmp_path / "py.npz")
    for name in set(ours.files) - {"report"}:
        assert ours[name].tobytes() == theirs[name].tobytes(), name
    reports = [json.loads(str(file["report"])) for file in (ours, theirs)]
    for name in ("points", "entries", "rows", "options"):
        assert reports[0][name] == reports[1][name]
    # A cut connection of which a busy machine read no row is not resumed, but begun anew.
    assert 1 <= len(reports[0]["resumed_rows"]) <= 2 and reports[1]["resumed_rows"] == []


class Rebuilt(fake_server.FakeService):
    """Breaks the first answer after a block, and then has another numerics_version."""

    version = 1

    def ComputeCoordinates(self, request_iterator, context):
        requests = list(request_iterator)
        resume = requests[0].header.resume
        if resume.first_row and resume.numerics_version != self.version:
            self.behaviour.log.append("refused")
            fake_server.abort(context, grpc.StatusCode.FAILED_PRECONDITION, "another build",
                              fake_server.bad_request("header.resume.numerics_version", "another build"))
        for response in super().ComputeCoordinates(iter(requests), context):
            if response.WhichOneof("message") == "header":
                response.header.numerics_version = self.version
            yield response
            if self.version == 1 and response.WhichOneof("message") == "rows":
                self.version = 2
                context.abort(grpc.StatusCode.UNAVAILABLE, "gone")


class LosesTheSummary(fake_server.FakeService):
    """Breaks the first answer after its last row; then resumes."""

    broken = False

    def ComputeCoordinates(self, request_iterator, context):
        requests = list(request_iterator)
        header = requests[0].header
        first_row = header.resume.first_row
        assert first_row < header.queries.point_count
        for response in super().ComputeCoordinates(iter(requests), context):
            if response.WhichOneof("message") == "summary" and not self.broken:
                self.broken = True
                context.abort(grpc.StatusCode.UNAVAILABLE, "gone")
            if response.WhichOneof("message") == "rows":
                assert first_row in (0, 2499)
                if first_row:
                    if response.rows.first_row + len(response.rows.flags) <= first_row:
                        continue
                    response.rows.CopyFrom(last_row(response.rows))
            yield response


def last_row(rows):
    """The block's last row alone."""
    begin = int(np.frombuffer(rows.offsets.data, "<u4")[-2])
    end = rows.indices.rows
    return pb.RowBlock(first_row=rows.first_row + len(rows.flags) - 1,
                       offsets=arrays.to_message(np.array([0, end - begin], np.uint32)),
                       indices=arrays.to_message(np.frombuffer(rows.indices.data, "<u4")[begin:]),
                       values=arrays.to_message(np.frombuffer(rows.values.data, "<f4")[begin:]), flags=rows.flags[-1:])


@pytest.fixture(params=[Rebuilt])
def unsteady(request, monkeypatch):
    monkeypatch.setattr(fake_server, "FakeService", request.param)
    server = fake_server.start("127.0.0.1:0")
    server.address = f"127.0.0.1:{server.port}"
    yield server
    server.stop(None)


def test_starts_over_with_another_build(cpp, unsteady, tmp_path):
    cage, model = write_box(tmp_path, 2500)
    done = cpp(cage, model, "-o", tmp_path / "b.npz", "--server", unsteady.address)
    assert done.returncode == 0, done.stderr
    assert unsteady.service.behaviour.log.count("refused") == 1
    binding = Binding.load(tmp_path / "b.npz")
    assert binding.report["numerics_version"] == 2 and binding.matrix.shape == (2500, 8)
    np.testing.assert_allclose(binding.deform(box_vertices()), points_inside(2500), atol=1e-6)


@pytest.mark.parametrize("unsteady", [LosesTheSummary], indirect=True)
def test_only_the_summary_is_missing(cpp, unsteady, tmp_path):
    cage, model = write_box(tmp_path, 2500)
    done = cpp(cage, model, "-o", tmp_path / "b.npz", "--server", unsteady.address)
    assert done.returncode == 0 and unsteady.service.broken, done.stderr
    binding = Binding.load(tmp_path / "b.npz")
    assert binding.report["points"] == 2500 and binding.report["resumed_rows"] == [2500]
    np.testing.assert_allclose(binding.deform(box_vertices()), points_inside(2500), atol=1e-6)


def test_uploads_once_then_inline(cpp, fake, behaviour, tmp_path):
    cage, model = write_box(tmp_path)
    arguments = [cage, model, "-o", tmp_path / "b.npz", "--server", fake.address]
    assert cpp(*arguments).returncode == 0
    assert behaviour.log == ["capabilities", "digest", "upload", "digest"]
    fake.service.cages.clear()
    behaviour.log.clear()
    behaviour.uploads_ignored = True
    assert cpp(*arguments).returncode == 0
    assert behaviour.log == ["capabilities", "digest", "upload", "digest", "inline"]


def test_blocks_respect_the_servers_limit(cpp, fake, behaviour, tmp_path):
    cage, model = write_box(tmp_path)
    model.write_text(grid_text(60))
    sent = []
    for limit in (16384, 4 << 20):
        behaviour.message_bytes_max = limit
        behaviour.request_bytes.clear()
        assert cpp(cage, model, "-o", tmp_path / "b.npz", "--server", fake.address).returncode == 0
        assert max(behaviour.request_bytes) <= limit
        sent.append(list(behaviour.request_bytes))
        behaviour.request_bytes.clear()
        with Client(fake.address) as client:
            parsed = load_model(model)
            client.bind(box_cage(), parsed.points, parsed.faces)
        assert behaviour.request_bytes == sent[-1]  # the same cuts
    assert len(sent[0]) > 10 and len(sent[1]) == 2


def test_waits_for_a_busy_server(cpp, tcp_daemon, tmp_path):
    cage, model = write_box(tmp_path)
    address = f"127.0.0.1:{tcp_daemon('--requests-max', '1')}"
    release = threading.Event()

    def holding():
        header = pb.ComputeHeader(inline_cage=box_cage().to_message(), queries=pb.QuerySet(point_count=1))
        yield pb.ComputeCoordinatesRequest(header=header)
        release.wait(30)

    with grpc.insecure_channel(address) as channel:
        call = barycast_pb2_grpc.BarycastServiceStub(channel).ComputeCoordinates(holding(), timeout=60)
        time.sleep(0.5)
        threading.Timer(1.5, lambda: (release.set(), call.cancel())).start()
        started = time.monotonic()
        done = cpp(cage, model, "-o", tmp_path / "b.npz", "--server", address)
        assert done.returncode == 0, done.stderr
        assert time.monotonic() - started > 0.9  # the server asks for a second


class DiesAtWork(fake_server.FakeService):
    """Reports progress, as far as every attempt before, and goes away."""

    attempts = 0

    def ComputeCoordinates(self, request_iterator, context):
        self.attempts += 1
        for response in super().ComputeCoordinates(request_iterator, context):
            if response.WhichOneof("message") == "rows":
                context.abort(grpc.StatusCode.UNAVAILABLE, "gone")
            yield response


@pytest.mark.parametrize("unsteady", [DiesAtWork], indirect=True)
def test_repeated_progress_is_none(cpp, unsteady, tmp_path):
    """A request that ends its server must not be sent for ever."""
    cage, model = write_box(tmp_path)
    done = cpp(cage, model, "-o", tmp_path / "b.npz", "--server", unsteady.address, "--retry-seconds", 2)
    assert done.returncode == 4 and 1 < unsteady.service.attempts < 50
