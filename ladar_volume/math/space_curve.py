"""The order of points along a curve through space (Morton 1966): neighbours in memory are
neighbours in space, so what looks around a point finds it near by.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ladar_volume.math.array_types import F64, I32, U64
from ladar_volume.math.kernels import kernel, leaf_kernel

#: Bits of a cell number per axis.
BITS = 21
#: Bits that one pass of a sort looks at.
DIGIT = 11
#: Points of a cell from which on it is divided.
FULL = 16


@kernel
def radix_order(key: npt.NDArray[np.uint64], bits: int) -> npt.NDArray[np.int32]:
    """Stable sorting permutation (n,) of keys of so many bits; destroys ``key``."""
    n = len(key)
    order, order2, key2 = np.empty(n, np.int32), np.empty(n, np.int32), np.empty(n, np.uint64)
    for i in range(n):
        order[i] = i
    mask = np.uint64(2**DIGIT - 1)
    for shift in range(0, bits, DIGIT):
        s = np.uint64(shift)
        at = np.zeros(2**DIGIT + 1, np.int64)
        for i in range(n):
            at[((key[i] >> s) & mask) + np.uint64(1)] += 1
        if at.max() == n:
            continue
        for b in range(2**DIGIT):
            at[b + 1] += at[b]
        for i in range(n):
            b = (key[i] >> s) & mask
            j = at[b]
            at[b] = j + 1
            key2[j], order2[j] = key[i], order[i]
        key, key2, order, order2 = key2, key, order2, order
    return order


@leaf_kernel
def spread_bits(x: int) -> Any:
    """The bits of a number, two zeros between each and the next."""
    b = np.uint64(x)
    b = (b | (b << np.uint64(32))) & np.uint64(0x001F00000000FFFF)
    b = (b | (b << np.uint64(16))) & np.uint64(0x001F0000FF0000FF)
    b = (b | (b << np.uint64(8))) & np.uint64(0x100F00F00F00F00F)
    b = (b | (b << np.uint64(4))) & np.uint64(0x10C30C30C30C30C3)
    return (b | (b << np.uint64(2))) & np.uint64(0x1249249249249249)


@kernel
def morton_kernel(r: F64, low: F64, scale: float) -> U64:
    """Position (n,) of points r (n, 3) m along the curve; low : (3,) m, corner of its cube ·
    scale : cells per m.
    """
    out, top = np.empty(len(r), np.uint64), 2**BITS - 1
    for i in range(len(r)):
        key = np.uint64(0)
        for axis in range(3):
            cell = min(int((r[i, axis] - low[axis]) * scale), top)
            key = (key << np.uint64(1)) | spread_bits(cell)
        out[i] = key
    return out


def curve_order(r: F64) -> I32:
    """Permutation (n,) of points r (n, 3) m along a Morton curve through their bounding cube, a
    full cell along a curve of its own. Only points equal in every coordinate keep their order.
    """
    if len(r) == 0:
        return np.zeros(0, np.int32)
    low, high = (np.array([extreme(c) for c in r.T]) for extreme in (np.min, np.max))
    # a subnormal extent would make the scale infinite
    size = max(float((high - low).max()), 1e-280)
    key = morton_kernel(r, low, 2.0**BITS / size)
    order: I32 = radix_order(key.copy(), 3 * BITS)
    _order_in_cells(r, key[order], order)
    return order


def _order_in_cells(r: F64, key: U64, order: I32) -> None:
    """Put those of points (n, 3) that share a cell in an order of their own; key, order : (n,)
    sorted by cell.
    """
    start = np.flatnonzero(np.r_[True, key[1:] != key[:-1]])
    count = np.diff(start, append=len(key))
    full = (count > FULL) & (count < len(r))  # one cell for all would be divided without end
    for first, n in zip(start[full], count[full], strict=True):
        rows = order[first : first + n]
        order[first : first + n] = rows[curve_order(r[rows])]
    at = np.flatnonzero(np.repeat((count > 1) & ~full, count))
    rows = order[at]
    order[at] = rows[np.lexsort((*r[rows].T[::-1], key[at]))]
