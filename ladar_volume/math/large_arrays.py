"""Where large arrays lie: in memory, unless a program that works on more than that gives other
room, such as files that the system writes back and reads again as needed.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

#: Arrays of so many bytes or more are large.
LARGE_BYTES = 1 << 22

#: Gives an array of zeros of a shape and a type.
Room = Callable[[tuple[int, ...], npt.DTypeLike], npt.NDArray[Any]]

_rooms: list[Room] = []


@contextlib.contextmanager
def large_arrays_in(room: Room) -> Iterator[None]:
    """Within the block, large arrays of all threads lie there; they stay there afterwards."""
    _rooms.append(room)
    try:
        yield
    finally:
        _rooms.pop()


def large_zeros(shape: tuple[int, ...], dtype: npt.DTypeLike = np.float64) -> npt.NDArray[Any]:
    """An array of zeros."""
    large = math.prod(shape) * np.dtype(dtype).itemsize >= LARGE_BYTES
    return _rooms[-1](shape, dtype) if _rooms and large else np.zeros(shape, dtype)


def taken(array: npt.NDArray[Any], rows: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """The rows (...,) of an array (n, ...), as ``array[rows]``. Raises IndexError for others."""
    n = len(array)
    if rows.size and not -n <= rows.min() <= rows.max() < n:
        raise IndexError(f"rows from {rows.min()} to {rows.max()} of {n}")
    out = large_zeros((*rows.shape, *array.shape[1:]), array.dtype)
    # of the modes that write without a copy this one counts -1 from the end
    return np.take(array, rows, axis=0, out=out, mode="wrap")


def in_its_room(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """The array, moved to where large ones lie, if it is one."""
    if not _rooms or array.nbytes < LARGE_BYTES:
        return array
    out = _rooms[-1](array.shape, array.dtype)
    out[...] = array
    return out
