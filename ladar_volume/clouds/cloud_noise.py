"""The noise of a cloud's heights, from neighbours that lie across scan lines as well as along them.

A return's nearest neighbours lie on its own scan line, an exact cone through the scanner, which
local fits go through whatever the noise. Neighbours are therefore taken one from each cell of the
size at which the raster of the footprints is filled (see :mod:`ladar_volume.tin.sampled_area`).
Copies of a point count once; coordinates rounded to steps of q have at least the variance q²/12.

The filter has an estimate of its own (:mod:`ladar_volume.clouds.sampling.trimmed_noise`). It tells
the noise along the normal of surfaces of any direction, place by place, of raw sweeps. This one
tells one number for the heights of a surface that has one height per place, which is what a volume
propagates, and roughness between the points counts in it: the triangles have it too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ladar_volume.math.equal_rows import distinct_rows
from ladar_volume.math.kernels import kernel
from ladar_volume.math.nearest import nearest, nearest_index
from ladar_volume.math.own_axes import along_own_axes, extent_where, raster_between
from ladar_volume.math.plane_grid import fullest, nearest_in_grid, plane_grid
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I64, Bool
from ladar_volume.tin.insertion_order import hilbert_order
from ladar_volume.tin.sampled_area import spacings

#: Neighbours of a local fit with six coefficients, and the most points at which one is made.
NEIGHBOURS, MOST_FITS = 18, 20_000
#: Heights that show whether they are rounded.
ENOUGH = 1_000_000
#: Fewest points from which the noise is estimated.
FEWEST = 2 * NEIGHBOURS
#: Cells from which neighbours are taken, in spacings; neighbours at even sampling need none.
CELL = 0.5
#: Residuals beyond this many standard deviations do not count; the variance that this cuts off.
CUT, KEPT = 3.0, 0.9733
#: Points in the fullest cell of a grid with which it is still faster than a tree.
FULL = 100
#: Neighbours whose footprints are this much narrower than they are long lie on one line.
NARROW = 0.2
#: Cells of a raster per point that are cheaper than sorting the points.
RASTER = 8.0
#: Cells of a size that fewer than this share of the points have are rare; of sizes that differ by
#: less than this factor, one does for both.
RARE, ALIKE = 0.01, 1.5


@dataclass(frozen=True)
class CloudNoise:
    """sigma_m : standard deviation of the heights, m · step_m : to which heights are rounded, 0
    where they are not · copies : points that stand where another does · on_lines : share of the
    points whose nearest neighbours do not show the noise, since they lie on one scan line
    """

    sigma_m: float
    step_m: float
    copies: int
    on_lines: float

    @property
    def words(self) -> str:
        """Where the noise comes from."""
        rounded = self.step_m / math.sqrt(12.0) >= 0.5 * self.sigma_m > 0.0
        return (
            "residuals of local quadrics"
            + (" across scan lines" if self.on_lines > 0.5 else "")
            + (f", with the rounding to {1e3 * self.step_m:g} mm" if rounded else "")
        )


def rounding_step(z: F64) -> float:
    """The step that values (n,) are multiples of, apart from a common offset; 0 where there is
    none: fewer than a tenth of them would then be the same.
    """
    levels = np.unique(z)
    if len(levels) < 2 or len(levels) > 0.9 * len(z):
        return 0.0
    precision = 8.0 * np.spacing(np.abs(levels).max())
    gaps = np.diff(levels)
    gaps = gaps[gaps > precision]
    if not len(gaps):
        return 0.0
    step = float(gaps.min())
    # the mean of gaps of one step is better known than the smallest
    step = float(gaps[gaps < 1.5 * step].mean())
    off = np.abs(gaps / step - np.round(gaps / step)) * step
    return step if bool((off <= 4.0 * precision + 1e-3 * step).all()) else 0.0


@kernel
def nearest_in_cells(
    points: F64, chosen: Bool, low: F64, cell_m: float, shift: F64, nearest: I64
) -> None:
    """Write the row of the ``chosen`` (n,) of points (n, 3) that is nearest to the middle of each
    cell of a raster (a, b), whose origin is ``low`` less the shift in cells; -1 stays where there
    is none, and the first of equals is taken.
    """
    distance = np.empty(nearest.shape)
    for i in range(len(points)):
        if not chosen[i]:
            continue
        u = (points[i, 0] - low[0]) / cell_m + shift[0]
        v = (points[i, 1] - low[1]) / cell_m + shift[1]
        x, y = int(np.floor(u)), int(np.floor(v))
        off = (u - x - 0.5) ** 2 + (v - y - 0.5) ** 2
        if nearest[x, y] < 0 or off < distance[x, y]:
            nearest[x, y], distance[x, y] = i, off


def thin_by_cells(
    points: F64,
    cell_m: float,
    shift: tuple[float, float] = (0.0, 0.0),
    chosen: Bool | None = None,
    extent: tuple[F64, F64] | None = None,
) -> I64:
    """Rows (k,) of the ``chosen`` (n,) of points (n, 3), of all by default: in every cell of the
    horizontal plane, shifted by so many cells, the one nearest to its middle; by cells along x, and
    along y in each. extent : least and greatest coordinates (2,) between which the cells lie, where
    the points are a part of others; those of the points by default
    """
    chosen = np.ones(len(points), np.bool_) if chosen is None else chosen
    extent = extent_where(points[:, :2], chosen) if extent is None else extent
    low, size = raster_between(extent, cell_m)
    moved, size = np.array(shift), size + 1
    if float(size[0]) * float(size[1]) <= RASTER * int(np.count_nonzero(chosen)) + 1e4:
        nearest = np.full(size, -1, np.int64)
        nearest_in_cells(points, chosen, low, cell_m, moved, nearest)
        return nearest[nearest >= 0]
    # few points in a wide raster: sorted instead
    own = np.flatnonzero(chosen)
    place = (points[own, :2] - low) / cell_m + moved
    cell = np.floor(place)
    off = ((place - cell - 0.5) ** 2).sum(axis=1)
    order = np.lexsort((off, cell[:, 1], cell[:, 0]))
    same = (np.diff(cell[order], axis=0) == 0).all(axis=1)
    return own[order[np.r_[True, ~same]]]


def fit_residuals(points: F64, near: F64, chosen: I64) -> tuple[F64, F64]:
    """What quadrics through the neighbours ``near`` (k, m, 3) miss the points ``chosen`` (k,) by,
    m, each divided by the standard deviation it has for noise of 1; and how narrow the neighbours'
    footprints are for their length.
    """
    d = near - points[chosen, None]
    size = np.sqrt((d[..., :2] ** 2).sum(axis=2).mean(axis=1))
    u, v = (d[..., k] / np.where(size > 0, size, 1.0)[:, None] for k in (0, 1))
    X = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=2)
    N = X.transpose(0, 2, 1) @ X + 1e-9 * np.eye(6)
    first = np.linalg.solve(N, np.broadcast_to(np.eye(6)[:, :1], (len(N), 6, 1)))[..., 0]
    # the quadric's height over the point itself
    level = np.einsum("nki,ni,nk->n", X, first, d[..., 2])
    return level / np.sqrt(1.0 + np.maximum(first[:, 0], 0.0)), narrowness(d)


def narrowness(d: F64) -> F64:
    """How narrow the footprints of points d (n, k, 3) are for their length, (n,): the ratio of
    their standard deviations along their own axes.
    """
    x, y = (d[..., k] - d[..., k].mean(axis=1, keepdims=True) for k in (0, 1))
    xx, yy, xy = ((a * b).sum(axis=1) for a, b in ((x, x), (y, y), (x, y)))
    half, apart = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    least = np.maximum(xx * yy - xy * xy, 0.0) / np.maximum(half + apart, 1e-300)
    out: F64 = np.sqrt(least / np.maximum(half + apart, 1e-300))
    return out


def nearest_in_plane(xy: F64, places: F64, k: int) -> tuple[I64, F64]:
    """Rows (m, k) of the points (n, 2), m, nearest to places (m, 2), by distance; and the distances
    (m, k), m.
    """
    order, along = hilbert_order(xy), hilbert_order(places)
    flat, at = (np.column_stack([p, np.zeros(len(p))]) for p in (xy[order], places[along]))
    found = order[nearest(nearest_index(flat), at, k)[0]]
    square = ((xy[found] - places[along, None]) ** 2).sum(axis=2)
    first = np.lexsort((found, square), axis=1)
    rows, far = np.empty((len(places), k), np.int64), np.empty((len(places), k))
    rows[along] = np.take_along_axis(found, first, axis=1)
    far[along] = np.sqrt(np.take_along_axis(square, first, axis=1))
    return rows, far


def neighbours(points: F64, kept: I64, chosen: I64) -> F64:
    """Of the points ``kept``, rows (k,) of (n, 3), the nearest (m, NEIGHBOURS, 3) to those
    ``chosen`` (m,), themselves not.
    """
    k = NEIGHBOURS + 1
    xy, places = points[kept, :2], points[chosen, :2]
    grid = plane_grid(xy)
    if fullest(grid) * len(chosen) > len(xy) + FULL * len(chosen):
        found = nearest_in_plane(xy, places, k)[0]
    else:
        found, square = np.empty((len(chosen), k), np.int64), np.empty((len(chosen), k))
        nearest_in_grid(grid, places, found, square)
    near = kept[found]
    own = near == chosen[:, None]
    own[~own.any(axis=1), -1] = True
    out: F64 = points[near[~own].reshape(-1, NEIGHBOURS)]
    return out


def robust_sigma(residuals: F64, floor: float) -> float:
    """Root mean square of residuals (k,) within three of itself, as for Gaussian noise; where most
    of them are the same, as rounding makes them, the median says nothing.
    """
    size = np.abs(residuals[np.isfinite(residuals)])
    if not len(size):
        return floor
    sigma = max(1.4826 * float(np.median(size)), floor)
    for _ in range(20):
        inside = size[size <= CUT * sigma]
        new = max(math.sqrt(float((inside**2).mean()) / KEPT), floor) if len(inside) else sigma
        if abs(new - sigma) <= 1e-6 * sigma:
            break
        sigma = new
    return sigma


def common_cells(cells: F64) -> F64:
    """Cells (m,), m, those that are rare replaced by the nearest in size that is not, where that is
    about as large: each size costs a search of its own.
    """
    size, count = np.unique(cells[np.isfinite(cells)], return_counts=True)
    many = size[count >= RARE * len(cells)]
    out = cells.copy()
    for value in np.setdiff1d(size, many).tolist():
        ratio = np.abs(np.log(many / value))
        if len(many) and ratio.min() < math.log(ALIKE):
            out[cells == value] = many[np.argmin(ratio)]
    return out


def cloud_noise(points: F64) -> CloudNoise:
    """The noise of the heights of points (n, 3), m.

    Roughness finer than the neighbourhood counts as noise. Raises :class:`SurfaceError` below
    :data:`FEWEST` distinct footprints.
    """
    step = rounding_step(points[:: max(1, len(points) // ENOUGH), 2])
    first = distinct_rows(points[:, :2])
    copies = len(points) - len(first)
    own = points[first]
    if len(own):
        own = np.column_stack([along_own_axes(own[:, :2]), own[:, 2]])
    if len(own) < FEWEST:
        words = f"{len(own)} points are too few to estimate their noise ({FEWEST} are needed)"
        raise SurfaceError(words, reason="surface_too_few_points", value=len(own))
    floor = step / math.sqrt(12.0)
    chosen = np.unique(np.linspace(0, len(own) - 1, min(len(own), MOST_FITS)).astype(np.int64))
    residual, narrow = fit_residuals(own, neighbours(own, np.arange(len(own)), chosen), chosen)
    cells = common_cells(CELL * spacings(own[:, :2], chosen))
    lines = 0.0
    for cell in np.unique(cells[np.isfinite(cells)]).tolist():
        kept = thin_by_cells(own, cell)
        if len(kept) < FEWEST:
            continue
        at = np.flatnonzero(cells == cell)
        across, wide = fit_residuals(own, neighbours(own, kept, chosen[at]), chosen[at])
        # where neighbours lie along a line, those across it tell more
        on_line = narrow[at] < NARROW * np.minimum(1.0, wide / NARROW)
        lines += float(np.count_nonzero(on_line))
        residual[at] = np.where(np.isfinite(across), across, residual[at])
    return CloudNoise(robust_sigma(residual, floor), step, copies, lines / len(chosen))
