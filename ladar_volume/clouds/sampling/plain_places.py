"""Points that lie on a plane with all those around them: nothing there needs a closer look.

The points of a cell and of the eight around it, of a raster with a few points a cell, are on a
plane where one of least squares leaves no more than their noise. Sums over each cell tell that, so
it costs one pass over the points, where neighbours cost a search each.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ladar_volume.math.kernels import inlined, kernel, leaf_kernel
from ladar_volume.math.own_axes import extent_of
from ladar_volume.model.records import F64, I64, Bool

#: Mean number of points in a cell, and fewest in a block of nine cells.
MEAN, FEWEST = 4.0, 18
#: A block is plain where its residuals are no larger than so many times the noise, root mean
#: square, and its points as spread as this share of a square cell, along any direction.
ROUGH, SPREAD = 1.3, 0.3
#: A point of a plain block is plain within so many standard deviations of its plane.
WITHIN = 3.5


@leaf_kernel
def add_block(total: F64, own: F64, dx: float, dy: float) -> None:
    """Add the sums (10,) of a cell whose middle lies at (dx, dy) from that of the block: of 1, x,
    y, z, x², xy, y², xz, yz and z².
    """
    n, x, y, z = own[0], own[1], own[2], own[3]
    total[0], total[1], total[2], total[3] = (
        total[0] + n,
        total[1] + x + n * dx,
        total[2] + y + n * dy,
        total[3] + z,
    )
    total[4] += own[4] + 2.0 * dx * x + n * dx * dx
    total[5] += own[5] + dx * y + dy * x + n * dx * dy
    total[6] += own[6] + 2.0 * dy * y + n * dy * dy
    total[7] += own[7] + dx * z
    total[8] += own[8] + dy * z
    total[9] += own[9]


@inlined
def cell_sums(r: F64, low: F64, size: float, first: I64, sums: F64) -> None:
    """Add points (n, 3) to the sums (a, b, 10) of their cells from the ``first`` (2,) on, about the
    middle of each.
    """
    for i in range(len(r)):
        u, v, z = (r[i, 0] - low[0]) / size, (r[i, 1] - low[1]) / size, r[i, 2]
        own = sums[int(u) - first[0], int(v) - first[1]]
        x, y = u - int(u) - 0.5, v - int(v) - 0.5
        own[0] += 1.0
        own[1] += x
        own[2] += y
        own[3] += z
        own[4] += x * x
        own[5] += x * y
        own[6] += y * y
        own[7] += x * z
        own[8] += y * z
        own[9] += z * z


@leaf_kernel
def block_plane(t: F64, rough_m: float, plane: F64) -> None:
    """Write height and slopes (3,) of the plane through a block with sums (10,), the slopes by the
    side of a cell; NaN where it is not plain.
    """
    plane[0] = np.nan
    n = t[0]
    if n < FEWEST:
        return
    x, y, z = t[1] / n, t[2] / n, t[3] / n
    xx, xy, yy = t[4] / n - x * x, t[5] / n - x * y, t[6] / n - y * y
    half, det = 0.5 * (xx + yy), xx * yy - xy * xy
    if not half - math.sqrt(max(half * half - det, 0.0)) > SPREAD:
        return
    xz, yz, zz = t[7] / n - x * z, t[8] / n - y * z, t[9] / n - z * z
    gx, gy = (yy * xz - xy * yz) / det, (xx * yz - xy * xz) / det
    if not n * (zz - gx * xz - gy * yz) <= (n - 3.0) * rough_m * rough_m:
        return
    plane[0], plane[1], plane[2] = z - gx * x - gy * y, gx, gy


@inlined
def block_planes(sums: F64, rough_m: float, planes: F64) -> None:
    """Write the planes (a, b, 3) of the blocks around all cells; their heights are NaN where they
    are not plain.
    """
    a, b, total = sums.shape[0], sums.shape[1], np.empty(10)
    for i in range(a):
        for j in range(b):
            planes[i, j, 0] = np.nan
            if sums[i, j, 0] == 0.0:
                continue
            total[:] = 0.0
            for k in range(max(i - 1, 0), min(i + 2, a)):
                for m in range(max(j - 1, 0), min(j + 2, b)):
                    if sums[k, m, 0] > 0.0:
                        add_block(total, sums[k, m], float(k - i), float(m - j))
            block_plane(total, rough_m, planes[i, j])


@kernel
def plain_kernel(r: F64, low: F64, size: float, sigma_m: float) -> Bool:
    """See :func:`plain_points`; the cells that hold points, of a raster from ``low`` (2,) on."""
    first, last = np.full(2, np.iinfo(np.int64).max), np.full(2, -1)
    for i in range(len(r)):
        for k in range(2):
            cell = int((r[i, k] - low[k]) / size)
            first[k], last[k] = min(first[k], cell), max(last[k], cell)
    a, b = max(last[0] - first[0] + 1, 0), max(last[1] - first[1] + 1, 0)
    sums, planes = np.zeros((a, b, 10)), np.empty((a, b, 3))
    cell_sums(r, low, size, first, sums)
    block_planes(sums, ROUGH * sigma_m, planes)
    out = np.empty(len(r), np.bool_)
    for i in range(len(r)):
        u, v = (r[i, 0] - low[0]) / size, (r[i, 1] - low[1]) / size
        own = planes[int(u) - first[0], int(v) - first[1]]
        x, y = u - int(u) - 0.5, v - int(v) - 0.5
        out[i] = abs(r[i, 2] - own[0] - own[1] * x - own[2] * y) <= WITHIN * sigma_m
    return out


def plain_points(r: F64, sigma_m: float) -> Bool:
    """Which (n,) of points (n, 3) m, whose heights have a noise of ``sigma_m``, lie on a plane with
    all those around them.
    """
    low, high = extent_of(r[:, :2])
    middle = 0.5 * float(r[:, 2].min() + r[:, 2].max())
    return plain_in_cells(r, PlainCells(low, cell_side(low, high, len(r)), middle), sigma_m)


@dataclass(frozen=True)
class PlainCells:
    """low : (2,) m, where the raster begins · side : of a cell, m · middle : height about which
    sums are taken, m
    """

    low: F64
    side: float
    middle: float


def cell_side(low: F64, high: F64, count: int) -> float:
    """The side of a cell, m, for so many points between coordinates (2,), m."""
    wide = high - low
    return max(math.sqrt(float(wide.prod()) * MEAN / count), float(wide.max()) / count, 1e-300)


def plain_in_cells(r: F64, cells: PlainCells, sigma_m: float) -> Bool:
    """:func:`plain_points` with the cells that all points have, of which these may be a part."""
    about = r - [0.0, 0.0, cells.middle]
    return np.asarray(plain_kernel(about, cells.low, cells.side, sigma_m))
