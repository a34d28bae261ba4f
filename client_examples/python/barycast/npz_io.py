"""numpy's .npz: `points` (n x 2 or n x 3) or `control_vertices`, and optionally `face_offsets` (k + 1) with
`face_corners`, `triangles`, `quads`, `segments`. Other arrays are kept."""

from __future__ import annotations

import io
import zipfile
from typing import Any, Dict

import numpy as np
from numpy.typing import NDArray

from . import arrays
from .cage import Faces
from .errors import InputError
from .model import Model


def read_npz(path: str, data: bytes) -> Model:
    """The faces are those of face_offsets, then triangles, then quads. Throws InputError naming the array."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            entries = {name: file[name] for name in file.files}
    except (ValueError, zipfile.BadZipFile, EOFError, AttributeError) as error:
        raise InputError("is no .npz of plain arrays; write it with numpy.savez", field=path) from error
    names = [name for name in ("points", "control_vertices") if name in entries]
    if len(names) != 1:
        raise InputError("must hold either an array points or an array control_vertices", field=path)
    try:
        points = arrays.positions(entries[names[0]], names[0])
        segments = arrays.indices(entries.get("segments", ()), "segments", 2, len(points))
        faces = _faces(entries, len(points))
    except InputError as error:
        raise InputError(str(error), field=path) from error
    return Model(path, points, faces, segments, lambda positions: _rewrite(entries, names[0], positions))


def _faces(entries: Dict[str, NDArray[Any]], point_count: int) -> Faces:
    if ("face_offsets" in entries) != ("face_corners" in entries):
        raise InputError("face_offsets and face_corners belong together")
    faces = Faces(entries["face_offsets"], entries["face_corners"]) if "face_offsets" in entries else Faces()
    parts = [faces] + [Faces.of(arrays.indices(entries.get(name, ()), name, size))
                       for name, size in (("triangles", 3), ("quads", 4))]
    counts = np.concatenate([part.counts for part in parts])
    corners = arrays.indices(np.concatenate([part.corners for part in parts]), "face_corners", count=point_count)
    return Faces(np.concatenate([[0], np.cumsum(counts)]), corners)


def _rewrite(entries: Dict[str, NDArray[Any]], name: str, positions: NDArray[Any]) -> bytes:
    dtype = entries[name].dtype if entries[name].dtype.kind == "f" else np.dtype(np.float64)
    file = io.BytesIO()
    np.savez(file, **{**entries, name: positions.astype(dtype)})
    return file.getvalue()
