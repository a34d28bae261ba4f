"""The client for asyncio: the verbs of `Client`, awaited."""

from __future__ import annotations

import time
from typing import Any, Optional

from barycast.v1 import barycast_pb2, options_pb2

from . import flows
from .async_connection import AsyncComputation, AsyncConnection
from .binding import Binding, gathered
from .cage import Cage
from .exchange import ProgressCallback
from .options import compute_options, estimate_request, output_options
from .retry import RETRY_SECONDS, Retry


class AsyncClient:
    """A client of one server for asyncio; an asynchronous context manager. Parameters and results are those of
    `Client`. Any number of calls may go on at once. It connects, and starts a private server, when it is first used;
    use it in one event loop. Processes that are forked after it was used cannot use gRPC (spawn them instead).
    """

    def __init__(self, address: Optional[str] = None, *, threads: Optional[int] = None,
                 timeout_seconds: Optional[float] = None, retry_seconds: float = RETRY_SECONDS) -> None:
        self._timeout_seconds = timeout_seconds
        self._retry_seconds = retry_seconds
        self.connection = AsyncConnection(address, threads)

    async def __aenter__(self) -> AsyncClient:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Closes the connection and ends the private server. May be called again."""
        await self.connection.close()

    def _retry(self) -> Retry:
        return Retry(self._retry_seconds, self._timeout_seconds)

    async def capabilities(self) -> barycast_pb2.GetCapabilitiesResponse:
        """What the server can do. Throws ServerError."""
        retry = self._retry()
        return await self.connection.run(
            flows.retried(retry, lambda: flows.capabilities(self.connection.memory, retry)))

    async def upload(self, cage: Cage, fill_tables: bool = False) -> barycast_pb2.UploadCageResponse:
        """As `Client.upload`."""
        retry = self._retry()
        return await self.connection.run(flows.retried(retry, lambda: flows.upload(cage, retry, fill_tables)))

    async def estimate(self, cage: Cage, point_count: int, faces: Any = None,
                       options: Optional[options_pb2.ComputeOptions] = None,
                       output: Optional[options_pb2.OutputOptions] = None) -> barycast_pb2.EstimateCostResponse:
        """As `Client.estimate`."""
        request = estimate_request(point_count, faces, options or compute_options(), output or output_options())
        retry = self._retry()
        return await self.connection.run(flows.retried(retry, lambda: flows.estimate(cage, request, retry)))

    def compute(self, cage: Cage, points: Any, faces: Any = None,
                options: Optional[options_pb2.ComputeOptions] = None,
                output: Optional[options_pb2.OutputOptions] = None,
                progress: Optional[ProgressCallback] = None) -> AsyncComputation:
        """As `Client.compute`; iterate the result with `async for`."""
        return AsyncComputation(self.connection, cage, points, faces, options or compute_options(),
                                output or output_options(), progress, self._retry)

    async def bind(self, cage: Cage, points: Any, faces: Any = None, coordinates: str = "harmonic",
                   samples: Optional[int] = None, seed: int = 0, preset: str = "default", denoise: str = "auto",
                   gradients: bool = False, dtype: Any = "float32", progress: Optional[ProgressCallback] = None,
                   thickness: Optional[float] = None, walk_steps_max: Optional[int] = None,
                   prune_below: Optional[float] = None, smoothing_time: Optional[float] = None,
                   influences_max: int = 0, estimator: str = "auto", panels: Optional[int] = None,
                   target_error: Optional[float] = None, errors: bool = False, tables: bool = False) -> Binding:
        """As `Client.bind`."""
        options = compute_options(coordinates, preset, samples, seed, denoise, thickness, walk_steps_max, prune_below,
                                  smoothing_time, estimator, panels, target_error, tables)
        output = output_options(dtype, gradients, influences_max, errors)
        return await self.bind_with(cage, points, faces, options, output, progress)

    async def bind_with(self, cage: Cage, points: Any, faces: Any, options: options_pb2.ComputeOptions,
                        output: options_pb2.OutputOptions, progress: Optional[ProgressCallback] = None) -> Binding:
        """As `Client.bind_with`."""
        started = time.monotonic()
        computation = AsyncComputation(self.connection, cage, points, faces, options, output, progress, self._retry,
                                       rows_kept=False)
        collector = computation.collector()
        async for rows in computation:
            collector.add(rows)
        return gathered(collector, computation, started)
