"""Axes and rasters that turn and move with the points: what is told with cells along the axes of
the coordinates changes when the same points are turned.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ladar_volume.math.kernels import kernel

F64 = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]
#: Share of the mean square distance from the centroid above which the second moment shows a long
#: direction; below it the fourth moment shows that of the sides.
LONG = 0.05
#: The middle of places is rounded to their extent over so many times 2, angles to one over this.
MIDDLE_BITS, ANGLE = 20, 2.0**40
#: Places that are summed at once.
PART = 1024


@dataclass(frozen=True)
class OwnAxes:
    """middle : (2,) m · angle : of the first axis. Both are rounded, so that they do not depend on
    the order in which the places are summed, nor what lies on the edge of a cell.
    """

    middle: F64
    angle: float

    def along(self, xy: F64) -> F64:
        """Places (n, 2) m about the middle along these axes."""
        x, y = self.middle.tolist()
        return np.asarray(turned(xy, x, y, math.cos(self.angle), math.sin(self.angle)))


@kernel
def turned(xy: F64, x0: float, y0: float, c: float, s: float) -> F64:
    """Places (n, 2) about (x0, y0) along axes at an angle with this cosine and sine."""
    out = np.empty((len(xy), 2))
    for i in range(len(xy)):
        x, y = xy[i, 0] - x0, xy[i, 1] - y0
        out[i, 0], out[i, 1] = c * x + s * y, c * y - s * x
    return out


def rounded_middle(mean: F64, extent: tuple[F64, F64]) -> F64:
    """The mean (2,) m of places with least and greatest coordinates (2,), to a millionth of these
    or less.
    """
    step = 2.0 ** (math.frexp(float((extent[1] - extent[0]).max()))[1] - MIDDLE_BITS)
    out: F64 = np.rint(mean / step) * step
    return out if np.isfinite(out).all() else mean


def moments_about(xy: F64, middle: F64) -> F64:
    """Sums (5,) over places (n, 2) m about a middle (2,), as complex numbers z: of z² and z⁴, real
    and imaginary parts, and of the size of z².
    """
    out: F64 = np.asarray(moment_parts(xy, middle)).sum(axis=0)
    return out


@kernel
def moment_parts(xy: F64, middle: F64) -> F64:
    """The sums (k, 5) of :func:`moments_about` over every :data:`PART` places: a sum of few sums
    has all its digits.
    """
    out = np.zeros((len(xy) // PART + 1, 5))
    for i in range(len(xy)):
        x, y, own = xy[i, 0] - middle[0], xy[i, 1] - middle[1], out[i // PART]
        u, v = x * x - y * y, 2.0 * x * y
        own[0] += u
        own[1] += v
        own[2] += u * u - v * v
        own[3] += 2.0 * u * v
        own[4] += math.hypot(u, v)
    return out


def axes_of(middle: F64, moments: F64) -> OwnAxes:
    """The axes of places from :func:`moments_about` their middle.

    The direction is the argument of the mean of z² or, where they are about as long as wide, of
    -z⁴, which for a square is that of its sides.
    """
    second, fourth = complex(*moments[:2]), complex(*moments[2:4])
    angle = np.angle(second) / 2.0
    if abs(second) <= LONG * moments[4]:
        angle = np.angle(-fourth) / 4.0
    return OwnAxes(middle, float(np.rint(angle * ANGLE) / ANGLE))


def along_own_axes(xy: F64) -> F64:
    """Places (n, 2) m about their centroid, turned so that their long direction is the first
    axis.
    """
    mean = np.array([xy[:, 0].mean(), xy[:, 1].mean()])  # by column: summed in pairs
    middle = rounded_middle(mean, extent_of(xy))
    return axes_of(middle, moments_about(xy, middle)).along(xy)


@kernel
def extent_of(xy: F64) -> tuple[F64, F64]:
    """Least and greatest coordinates (2,) m of places (n, 2) m."""
    x0, y0, x1, y1 = np.inf, np.inf, -np.inf, -np.inf
    for i in range(len(xy)):
        x, y = xy[i, 0], xy[i, 1]
        x0, x1 = x if x < x0 else x0, x if x > x1 else x1
        y0, y1 = y if y < y0 else y0, y if y > y1 else y1
    return np.array([x0, y0]), np.array([x1, y1])


@kernel
def extent_where(xy: F64, chosen: Bool) -> tuple[F64, F64]:
    """:func:`extent_of` the ``chosen`` (n,) of places (n, 2) m."""
    x0, y0, x1, y1 = np.inf, np.inf, -np.inf, -np.inf
    for i in range(len(xy)):
        if chosen[i]:
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
