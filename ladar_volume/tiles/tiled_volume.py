"""The volume of a cloud above a level, a plane, or a ground of its own, by tiles: to what
:func:`~ladar_volume.clouds.cloud_volume.above_base` gives.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from ladar_volume.clouds.between_points import BetweenPoints
from ladar_volume.clouds.cloud_noise import cloud_noise
from ladar_volume.clouds.cloud_volume import CloudVolume, Solid, with_noise
from ladar_volume.clouds.sampling.site_lengths import SiteSize, site_lengths
from ladar_volume.ground.heights import height_above
from ladar_volume.ground.polynomial import design_surface
from ladar_volume.model.errors import ParameterValueError, SurfaceError, VolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, Plane
from ladar_volume.model.verdict import Doubt
from ladar_volume.tiles import tile_outline, tile_volume
from ladar_volume.tiles.readings.tiled_readings import Around
from ladar_volume.tiles.tile_batches import LEAST, TiledCloud, ask, ask_merged, givers, run_batch
from ladar_volume.tiles.tile_fit import VertexSelection
from ladar_volume.tiles.tile_near import whole_fold
from ladar_volume.tiles.tile_outline import Box
from ladar_volume.tiles.tile_places import hull_of_places, joined_hull
from ladar_volume.tiles.tile_store import (
    CloudParts,
    Tile,
    TileIndex,
    digest,
    distribute_part,
    tile_index,
)
from ladar_volume.tiles.tile_surface import Limits, surface_folder, surface_of
from ladar_volume.tiles.tile_volume import Above, Beside, Squares, TileSums
from ladar_volume.tiles.tile_work import Workers, each_result, results
from ladar_volume.tiles.tiled_ground import GroundFitter, TiledFit
from ladar_volume.tiles.tiled_outline import OutlineFinder
from ladar_volume.tiles.unseen.tiled_judgement import judged
from ladar_volume.tin.full_tin import footprint_areas
from ladar_volume.uncertainty.ground_field import (
    Roughness,
    field_squares,
    occupied_side,
    spacing_of,
    variance_on_squares,
)
from ladar_volume.uncertainty.roughness import FieldSample, roughness_of, sample_step
from ladar_volume.volume.volume_loads import base_name

#: Up to this many tiles are taken whatever they hold. More must hold this many points each in the
#: mean; a side that is suggested gives this many.
FEW_TILES, FEWEST, ENOUGH = 100, 12, 200
#: In how many tasks at most the tiles are sorted and triangulated.
TASKS = 512
R = TypeVar("R")
#: Called with the stage, its points, and how many of them a task has just done.
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class TiledVolume:
    """volume : of all tiles · between : what lies between the points, None where that is not told ·
    base : what is below · index : the tiles · sums : of each, in the order of their names · sigma_m
    : of the heights · parameters : with the lengths that fit the site
    """

    volume: CloudVolume
    between: BetweenPoints | None
    base: Plane
    index: TileIndex
    sums: list[TileSums]
    sigma_m: float
    parameters: Parameters
    doubts: tuple[Doubt, ...] = ()


@dataclass(frozen=True)
class TriangulatedTile:
    """What is known of a tile once it is triangulated: its reach, its points and their noise, m,
    NaN where it is not asked for or cannot be told, the area that counts and the vertices on it.
    """

    reach: Box
    points: int
    sigma_m: float
    area_m2: float
    vertices: int


def noise_of_tile(points: F64) -> float | None:
    """Standard deviation, m, of the heights of points (n, 3); None where they are too few."""
    try:
        return cloud_noise(points).sigma_m
    except SurfaceError:
        return None


def sort_tile(of: TiledCloud, tile: Tile) -> F64:
    """Put the footprints of a tile at rest; returns the corners (h, 2) of their hull, m."""
    return hull_of_places(of.index.places(tile)[:, :2])


def triangulate_tile(of: TiledCloud, tile: Tile, noise: bool) -> TriangulatedTile:
    """Triangulate a tile where that is not done yet; ``noise`` : whether that of its points is
    asked for.
    """
    surface = surface_of(of.index, of.limits, tile)
    tin, sigma = surface.tin, noise_of_tile(of.index.points(tile)) if noise else None
    own = tin.triangles[tin.relevant & surface.counted]
    return TriangulatedTile(
        tile_outline.reach(of, tile),
        surface.points,
        math.nan if sigma is None else sigma,
        float(footprint_areas(tin.vertices, own).sum()),
        int(np.count_nonzero(surface.used)),
    )


def triangulated(
    cloud: CloudParts, limits: Limits, noise: bool, workers: Workers, progress: Progress
) -> tuple[TiledCloud, dict[Tile, TriangulatedTile]]:
    """Deal a cloud out into tiles and triangulate each. noise : whether that of its points is
    asked for.
    """
    each = -(-cloud.points // cloud.count)
    results(
        workers,
        partial(distribute_part, cloud),
        list(range(cloud.count)),
        lambda _: progress("into tiles", cloud.points, each),
    )
    index = tile_index(cloud)
    check_tile(index, cloud.tile_m)
    work = EachTile(workers, index, progress)
    ends = work.done(TiledCloud(index, limits), sort_tile, "sorted", 16)
    of = TiledCloud(dataclasses.replace(index, hull=joined_hull(list(ends.values()))), limits)
    return of, work.done(of, partial(triangulate_tile, noise=noise), "surface", 4)


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


@dataclass(frozen=True)
class VolumeTask:
    """limits : which triangles count · parameters : of base, outline and ground · sigma_m : of the
    heights; None for that of the tiles, their root mean square by points · correct : whether cut
    and fill are corrected near the base · between : whether what lies between the points is told,
    where all triangles count · named : lengths of base and outline that stay, the others
    follow the site; None for all as given
    """

    limits: Limits
    parameters: Parameters
    sigma_m: float | None
    correct: bool = True
    between: bool = True
    named: Collection[str] | None = None


def volume_by_tiles(
    cloud: CloudParts,
    task: VolumeTask,
    workers: Workers,
    progress: Progress = lambda stage, total, done: None,
) -> TiledVolume:
    """The volume above a level, a plane, or the ground of the same cloud. Raises
    :class:`GroundError` where no ground can be fitted, :class:`VolumeError` where nothing lies
    inside the outline.
    """
    of, known = triangulated(cloud, task.limits, task.sigma_m is None, workers, progress)
    tiles, parameters = list(known.values()), task.parameters
    sigma = noise_of(tiles) if task.sigma_m is None else task.sigma_m
    if task.named is not None:
        parameters = site_lengths(parameters, size_of_tiles(tiles, sigma), task.named)
    fitter, v, around, folder = GroundFitter(of, workers, sigma), parameters.volume, None, None
    if v.base == "ground":
        around = around_ground(fitter, parameters, [known[t].reach for t in of.tiles])
        base, folder = around.found.fit.plane, around.found.folder
    else:
        base = design_surface([v.level_m] if v.base == "level" else list(v.plane))
    near = near_folder(of, base, folder, sigma) if task.correct else None
    asked = Above(base, folder, sigma, near)
    sums = ask(workers, of, tile_volume.tile_sums, [(asked,)] * len(of.tiles))
    fit = None if around is None else around.found.fit
    volume = VolumeAbove(fitter, fit, asked, sums).volume(base_name(parameters))
    if not (task.between and task.limits.relevant == "all" and math.isfinite(volume.sigma_m3)):
        return TiledVolume(volume, None, base, of.index, sums, sigma, parameters)
    volume, between, doubts = judged(volume, fitter, folder, base, v, around)
    return TiledVolume(volume, between, base, of.index, sums, sigma, parameters, tuple(doubts))


def around_ground(fitter: GroundFitter, parameters: Parameters, reach: Sequence[Box]) -> Around:
    """Ground and outline of the cloud, and who asks about them; ``reach`` of each tile."""
    if math.isnan(fitter.sigma_m):
        words = "no tile has points enough to estimate their noise: give --sigma, or larger tiles"
        raise SurfaceError(words, reason="surface_too_few_points")
    finder = OutlineFinder(fitter, parameters, reach)
    return Around(fitter, finder, finder.found())


def near_folder(of: TiledCloud, base: Plane, outline: Path | None, sigma_m: float) -> Path:
    """Where what is near a base is at rest."""
    words = [base.beta.tolist(), base.origin_xy.tolist(), outline, sigma_m]
    return surface_folder(of.index, of.limits) / f"near_{digest(words)}"


def size_of_tiles(tiles: list[TriangulatedTile], sigma_m: float) -> SiteSize:
    """The size of the site that tiles make up."""
    area = math.fsum(t.area_m2 for t in tiles)
    return SiteSize(area, sum(t.vertices for t in tiles), sigma_m)


def noise_of(tiles: list[TriangulatedTile]) -> float:
    """Root mean square by points of the noise of all tiles, m; NaN where no tile can tell."""
    some = [t for t in tiles if math.isfinite(t.sigma_m)]
    if not some:
        return math.nan
    return math.sqrt(math.fsum(t.points * t.sigma_m**2 for t in some) / sum(t.points for t in some))


@dataclass(frozen=True)
class VolumeAbove:
    """The last sums. fitter : asks the tiles · fit : the ground, None above a given base · asked :
    of the tiles · sums : of each
    """

    fitter: GroundFitter
    fit: TiledFit | None
    asked: Above
    sums: list[TileSums]

    def _sum(self, op: Callable[..., F64], *more: object) -> F64:
        """Answers of the tiles, added up."""
        of = self.fitter.of
        return np.asarray(ask_merged(self.fitter.workers, of, op, [more] * len(of.index.count)))

    def volume(self, base: str) -> CloudVolume:
        """The volume of all tiles, its base in words."""
        s = self.sums
        if not any(t.triangles for t in s):
            raise VolumeError("no triangle counts: widen the limit", reason="volume_no_triangle")
        by_beta = np.sum([t.by_beta for t in s], axis=0)
        chosen, by_sums, extra = None, by_beta, dict[str, float]()
        if self.fit is not None:
            chosen, by_sums = self.fit.chosen, self.fit.inverse @ by_beta
            extra["base_surface"] = self._field(self.fit, by_sums[:, 0])
        noise = self.asked.sigma_m**2 * self._squares(chosen, by_sums)
        near = whole_fold([t.near for t in s if t.near is not None])
        cut, fill = math.fsum(t.cut_m3 for t in s), math.fsum(t.fill_m3 for t in s)
        area = math.fsum(t.area_m2 for t in s)
        curved = 0.0 if near is None else near.variance_m6
        solid = Solid(cut, fill, area, (), near, curved, extra)
        return with_noise(solid, noise, {}, base, self.fit is not None)

    def _squares(self, chosen: VertexSelection | None, by_sums: F64) -> F64:
        """Sums (3,) m⁴ of squared derivatives; each tile is told which give something to it."""
        tiles = self.fitter.of.tiles
        beside = givers(tiles, [() if t.near is None else t.near.beside for t in self.sums])
        more = [
            (self.asked, Beside(found.near is not None, some), chosen, by_sums)
            for found, some in zip(self.sums, beside, strict=True)
        ]
        return np.asarray(
            ask_merged(self.fitter.workers, self.fitter.of, tile_volume.squares, more)
        )

    def _field(self, fit: TiledFit, by_sums: F64) -> float:
        """Variance, m⁶, of what the deviation of the ground from its base adds to the net volume,
        whose derivatives by the sums ``Xᵀz`` are given (p,).
        """
        chosen = fit.chosen
        base = dataclasses.replace(fit.plane, support=np.zeros(0, np.int64))
        of = self.fitter.of
        asked = [(base, chosen, by_sums)] * len(of.tiles)
        facts = np.stack(ask(self.fitter.workers, of, tile_volume.field_facts, asked))
        low, high = facts[:, :2].min(axis=0), facts[:, 2:4].max(axis=0)
        n, square, shares, own = facts[:, 4:].sum(axis=0).tolist()
        rough = self._roughness(fit, (low, high), int(n), square / n, shares / n)
        if rough.variance_m2 == 0.0:
            return 0.0
        boxes = np.stack([t.box for t in self.sums])
        low = np.minimum(low, boxes[:, :2].min(axis=0))
        high = np.maximum(high, boxes[:, 2:].max(axis=0))
        h, shape = field_squares(rough, low, high)
        more = (self.asked, chosen, by_sums, Squares(low, h, shape))
        grid = self._sum(tile_volume.field_grid, *more)
        return variance_on_squares(rough, grid, h, own)

    def _roughness(
        self, fit: TiledFit, box: tuple[F64, F64], n: int, square: float, share: float
    ) -> Roughness:
        """The field of n points of the ground within a box: mean of their squared residuals, m²,
        and of their noise variances in those of one point.
        """
        chosen, low, side = fit.chosen, box[0], occupied_side(*box)
        grid = self._sum(tile_volume.points_per_square, chosen, low, side)
        some = self.fitter.at_ranks(chosen, n, sample_step(n))[:, 1:4]
        residual = height_above(some, fit.plane)
        spacing = spacing_of(int(np.count_nonzero(grid)), side, n)
        xy = np.ascontiguousarray(some[:, :2])
        noise = self.asked.sigma_m**2 * share
        sample = FieldSample(xy, residual, n, spacing, noise, square)
        return roughness_of(sample, len(fit.plane.beta))
