"""The client: the verbs of the API with numpy in and out."""

from __future__ import annotations

import time
from typing import Any, Optional

from barycast.v1 import barycast_pb2, options_pb2

from .binding import Binding, collect
from .cage import Cage
from .compute import Computation, ProgressCallback
from .connection import Connection
from .options import compute_options, output_options


class Client:
    """A client of one server; a context manager.

    address: "host:port", "unix:/path", or any gRPC target; None starts a private local server that ends with this
    object. threads: of the private server. timeout_seconds: of one attempt of one call; None waits for ever.
    Calls reconnect when the server restarted: a bounded number of attempts over about six seconds. Use one Client
    per thread and process (gRPC does not survive a fork).
    """

    def __init__(self, address: Optional[str] = None, *, threads: Optional[int] = None,
                 timeout_seconds: Optional[float] = None) -> None:
        self.connection = Connection(address, threads, timeout_seconds)

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes the connection and ends the private server. May be called again."""
        self.connection.close()

    def capabilities(self) -> barycast_pb2.GetCapabilitiesResponse:
        """What the server can do. Throws ServerError."""
        return self.connection.retried(self.connection.capabilities)

    def upload(self, cage: Cage) -> barycast_pb2.UploadCageResponse:
        """Gives the server the cage to hold, and returns its digest and warnings. Throws InputError when the cage is
        invalid or too large, ServerError. `compute` and `bind` upload by themselves when they must."""
        return self.connection.retried(lambda: self.connection.upload(cage))

    def compute(self, cage: Cage, points: Any, faces: Any = None,
                options: Optional[options_pb2.ComputeOptions] = None,
                output: Optional[options_pb2.OutputOptions] = None,
                progress: Optional[ProgressCallback] = None) -> Computation:
        """Coordinates of points (n x d, in the cage's units and frame) as blocks of rows, in order: iterate the
        result. faces: the mesh over the points that denoising runs over, anything `Faces.of` takes, or None.
        progress: called with (stage, done, total). Throws InputError here or while iterating, ServerError while
        iterating."""
        return Computation(self.connection, cage, points, faces, options or compute_options(),
                           output or output_options(), progress)

    def bind(self, cage: Cage, points: Any, faces: Any = None, coordinates: str = "harmonic",
             samples: Optional[int] = None, seed: int = 0, preset: str = "default", denoise: str = "auto",
             gradients: bool = False, dtype: Any = "float32", progress: Optional[ProgressCallback] = None,
             thickness: Optional[float] = None, walk_steps_max: Optional[int] = None,
             prune_below: Optional[float] = None, smoothing_time: Optional[float] = None) -> Binding:
        """All rows of `compute` as one sparse matrix. None follows the preset. Throws InputError, ServerError."""
        options = compute_options(coordinates, preset, samples, seed, denoise, thickness, walk_steps_max, prune_below,
                                  smoothing_time)
        started = time.monotonic()
        computation = self.compute(cage, points, faces, options, output_options(dtype, gradients), progress)
        binding = collect(computation, cage)
        binding.report["seconds"]["total"] = time.monotonic() - started
        binding.report["build_version"] = self.capabilities().build_version
        return binding
