"""What operators see of the real daemon: its log, its metrics page, reflection and health."""

import json
import threading
import time

import grpc
import pytest
from barycast import Client, load_model
from barycast.v1 import barycast_pb2
from daemon import Daemon, run, tetrahedron
from shapes import box_cage, grid_text


def refused(call):
    with pytest.raises(grpc.RpcError) as caught:
        call()
    return caught.value.code()


def exercise(daemon):
    """Two computations, a refusal, an estimate; with texts that need escaping."""
    daemon.compute(5)
    daemon.compute(4, samples=7)
    assert refused(lambda: daemon.compute(3, metadata=[("x-cage-digest", 'q"\\quote')])) == \
        grpc.StatusCode.INVALID_ARGUMENT
    assert refused(lambda: daemon.compute(1, samples=0)) == grpc.StatusCode.INVALID_ARGUMENT
    daemon.stub.GetCapabilities(barycast_pb2.GetCapabilitiesRequest(), timeout=20)
    assert refused(lambda: daemon.stub.EstimateCost(barycast_pb2.EstimateCostRequest(), timeout=20)) == \
        grpc.StatusCode.INVALID_ARGUMENT


def test_json_log_is_one_object_per_line(real_daemon, tmp_path):
    with Daemon(real_daemon, tmp_path, "--log-format", "json", "--log-level", "debug") as daemon:
        exercise(daemon)
    lines = [json.loads(line) for line in daemon.log_lines()]
    assert all({"time", "level"} <= line.keys() for line in lines)
    requests = [line for line in lines if "method" in line]
    # A line is written once the client has its answer: on a busy machine after those of the next request.
    assert sorted((line["method"], line["code"]) for line in requests) == [
        ("ComputeCoordinates", "INVALID_ARGUMENT"), ("ComputeCoordinates", "INVALID_ARGUMENT"),
        ("ComputeCoordinates", "OK"), ("ComputeCoordinates", "OK"), ("EstimateCost", "INVALID_ARGUMENT"),
        ("GetCapabilities", "OK")]
    computed = [line for line in requests if line["method"] == "ComputeCoordinates"]
    [first], [second] = ([line for line in computed if line.get("points") == count] for count in (5, 4))
    [spoilt] = [line for line in computed if "x-cage-digest" in line.get("message", "")]
    assert (first["points"], first["control_vertices"], first["samples"], first["rows"], first["entries"]) == \
        (5, 4, 5 * 12, 5, 20)
    assert (first["cache_hit"], second["cache_hit"], second["samples"]) == (False, True, 28)
    assert len(first["cage"]) == 64 and first["peer"].startswith("ipv4:")
    assert set(first["stages_ms"]) == {"cage", "solving", "sampling", "smoothing_factor", "smoothing_solve", "rows"}
    assert 0 < sum(first["stages_ms"].values()) <= first["ms"] * 2
    assert not spoilt["stages_ms"]


def test_text_log_has_one_line_per_request(real_daemon, tmp_path):
    with Daemon(real_daemon, tmp_path) as daemon:
        daemon.compute(5)
    [line] = [line for line in daemon.log_lines() if "ComputeCoordinates" in line]
    assert " info ComputeCoordinates OK ms=" in line
    assert " points=5 faces=0 control_vertices=4 samples=60 rows=5 entries=20" in line


def test_metrics_add_up(real_daemon, tmp_path):
    with Daemon(real_daemon, tmp_path, "--threads", "2") as daemon:
        before = daemon.metrics()
        assert before['barycastd_requests_total{method="ComputeCoordinates",code="OK"}'] == 0
        assert before["barycastd_serving"] == 1
        assert before["barycastd_arena_threads"] == 2
        exercise(daemon)
        page = daemon.settled_metrics()

    def total(method, code):
        return page[f'barycastd_requests_total{{method="{method}",code="{code}"}}']

    assert total("ComputeCoordinates", "OK") == 2
    assert total("ComputeCoordinates", "INVALID_ARGUMENT") == 2
    assert total("GetCapabilities", "OK") == 1
    assert total("EstimateCost", "INVALID_ARGUMENT") == 1
    assert page['barycastd_request_duration_seconds_count{method="ComputeCoordinates"}'] == 4
    assert page['barycastd_request_duration_seconds_bucket{method="ComputeCoordinates",le="+Inf"}'] == 4
    assert page['barycastd_request_duration_seconds_sum{method="ComputeCoordinates"}'] > 0
    assert page["barycastd_samples_total"] == 5 * 12 + 4 * 7
    assert page["barycastd_rows_total"] == 9
    assert page["barycastd_entries_total"] == 36
    assert page['barycastd_stage_seconds_total{stage="sampling"}'] > 0
    lookups = {r: page[f'barycastd_cage_cache_lookups_total{{result="{r}"}}'] for r in ("hit", "join", "miss")}
    assert lookups == {"hit": 1, "join": 0, "miss": 1}
    assert page["barycastd_cage_cache_entries"] == 1
    assert page["barycastd_cage_cache_bytes"] > 0
    assert page["barycastd_cage_cache_evictions_total"] == 0
    assert page["barycastd_admitted_requests"] == page["barycastd_admitted_bytes"] == 0
    assert page["barycastd_overload_refusals_total"] == 0
    assert page["barycastd_queue_wait_seconds_count"] >= 4
    assert page["barycastd_requests_active"] == 0
    [build] = [name for name in page if name.startswith("barycastd_build_info")]
    assert 'version="' in build and 'numerics_version="' in build


def test_what_computations_build_is_counted(real_daemon, tmp_path):
    """Of a cage that was uploaded, and then used for one kind of coordinates after the other."""
    held = []
    with Daemon(real_daemon, tmp_path) as daemon, Client(daemon.address) as client:
        client.upload(box_cage())
        held.append(daemon.settled_metrics()["barycastd_cage_cache_bytes"])
        for kind in ("mean-value", "harmonic", "harmonic"):
            client.bind(box_cage(), [[0.5, 0.5, 0.5]], coordinates=kind, samples=5)
            held.append(daemon.settled_metrics()["barycastd_cage_cache_bytes"])
    assert 0 < held[0] < held[1] < held[2] - 100_000 and held[3] == held[2]


def test_factors_of_denoising_are_counted(real_daemon, tmp_path):
    model_file = tmp_path / "model.obj"
    model_file.write_text(grid_text(10))
    model = load_model(model_file)
    with Daemon(real_daemon, tmp_path) as daemon:
        with Client(daemon.address) as client:
            rows = [client.bind(box_cage(), model.points, model.faces, samples=5).matrix.data.tobytes() for _ in range(2)]
        page = daemon.settled_metrics()
    assert rows[0] == rows[1]
    assert page['barycastd_smoothing_cache_lookups_total{result="miss"}'] == 1
    assert page['barycastd_smoothing_cache_lookups_total{result="hit"}'] == 1
    assert page["barycastd_smoothing_cache_entries"] == 1 and page["barycastd_smoothing_cache_bytes"] > 0
    assert page["barycastd_smoothing_cache_evictions_total"] == 0


def test_overload_is_counted(real_daemon, tmp_path):
    with Daemon(real_daemon, tmp_path, "--requests-max", "1") as daemon:
        release = threading.Event()

        def header_and_silence():
            yield barycast_pb2.ComputeCoordinatesRequest(header=barycast_pb2.ComputeHeader(
                inline_cage=tetrahedron(), queries=barycast_pb2.QuerySet(point_count=1)))
            release.wait(30)

        holder = daemon.stub.ComputeCoordinates(header_and_silence(), timeout=60)
        while daemon.metrics()["barycastd_admitted_requests"] == 0:
            time.sleep(0.02)
        assert daemon.metrics()["barycastd_admitted_bytes"] > 0
        assert refused(lambda: daemon.compute(1)) == grpc.StatusCode.RESOURCE_EXHAUSTED
        assert daemon.metrics()["barycastd_overload_refusals_total"] == 1
        holder.cancel()
        release.set()


def test_metrics_errors(real_daemon):
    result = run(real_daemon, "--listen", "127.0.0.1:0", "--metrics-listen", "no.such.host.invalid:1")
    assert result.returncode == 1
    assert "metrics-listen" in result.stderr


def test_reflection_describes_all_services(real_daemon, tmp_path):
    """In bytes, for its generated module is not packaged: field 7 lists services, field 4 asks for a symbol's file."""
    with Daemon(real_daemon, tmp_path) as daemon:
        ask = daemon.channel.stream_stream("/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo")
        [services] = ask(iter([b"\x3a\x01*"]), timeout=20)
        for name in (b"barycast.v1.BarycastService", b"grpc.health.v1.Health",
                     b"grpc.reflection.v1alpha.ServerReflection"):
            assert name in services
        symbol = b"barycast.v1.BarycastService"
        [file] = ask(iter([b"\x22" + bytes([len(symbol)]) + symbol]), timeout=20)
        assert b"barycast/v1/barycast.proto" in file and b"EstimateCost" in file


def test_health_check_and_watch(real_daemon, tmp_path):
    """In bytes too: status SERVING is 08 01, NOT_SERVING 08 02."""
    service = b"\x0a\x1bbarycast.v1.BarycastService"
    with Daemon(real_daemon, tmp_path) as daemon:
        check = daemon.channel.unary_unary("/grpc.health.v1.Health/Check")
        assert check(b"", timeout=20) == check(service, timeout=20) == b"\x08\x01"
        watch = daemon.channel.unary_stream("/grpc.health.v1.Health/Watch")(service, timeout=40)
        assert next(watch) == b"\x08\x01"
        daemon.process.terminate()
        assert next(watch) == b"\x08\x02"


def test_probe(real_daemon, tmp_path):
    with Daemon(real_daemon, tmp_path) as daemon:
        done = run(real_daemon, "--probe", daemon.port_file.read_text().strip())
        assert (done.returncode, done.stdout, done.stderr) == (0, "SERVING\n", "")


def test_probe_of_the_server_with_these_settings(real_daemon, tmp_path):
    proxies = {"http_proxy": "http://127.0.0.1:1", "grpc_proxy": "http://127.0.0.1:1"}
    with Daemon(real_daemon, tmp_path) as daemon:
        everywhere = "0.0.0.0:" + daemon.port_file.read_text().strip().rsplit(":", 1)[1]
        assert run(real_daemon, "--probe", BARYCASTD_LISTEN=everywhere, **proxies).returncode == 0
        assert run(real_daemon, "--probe", "--listen", everywhere).returncode == 0
        assert run(real_daemon, "--probe", "--listen", "127.0.0.1:1").returncode == 1


@pytest.mark.parametrize("where", ["127.0.0.1:1", "unix:/nowhere/socket"])
def test_probe_where_nobody_listens(real_daemon, where):
    done = run(real_daemon, "--probe", where)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == f"barycastd: no server answers at {where}\n"


@pytest.mark.parametrize("pause, metadata, least, most", [
    (0.5, [], 0, 0.4),  # at once, whatever comes
    (0.5, [("x-forwarded-for", "192.0.2.1")], 0.5, 0.9),  # when all was sent
    (5.0, [("x-forwarded-for", "192.0.2.1")], 0.9, 3.0),  # or after a second
])
def test_a_refusal_behind_a_proxy_waits_for_the_client(real_daemon, tmp_path, pause, metadata, least, most):
    def requests():
        yield barycast_pb2.ComputeCoordinatesRequest(header=barycast_pb2.ComputeHeader(
            cage_digest=box_cage().digest, queries=barycast_pb2.QuerySet(point_count=3)))
        ended.wait(pause)

    ended = threading.Event()
    with Daemon(real_daemon, tmp_path) as daemon:
        daemon.compute(3)  # connected
        begin = time.monotonic()
        call = daemon.stub.ComputeCoordinates(requests(), timeout=20, metadata=metadata)
        assert refused(lambda: next(call)) == grpc.StatusCode.FAILED_PRECONDITION
        assert least <= time.monotonic() - begin < most
        ended.set()
