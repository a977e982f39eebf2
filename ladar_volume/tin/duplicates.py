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


def places(points: F64) -> F64:
    """The distinct footprints of points (n, 3) by x, then y: (k, 4) of x, y, the mean height of the
    points there, m, and how many these are; points with the same three coordinates are one.
    """
    return places_and_rows(points, np.zeros(len(points), np.int64))[0]


def places_and_rows(points: F64, rows: I64) -> tuple[F64, I64]:
    """:func:`places`, and the least of the rows (n,) of the points at each."""
    order = np.lexsort(points.T[::-1])
    r, rows = points[order] + 0.0, rows[order]  # no signed zeros
    first = np.flatnonzero(np.r_[True, (np.diff(r[:, :2], axis=0) != 0).any(axis=1)][: len(r)])
    at_place = np.minimum.reduceat(rows, first) if len(r) else rows
    distinct = np.r_[True, (np.diff(r, axis=0) != 0).any(axis=1)][: len(r)]
    r = r[distinct]
    first = np.flatnonzero(np.r_[True, (np.diff(r[:, :2], axis=0) != 0).any(axis=1)][: len(r)])
    count = np.diff(np.r_[first, len(r)])
    height = np.add.reduceat(r[:, 2], first) / count if len(r) else r[:, 2]
    height = np.where(count > 1, height, r[first, 2])
    return np.column_stack([r[first, :2], height, count]), at_place
