"""A site without its piles: what is asked for, and the bases of a pile on it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.clouds.pair_verdict import PairGround
from ladar_volume.ground.robust_ground import fit_ground, refine
from ladar_volume.model.errors import GroundError, LadarVolumeError, VolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.piles import TOE_BASES, Pile
from ladar_volume.model.records import I64, Bool, Plane
from ladar_volume.piles.pile_bases import (
    PilePart,
    pile_part,
)
from ladar_volume.piles.toe_bases import ToeBase, toe_base
from ladar_volume.piles.toe_line import PlacedSurface, toe_line
from ladar_volume.tin.full_tin import vertex_mask
from ladar_volume.uncertainty.ground_field import Roughness
from ladar_volume.volume.neighbourhood import SparseF64
from ladar_volume.volume.outline import surroundings
from ladar_volume.volume.polygon import areas_inside, check_polygon, signed_area
from ladar_volume.volume.volume_loads import ground_field

#: Least area of an outline, in squares of the usual edge.
SMALLEST = 4.0


@dataclass(frozen=True)
class SiteTask:
    """What is asked for at all piles.

    parameters : of the base, where it is a level or a plane, and of the ground · base : one of
    :data:`PILE_BASES`, "level", "plane" or "second" · is_named : whether the user named it · words
    : the base as printed · second : the surface that is the base "second" · correct : whether cut
    and fill are corrected near the base
    """

    parameters: Parameters
    base: str
    is_named: bool = True
    words: str = ""
    second: CloudSurface | None = None
    correct: bool = True


@dataclass(frozen=True)
class Site:
    """surface · covariance : (n, n) m² of its heights, None where they are not known · within :
    (m,) triangles in any outline · ground : of the whole site, or why there is none · placed : the
    surface · pair : what the surface and a second one say of one another, where that is the base
    """

    surface: CloudSurface
    covariance: SparseF64 | None
    within: Bool
    ground: Plane | GroundError = field(repr=False)
    placed: PlacedSurface = field(repr=False)
    pair: PairGround | None = None

    @cached_property
    def roughness(self) -> Roughness | None:
        """How the ground deviates from that of the whole site, which is the same for all piles."""
        if not isinstance(self.ground, Plane):
            return None
        tin, variance = self.surface.representation.tin, self.surface.vertex_variance
        nothing = np.zeros(len(self.ground.beta)), np.zeros(len(tin.triangles))
        field = ground_field(tin, self.ground, *nothing, variance)
        return None if field is None else field.rough


#: A base of a pile, or why there is none.
Made = Plane | ToeBase | LadarVolumeError


def site_of(surface: CloudSurface, piles: Sequence[Pile], parameters: Parameters) -> Site:
    """The site without its piles."""
    tin = surface.representation.tin
    within = np.zeros(len(tin.triangles), bool)
    for pile in piles:
        within |= areas_inside(tin, check_polygon(pile.ring)) > 0
    covariance = None
    if surface.sigma_m is not None:
        covariance = surface.representation.covariance(surface.sigma_m)
    around = surroundings(tin, within, 0.0)
    coarse = parameters.volume.object_height_m / 2
    ground: Plane | GroundError
    try:
        ground = fit_ground(
            tin.vertices, surface.vertex_variance, parameters.ground, coarse, select=around
        )
    except GroundError as error:
        ground = error
    return Site(surface, covariance, within, ground, PlacedSurface.of(tin))


def checked_part(site: Site, pile: Pile) -> PilePart:
    """The part of the surface in an outline that is large enough to hold some of it. Raises
    :class:`VolumeError` (pile_small).
    """
    part = pile_part(site.surface, pile)
    least = SMALLEST * site.placed.spacing_m**2
    area = abs(signed_area(pile.ring))
    if area < least:
        raise VolumeError(
            f"the outline holds {area:.3g} m², less than the surface can show ({least:.3g} m²): is "
            "it in the units and the system of the points?",
            reason="pile_small",
            value=area,
        )
    return part


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


def made_bases(site: Site, part: PilePart, parameters: Parameters) -> dict[str, Made]:
    """All bases of a pile, by name."""
    out: dict[str, Made] = {"ground": own_ground(site, part, parameters)}
    out["site_ground"] = site.ground
    variance = site.surface.vertex_variance
    try:
        line = toe_line(site.placed, part.pile.ring)
    except VolumeError as error:
        return out | dict.fromkeys(TOE_BASES, error)
    for name in TOE_BASES:
        try:
            out[name] = toe_base(name, site.placed, part.pile.ring, line, variance)
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


def reference_of(part: PilePart, made: Mapping[str, Made]) -> Plane | None:
    """A plane near the base, where that is none itself: of the toe line, or of the ground."""
    for name in ("toe_plane", "ground"):
        base = made[name]
        if isinstance(base, ToeBase):
            return base.plane
        if isinstance(base, Plane):
            return base
    return None
