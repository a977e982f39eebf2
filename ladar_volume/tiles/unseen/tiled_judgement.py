"""A volume by tiles with what its points do not show, and what speaks against it: to what
:mod:`ladar_volume.clouds.volume_verdict` gives for surfaces of which all triangles count.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from ladar_volume.clouds.between_points import BetweenPoints
from ladar_volume.clouds.cloud_volume import CloudVolume
from ladar_volume.clouds.sampling.layers import layer_doubts
from ladar_volume.clouds.volume_verdict import (
    base_doubts,
    coarse_doubts,
    open_doubts,
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
from ladar_volume.tiles.tiled_ground import GroundFitter
from ladar_volume.tiles.unseen.tiled_between import BetweenFinder, filled_rasters
from ladar_volume.tiles.unseen.tiled_gaps import GapFinder
from ladar_volume.tiles.unseen.tiled_layers import found_layers
from ladar_volume.volume.field_checks.base_readings import unsettled


class Judged(NamedTuple):
    """volume : with what was not seen · between : what lies between the points · doubts : about
    these
    """

    volume: CloudVolume
    between: BetweenPoints
    doubts: list[Doubt]


def judged(
    volume: CloudVolume,
    fitter: GroundFitter,
    outline: Path | None,
    base: Plane,
    v: VolumeParameters,
    around: Around | None,
) -> Judged:
    """A volume above a base with lines for what lies over gaps and between the points, and above a
    base that is not the cloud's own ground for two layers. outline : where the triangles inside are
    at rest, None for all · around : that asks about the cloud's own ground, None for another base
    """
    doubts: list[Doubt] = []
    rasters = filled_rasters(fitter, outline)
    gaps = GapFinder(fitter, outline, base, rasters).found()
    if gaps is not None:
        volume, doubts = with_bridged(volume, *gaps, v.outline)
    between = BetweenFinder(fitter, outline, rasters).found()
    volume = with_between_points(volume, between)
    if around is not None:
        volume, doubts = above_ground(volume, around, v, [*doubts, *coarse_doubts(volume, between)])
        return Judged(volume, between, doubts)
    doubts += coarse_doubts(volume, between)
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
    volume, more = with_growth(around, with_readings(volume, readings, doubts), body)
    return volume, [*doubts, *more]
