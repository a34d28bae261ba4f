"""A small server of the API, so that the client is tested without the daemon, and against misbehaviour.

Its rows are the minimum-norm affine ones: they sum to one and reproduce the points, which is all that the client
relies on. `Behaviour` makes it lose cages, be away, be slow or refuse. As a program it takes the daemon's flags.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import sys
import tempfile
import threading
import time
from concurrent import futures
from dataclasses import dataclass, field
from typing import Dict, List, Optional

import grpc
import numpy as np

from barycast import arrays, rpc_details
from barycast.v1 import barycast_pb2 as pb
from barycast.v1 import barycast_pb2_grpc, cage_pb2, options_pb2

BLOCK_ROWS = 1000


@dataclass
class Behaviour:
    """uploads_ignored: answers MISSING although it was uploaded. unavailable, busy: so many computations are refused.
    knows_tables: false answers without them. row_seconds: delay per block of rows. message_bytes_max: as announced, and checked. break_after_blocks: fails with
    UNKNOWN there. unavailable_after_blocks: the next computations end with UNAVAILABLE after so many blocks, and the
    next of numerics_versions then counts. resumes: where clients went on."""

    uploads_ignored: bool = False
    knows_tables: bool = True
    unavailable: int = 0
    busy: int = 0
    row_seconds: float = 0.0
    message_bytes_max: int = 4 << 20
    break_after_blocks: Optional[int] = None
    unavailable_after_blocks: List[int] = field(default_factory=list)
    numerics_versions: List[int] = field(default_factory=lambda: [1])
    estimates: bool = True
    resumes: List[int] = field(default_factory=list)
    log: List[str] = field(default_factory=list)
    request_bytes: List[int] = field(default_factory=list)


def status_bytes(code: int, message: str, *details: object) -> bytes:
    """A serialized google.rpc.Status."""
    status = rpc_details.MESSAGES["Status"](code=code, message=message)
    for detail in details:
        status.details.add(type_url=f"type.googleapis.com/{detail.DESCRIPTOR.full_name}",
                           value=detail.SerializeToString())
    return status.SerializeToString()


def abort(context: grpc.ServicerContext, code: grpc.StatusCode, message: str, *details: object) -> None:
    context.set_trailing_metadata((("grpc-status-details-bin", status_bytes(code.value[0], message, *details)),))
    context.abort(code, message)


def bad_request(name: str, description: str) -> object:
    detail = rpc_details.MESSAGES["BadRequest"]()
    detail.field_violations.add(field=name, description=description)
    return detail


def server_digest(cage: cage_pb2.Cage) -> bytes:
    """SHA-256 of the canonical bytes, from the message, written apart from the client's."""
    names = ("points", "segments", "triangles", "quads")
    polygons = max(0, cage.polygons.offsets.rows - 1) if cage.polygons.offsets.rows else 0
    head = [cage.control_vertices.columns, cage.control_vertices.rows] + [getattr(cage, n).rows for n in names]
    head += [polygons, cage.polygons.corners.rows]
    data = b"BCCAGE01" + b"".join(number.to_bytes(4, "little") for number in head)
    data += (np.frombuffer(cage.control_vertices.data, "<f8") + 0.0).tobytes()
    data += b"".join(getattr(cage, n).data for n in names)
    return hashlib.sha256(data + cage.polygons.offsets.data + cage.polygons.corners.data).digest()


class FakeService(barycast_pb2_grpc.BarycastServiceServicer):
    def __init__(self, behaviour: Behaviour) -> None:
        self.behaviour = behaviour
        self.cages: Dict[bytes, cage_pb2.Cage] = {}

    def GetCapabilities(self, request, context):
        self.behaviour.log.append("capabilities")
        limits = pb.Limits(points_max=10**6, samples_max=10**5, message_bytes_max=self.behaviour.message_bytes_max)
        return pb.GetCapabilitiesResponse(coordinates=[options_pb2.COORDINATE_KIND_HARMONIC], limits=limits,
                                          build_version="0.0.0", numerics_version=1)

    def UploadCage(self, request_iterator, context):
        self.behaviour.log.append("upload")
        expected, data = None, b""
        for request in request_iterator:
            expected = expected or request.expected_digest.sha256
            data += request.piece
        cage = cage_pb2.Cage.FromString(data)
        digest = server_digest(cage)
        if expected and digest != expected:
            abort(context, grpc.StatusCode.INVALID_ARGUMENT, "digest mismatch",
                  bad_request("expected_digest", "mismatch"))
        if not self.behaviour.uploads_ignored:
            self.cages[digest] = cage
        return pb.UploadCageResponse(digest=cage_pb2.CageDigest(sha256=digest))

    def _cage(self, header: pb.ComputeHeader, context) -> cage_pb2.Cage:
        metadata = dict(context.invocation_metadata())
        if header.WhichOneof("cage") == "inline_cage":
            self.behaviour.log.append("inline")
            digest = server_digest(header.inline_cage)
            assert metadata["x-cage-digest"] == digest.hex()
            assert not hasattr(header, "expected_digest") or header.expected_digest.sha256 == digest
            return header.inline_cage
        self.behaviour.log.append("digest")
        assert metadata["x-cage-digest"] == header.cage_digest.sha256.hex()
        if header.cage_digest.sha256 not in self.cages:
            failure = rpc_details.MESSAGES["PreconditionFailure"]()
            failure.violations.add(type="MISSING", subject=header.cage_digest.sha256.hex())
            abort(context, grpc.StatusCode.FAILED_PRECONDITION, "the cage is not held", failure)
        return self.cages[header.cage_digest.sha256]

    def ComputeCoordinates(self, request_iterator, context):
        first = next(request_iterator)
        if self.behaviour.unavailable > 0:
            self.behaviour.unavailable -= 1
            context.abort(grpc.StatusCode.UNAVAILABLE, "draining")
        if self.behaviour.busy > 0:
            self.behaviour.busy -= 1
            retry = rpc_details.MESSAGES["RetryInfo"]()
            retry.retry_delay.nanos = 1_000_000
            abort(context, grpc.StatusCode.RESOURCE_EXHAUSTED, "too busy", retry)
        header = first.header
        cage = self._cage(header, context)
        if header.options.coordinates != options_pb2.COORDINATE_KIND_HARMONIC:
            abort(context, grpc.StatusCode.UNIMPLEMENTED, "header.options.coordinates: is not built yet",
                  bad_request("header.options.coordinates", "is not built yet; this server computes harmonic"))
        if header.options.samples > 10**5:
            abort(context, grpc.StatusCode.INVALID_ARGUMENT, "options.samples: 200000 > 100000",
                  bad_request("options.samples", "200000 > 100000"))
        if header.HasField("resume"):
            if header.resume.numerics_version != self.behaviour.numerics_versions[0]:
                abort(context, grpc.StatusCode.FAILED_PRECONDITION, "another numerics_version",
                      bad_request("header.resume.numerics_version", "1, but this server's is 2"))
            self.behaviour.resumes.append(header.resume.first_row)
        points, counts, corners = [], [], []
        for request in request_iterator:
            self.behaviour.request_bytes.append(request.ByteSize())
            if request.WhichOneof("message") == "points":
                dtype = np.dtype("f4" if request.points.points.type == cage_pb2.DATA_TYPE_FLOAT32 else "f8")
                points.append(arrays.from_message(request.points.points, dtype, "points"))
            else:
                counts.append(arrays.from_message(request.faces.corner_counts, np.dtype("u4"), "counts"))
                corners.append(arrays.from_message(request.faces.corners, np.dtype("u4"), "corners"))
                assert counts[-1].sum() == len(corners[-1])
        points = np.concatenate(points).astype(np.float64)
        queries = header.queries
        assert (len(points), sum(map(len, counts)), sum(map(len, corners))) == (
            queries.point_count, queries.face_count, queries.corner_count)
        yield from self._answer(header, cage, points, context)

    def EstimateCost(self, request, context):
        self.behaviour.log.append("estimate")
        if not self.behaviour.estimates:
            context.abort(grpc.StatusCode.UNIMPLEMENTED, "")
        self._cage(request, context)
        samples = (request.options.samples or 12) * request.queries.point_count
        return pb.EstimateCostResponse(memory_bytes=5_000_000, samples=samples,
                                       output_bytes=100 * request.queries.point_count)

    def _answer(self, header, cage, points, context):
        vertices = arrays.from_message(cage.control_vertices, np.dtype("f8"), "control_vertices")
        dtype = np.float64 if header.output.type == cage_pb2.DATA_TYPE_FLOAT64 else np.float32
        options = options_pb2.ComputeOptions()
        options.CopyFrom(header.options)
        # As the service does for such cages.
        options.estimator = options.estimator or options_pb2.ESTIMATOR_PREDICTED
        options.samples = options.samples or 12
        options.thickness = options.thickness or 1e-3
        options.tables = options.tables and self.behaviour.knows_tables
        yield pb.ComputeCoordinatesResponse(header=pb.ResponseHeader(
            options=options, output=header.output, numerics_version=self.behaviour.numerics_versions[0],
            control_vertex_count=len(vertices)))
        yield pb.ComputeCoordinatesResponse(progress=pb.Progress(stage=pb.STAGE_SAMPLING, done=1, total=2))
        solve = np.linalg.pinv(np.c_[vertices, np.ones(len(vertices))])  # (d + 1) x v
        cut = self.behaviour.unavailable_after_blocks.pop(0) if self.behaviour.unavailable_after_blocks else None
        blocks = range(header.resume.first_row, len(points), BLOCK_ROWS)
        for block, begin in enumerate([*blocks, None]):
            if block == cut:
                if len(self.behaviour.numerics_versions) > 1:
                    self.behaviour.numerics_versions.pop(0)
                context.abort(grpc.StatusCode.UNAVAILABLE, "the connection broke")
            if begin is None:
                break
            if block == self.behaviour.break_after_blocks:
                raise SystemError("broken on purpose")
            time.sleep(self.behaviour.row_seconds)
            some = points[begin:begin + BLOCK_ROWS]
            values = (np.c_[some, np.ones(len(some))] @ solve.T.reshape(len(vertices), -1).T).astype(dtype)
            rows = pb.RowBlock(
                first_row=begin, offsets=arrays.to_message(np.arange(len(some) + 1, dtype=np.uint32) * len(vertices)),
                indices=arrays.to_message(np.tile(np.arange(len(vertices), dtype=np.uint32), len(some))),
                values=arrays.to_message(values.ravel()), flags=bytes(len(some)))
            if header.output.gradients:
                rows.gradients.CopyFrom(arrays.to_message(np.tile(solve[:-1].T.astype(dtype), (len(some), 1))))
            yield pb.ComputeCoordinatesResponse(rows=rows)
        yield pb.ComputeCoordinatesResponse(summary=pb.Summary(
            row_count=len(points), entry_count=len(points) * len(vertices), samples=options.samples * len(points),
            walk_steps=7 * options.samples * len(points), linear_precision_error_max=1e-15,
            times=[pb.StageTime(stage="sampling", seconds=0.25)],
            warnings=[pb.Warning(field="cage.control_vertices[1]", message="is not used")]))


def start(address: str, behaviour: Optional[Behaviour] = None) -> grpc.Server:
    server = grpc.server(futures.ThreadPoolExecutor(max_workers=8))
    server.service = FakeService(behaviour or Behaviour())
    barycast_pb2_grpc.add_BarycastServiceServicer_to_server(server.service, server)
    server.port = server.add_insecure_port(address)
    server.start()
    return server


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--listen", required=True)
    parser.add_argument("--port-file", required=True)
    parser.add_argument("--exit-on-stdin-close", action="store_true")
    parser.add_argument("--log-level")
    parser.add_argument("--threads", type=int)
    arguments = parser.parse_args()
    behaviour = Behaviour(row_seconds=float(os.environ.get("FAKE_ROW_SECONDS", "0")))
    server = start(arguments.listen, behaviour)
    with tempfile.NamedTemporaryFile("w", dir=os.path.dirname(arguments.port_file), delete=False) as file:
        file.write(arguments.listen + "\n")
    os.replace(file.name, arguments.port_file)
    if arguments.exit_on_stdin_close:
        sys.stdin.read()
    else:
        threading.Event().wait()
    server.stop(None)


if __name__ == "__main__":
    main()
