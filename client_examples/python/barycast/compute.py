"""One streamed computation: points and faces out in blocks, rows back in order."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Any, Callable, Iterator, Optional

import numpy as np

from barycast.v1 import barycast_pb2, cage_pb2, options_pb2

from . import arrays
from .cage import Cage, Faces
from .connection import Backoff, Connection, digest_metadata
from .errors import InputError, MissingCageError, ServerError, translated
from .options import STAGES, name_of

ProgressCallback = Callable[[str, int, int], None]

_BLOCK_ITEMS = 65536  # points or faces of one message: 1.5 MiB of float64 points
_MESSAGE_BYTES_SPARE = 4096  # for the fields around an array


@dataclass(frozen=True)
class Rows:
    """Consecutive rows. Row first_row + i has the entries offsets[i] ... offsets[i + 1] - 1.

    offsets: (k + 1) uint32. indices: nnz uint32, control vertices in ascending order. values: nnz. gradients: nnz x d
    per unit of the caller's length, or None. flags: k uint8, bits of RowFlag. All read-only.
    """

    first_row: int
    offsets: np.ndarray
    indices: np.ndarray
    values: np.ndarray
    gradients: Optional[np.ndarray]
    flags: np.ndarray


class _CageBy(enum.Enum):
    DIGEST = 1
    UPLOAD_THEN_DIGEST = 2
    INLINE = 3


class Computation:
    """Iterate it once to receive the rows (`Rows`), in order and without gaps.

    header is there from the first block on, summary after the last one. The cage is named by its digest; a server
    that does not hold it gets an upload, and if it (or another replica) then still does not, the cage itself in the
    request. A lost connection is retried as long as no row arrived. Iterating throws InputError and ServerError;
    leaving the loop cancels the computation.
    """

    def __init__(self, connection: Connection, cage: Cage, points: Any, faces: Any, options: options_pb2.ComputeOptions,
                 output: options_pb2.OutputOptions, progress: Optional[ProgressCallback] = None) -> None:
        self._connection = connection
        self._cage = cage
        self._points = arrays.positions(points, "points", keep_float32=True)
        self._faces = Faces.of(faces)
        self._options = options
        self._output = output
        self._progress = progress
        self.header: Optional[barycast_pb2.ResponseHeader] = None
        self.summary: Optional[barycast_pb2.Summary] = None
        if self._points.shape[1] != cage.dimension:
            raise InputError(f"have {self._points.shape[1]} coordinates, the cage has {cage.dimension}", field="points")
        if len(self._points) == 0:
            raise InputError("there must be at least one point", field="points")
        arrays.indices(self._faces.corners, "faces.corners", count=len(self._points))

    def __len__(self) -> int:
        return len(self._points)

    def __iter__(self) -> Iterator[Rows]:
        by = _CageBy.DIGEST
        backoff = Backoff()
        received = False
        while True:
            try:
                if by is _CageBy.UPLOAD_THEN_DIGEST:
                    self._connection.upload(self._cage)
                for rows in self._receive(by):
                    received = True
                    yield rows
                return
            except MissingCageError:
                if by is _CageBy.INLINE:
                    raise
                by = _CageBy(by.value + 1)
            except ServerError as error:
                if received or not backoff.wait(error):
                    raise
                self._connection.reconnect()

    def _receive(self, by: _CageBy) -> Iterator[Rows]:
        message_bytes_max = self._connection.capabilities().limits.message_bytes_max
        expected_row = 0
        with translated():
            call = self._connection.stub.ComputeCoordinates(
                self._requests(by, message_bytes_max), timeout=self._connection.timeout_seconds,
                metadata=digest_metadata(self._cage))
            try:
                for response in call:
                    kind = response.WhichOneof("message")
                    if kind == "header":
                        self.header = response.header
                    elif kind == "progress" and self._progress:
                        progress = response.progress
                        self._progress(name_of(STAGES, progress.stage), progress.done, progress.total)
                    elif kind == "rows":
                        rows = self._rows(response.rows)
                        if rows.first_row != expected_row:
                            raise ServerError(f"sent row {rows.first_row} where row {expected_row} was due",
                                              code="DATA_LOSS", field="rows")
                        expected_row += len(rows.flags)
                        yield rows
                    elif kind == "summary":
                        self.summary = response.summary
            finally:
                call.cancel()
        if self.header is None or self.summary is None or expected_row != len(self):
            raise ServerError(f"the answer ended after {expected_row} of {len(self)} rows", code="DATA_LOSS")

    def _rows(self, block: barycast_pb2.RowBlock) -> Rows:
        dtype = np.dtype("f8" if self._output.type == cage_pb2.DATA_TYPE_FLOAT64 else "f4")
        offsets = arrays.from_message(block.offsets, np.dtype("u4"), "rows.offsets")
        indices = arrays.from_message(block.indices, np.dtype("u4"), "rows.indices")
        values = arrays.from_message(block.values, dtype, "rows.values")
        gradients = arrays.from_message(block.gradients, dtype, "rows.gradients") if self._output.gradients else None
        flags = np.frombuffer(block.flags, np.uint8)
        if (len(offsets) != len(flags) + 1 or offsets[-1] != len(indices) or len(values) != len(indices)
                or (gradients is not None and gradients.shape != (len(indices), self._cage.dimension))):
            raise ServerError("the arrays of a block of rows do not fit together", code="DATA_LOSS", field="rows")
        return Rows(block.first_row, offsets, indices, values, gradients, flags)

    def _requests(self, by: _CageBy, message_bytes_max: int) -> Iterator[barycast_pb2.ComputeCoordinatesRequest]:
        """The header, then points and faces in blocks that the server accepts."""
        faces, points = self._faces, self._points
        header = barycast_pb2.ComputeHeader(
            expected_digest=self._cage.digest, options=self._options, output=self._output,
            queries=barycast_pb2.QuerySet(point_count=len(points), face_count=len(faces),
                                          corner_count=len(faces.corners)))
        if by is _CageBy.INLINE:
            header.inline_cage.CopyFrom(self._cage.to_message())
        else:
            header.cage_digest.CopyFrom(self._cage.digest)
            header.ClearField("expected_digest")
        yield barycast_pb2.ComputeCoordinatesRequest(header=header)

        room = max(1, message_bytes_max - _MESSAGE_BYTES_SPARE)
        step = max(1, min(_BLOCK_ITEMS, room // (points.shape[1] * points.itemsize)))
        for begin in range(0, len(points), step):
            block = barycast_pb2.PointBlock(points=arrays.to_message(points[begin:begin + step]))
            yield barycast_pb2.ComputeCoordinatesRequest(points=block)

        begin = 0
        words = faces.offsets + np.arange(len(faces) + 1)  # uint32 up to each face: its corners and its count
        while begin < len(faces):
            fits = int(np.searchsorted(words, words[begin] + room // 4, side="right")) - 1
            end = max(begin + 1, min(fits, begin + _BLOCK_ITEMS))
            corners = faces.corners[faces.offsets[begin]:faces.offsets[end]]
            block = barycast_pb2.FaceBlock(
                corner_counts=arrays.to_message(faces.counts[begin:end].astype(np.uint32)),
                corners=arrays.to_message(corners))
            yield barycast_pb2.ComputeCoordinatesRequest(faces=block)
            begin = end
