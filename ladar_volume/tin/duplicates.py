"""Points that share a footprint, exactly or within a tolerance (seed 000, "duplicate points")."""

from __future__ import annotations

import numpy as np

from ladar_volume.math.equal_rows import first_equal
from ladar_volume.math.kernels import kernel
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I32, I64

#: How far a point is moved at most among others with the same x, before all are sorted anew.
LONG = 200


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
    order = np.argsort(points[:, 0])
    if not order_runs(points, order):
        order = np.lexsort(points.T[::-1])
    return place_kernel(points, rows, order)


@kernel
def order_runs(points: F64, order: I64) -> bool:
    """Bring points (n, 3) that an order (n,) has by x into that by y, then z, where x is the same;
    False where they are so many that this takes long, and are better sorted by other means.
    """
    for i in range(1, len(order)):
        p, k = order[i], i
        while k > 0:
            q = order[k - 1]
            if points[q, 0] != points[p, 0] or points[q, 1] < points[p, 1]:
                break
            if points[q, 1] == points[p, 1] and points[q, 2] <= points[p, 2]:
                break
            if i - k >= LONG:
                return False
            order[k] = q
            k -= 1
        order[k] = p
    return True


@kernel
def place_kernel(points: F64, rows: I64, order: I64) -> tuple[F64, I64]:
    """See :func:`places_and_rows`, of points in their order (n,) by x, y, z."""
    n, k = len(points), -1
    out, least = np.empty((n, 4)), np.empty(n, np.int64)
    before = np.full(3, np.nan)
    for i in order:
        x, y, z = points[i, 0] + 0.0, points[i, 1] + 0.0, points[i, 2] + 0.0  # no signed zeros
        if x != before[0] or y != before[1]:
            k += 1
            out[k, 0], out[k, 1], out[k, 2], out[k, 3], least[k] = x, y, z, 1.0, rows[i]
        else:
            least[k] = min(least[k], rows[i])
            if z != before[2]:
                out[k, 2], out[k, 3] = out[k, 2] + z, out[k, 3] + 1.0
        before[0], before[1], before[2] = x, y, z
    for j in range(k + 1):
        out[j, 2] /= out[j, 3]
    return out[: k + 1].copy(), least[: k + 1].copy()
