"""The order in which points are inserted: few random rounds, each along a Hilbert curve.

Along the curve the walk from one point to the next is short; the rounds (each about twice the one before) keep the
number of flips low on any input (Amenta, Choi & Rote 2003, "Incremental constructions con BRIO").
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ladar_volume.model.records import F64, I64

BITS = 16


def hilbert_index(xy: F64) -> I64:
    """Position of points xy (n, 2) along a Hilbert curve over their bounding square: (n,) int64."""
    low = xy.min(axis=0)
    size = float((xy.max(axis=0) - low).max()) or 1.0
    cells = np.minimum(((xy - low) / size * 2**BITS).astype(np.int64), 2**BITS - 1)
    x, y = cells[:, 0].copy(), cells[:, 1].copy()
    out = np.zeros(len(xy), np.int64)
    side = 2 ** (BITS - 1)
    while side:
        rx, ry = (x & side) > 0, (y & side) > 0
        out += side * side * ((3 * rx) ^ ry)
        mirror = ~ry & rx
        x[mirror], y[mirror] = 2**BITS - 1 - x[mirror], 2**BITS - 1 - y[mirror]
        swap = ~ry
        x[swap], y[swap] = y[swap], x[swap].copy()
        side //= 2
    return out


def rounds(n: int) -> I64:
    """Round of each of n points, (n,): round k holds about a 2^-(k+1) share; the highest round goes first."""
    z = np.arange(1, n + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z ^= z >> np.uint64(31)
    last = max(0, int(np.log2(max(n, 1) / 64.0)) if n > 64 else 0)
    lowest: npt.NDArray[np.uint64] = z & (~z + np.uint64(1))
    level = np.where(lowest > 0, np.log2(np.maximum(lowest, 1).astype(np.float64)), 63.0).astype(np.int64)
    return np.minimum(level, last)


def insertion_order(xy: F64) -> I64:
    """Permutation (n,) of points xy (n, 2): rounds from few points to many, each along the Hilbert curve. Deterministic."""
    return np.lexsort((hilbert_index(xy), -rounds(len(xy)))).astype(np.int64)
