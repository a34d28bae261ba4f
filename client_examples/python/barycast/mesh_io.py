"""Cages and models from files, and deformed models back into them.

| ending | points | faces | segments |
|---|---|---|---|
| .obj | `v` | `f`, any size | `l` |
| .ply | element `vertex` | element `face`, any size | |
| .stl | coincident corners merged, in order of appearance | facets | |
| .npz | `points` or `control_vertices` | `face_offsets` and `face_corners`, or `triangles`, `quads` | `segments` |

A cage has two dimensions when its .npz array has two columns, or when its file holds segments, no faces, and only
z = 0. Writing a model keeps everything in its file but the positions (normals stored per vertex stay as they are).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Callable, Dict

import numpy as np
from numpy.typing import NDArray

from . import files
from .cage import Cage
from .errors import InputError
from .model import Model
from .npz_io import read_npz
from .obj_io import read_obj
from .ply_io import read_ply
from .stl_io import read_stl

_READERS: Dict[str, Callable[[str, bytes], Model]] = {
    ".obj": read_obj, ".ply": read_ply, ".stl": read_stl, ".npz": read_npz,
}


def load_model(path: files.PathLike) -> Model:
    """A model's points, faces and segments. Throws InputError naming the file, the line, and what to do."""
    reader = _READERS.get(Path(path).suffix.lower())
    if reader is None:
        raise InputError(f"has no known ending; use one of {', '.join(_READERS)}", field=str(path))
    with files.read(path) as file:
        return reader(str(path), file.read())


def load_cage(path: files.PathLike) -> Cage:
    """A cage. Throws InputError when the file cannot be read or holds no elements."""
    model = load_model(path)
    if len(model.faces) == 0 and len(model.segments) == 0:
        raise InputError("has neither faces nor segments, so it is no cage", field=str(path))
    vertices = model.points
    if len(model.faces) == 0 and vertices.shape[1] == 3 and not vertices[:, 2].any():
        vertices = vertices[:, :2]
    try:
        return Cage(vertices, segments=model.segments, polygons=model.faces)
    except InputError as error:
        raise InputError(str(error), field=str(path)) from error


def points_for(model: Model, dimension: int) -> NDArray[Any]:
    """The model's points (n x dimension) for a cage of that dimension. For 2, z must be 0 everywhere and is dropped.
    Throws InputError."""
    points = model.points
    if points.shape[1] == dimension:
        return points
    if dimension == 3:
        raise InputError("has two coordinates per point, the cage has three", field=model.path)
    if points[:, 2].any():
        raise InputError(f"has a point with z other than 0 (point {int(np.argmax(points[:, 2] != 0))}), but the cage "
                         "is two-dimensional", field=model.path)
    return np.ascontiguousarray(points[:, :2])


def save_model(model: Model, positions: NDArray[Any], path: files.PathLike) -> None:
    """Writes model's file with its points at positions (n x 2 or n x 3). Throws InputError when the count differs,
    when the endings do, or when the file cannot be written."""
    if Path(path).suffix.lower() != Path(model.path).suffix.lower():
        raise InputError(f"must end in {Path(model.path).suffix} as the model does: everything but the positions is "
                         "copied from it", field=str(path))
    data = model.with_positions(positions)
    files.write_atomically(path, lambda file: file.write(data))
