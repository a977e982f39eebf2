"""The order in which points are inserted: few random rounds, each along a Hilbert curve.

Along the curve the walk from one point to the next is short and its triangles are in the cache; the
rounds (each a few times the one before) keep the number of flips low on any input (Amenta, Choi &
Rote 2003, "Incremental constructions con BRIO").
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ladar_volume.math.kernels import kernel
from ladar_volume.math.space_curve import radix_order
from ladar_volume.model.records import F64, I64

#: Bits of a cell number per axis: an outlier may be 2**16 times as far away as the points are wide
#: before these share cells.
BITS = 26
#: A round holds this many bits' share: 2**-SHARE of the points that are left over go before it.
SHARE = 2


def hilbert_steps() -> I64:
    """Steps of the curve by four levels at once: entry (state, 4 bits of x, 4 bits of y) is 8 bits
    of position and the next state, (1024,).

    A state is how the quarter's own frame lies in the map: bit 0 says that x and y are swapped, bit
    1 that both are mirrored.
    """
    table = np.empty((4, 16, 16), np.int64)
    for state, qx, qy in np.ndindex(4, 16, 16):
        swapped, mirrored, d = state & 1, state >> 1, 0
        for bit in (3, 2, 1, 0):
            x, y = ((qx >> bit) & 1) ^ mirrored, ((qy >> bit) & 1) ^ mirrored
            if swapped:
                x, y = y, x
            d = 4 * d + ((3 * x) ^ y)
            if not y:
                mirrored ^= x
                swapped ^= 1
        table[state, qx, qy] = 4 * d + 2 * mirrored + swapped
    return table.reshape(-1)


STEPS = hilbert_steps()


@kernel
def hilbert_kernel(xy: F64, x0: float, y0: float, scale: float) -> I64:
    """Position of points xy (n, 2) along the Hilbert curve of :data:`BITS` bits per axis."""
    out = np.empty(len(xy), np.int64)
    top = 2**BITS - 1
    for i in range(len(xy)):
        x, y = min(int((xy[i, 0] - x0) * scale), top), min(int((xy[i, 1] - y0) * scale), top)
        d, step = 0, 0
        for bit in range(
            BITS - 2, -1, -4
        ):  # the two levels above the first have 0 of both, which turns the frame there and back
            step = STEPS[((step & 3) << 8) | (((x >> bit) & 15) << 4) | ((y >> bit) & 15)]
            d = (d << 8) | (step >> 2)
        out[i] = d
    return out


@kernel
def insertion_rounds(n: int) -> npt.NDArray[np.uint8]:
    """Round of each of n points, (n,): about 4**-k of the points are in round k or higher; the
    highest round goes first.
    """
    out = np.zeros(n, np.uint8)
    last, left = 0, n
    while left > 64:
        last, left = last + 1, left >> SHARE
    for i in range(n):
        z = np.uint64(i + 1) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z ^= z >> np.uint64(31)
        k = 0
        while k < last and (z & np.uint64(2**SHARE - 1)) == np.uint64(0):
            z >>= np.uint64(SHARE)
            k += 1
        out[i] = k
    return out


@kernel
def by_rounds(order: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """The permutation regrouped by :func:`insertion_rounds` of the point, highest first, otherwise
    in its order.
    """
    level = insertion_rounds(len(order))
    at = np.zeros(66, np.int64)
    for i in range(len(level)):
        at[64 - level[i]] += 1
    total = 0
    for b in range(66):
        total, at[b] = total + at[b], total
    out = np.empty_like(order)
    for i in range(len(order)):
        b = 64 - level[order[i]]
        out[at[b]] = order[i]
        at[b] += 1
    return out


def hilbert_index(xy: F64) -> I64:
    """Position of points xy (n, 2) along a Hilbert curve over their bounding square: (n,) int64."""
    low, high = (
        [float(extreme(c)) for c in xy.T] for extreme in (np.min, np.max)
    )  # by column: a twentieth of both at once
    return hilbert_positions(xy, (low[0], low[1]), square_side(low, high))


def square_side(low: Sequence[float], high: Sequence[float]) -> float:
    """The side, m, of the square that points with least and greatest x and y are in."""
    # a subnormal extent would make the scale infinite
    return max(high[0] - low[0], high[1] - low[1], 1e-280)


def hilbert_positions(xy: F64, low: tuple[float, float], side: float) -> I64:
    """:func:`hilbert_index` over a square from ``low`` on."""
    return np.asarray(hilbert_kernel(xy, low[0], low[1], 2.0**BITS / side))


def hilbert_order(xy: F64) -> npt.NDArray[np.int32]:
    """Permutation (n,) of points xy (n, 2) along the curve; points in one cell keep their order."""
    if len(xy) == 0:
        return np.zeros(0, np.int32)
    order: npt.NDArray[np.int32] = radix_order(hilbert_index(xy).view(np.uint64), 2 * BITS)
    return order


def insertion_order(xy: F64) -> npt.NDArray[np.int32]:
    """Permutation (n,) of points xy (n, 2): rounds from few points to many, each along the Hilbert
    curve. Deterministic.
    """
    out: npt.NDArray[np.int32] = by_rounds(hilbert_order(xy))
    return out
