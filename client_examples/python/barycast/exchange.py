"""One streamed computation without its transport: what to send, what an answer means, what to do after a failure."""

from __future__ import annotations

from typing import Any, Callable, List, Optional

import numpy as np

from barycast.v1 import barycast_pb2, cage_pb2, options_pb2

from . import arrays, flows
from .cage import Cage, Faces
from .errors import BarycastError, InputError, MissingCageError, ServerError
from .options import STAGES, name_of
from .requests import CageNaming, compute_requests, digest_metadata, query_set
from .retry import Retry
from .rows import RowCollector, Rows, rows_from_message

ProgressCallback = Callable[[str, int, int], None]

_RESTARTS_MAX = 3  # builds change during a roll-out, not for ever


class Exchange:
    """A computation's state. Drive it so: `begin`; then per attempt run `open`, give every answer to `receive`, call
    `finish`; after a BarycastError run `failed`, which throws it when no other attempt makes sense.

    header: of the first answer, from the first rows on. summary: of the last answer, at the end. resumed_rows: where
    later attempts went on. build_version: of the server. rows_kept: somebody holds rows already handed out, so that
    the computation cannot start over.
    """

    def __init__(self, memory: flows.Memory, cage: Cage, points: Any, faces: Any,
                 options: options_pb2.ComputeOptions, output: options_pb2.OutputOptions,
                 progress: Optional[ProgressCallback], make_retry: Callable[[], Retry], rows_kept: bool = True) -> None:
        self.cage = cage
        self._points = arrays.positions(points, "points", keep_float32=True)
        self._faces = Faces.of(faces)
        self._options = options
        self._output = output
        self._progress = progress
        self._memory = memory
        self._make_retry = make_retry
        self._rows_kept = rows_kept
        self.build_version = ""
        if not isinstance(cage, Cage):
            raise InputError(f"must be a Cage, not {type(cage).__name__}; make one with load_cage", field="cage")
        if self._points.shape[1] != cage.dimension:
            raise InputError(f"have {self._points.shape[1]} coordinates, the cage has {cage.dimension}", field="points")
        if len(self._points) == 0:
            raise InputError("there must be at least one point", field="points")
        arrays.indices(self._faces.corners, "faces.corners", count=len(self._points))
        self.begin()

    def __len__(self) -> int:
        return len(self._points)

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of values and gradients."""
        return np.dtype("f8" if self._output.type == cage_pb2.DATA_TYPE_FLOAT64 else "f4")

    def collector(self) -> RowCollector:
        """Takes this computation's rows."""
        return RowCollector(len(self), len(self.cage.control_vertices), self.cage.dimension, self.dtype,
                            self._output.gradients, self._output.errors)

    def begin(self) -> None:
        """Back to before the first attempt."""
        self._retry = self._make_retry()
        self._naming = CageNaming(self.cage)
        self._restarts = 0
        self._start_over()

    def _start_over(self) -> None:
        self.header: Optional[barycast_pb2.ResponseHeader] = None
        self.summary: Optional[barycast_pb2.Summary] = None
        self.resumed_rows: List[int] = []
        self._next_row = 0

    def open(self) -> flows.Flow[Any]:
        """Begins an attempt; returns the call whose answers are to be received."""
        if self._naming.uploads:
            yield from flows.upload(self.cage, self._retry)
        capabilities = yield from flows.capabilities(self._memory, self._retry)
        self.build_version = capabilities.build_version
        requests = compute_requests(self._header(), self._points, self._faces, capabilities.limits.message_bytes_max)
        return (yield flows.Call("ComputeCoordinates", requests, self._retry.timeout(), digest_metadata(self.cage)))

    def _header(self) -> barycast_pb2.ComputeHeader:
        header = barycast_pb2.ComputeHeader(options=self._options, output=self._output,
                                            queries=query_set(len(self), self._faces))
        self._naming.name(header)
        if self.header is not None and self._next_row > 0:
            # Only the summary may be missing: the server wants a row to go on from, and `receive` drops it.
            first_row = min(self._next_row, len(self) - 1)
            header.resume.first_row = first_row
            header.resume.numerics_version = self.header.numerics_version
            header.resume.smoothing_time = self.header.options.smoothing_time
        return header

    def receive(self, response: barycast_pb2.ComputeCoordinatesResponse) -> Optional[Rows]:
        """What an answer brings: rows to hand on, or None. Throws ServerError when it makes no sense."""
        kind = response.WhichOneof("message")
        if kind == "header":
            self._naming.found()
            self._accept(response.header)
        elif kind == "progress" and self._progress:
            progress = response.progress
            self._progress(name_of(STAGES, progress.stage), progress.done, progress.total)
        elif kind == "rows":
            rows = rows_from_message(response.rows, self.dtype, self.cage.dimension, self._output.gradients,
                                     self._output.errors)
            if self._next_row == len(self) == rows.first_row + len(rows.flags):
                return None
            if rows.first_row != self._next_row:
                raise ServerError(f"sent row {rows.first_row} where row {self._next_row} was due", code="DATA_LOSS",
                                  field="rows")
            self._next_row += len(rows.flags)
            self._retry.progressed()
            return rows
        elif kind == "summary":
            self.summary = response.summary
        return None

    def _accept(self, header: barycast_pb2.ResponseHeader) -> None:
        if self._options.HasField("target_error") and not header.options.HasField("target_error"):
            raise ServerError("knows no target error; ask for samples", code="DATA_LOSS",
                              field="header.options.target_error")
        if self._options.tables and not header.options.tables:
            raise ServerError("knows no tables; leave them out", code="DATA_LOSS", field="header.options.tables")
        if self.header is None or self._next_row == 0:
            self.header = header
            return
        self.resumed_rows.append(self._next_row)
        if header.numerics_version != self.header.numerics_version:
            raise ServerError("went on with another numerics_version although it was told the first one",
                              code="DATA_LOSS", field="header.numerics_version")

    def finish(self) -> None:
        """The answers ended. Throws ServerError when something is missing."""
        if self.header is None or self.summary is None or self._next_row != len(self):
            raise ServerError(f"the answer ended after {self._next_row} of {len(self)} rows", code="DATA_LOSS")

    def failed(self, error: BarycastError) -> flows.Flow[None]:
        """Prepares the next attempt, or throws."""
        if isinstance(error, MissingCageError):
            self._naming.missing(error)
        elif error.code == "FAILED_PRECONDITION" and self._next_row > 0:
            if self._rows_kept or self._restarts == _RESTARTS_MAX:
                raise ServerError(f"the connection broke after {self._next_row} of {len(self)} rows, and the server "
                                  "that answers now computes other bits: start over", code=error.code,
                                  field=error.field) from error
            self._restarts += 1
            self._start_over()
        elif isinstance(error, ServerError):
            yield flows.Pause(self._retry.wait_after(error))
        else:
            raise error
