"""A volume by tiles with what its points do not show, and what speaks against it: to what
:mod:`ladar_volume.clouds.volume_verdict` gives for surfaces of which all triangles count.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from ladar_volume.clouds.between_points import BetweenPoints
from ladar_volume.clouds.cloud_volume import CloudVolume
from ladar_volume.clouds.sampling.layers import layer_doubts
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
from ladar_volume.model.parameters import VolumeParameters
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
from ladar_volume.tiles.tile_surface import EVERY
from ladar_volume.tiles.tiled_ground import GroundFitter
from ladar_volume.tiles.unseen.tile_spacing import Rasters
from ladar_volume.tiles.unseen.tiled_between import (
    BetweenFinder,
    filled_rasters,
    median_of,
    told_spacings,
)
from ladar_volume.tiles.unseen.tiled_bridges import bridged_of
from ladar_volume.tiles.unseen.tiled_edge import outline_of
from ladar_volume.tiles.unseen.tiled_gaps import GapFinder
from ladar_volume.tiles.unseen.tiled_layers import found_layers
from ladar_volume.tiles.unseen.tiled_notches import tiled_notches
from ladar_volume.tiles.unseen.tiled_steps import step_doubts
from ladar_volume.volume.field_checks.base_readings import unsettled


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
    None for all that count · base : that heights count from · rasters : that tell how far apart all
    points lie, None where that is not known yet · sampled : whether the sampled area is told from
    that · objects : whether what stands on the surface is to be taken out
    """

    fitter: GroundFitter
    outline: Path | None
    base: Plane
    rasters: Rasters | None
    sampled: bool
    objects: bool


def judged(
    volume: CloudVolume, sought: Sought, v: VolumeParameters, around: Around | None
) -> Judged:
    """A volume above a base with lines for what lies over gaps, between the points and at the edge
    of what was sampled, and above a base that is not the cloud's own ground for two layers. around
    : that asks about the cloud's own ground, None for another base
    """
    fitter, outline, base = sought.fitter, sought.outline, sought.base
    every = dataclasses.replace(fitter, of=dataclasses.replace(fitter.of, limits=EVERY))
    rasters = sought.rasters or filled_rasters(every, outline)
    told = told_spacings(fitter.workers, every.of, rasters)
    gaps, doubts = GapFinder(fitter, outline, base, rasters).found(), list[Doubt]()
    if gaps.areas.size:
        volume, doubts = with_bridged(volume, gaps.volume, float(gaps.areas.sum()), v.outline)
    bridged = bridged_of(fitter, outline, base, gaps)
    between = BetweenFinder(fitter, every.of, outline, rasters, told, bridged.hidden_m3).found()
    volume = with_between_points(volume, between)
    if sought.sampled:
        variance = outline_of(fitter, outline, base)
        volume = with_lines(volume, {"outline": variance}) if variance > 0.0 else volume
    doubts = doubts or unseen_doubts(bridged.bridged_m2, bridged.inside_m2)
    doubts += coarse_doubts(volume, between)
    if sought.objects:
        spacing = math.inf if rasters is None else median_of(told, rasters.count)
        doubts += step_doubts(fitter, outline, v.object_height_m, spacing)
    if around is not None:
        volume, doubts = above_ground(volume, around, v, doubts)
        return Judged(volume, between, doubts)
    doubts += tiled_notches(fitter, base, volume) if v.outline == "all" else []
    more, sigma_m3 = layer_doubts(found_layers(fitter), volume.area_m2, volume.sigma_m3)
    volume = with_lines(volume, {"layers": sigma_m3**2}) if more else volume
    return Judged(volume, between, [*doubts, *more])


def above_ground(
    volume: CloudVolume, around: Around, v: VolumeParameters, doubts: list[Doubt]
) -> tuple[CloudVolume, list[Doubt]]:
    """A volume above the cloud's own ground with lines for the toe, other readings of that ground
    and what grows on it, and with what speaks against it besides.
    """
    by_body = v.outline == "auto"
    readings = ground_readings(around, volume.area_m2, v.object_height_m)
    if by_body:
        edge = edge_of(around)
        volume, doubts = with_edge(volume, edge), [*doubts, *open_doubts(edge.open_share)]
    doubts = doubts + base_doubts(readings, volume, by_body)
    doubts += unsettled(around.found.fit.plane, volume.sigma_m3)
    body = body_scatter(around, v.object_height_m)
    if by_body:
        judged = completeness(around, volume, body.scatter_m, edge.centre)
        doubts += judged.doubts
        volume = with_lines(volume, judged.lines) if judged.lines else volume
    else:
        doubts = doubts + tiled_notches(around.fitter, around.found.fit.plane, volume)
    volume, more = with_growth(around, with_readings(volume, readings, doubts), body)
    return volume, [*doubts, *more]
