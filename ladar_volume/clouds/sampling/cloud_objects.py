"""A point cloud without what stands on its surface: machines, trees, wires, fences, people.

They are told as in a survey (:mod:`~ladar_volume.volume.field_checks.standing_objects`): parts of
the surface that lie above nearly all of the steep steps around them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Self

import numpy as np

from ladar_volume.clouds.cloud_noise import thin_by_cells
from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.clouds.cloud_volume import ground_and_outline, solid_within
from ladar_volume.clouds.sampling.object_search import (
    Located,
    Objects,
    ObjectSearch,
    Ring,
    sampled_tin,
    searched,
    step_height,
)
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, I64, Bool, Tin
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.tin.full_tin import vertex_mask
from ladar_volume.tin.represent import represent
from ladar_volume.volume.base import ZERO
from ladar_volume.volume.field_checks.standing_objects import (
    MOST,
    STEEP,
    any_step,
    standing_vertices,
)
from ladar_volume.volume.polygon import areas_inside

#: Things that are this share of all that rises, or that changed, may be what is measured.
NEARLY_ALL = 0.75


#: Vertices (n,) of a thinned surface that stand on it, and triangles (m,) that count, for a noise
#: of its heights, parameters and the height of a step, m.
Find = Callable[[Tin, float, Parameters, float], tuple[Bool, Bool]]


@dataclass(frozen=True)
class ThinTin:
    """A thinned surface, its vertices (n,) that stand on it, and those of triangles that count;
    ``tin.source`` are the rows of its points.
    """

    tin: Tin
    on_it: Bool
    counted: Bool

    @property
    def standing(self) -> Located:
        """The vertices that stand on it."""
        return Located(self.tin.source[self.on_it], self.tin.vertices[self.on_it])

    def around(self, there: F64, cell_m: float) -> Ring:
        """The vertices in or beside the cells that places ``there`` (m, 2) m lie in."""
        r = self.tin.vertices
        near = beside(r[:, :2], there, cell_m, there.min(axis=0))
        located = Located(self.tin.source[near], r[near])
        return Ring(located, self.on_it[near], self.counted[near])


@dataclass(frozen=True)
class PointsAtHand:
    """Points (n, 3) m, of which those of rows ``kept`` (k,), ascending, are left. find : what
    stands on their thinned surface
    """

    points: F64
    kept: I64
    find: Find

    def thinned(self, cell_m: float) -> Located:
        """The nearest to the middle of each square cell; all for a cell of 0."""
        rows = self.kept
        if cell_m > 0.0:
            rows = rows[np.sort(thin_by_cells(self.points[rows], cell_m))]
        return Located(rows, self.points[rows])

    def thin_surface(self, how: ObjectSearch) -> ThinTin | None:
        """Their surface, thinned; None where nothing stands on it."""
        tin = sampled_tin(self.thinned(how.thinned_m))
        if not any_step(tin.triangles, tin.vertices, how.step_m, STEEP):
            return None
        standing, inside = self.find(tin, how.sigma_m, how.with_reach, how.step_m)
        return ThinTin(tin, standing, vertex_mask(tin, inside)) if standing.any() else None

    def beside(self, there: F64, cell_m: float) -> Located:
        """Those in or beside the cells that places ``there`` (m, 2) m lie in."""
        near = beside(self.points[self.kept, :2], there, cell_m, there.min(axis=0))
        return Located(self.kept[near], self.points[self.kept[near]])

    def without(self, things: Located) -> Self:
        """The others."""
        kept = np.setdiff1d(self.kept, things.rows, assume_unique=True)
        return dataclasses.replace(self, kept=kept)


def beside(xy: F64, there: F64, cell_m: float, low: F64) -> I64:
    """Rows (k,) of places xy (n, 2) m in or beside the square cells that places ``there`` (m, 2) m
    lie in, of a raster from a corner low (2,) m.
    """
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
    tin: Tin, sigma_m: float, parameters: Parameters, step_m: float, rings: Sequence[F64] = ()
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
    kept, found = what_stays(surface, parameters, partial(standing_in, rings=rings))
    return rebuilt(surface, kept, options, found) if found else surface


def nearly_all_above(cleared: CloudSurface, parameters: Parameters) -> bool:
    """Whether what was taken out of a surface is nearly all that rose above its base."""
    tin = cleared.representation.tin
    base, inside = ground_and_outline(tin, np.zeros(len(tin.vertices)), parameters)
    left = solid_within(tin, base, inside > 0.0, parameters).cut_m3
    return is_nearly_all(cleared.objects, left)


def is_nearly_all(objects: Objects, left_m3: float) -> bool:
    """Whether objects are nearly all of what they and the rest make."""
    taken = sum(one.volume_m3 for one in objects)
    return 0.0 < taken >= NEARLY_ALL * (taken + left_m3)


def what_stays(surface: CloudSurface, parameters: Parameters, find: Find) -> tuple[I64, Objects]:
    """Rows (k,) of the points of a surface that belong to it, and what stands on it, which others
    belong to, the largest first.
    """
    every = np.arange(len(surface.points))
    if surface.sigma_m is None or surface.given_faces is not None:
        return every, ()
    sigma, spacing = float(np.median(surface.sigma_m)), float(np.median(surface.spacing_m))
    how, tin = ObjectSearch(sigma, spacing, parameters), surface.representation.tin
    if not how.thinned_m and not any_step(tin.triangles, tin.vertices, how.step_m, STEEP):
        return every, ()
    found = searched(PointsAtHand(surface.points, every, find), how)
    return found.points.kept, found.objects


def step_of(surface: CloudSurface, parameters: Parameters) -> float:
    """How high a step is, m, on a surface whose noise is known."""
    sigma = 0.0 if surface.sigma_m is None else float(np.median(surface.sigma_m))
    return step_height(parameters.volume.object_height_m, sigma)
