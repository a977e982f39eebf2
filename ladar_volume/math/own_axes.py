"""Axes and rasters that turn and move with the points: what is told with cells along the axes of
the coordinates changes when the same points are turned.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ladar_volume.math.kernels import kernel

F64 = npt.NDArray[np.float64]
#: Share of the mean square distance from the centroid above which the second moment shows a long
#: direction; below it the fourth moment shows that of the sides.
LONG = 0.05


def along_own_axes(xy: F64) -> F64:
    """Places (n, 2) m about their centroid, turned so that their long direction is the first axis.

    The direction is that of the moments of the places, as complex numbers z: the argument of the
    mean of z² or, where they are about as long as wide, of -z⁴, which for a square is that of its
    sides.
    """
    middle, z = xy.mean(axis=0), np.empty(len(xy), np.complex128)
    z.real, z.imag = xy[:, 0] - middle[0], xy[:, 1] - middle[1]
    square = z * z
    second, size = square.mean(), float(np.abs(square).mean())
    angle = np.angle(second) / 2.0
    if abs(second) <= LONG * size:
        square *= square
        angle = np.angle(-square.mean()) / 4.0
    del square  # the places of a whole cloud take much memory
    z *= np.exp(-1j * angle)
    return z.view(np.float64).reshape(-1, 2)


@kernel
def extent_of(xy: F64) -> tuple[F64, F64]:
    """Least and greatest coordinates (2,) m of places (n, 2) m."""
    x0, y0, x1, y1 = np.inf, np.inf, -np.inf, -np.inf
    for i in range(len(xy)):
        x, y = xy[i, 0], xy[i, 1]
        x0, x1 = x if x < x0 else x0, x if x > x1 else x1
        y0, y1 = y if y < y0 else y0, y if y > y1 else y1
    return np.array([x0, y0]), np.array([x1, y1])


def raster_of(xy: F64, cell_m: float) -> tuple[F64, npt.NDArray[np.int64]]:
    """Lower corner (2,) m and numbers of cells (2,) of a raster over places (n, 2) m, half a cell
    or less beyond the outermost, as much on either side: mirrored places have mirrored cells.
    """
    return raster_between(extent_of(xy), cell_m)


def raster_between(extent: tuple[F64, F64], cell_m: float) -> tuple[F64, npt.NDArray[np.int64]]:
    """:func:`raster_of` places with least and greatest coordinates (2,), m."""
    low, high = extent
    count = np.rint((high - low) / cell_m) + 1.0
    return 0.5 * (low + high) - 0.5 * count * cell_m, count.astype(np.int64)
