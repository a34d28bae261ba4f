"""The client: the verbs of the API with numpy in and out."""

from __future__ import annotations

import time
from typing import Any, Optional

from barycast.v1 import barycast_pb2, options_pb2

from . import flows
from .binding import Binding, gathered
from .cage import Cage
from .compute import Computation
from .connection import Connection
from .exchange import ProgressCallback
from .options import compute_options, estimate_request, output_options
from .retry import RETRY_SECONDS, Retry


class Client:
    """A client of one server; a context manager.

    address: "host:port", "unix:/path", or what else `check_address` takes, or InputError is thrown; None starts a
    private local server that ends with this object. threads: of the private server. timeout_seconds: of one call, over
    all its attempts; None waits for ever.
    retry_seconds: how much time lost connections and busy answers may cost one call; 0 never tries again.
    Use one Client per thread. A Client survives a fork, as long as no call of the process that forks is going on: the
    forked process connects anew, and uses the private server without ending it.
    """

    def __init__(self, address: Optional[str] = None, *, threads: Optional[int] = None,
                 timeout_seconds: Optional[float] = None, retry_seconds: float = RETRY_SECONDS) -> None:
        self._timeout_seconds = timeout_seconds
        self._retry_seconds = retry_seconds
        self.connection = Connection(address, threads)

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes the connection and ends the private server. May be called again."""
        self.connection.close()

    def _retry(self) -> Retry:
        return Retry(self._retry_seconds, self._timeout_seconds)

    def capabilities(self) -> barycast_pb2.GetCapabilitiesResponse:
        """What the server can do. Throws ServerError."""
        retry = self._retry()
        return self.connection.run(flows.retried(retry, lambda: flows.capabilities(self.connection.memory, retry)))

    def upload(self, cage: Cage, fill_tables: bool = False) -> barycast_pb2.UploadCageResponse:
        """Gives the server the cage to hold, and returns its digest, warnings and number of tables. fill_tables: also
        fill them, seconds for some cages, so that `bind` with tables finds them there. Throws InputError when the cage
        is invalid or too large, or has no tables, ServerError. `compute` and `bind` upload by themselves when they
        must."""
        retry = self._retry()
        return self.connection.run(flows.retried(retry, lambda: flows.upload(cage, retry, fill_tables)))

    def estimate(self, cage: Cage, point_count: int, faces: Any = None,
                 options: Optional[options_pb2.ComputeOptions] = None,
                 output: Optional[options_pb2.OutputOptions] = None) -> barycast_pb2.EstimateCostResponse:
        """What `compute` of that many points would cost: working memory, samples, bytes of the rows. Throws InputError
        when it would be refused or the server cannot tell, ServerError."""
        request = estimate_request(point_count, faces, options or compute_options(), output or output_options())
        retry = self._retry()
        return self.connection.run(flows.retried(retry, lambda: flows.estimate(cage, request, retry)))

    def compute(self, cage: Cage, points: Any, faces: Any = None,
                options: Optional[options_pb2.ComputeOptions] = None,
                output: Optional[options_pb2.OutputOptions] = None,
                progress: Optional[ProgressCallback] = None) -> Computation:
        """Coordinates of points (n x d, in the cage's units and frame) as blocks of rows, in order: iterate the
        result. faces: the mesh over the points that denoising runs over, anything `Faces.of` takes, or None.
        progress: called with (stage, done, total). Throws InputError here or while iterating, ServerError while
        iterating: with code FAILED_PRECONDITION when the connection broke and another build went on, whose rows must
        not be mixed with those handed out."""
        return Computation(self.connection, cage, points, faces, options or compute_options(),
                           output or output_options(), progress, self._retry)

    def bind(self, cage: Cage, points: Any, faces: Any = None, coordinates: str = "harmonic",
             samples: Optional[int] = None, seed: int = 0, preset: str = "default", denoise: str = "auto",
             gradients: bool = False, dtype: Any = "float32", progress: Optional[ProgressCallback] = None,
             thickness: Optional[float] = None, walk_steps_max: Optional[int] = None,
             prune_below: Optional[float] = None, smoothing_time: Optional[float] = None,
             influences_max: int = 0, estimator: str = "auto", panels: Optional[int] = None,
             target_error: Optional[float] = None, errors: bool = False, tables: bool = False) -> Binding:
        """All rows of `compute` as one sparse matrix. None follows the preset. influences_max: coordinates kept per
        row, d + 1 or more; 0: all. estimator: "auto" (the best that kind, preset and cage
        allow), "sampling", "predicted" (harmonic: walks correct a prediction, surface cages in space that are not too large), or without samples "boundary-element" (harmonic, at most
        `panels` of them) or "exact" (mean value, closed cages of triangles and polygons). target_error: of predicted
        coordinates, instead of samples: as many walks a point as bring the standard error of its row down to it, at
        most 6144, and nothing denoised; errors: the binding then holds those errors. tables: of predicted coordinates,
        corrections inside a closed cage from tables that the server keeps with the cage, for points that follow one
        another over time; nothing is denoised. Throws InputError, ServerError."""
        options = compute_options(coordinates, preset, samples, seed, denoise, thickness, walk_steps_max, prune_below,
                                  smoothing_time, estimator, panels, target_error, tables)
        output = output_options(dtype, gradients, influences_max, errors)
        return self.bind_with(cage, points, faces, options, output, progress)

    def bind_with(self, cage: Cage, points: Any, faces: Any, options: options_pb2.ComputeOptions,
                  output: options_pb2.OutputOptions, progress: Optional[ProgressCallback] = None) -> Binding:
        """As `bind`, with the messages of the API that `compute` takes."""
        started = time.monotonic()
        computation = Computation(self.connection, cage, points, faces, options, output, progress, self._retry,
                                  rows_kept=False)
        collector = computation.collector()
        for rows in computation:
            collector.add(rows)
        return gathered(collector, computation, started)
