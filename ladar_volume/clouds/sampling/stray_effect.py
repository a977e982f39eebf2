"""What points that were left out would change in a volume: the surface is triangulated with and
without them where they are, not as a whole.

A point changes the triangles whose circumcircle it lies in, and no others; the new ones all have it
as a corner. So the triangulations of the vertices around with the strays, and without, differ by
what the whole ones differ by, as long as the vertices around reach beyond those circles.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ladar_volume.ground.heights import height_above
from ladar_volume.math.array_types import U64
from ladar_volume.model.records import F64, I32, I64, Bool, Plane, Tin
from ladar_volume.tin.full_tin import any_corner, build_tin, footprint_areas
from ladar_volume.tin.locate import locate, triangle_index

#: Vertices within so many spacings of a stray are triangulated with it.
AROUND = 8.0
#: Odd factors that make numbers of triangles from the numbers of their corners.
FACTORS = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)


def stray_effect(tin: Tin, inside_m2: F64, strays: F64, base: Plane | None = None) -> float:
    """Net volume below a surface less that with strays (s, 3) m in it, m³, above the same base and
    within the same outline: of each triangle inside_m2 (m,) counts.
    """
    area = footprint_areas(tin.vertices, tin.triangles)
    spacing = float(np.sqrt(2.0 * area[tin.relevant].mean()))
    return effect_about(tin, inside_m2, strays, base, spacing)


def effect_about(
    tin: Tin,
    inside_m2: F64,
    strays: F64,
    base: Plane | None,
    spacing_m: float,
    own: Callable[[F64], Bool] | None = None,
) -> float:
    """The same of points about so far apart; ``own`` : which of triangles count that have places
    (m, 2) as their first corner by x, then y, of those that are no strays where there are some.
    """
    area = footprint_areas(tin.vertices, tin.triangles)
    # one beyond the surface changes nothing within the same outline
    strays = strays[locate(triangle_index(tin, tin.relevant), strays[:, :2]) >= 0]
    rows = vertices_near(tin.vertices, strays, AROUND * spacing_m)
    if len(rows) < 3:
        return 0.0
    points = np.vstack([tin.vertices[rows], strays])
    points[:, 2] = (
        points[:, 2] - points[: len(rows), 2].mean() if base is None else height_above(points, base)
    )
    old, new = corners_of(build_tin(points[: len(rows)])), corners_of(build_tin(points))
    fresh = (new >= len(rows)).any(axis=1)
    old, new = old[~np.isin(names_of(old), names_of(new[~fresh]))], new[fresh]
    name, share = shares(tin, inside_m2, area, rows)
    at = np.searchsorted(name, names_of(old))
    # a triangle that the surface does not have counts nowhere
    known = np.append(name, 0)[at] == names_of(old)
    of_old = np.where(known, np.append(share, 0.0)[at], 0.0)
    of_fresh = of_new(points, old, of_old, new)
    if own is not None:
        of_old *= own(points[first_corner(points, old, len(rows)), :2])
        of_fresh *= own(points[first_corner(points, new, len(rows)), :2])
    return volume_above_zero(points, old, of_old) - volume_above_zero(points, new, of_fresh)


def first_corner(points: F64, triangles: I32, known: int) -> I64:
    """The first corner (m,) of triangles (m, 3) by x, then y, of those below ``known`` where there
    are some.
    """
    x, y = (points[triangles, k] for k in range(2))
    order = np.lexsort((y, x, triangles >= known), axis=1)
    out: I64 = np.take_along_axis(triangles, order[:, :1], axis=1)[:, 0].astype(np.int64)
    return out


def vertices_near(vertices: F64, strays: F64, reach_m: float) -> I64:
    """Rows (k,) of vertices (n, 3) that lie within the square cells of side ``reach_m`` around
    those of the strays (s, 3).
    """
    low = vertices[:, :2].min(axis=0)
    size = np.floor((vertices[:, :2].max(axis=0) - low) / reach_m).astype(np.int64) + 1
    marked = np.zeros(size + 2, bool)
    own = np.floor((strays[:, :2] - low) / reach_m).astype(np.int64)
    own = own[((own >= -1) & (own <= size)).all(axis=1)] + 1
    for dx in (-1, 0, 1):
        for dy in (-1, 0, 1):
            x, y = own[:, 0] + dx, own[:, 1] + dy
            good = (x >= 0) & (y >= 0) & (x < marked.shape[0]) & (y < marked.shape[1])
            marked[x[good], y[good]] = True
    x, y = (np.floor((vertices[:, k] - low[k]) / reach_m).astype(np.int64) + 1 for k in range(2))
    return np.flatnonzero(marked[x, y])


def corners_of(tin: Tin) -> I32:
    """Triangles (m, 3) by the rows of the points that were triangulated."""
    out: I32 = tin.source[tin.triangles].astype(np.int32)
    return out


def names_of(corners: I32) -> U64:
    """A number for each triangle (m, 3), whatever the order of its corners."""
    return np.asarray((np.sort(corners, axis=1).astype(np.uint64) + 1) ** 3 @ FACTORS)


def shares(tin: Tin, inside_m2: F64, area: F64, rows: I64) -> tuple[U64, F64]:
    """Names (k,), ascending, of the triangles whose corners all are among ``rows``, and which share
    of each counts.
    """
    number = np.full(len(tin.vertices), -1, np.int32)
    number[rows] = np.arange(len(rows), dtype=np.int32)
    among = np.flatnonzero(~any_corner(tin.triangles, number < 0))
    name = names_of(number[tin.triangles[among]])
    order = np.argsort(name)
    part = inside_m2[among] / np.where(area[among] > 0.0, area[among], 1.0)
    return name[order], part[order]


def of_new(points: F64, old: I32, of_old: F64, new: I32) -> F64:
    """Which share of each new triangle (k, 3) counts: that of the old ones at its corners; a corner
    without any, a stray, has that of its neighbours.
    """
    n = len(points)
    area = np.repeat(np.abs(footprint_areas(points, old)), 3)
    total = np.bincount(old.ravel(), area, n)
    counted = np.bincount(old.ravel(), area * np.repeat(of_old, 3), n)
    known = total > 0.0
    share = np.where(known, counted / np.where(known, total, 1.0), 0.0)
    while True:
        here = known[new]
        each = np.count_nonzero(here, axis=1)
        mean: F64 = (share[new] * here).sum(axis=1) / np.maximum(each, 1)
        if here.all() or not each.any():
            return mean
        # one step further from what is known, until nothing new is reached
        reached = np.repeat((each > 0).astype(np.float64), 3)
        times = np.bincount(new.ravel(), reached, n)
        sums = np.bincount(new.ravel(), np.repeat(mean, 3) * reached, n)
        fresh = ~known & (times > 0.0)
        if not fresh.any():
            return mean
        share[fresh] = sums[fresh] / times[fresh]
        known = known | fresh


def volume_above_zero(points: F64, triangles: I32, share: F64) -> float:
    """Volume, m³, between triangles (m, 3) and height 0."""
    area = np.abs(footprint_areas(points, triangles))
    return float((share * area * points[triangles, 2].mean(axis=1)).sum())
