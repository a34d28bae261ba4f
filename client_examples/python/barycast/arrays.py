"""Between numpy and the API's `Array`: dense, row-major, little-endian."""

from __future__ import annotations

from typing import Any, Optional

import numpy as np
from numpy.typing import NDArray

from barycast.v1 import cage_pb2

from .errors import InputError, ServerError

_TYPES = {
    cage_pb2.DATA_TYPE_FLOAT32: np.dtype("<f4"),
    cage_pb2.DATA_TYPE_FLOAT64: np.dtype("<f8"),
    cage_pb2.DATA_TYPE_UINT32: np.dtype("<u4"),
}
DATA_TYPES = {dtype: data_type for data_type, dtype in _TYPES.items()}


def to_message(values: NDArray[Any]) -> cage_pb2.Array:
    """An Array from n x c or n (one column) float32, float64 or uint32; copies once, into the message."""
    dtype = values.dtype.newbyteorder("<")
    columns = values.shape[1] if values.ndim == 2 else 1
    return cage_pb2.Array(type=DATA_TYPES[dtype], rows=values.shape[0], columns=columns,
                          data=values.astype(dtype, copy=False).tobytes())


def from_message(message: cage_pb2.Array, dtype: np.dtype[Any], field: str) -> NDArray[Any]:
    """rows x columns (or rows, for one column) of dtype, read-only. Throws ServerError when the message holds
    another type or another number of bytes."""
    expected = DATA_TYPES[dtype.newbyteorder("<")]
    data = message.data
    if message.type != expected or len(data) != message.rows * message.columns * dtype.itemsize:
        raise ServerError("the server sent an array whose type or size does not fit its description", code="INTERNAL",
                          field=field)
    values = np.frombuffer(data, dtype.newbyteorder("<"))
    return values if message.columns == 1 else values.reshape(message.rows, message.columns)


def positions(values: Any, field: str, keep_float32: bool = False) -> NDArray[Any]:
    """n x 2 or n x 3 finite float64 (float32 is kept when asked for). Throws InputError naming the field."""
    try:
        array = np.asarray(values)
        dtype = np.float32 if keep_float32 and array.dtype == np.float32 else np.float64
        array = np.ascontiguousarray(array, dtype)
    except (TypeError, ValueError) as error:
        raise InputError("must be an n x 2 or n x 3 array of numbers", field=field) from error
    if array.ndim != 2 or array.shape[1] not in (2, 3):
        raise InputError(f"must be an n x 2 or n x 3 array, not of shape {array.shape}", field=field)
    finite = np.isfinite(array).all(axis=1)
    if not finite.all():
        raise InputError("has a coordinate that is not finite", field=f"{field}[{int(np.argmin(finite))}]")
    return array


def indices(values: Any, field: str, columns: Optional[int] = None, count: Optional[int] = None) -> NDArray[Any]:
    """k (or k x columns) uint32. Throws InputError when the values are not whole numbers that fit, when the shape
    differs, or when one is not below count."""
    shape = (-1,) if columns is None else (-1, columns)
    try:
        array = np.asarray(values)
    except ValueError as error:
        raise InputError("must be an array, its rows must have equal lengths", field=field) from error
    if array.size == 0:
        return np.zeros((0,) if columns is None else (0, columns), np.uint32)
    if array.dtype.kind not in "iu" or array.ndim != len(shape) or (columns and array.shape[1] != columns):
        wanted = "a list" if columns is None else f"a k x {columns} array"
        raise InputError(f"must be {wanted} of whole numbers, not {array.dtype} of shape {array.shape}", field=field)
    limit = 2**32 if count is None else count
    wrong = (array < 0) | (array >= limit)
    if wrong.any():
        place = np.unravel_index(int(np.argmax(wrong)), array.shape)
        where = "".join(f"[{int(i)}]" for i in place)
        raise InputError(f"index {int(array[place])} is not in 0 ... {limit - 1}", field=field + where)
    return np.ascontiguousarray(array, np.uint32)
