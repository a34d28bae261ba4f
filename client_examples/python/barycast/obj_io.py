"""Wavefront OBJ: `v`, `f` and `l`; every other line is kept and passed on as it is."""

from __future__ import annotations

import re
from typing import Any, Iterator, List, Tuple

import numpy as np
from numpy.typing import NDArray

from .cage import Faces
from .errors import InputError
from .model import Model, no_segments, number_bytes, place

_VERTEX = re.compile(rb"(\s*v\s+)\S+(\s+)\S+(\s+)\S+(.*)", re.DOTALL)
_CONTINUED = re.compile(rb"\\(\r\n|\r|\n)")


def _logical_lines(data: bytes) -> Iterator[Tuple[int, bytes]]:
    """(number of the first physical line, bytes with their line end). A backslash at a line's end continues it, but not
    in a comment: paths that end in one are common there."""
    held, first = b"", 0
    for number, line in enumerate(data.splitlines(keepends=True), 1):
        if held:
            line, number = held + line, first
        comment = line.find(b"#") >= 0
        if not comment and line.rstrip(b"\r\n").endswith(b"\\"):
            held, first = line, number
        else:
            held = b""
            yield number, line
    if held:
        yield first, held


class _Parser:
    def __init__(self, path: str) -> None:
        self.path = path
        self.lines: List[bytes] = []
        self.vertex_lines: List[int] = []
        self.coordinates: List[float] = []
        self.counts: List[int] = []
        self.corners: List[int] = []
        self.corner_lines: List[int] = []
        self.segments: List[Tuple[int, int]] = []
        self.segment_lines: List[int] = []

    def parse(self, data: bytes) -> None:
        for number, line in _logical_lines(data):
            self.lines.append(line)
            text = _CONTINUED.sub(b" ", line)
            if b"#" in text:
                text = text[:text.index(b"#")]
            tokens = text.split()
            if not tokens:
                continue
            if tokens[0] == b"v":
                self._vertex(number, tokens)
            elif tokens[0] == b"f":
                corners = self._indices(number, tokens, 3)
                self.counts.append(len(corners))
                self.corners.extend(corners)
                self.corner_lines.append(number)
            elif tokens[0] == b"l":
                corners = self._indices(number, tokens, 2)
                self.segments.extend(zip(corners, corners[1:]))
                self.segment_lines.extend([number] * (len(corners) - 1))

    def _vertex(self, number: int, tokens: List[bytes]) -> None:
        try:
            x, y, z = map(float, tokens[1:4])
        except ValueError:
            raise InputError("v needs three numbers; repair or remove the line",
                             field=place(self.path, number)) from None
        self.vertex_lines.append(len(self.lines) - 1)
        self.coordinates += (x, y, z)

    def _indices(self, number: int, tokens: List[bytes], least: int) -> List[int]:
        """Indices of vertices from 0, of v, v/vt, v//vn or v/vt/vn; negative ones count back from the last vertex."""
        count = len(self.vertex_lines)
        try:
            indices = [int(token.partition(b"/")[0]) for token in tokens[1:]]
        except ValueError:
            raise InputError("corners must be whole numbers like 3 or 3/1/2; repair or remove the line",
                             field=place(self.path, number)) from None
        if len(indices) < least:
            raise InputError(f"needs at least {least} corners; repair or remove the line",
                             field=place(self.path, number))
        zero_based = [index - 1 if index > 0 else count + index for index in indices]
        if 0 in indices or min(zero_based) < 0:
            raise InputError("names a vertex before the first; indices start at 1, negative ones count back",
                             field=place(self.path, number))
        return zero_based


def read_obj(path: str, data: bytes) -> Model:
    """points: n x 3, further numbers of `v` (weights, colours) are kept. Throws InputError naming the line."""
    parser = _Parser(path)
    parser.parse(data)
    points = np.array(parser.coordinates, np.float64).reshape(-1, 3)
    if len(points) == 0:
        raise InputError("holds no vertices (lines that start with v)", field=path)
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        raise InputError("has a coordinate that is not finite; repair the line",
                         field=_line_of(parser, int(np.argmin(finite))))
    offsets = np.concatenate([[0], np.cumsum(parser.counts, dtype=np.int64)])
    corners = np.array(parser.corners, np.int64)
    segments = np.array(parser.segments, np.int64).reshape(-1, 2)
    for values, lines in ((corners, np.repeat(parser.corner_lines, parser.counts)),
                          (segments.ravel(), np.repeat(parser.segment_lines, 2))):
        if len(values) and values.max() >= len(points):
            worst = int(np.argmax(values >= len(points)))
            raise InputError(f"names vertex {int(values[worst]) + 1}, the file has {len(points)}",
                             field=place(path, int(lines[worst])))
    return Model(path, points, Faces(offsets, corners), segments.astype(np.uint32) if len(segments) else no_segments(),
                 lambda positions: _rewrite(parser, positions))


def _line_of(parser: _Parser, vertex: int) -> str:
    physical = 1 + sum(len(line.splitlines()) for line in parser.lines[:parser.vertex_lines[vertex]])
    return place(parser.path, physical)


def _rewrite(parser: _Parser, positions: NDArray[Any]) -> bytes:
    lines = list(parser.lines)
    numbers = number_bytes(positions.ravel())
    for vertex, index in enumerate(parser.vertex_lines):
        match = _VERTEX.fullmatch(_CONTINUED.sub(b" ", lines[index]))
        assert match is not None  # the line was read as a vertex
        head, first, second, tail = match.groups()
        x, y, z = numbers[3 * vertex:3 * vertex + 3]
        lines[index] = b"".join((head, x, first, y, second, z, tail))
    return b"".join(lines)
