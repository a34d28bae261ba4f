"""Generalized barycentric coordinates of points with respect to a cage: the client of `barycastd`.

    from barycast import Cage, Client
    with Client() as client:                       # or Client("host:port")
        binding = client.bind(Cage.from_faces(vertices, faces), points)
    moved_points = binding.deform(moved_vertices)

A wheel holds the generated modules `barycast.v1.*`. In a checkout they live in the build tree (`<build>/python`), so
this package's path is extended by every folder `barycast` on `sys.path`.
"""

import os
from pkgutil import extend_path

# Read by grpc when it is first imported: its threads then pause while a process forks. Of processes forked right after
# a call about one in 50 hung without it, one in 400 with it.
os.environ.setdefault("GRPC_ENABLE_FORK_SUPPORT", "1")

__version__ = "0.1.0"
__path__ = extend_path(__path__, __name__)

from .async_client import AsyncClient  # noqa: E402  (the path must be extended first)
from .async_connection import AsyncComputation  # noqa: E402
from .binding import Binding  # noqa: E402
from .cage import Cage, Faces  # noqa: E402
from .client import Client  # noqa: E402
from .compute import Computation  # noqa: E402
from .errors import BarycastError, InputError, MissingCageError, ServerError  # noqa: E402
from .mesh_io import load_cage, load_model  # noqa: E402
from .rows import Rows  # noqa: E402

__all__ = [
    "AsyncClient", "AsyncComputation", "BarycastError", "Binding", "Cage", "Client", "Computation", "Faces",
    "InputError", "MissingCageError", "Rows", "ServerError", "load_cage", "load_model",
]
