"""What lies between the points: how far a surface may be from the truth where nothing was measured,
told from what becomes of it when points are left out.

One point is kept of each cell that is wider than the spacing; the volume of the coarser surface
differs, cell by cell. Where a step crosses the cells at random the differences are independent and
their variance goes with the cube of the spacing (as for pixel counts along an edge); where the
surface is curved they add up, with its square (the chord of a parabola). Both are taken back to the
spacing of all points. What the noise of the points does to the differences is taken off.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from ladar_volume.clouds.cloud_noise import thin_by_cells
from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.math.equal_rows import few_values
from ladar_volume.math.kernels import kernel, leaf_kernel
from ladar_volume.math.own_axes import along_own_axes, extent_of, raster_between, raster_of
from ladar_volume.model.records import F64, I32, I64, Bool, Tin
from ladar_volume.tin.full_tin import build_tin, first_corner, places_in, vertex_mask
from ladar_volume.tin.locate import barycentric, locate_in_delaunay
from ladar_volume.tin.relevant import circumdiameters
from ladar_volume.tin.sampled_area import FEWEST, fill_cells, look_up

#: Cells of the coarser surface, in spacings; blocks of differences, in such cells.
CELL, BLOCK = 1.5, 3.0
#: The coarser surface is made as often, its cells shifted by so many.
SHIFTS = ((0.0, 0.0), (0.5, 0.5), (0.5, 0.0), (0.0, 0.5))
#: Triangles that are enough, of all coarser surfaces together; where one has more, those in squares
#: of so many spacings, spread evenly over the outline, stand for all.
ENOUGH, SQUARE = 400_000, 30.0
#: A coarser surface is made of what lies within so many spacings of where it is compared, and more:
#: triangles there are those of all. Most cells of the raster that tells it.
AROUND, MOST_CELLS = 12.0, 1e8
#: The golden section.
GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
#: A sum of differences above this many times the root of its squares is no chance.
CHANCE = 2.5
#: Weights of the centre and of each corner of a triangle: exact for quadratics.
CENTRE, CORNER = 9.0 / 12.0, 1.0 / 12.0
#: A place is on an edge whose barycentric coordinate is less.
ON_EDGE = 1e-9


@dataclass(frozen=True)
class BetweenPoints:
    """random_m6 : variance of the volume from steps between points · drift_m3 : what curvature
    between them may do to it, all in one direction · unseen_m3 : how far it may be off where
    triangles bridge what was not sampled
    """

    random_m6: float
    drift_m3: float
    unseen_m3: float

    @property
    def variance_m6(self) -> float:
        """Steps and curvature, as a variance."""
        return self.random_m6 + self.drift_m3**2


def thin_by_spacing(points: F64, spacing: F64, shift: tuple[float, float]) -> I64:
    """Rows (k,) of places (n, 2): one of each cell of 1.5 spacings (n,), shifted by so many."""
    out = [
        thin_by_cells(points, CELL * size, shift, spacing == size) for size in few_values(spacing)
    ]
    return np.concatenate(out) if out else np.zeros(0, np.int64)


def wide(tin: Tin, area: F64) -> float:
    """Circumdiameter, m, that half of an area (m,) m² of triangles is below."""
    some = np.flatnonzero(area > 0)
    size = circumdiameters(tin.vertices, tin.triangles[some])
    order = np.argsort(size)
    share = np.cumsum(area[some][order])
    return float(size[order][min(np.searchsorted(share, share[-1] / 2), len(size) - 1)])


def between_points(
    surface: CloudSurface, inside: F64, height: F64, unknown: Bool | None = None
) -> BetweenPoints:
    """What lies between the points of a surface within an outline; ``inside`` (m,) m² is the area
    of each triangle in it, height (n,) m that of the vertices above the base · unknown : (m,)
    triangles whose gaps nothing else tells of, None for all. Steps and curvature are 0 where the
    points are too few to tell.
    """
    tin = surface.representation.tin
    bridged = bridges(surface) & (inside > 0.0)
    hidden = bridged_deviation(
        tin, inside, height, bridged if unknown is None else bridged & unknown
    )
    spacing, own = surface.spacing_m, along_own_axes(tin.vertices[:, :2])
    if np.count_nonzero(inside > 0.0) - np.count_nonzero(bridged) < FEWEST:
        return BetweenPoints(0.0, 0.0, hidden)
    seen, share = some_squares(tin, inside, bridged, spacing, own)
    kept = [
        thin_by_spacing(own, spacing, shift)
        for shift in shifts_for(int(np.count_nonzero(seen > 0)))
    ]
    if any(len(rows) < FEWEST // 4 for rows in kept):
        return BetweenPoints(0.0, 0.0, hidden)
    finest, near = wide(tin, seen), near_triangles(tin, own, seen, spacing)
    part, number = compared_part(surface, seen, own, near)
    del own, seen
    found = [coarser(part, number[rows[near[rows]]].astype(np.int64)) for rows in kept]
    return from_coarser(found, finest, share, hidden)


def shifts_for(triangles: int) -> tuple[tuple[float, float], ...]:
    """The shifts of the cells at which so many triangles are compared: chosen squares may hold a
    tenth fewer than are enough.
    """
    return SHIFTS[: math.ceil(0.9 * ENOUGH / triangles)]


def from_coarser(
    found: list[tuple[F64, float, float]], finest: float, share: float, hidden: float
) -> BetweenPoints:
    """What lies between points whose triangles are as wide as ``finest``, m, from what
    :func:`coarser` tells of ``share`` of the area.
    """
    squares, totals, few = [], [], []
    for blocks, _, _ in found:
        squares.append(float((blocks**2).sum()))
        # a variance from few blocks is itself uncertain
        few.append(2.0 * float((blocks**4).sum()) / max(squares[-1] ** 2, 1e-300))
        totals.append(float(blocks.sum()))
    noise = float(np.mean([noise for _, noise, _ in found]))
    ratio = float(np.median([size / max(finest, 1e-300) for _, _, size in found]))
    square = float(np.mean(squares))
    if not ratio > 1.2:
        return BetweenPoints(0.0, 0.0, hidden)
    more = 1.0 + float(np.mean(few))
    random = more * max(square - noise, 0.0) / (ratio**3 - 1.0)
    # chance alone makes a sum of twice the root of its squares
    total = float(np.mean(totals))
    excess = total**2 - CHANCE**2 * max(square, noise)
    drift = abs(total) / (ratio**2 - 1.0) if excess > 0 else 0.0
    return BetweenPoints(random / share, drift / share, hidden)


@kernel
def chosen_squares(corner: F64, low: F64, side: float, every: int, step: int) -> Bool:
    """Triangles (m,) whose first corner (m, 2) m, by x, then y, lies in one of ``every`` so many
    squares of a raster, ``step`` squares on from row to row.
    """
    out = np.empty(len(corner), np.bool_)
    for i in range(len(corner)):
        u, v = np.floor((corner[i, 0] - low[0]) / side), np.floor((corner[i, 1] - low[1]) / side)
        out[i] = (int(u) + step * int(v)) % every == 0
    return out


def row_step(every: int) -> int:
    """By how many squares the chosen ones move on from row to row: the number next to the golden
    section of ``every`` that shares no divisor with it. They then lie evenly over an outline of any
    size: with a short step, as a knight's, and more squares than a row has, all lay on a line.
    """
    near = round(GOLDEN * every)
    steps = (near + off * sign for off in range(every) for sign in (-1, 1))
    return next(step for step in steps if 0 < step <= every and math.gcd(step, every) == 1)


def squares_every(triangles: int) -> int:
    """Of how many squares one is looked at, for so many triangles."""
    return math.ceil(triangles / ENOUGH)


def some_squares(tin: Tin, inside: F64, bridged: Bool, spacing: F64, xy: F64) -> tuple[F64, float]:
    """The areas (m,) m² of triangles within the outline, 0 for those ``bridged`` (m,) and for those
    that others stand for; and what part of the area is left. xy : (n, 2) m, the vertices along
    their own axes.
    """
    every = squares_every(int(np.count_nonzero(inside > 0.0) - np.count_nonzero(bridged)))
    side = SQUARE * float(np.median(spacing))
    if every < 2 or not math.isfinite(side):
        return np.where(bridged, 0.0, inside), 1.0
    low, _ = raster_of(xy, side)
    # asked of the vertices: there are half as many as triangles
    chosen = chosen_squares(xy, low, side, every, row_step(every))
    kept = np.asarray(chosen_areas(tin.vertices, tin.triangles, chosen, inside, bridged))
    return kept, float(kept.sum() / (inside.sum() - inside[bridged].sum()))


@kernel
def chosen_areas(vertices: F64, triangles: I32, chosen: Bool, inside: F64, bridged: Bool) -> F64:
    """The areas (m,) m² of triangles whose first corner is ``chosen`` (n,), 0 of others and of
    those ``bridged`` (m,).
    """
    out = np.zeros(len(inside))
    for t in range(len(inside)):
        if inside[t] > 0.0 and not bridged[t] and chosen[first_corner(vertices, triangles, t)]:
            out[t] = inside[t]
    return out


def near_triangles(tin: Tin, xy: F64, inside: F64, spacing: F64) -> Bool:
    """Which vertices (n,) lie in the square cells of corners of triangles within the outline, or
    beside them, cells of :data:`AROUND` spacings: those that a coarser surface is made of there.
    xy : (n, 2) m, the vertices along their own axes
    """
    side = AROUND * float(np.median(spacing))
    if not (math.isfinite(side) and side > 0.0):
        return np.ones(len(xy), np.bool_)
    low, size = raster_of(xy, side)
    if float(size[0]) * float(size[1]) > MOST_CELLS:
        return np.ones(len(xy), np.bool_)
    marked, out = np.zeros(size + 4, np.bool_), np.empty(len(xy), np.bool_)
    fill_cells(xy[vertex_mask(tin, inside > 0)], low, side, marked)
    marked = ndimage.binary_dilation(marked, np.ones((3, 3), np.bool_))
    look_up(xy, np.zeros(0, np.int64), low, side, marked, out)
    return out


class Part(NamedTuple):
    """What is compared of a surface, and what lies around it. vertices : (n, 3) m · xy : (n, 2) m,
    along the axes of the whole · noise_m2 : (n,) variance of each from the noise of its point ·
    corners : (m, 3) of the triangles that are compared · area : (m,) m² of these within the outline
    """

    vertices: F64
    xy: F64
    noise_m2: F64
    corners: I32
    area: F64


def compared_part(surface: CloudSurface, inside: F64, xy: F64, near: Bool) -> tuple[Part, I32]:
    """The triangles of which some area (m,) m² lies ``inside``, with the vertices that are ``near``
    (n,) them: all of theirs, and more; and the number of each vertex (n,) in it. xy : (n, 2) m, the
    vertices along their own axes
    """
    tin, rows, own = surface.representation.tin, np.flatnonzero(near), np.flatnonzero(inside > 0)
    number = places_in(rows, len(near))
    noise = np.zeros(len(rows))
    if surface.sigma_m is not None:
        source = tin.source[rows]
        noise = np.where(source >= 0, surface.sigma_m[source], 0.0) ** 2
    vertices, area = tin.vertices[rows], inside[own]
    return Part(vertices, xy[rows], noise, number[tin.triangles[own]], area), number


class Places(NamedTuple):
    """Places on a surface. z : (p,) m, its height there · where : (p,) triangle of the coarser
    surface there, -1 for none · coarse : (p, 3) barycentric coordinates in it
    """

    z: F64
    where: I64
    coarse: F64


def on_coarser(coarse: Tin, p: F64) -> Places:
    """Places p (p, 3) m of a surface on a coarser one, a Delaunay triangulation."""
    return places_in_triangles(coarse, p, locate_in_delaunay(coarse, p[:, :2]))


def places_in_triangles(coarse: Tin, p: F64, where: I64) -> Places:
    """Places p (p, 3) m in triangles (p,) of a surface, -1 for none. On lattices many lie on an
    edge, in one triangle or the other by the last bit and the way they were found: they then are in
    the one with the lower sum of x, then y.
    """
    at = barycentric(coarse, where, p[:, :2])
    rows = np.flatnonzero((where >= 0) & (at.min(axis=1) < ON_EDGE))
    beyond = coarse.neighbours[where[rows], at[rows].argmin(axis=1)]
    rows, beyond = rows[beyond >= 0], beyond[beyond >= 0].astype(np.int64)
    if len(rows):
        own, other = (
            np.sort(coarse.vertices[coarse.triangles[t], :2], axis=1).sum(axis=1)
            for t in (where[rows], beyond)
        )
        moves = (other[:, 0] < own[:, 0]) | ((other[:, 0] == own[:, 0]) & (other[:, 1] < own[:, 1]))
        where = where.copy()
        where[rows[moves]] = beyond[moves]
        at[rows[moves]] = barycentric(coarse, beyond[moves], p[rows[moves], :2])
    return Places(p[:, 2], where, at)


@kernel
def centres_of(vertices: F64, corners: I32) -> F64:
    """The centres (m, 3) of triangles (m, 3), whatever the order of their corners."""
    out = np.empty((len(corners), 3))
    for t in range(len(corners)):
        a, b, d = corners[t, 0], corners[t, 1], corners[t, 2]
        for c in range(3):
            out[t, c] = mean_of(vertices[a, c], vertices[b, c], vertices[d, c])
    return out


@leaf_kernel
def mean_of(x: float, y: float, z: float) -> float:
    """The mean of three numbers, added by size: the last bit does not depend on their order."""
    low, high = min(x, min(y, z)), max(x, max(y, z))
    between = max(min(x, y), min(max(x, y), z))
    return (low + between + high) / 3.0


def number_vertices(corners: I32, count: int, left_out: I64) -> tuple[I64, I64]:
    """Rows (p,) of the vertices of triangles (m, 3), each once, in the order in which they come,
    and the place of each of ``count`` vertices among them: -1 for others, and for those left out.
    """
    flat, place = corners.reshape(-1), np.full(count, -1, np.int64)
    at = np.arange(len(flat))
    place[flat[::-1]] = at[::-1]  # the first of several is written last
    first = place[flat] == at
    out = np.zeros(count, np.bool_)
    out[left_out] = True
    rows = flat[first & ~out[flat]].astype(np.int64)
    place[:] = -1
    place[rows] = np.arange(len(rows))
    return rows, place


class Compared(NamedTuple):
    """Two surfaces. z : (n,) m, the heights of all vertices · corners : (m, 3) of the triangles ·
    above : (c, 3) of those of the coarser one
    """

    z: F64
    corners: I32
    above: I64


class Differences(NamedTuple):
    """By how much they differ. volume : (m,) m³ over each triangle · gradient : (n,) m², of their
    sum by the heights · covered : (c,) m² of the triangles of the coarser surface
    """

    volume: F64
    gradient: F64
    covered: F64


@kernel
def add_kernel(two: Compared, at: Places, row: I64, own: F64, part: F64, sums: Differences) -> None:
    """Add what one surface lies above the other at one place in each triangle. row : (m,) of that
    place, -1 where the surfaces meet · own : (3,) its barycentric coordinates · part
    : (m,) m², the area it stands for
    """
    for t in range(len(two.corners)):
        i = row[t]
        if i < 0 or at.where[i] < 0:
            continue
        where, height = at.where[i], at.z[i]
        for k in range(3):
            height -= at.coarse[i, k] * two.z[two.above[where, k]]
            sums.gradient[two.above[where, k]] -= part[t] * at.coarse[i, k]
            sums.gradient[two.corners[t, k]] += part[t] * own[k]
        sums.volume[t] += part[t] * height
        if own.min() > 0.0:  # a corner may lie on an edge of the coarser surface
            sums.covered[where] += part[t]


def surface_differences(part: Part, coarse: Tin, kept: I64) -> Differences:
    """By how much the triangles of a part lie above the surface of its vertices ``kept`` (k,), by a
    rule that is exact for quadratics: their centres and corners.
    """
    vertices, corners, area = part.vertices, part.corners, part.area
    two = Compared(vertices[:, 2].copy(), corners, kept[coarse.source][coarse.triangles])
    sums = Differences(
        np.zeros(len(corners)), np.zeros(len(vertices)), np.zeros(len(coarse.triangles))
    )
    at = on_coarser(coarse, centres_of(vertices, corners))
    add_kernel(two, at, np.arange(len(corners)), np.full(3, 1.0 / 3.0), CENTRE * area, sums)
    rows, place = number_vertices(corners, len(vertices), kept)
    at = on_coarser(coarse, vertices[rows])
    for k in range(3):
        add_kernel(two, at, place[corners[:, k]], np.eye(3)[k], CORNER * area, sums)
    return sums


def coarser(part: Part, kept: I64) -> tuple[F64, float, float]:
    """What the volume of a part loses where only its vertices ``kept`` (k,) stay: by blocks, m³;
    the variance, m⁶, that the noise gives to the whole; and how wide the triangles then are, m.
    """
    coarse = build_tin(part.vertices[kept])
    sums = surface_differences(part, coarse, kept)
    size = wide(coarse, sums.covered)
    middle = middles_of(part.xy[part.corners])
    _, blocks = volume_by_block(middle, sums.volume, extent_of(middle), size)
    return blocks, float((sums.gradient**2 * part.noise_m2).sum()), size


@kernel
def middles_of(corners: F64) -> F64:
    """Middles (m, 2) of triangles (m, 3, 2), whatever the order of their corners."""
    out = np.empty((len(corners), 2))
    for t in range(len(corners)):
        for c in range(2):
            out[t, c] = mean_of(corners[t, 0, c], corners[t, 1, c], corners[t, 2, c])
    return out


def volume_by_block(
    middle: F64, volume: F64, extent: tuple[F64, F64], size: float
) -> tuple[I64, F64]:
    """Names (k,) of blocks, for triangles as wide as ``size``, m, and the sums (k,) of volumes (m,)
    of the triangles with middles (m, 2) in them; those of all lie between coordinates (2,).
    """
    low, _ = raster_between(extent, BLOCK * size)
    cell = np.floor((middle - low) / (BLOCK * size)).astype(np.int64)
    names, number = np.unique(cell @ np.array([1 << 32, 1]), return_inverse=True)
    return names, np.bincount(number.reshape(-1), volume, len(names)).astype(np.float64)


def bridged_deviation(tin: Tin, inside: F64, height: F64, own: Bool) -> float:
    """How far, m³, the volume may be off where triangles bridge what was not sampled, their ``own``
    (m,): a third of the difference in height between their corners, in all of them alike. The truth
    is some step or hollow between the corners; a triangle holds a third or two thirds of it.
    """
    corner = height[tin.triangles[own]]
    return float((inside[own] * np.ptp(corner, axis=1)).sum()) / 3.0


def bridges(surface: CloudSurface) -> Bool:
    """The triangles (m,) that bridge what was not sampled."""
    found, count = surface.representation.sampled_area, len(surface.representation.tin.triangles)
    if found is None or len(found.bridged) != count:
        return np.zeros(count, bool)
    return found.bridged
