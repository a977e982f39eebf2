"""A volume by tiles with what its points do not show, and what speaks against it: to what
:mod:`ladar_volume.clouds.volume_verdict` gives for surfaces of which all triangles count.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from ladar_volume.clouds.between_points import BetweenPoints
from ladar_volume.clouds.cloud_volume import CloudVolume
from ladar_volume.clouds.sampling.layers import layer_doubts
from ladar_volume.clouds.sampling.object_search import Objects
from ladar_volume.clouds.sampling.objects_beside import beside_doubts
from ladar_volume.clouds.volume_verdict import (
    base_doubts,
    coarse_doubts,
    open_doubts,
    unseen_doubts,
    with_between_points,
    with_bridged,
    with_lines,
    with_readings,
)
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import Plane
from ladar_volume.model.verdict import Doubt
from ladar_volume.tiles.readings.tiled_body import (
    body_scatter,
    completeness,
    edge_of,
    with_edge,
    with_growth,
)
from ladar_volume.tiles.readings.tiled_readings import Around, ground_readings
from ladar_volume.tiles.standing.cleared_tiles import ClearedTiles, with_spacings
from ladar_volume.tiles.standing.objects_inside import tiled_within, with_walls
from ladar_volume.tiles.tile_surface import EVERY
from ladar_volume.tiles.tiled_ground import GroundFitter
from ladar_volume.tiles.unseen.tiled_between import BetweenFinder
from ladar_volume.tiles.unseen.tiled_bridges import bridged_of
from ladar_volume.tiles.unseen.tiled_edge import outline_of
from ladar_volume.tiles.unseen.tiled_gaps import GapFinder
from ladar_volume.tiles.unseen.tiled_layers import found_layers
from ladar_volume.tiles.unseen.tiled_notches import tiled_notches
from ladar_volume.volume.field_checks.base_readings import unsettled
from ladar_volume.volume.field_checks.standing_objects import object_doubts


class Judged(NamedTuple):
    """volume : with what was not seen · between : what lies between the points · doubts : about
    these
    """

    volume: CloudVolume
    between: BetweenPoints
    doubts: list[Doubt]


@dataclass(frozen=True)
class Sought:
    """What is judged. fitter : asks the tiles · outline : where the triangles inside are at rest,
    None for all that count · base : that heights count from · cleared : the surfaces, without what
    stood on them
    """

    fitter: GroundFitter
    outline: Path | None
    base: Plane
    cleared: ClearedTiles


def judged(
    volume: CloudVolume, sought: Sought, parameters: Parameters, around: Around | None
) -> Judged:
    """A volume above a base with lines for what lies over gaps, between the points and at the edge
    of what was sampled, and above a base that is not the cloud's own ground for two layers. around
    : that asks about the cloud's own ground, None for another base
    """
    fitter, outline, base, v = sought.fitter, sought.outline, sought.base, parameters.volume
    every = dataclasses.replace(fitter.of, limits=EVERY)
    made = with_spacings(sought.cleared.made, fitter.workers)
    rasters, told = made.rasters, made.told
    assert told is not None
    gaps, doubts = GapFinder(fitter, outline, base, rasters).found(), list[Doubt]()
    if gaps.areas.size:
        volume, doubts = with_bridged(volume, gaps.volume, float(gaps.areas.sum()), v.outline)
    bridged = bridged_of(fitter, outline, base, gaps)
    between = BetweenFinder(fitter, every, outline, rasters, told, bridged.hidden_m3).found()
    volume = with_between_points(volume, between)
    if made.sampled:
        variance = outline_of(fitter, outline, base)
        volume = with_lines(volume, {"outline": variance}) if variance > 0.0 else volume
    doubts = doubts or unseen_doubts(bridged.bridged_m2, bridged.inside_m2)
    doubts += coarse_doubts(volume, between)
    doubts += sought.cleared.doubts
    if around is not None:
        volume, doubts = above_ground(volume, around, sought, doubts)
        return Judged(volume, between, doubts)
    stood = object_doubts(objects_within(sought), volume.sigma_m3)
    doubts = doubts + stood
    doubts += tiled_notches(fitter, base, volume) if v.outline == "all" else []
    volume, unseen = with_walls(volume, fitter, base, parameters, stood)
    doubts += unseen
    more, sigma_m3 = layer_doubts(found_layers(fitter), volume.area_m2, volume.sigma_m3)
    volume = with_lines(volume, {"layers": sigma_m3**2}) if more else volume
    return Judged(volume, between, [*doubts, *more])


def objects_within(sought: Sought) -> Objects:
    """What stood inside the outline."""
    fitter = sought.fitter
    return tiled_within(fitter.workers, fitter.of, sought.outline, sought.cleared.objects)


def above_ground(
    volume: CloudVolume, around: Around, sought: Sought, doubts: list[Doubt]
) -> tuple[CloudVolume, list[Doubt]]:
    """A volume above the cloud's own ground with lines for the toe, other readings of that ground
    and what grows on it, and with what speaks against it besides.
    """
    parameters = around.finder.parameters
    v = parameters.volume
    by_body = v.outline == "auto"
    readings = ground_readings(around, volume.area_m2, v.object_height_m)
    if by_body:
        edge = edge_of(around)
        volume, doubts = with_edge(volume, edge), [*doubts, *open_doubts(edge.open_share)]
    doubts = doubts + base_doubts(readings, volume, by_body)
    doubts += unsettled(around.found.fit.plane, volume.sigma_m3)
    within = objects_within(sought)
    stood = object_doubts(within, volume.sigma_m3)
    doubts += stood
    body = body_scatter(around, v.object_height_m)
    if by_body:
        judged = completeness(around, volume, body.scatter_m, edge.centre, stood)
        sizes = v.min_body_m3, volume.net_m3
        doubts += judged.doubts + beside_doubts(sought.cleared.objects, within, sizes)
        volume = with_lines(volume, judged.lines) if judged.lines else volume
    else:
        doubts += tiled_notches(around.fitter, sought.base, volume)
        volume, unseen = with_walls(volume, around.fitter, sought.base, parameters, stood)
        doubts += unseen
    volume, more = with_growth(around, with_readings(volume, readings, doubts), body)
    return volume, [*doubts, *more]
