"""Every pile of a site: its volume above the base that was asked for, with a verdict, and above
every other base; and the sum of all piles.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.clouds.cloud_volume import CloudVolume, Solid, finished
from ladar_volume.clouds.ground_readings import GroundReadings, ground_readings
from ladar_volume.clouds.volume_verdict import judged, surface_doubts, with_lines
from ladar_volume.ground.polynomial import design_surface, height_above
from ladar_volume.ground.robust_ground import fit_ground, refine
from ladar_volume.model.errors import GroundError, LadarVolumeError, VolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.piles import ALIKE, PILE_BASES, TOE_BASES, Pile
from ladar_volume.model.records import F64, I64, Bool, Plane
from ladar_volume.model.verdict import Doubt, Verdict
from ladar_volume.piles.pile_bases import (
    Net,
    PilePart,
    above_plane,
    above_toe,
    pile_part,
    solid_above_plane,
    solid_above_second,
    solid_above_toe,
)
from ladar_volume.piles.toe_bases import ToeBase, toe_base
from ladar_volume.piles.toe_line import spacing_of, toe_line
from ladar_volume.tin.full_tin import footprint_areas, vertex_mask
from ladar_volume.volume.field_checks.completeness import cut_doubts
from ladar_volume.volume.neighbourhood import SparseF64
from ladar_volume.volume.outline import surroundings
from ladar_volume.volume.polygon import areas_inside, check_polygon

#: Share of an outline without surface, and area that several outlines share, of which there is a
#: word.
UNSEEN, TWICE = 0.02, 1e-3
#: Least area of an outline, in squares of the usual edge.
SMALLEST = 4.0


@dataclass(frozen=True)
class Above:
    """A volume above one base: net and its standard deviation, m³ (NaN where it is not known), or
    why there is none.
    """

    net_m3: float
    sigma_m3: float
    why: str = ""


@dataclass(frozen=True)
class PileVolume:
    """pile · volume : above the base that was asked for · solid : before its noise · verdict ·
    inside_m2 : (m,) of each triangle · height_m : of its highest point above the base · top_m : of
    that point · bases : above every base · plane : the base as a polynomial, None for triangles ·
    reference : a plane near the base, for pictures
    """

    pile: Pile
    volume: CloudVolume
    solid: Solid
    verdict: Verdict
    inside_m2: F64
    height_m: float
    top_m: float
    bases: Mapping[str, Above]
    plane: Plane | None
    reference: Plane | None


@dataclass(frozen=True)
class Refused:
    """A pile that has no volume, and why."""

    pile: Pile
    error: LadarVolumeError


@dataclass(frozen=True)
class SitePiles:
    """piles : with a volume, in the order given · refused : without · total : of all piles, what
    they share counted as shared · verdict : of the outlines together
    """

    piles: list[PileVolume]
    refused: list[Refused]
    total: CloudVolume
    verdict: Verdict


@dataclass(frozen=True)
class SiteTask:
    """What is asked for at all piles.

    parameters : of the base, where it is a level or a plane, and of the ground · base : one of
    :data:`PILE_BASES`, "level", "plane" or "second" · chosen : whether the user named it · words :
    the base as printed · second : the surface that is the base "second" · correct : whether cut and
    fill are corrected near the base
    """

    parameters: Parameters
    base: str
    chosen: bool
    words: str
    second: CloudSurface | None = None
    correct: bool = True


@dataclass(frozen=True)
class Site:
    """surface · covariance : (n, n) m² of its heights, None where they are not known · within :
    (m,) triangles in any outline · ground : of the whole site, or why there is none
    """

    surface: CloudSurface
    covariance: SparseF64 | None
    within: Bool
    ground: Plane | GroundError = field(repr=False)


def site_of(surface: CloudSurface, piles: Sequence[Pile], parameters: Parameters) -> Site:
    """The site without its piles."""
    tin = surface.made.tin
    within = np.zeros(len(tin.triangles), bool)
    for pile in piles:
        within |= areas_inside(tin, check_polygon(pile.ring)) > 0
    covariance = None
    if surface.sigma_m is not None:
        covariance = surface.made.covariance(surface.sigma_m)
    around = surroundings(tin, within, 0.0)
    coarse = parameters.volume.object_height_m / 2
    ground: Plane | GroundError
    try:
        ground = fit_ground(
            tin.vertices, surface.vertex_variance, parameters.ground, coarse, select=around
        )
    except GroundError as error:
        ground = error
    return Site(surface, covariance, within, ground)


def piles_of(
    surface: CloudSurface, piles: Sequence[Pile], task: SiteTask, progress: Callable[[str], None]
) -> SitePiles:
    """All piles. Raises what the first pile raises where none has a volume."""
    site = site_of(surface, piles, task.parameters)
    found: list[PileVolume] = []
    refused: list[Refused] = []
    for number, pile in enumerate(piles, 1):
        progress(f"pile {number} of {len(piles)}: {pile.name}")
        try:
            found.append(pile_volume(site, pile, task))
        except LadarVolumeError as error:
            refused.append(Refused(pile, error))
    if not found:
        raise refused[0].error
    total = found[0].volume if len(found) == 1 else total_volume(found, task)
    doubts = [*refused_doubts(refused), *twice_doubts(surface, found)]
    return SitePiles(found, refused, total, Verdict(tuple(doubts)))


def pile_volume(site: Site, pile: Pile, task: SiteTask) -> PileVolume:
    """One pile above the base that was asked for, and above the others."""
    part = checked_part(site, pile)
    parameters = own_parameters(task, pile)
    made = made_bases(site, part, parameters)
    solid, plane, readings = asked_solid(site, part, task, parameters, made)
    same = task.base in PILE_BASES
    reference = plane if plane is not None else reference_of(part, made)
    volume, verdict = judged(
        finished(solid, task.words, same),
        site.surface,
        part.inside_m2,
        readings,
        parameters,
        reference,
    )
    nets = {name: net_above(part, base) for name, base in made.items()}
    bases = all_above(part, nets, volume, task.base)
    if not task.chosen:
        volume = with_choice(volume, bases)
    doubts = list(outline_doubts(part))
    if same and not isinstance(made["ground"], LadarVolumeError):
        ground, like_ground = made["ground"], ground_parameters(parameters)
        assert isinstance(ground, Plane)
        doubts += cut_doubts(part.tin, ground, part.inside_m2 > 0, volume.sigma_m3, like_ground)
    if task.base == "second" and task.second is not None:
        doubts += surface_doubts(task.second, areas_inside(task.second.made.tin, pile.ring))
    high, top = summit(part, reference)
    verdict = verdict + Verdict(tuple(doubts))
    return PileVolume(
        pile, volume, solid, verdict, part.inside_m2, high, top, bases, plane, reference
    )


def checked_part(site: Site, pile: Pile) -> PilePart:
    """The part of the surface in an outline that is large enough to hold some of it. Raises
    :class:`VolumeError` (pile_small).
    """
    part = pile_part(site.surface, pile)
    least = SMALLEST * spacing_of(part.tin) ** 2
    area = ring_area(pile.ring)
    if area < least:
        raise VolumeError(
            f"the outline holds {area:.3g} m², less than the surface can show ({least:.3g} m²): is "
            "it in the units and the system of the points?",
            reason="pile_small",
            value=area,
        )
    return part


def ring_area(ring: F64) -> float:
    """Area, m², within a ring (k, 2)."""
    x, y = (ring - ring[0]).T
    return abs(0.5 * float(x @ np.roll(y, -1) - np.roll(x, -1) @ y))


def own_parameters(task: SiteTask, pile: Pile) -> Parameters:
    """The parameters with the outline of a pile."""
    base = task.base if task.base in ("level", "plane") else "ground"
    volume = dataclasses.replace(
        task.parameters.volume,
        base=base,
        outline="polygon",
        polygon_m=tuple(check_polygon(pile.ring).ravel().tolist()),
    )
    return dataclasses.replace(task.parameters, volume=volume)


def ground_parameters(parameters: Parameters) -> Parameters:
    """The parameters of a pile above the ground."""
    volume = dataclasses.replace(parameters.volume, base="ground")
    return dataclasses.replace(parameters, volume=volume)


#: A base of a pile, or why there is none.
Made = Plane | ToeBase | LadarVolumeError


def made_bases(site: Site, part: PilePart, parameters: Parameters) -> dict[str, Made]:
    """All bases of a pile, by name."""
    out: dict[str, Made] = {"ground": own_ground(site, part, parameters)}
    out["site_ground"] = site.ground
    variance = site.surface.vertex_variance
    try:
        line = toe_line(part.tin, part.pile.ring)
    except VolumeError as error:
        return out | dict.fromkeys(TOE_BASES, error)
    for name in TOE_BASES:
        try:
            out[name] = toe_base(name, part.tin, part.pile.ring, line, variance)
        except LadarVolumeError as error:
            out[name] = error
    return out


def ring_around(site: Site, part: PilePart, ring_m: float) -> I64:
    """Vertices (k,) within ``ring_m`` of a pile (0: all) that are in no outline."""
    around = surroundings(part.tin, part.inside_m2 > 0, ring_m)
    return around[~vertex_mask(part.tin, site.within)[around]]


def own_ground(site: Site, part: PilePart, parameters: Parameters) -> Plane | LadarVolumeError:
    """The ground around one pile, outside all others."""
    if isinstance(site.ground, GroundError):
        return site.ground
    tin, p = part.tin, parameters.volume
    ring = ring_around(site, part, p.ground_ring_m)
    try:
        found = refine(
            tin.vertices[ring],
            site.surface.vertex_variance[ring],
            site.ground,
            parameters.ground,
            p.object_height_m,
        )
    except GroundError as error:
        return error
    return dataclasses.replace(found, support=ring[found.support])


def asked_solid(
    site: Site, part: PilePart, task: SiteTask, parameters: Parameters, made: Mapping[str, Made]
) -> tuple[Solid, Plane | None, GroundReadings | None]:
    """The solid above the base that was asked for, that base as a polynomial, and the readings of
    the ground where it is it. Raises why that base cannot be made.
    """
    C, correct = site.covariance, task.correct
    if task.base == "second":
        assert task.second is not None
        return solid_above_second(part, task.second), None, None
    if task.base in ("level", "plane"):
        v = parameters.volume
        plane = design_surface([v.level_m] if task.base == "level" else v.plane)
        return solid_above_plane(part, plane, parameters, correct, C), plane, None
    base = made[task.base]
    if isinstance(base, LadarVolumeError):
        raise base
    if isinstance(base, ToeBase):
        return solid_above_toe(part, base, parameters, correct, C), base.plane, None
    solid = solid_above_plane(part, base, parameters, correct, C)
    wide = 0.0 if task.base == "site_ground" else parameters.volume.ground_ring_m
    ring = ring_around(site, part, wide)
    readings = ground_readings(site.surface, base, part.inside_m2, parameters, ring)
    return solid, base, readings


def reference_of(part: PilePart, made: Mapping[str, Made]) -> Plane | None:
    """A plane near the base, where that is none itself: of the toe line, or of the ground."""
    for name in ("toe_plane", "ground"):
        base = made[name]
        if isinstance(base, ToeBase):
            return base.plane
        if isinstance(base, Plane):
            return base
    return None


def net_above(part: PilePart, base: Made) -> Net | LadarVolumeError:
    """The net volume above a base, or why there is none."""
    if isinstance(base, LadarVolumeError):
        return base
    return above_toe(part, base) if isinstance(base, ToeBase) else above_plane(part, base)


def all_above(
    part: PilePart,
    nets: Mapping[str, Net | LadarVolumeError],
    asked: CloudVolume,
    asked_name: str,
) -> dict[str, Above]:
    """The volumes above every base with the standard deviations of their noise and of what heights
    share; what lies between the points is taken from the volume that was asked for.
    """
    known = {name: net for name, net in nets.items() if isinstance(net, Net)}
    columns = np.column_stack([net.gradient for net in known.values()] or [part.by_height])
    variance = part.surface.variance(columns)
    variance = variance + sum(part.surface.shared_lines(columns).values())
    between = sum(asked.budget_m6.get(name, 0.0) for name in ("between_points", "unseen"))
    out = {}
    for name, net in nets.items():
        if name == asked_name:
            out[name] = Above(asked.net_m3, asked.sigma_m3)
        elif isinstance(net, LadarVolumeError):
            out[name] = Above(math.nan, math.nan, str(net))
        else:
            noise = float(variance[list(known).index(name)]) + sum(net.extra.values())
            out[name] = Above(net.net_m3, math.sqrt(max(noise + between, 0.0)))
    return out


def with_choice(volume: CloudVolume, bases: Mapping[str, Above]) -> CloudVolume:
    """The volume with the spread between bases that nobody chose between, as of an even
    distribution between the least and the greatest.
    """
    nets = [bases[name].net_m3 for name in ALIKE if math.isfinite(bases[name].net_m3)]
    if len(nets) < 2 or math.isnan(volume.sigma_m3):
        return volume
    return with_lines(volume, {"base_choice": (max(nets) - min(nets)) ** 2 / 12.0})


def summit(part: PilePart, base: Plane | None) -> tuple[float, float]:
    """Height, m, of the highest vertex within an outline above the base, and that of the vertex."""
    rows = np.flatnonzero(vertex_mask(part.tin, part.inside_m2 > 0) & (part.by_height > 0.0))
    v = part.tin.vertices[rows]
    return float(height_above(v, base).max()), float(v[:, 2].max())


def outline_doubts(part: PilePart) -> list[Doubt]:
    """A part of an outline is not covered by the surface."""
    area = ring_area(part.pile.ring)
    missing = 1.0 - part.area_m2 / area
    if missing <= UNSEEN:
        return []
    words = (
        f"{100 * missing:.0f} % of the outline ({missing * area:.4g} m²) lie where nothing was "
        "surveyed and are not in the volume; survey them, or draw the outline within the survey"
    )
    return [Doubt("outline_unseen", words, missing)]


def refused_doubts(refused: Sequence[Refused]) -> list[Doubt]:
    """Piles that have no volume are missing in the sum."""
    return [
        Doubt("pile_refused", f"pile {r.pile.name} is not in the sum: {r.error}", None)
        for r in refused
    ]


def twice_doubts(surface: CloudSurface, piles: Sequence[PileVolume]) -> list[Doubt]:
    """Outlines lie over one another, so that the sum counts a part twice."""
    tin = surface.made.tin
    own = footprint_areas(tin.vertices, tin.triangles)
    total = np.sum([pile.inside_m2 for pile in piles], axis=0)
    twice = float(np.maximum(total - own, 0.0)[tin.relevant].sum())
    if twice <= TWICE * min(float(p.inside_m2.sum()) for p in piles):
        return []
    words = (
        f"outlines overlap: {twice:.4g} m² or more count in several piles, and more than once in "
        "the sum; draw them apart"
    )
    return [Doubt("outlines_overlap", words, twice)]


def total_volume(piles: Sequence[PileVolume], task: SiteTask) -> CloudVolume:
    """The sum over piles: noise and what heights share through the sum of their gradients; other
    lines as independent, but those of one ground or one choice, which are wrong alike.
    """
    surfaces = [surface for surface, _ in piles[0].solid.gradients]
    gradients = tuple(
        (surface, np.sum([p.solid.gradients[k][1] for p in piles], axis=0))
        for k, surface in enumerate(surfaces)
    )
    parts = [p.solid for p in piles]
    solid = Solid(
        sum(p.volume.cut_raw_m3 for p in piles),
        sum(p.volume.fill_raw_m3 for p in piles),
        sum(s.area_m2 for s in parts),
        gradients,
        None,
        sum(s.curved_m6 for s in parts),
    )
    total = finished(solid, task.words, piles[0].volume.base_same_survey)
    alike = {"base_choice", *(("base_surface",) if task.base == "site_ground" else ())}
    lines: dict[str, float] = {}
    for p in piles:
        for name, value in p.volume.budget_m6.items():
            if name in total.budget_m6:
                continue
            lines[name] = lines.get(name, 0.0) + (math.sqrt(value) if name in alike else value)
    lines = {name: v**2 if name in alike else v for name, v in lines.items()}
    total = total if math.isnan(total.sigma_m3) else with_lines(total, lines)
    return dataclasses.replace(
        total,
        cut_m3=sum(p.volume.cut_m3 for p in piles),
        fill_m3=sum(p.volume.fill_m3 for p in piles),
        folded_m3=sum(p.volume.folded_m3 for p in piles),
        near_area_m2=sum(p.volume.near_area_m2 for p in piles),
        freedom=min(p.volume.freedom for p in piles),
    )
