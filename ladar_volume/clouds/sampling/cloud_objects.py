"""A point cloud without what stands on its surface: machines, trees, wires, fences, people.

They are told as in a survey (:mod:`~ladar_volume.volume.field_checks.standing_objects`): parts of
the surface that lie above nearly all of the steep steps around them. A dense cloud has points on
the faces themselves, so that no single edge is a step: it is thinned for this to one point a cell
as wide as a step is high. What the thinned cloud shows is then looked up in the whole: points
beside such a part, and well above the surface that is left.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.clouds.cloud_noise import thin_by_cells
from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.clouds.cloud_volume import ground_and_outline, solid_within
from ladar_volume.model.errors import GroundError, SurfaceError, VolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, I64, Bool, StandingObject, Tin
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.tin.full_tin import build_tin, vertex_mask
from ladar_volume.tin.represent import represent
from ladar_volume.tin.sampled_area import sampled_without_isolated, spacings
from ladar_volume.volume.base import ZERO
from ladar_volume.volume.field_checks.standing_objects import (
    APART_M,
    MOST,
    STEEP,
    any_step,
    clumps,
    objects_of,
    rise_above,
    standing_vertices,
)
from ladar_volume.volume.polygon import areas_inside

Objects = tuple[StandingObject, ...]


class Coarse(NamedTuple):
    """A surface that was thinned, its vertices (n,) that stand on it, and triangles (m,) that
    count.
    """

    tin: Tin
    standing: Bool
    inside: Bool


#: Vertices (n,) of a thinned surface that stand on it, and triangles (m,) that count, for a noise
#: of its heights, parameters and the height of a step, m.
Find = Callable[[Tin, float, Parameters, float], tuple[Bool, Bool]]

#: Steps are so many times as high as the least body, and than so many standard deviations of one
#: height.
STEP, CLEAR = 5.0 / 3.0, 8.0
#: Points beside a part that stands are of it where they are above the surface that is left by this
#: share of a step.
HIGHER = 0.5
#: Edges that join reach over so many spacings.
REACH = 4.0
#: Points nearer than so many spacings are of one thing; the surface around it reaches over so many
#: of these distances.
APART, AROUND = 2.0, 4.0
#: Rounds: what leans on a thing is seen when that is gone.
ROUNDS = 3
#: Things that are this share of all that rises, or that changed, may be what is measured.
NEARLY_ALL = 0.75


def thinned_tin(points: F64, cell_m: float, spacing_m: float) -> Tin:
    """The sampled surface of points (n, 3) m, one a cell; of all where they lie farther apart.
    ``source`` numbers the points.
    """
    rows = np.arange(len(points), dtype=np.int64)
    if spacing_m < cell_m:
        rows = np.sort(thin_by_cells(points, cell_m))
    tin, _ = sampled_without_isolated(build_tin(points[rows]))
    return dataclasses.replace(tin, source=rows[tin.source])


def beside(xy: F64, there: F64, cell_m: float) -> I64:
    """Rows (k,) of places xy (n, 2) m in or beside the square cells that places ``there`` (m, 2) m
    lie in.
    """
    low = there.min(axis=0)
    wide = int((there - low).max() // cell_m) + 5
    around = np.array([i * wide + j for i in (-1, 0, 1) for j in (-1, 0, 1)])

    def cell(places: F64) -> I64:
        at = np.floor((places - low) / cell_m) + 2.0
        at = np.where((at < 0.0) | (at >= wide), 0.0, at)  # no cell there is marked
        return np.asarray(at[:, 0] * wide + at[:, 1], dtype=np.int64)

    marked = np.unique(cell(there)[:, None] + around)
    own = cell(xy)
    found = np.minimum(np.searchsorted(marked, own), len(marked) - 1)
    return np.flatnonzero(marked[found] == own)


def standing_points(points: F64, tin: Tin, standing: Bool, step_m: float, cell_m: float) -> Bool:
    """Which points (n,) of points (n, 3) m belong to the vertices ``standing`` (k,) of a thinned
    surface: those themselves, and what is beside them and above the surface of the others.
    """
    out = np.zeros(len(points), np.bool_)
    out[tin.source[standing]] = True
    near = beside(points[:, :2], tin.vertices[standing, :2], cell_m)
    out[near[rise_above(points[near], tin.vertices[~standing]) > HIGHER * step_m]] = True
    return out


def rebuilt(
    surface: CloudSurface, kept: I64, options: SurfaceParameters, objects: Objects
) -> CloudSurface:
    """The surface of its points ``kept`` (k,), without objects."""
    if surface.sigma_m is None:
        raise ValueError("a surface without noise")
    points, sigma = surface.points[kept], surface.sigma_m[kept]
    standing = np.setdiff1d(surface.index, surface.index[kept])
    return dataclasses.replace(
        surface,
        points=points,
        index=surface.index[kept],
        sigma_m=sigma,
        representation=represent(points, options, sigma),
        standing=standing,
        objects=objects,
    )


def standing_in(
    tin: Tin, rings: Sequence[F64], sigma_m: float, parameters: Parameters, step_m: float
) -> tuple[Bool, Bool]:
    """Vertices (n,) that stand on a surface, and triangles (m,) in its outlines: the main body's,
    or ``rings`` (k, 2) m that are given. What fills most of a ring is the body it was drawn for.
    """
    if not len(rings):
        base, area = ground_and_outline(tin, np.full(len(tin.vertices), sigma_m**2), parameters)
        return standing_vertices(tin, base, area > 0.0, parameters.volume, step_m), area > 0.0
    volume = dataclasses.replace(parameters.volume, outline="all")
    every = np.ones(len(tin.triangles), np.bool_)
    standing = standing_vertices(tin, ZERO, every, volume, step_m)
    within = np.zeros(len(every), np.bool_)
    for ring in rings:
        own = areas_inside(tin, ring)
        mask = own > 0.0
        within |= mask
        if own[standing[tin.triangles].any(axis=1)].sum() > MOST * own.sum():
            standing &= ~vertex_mask(tin, mask)
    return standing, within


def without_objects(
    surface: CloudSurface,
    parameters: Parameters,
    options: SurfaceParameters,
    rings: Sequence[F64] = (),
) -> CloudSurface:
    """The surface without what stands on it, which it names; itself where nothing does, or where
    nothing would be left. rings : outlines (k, 2) m that are given, none for that of the main body
    """

    def find(tin: Tin, sigma_m: float, own: Parameters, step_m: float) -> tuple[Bool, Bool]:
        return standing_in(tin, rings, sigma_m, own, step_m)

    kept, found = what_stays(surface, parameters, find)
    return rebuilt(surface, kept, options, found) if found else surface


def nearly_all_above(cleared: CloudSurface, parameters: Parameters) -> bool:
    """Whether what was taken out of a surface is nearly all that rose above its base."""
    taken = sum(one.volume_m3 for one in cleared.objects)
    if taken == 0.0:
        return False
    tin = cleared.representation.tin
    base, inside = ground_and_outline(tin, np.zeros(len(tin.vertices)), parameters)
    left = solid_within(tin, base, inside > 0.0, parameters).cut_m3
    return taken >= NEARLY_ALL * (taken + left)


def objects_of_points(points: F64, taken: Bool, coarse: Coarse, spacing_m: float) -> Objects:
    """What stood on a surface of points (n, 3) m, those ``taken`` (n,), above all others around; on
    the thinned surface where the points around are too few for one.
    """
    thin, standing, inside = coarse
    apart = max(APART_M, APART * spacing_m)
    label, mask = clumps(thin.vertices[standing, :2], apart), vertex_mask(thin, inside)
    counted = np.zeros(len(points), np.bool_)
    counted[thin.source[mask]] = True
    rows = beside(points[:, :2], points[taken, :2], AROUND * apart)
    try:
        tin = thinned_tin(points[rows], 0.0, spacing_m)
    except SurfaceError:
        return objects_of(thin, standing, standing, mask, label)
    rows = rows[tin.source]
    own = taken[rows]
    if not own.any():
        return objects_of(thin, standing, standing, mask, label)
    # dense points have too many neighbours for pairs of them
    near = cKDTree(thin.vertices[standing, :2]).query(points[rows[own], :2])[1]
    return objects_of(tin, own, own, counted[rows], label[near])


def what_stays(surface: CloudSurface, parameters: Parameters, find: Find) -> tuple[I64, Objects]:
    """Rows (k,) of the points of a surface that belong to it, and what stands on it, which others
    belong to, the largest first.
    """
    kept, found = np.arange(len(surface.points)), list[StandingObject]()
    if surface.sigma_m is None or surface.given_faces is not None:
        return kept, ()
    made, sigma = surface.representation, float(np.median(surface.sigma_m))
    step = step_of(surface, parameters)
    area = made.sampled_area
    at = spacings(surface.points[:, :2]) if area is None else area.spacings_m
    spacing = float(np.median(at))
    if spacing >= step and not any_step(made.tin.triangles, made.tin.vertices, step, STEEP):
        return kept, ()
    longest = max(parameters.volume.max_edge_m, REACH * spacing)
    volume = dataclasses.replace(parameters.volume, max_edge_m=longest)
    parameters = dataclasses.replace(parameters, volume=volume)
    for _ in range(ROUNDS):
        points = surface.points[kept]
        try:
            tin = thinned_tin(points, step, spacing)
            if not any_step(tin.triangles, tin.vertices, step, STEEP):
                break
            standing, inside = find(tin, sigma, parameters, step)
        except (GroundError, SurfaceError, VolumeError):  # no ground: the volume will say so
            break
        if not standing.any():
            break
        taken = standing_points(points, tin, standing, step, max(step, spacing))
        found += objects_of_points(points, taken, Coarse(tin, standing, inside), spacing)
        kept = kept[~taken]
    return kept, tuple(sorted(found, key=lambda one: -one.volume_m3))


def step_of(surface: CloudSurface, parameters: Parameters) -> float:
    """How high a step is, m, on a surface whose noise is known."""
    sigma = 0.0 if surface.sigma_m is None else float(np.median(surface.sigma_m))
    return max(STEP * parameters.volume.object_height_m, CLEAR * sigma)
