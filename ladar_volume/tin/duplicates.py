"""Points that share a footprint, exactly or within a tolerance (seed 000, "duplicate points")."""

from __future__ import annotations

import numpy as np

from ladar_volume.math.equal_rows import first_equal
from ladar_volume.math.kernels import kernel
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I32, I64


@kernel
def cell_bucket(ix: float, iy: float, mask: int) -> int:
    """Bucket of a cell."""
    # the products wrap; what is left of them spreads neighbours over the table
    h = np.int64(ix) * np.int64(0x9E3779B97F4A7C1) ^ np.int64(iy) * np.int64(0xC2B2AE3D27D4EB4)
    return int((h ^ (h >> 29)) & mask)


@kernel
def copies_kernel(xy: F64, tolerance: float, cell: F64, head: I64, after: I32, same: I32) -> None:
    """``same[i]``: the first kept point within the tolerance of point i, or i, which is then kept;
    ``cell`` (n, 2) are whole numbers.
    """
    mask = len(head) - 1
    for i in range(len(xy)):
        same[i] = i
        for dx in range(-1, 2):
            for dy in range(-1, 2):
                k = head[cell_bucket(cell[i, 0] + dx, cell[i, 1] + dy, mask)]
                while k >= 0:
                    x, y = xy[k, 0] - xy[i, 0], xy[k, 1] - xy[i, 1]
                    if x * x + y * y <= tolerance * tolerance and (same[i] == i or k < same[i]):
                        same[i] = k
                    k = after[k]
        if same[i] == i:
            b = cell_bucket(cell[i, 0], cell[i, 1], mask)
            after[i], head[b] = head[b], i


def first_within(xy: F64, tolerance_m: float = 0.0) -> I32:
    """For every point of xy (n, 2), m, the first kept point within the tolerance, (n,); points for
    which that is themselves are kept.

    Points are taken in their order, so every point lies within the tolerance of a kept one, and no
    two kept ones within it of each other. Raises :class:`SurfaceError` for a tolerance that is not
    a number >= 0, or so small that cells of its size over the points' extent cannot be numbered.
    """
    if not (0.0 <= tolerance_m < np.inf):
        raise SurfaceError(
            f"the tolerance is {tolerance_m} m; it must be 0 or more",
            reason="surface_tolerance",
            value=tolerance_m,
        )
    n = len(xy)
    if n == 0 or tolerance_m == 0.0:
        return first_equal(xy).astype(np.int32)
    same, after = np.empty(n, np.int32), np.empty(n, np.int32)
    xy = np.asarray(xy, dtype=np.float64)
    cell = np.floor((xy - xy.min(axis=0)) / tolerance_m)
    if not cell.max() < 2.0**52:
        words = f"a tolerance of {tolerance_m} m is below the points' resolution"
        raise SurfaceError(words, reason="surface_tolerance", value=tolerance_m)
    head = np.full(1 << int(2 * n - 1).bit_length(), -1, np.int64)
    copies_kernel(xy, float(tolerance_m), cell, head, after, same)
    return same
