"""Whether the volume of a cloud can be believed: what speaks against its base, its outline, its
points and their noise, each with a number and what to do.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from ladar_volume.clouds.between_points import BetweenPoints, between_points, bridges
from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.clouds.cloud_volume import CloudVolume, has_selected_vertices
from ladar_volume.clouds.ground_cover import (
    body_scatter,
    body_vertices,
    growth_above_ground,
    growth_doubts,
    steep_vertices,
)
from ladar_volume.clouds.ground_readings import GroundReadings
from ladar_volume.clouds.sampling.layers import layer_doubts, two_layers
from ladar_volume.clouds.sampling.object_search import STEP
from ladar_volume.clouds.sampling.objects_beside import beside_doubts, objects_within
from ladar_volume.clouds.sampling.outline_place import outline_variance
from ladar_volume.clouds.sampling.thin_toe import volume_beyond
from ladar_volume.ground.heights import height_above
from ladar_volume.model.parameters import Parameters, VolumeParameters
from ladar_volume.model.records import F64, Bool, Plane, Tin
from ladar_volume.model.verdict import Doubt, Verdict
from ladar_volume.tin.boundary import border, part_numbers
from ladar_volume.tin.full_tin import footprint_areas, vertex_mask
from ladar_volume.volume.centroid import plan_centre
from ladar_volume.volume.cutfill import with_net
from ladar_volume.volume.field_checks.base_readings import (
    base_reading_doubts,
    below_base,
    doubted_m6,
    unsettled,
)
from ladar_volume.volume.field_checks.completeness import surroundings_of
from ladar_volume.volume.field_checks.cut_bodies import cut_m6
from ladar_volume.volume.field_checks.gaps import (
    BridgedVolume,
    bridged_volume,
    find_gaps,
    gap_doubts,
    seen_above,
)
from ladar_volume.volume.field_checks.notches import notch_doubts
from ladar_volume.volume.field_checks.plant_cover import known_cover
from ladar_volume.volume.field_checks.standing_objects import object_doubts
from ladar_volume.volume.field_checks.steep_faces import enclosed_m6, wall_m6

#: Share of the points that are strays, of the area that is holes, of the outline that lies on the
#: edge of the survey, above which there is doubt.
STRAYS, UNSEEN, OPEN = 0.04, 0.1, 0.1
#: Share of the points around a body below which the base has little support.
SUPPORT = 0.5
#: Readings of the ground, and its unevenness, differ by more than so many standard deviations.
SIGMAS = 2.0
#: Height of what grows over the ground, in its scatter: 1.4 for a gamma of order 2, 1.7 for even
#: returns from soil to top.
GROWTH = 2.0
#: The same in shares of the volume, even where sigma holds it.
ROUGH = 0.05
#: What curvature between the points may do, in shares of the volume.
COARSE = 0.02
#: Two surfaces further apart than so many widths of what both saw are of unlike units or datums.
APART_WIDTHS = 2.0


@dataclass(frozen=True)
class Place:
    """One part of the outline: x, y of its centroid, m · extent_m : (x0, y0, x1, y1) · area_m2 ·
    net_m3 : above the base · top_m, bottom_m : highest and lowest vertex
    """

    x_m: float
    y_m: float
    extent_m: tuple[float, float, float, float]
    area_m2: float
    top_m: float
    bottom_m: float


def places(surface: CloudSurface, inside: F64, most: int = 10) -> list[Place]:
    """The parts (joined by edges) of an outline, the largest by area first, ``most`` of them;
    inside (m,) m² is the area of each triangle in it.
    """
    tin, mask = surface.representation.tin, inside > 0
    part = part_numbers(tin.neighbours, mask)
    area = np.bincount(part[mask], inside[mask], minlength=1)
    out = []
    for k in np.argsort(-area, kind="stable")[:most].tolist():
        own = part == k
        if not own.any():
            break
        r = tin.vertices[vertex_mask(tin, own)]
        low, high = r.min(axis=0).tolist(), r.max(axis=0).tolist()
        x, y = plan_centre(tin, tin.triangles[own], inside[own])
        extent = (low[0], low[1], high[0], high[1])
        out.append(Place(x, y, extent, float(area[k]), high[2], low[2]))
    return out


def open_share(surface: CloudSurface, mask: Bool) -> float:
    """Share of the boundary of triangles (m,), by length, beyond which there is no surface."""
    _, length, open_ = border(surface.representation.tin, mask)
    total = float(length.sum())
    return float(length[open_].sum()) / total if total > 0 else 0.0


def shrunk_doubts(
    surface: CloudSurface, inside: F64, height: F64, volume: CloudVolume
) -> list[Doubt]:
    """A surface of some of the points ends before they do, by the chords of its outline; height
    (n,) m of the vertices above the base.
    """
    made = surface.representation
    if made.sampled_area is None or not has_selected_vertices(surface):
        return []
    tin = made.tin
    area = float(footprint_areas(tin.vertices, tin.triangles[tin.relevant]).sum())
    _, everywhere, _ = border(tin, tin.relevant)
    ends, length, open_ = border(tin, inside > 0)
    ends, length = ends[open_], length[open_]
    if not len(length):
        return []
    rise = np.abs(height[ends]).mean(axis=1)
    lost_m2 = (made.sampled_area.area_m2 - area) * float(length.sum() / everywhere.sum())
    lost_m3 = lost_m2 * float(length @ rise / length.sum())
    # what the line of the edge allows for is loss, too: it does not excuse a cause that is known
    sigma = math.sqrt(max(volume.sigma_m3**2 - volume.budget_m6.get("outline", 0.0), 0.0))
    if not lost_m3 > SIGMAS * sigma:
        return []
    words = (
        f"the vertices that were chosen leave out {lost_m2:.3g} m² at the edge of what was "
        f"sampled, about {lost_m3:.3g} m³ against a sigma of {sigma:.3g} m³ inside it; take every "
        "point (without --vertices or --tolerance), or a base that meets the surface there"
    )
    return [Doubt("outline_shrunk", words, lost_m3)]


def stray_doubts(strays: int, points: int) -> list[Doubt]:
    """Too many points were left out."""
    share = strays / max(points, 1)
    if share <= STRAYS:
        return []
    words = (
        f"{100 * share:.1f} % of the points ({strays:,}) lie off the surface and are left out; "
        "look at them, clean the cloud by hand, or compare with --clean off"
    )
    return [Doubt("outliers", words, share)]


def surface_doubts(surface: CloudSurface, inside: F64) -> list[Doubt]:
    """What the surface itself says: unseen area, noise that cannot be told."""
    out = unseen_doubts(float(inside[bridges(surface)].sum()), float(inside.sum()))
    if surface.sigma_m is None:
        words = f"the noise of the points is {surface.sigma_from}; give --sigma"
        out.append(Doubt("noise_unknown", words, float(len(surface.points))))
    return out


def unseen_doubts(hole: float, area: float) -> list[Doubt]:
    """So much of the area that counts, m², is bridged."""
    if not hole > UNSEEN * area:
        return []
    words = (
        f"{hole:.4g} m² of the {area:.4g} m² that count ({100 * hole / area:.0f} %) have no "
        "points and are bridged by long triangles; scan them, or leave them out with --max-edge"
    )
    return [Doubt("unseen", words, hole / area)]


def outline_doubts(surface: CloudSurface, inside: F64) -> list[Doubt]:
    """A body that runs out of the survey is not whole, and has no ground on that side."""
    return open_doubts(open_share(surface, inside > 0))


def open_doubts(share: float) -> list[Doubt]:
    """The same from the share of the outline on the edge of what was sampled."""
    if share <= OPEN:
        return []
    words = (
        f"{100 * share:.0f} % of the outline of the body lie on the edge of what was sampled: "
        "part of it may be missing, and its ground there is not seen; take more of the "
        "surroundings, or give --level or --plane with --outline all"
    )
    return [Doubt("outline_open", words, share)]


def coarse_doubts(volume: CloudVolume, between: BetweenPoints) -> list[Doubt]:
    """The surface is too coarse for the shape."""
    size = max(volume.cut_m3 + volume.fill_m3, 1e-300)
    out = []
    if between.unseen_m3 > COARSE * size:
        words = (
            f"{between.unseen_m3:.3g} m³ ({100 * between.unseen_m3 / size:.1f} %) depend on long "
            "triangles between corners of unlike heights, where nothing was measured; scan these "
            "places, as behind and at the foot of a pile"
        )
        out.append(Doubt("unseen_steps", words, between.unseen_m3))
    if between.drift_m3 <= COARSE * size:
        return out
    words = (
        f"left out point by point the surface gives other volumes: {between.drift_m3:.3g} m³ "
        f"({100 * between.drift_m3 / size:.1f} %) may be missing between the points; scan more "
        "densely, or from more places"
    )
    return [*out, Doubt("coarse", words, between.drift_m3 / size)]


def base_doubts(readings: GroundReadings | None, volume: CloudVolume, by_body: bool) -> list[Doubt]:
    """What speaks against the base, of bodies whose outline was found, and the ground of the same
    cloud.
    """
    out = below_base(volume.cut_m3, volume.fill_m3, volume.sigma_fill_m3) if by_body else []
    if readings is None:
        return out
    r = readings
    if r.support < SUPPORT:
        words = (
            f"the base is supported by {100 * r.support:.0f} % of the {r.ring:,} points around "
            "the body: the ground is no plane there, or covered; give --level, --plane, "
            "--set ground.degree=2, or classified ground as a second cloud"
        )
        out.append(Doubt("base_support", words, r.support))
    limit = SIGMAS * volume.sigma_m3
    noise = SIGMAS * math.sqrt(volume.budget_m6["noise"])
    part = ROUGH * (volume.cut_m3 + volume.fill_m3)
    if math.isfinite(r.uneven_m3) and r.uneven_m3 > min(limit, part) and r.uneven_m3 > noise:
        words = (
            f"the ground is off the base by {1e3 * r.uneven_m:.3g} mm (RMS) over stretches as "
            f"long as half the body, {r.uneven_m3:.3g} m³ under it, against a sigma of "
            f"{volume.sigma_m3:.3g} m³; survey the ground before, or narrow "
            "--set volume.ground_ring_m"
        )
        out.append(Doubt("base_uneven", words, r.uneven_m3))
    if r.others is not None:
        out += base_reading_doubts(r.others, volume.net_m3, volume.sigma_m3, volume.base)
    return out


def with_gaps(
    volume: CloudVolume, surface: CloudSurface, inside: F64, base: Plane | None, outline: str
) -> tuple[CloudVolume, Bool, list[Doubt]]:
    """The volume with what was not seen of the body, by kriging from its surroundings; the
    triangles (m,) over gaps of which that tells; and the doubts. With the ``outline`` "all" the
    volume stays that of the triangles, as in a sequence of levels, and what it would move by is in
    sigma.
    """
    tin = surface.representation.tin
    gap_mask = np.zeros(len(tin.triangles), np.bool_)
    if base is None or surface.sigma_m is None or math.isnan(volume.sigma_m3):
        return volume, gap_mask, []
    gaps = find_gaps(tin, inside, surface.spacing_m)
    if not len(gaps.areas):
        return volume, gap_mask, []
    seen = partial(seen_above, tin, base, surface.vertex_variance)
    found = bridged_volume(tin, base, inside, gaps, seen)
    known = [k for k, gap in enumerate(found.gaps) if math.isfinite(gap.sigma_m3)]
    gap_mask = np.isin(gaps.triangle, [*known, *range(len(found.gaps), len(gaps.areas))])
    volume, doubts = with_bridged(volume, found, gaps.area_m2, outline)
    return volume, gap_mask, doubts


def with_bridged(
    volume: CloudVolume, found: BridgedVolume, gap_m2: float, outline: str
) -> tuple[CloudVolume, list[Doubt]]:
    """What :func:`with_gaps` makes of the gaps, gap_m2 of the area."""
    doubts = gap_doubts(found, gap_m2, volume.area_m2, volume.net_m3, volume.sigma_m3)
    if outline == "all":
        return with_lines(volume, {"unseen": found.variance_m6 + found.more_m3**2}), doubts
    cut, fill = with_net(volume.cut_m3, volume.fill_m3, found.more_m3)
    volume = dataclasses.replace(volume, cut_m3=cut, fill_m3=fill)
    return with_lines(volume, {"unseen": found.variance_m6}), doubts


def with_between_points(volume: CloudVolume, between: BetweenPoints) -> CloudVolume:
    """The volume with what lies between the points in its standard deviations."""
    if math.isnan(volume.sigma_m3):
        return volume
    unseen = volume.budget_m6.get("unseen", 0.0) + between.unseen_m3**2
    return with_lines(volume, {"between_points": between.variance_m6, "unseen": unseen})


def with_lines(volume: CloudVolume, lines: dict[str, float]) -> CloudVolume:
    """The volume with lines (variances, m⁶) of its budget as given, in its standard deviations too.
    Fill that there is none of is no less sure.
    """
    more = sum(v - volume.budget_m6.get(k, 0.0) for k, v in lines.items())
    net, cut, fill = (
        math.sqrt(s**2 + more) for s in (volume.sigma_m3, volume.sigma_cut_m3, volume.sigma_fill_m3)
    )
    return dataclasses.replace(
        volume,
        sigma_m3=net,
        sigma_cut_m3=cut,
        sigma_fill_m3=fill if volume.fill_raw_m3 > 0 else volume.sigma_fill_m3,
        budget_m6={**volume.budget_m6, **lines},
    )


def with_edge(
    volume: CloudVolume, surface: CloudSurface, inside: F64, height: F64, by_body: bool
) -> CloudVolume:
    """The volume with what the place of its edge does to it: where the sampled area ends (line
    ``outline``) and, for the outline of a body, what its toe holds beyond (line ``toe``).
    """
    tin, mask = surface.representation.tin, inside > 0
    lines = {"outline": outline_variance(tin, mask, height, [surface.representation.sampled_area])}
    if by_body:
        lines["toe"] = volume_beyond(tin, mask, height) ** 2
    lines = {name: variance for name, variance in lines.items() if variance > 0.0}
    return with_lines(volume, lines) if lines else volume


def with_readings(
    volume: CloudVolume, readings: GroundReadings | None, doubts: list[Doubt]
) -> CloudVolume:
    """The volume with what the choice of its ground does to it, its unevenness where that is
    doubted, and what lies below its base.
    """
    if math.isnan(volume.sigma_m3):
        return volume
    chosen = 0.0
    if readings is not None and any(doubt.name == "base_uneven" for doubt in doubts):
        chosen = readings.uneven_m3**2
    if readings is not None and readings.others is not None:
        volume = dataclasses.replace(volume, freedom=readings.others.freedom)
        chosen = max(chosen, readings.others.variance_m6)
    chosen += doubted_m6(doubts)
    return with_lines(volume, {"base_model": chosen}) if chosen > 0.0 else volume


class SeenVolume(NamedTuple):
    """volume : with what was not seen of the body · gaps : the doubts about that · height : (n,) m
    of the vertices above the base · between : what lies between the points
    """

    volume: CloudVolume
    gaps: list[Doubt]
    height: F64
    between: BetweenPoints


def seen_volume(
    gapped: tuple[CloudVolume, Bool, list[Doubt]],
    surface: CloudSurface,
    inside: F64,
    base: Plane | None = None,
) -> SeenVolume:
    """What :func:`with_gaps` gives, with what lies between the points."""
    volume, gap_mask, gaps = gapped
    height = height_above(surface.representation.tin.vertices, base)
    return SeenVolume(volume, gaps, height, between_points(surface, inside, height, ~gap_mask))


def volume_with_verdict(
    seen: SeenVolume,
    surface: CloudSurface,
    inside: F64,
    readings: GroundReadings | None,
    parameters: Parameters,
    base: Plane | None = None,
) -> tuple[CloudVolume, Verdict]:
    """A volume with what lies between its points, and its verdict. inside (m,) m² : area of each
    triangle that counts · readings : of the ground, where it is the cloud's own · base : that
    heights count from.
    """
    tin, v = surface.representation.tin, parameters.volume
    by_body = v.outline == "auto"
    volume, gaps, height, between = seen
    found = with_edge(with_between_points(volume, between), surface, inside, height, by_body)
    doubts = (gaps or surface_doubts(surface, inside)) + coarse_doubts(found, between)
    doubts += shrunk_doubts(surface, inside, height, found)
    doubts += outline_doubts(surface, inside) if by_body else []
    doubts += base_doubts(readings, found, by_body and base is not None)
    doubts += [] if base is None else unsettled(base, found.sigma_m3)
    if base is None:
        return with_readings(found, readings, doubts), Verdict(tuple(doubts))
    if math.isnan(found.sigma_m3):
        return with_known_cover(found, tin, base, inside, v), Verdict(tuple(doubts))
    within = objects_within(surface, inside)
    doubts += object_doubts(within, found.sigma_m3)
    faces = np.zeros(len(tin.vertices), np.bool_)
    if by_body or any(doubt.name == "object" for doubt in doubts):
        faces = faces_around(surface, base, inside, v.object_height_m)
    if by_body:
        edges = surroundings_of(tin, base, inside, faces, parameters)
        doubts += edges.doubts(found.sigma_m3, parameters)
        doubts += beside_doubts(surface.objects, within, (v.min_body_m3, found.net_m3))
    elif v.outline == "all":
        doubts += notch_doubts(tin, base, found.cut_m3 + found.fill_m3, found.sigma_m3)
    found = with_missing(found, tin, base, (inside, faces), doubts, parameters)
    own = with_growth if readings is not None else with_layers
    found, more = own(with_readings(found, readings, doubts), surface, base, inside, v)
    return with_known_cover(found, tin, base, inside, v), Verdict((*doubts, *more))


def with_layers(
    volume: CloudVolume, surface: CloudSurface, base: Plane, inside: F64, v: VolumeParameters
) -> tuple[CloudVolume, list[Doubt]]:
    """The volume above a base that is not the cloud's own ground, which two layers of points would
    lift as well, with what they do to it.
    """
    source = surface.representation.tin.source[vertex_mask(surface.representation.tin, inside > 0)]
    layers = two_layers(surface.points, np.sort(source[source >= 0]).astype(np.int64))
    doubts, sigma = layer_doubts(layers, volume.area_m2, volume.sigma_m3)
    return with_lines(volume, {"layers": sigma**2}) if doubts else volume, doubts


def with_missing(
    volume: CloudVolume,
    tin: Tin,
    base: Plane,
    counted: tuple[F64, Bool],
    doubts: list[Doubt],
    parameters: Parameters,
) -> CloudVolume:
    """The volume with what a cut took of the body and what walls may hide or add in sigma, where
    they are doubted. counted : area (m,) m² of each triangle that counts, and vertices (n,) on
    steep faces
    """
    size = abs(volume.cut_m3 - volume.fill_m3)
    lines = missing_lines(size, tin, base, counted, doubts, parameters)
    return with_lines(volume, lines) if lines else volume


def missing_lines(
    size_m3: float,
    tin: Tin,
    base: Plane,
    counted: tuple[F64, Bool],
    doubts: list[Doubt],
    parameters: Parameters,
) -> dict[str, float]:
    """The lines that this adds to a budget, m⁶, of a body of so many m³."""
    lines, (inside, on_face) = dict[str, float](), counted
    doubted = {doubt.name: doubt.value or 0.0 for doubt in doubts}
    if "cut" in doubted:
        lines["cut"] = cut_m6(tin, base, inside, size_m3, parameters)
    if "wall" in doubted or "object" in doubted:
        faces = (inside > 0.0) & on_face[tin.triangles].any(axis=1)
        wall = wall_m6(tin, faces, STEP * parameters.volume.object_height_m)
        # no more of a thing can be left, or be missing, than what was taken out
        if "wall" in doubted:
            lines["wall"] = wall + enclosed_m6(tin, inside, on_face)
        else:
            lines["wall"] = min(wall, doubted["object"] ** 2)
    return {name: variance for name, variance in lines.items() if variance > 0.0}


def faces_around(surface: CloudSurface, base: Plane, inside: F64, rise_m: float) -> Bool:
    """Vertices (n,) on steep faces, for the scatter of the body within an outline (m,) m²."""
    scatter = body_scatter(surface, body_vertices(surface, base, inside > 0, rise_m))
    return steep_vertices(surface, rise_m, 0.0 if math.isnan(scatter) else scatter)


def with_growth(
    volume: CloudVolume, surface: CloudSurface, ground: Plane, inside: F64, v: VolumeParameters
) -> tuple[CloudVolume, list[Doubt]]:
    """The volume with what grows on the ground around it in sigma, where the user has not told. The
    body is what is higher above the ground, within the outline (m,) m².
    """
    if v.ground_cover_m or math.isnan(volume.sigma_m3):
        return volume, []
    high = body_vertices(surface, ground, inside > 0, v.object_height_m)
    growth = growth_above_ground(surface, ground, high, body_scatter(surface, high))
    return with_growth_of(volume, growth)


def with_growth_of(volume: CloudVolume, growth: float) -> tuple[CloudVolume, list[Doubt]]:
    """The same from how high it grows, m."""
    if not growth > 0.0:
        return volume, []
    sigma = GROWTH * growth * volume.area_m2
    return with_lines(volume, {"vegetation": sigma**2}), growth_doubts(growth, sigma)


def with_known_cover(
    volume: CloudVolume, tin: Tin, base: Plane, inside: F64, v: VolumeParameters
) -> CloudVolume:
    """The volume with the plants that the user told of."""
    known = known_cover(v, volume.base_same_survey)
    told, sigma = known.correction(tin, base, inside, v.object_height_m)
    cut, fill = with_net(volume.cut_m3, volume.fill_m3, told)
    volume = dataclasses.replace(volume, cut_m3=cut, fill_m3=fill, cover_m3=told)
    if not sigma > 0.0 or math.isnan(volume.sigma_m3):
        return volume
    found = volume.budget_m6.get("vegetation", 0.0)
    return with_lines(volume, {"vegetation": found + sigma**2})


def counted_areas(surface: CloudSurface, mask: Bool) -> F64:
    """Area (m,) m² of the triangles in the mask (m,), 0 elsewhere."""
    tin = surface.representation.tin
    return np.where(mask, footprint_areas(tin.vertices, tin.triangles), 0.0)


def apart_doubts(volume: CloudVolume) -> list[Doubt]:
    """The two surfaces are further apart than what both saw is wide."""
    wide = math.sqrt(max(volume.area_m2, 0.0))
    apart = abs(volume.cut_m3 - volume.fill_m3) / max(volume.area_m2, 1e-300)
    if not apart > APART_WIDTHS * wide > 0.0:
        return []
    words = (
        f"the two clouds are {apart:.4g} m apart over {wide:.3g} m of width that both saw: are "
        "they in one unit and one system of heights? Say so with --units or --crs"
    )
    return [Doubt("apart", words, apart)]
