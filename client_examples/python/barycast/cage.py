"""Cages and faces as numpy arrays, and the digest that names a cage."""

from __future__ import annotations

import hashlib
import itertools
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Tuple

import numpy as np
from numpy.typing import NDArray

from barycast.v1 import cage_pb2

from . import arrays
from .errors import InputError


@dataclass(frozen=True, eq=False)
class Faces:
    """k faces of any size: face i has the corners corners[offsets[i]] ... corners[offsets[i + 1] - 1].

    offsets: (k + 1) int64, starting at 0, not decreasing. corners: uint32 indices of vertices.
    Throws InputError when they do not fit together or a face has fewer than three corners.
    """

    offsets: NDArray[Any] = field(default_factory=lambda: np.zeros(1, np.int64))
    corners: NDArray[Any] = field(default_factory=lambda: np.zeros(0, np.uint32))

    def __post_init__(self) -> None:
        corners = arrays.indices(self.corners, "faces.corners")
        offsets = arrays.indices(self.offsets, "faces.offsets").astype(np.int64)
        if offsets.size == 0 or offsets[0] != 0 or offsets[-1] != corners.size:
            raise InputError("must start at 0 and end at the number of corners", field="faces.offsets")
        small = np.diff(offsets) < 3
        if small.any():
            raise InputError("has fewer than three corners", field=f"faces[{int(np.argmax(small))}]")
        object.__setattr__(self, "offsets", offsets)
        object.__setattr__(self, "corners", corners)

    @classmethod
    def of(cls, faces: Any) -> Faces:
        """From Faces, a k x c array, a list of lists of indices, or None (no faces)."""
        if isinstance(faces, Faces):
            return faces
        if faces is None or len(faces) == 0:
            return cls()
        if isinstance(faces, np.ndarray) and faces.ndim == 2:
            return cls(np.arange(len(faces) + 1) * faces.shape[1], faces.ravel())
        counts = [len(face) for face in faces]
        offsets = np.concatenate([[0], np.cumsum(counts)])
        return cls(offsets, np.array(list(itertools.chain.from_iterable(faces))))

    def __len__(self) -> int:
        return len(self.offsets) - 1

    @property
    def counts(self) -> NDArray[Any]:
        """k int64: corners of each face."""
        return np.diff(self.offsets)

    def of_size(self, size: int) -> NDArray[Any]:
        """j x size uint32: the faces with that many corners, in order."""
        starts = self.offsets[:-1][self.counts == size]
        faces: NDArray[Any] = self.corners[starts[:, None] + np.arange(size)]
        return faces

    def without(self, sizes: Tuple[int, ...]) -> Faces:
        """The faces whose corner count is not in sizes, in order."""
        counts = self.counts
        kept = ~np.isin(counts, sizes)
        return Faces(np.concatenate([[0], np.cumsum(counts[kept])]), self.corners[np.repeat(kept, counts)])


def _none(columns: int) -> Any:
    return field(default_factory=lambda: np.zeros((0, columns), np.uint32))


@dataclass(frozen=True, eq=False)
class Cage:
    """A cage: control vertices and the elements between them.

    control_vertices: n x d float64, d = 2 or 3, in the caller's units. segments: k x 2, triangles: k x 3, quads:
    k x 4 (bilinear patches), all uint32. polygons: faces with five or more corners; those with three or four are
    moved behind the triangles and quads, which is what they are. Immutable. Throws InputError naming the field.
    """

    control_vertices: NDArray[Any]
    segments: NDArray[Any] = _none(2)
    triangles: NDArray[Any] = _none(3)
    quads: NDArray[Any] = _none(4)
    polygons: Faces = field(default_factory=Faces)

    def __post_init__(self) -> None:
        vertices = arrays.positions(self.control_vertices, "cage.control_vertices")
        polygons = Faces.of(self.polygons)
        arrays.indices(polygons.corners, "cage.polygons.corners", count=len(vertices))
        elements = {}
        for name, columns in (("segments", 2), ("triangles", 3), ("quads", 4)):
            elements[name] = arrays.indices(getattr(self, name), f"cage.{name}", columns, len(vertices))
        elements["triangles"] = np.concatenate([elements["triangles"], polygons.of_size(3)])
        elements["quads"] = np.concatenate([elements["quads"], polygons.of_size(4)])
        object.__setattr__(self, "control_vertices", vertices)
        object.__setattr__(self, "polygons", polygons.without((3, 4)))
        for name, values in elements.items():
            object.__setattr__(self, name, values)

    @classmethod
    def from_faces(cls, vertices: Any, faces: Any) -> Cage:
        """vertices: n x 3. faces: anything Faces.of takes; three corners make a triangle, four a bilinear quad."""
        return cls(vertices, polygons=Faces.of(faces))

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return int(self.control_vertices.shape[1])

    @property
    def used(self) -> NDArray[Any]:
        """n bool: the control vertices that an element uses."""
        mask = np.zeros(len(self.control_vertices), bool)
        for corners in (self.segments, self.triangles, self.quads, self.polygons.corners):
            mask[corners.ravel()] = True
        return mask

    def canonical_bytes(self) -> bytes:
        """The bytes that the digest is taken over, as cage.proto defines them."""
        polygons = self.polygons
        head = [self.dimension, len(self.control_vertices), 0, len(self.segments), len(self.triangles),
                len(self.quads), len(polygons), len(polygons.corners)]
        parts = [np.array(head), self.segments, self.triangles, self.quads]
        if len(polygons):
            parts += [polygons.offsets, polygons.corners]
        integers = [np.ascontiguousarray(part, "<u4").tobytes() for part in parts]
        vertices = self.control_vertices + 0.0  # -0 becomes +0
        return b"".join([b"BCCAGE01", integers[0], vertices.astype("<f8").tobytes(), *integers[1:]])

    @cached_property
    def digest(self) -> cage_pb2.CageDigest:
        """The cage's name."""
        canonical = self.canonical_bytes()
        return cage_pb2.CageDigest(sha256=hashlib.sha256(canonical).digest(), size_bytes=len(canonical))

    def to_message(self) -> cage_pb2.Cage:
        """The cage as the API takes it."""
        message = cage_pb2.Cage(control_vertices=arrays.to_message(self.control_vertices))
        for name in ("segments", "triangles", "quads"):
            if len(getattr(self, name)):
                getattr(message, name).CopyFrom(arrays.to_message(getattr(self, name)))
        if len(self.polygons):
            message.polygons.offsets.CopyFrom(arrays.to_message(self.polygons.offsets.astype(np.uint32)))
            message.polygons.corners.CopyFrom(arrays.to_message(self.polygons.corners))
        return message
