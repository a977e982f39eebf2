"""The volume of a cloud above a level, a plane, or a ground of its own, by tiles: to what
:func:`~ladar_volume.clouds.cloud_volume.above_base` gives.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ladar_volume.clouds.between_points import BetweenPoints
from ladar_volume.clouds.cloud_volume import CloudVolume, Solid, with_noise
from ladar_volume.clouds.sampling.cloud_objects import is_nearly_all
from ladar_volume.clouds.sampling.object_search import Objects
from ladar_volume.clouds.sampling.site_lengths import site_lengths
from ladar_volume.ground.heights import height_above
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, Plane
from ladar_volume.model.verdict import Doubt
from ladar_volume.tiles import tile_volume
from ladar_volume.tiles.cleaning.cleaned_tiles import CleanedTiles
from ladar_volume.tiles.cleaning.tiled_effect import tiled_effect
from ladar_volume.tiles.readings.tiled_readings import base_of
from ladar_volume.tiles.standing.cleared_tiles import ClearedTiles, cleared_tiles
from ladar_volume.tiles.tile_batches import TiledCloud, ask, ask_merged, givers
from ladar_volume.tiles.tile_fit import VertexSelection
from ladar_volume.tiles.tile_near import whole_fold
from ladar_volume.tiles.tile_store import CloudParts, TileIndex, digest
from ladar_volume.tiles.tile_surface import Limits, surface_folder
from ladar_volume.tiles.tile_volume import Above, Beside, Squares, TileSums
from ladar_volume.tiles.tile_work import Workers
from ladar_volume.tiles.tiled_ground import GroundFitter, TiledFit
from ladar_volume.tiles.tiled_points import PointsTask, Progress, Triangulated, triangulated
from ladar_volume.tiles.unseen.tiled_judgement import Sought, judged
from ladar_volume.uncertainty.ground_field import (
    Roughness,
    field_squares,
    occupied_side,
    spacing_of,
    variance_on_squares,
)
from ladar_volume.uncertainty.roughness import FieldSample, roughness_of, sample_step
from ladar_volume.volume.volume_loads import base_name


@dataclass(frozen=True)
class TiledVolume:
    """volume : of all tiles · between : what lies between the points, None where that is not told ·
    base : what is below · index : the tiles · sums : of each, in the order of their names · sigma_m
    : of the heights · sigma_from : where that comes from, in words · parameters : with the lengths
    that fit the site · stray_effect_m3 : what the strays that were left out would change, None for
    none · objects : that stood on the surface, the largest first
    """

    volume: CloudVolume
    between: BetweenPoints | None
    base: Plane
    index: TileIndex
    sums: list[TileSums]
    sigma_m: float
    sigma_from: str
    parameters: Parameters
    doubts: tuple[Doubt, ...] = ()
    stray_effect_m3: float | None = None
    objects: Objects = ()


@dataclass(frozen=True)
class VolumeTask:
    """limits : which triangles count · parameters : of base, outline and ground · sigma_m : of the
    heights; None for what the points tell · correct : whether cut
    and fill are corrected near the base · between : whether what lies between the points is told,
    where all triangles count · named : lengths of base and outline that stay, the others
    follow the site; None for all as given · clean : whether stray points are left out, and what
    stands on the surface where the parameters say so
    """

    limits: Limits
    parameters: Parameters
    sigma_m: float | None
    correct: bool = True
    between: bool = True
    named: Collection[str] | None = None
    clean: bool = False

    def fitted(self, made: Triangulated) -> Parameters:
        """The parameters, with lengths that go with the site."""
        if self.named is None:
            return self.parameters
        return site_lengths(self.parameters, made.size, self.named)


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
    points = PointsTask(task.limits, task.sigma_m, task.clean)
    made = triangulated(cloud, points, workers, progress)
    cleared = ClearedTiles(made)
    if task.clean and task.parameters.volume.objects == "remove":
        fitted = task.fitted(made)
        cleared = cleared_tiles(made, fitted, workers, progress)
        if cleared.objects and nearly_all_above(cleared, fitted, workers):
            cleared = ClearedTiles(made)
    made, parameters = cleared.made, task.fitted(cleared.made)
    of, sigma = made.of, made.points.sigma_m
    fitter = GroundFitter(of, workers, sigma)
    around, base, folder = base_of(fitter, [t.reach for t in made.tiles], parameters)
    near = near_folder(of, base, folder, sigma) if task.correct else None
    asked = Above(base, folder, sigma, near)
    sums = ask(workers, of, tile_volume.tile_sums, [(asked,)] * len(of.tiles))
    fit = None if around is None else around.found.fit
    volume = VolumeAbove(fitter, fit, asked, sums).volume(base_name(parameters))
    every, effect = of.index.cleaned, None
    if isinstance(every, CleanedTiles) and every.strays:
        effect = tiled_effect(workers, of, folder, base)
    facts = sigma, made.points.sigma_from, parameters, (), effect, cleared.objects
    found = TiledVolume(volume, None, base, of.index, sums, *facts)
    if not (task.between and math.isfinite(volume.sigma_m3)):
        return found
    sought = Sought(fitter, folder, base, cleared)
    volume, between, doubts = judged(volume, sought, parameters, around)
    return dataclasses.replace(found, volume=volume, between=between, doubts=tuple(doubts))


def nearly_all_above(cleared: ClearedTiles, parameters: Parameters, workers: Workers) -> bool:
    """Whether what was taken out is nearly all that rose above the base, and may be what is
    measured: not where a body was looked for.
    """
    v, of = parameters.volume, cleared.made.of
    if v.base == "ground" and v.outline == "auto":
        return False
    reach = [t.reach for t in cleared.made.tiles]
    _, base, folder = base_of(GroundFitter(of, workers, 0.0), reach, parameters)
    asked = Above(base, folder, 0.0)
    sums = ask(workers, of, tile_volume.tile_sums, [(asked,)] * len(of.tiles))
    return is_nearly_all(cleared.objects, math.fsum(s.cut_m3 for s in sums))


def near_folder(of: TiledCloud, base: Plane, outline: Path | None, sigma_m: float) -> Path:
    """Where what is near a base is at rest."""
    words = [base.beta.tolist(), base.origin_xy.tolist(), outline, sigma_m]
    return surface_folder(of.index, of.limits) / f"near_{digest(words)}"


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
