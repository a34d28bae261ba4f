"""Rows as they arrive, and all of them gathered into arrays."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any, Optional

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from barycast.v1 import barycast_pb2

from . import arrays
from .errors import ServerError

_SLACK = 1.125  # rows to come may be a little fuller than those that arrived; pages never written cost nothing


@dataclass(frozen=True)
class Rows:
    """Consecutive rows. Row first_row + i has the entries offsets[i] ... offsets[i + 1] - 1.

    offsets: (k + 1) uint32. indices: nnz uint32, control vertices in ascending order. values: nnz. gradients: nnz x d
    per unit of the caller's length, or None. flags: k uint8, bits of RowFlag. errors: k x 2 float32, or None. All
    read-only views of the bytes of the message.
    """

    first_row: int
    offsets: NDArray[Any]
    indices: NDArray[Any]
    values: NDArray[Any]
    gradients: Optional[NDArray[Any]]
    flags: NDArray[Any]
    errors: Optional[NDArray[Any]] = None


def rows_from_message(block: barycast_pb2.RowBlock, dtype: Any, dimension: int, with_gradients: bool,
                      with_errors: bool = False) -> Rows:
    """Throws ServerError when the arrays do not fit together. dtype: of values and gradients."""
    dtype = np.dtype(dtype)
    offsets = arrays.from_message(block.offsets, np.dtype("u4"), "rows.offsets")
    indices = arrays.from_message(block.indices, np.dtype("u4"), "rows.indices")
    values = arrays.from_message(block.values, dtype, "rows.values")
    gradients = arrays.from_message(block.gradients, dtype, "rows.gradients") if with_gradients else None
    flags = np.frombuffer(block.flags, np.uint8)
    misfit = len(block.errors) != (8 * len(flags) if with_errors else 0)
    if (misfit or len(offsets) != len(flags) + 1 or offsets[-1] != len(indices) or len(values) != len(indices)
            or (gradients is not None and gradients.shape != (len(indices), dimension))):
        raise ServerError("the arrays of a block of rows do not fit together", code="DATA_LOSS", field="rows")
    errors = np.frombuffer(block.errors, "<f4").reshape(-1, 2) if with_errors else None
    return Rows(block.first_row, offsets, indices, values, gradients, flags, errors)


class _Growing:
    """An array that is written once, from front to back, and whose final length is guessed while it fills."""

    def __init__(self, dtype: Any, columns: Optional[int] = None) -> None:
        self._values = np.empty((0,) if columns is None else (0, columns), dtype)
        self._used = 0

    def append(self, block: NDArray[Any], part: float) -> None:
        """part: how much of the whole will have arrived with this block, above 0 to 1."""
        end = self._used + len(block)
        if end > len(self._values):
            capacity = max(end, int(end / part * _SLACK)) if part < 1 else end
            grown = np.empty((capacity, *self._values.shape[1:]), self._values.dtype)
            grown[:self._used] = self._values[:self._used]
            self._values = grown
        self._values[self._used:end] = block
        self._used = end

    def finished(self) -> NDArray[Any]:
        """All that was appended, its spare room given back in place; nothing may be appended afterwards."""
        self._values.resize((self._used, *self._values.shape[1:]), refcheck=False)
        return self._values


class RowCollector:
    """Gathers all rows of n points and v control vertices. Every entry is copied once, from the message to its place
    in the result, so the peak is the result and one block. A block with row 0 starts anew."""

    def __init__(self, point_count: int, control_vertex_count: int, dimension: int, dtype: Any,
                 with_gradients: bool, with_errors: bool = False) -> None:
        self._shape = (point_count, control_vertex_count)
        self._new_gradients = functools.partial(_Growing, dtype, dimension) if with_gradients else None
        self._dtype = dtype
        self.flags = np.zeros(point_count, np.uint8)
        self.errors = np.zeros((point_count, 2), np.float32) if with_errors else None
        self._ends = np.zeros(point_count + 1, np.int64)
        self._start()

    def _start(self) -> None:
        self._values, self._indices = _Growing(self._dtype), _Growing(np.int32)
        self._gradients = self._new_gradients() if self._new_gradients else None

    def add(self, rows: Rows) -> None:
        """The next rows."""
        first, end = rows.first_row, rows.first_row + len(rows.flags)
        if first == 0:
            self._start()
        part = end / self._shape[0]
        self._values.append(rows.values, part)
        self._indices.append(rows.indices.view(np.int32), part)  # control vertices are far below 2^31
        if self._gradients is not None and rows.gradients is not None:
            self._gradients.append(rows.gradients, part)
        self._ends[first + 1:end + 1] = self._ends[first] + rows.offsets[1:]
        self.flags[first:end] = rows.flags
        if self.errors is not None and rows.errors is not None:
            self.errors[first:end] = rows.errors

    def matrix(self) -> scipy.sparse.csr_matrix:
        """n x v, over the gathered arrays themselves; once, at the end."""
        values, indices = self._values.finished(), self._indices.finished()
        # scipy wants one type for both index arrays.
        index_type = np.int32 if len(values) < 2**31 else np.int64
        parts = (values, indices.astype(index_type, copy=False), self._ends.astype(index_type, copy=False))
        return scipy.sparse.csr_matrix(parts, shape=self._shape, copy=False)

    def gradients(self) -> Optional[NDArray[Any]]:
        """nnz x d in the order of the matrix's entries, or None; once, at the end."""
        return None if self._gradients is None else self._gradients.finished()
