"""A cloud dealt out into tiles, without its strays, each triangulated: what a volume by tiles asks
after that is at rest.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import numpy as np

from ladar_volume.clouds.cloud_noise import CloudNoise
from ladar_volume.clouds.sampling.site_lengths import SiteSize
from ladar_volume.model.errors import CloudError, ParameterValueError
from ladar_volume.model.records import F64
from ladar_volume.tiles import tile_outline
from ladar_volume.tiles.cleaning.cleaned_tiles import CleanedTiles
from ladar_volume.tiles.cleaning.tiled_cleaning import Cleaner
from ladar_volume.tiles.sampled.tiled_area import AreaFinder
from ladar_volume.tiles.tile_batches import LEAST, TiledCloud, ask, run_batch
from ladar_volume.tiles.tile_outline import Box
from ladar_volume.tiles.tile_places import hull_of_places, joined_hull
from ladar_volume.tiles.tile_store import (
    CloudParts,
    Tile,
    TileIndex,
    distribute_part,
    tile_index,
)
from ladar_volume.tiles.tile_surface import EVERY, Limits, surface_of
from ladar_volume.tiles.tile_work import Workers, each_result, results
from ladar_volume.tiles.unseen.tile_spacing import Rasters
from ladar_volume.tin.full_tin import footprint_areas

#: Up to this many tiles are taken whatever they hold. More must hold this many points each in the
#: mean; a side that is suggested gives this many.
FEW_TILES, FEWEST, ENOUGH = 100, 12, 200
#: In how many tasks at most the tiles are sorted and triangulated.
TASKS = 512
R = TypeVar("R")
#: Called with the stage, its points, and how many of them a task has just done.
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class TriangulatedTile:
    """What is known of a tile once it is triangulated: its reach, the area that counts, and how
    many vertices lie on it.
    """

    reach: Box
    area_m2: float
    vertices: int


def sort_tile(of: TiledCloud, tile: Tile) -> F64:
    """Put the footprints of a tile at rest; returns the corners (h, 2) of their hull, m."""
    return hull_of_places(of.index.places(tile)[:, :2])


def triangulate_tile(of: TiledCloud, tile: Tile) -> TriangulatedTile:
    """Triangulate a tile where that is not done yet."""
    surface = surface_of(of.index, of.limits, tile)
    tin = surface.tin
    own = tin.triangles[tin.relevant & surface.counted]
    return TriangulatedTile(
        tile_outline.reach(of, tile),
        float(footprint_areas(tin.vertices, own).sum()),
        int(np.count_nonzero(surface.used)),
    )


@dataclass(frozen=True)
class PointsTask:
    """limits : which triangles count · sigma_m : of the heights, None where it is to be told ·
    clean : whether strays are left out
    """

    limits: Limits
    sigma_m: float | None
    clean: bool


@dataclass(frozen=True)
class DealtOut:
    """Points in tiles. index : the tiles, with their hull · hulls : by tile, corners (h, 2) m ·
    limits : which triangles count · sigma_m : noise of the points, NaN where they are too few to
    tell · sigma_from : where it comes from, in words
    """

    index: TileIndex
    hulls: dict[Tile, F64]
    limits: Limits
    sigma_m: float
    sigma_from: str


@dataclass(frozen=True)
class Triangulated:
    """of : the tiles, with the triangles that count · tiles : what is known of each, in the order
    of their names · points : that they are made of · rasters : that tell how far apart the points
    lie, None where that is not known yet · sampled : whether the sampled area is told from that ·
    told : the spacings at all points, as ``tiled_between.told_spacings`` gives them, None where
    that is not asked yet
    """

    of: TiledCloud
    tiles: list[TriangulatedTile]
    points: DealtOut
    rasters: Rasters | None
    sampled: bool
    told: F64 | None = None

    @property
    def size(self) -> SiteSize:
        """The size of the site that the tiles make up."""
        area = math.fsum(t.area_m2 for t in self.tiles)
        return SiteSize(area, sum(t.vertices for t in self.tiles), self.points.sigma_m)


def triangulated(
    cloud: CloudParts, task: PointsTask, workers: Workers, progress: Progress
) -> Triangulated:
    """Deal a cloud out into tiles and triangulate each."""
    each = -(-cloud.points // cloud.count)
    results(
        workers,
        partial(distribute_part, cloud),
        list(range(cloud.count)),
        lambda _: progress("into tiles", cloud.points, each),
    )
    index = tile_index(cloud)
    check_tile(index, cloud.tile_m)
    noise, points = None, TiledCloud(index, EVERY)
    if task.clean:
        index = without_strays(points, workers, progress)
        noise = index.noise
    elif task.sigma_m is None:
        noise = Cleaner(points, workers, in_points(points, progress)).noise()
    work = EachTile(workers, index, progress)
    ends = work.done(TiledCloud(index, EVERY), sort_tile, "sorted", 16)
    index = dataclasses.replace(index, hull=joined_hull(list(ends.values())))
    dealt = DealtOut(index, ends, task.limits, *sigma_of(task.sigma_m, noise))
    return with_surfaces(dealt, workers, progress)


def with_surfaces(points: DealtOut, workers: Workers, progress: Progress) -> Triangulated:
    """Triangulate each tile."""
    index, limits = points.index, points.limits
    by_area = limits.relevant == "sampled"
    of = TiledCloud(index, EVERY if by_area else limits)
    known = EachTile(workers, index, progress).done(of, triangulate_tile, "surface", 4)
    if not by_area:
        return Triangulated(of, [known[t] for t in of.tiles], points, None, False)
    found = AreaFinder(of, workers, points.hulls, in_points(of, progress)).found()
    tiles = ask(workers, found.of, triangulate_tile)
    return Triangulated(found.of, tiles, points, found.rasters, found.told)


def sigma_of(given_m: float | None, noise: CloudNoise | None) -> tuple[float, str]:
    """The standard deviation of the heights, m, NaN where it is not known; and where it comes
    from.
    """
    if given_m is not None:
        return given_m, "given"
    return (math.nan, "unknown") if noise is None else (noise.sigma_m, noise.words)


def in_points(of: TiledCloud, progress: Progress) -> Callable[[str, int], None]:
    """Progress in tiles as one in points."""
    tiles, total = len(of.tiles), sum(of.index.count.values())
    return lambda stage, done: progress(stage, total, done * total // tiles)


def without_strays(of: TiledCloud, workers: Workers, progress: Progress) -> CleanedTiles:
    """The tiles of a cloud without its strays. Raises :class:`CloudError` where none is left."""
    found = Cleaner(of, workers, in_points(of, progress)).cleaned()
    if not found.count:
        total = sum(of.index.count.values())
        words = f"{of.index.cloud.path}: all {total} points are strays: give --clean off"
        raise CloudError(words, reason="cloud_empty")
    return found


@dataclass(frozen=True)
class EachTile:
    """What is done once for each tile, the fullest first."""

    workers: Workers
    index: TileIndex
    progress: Progress

    def done(
        self, of: TiledCloud, op: Callable[[TiledCloud, Tile], R], stage: str, each: int
    ) -> dict[Tile, R]:
        """The answers by tile; about so many tiles make a task, where these are not too many."""
        count = self.index.count
        order, total = sorted(count, key=lambda t: (-count[t], t)), sum(count.values())
        many = min(TASKS, len(order), max(len(order) // each, LEAST))
        tasks = [(k, [(t,) for t in order[k::many]]) for k in range(many)]
        out: dict[Tile, R] = {}
        for k, found in each_result(self.workers, partial(run_batch, op, of), tasks):
            some = order[k::many]
            self.progress(stage, total, sum(count[t] for t in some))
            out |= zip(some, found, strict=True)
        return out


def check_tile(index: TileIndex, tile_m: float) -> None:
    """Raise :class:`ParameterValueError` for many tiles with next to nothing in each: each of them
    would ask all others.
    """
    total, tiles = sum(index.count.values()), np.array(list(index.count))
    if len(tiles) <= FEW_TILES or total >= FEWEST * len(tiles):
        return
    over = (np.ptp(tiles, axis=0) + 1.0) * tile_m
    enough = math.sqrt(float(over.prod()) * ENOUGH / total)
    raise ParameterValueError(
        f"{len(tiles):,} tiles of {tile_m:g} m hold {total / len(tiles):.1f} points each, over "
        f"{over[0]:.4g} by {over[1]:.4g} m: give --tile {enough:.0f} or more, or mend the file's "
        "unit or scale",
        value=tile_m,
    )
