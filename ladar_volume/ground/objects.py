"""Objects above the ground, and pits below it: found by themselves, or by regions or picked points
(seed 002 section 7.3).

A point belongs to an object where it rises above the ground by more than the least height and by
more than ``sigmas`` standard deviations of the ground. Objects are clusters of such points. Bodies
that touch are one cluster: ``split_m`` parts those with a saddle between them, regions and picked
points part any.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from ladar_volume.ground.clusters import clusters
from ladar_volume.ground.surfaces import heights_above
from ladar_volume.model.body_parameters import ObjectParameters
from ladar_volume.model.errors import ObjectError
from ladar_volume.model.records import F64, I64, Bool, Plane


@dataclass(frozen=True)
class ObjectRecord:
    """points : how many · low_m, high_m : (3,) corners of the extent · centroid_m : (3,) mean of
    the points · height_m : largest height above the ground, for a pit the lowest (negative) ·
    footprint_m : (k, 2) convex outline, counter-clockwise · footprint_m2 : its area · pit : whether
    it lies below the ground
    """

    points: int
    low_m: F64
    high_m: F64
    centroid_m: F64
    height_m: float
    footprint_m: F64
    footprint_m2: float
    pit: bool


@dataclass(frozen=True)
class Objects:
    """label : (n,) index into ``records`` of each point, −1 for none · height_m : (n,) height of
    each point above the ground
    """

    label: I64
    height_m: F64
    records: tuple[ObjectRecord, ...]

    def mask(self, number: int) -> Bool:
        """The points (n,) of one object."""
        out: Bool = self.label == number
        return out


def find_objects(
    points: F64,
    grounds: Sequence[Plane],
    p: ObjectParameters | None = None,
    supports: F64 | None = None,
) -> Objects:
    """Clusters of points (n, 3) m, z up, above the ground: the largest first, equal ones by
    position; none where nothing rises.

    supports : the points that the ground's ``support`` indexes; default the points themselves.
    Raises :class:`ObjectError` without points or ground.
    """
    p = p or ObjectParameters()
    height, above, below = heights_above_ground(points, grounds, p, supports)
    label = _clusters(points, height, above, p)
    if p.pits:
        deep = _clusters(points, -height, below, p)
        label = np.where(deep >= 0, deep + label.max() + 1, label)
    return _objects(points, height, label)


def objects_in_regions(
    points: F64,
    grounds: Sequence[Plane],
    regions: Sequence[Bool],
    p: ObjectParameters | None = None,
    supports: F64 | None = None,
) -> Objects:
    """One object per region: its points (n,) that are above the ground (with ``pits``: or below
    it). A point in several regions belongs to the first.

    Regions are masks as of :func:`regions.in_polygon` and :func:`regions.in_box`. Raises
    :class:`ObjectError` for a region in which nothing rises.
    """
    p = p or ObjectParameters()
    height, above, below = heights_above_ground(points, grounds, p, supports)
    free = above | below if p.pits else above
    label = np.full(len(points), -1, dtype=np.int64)
    for number, region in enumerate(regions):
        mine = region & free & (label < 0)
        if not mine.any():
            raise ObjectError(
                (
                    f"nothing rises {p.min_height_m:g} m above the ground in region {number}: "
                    "check its coordinates, or lower min_height_m"
                ),
                reason="object_empty",
                value=number,
            )
        label[mine] = number
    return _objects(points, height, label)


def objects_at_places(
    points: F64,
    grounds: Sequence[Plane],
    picks: Sequence[F64],
    p: ObjectParameters | None = None,
    supports: F64 | None = None,
) -> Objects:
    """One object per group of picked points (k, 3) m: the clusters nearest to its points.

    A cluster that several groups pick is shared: each of its points goes to the group with the
    nearest picked point. Raises :class:`ObjectError` for an empty group, or where no cluster is
    within ``pick_reach_m``.
    """
    p = p or ObjectParameters()
    groups = _checked_picks(picks)
    found = find_objects(points, grounds, p, supports)
    rows = np.flatnonzero(found.label >= 0)
    if len(rows) == 0:
        above = heights_above_ground(points, grounds, p, supports)[1]
        raise ObjectError(
            f"nothing to pick: {int(np.count_nonzero(above)):,} "
            f"points rise above the ground, none in a cluster of {p.min_points} in steps of "
            f"{p.distance_m:.3g} m: raise distance_m, or lower min_height_m or min_points",
            reason="object_empty",
        )
    picked, group = (
        np.concatenate(groups),
        np.repeat(np.arange(len(groups)), [len(g) for g in groups]),
    )
    hit = found.label[rows[_nearest(points[rows], picked, p.pick_reach_m)]]
    label = np.full(len(points), -1, dtype=np.int64)
    for cluster in np.unique(hit):
        own, mine = found.label == cluster, hit == cluster
        label[own] = group[mine][cKDTree(picked[mine]).query(points[own])[1]]
    _check_all_found(np.setdiff1d(group, label))
    return _objects(points, found.height_m, label)


def _check_all_found(lost: I64) -> None:
    """Refuses groups of picks to which no point went."""
    if len(lost):
        raise ObjectError(
            f"no point is nearer to the picks of object {lost[0]} than to others: pick on the body",
            reason="object_pick",
            value=int(lost[0]),
        )


def _checked_picks(picks: Sequence[F64]) -> list[F64]:
    """Groups of picked points (k, 3), none empty. Raises :class:`ObjectError`."""
    groups = [np.atleast_2d(np.asarray(g, dtype=np.float64)) for g in picks]
    if not groups or any(
        g.size == 0 or g.shape[1:] != (3,) or not np.isfinite(g).all() for g in groups
    ):
        raise ObjectError(
            "each object needs at least one picked point x, y, z", reason="object_pick", value=picks
        )
    return groups


def _nearest(points: F64, picked: F64, reach_m: float) -> I64:
    """The point (k,) nearest to each that is picked (k, 3). Raises :class:`ObjectError` beyond the
    reach.
    """
    away, nearest = (np.asarray(a) for a in cKDTree(points).query(picked))
    if away.max() > reach_m:
        far = int(away.argmax())
        raise ObjectError(
            f"the picked point {picked[far]} is {away[far]:.2f} m from the nearest "
            f"object, more than {reach_m:g} m: pick on it, or raise pick_reach_m",
            reason="object_pick",
            value=picked[far],
        )
    return nearest.astype(np.int64)


def heights_above_ground(
    points: F64, grounds: Sequence[Plane], p: ObjectParameters, supports: F64 | None = None
) -> tuple[F64, Bool, Bool]:
    """Heights (n,) m above the ground, and which points are above and below it. Raises
    :class:`ObjectError` without points or ground.
    """
    if len(points) == 0 or not np.isfinite(points).all():
        raise ObjectError(
            "objects need points, all of them finite", reason="object_points", value=len(points)
        )
    if len(grounds) == 0:
        raise ObjectError(
            "objects need a ground: fit one, or give a level", reason="object_no_ground"
        )
    height, sigma = heights_above(
        points, grounds, points if supports is None else supports, p.step_m
    )
    least = np.maximum(p.min_height_m, p.sigmas * sigma)
    return height, height > least, height < -least


def _clusters(points: F64, height: F64, chosen: Bool, p: ObjectParameters) -> I64:
    label = clusters(points, p.distance_m, p.min_points, chosen)
    if p.split_m == 0.0:
        return label
    cores = [
        core
        for number in range(label.max() + 1)
        for core in split_cluster(points, height, np.flatnonzero(label == number), p)
    ]
    sizes = [(-len(core), *points[core][np.lexsort(points[core].T[::-1])[0]]) for core in cores]
    out = np.full(len(points), -1, dtype=np.int64)
    for new, old in enumerate(sorted(range(len(cores)), key=lambda i: sizes[i])):
        out[cores[old]] = new
    return out


def split_cluster(points: F64, height: F64, rows: I64, p: ObjectParameters) -> list[I64]:
    """Rows (k,) of one cluster, parted where the points above some level fall into clusters that
    each rise ``split_m`` above it.
    """
    levels = np.arange(height[rows].min(), height[rows].max() - p.split_m, p.split_m / 4)
    for level in levels:
        high = rows[height[rows] > level]
        label = clusters(points[high], p.distance_m, p.min_points)
        peaks = [high[label == i] for i in range(label.max() + 1)]
        cores = [peak for peak in peaks if height[peak].max() >= level + p.split_m]
        if len(cores) > 1:
            owner = np.repeat(np.arange(len(cores)), [len(core) for core in cores])
            nearest = owner[cKDTree(points[np.concatenate(cores)]).query(points[rows])[1]]
            return [
                part
                for i in range(len(cores))
                for part in split_cluster(points, height, rows[nearest == i], p)
            ]
    return [rows]


def _objects(points: F64, height: F64, label: I64) -> Objects:
    records = tuple(
        _record(points[label == number], height[label == number])
        for number in range(label.max() + 1)
    )
    return Objects(label, height, records)


def _record(p: F64, height: F64) -> ObjectRecord:
    try:
        hull = ConvexHull(p[:, :2])
        ring, area = p[hull.vertices, :2], float(hull.volume)
    except (QhullError, ValueError):  # on one line
        order = np.lexsort((p[:, 1], p[:, 0]))
        ring, area = p[order[[0, -1]], :2], 0.0
    pit = bool(np.median(height) < 0)
    return ObjectRecord(
        len(p),
        p.min(axis=0),
        p.max(axis=0),
        p.mean(axis=0),
        float(height.min() if pit else height.max()),
        ring,
        area,
        pit,
    )
