"""The volume of a cloud above a ground of its own, by tiles: to what
:func:`~ladar_volume.clouds.cloud_volume.above_base` gives without its correction near the base.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import partial

import numpy as np

from ladar_volume.clouds.cloud_volume import CloudVolume
from ladar_volume.clouds.sampling.site_lengths import SiteSize, site_lengths
from ladar_volume.ground.polynomial import height_above
from ladar_volume.model.errors import SurfaceError, VolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, Plane
from ladar_volume.tiles import tile_ground_volume, tile_outline
from ladar_volume.tiles.tile_batches import TiledCloud, ask, run_batch
from ladar_volume.tiles.tile_ground_volume import Above, GroundSums, Squares
from ladar_volume.tiles.tile_outline import Box
from ladar_volume.tiles.tile_store import CloudParts, Tile, TileIndex, distribute_part, tile_index
from ladar_volume.tiles.tile_surface import Limits, surface_of
from ladar_volume.tiles.tile_volume import noise_of_tile
from ladar_volume.tiles.tile_work import Workers, results
from ladar_volume.tiles.tiled_ground import GroundFitter, TiledFit
from ladar_volume.tiles.tiled_outline import OutlineFinder
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

#: Called with the stage, its points, and how many of them a task has just done.
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class GroundVolume:
    """volume : of all tiles · base : the ground · index : the tiles · sums : of each, in the order
    of their names · sigma_m : of the heights · parameters : with the lengths that fit the site
    """

    volume: CloudVolume
    base: Plane
    index: TileIndex
    sums: list[GroundSums]
    sigma_m: float
    parameters: Parameters


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
    of, total = TiledCloud(index, limits), sum(index.count.values())
    longest = sorted(index.count, key=lambda t: (-index.count[t], t))
    found = results(
        workers,
        partial(run_batch, triangulate_tile, of),
        [(k, [(tile, noise)]) for k, tile in enumerate(longest)],
        lambda done: progress("surface", total, done[1][0].points),
    )
    return of, {longest[k]: one for k, (one,) in found}


def above_ground(
    cloud: CloudParts,
    limits: Limits,
    parameters: Parameters,
    sigma_m: float | None,
    workers: Workers,
    progress: Progress = lambda stage, total, done: None,
    named: Collection[str] | None = None,
) -> GroundVolume:
    """The volume above the ground of the same cloud. sigma_m : of the heights; None for that of
    the tiles, their root mean square by points. The lengths of base and outline follow the site,
    but for those ``named``; None for all as given. Raises :class:`GroundError` where no ground can
    be fitted, :class:`VolumeError` where nothing lies inside the outline.
    """
    of, known = triangulated(cloud, limits, sigma_m is None, workers, progress)
    sigma = noise_of(list(known.values())) if sigma_m is None else sigma_m
    if named is not None:
        parameters = site_lengths(parameters, size_of_tiles(list(known.values()), sigma), named)
    fitter = GroundFitter(of, workers, sigma)
    reach = [known[tile].reach for tile in of.tiles]
    outline = OutlineFinder(fitter, parameters, reach).found()
    asked = Above(outline.fit.plane, outline.folder, sigma)
    sums = ask(workers, of, tile_ground_volume.ground_sums, [(asked,)] * len(of.tiles))
    volume = VolumeAbove(fitter, outline.fit, asked, sums).volume(base_name(parameters))
    return GroundVolume(volume, outline.fit.plane, of.index, sums, sigma, parameters)


def size_of_tiles(tiles: list[TriangulatedTile], sigma_m: float) -> SiteSize:
    """The size of the site that tiles make up."""
    area = math.fsum(t.area_m2 for t in tiles)
    return SiteSize(area, sum(t.vertices for t in tiles), sigma_m)


def noise_of(tiles: list[TriangulatedTile]) -> float:
    """Root mean square by points of the noise of all tiles, m. Raises :class:`SurfaceError` where
    no tile can tell.
    """
    some = [t for t in tiles if math.isfinite(t.sigma_m)]
    if not some:
        words = "no tile has points enough to estimate their noise: give --sigma, or larger tiles"
        raise SurfaceError(words, reason="surface_too_few_points")
    return math.sqrt(math.fsum(t.points * t.sigma_m**2 for t in some) / sum(t.points for t in some))


@dataclass(frozen=True)
class VolumeAbove:
    """The last sums. fitter : asks the tiles · fit : the ground · asked : what is above it · sums :
    of each tile
    """

    fitter: GroundFitter
    fit: TiledFit
    asked: Above
    sums: list[GroundSums]

    def _ask(self, op: Callable[..., F64], *more: object, adds: bool = True) -> F64:
        """Answers of the tiles, added up or one below the other."""
        of = self.fitter.of
        found = ask(self.fitter.workers, of, op, [more] * len(of.index.count), adds=adds)
        return np.asarray(np.sum(found, axis=0) if adds else np.stack(found))

    def volume(self, base: str) -> CloudVolume:
        """The volume of all tiles, its base in words."""
        s = self.sums
        if not any(t.triangles for t in s):
            raise VolumeError("no triangle counts: widen the limit", reason="volume_no_triangle")
        by_beta = np.sum([t.by_beta for t in s], axis=0)
        by_sums, chosen = self.fit.inverse @ by_beta, self.fit.chosen
        found = self._ask(tile_ground_volume.squares, self.asked, chosen, by_sums)
        noise = self.asked.sigma_m**2 * found
        rough = self._field(by_sums[:, 0])
        cut, fill = math.fsum(t.cut_m3 for t in s), math.fsum(t.fill_m3 for t in s)
        near, area = math.fsum(t.near_m2 for t in s), math.fsum(t.area_m2 for t in s)
        sigma, sigma_cut, sigma_fill = np.sqrt(noise + rough).tolist()
        return CloudVolume(
            cut,
            fill,
            cut,
            fill,
            0.0,
            near,
            sigma,
            sigma_cut,
            sigma_fill,
            area,
            base,
            True,
            {"noise": float(noise[0]), "base_surface": rough},
        )

    def _field(self, by_sums: F64) -> float:
        """Variance, m⁶, of what the deviation of the ground from its base adds to the net volume,
        whose derivatives by the sums ``Xᵀz`` are given (p,).
        """
        chosen = self.fit.chosen
        base = dataclasses.replace(self.fit.plane, support=np.zeros(0, np.int64))
        facts = self._ask(tile_ground_volume.field_facts, base, chosen, by_sums, adds=False)
        low, high = facts[:, :2].min(axis=0), facts[:, 2:4].max(axis=0)
        n, square, shares, own = facts[:, 4:].sum(axis=0).tolist()
        rough = self._roughness(low, high, int(n), square / n, shares / n)
        if rough.variance_m2 == 0.0:
            return 0.0
        boxes = np.stack([t.box for t in self.sums])
        low = np.minimum(low, boxes[:, :2].min(axis=0))
        high = np.maximum(high, boxes[:, 2:].max(axis=0))
        h, shape = field_squares(rough, low, high)
        more = (self.asked, chosen, by_sums, Squares(low, h, shape))
        grid = self._ask(tile_ground_volume.field_grid, *more)
        return variance_on_squares(rough, grid, h, own)

    def _roughness(self, low: F64, high: F64, n: int, square: float, share: float) -> Roughness:
        """The field of n points of the ground within a box: mean of their squared residuals, m²,
        and of their noise variances in those of one point.
        """
        chosen, side = self.fit.chosen, occupied_side(low, high)
        grid = self._ask(tile_ground_volume.points_per_square, chosen, low, side)
        some = self.fitter.at_ranks(chosen, n, sample_step(n))[:, 1:4]
        residual = height_above(some, self.fit.plane)
        spacing = spacing_of(int(np.count_nonzero(grid)), side, n)
        xy = np.ascontiguousarray(some[:, :2])
        noise = self.asked.sigma_m**2 * share
        sample = FieldSample(xy, residual, n, spacing, noise, square)
        return roughness_of(sample, len(self.fit.plane.beta))
