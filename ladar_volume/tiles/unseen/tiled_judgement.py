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
    coarse_doubts,
    with_between_points,
    with_bridged,
    with_lines,
)
from ladar_volume.model.parameters import VolumeParameters
from ladar_volume.model.records import Plane
from ladar_volume.model.verdict import Doubt
from ladar_volume.tiles.tiled_ground import GroundFitter
from ladar_volume.tiles.unseen.tiled_between import BetweenFinder, filled_rasters
from ladar_volume.tiles.unseen.tiled_gaps import GapFinder
from ladar_volume.tiles.unseen.tiled_layers import found_layers


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
) -> Judged:
    """A volume above a base with lines for what lies over gaps and between the points, and above a
    base that is not the cloud's own ground for two layers. outline : where the triangles inside are
    at rest, None for all
    """
    doubts: list[Doubt] = []
    rasters = filled_rasters(fitter, outline)
    gaps = GapFinder(fitter, outline, base, rasters).found()
    if gaps is not None:
        volume, doubts = with_bridged(volume, *gaps, v.outline)
    between = BetweenFinder(fitter, outline, rasters).found()
    volume = with_between_points(volume, between)
    doubts += coarse_doubts(volume, between)
    if v.base != "ground":
        more, sigma_m3 = layer_doubts(found_layers(fitter), volume.area_m2, volume.sigma_m3)
        volume = with_lines(volume, {"layers": sigma_m3**2}) if more else volume
        doubts += more
    return Judged(volume, between, doubts)
