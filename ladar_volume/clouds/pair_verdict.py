"""Whether the volume between two clouds can be believed: whether they agree where nothing changed,
whether the change ends within what both saw, what neither saw, and what stands on one of them.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import partial

import numpy as np

from ladar_volume.change.surface_difference import difference
from ladar_volume.clouds.between_points import between_points
from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.clouds.cloud_volume import CloudVolume
from ladar_volume.clouds.ground_cover import CLIMB, steep_edges
from ladar_volume.clouds.sampling.objects_beside import objects_within
from ladar_volume.clouds.sampling.outline_place import outline_variance
from ladar_volume.clouds.sampling.pair_objects import new_object_doubts
from ladar_volume.clouds.sampling.pair_registration import (
    ALIKE,
    CELLS,
    CHANGED,
    CellMeans,
    UnchangedPart,
    cell_means,
    registration_doubts,
    unchanged_cells,
    unit_doubts,
    with_offset,
)
from ladar_volume.clouds.volume_verdict import with_lines
from ladar_volume.ground.heights import height_above
from ladar_volume.ground.polynomial import design_surface
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64, Bool, Plane, StandingObject, Tin
from ladar_volume.model.verdict import Doubt, Verdict
from ladar_volume.tin.full_tin import footprint_areas
from ladar_volume.tin.locate import locate, triangle_index
from ladar_volume.volume.cutfill import with_net
from ladar_volume.volume.field_checks.completeness import wall_doubts
from ladar_volume.volume.field_checks.cut_bodies import (
    HIDDEN,
    CutSides,
    cut_at_boundary,
    cut_sides,
    missing_m6,
)
from ladar_volume.volume.field_checks.gaps import bridged_volume, find_gaps, gap_doubts, seen_above
from ladar_volume.volume.field_checks.standing_objects import APART_M
from ladar_volume.volume.field_checks.steep_faces import enclosed_m6, wall_m6
from ladar_volume.volume.outline import components
from ladar_volume.volume.polygon import areas_inside, check_polygon

#: Fewest cells of ground that is named, and fewest triangles in each.
FEWEST_NAMED, IN_CELL = 8, 8
#: Climb of a steep face that may be a wall or a machine, at least, m.
FACE_M = 0.3


@dataclass(frozen=True)
class PairGround:
    """tin : upper minus lower over what both saw · unchanged : where they are alike · least_m :
    apart beyond chance · on_face : (n,) vertices on steep faces · cells : means of the difference
    """

    tin: Tin
    unchanged: UnchangedPart
    least_m: float
    on_face: Bool
    cells: CellMeans

    @property
    def level(self) -> Plane:
        """Height of the difference where nothing changed."""
        return design_surface([self.unchanged.offset_m])


def named_part(ground: PairGround, corners: F64) -> UnchangedPart:
    """The part of a difference within corners (c, 2) m, which is known not to have changed. Raises
    :class:`VolumeError` (epochs_stable) where both saw too little of it.
    """
    tin = ground.tin
    own = footprint_areas(tin.vertices, tin.triangles)
    inside = areas_inside(tin, check_polygon(corners)) >= 0.5 * own
    cells = min(CELLS, int(np.count_nonzero(inside)) // IN_CELL)
    if cells < FEWEST_NAMED:
        words = "both clouds cover too little of the stable ground: name a larger place"
        raise VolumeError(words, reason="epochs_stable", value=cells)
    mean, area = cell_means(dataclasses.replace(tin, triangles=tin.triangles[inside]), cells)[:2]
    middle = float(np.average(mean, weights=area))
    scatter = max(float(np.std(mean, ddof=1)), 1e-9)
    sigma = scatter / math.sqrt(max(len(mean) / ALIKE, 1.0))
    share = float(own[inside].sum() / own.sum())
    return UnchangedPart(middle, sigma, scatter, share, ground.unchanged.changed, True)


def pair_ground(surfaces: list[CloudSurface]) -> PairGround | None:
    """What two surfaces say of one another. None where their noise is not known, or too little is
    common to both.
    """
    sigmas = [s.sigma_m for s in surfaces]
    if sigmas[0] is None or sigmas[1] is None:
        return None
    tin = difference(surfaces[0].representation.tin, surfaces[1].representation.tin).common()
    if not len(tin.triangles):
        return None
    cells = cell_means(tin)
    found = unchanged_cells(cells)
    if found is None:
        return None
    noise = math.hypot(*(float(np.median(s)) for s in sigmas if s is not None))
    least = max(CLIMB * noise, CHANGED * found.scatter_m)
    return PairGround(tin, found, least, steep_edges(tin, max(FACE_M, least)), cells)


def with_edge(
    volume: CloudVolume, ground: PairGround, inside: Bool, outline: bool
) -> tuple[CloudVolume, list[Doubt]]:
    """The two surfaces are apart where what counts, the triangles ``inside`` (m,) of their
    difference, ends: at the edge of what both saw, or at an ``outline``. What may have changed
    beyond is in sigma but for an outline, which says what is meant.
    """
    tin, level = ground.tin, ground.level
    cut = cut_at_boundary(tin, level, inside, ground.least_m)
    if (
        cut is None
        or not ground.unchanged.is_distinguishable
        or cut.hidden_m3 < HIDDEN * volume.sigma_m3
    ):
        return volume, []
    what, todo = (
        ("the outline lies", "draw it around what changed")
        if outline
        else ("one of the clouds ends", "survey that place, or take the base from the ground")
    )
    words = (
        f"{what} where they are {cut.high_m:.2g} m apart, along {cut.length_m:.3g} m about "
        f"({cut.x_m:.1f}, {cut.y_m:.1f}) m: what changed beyond, some {cut.hidden_m3:.2g} m³ or "
        f"more, is not counted; {todo}"
    )
    if not outline:
        sides = cut_sides(tin, level, inside, ground.least_m)
        missing = missing_m6(tin, level, inside, sides, changed_at_m3(ground, inside, sides))
        volume = with_lines(volume, {"cut": missing})
    return volume, [Doubt("cut", words, cut.hidden_m3)]


def changed_at_m3(ground: PairGround, inside: Bool, sides: CutSides) -> float:
    """How much lies between the surfaces in the parts of the triangles ``inside`` (m,) that are cut
    at ``sides``, m³.
    """
    tin, level = ground.tin, ground.level
    height = np.abs(height_above(tin.vertices, level))[tin.triangles]
    part = components(tin, inside & (height > ground.least_m).any(axis=1))
    own = np.isin(part, part[sides.triangle])
    area = footprint_areas(tin.vertices, tin.triangles[own])
    return float(area @ height[own].mean(axis=1))


def overlap_area(surface: CloudSurface, other: CloudSurface, area: F64) -> F64:
    """The area (m,) m² of a surface's triangles that lie over the other one; 0 elsewhere."""
    tin, below = surface.representation.tin, other.representation.tin
    middle = tin.vertices[tin.triangles, :2].mean(axis=1)
    there: Bool = locate(triangle_index(below, below.relevant), middle) >= 0
    return np.where(there, area, 0.0)


def with_pair_gaps(
    volume: CloudVolume, surfaces: list[CloudSurface], areas: list[F64]
) -> tuple[CloudVolume, list[Doubt]]:
    """The volume with what either cloud did not see, by kriging from around it; areas (m,) m² of
    the triangles of each that count and that both saw.
    """
    doubts: list[Doubt] = []
    for surface, inside, sign in zip(surfaces, areas, (1.0, -1.0), strict=True):
        tin = surface.representation.tin
        gaps = find_gaps(tin, inside, surface.spacing_m)
        if not len(gaps.areas):
            continue
        level = design_surface([float(np.median(tin.vertices[:, 2]))])
        seen = partial(seen_above, tin, level, surface.vertex_variance)
        found = bridged_volume(tin, level, inside, gaps, seen)
        size = volume.cut_m3 + volume.fill_m3
        doubts += gap_doubts(found, gaps.area_m2, volume.area_m2, size, volume.sigma_m3)
        cut, fill = with_net(volume.cut_m3, volume.fill_m3, sign * found.more_m3)
        volume = dataclasses.replace(volume, cut_m3=cut, fill_m3=fill)
        unseen = volume.budget_m6.get("unseen", 0.0) + found.variance_m6
        volume = with_lines(volume, {"unseen": unseen})
    return volume, doubts


def with_pair_steps(
    volume: CloudVolume, surfaces: list[CloudSurface], areas: list[F64]
) -> CloudVolume:
    """The volume with what lies between the points of either cloud: steps of which no point tells
    where they are. areas (m,) m² : as for :func:`with_pair_gaps`
    """
    variance = 0.0
    for surface, inside in zip(surfaces, areas, strict=True):
        height = np.zeros(len(surface.representation.tin.vertices))  # gaps are kriged
        variance += between_points(surface, inside, height).random_m6
    return with_lines(volume, {"between_points": variance}) if variance > 0.0 else volume


def with_walls(
    volume: CloudVolume,
    ground: PairGround,
    changed: Bool,
    things: list[StandingObject],
    doubted: bool,
) -> CloudVolume:
    """The volume with what is left of things that were taken out in sigma: steep faces beside them,
    and no more than what they were; and what faces enclose that are ``doubted``. changed : (m,)
    triangles of the difference
    """
    tin = ground.tin
    rows = np.flatnonzero(changed & ground.on_face[tin.triangles].any(axis=1))
    middle = tin.vertices[tin.triangles[rows], :2].mean(axis=1)
    beside = np.zeros(len(rows), np.bool_)
    for one in things:
        away = np.hypot(*(middle - (one.x_m, one.y_m)).T)
        beside |= away <= 0.5 * one.size_m + APART_M
    faces = np.zeros(len(changed), np.bool_)
    faces[rows[beside]] = True
    wall = min(wall_m6(tin, faces, FACE_M), sum(one.volume_m3 for one in things) ** 2)
    if doubted:
        inside_m2 = np.where(changed, footprint_areas(tin.vertices, tin.triangles), 0.0)
        wall += enclosed_m6(tin, inside_m2, ground.on_face)
    return with_lines(volume, {"wall": wall}) if wall > 0.0 else volume


def pair_verdict(
    volume: CloudVolume,
    surfaces: list[CloudSurface],
    areas: list[F64],
    ground: PairGround | None,
    inside: Bool | None = None,
) -> tuple[CloudVolume, Verdict]:
    """The volume between two clouds with what they say of one another, and its verdict. areas (m,)
    m² : of the triangles of each that count · inside : (k,) triangles of their difference within an
    outline, None for all.
    """
    if any(s.sigma_m is None for s in surfaces) or math.isnan(volume.sigma_m3):
        return volume, Verdict()
    pairs = zip(surfaces, surfaces[::-1], areas, strict=True)
    areas = [overlap_area(*pair) for pair in pairs]
    volume, doubts = with_pair_gaps(volume, surfaces, areas)
    volume = with_pair_steps(volume, surfaces, areas)
    things = [one for k in (0, 1) for one in objects_within(surfaces[k], areas[k])]
    doubts += new_object_doubts(things, volume.sigma_m3)
    doubts += [doubt for s in surfaces if s.given_faces is None for doubt in s.doubts]
    doubts += unit_doubts(surfaces[0].points, surfaces[1].points)
    if ground is None:
        return volume, Verdict(tuple(doubts))
    tin, least = ground.tin, ground.least_m
    within = np.ones(len(tin.triangles), np.bool_) if inside is None else inside
    volume, edge = with_edge(volume, ground, within, inside is not None)
    height = tin.vertices[tin.triangles, 2].mean(axis=1) - ground.unchanged.offset_m
    changed = within & (np.abs(height) > least)
    if changed.any():
        walls = wall_doubts(tin, ground.level, changed, ground.on_face, least)
        volume = with_walls(volume, ground, changed, things, len(walls) > 0)
        doubts += walls
    sampled = [s.representation.sampled_area for s in surfaces]
    outline = outline_variance(tin, within, tin.vertices[:, 2], sampled)
    if outline > 0.0:
        volume = with_lines(volume, {"outline": outline})
    volume, more = with_offset(volume, ground.unchanged)
    if inside is None:  # of all that both saw
        more += registration_doubts(volume, ground.cells, ground.unchanged)
    return volume, Verdict(tuple(doubts + edge + more))
