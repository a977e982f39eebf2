"""The deviation of the ground from its base as a random field, and what it does to a volume.

The field acts twice: through the fit of the base, and under the body, where the ground is not seen.
Both are one linear functional of the field, ``Σ w e``, with the outline's area as weight inside and
the fit's weights outside; its variance ``s² Σ_ij w_i w_j rho(d_ij)`` is summed on a grid by FFT.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.fft import dctn, next_fast_len, rfft2

from ladar_volume.math.kernels import kernel
from ladar_volume.model.records import F64, I32
from ladar_volume.tin.full_tin import first_corner

#: Distances whose correlations are computed at a time, of half a million: all of them would pass
#: through memory for each operation.
IN_CACHE = 1 << 13
#: Squares of the grid along its longer side.
MAX_CELLS = 400
#: Times a triangle can be halved until it is as small as a square: its diameter falls by a factor
#: of 0.87 at least with every second time (Rosenberg and Stenger 1975, SIAM Journal on Numerical
#: Analysis 12, 390).
HALVINGS = 128


@dataclass(frozen=True)
class Roughness:
    """variance_m2 : s², m² · length_m : L, m · spacing_m : mean distance of the points it was
    estimated from · gaussian : share g of the Gaussian correlation, the rest is exponential
    """

    variance_m2: float
    length_m: float
    spacing_m: float
    gaussian: float = 0.0

    def correlation(self, d: F64) -> F64:
        """Correlation at distances d, m."""
        out, flat = np.empty(np.shape(d)), np.ravel(d)
        for first in range(0, flat.size, IN_CACHE):
            out.reshape(-1)[first : first + IN_CACHE] = self._correlation(
                flat[first : first + IN_CACHE]
            )
        return out

    def _correlation(self, d: F64) -> F64:
        x, g = d / self.length_m, self.gaussian
        if 0.0 < g < 1.0:
            return np.asarray((1.0 - g) * np.exp(-x) + g * np.exp(-0.5 * x * x))
        return np.asarray(np.exp(-x) if g == 0.0 else np.exp(-0.5 * x * x))


@dataclass(frozen=True)
class GroundField:
    """How the deviation of the ground from its base enters a volume: with its mean over triangles
    that hide it, and at points.

    vertices : (v, 2 or 3) m · triangles : (t, 3) · area : (t,) m² with which each counts, most
    often 0 · xy : (s, 2) m · weight : (s,) m² · rough : the deviation
    """

    vertices: F64
    triangles: I32
    area: F64
    xy: F64
    weight: F64
    rough: Roughness

    @property
    def variance_m6(self) -> float:
        """Variance of what the deviation adds to the volume, m⁶: ``Σ w_i w_j C(d_ij)`` on a grid,
        by FFT.
        """
        rough = self.rough
        low, high = field_bounds(self.vertices, self.triangles, self.area, self.xy)
        if rough.variance_m2 == 0.0 or not (low <= high).all():
            return 0.0
        h, shape = field_squares(rough, low, high)
        grid = squares_grid(self.xy, self.weight, low, h, shape)
        spread_kernel(self.vertices, self.triangles, self.area, low, h, grid)
        return variance_on_squares(rough, grid, h, float(self.weight @ self.weight))


def field_squares(rough: Roughness, low: F64, high: F64) -> tuple[float, tuple[int, int]]:
    """Side, m, and numbers of the squares on which a field is summed, from ``low`` to ``high``
    (2,).
    """
    h = max(rough.spacing_m, float((high - low).max()) / MAX_CELLS, 1e-9)
    nx, ny = (int(s) + 1 for s in (high - low) / h)
    return h, (nx, ny)


def variance_on_squares(rough: Roughness, grid: F64, h: float, own: float) -> float:
    """Variance, m⁶, of a field's deviations with weights summed by squares (a, b) of side h, m; own
    : sum of the squared weights of points, m⁴.
    """
    half = [
        next_fast_len(s, real=True) for s in grid.shape
    ]  # of a torus on which the grid does not reach round
    quarter = rough.correlation(
        h * np.hypot(np.arange(half[0] + 1)[:, None], np.arange(half[1] + 1))
    )
    # two points of one cell are 0.52 h apart on average; for L below h the cell's mean
    # correlation is its integral over its area
    quarter[0, 0] = min(
        float(rough.correlation(np.array(0.5214 * h))), 2 * math.pi * (rough.length_m / h) ** 2
    )
    power = np.abs(rfft2(grid, s=[2 * s for s in half])) ** 2  # by Parseval's theorem: no way back
    spectrum = dctn(quarter, type=1)  # of the even kernel whose quarter it is
    folded = power[: half[0] + 1].copy()
    folded[1 : half[0]] += power[: half[0] : -1]
    folded[:, 1 : half[1]] *= 2.0
    total = float((folded * spectrum).sum()) / (4.0 * half[0] * half[1])
    # a point is fully correlated with itself, not as two points of one cell are
    return rough.variance_m2 * max(0.0, total + (1.0 - float(quarter[0, 0])) * own)


#: Squares along the longer side of the grid on which occupied ground is counted.
OCCUPIED = 40


def mean_spacing(xy: F64) -> float:
    """Side (m) of the square that one of the points (n, 2) occupies on average: of the occupied
    cells of a coarse grid.
    """
    low, high = xy.min(axis=0), xy.max(axis=0)
    side = occupied_side(low, high)
    grid = squares_grid(xy, np.ones(len(xy)), low, side, (OCCUPIED + 1, OCCUPIED + 1))
    return spacing_of(int(np.count_nonzero(grid)), side, len(xy))


def occupied_side(low: F64, high: F64) -> float:
    """Side, m, of the squares on which occupied ground from ``low`` to ``high`` (2,) is counted."""
    return max(float((high - low).max()) / OCCUPIED, 1e-9)


def spacing_of(occupied: int, side: float, count: int) -> float:
    """:func:`mean_spacing` of so many points on so many squares."""
    return math.sqrt(occupied * side * side / count)


@kernel
def field_bounds(vertices: F64, triangles: I32, area: F64, xy: F64) -> tuple[F64, F64]:
    """Least and greatest x and y, (2,) each, of points (n, 2) and of the corners of the triangles
    whose area (t,) is not 0.
    """
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for i in range(len(xy)):
        for c in range(2):
            low[c], high[c] = min(low[c], xy[i, c]), max(high[c], xy[i, c])
    for t in range(len(triangles)):
        if area[t] != 0.0:
            for corner in triangles[t]:
                for c in range(2):
                    low[c], high[c] = (
                        min(low[c], vertices[corner, c]),
                        max(high[c], vertices[corner, c]),
                    )
    return low, high


@kernel
def squares_grid(xy: F64, weight: F64, low: F64, side: float, shape: tuple[int, int]) -> F64:
    """Sums ``shape`` of the weights (n,) of points xy (n, 2) by square from ``low`` (2,) on."""
    grid = np.zeros(shape)
    for i in range(len(xy)):
        grid[int((xy[i, 0] - low[0]) / side), int((xy[i, 1] - low[1]) / side)] += weight[i]
    return grid


@kernel
def spread_kernel(
    vertices: F64, triangles: I32, area: F64, low: F64, side: float, grid: F64
) -> None:
    """Adds the areas (t,) of triangles to the squares of :func:`squares_grid` over which they lie:
    each halved across its longest edge until none is longer than a square, at the centroids of the
    parts. At the centroid of the whole, the few large triangles that close a body on its ground
    would feel the field at a few points, and not its mean.
    """
    stack = np.empty((HALVINGS, 7))  # three corners and a weight
    for t in range(len(triangles)):
        if area[t] == 0.0:
            continue
        corner = first_corner(vertices, triangles, t)
        first = 0 if corner == triangles[t, 0] else 1 if corner == triangles[t, 1] else 2
        for k in range(3):  # from the first: of equal edges the same is halved, however numbered
            at = vertices[triangles[t, (first + k) % 3]]
            stack[0, 2 * k], stack[0, 2 * k + 1] = at[0], at[1]
        stack[0, 6], left = area[t], 1
        while left > 0:
            left -= 1
            ax, ay, bx, by, cx, cy, w = stack[left]
            bc, ca, ab = (
                (bx - cx) ** 2 + (by - cy) ** 2,
                (cx - ax) ** 2 + (cy - ay) ** 2,
                (ax - bx) ** 2 + (ay - by) ** 2,
            )
            if max(bc, ca, ab) <= side * side:
                grid[
                    int(((ax + bx + cx) / 3.0 - low[0]) / side),
                    int(((ay + by + cy) / 3.0 - low[1]) / side),
                ] += w
                continue
            if ca >= bc and ca >= ab:  # the longest edge is made that from b to c
                ax, ay, bx, by, cx, cy = bx, by, cx, cy, ax, ay
            elif ab >= bc:
                ax, ay, bx, by, cx, cy = cx, cy, ax, ay, bx, by
            mx, my = 0.5 * (bx + cx), 0.5 * (by + cy)
            stack[left] = ax, ay, bx, by, mx, my, 0.5 * w
            stack[left + 1] = ax, ay, mx, my, cx, cy, 0.5 * w
            left += 2
