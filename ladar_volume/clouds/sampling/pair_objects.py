"""Two point clouds of one place without what stands on one of them alone: a machine, a parked
truck, a tree in one of two surveys is no cut and no fill.

What stands is told on each cloud by itself, as on one (:mod:`.cloud_objects`), from the steep steps
around it; it counts as such where the other cloud lies lower there. What stands on both clouds is
no change, and stays. Where the things are nearly all that changed, as where a box is compared with
its empty place, they may be what is measured: then they stay, and are named.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from ladar_volume.change.surface_difference import difference
from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.clouds.sampling.cloud_objects import (
    NEARLY_ALL,
    rebuilt,
    step_of,
    what_stays,
)
from ladar_volume.clouds.sampling.object_search import HIGHER, Objects
from ladar_volume.math.nearest import nearest_distances, nearest_index
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, I64, Bool, StandingObject, Tin
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.model.verdict import Doubt
from ladar_volume.tin.full_tin import footprint_areas
from ladar_volume.tin.locate import TriangleIndex, height_at, triangle_index
from ladar_volume.volume.base import ZERO
from ladar_volume.volume.field_checks.standing_objects import (
    APART_M,
    MATTERS,
    clumps,
    standing_vertices,
)

#: A thing is new where the other cloud lies lower at this share of its vertices.
NEW = 0.5
#: Points of both are the same thing where they are no farther apart than this many times as far as
#: the next point of their own cloud.
FAR = 2.0


def new_vertices(
    tin: Tin,
    standing: Bool,
    surfaces: tuple[CloudSurface, CloudSurface],
    index: TriangleIndex,
    least_m: float,
) -> Bool:
    """Vertices (n,) of the things ``standing`` (n,) on the first of two surfaces, some of whose
    points ``tin`` joins, that the second has not: it lies lower there, and none of its points is
    near. index : of the second
    """
    rows, out = np.flatnonzero(standing), np.zeros(len(standing), np.bool_)
    if not len(rows):
        return out
    r = tin.vertices[rows]
    below = height_at(surfaces[1].representation.tin, r[:, :2], index)  # NaN: not seen by the other
    higher = r[:, 2] - below > least_m
    higher[higher] = far_from(r[higher], *surfaces, least_m)
    label = clumps(r[:, :2], APART_M)
    share = np.bincount(label, higher) / np.bincount(label)
    out[rows] = share[label] > NEW
    return out


def far_from(places: F64, own: CloudSurface, other: CloudSurface, least_m: float) -> Bool:
    """Which places (k, 3) m, points of one cloud, have no point of the other near, strays
    included: none within ``least_m``, and none within :data:`FAR` times the distance to the next
    point of their own cloud. Two surveys meet the same crown at other leaves, and the surface of
    one is lower there by chance.
    """
    if not len(places):
        return np.zeros(0, np.bool_)
    one, two = (np.concatenate([s.points, s.stray_points]) for s in (own, other))
    next_own = nearest_within(one, places, 2, math.inf)
    least = np.maximum(least_m, FAR * max(1.0, math.sqrt(len(one) / len(two))) * next_own)
    out: Bool = nearest_within(two, places, 1, float(least.max())) > least
    return out


def nearest_within(points: F64, places: F64, k: int, reach_m: float) -> F64:
    """Distances (m,) m from places (m, 3) m to the k-th nearest of points (n, 3) m. One beyond the
    reach may come out too large, but never within it.
    """
    low, high = places.min(axis=0) - reach_m, places.max(axis=0) + reach_m
    near = points[((points >= low) & (points <= high)).all(axis=1)]
    if len(near) < k:
        return np.full(len(places), np.inf)
    return nearest_distances(nearest_index(near), places, k)


def new_on(
    surface: CloudSurface, other: CloudSurface, parameters: Parameters
) -> tuple[I64, Objects]:
    """Rows (k,) of the points of a surface that belong to it, and what stands on it and is new
    against the other one.
    """
    below = other.representation.tin
    index = triangle_index(below, below.relevant)
    least = HIGHER * step_of(surface, parameters)

    def find(tin: Tin, _: float, own: Parameters, step_m: float) -> tuple[Bool, Bool]:
        every = np.ones(len(tin.triangles), np.bool_)
        volume = dataclasses.replace(own.volume, outline="all")
        standing = standing_vertices(tin, ZERO, every, volume, step_m)
        return new_vertices(tin, standing, (surface, other), index, least), every

    return what_stays(surface, parameters, find)


def changed_m3(surfaces: Sequence[CloudSurface], least_m: float) -> float:
    """What lies between two surfaces where they are apart by more than that, m³, cut and fill."""
    tin = difference(*(s.representation.tin for s in surfaces)).common()
    apart = np.abs(tin.vertices[tin.triangles, 2].mean(axis=1))
    area = footprint_areas(tin.vertices, tin.triangles)
    return float((area * np.where(apart > least_m, apart, 0.0)).sum())


def without_new_objects(
    surfaces: Sequence[CloudSurface], parameters: Parameters, options: SurfaceParameters
) -> list[CloudSurface]:
    """Two surfaces without what stands on one of them alone, which each names; as they are, with a
    doubt, where that may be what is measured.
    """
    one, two = surfaces
    if any(s.sigma_m is None or s.given_faces is not None for s in surfaces):
        return [one, two]
    found = [new_on(one, two, parameters), new_on(two, one, parameters)]
    objects = [thing for _, things in found for thing in things]
    if not objects:
        return [one, two]
    own = sum(thing.volume_m3 for thing in objects)
    least = HIGHER * max(step_of(s, parameters) for s in surfaces)
    if own >= NEARLY_ALL * changed_m3(surfaces, least):
        return [dataclasses.replace(one, doubts=(*one.doubts, counted_doubt(objects))), two]
    return [
        rebuilt(surface, kept, options, things) if things else surface
        for surface, (kept, things) in zip(surfaces, found, strict=True)
    ]


def largest_words(objects: Sequence[StandingObject]) -> str:
    """How many things there are, and the largest one."""
    one = max(objects, key=lambda each: each.volume_m3)
    several = f"{len(objects)} things stand" if len(objects) > 1 else "something stands"
    return (
        f"{several} on one of the two clouds and not on the other, the largest "
        f"{one.size_m:.2g} m wide and {one.high_m:.2g} m high at ({one.x_m:.1f}, {one.y_m:.1f}) m"
    )


def counted_doubt(objects: Sequence[StandingObject]) -> Doubt:
    """What stands on one cloud alone is nearly all that changed, and is counted."""
    total = sum(one.volume_m3 for one in objects)
    words = (
        f"{largest_words(objects)}: {total:.3g} m³, nearly all that changed, are counted; where "
        "they are machines, trees or people, cut them out of the clouds or draw an outline without "
        "them, and where they are what is measured, say so with --clean off"
    )
    return Doubt("object", words, total)


def new_object_doubts(objects: Sequence[StandingObject], sigma_m3: float) -> list[Doubt]:
    """What was taken out matters. sigma_m3 : of the volume."""
    total = sum(one.volume_m3 for one in objects)
    if not objects or total < MATTERS * sigma_m3:
        return []
    words = (
        f"{largest_words(objects)}: {total:.3g} m³ are not counted, and the surface below is "
        "bridged; survey the place without them, or count them with --clean off"
    )
    return [Doubt("object", words, total)]
