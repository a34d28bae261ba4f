"""PLY, ascii and binary of either byte order: the elements `vertex` and `face`; all others are kept."""

from __future__ import annotations

from typing import Union

import numpy as np

from .cage import Faces
from .errors import InputError
from .model import Model, no_segments
from .ply_body import AsciiBody, BinaryBody
from .ply_header import parse_header


def read_ply(path: str, data: bytes) -> Model:
    """points: n x 3 from x, y, z. Throws InputError naming the file, and the line of ascii files."""
    header = parse_header(path, data)
    by_name = {element.name: element for element in header.elements}
    vertex = by_name.get("vertex")
    if vertex is None or vertex.count == 0 or min(vertex.find((axis,)) for axis in "xyz") < 0 or vertex.has_lists():
        raise InputError("needs an element vertex with the plain properties x, y, z", field=path)
    if any(vertex.properties[vertex.find((axis,))].kind[0] != "f" for axis in "xyz"):
        raise InputError("needs x, y, z of type float or double", field=path)
    body: Union[AsciiBody, BinaryBody] = (AsciiBody(path, data, header) if header.order == "" else
                                          BinaryBody(path, data, header))
    points, counts, corners = body.read()
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        raise InputError(f"vertex {int(np.argmin(finite))} is not finite; export it again", field=path)
    if len(corners) and (corners.min() < 0 or corners.max() >= len(points)):
        raise InputError(f"a face names a vertex that is not in 0 ... {len(points) - 1}; export it again", field=path)
    try:
        faces = Faces(np.concatenate([[0], np.cumsum(counts, dtype=np.int64)]), corners)
    except InputError as error:
        raise InputError(str(error), field=path) from error
    return Model(path, points, faces, no_segments(), body.rewrite)
