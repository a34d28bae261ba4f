"""The header of a PLY file."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import List, Optional, Tuple

from .errors import InputError
from .model import place

_TYPES = {"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
          "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
          "double": "f8", "float64": "f8"}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
CORNER_LISTS = ("vertex_indices", "vertex_index")


@dataclass
class Property:
    """One property of an element: a number, or a list of numbers."""

    name: str
    kind: str  # numpy code of an entry, without byte order
    count_kind: Optional[str] = None  # of a list's length; None for a plain property


@dataclass
class Element:
    """One element: so many items with these properties, in the order of the file."""

    name: str
    count: int
    properties: List[Property] = field(default_factory=list)

    def has_lists(self) -> bool:
        """Whether items differ in size."""
        return any(item.count_kind for item in self.properties)

    def find(self, names: Tuple[str, ...]) -> int:
        """Place of the first property of one of these names, -1 when there is none."""
        places = [place for place, item in enumerate(self.properties) if item.name in names]
        return places[0] if places else -1


@dataclass
class Header:
    """order: of bytes, as in numpy and struct; "" for ascii. size, lines: bytes and lines before the body."""

    order: str
    elements: List[Element]
    size: int
    lines: int


def parse_header(path: str, data: bytes) -> Header:
    """Throws InputError naming the line."""
    order, elements, offset, number = None, [], 0, 0
    while True:
        end = data.find(b"\n", offset)
        if end < 0:
            raise InputError("is no PLY: its header does not end; export it again", field=path)
        tokens = data[offset:end].decode("ascii", "replace").split()
        offset, number = end + 1, number + 1
        try:
            if number == 1 and tokens != ["ply"]:
                raise ValueError
            if tokens[:1] == ["format"]:
                order = _ORDERS[tokens[1]]
            elif tokens[:1] == ["element"]:
                elements.append(Element(tokens[1], int(tokens[2])))
                if elements[-1].count < 0:
                    raise ValueError
            elif tokens[:2] == ["property", "list"]:
                elements[-1].properties.append(Property(tokens[4], _TYPES[tokens[3]], _TYPES[tokens[2]]))
            elif tokens[:1] == ["property"]:
                elements[-1].properties.append(Property(tokens[2], _TYPES[tokens[1]]))
            elif tokens[:1] == ["end_header"]:
                break
        except (ValueError, KeyError, IndexError):
            raise InputError("is not understood in a PLY header; export it again", field=place(path, number)) from None
    if order is None:
        raise InputError("states no format in its header; export it again", field=path)
    return Header(order, elements, offset, number)
