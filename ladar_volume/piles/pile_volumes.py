"""Every pile of a site: its volume above the base that was asked for, with a verdict, and above
every other base; and the sum of all piles.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.clouds.cloud_volume import CloudVolume, Solid, corrected_volume
from ladar_volume.clouds.pair_verdict import pair_ground
from ladar_volume.clouds.volume_verdict import (
    with_lines,
)
from ladar_volume.ground.heights import height_above
from ladar_volume.model.errors import LadarVolumeError
from ladar_volume.model.piles import ALIKE, PILE_BASES, Pile
from ladar_volume.model.records import F64, I64, Plane
from ladar_volume.model.verdict import Doubt, Verdict
from ladar_volume.piles.pile_bases import (
    Net,
    PilePart,
    above_plane,
    above_toe,
    roughness_around,
)
from ladar_volume.piles.pile_site import (
    Made,
    Site,
    SiteTask,
    checked_part,
    made_bases,
    own_parameters,
    reference_of,
    site_of,
)
from ladar_volume.piles.pile_verdict import outline_doubts, pile_with_verdict, requested_base
from ladar_volume.piles.toe_bases import ToeBase
from ladar_volume.tin.full_tin import footprint_areas, vertex_mask
from ladar_volume.uncertainty.ground_field import Roughness
from ladar_volume.volume.field_checks.plant_cover import known_cover

#: Share of the smallest pile that several outlines may share.
TWICE = 1e-3
#: Lines of a budget that come from where the points lie, whatever the base.
PLACES = ("between_points", "unseen", "outline")


@dataclass(frozen=True)
class VolumeAboveBase:
    """A volume above one base: net and its standard deviation, m³ (NaN where it is not known), or
    why there is none.
    """

    net_m3: float
    sigma_m3: float
    why: str = ""


class RowsHeld(NamedTuple):
    """The rows (k,) of an array that are not zero, and what they hold: a site has many piles, and
    each is small.
    """

    rows: I64
    values: F64

    @classmethod
    def of(cls, whole: F64) -> RowsHeld:
        """Those of an array (n,) or (n, c)."""
        rows = np.flatnonzero(whole.reshape(len(whole), -1).any(axis=1))
        return cls(rows, whole[rows])

    def add_to(self, whole: F64) -> None:
        """Adds them to an array."""
        whole[self.rows] += self.values


@dataclass(frozen=True)
class PileVolume:
    """pile · volume : above the base that was asked for · curved_m6 : second-order variance of cut
    and fill · gradients : (n, 2) by the heights, of net and cut, for every surface · verdict ·
    inside_m2 : (m,) of each triangle · height_m : of its highest point above the base · top_m : of
    that point · bases : above every base · plane : the base as a polynomial, None for triangles ·
    reference : a plane near the base, for pictures
    """

    pile: Pile
    volume: CloudVolume
    curved_m6: float
    gradients: tuple[tuple[CloudSurface, RowsHeld], ...]
    verdict: Verdict
    inside_m2: RowsHeld
    height_m: float
    top_m: float
    bases: Mapping[str, VolumeAboveBase]
    plane: Plane | None
    reference: Plane | None


@dataclass(frozen=True)
class RefusedPile:
    """A pile that has no volume, and why."""

    pile: Pile
    error: LadarVolumeError


@dataclass(frozen=True)
class SitePiles:
    """piles : with a volume, in the order given · refused_piles : without · total : of all piles,
    what they share counted as shared · verdict : of the outlines together · inside_m2 : (m,) of
    each triangle in all outlines
    """

    piles: list[PileVolume]
    refused_piles: list[RefusedPile]
    total: CloudVolume
    verdict: Verdict
    inside_m2: F64


def piles_of(
    surface: CloudSurface, piles: Sequence[Pile], task: SiteTask, progress: Callable[[str], None]
) -> SitePiles:
    """All piles. Raises what the first pile raises where none has a volume."""
    site = site_of(surface, piles, task.parameters)
    if task.second is not None:
        site = dataclasses.replace(site, pair=pair_ground([surface, task.second]))
    found: list[PileVolume] = []
    refused: list[RefusedPile] = []
    for number, pile in enumerate(piles, 1):
        progress(f"pile {number} of {len(piles)}: {pile.name}")
        try:
            found.append(pile_volume(site, pile, task))
        except LadarVolumeError as error:
            refused.append(RefusedPile(pile, error))
    if not found:
        raise refused[0].error
    total = found[0].volume if len(found) == 1 else total_volume(found, task)
    inside = np.zeros(len(surface.representation.tin.triangles))
    for one in found:
        one.inside_m2.add_to(inside)
    doubts = [*refused_doubts(refused), *twice_doubts(surface, found, inside)]
    return SitePiles(found, refused, total, Verdict(tuple(doubts)), inside)


def pile_volume(site: Site, pile: Pile, task: SiteTask) -> PileVolume:
    """One pile above the base that was asked for, and above the others."""
    part = checked_part(site, pile)
    parameters = own_parameters(task, pile)
    made = made_bases(site, part, parameters)
    ground = made["ground"]
    rough = roughness_around(part, ground) if isinstance(ground, Plane) else None
    asked = requested_base(site, part, task, parameters, made, rough)
    reference = asked.plane if asked.plane is not None else reference_of(part, made)
    volume, verdict = pile_with_verdict(site, part, task, parameters, asked, reference, ground)
    nets = {
        n: net_above(part, base, site.roughness if n == "site_ground" else rough)
        for n, base in made.items()
        if n != task.base
    }
    told = (0.0, 0.0)
    if isinstance(ground, Plane):
        known = known_cover(parameters.volume, own_ground=True)
        rise = parameters.volume.object_height_m
        told = known.correction(part.tin, ground, part.inside_m2, rise)
    bases = volumes_above_bases(part, nets, volume, told)
    if not task.is_named:
        volume = with_choice(volume, bases)
    verdict = verdict + Verdict(tuple(outline_doubts(part)))
    high, top = summit(part, reference)
    return PileVolume(
        pile,
        volume,
        asked.solid.curved_m6,
        tuple((surface, RowsHeld.of(g)) for surface, g in asked.solid.gradients),
        verdict,
        RowsHeld.of(part.inside_m2),
        high,
        top,
        bases,
        asked.plane,
        reference,
    )


def net_above(part: PilePart, base: Made, rough: Roughness | None = None) -> Net | LadarVolumeError:
    """The net volume above a base, or why there is none."""
    if isinstance(base, LadarVolumeError):
        return base
    return (
        above_toe(part, base, rough)
        if isinstance(base, ToeBase)
        else above_plane(part, base, rough)
    )


def volumes_above_bases(
    part: PilePart,
    nets: Mapping[str, Net | LadarVolumeError],
    requested: CloudVolume,
    told: tuple[float, float] = (0.0, 0.0),
) -> dict[str, VolumeAboveBase]:
    """The volumes above every base, ``requested`` for the one that is not among the nets, with the
    standard deviations of their noise and of what heights share; what lies between the points is
    taken from the volume that was asked for. told : what plants of a known height take from them,
    m³, and its standard deviation.
    """
    known = {name: net for name, net in nets.items() if isinstance(net, Net)}
    columns = np.column_stack([net.gradient for net in known.values()] or [part.by_height])
    variance = part.surface.variance(columns)
    variance = variance + sum(part.surface.shared_lines(columns).values())
    between = sum(requested.budget_m6.get(name, 0.0) for name in PLACES)
    out = {}
    for name in PILE_BASES:
        net = nets.get(name)
        if net is None:
            out[name] = VolumeAboveBase(requested.net_m3, requested.sigma_m3)
        elif isinstance(net, LadarVolumeError):
            out[name] = VolumeAboveBase(math.nan, math.nan, str(net))
        else:
            noise = float(variance[list(known).index(name)]) + sum(net.extra.values())
            variance_m6 = noise + between + told[1] ** 2
            out[name] = VolumeAboveBase(net.net_m3 + told[0], math.sqrt(max(variance_m6, 0.0)))
    return out


def with_choice(volume: CloudVolume, bases: Mapping[str, VolumeAboveBase]) -> CloudVolume:
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


def refused_doubts(refused: Sequence[RefusedPile]) -> list[Doubt]:
    """Piles that have no volume are missing in the sum."""
    return [
        Doubt("pile_refused", f"pile {r.pile.name} is not in the sum: {r.error}", None)
        for r in refused
    ]


def twice_doubts(surface: CloudSurface, piles: Sequence[PileVolume], inside_m2: F64) -> list[Doubt]:
    """Outlines lie over one another, so that the sum counts a part twice. inside_m2 : (m,) of each
    triangle in all of them
    """
    tin = surface.representation.tin
    own = footprint_areas(tin.vertices, tin.triangles)
    twice = float(np.maximum(inside_m2 - own, 0.0)[tin.relevant].sum())
    if twice <= TWICE * min(float(p.inside_m2.values.sum()) for p in piles):
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
    gradients = []
    for k, (surface, _) in enumerate(piles[0].gradients):
        gradient = np.zeros((len(surface.representation.tin.vertices), 2))
        for pile in piles:
            pile.gradients[k][1].add_to(gradient)
        gradients.append((surface, gradient))
    solid = Solid(
        sum(p.volume.cut_raw_m3 for p in piles),
        sum(p.volume.fill_raw_m3 for p in piles),
        sum(p.volume.area_m2 for p in piles),
        tuple(gradients),
        None,
        sum(p.curved_m6 for p in piles),
    )
    total = corrected_volume(solid, task.words, piles[0].volume.base_same_survey)
    lines = summed_lines(piles, total, task)
    total = total if math.isnan(total.sigma_m3) else with_lines(total, lines)
    return dataclasses.replace(
        total,
        cut_m3=sum(p.volume.cut_m3 for p in piles),
        fill_m3=sum(p.volume.fill_m3 for p in piles),
        folded_m3=sum(p.volume.folded_m3 for p in piles),
        near_area_m2=sum(p.volume.near_area_m2 for p in piles),
        freedom=min(p.volume.freedom for p in piles),
        cover_m3=sum(p.volume.cover_m3 for p in piles),
    )


def summed_lines(
    piles: Sequence[PileVolume], total: CloudVolume, task: SiteTask
) -> dict[str, float]:
    """The lines of all piles that the total has not, m⁶: those that are wrong alike as such."""
    alike = {"base_choice", "registration"}
    if task.base == "site_ground":
        alike |= {"base_surface"}
    if any(p.volume.cover_m3 for p in piles):  # of a height that holds for all of them
        alike |= {"vegetation"}
    lines: dict[str, float] = {}
    for p in piles:
        for name, value in p.volume.budget_m6.items():
            if name not in total.budget_m6:
                more = math.sqrt(value) if name in alike else value
                lines[name] = lines.get(name, 0.0) + more
    return {name: v**2 if name in alike else v for name, v in lines.items()}
