"""The body of a PLY file, ascii or binary: `read` gives points (n x 3), corner counts and corners; `rewrite` the file's
bytes with other positions."""

from __future__ import annotations

import struct
from typing import Any, List, Optional, Tuple

import numpy as np
from numpy.typing import NDArray

from .errors import InputError
from .model import place
from .ply_header import CORNER_LISTS, Element, Header


class AsciiBody:
    """One line per item of an element."""

    def __init__(self, path: str, data: bytes, header: Header) -> None:
        self._path, self._header = path, header
        self._lines = data.splitlines(keepends=True)
        self._vertex_lines: List[int] = []
        self._axes: List[int] = []

    def read(self) -> Tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        points, counts, corners = [], [], []
        line = self._header.lines
        for element in self._header.elements:
            items = 0
            corner_list = element.find(CORNER_LISTS) if element.name == "face" else -1
            while items < element.count:
                if line >= len(self._lines):
                    raise InputError(f"ends before its {element.count} items of element {element.name}; "
                                     "export it again", field=self._path)
                tokens = self._lines[line].split()
                line += 1
                if not tokens:
                    continue
                items += 1
                try:
                    if element.name == "vertex":
                        self._axes = [element.find((axis,)) for axis in "xyz"]
                        points.append([float(tokens[axis]) for axis in self._axes])
                        self._vertex_lines.append(line - 1)
                    elif corner_list >= 0:
                        found = _list_tokens(element, tokens, corner_list)
                        counts.append(len(found))
                        corners.extend(found)
                except (ValueError, IndexError):
                    raise InputError(f"does not hold the properties of element {element.name}; repair the line",
                                     field=place(self._path, line)) from None
        return np.array(points), np.array(counts, np.int64), np.array(corners, np.int64)

    def rewrite(self, positions: NDArray[Any]) -> bytes:
        lines = list(self._lines)
        vertex = next(element for element in self._header.elements if element.name == "vertex")
        kinds = [np.dtype(vertex.properties[axis].kind).type for axis in self._axes]
        for row, number in zip(positions, self._vertex_lines):
            tokens = lines[number].split()
            for axis, kind, value in zip(self._axes, kinds, row):
                tokens[axis] = str(kind(value)).encode()  # the shortest decimal of that type
            ending = lines[number][len(lines[number].rstrip(b"\r\n")):]
            lines[number] = b" ".join(tokens) + ending
        return b"".join(lines)


def _list_tokens(element: Element, tokens: List[bytes], wanted: int) -> List[int]:
    at = 0
    for item in element.properties[:wanted]:
        at += 1 + (int(tokens[at]) if item.count_kind else 0)
    count = int(tokens[at])
    found = [int(token) for token in tokens[at + 1:at + 1 + count]]
    if len(found) != count:
        raise ValueError
    return found


class BinaryBody:
    """Items one after another without padding."""

    def __init__(self, path: str, data: bytes, header: Header) -> None:
        self._path, self._data, self._header = path, data, header
        self._vertex_offset = 0
        self._vertex_type = np.dtype([])

    def read(self) -> Tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        points = counts = corners = np.zeros(0, np.int64)
        offset = self._header.size
        for element in self._header.elements:
            try:
                if element.has_lists():
                    element_counts, element_corners, end = self._read_lists(element, offset)
                    if element.name == "face":
                        counts, corners = element_counts, element_corners
                else:
                    dtype = np.dtype([(item.name, self._header.order + item.kind) for item in element.properties])
                    items = np.frombuffer(self._data, dtype, element.count, offset)
                    end = offset + items.nbytes
                    if element.name == "vertex":
                        self._vertex_offset, self._vertex_type = offset, dtype
                        points = np.stack([items[axis].astype(np.float64) for axis in "xyz"], axis=1)
            except (ValueError, struct.error):
                raise InputError(f"ends before its {element.count} items of element {element.name}, or repeats a "
                                 "property; export it again", field=self._path) from None
            offset = end
        return points, counts, corners

    def _read_lists(self, element: Element, offset: int) -> Tuple[NDArray[Any], NDArray[Any], int]:
        """Corner counts and corners of the corner list (empty when there is none), and where the element ends."""
        wanted = element.find(CORNER_LISTS)
        uniform = self._read_uniform(element, offset, wanted)
        if uniform is not None:
            return uniform
        order = self._header.order
        counts: List[int] = []
        corners: List[int] = []
        codes = [(np.dtype(item.kind).char, item.count_kind and np.dtype(item.count_kind).char)
                 for item in element.properties]
        for _ in range(element.count):
            for number, (code, count_code) in enumerate(codes):
                count = 1
                if count_code:
                    (count,) = struct.unpack_from(order + count_code, self._data, offset)
                    offset += struct.calcsize(order + count_code)
                values = struct.unpack_from(f"{order}{count}{code}", self._data, offset)
                offset += struct.calcsize(f"{order}{count}{code}")
                if number == wanted:
                    counts.append(count)
                    corners.extend(values)
        return np.array(counts, np.int64), np.array(corners, np.int64), offset

    def _read_uniform(self, element: Element, offset: int,
                      wanted: int) -> Optional[Tuple[NDArray[Any], NDArray[Any], int]]:
        """As _read_lists, at once, for one list whose length is the same in all items; None when it is not so."""
        if element.count == 0 or wanted < 0 or sum(item.count_kind is not None for item in element.properties) != 1:
            return None
        order = self._header.order
        fields: List[Tuple[str, str, int]] = []
        before = 0
        for number, item in enumerate(element.properties):
            if number < wanted:
                before += np.dtype(item.kind).itemsize
            if number == wanted:
                assert item.count_kind is not None  # it is a list
                (count,) = np.frombuffer(self._data, order + item.count_kind, 1, offset + before)
                fields.append(("count", order + item.count_kind, 1))
                fields.append(("corners", order + item.kind, int(count)))
            else:
                fields.append((f"property {number}", order + item.kind, 1))
        dtype = np.dtype([(name, kind, (size,)) for name, kind, size in fields])
        if offset + element.count * dtype.itemsize > len(self._data):
            return None
        items = np.frombuffer(self._data, dtype, element.count, offset)
        if (items["count"] != count).any():
            return None
        counts = np.full(element.count, int(count), np.int64)
        return counts, items["corners"].astype(np.int64).ravel(), offset + items.nbytes

    def rewrite(self, positions: NDArray[Any]) -> bytes:
        data = bytearray(self._data)
        items = np.frombuffer(data, self._vertex_type, len(positions), self._vertex_offset)
        for column, axis in enumerate("xyz"):
            items[axis] = positions[:, column]
        return bytes(data)
