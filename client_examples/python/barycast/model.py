"""A model: points and faces from a file, and the file with other positions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Callable

import numpy as np
from numpy.typing import NDArray

from .cage import Faces
from .errors import InputError


@dataclass(frozen=True, eq=False)
class Model:
    """path: as given. points: n x 2 or n x 3 float64. faces: of any size over the points. segments: k x 2 uint32.
    rewrite: the file's bytes with other positions of the shape of points."""

    path: str
    points: NDArray[Any]
    faces: Faces
    segments: NDArray[Any]
    rewrite: Callable[[NDArray[Any]], bytes]

    def with_positions(self, positions: NDArray[Any]) -> bytes:
        """The file's bytes with positions (n x 2 or n x 3) in place of points; a missing z is 0, a z that the file has
        no place for must be. Throws InputError on another count."""
        if len(positions) != len(self.points):
            raise InputError(f"has {len(self.points)} points where {len(positions)} are needed", field=self.path)
        columns = self.points.shape[1]
        if positions[:, columns:].any():
            raise InputError("has two coordinates per point and cannot hold a third", field=self.path)
        padded = np.zeros(self.points.shape)
        shared = min(columns, positions.shape[1])
        padded[:, :shared] = positions[:, :shared]
        return self.rewrite(padded)


def no_segments() -> NDArray[Any]:
    """0 x 2."""
    return np.zeros((0, 2), np.uint32)


def place(path: str, line: int) -> str:
    """How errors name a line, counted from 1."""
    return f"{path}:{line}"


def number_bytes(values: NDArray[Any]) -> list[bytes]:
    """Decimals that read back as the same numbers, the shortest such."""
    return [repr(value).encode() for value in values.tolist()]
