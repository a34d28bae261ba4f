"""STL, ascii and binary. Facets repeat their corners' positions; equal positions become one point, in order of
appearance, so that cages are connected and a model's rows are not computed six times."""

from __future__ import annotations

import re
from typing import Any, Callable, List, Tuple

import numpy as np
from numpy.typing import NDArray

from .cage import Faces
from .errors import InputError
from .model import Model, no_segments, number_bytes, place

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_HEADER_BYTES = 84
_NORMAL = re.compile(rb"(\s*facet\s+normal\s+)\S+\s+\S+\s+\S+(.*)", re.DOTALL | re.IGNORECASE)
_VERTEX = re.compile(rb"(\s*vertex\s+)\S+\s+\S+\s+\S+(.*)", re.DOTALL | re.IGNORECASE)


def read_stl(path: str, data: bytes) -> Model:
    """points: n x 3, faces: triangles. Throws InputError naming the line or the missing bytes."""
    # Binary files may also start with "solid", so the size decides, and a truncated one is known by its zero bytes.
    count = int.from_bytes(data[80:_HEADER_BYTES], "little") if len(data) >= _HEADER_BYTES else -1
    if len(data) == _HEADER_BYTES + count * _FACET.itemsize:
        return _read_binary(path, data, count)
    if data.lstrip()[:5].lower() == b"solid" and b"\0" not in data:
        return _read_ascii(path, data)
    announced = _HEADER_BYTES + max(0, count) * _FACET.itemsize
    raise InputError(f"is no STL: neither text that starts with solid nor {announced} bytes long as its header "
                     "announces; export it again", field=path)


def _merge(path: str, corners: NDArray[Any]) -> Tuple[NDArray[Any], NDArray[Any]]:
    """Unique positions in order of appearance, and for every corner the number of its position."""
    if len(corners) == 0:
        raise InputError("holds no facets", field=path)
    if not np.isfinite(corners).all():
        facet = int(np.argmin(np.isfinite(corners).all(axis=1))) // 3
        raise InputError(f"facet {facet + 1} has a coordinate that is not finite; export it again", field=path)
    keys = np.ascontiguousarray(corners + 0.0).view([("", corners.dtype)] * 3).ravel()  # -0 becomes +0
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return corners[first[order]].astype(np.float64), rank[inverse.ravel()]


def _normals(triangles: NDArray[Any]) -> NDArray[Any]:
    """k x 3 unit normals of k x 3 x 3 corners; 0 for facets without area, as the format asks."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    unit: NDArray[Any] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    return unit


def _model(path: str, corners: NDArray[Any], rewrite_facets: Callable[[NDArray[Any]], bytes]) -> Model:
    points, index = _merge(path, corners)
    return Model(path, points, Faces.of(index.reshape(-1, 3)), no_segments(),
                 lambda positions: rewrite_facets(positions[index].reshape(-1, 3, 3)))


def _read_binary(path: str, data: bytes, count: int) -> Model:
    facets = np.frombuffer(data, _FACET, count, _HEADER_BYTES)

    def rewrite(triangles: NDArray[Any]) -> bytes:
        moved = facets.copy()
        moved["corners"] = triangles
        moved["normal"] = _normals(triangles)
        return data[:_HEADER_BYTES] + moved.tobytes()

    return _model(path, facets["corners"].reshape(-1, 3), rewrite)


def _read_ascii(path: str, data: bytes) -> Model:
    lines = data.splitlines(keepends=True)
    corners: List[Any] = []
    vertex_lines: List[int] = []
    normal_lines: List[int] = []
    for number, line in enumerate(lines):
        tokens = line.split()
        keyword = tokens[0].lower() if tokens else b""
        if keyword == b"facet":
            if len(vertex_lines) != 3 * len(normal_lines) or not _NORMAL.fullmatch(line):
                raise InputError("facets need a normal and three vertices each; export it again",
                                 field=place(path, number + 1))
            normal_lines.append(number)
        elif keyword == b"vertex":
            try:
                x, y, z = map(float, tokens[1:])
            except ValueError:
                raise InputError("vertex needs three numbers; repair the line", field=place(path, number + 1)) from None
            corners.append((x, y, z))
            vertex_lines.append(number)
    if len(vertex_lines) != 3 * len(normal_lines):
        raise InputError(f"ends with {len(vertex_lines)} vertices for {len(normal_lines)} facets; export it again",
                         field=path)

    def rewrite(triangles: NDArray[Any]) -> bytes:
        changed = list(lines)
        for numbers, pattern, values in ((normal_lines, _NORMAL, _normals(triangles)),
                                         (vertex_lines, _VERTEX, triangles.reshape(-1, 3))):
            text = number_bytes(values.ravel())
            for row, number in enumerate(numbers):
                match = pattern.fullmatch(lines[number])
                assert match is not None  # the line was read with the same keyword
                head, tail = match.groups()
                changed[number] = head + b" ".join(text[3 * row:3 * row + 3]) + tail
        return b"".join(changed)

    return _model(path, np.array(corners, np.float64).reshape(-1, 3), rewrite)
