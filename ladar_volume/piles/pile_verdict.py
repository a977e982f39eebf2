"""One pile above the base that was asked for, and what speaks against its volume."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ladar_volume.clouds.cloud_volume import CloudVolume, Solid, corrected_volume
from ladar_volume.clouds.ground_readings import GroundReadings, ground_readings
from ladar_volume.clouds.pair_verdict import pair_verdict
from ladar_volume.clouds.volume_verdict import (
    faces_around,
    seen_volume,
    surface_doubts,
    volume_with_verdict,
    with_gaps,
    with_growth,
    with_lines,
)
from ladar_volume.ground.polynomial import design_surface
from ladar_volume.model.errors import LadarVolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.piles import GROUND_BASES, PILE_BASES
from ladar_volume.model.records import Plane
from ladar_volume.model.verdict import Doubt, Verdict
from ladar_volume.piles.pile_bases import (
    PilePart,
    solid_above_plane,
    solid_above_second,
    solid_above_toe,
)
from ladar_volume.piles.pile_site import (
    Made,
    Site,
    SiteTask,
    ground_parameters,
    ring_around,
)
from ladar_volume.piles.toe_bases import ToeBase
from ladar_volume.uncertainty.ground_field import Roughness
from ladar_volume.volume.field_checks.base_readings import below_base, doubted_m6
from ladar_volume.volume.field_checks.completeness import wall_doubts
from ladar_volume.volume.field_checks.cut_bodies import body_cut, cut_doubts
from ladar_volume.volume.polygon import areas_inside, check_polygon, signed_area

#: Share of an outline without surface of which there is a word.
UNSEEN = 0.02


@dataclass(frozen=True)
class RequestedBase:
    """solid : above the base that was asked for · plane : that base, None where it is no polynomial
    · readings : of the ground, where it is that
    """

    solid: Solid
    plane: Plane | None
    readings: GroundReadings | None = None


def requested_base(
    site: Site,
    part: PilePart,
    task: SiteTask,
    parameters: Parameters,
    made: Mapping[str, Made],
    rough: Roughness | None,
) -> RequestedBase:
    """The solid above the base that was asked for. Raises why that base cannot be made."""
    C, correct = site.covariance, task.correct
    if task.base == "second":
        assert task.second is not None
        return RequestedBase(solid_above_second(part, task.second), None)
    if task.base in ("level", "plane"):
        v = parameters.volume
        plane = design_surface([v.level_m] if task.base == "level" else v.plane)
        return RequestedBase(solid_above_plane(part, plane, parameters, correct, C), plane)
    base = made[task.base]
    if isinstance(base, LadarVolumeError):
        raise base
    if isinstance(base, ToeBase):
        return RequestedBase(solid_above_toe(part, base, rough, parameters, correct, C), base.plane)
    solid = solid_above_plane(part, base, parameters, correct, C)
    wide = 0.0 if task.base == "site_ground" else parameters.volume.ground_ring_m
    ring = ring_around(site, part, wide)
    return RequestedBase(
        solid, base, ground_readings(site.surface, base, part.inside_m2, parameters, ring)
    )


def pile_with_verdict(
    site: Site,
    part: PilePart,
    task: SiteTask,
    parameters: Parameters,
    requested: RequestedBase,
    reference: Plane | None,
    ground: Made,
) -> tuple[CloudVolume, Verdict]:
    """The volume with what lies between its points, and its verdict."""
    same = task.base in PILE_BASES
    volume = corrected_volume(requested.solid, task.words, same)
    if task.base == "second":
        return pair_with_verdict(site, part, task, volume)
    surface, inside = site.surface, part.inside_m2
    gapped = with_gaps(volume, surface, inside, reference, parameters.volume.outline)
    seen = seen_volume(gapped, surface, inside, reference)
    volume, verdict = volume_with_verdict(
        seen, surface, inside, requested.readings, parameters, reference
    )
    if not same or not isinstance(ground, Plane):
        return volume, verdict
    doubts: list[Doubt] = []
    rise, mask = parameters.volume.object_height_m, inside > 0
    if requested.readings is None:
        volume, doubts = with_growth(volume, surface, ground, inside, parameters.volume)
    own = ground_parameters(parameters)
    doubts += cut_doubts(body_cut(part.tin, ground, mask, own.volume), volume.sigma_m3, own)
    faces = faces_around(surface, ground, inside, rise)
    doubts += wall_doubts(part.tin, ground, mask, faces, rise)
    if part.pile.is_found:
        doubts += risen_doubts(volume)
    if volume.net_m3 > 0.0 and task.base in GROUND_BASES:
        lying = below_base(volume.cut_m3, volume.fill_m3, volume.sigma_fill_m3)
        chosen = volume.budget_m6.get("base_model", 0.0) + doubted_m6(lying)
        volume = with_lines(volume, {"base_model": chosen}) if lying else volume
        doubts += lying
    return volume, verdict + Verdict(tuple(doubts))


def pair_with_verdict(
    site: Site, part: PilePart, task: SiteTask, volume: CloudVolume
) -> tuple[CloudVolume, Verdict]:
    """The volume above a second surface with what the two say of one another."""
    assert task.second is not None
    surfaces = [site.surface, task.second]
    ring = check_polygon(part.pile.ring)
    areas = [part.inside_m2, areas_inside(task.second.representation.tin, ring)]
    verdict = Verdict()
    for surface, area in zip(surfaces, areas, strict=True):
        if surface.given_faces is None:
            verdict += Verdict(tuple(surface_doubts(surface, area)))
    if any(surface.given_faces is not None for surface in surfaces):
        return volume, verdict
    inside = None if site.pair is None else areas_inside(site.pair.tin, ring) > 0
    volume, more = pair_verdict(volume, surfaces, areas, site.pair, inside)
    return volume, verdict + more


def risen_doubts(volume: CloudVolume) -> list[Doubt]:
    """What was found because it rises above the ground of the site lies below its own base."""
    if volume.net_m3 > 0.0:
        return []
    words = (
        f"the pile was found because it rises above the ground of the site, and lies "
        f"{-volume.net_m3:.3g} m³ below this base: the ground is not one plane; draw the outline "
        "at its toe, name another --base, or set ground.degree"
    )
    return [Doubt("below_base", words, -volume.net_m3)]


def outline_doubts(part: PilePart) -> list[Doubt]:
    """A part of an outline is not covered by the surface."""
    area = abs(signed_area(part.pile.ring))
    missing = 1.0 - part.area_m2 / area
    if missing <= UNSEEN:
        return []
    words = (
        f"{100 * missing:.0f} % of the outline ({missing * area:.4g} m²) lie where nothing was "
        "surveyed and are not in the volume; survey them, or draw the outline within the survey"
    )
    return [Doubt("outline_unseen", words, missing)]
