"""A site in tiles without what stands on its surface, triangulated again where that was."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

from ladar_volume.clouds.sampling.object_search import Objects, ObjectSearch
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.verdict import Doubt
from ladar_volume.tiles.standing.tiled_objects import objects_in_tiles, thin_points
from ladar_volume.tiles.standing.tiled_steps import highest_of_all, step_doubt
from ladar_volume.tiles.tile_surface import EVERY
from ladar_volume.tiles.tile_work import Workers
from ladar_volume.tiles.tiled_ground import GroundFitter
from ladar_volume.tiles.tiled_points import Progress, Triangulated, with_surfaces
from ladar_volume.tiles.unseen.tiled_between import filled_rasters, median_of, told_spacings


@dataclass(frozen=True)
class ClearedTiles:
    """made : the surfaces without what stands on them · objects : that, the largest first ·
    doubts : that it has too many points
    """

    made: Triangulated
    objects: Objects = ()
    doubts: tuple[Doubt, ...] = ()


def cleared_tiles(
    made: Triangulated, parameters: Parameters, workers: Workers, progress: Progress
) -> ClearedTiles:
    """The tiles without what stands on their surface, above a ground, a level or a plane."""
    if math.isnan(made.points.sigma_m):
        return ClearedTiles(made)
    made = with_spacings(made, workers)
    how = ObjectSearch(made.points.sigma_m, median_spacing(made), parameters)
    found = objects_in_tiles(made.points, how, workers, staged(progress, "objects"))
    if found is None:
        highest = highest_of_all(workers, thin_points(made.points, how, workers), how.step_m)
        return ClearedTiles(made, (), () if highest is None else (step_doubt(highest, how.step_m),))
    if not found.objects:
        return ClearedTiles(made)
    again = staged(progress, "without objects")
    return ClearedTiles(with_surfaces(found.points.points, workers, again), found.objects)


def staged(progress: Progress, what: str) -> Progress:
    """Progress whose stages have a name before theirs."""
    return lambda stage, total, done: progress(f"{what}: {stage}", total, done)


def median_spacing(made: Triangulated) -> float:
    """The spacing of the points, m, in the median; infinite where they do not show it."""
    if made.rasters is None or made.told is None:
        return math.inf
    return median_of(made.told, made.rasters.count)


def with_spacings(made: Triangulated, workers: Workers) -> Triangulated:
    """With how far apart the points lie."""
    if made.told is not None:
        return made
    every = dataclasses.replace(made.of, limits=EVERY)
    rasters = made.rasters or filled_rasters(GroundFitter(every, workers, 0.0), None)
    told = told_spacings(workers, every, rasters)
    return dataclasses.replace(made, rasters=rasters, told=told)
