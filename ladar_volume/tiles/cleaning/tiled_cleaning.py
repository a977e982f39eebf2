"""A cloud in tiles without its strays: what :func:`~ladar_volume.clouds.cloud_cleaning.clean` gives
of all points at once, to the point, and in its order.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import secrets
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from ladar_volume.clouds.cloud_cleaning import (
    LINES,
    PASSES,
    UNMOVED,
    least_noise,
    noise_if_told,
    stretches_of,
)
from ladar_volume.clouds.cloud_noise import CloudNoise
from ladar_volume.clouds.sampling.plain_places import PlainCells, cell_side
from ladar_volume.math.own_axes import axes_of, rounded_middle
from ladar_volume.model.errors import InputError
from ladar_volume.model.records import F64, I64
from ladar_volume.tiles.array_file import read_arrays
from ladar_volume.tiles.cleaning import curve_tiles, line_rasters, tile_strays
from ladar_volume.tiles.cleaning.cleaned_tiles import (
    CleanedTiles,
    keep,
    read_index,
    whole,
    write_index,
)
from ladar_volume.tiles.cleaning.curve_tiles import CELLS, Curve, OwnFrame, write_cells
from ladar_volume.tiles.cleaning.near_box import (
    EVERYWHERE,
    Extent,
    extent_together,
    extents_of_tiles,
    near_box,
)
from ladar_volume.tiles.cleaning.tile_strays import Good, StrayTuning
from ladar_volume.tiles.tile_batches import TiledCloud, ask, ask_merged
from ladar_volume.tiles.tile_work import Workers
from ladar_volume.tiles.unseen.tile_spacing import Rasters
from ladar_volume.tiles.unseen.tiled_between import fill
from ladar_volume.tin.insertion_order import BITS, square_side
from ladar_volume.tin.sampled_area import FEWEST, SAMPLED

R = TypeVar("R")
#: Layout of what is at rest; another number makes another folder.
LAYOUT = 1


@contextlib.contextmanager
def work_folder(folder: Path) -> Iterator[Path]:
    """A folder below another one for what is at rest while it is worked on: of one run, since two
    may work on one store.
    """
    work = folder / f"work_{secrets.token_hex(8)}"
    try:
        yield work
    finally:
        shutil.rmtree(work, ignore_errors=True)


@dataclass(frozen=True)
class Numbered:
    """All points in their order. count : of them · curve, frame : theirs · low, high : (3,) m,
    between what they lie along their own axes · total : (2,) m, sums of their places along these
    """

    count: int
    curve: Curve
    frame: OwnFrame
    low: F64
    high: F64
    total: F64


@dataclass(frozen=True)
class Decided:
    """curve : in whose order the points are at rest · good : what is at rest of those that are
    kept, None for all · strays, isolated : how many are not, and how many of these are isolated ·
    noise : of what is kept, None where it is not told
    """

    curve: Curve
    good: str | None
    strays: int
    isolated: int
    noise: CloudNoise | None


@dataclass(frozen=True)
class Cleaner:
    """of : the tiles as they are in the file · progress : takes the stage, and how many tiles have
    just been done of it
    """

    of: TiledCloud
    workers: Workers
    progress: Callable[[str, int], None]

    def _each(self, stage: str, op: Callable[..., R], *more: object) -> list[R]:
        """The answers of all tiles, in the order of their names."""
        asked = [more] * len(self.of.tiles)
        return ask(
            self.workers, self.of, op, asked, lambda done: self.progress(f"strays: {stage}", done)
        )

    def cleaned(self) -> CleanedTiles:
        """The tiles without strays; read where they are at rest and sound."""
        index = self.of.index
        folder = index.cloud.folder / f"cleaned_{LAYOUT}"
        cloud = dataclasses.replace(index.cloud, folder=folder)
        with contextlib.suppress(InputError):
            found = read_index(cloud)
            if all(self._each("checked", whole, cloud)):
                return found
        with work_folder(folder) as work:
            done = self._without_strays(work)
            kept = self._each("kept", keep, done.curve, done.good, cloud)
        tiles = [(t, k) for t, k in zip(self.of.tiles, kept, strict=True) if k.box is not None]
        out = CleanedTiles(
            cloud,
            {},
            {t: k.count for t, k in tiles},
            {t: k.box for t, k in tiles if k.box is not None},
            index.left_out,
            index.doubts,
            np.zeros((0, 2)),
            done.strays,
            done.isolated,
            {
                t: k.stray_box
                for t, k in zip(self.of.tiles, kept, strict=True)
                if k.stray_box is not None
            },
            done.noise,
        )
        write_index(out)
        return out

    def noise(self) -> CloudNoise | None:
        """The noise of all points, strays or not; None where it is not told."""
        extent = extent_together(extents_of_tiles(self.workers, self.of))
        with work_folder(self.of.index.cloud.folder) as work:
            points = self._in_order(work, EVERYWHERE, extent)
            first, many = stretches_of(points.count)
            return noise_if_told(self._between(points, first, first + many, None)[:, 1:])

    def _without_strays(self, work: Path) -> Decided:
        """Which points are kept."""
        extents = extents_of_tiles(self.workers, self.of)
        near, everything = near_box(self.workers, self.of, extents), sum(e.count for e in extents)
        if near is not EVERYWHERE:
            extents = extents_of_tiles(self.workers, self.of, near)
        all_points = self._in_order(work, near, extent_together(extents))
        far = everything - all_points.count
        first, many = stretches_of(all_points.count)
        noise = noise_if_told(self._between(all_points, first, first + many, None)[:, 1:])
        if noise is None or all_points.count < FEWEST:
            return Decided(all_points.curve, None, far, far, noise)
        good, told = self._passes(all_points, noise)
        strays = sum(g.strays for g in told)
        if strays > UNMOVED * all_points.count:
            noise = self._noise_of_good(all_points, all_points.count - strays, good)
        return Decided(
            all_points.curve,
            good,
            far + strays,
            far + sum(g.isolated for g in told),
            noise,
        )

    def _in_order(self, work: Path, near: F64, extent: Extent) -> Numbered:
        """Number the points in the box of those that are near, between which these lie."""
        low, high, n = extent.low, extent.high, extent.count
        side = square_side(low.tolist(), high.tolist())
        cells = CELLS * side / self.of.index.cloud.tile_m
        level = min(max(math.ceil(math.log2(max(cells, 1.0))), 0), BITS)
        middle = rounded_middle(extent.total[:2] / n, (low[:2], high[:2]))
        curve = Curve(work, near, (float(low[0]), float(low[1])), side, level, middle)
        placed = self._each("in order", curve_tiles.place, curve)
        write_cells(curve, placed)
        axes = axes_of(middle, np.sum([p.moments for p in placed], axis=0))
        frame = OwnFrame(axes, float(np.round(extent.total[2] / n)))
        told = self._each("numbered", curve_tiles.number, curve, frame)
        low, high = np.min([t.low for t in told], axis=0), np.max([t.high for t in told], axis=0)
        return Numbered(n, curve, frame, low, high, np.sum([t.total for t in told], axis=0))

    def _between(self, points: Numbered, begin: I64, end: I64, good: str | None) -> F64:
        """Number and place (k, 4) of points with numbers from ``begin`` to before ``end`` (s,)."""
        asked = (points.curve, points.frame, begin, end, good)
        more = [asked] * len(self.of.tiles)
        found = np.concatenate(ask(self.workers, self.of, curve_tiles.points_between, more))
        return np.asarray(found[np.argsort(found[:, 0])])

    def _passes(self, points: Numbered, noise: CloudNoise) -> tuple[str | None, list[Good]]:
        """What is at rest of the last pass, and what the tiles told after it."""
        low, high = points.low, points.high
        sigma = least_noise(noise, float(high.max() - low.min()))
        rasters, plain = None, None
        if noise.on_lines > LINES:
            rasters = self._rasters(points)
        else:
            middle = 0.5 * float(low[2] + high[2])
            plain = PlainCells(low[:2], cell_side(low[:2], high[:2], points.count), middle)
        tuning = StrayTuning(points.curve, points.frame, sigma, rasters, plain)
        told, before = self._each("isolated", tile_strays.isolated, tuning), 0
        for number in range(1, PASSES + 1):
            extent = np.min([g.low for g in told], axis=0), np.max([g.high for g in told], axis=0)
            told = self._each("beside planes", tile_strays.beside, tuning, number, extent)
            strays = sum(g.strays for g in told)
            if strays == before:
                break
            before = strays
        return f"pass_{number}", told

    def _rasters(self, points: Numbered) -> Rasters:
        """The rasters that tell how far apart the points lie."""
        extent, n = (points.low[:2], points.high[:2]), points.count
        middle = rounded_middle(points.total / n, extent)
        ours = (points.curve, points.frame)
        more = [(*ours, middle)] * len(self.of.tiles)
        moments = ask_merged(self.workers, self.of, line_rasters.moments, more)
        axes = axes_of(middle, moments)
        boxes = np.array(self._each("spacings", line_rasters.extent, *ours, axes))
        begin = np.arange(0, n, max(1, n // SAMPLED), dtype=np.int64)
        some = self._between(points, begin, begin + 1, None)[:, 1:3]
        low, high = boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)
        rasters = line_rasters.rasters_of(axes, (low, high), some, n, points.curve.folder)
        fill(rasters, self._each("spacings", line_rasters.filled, *ours, rasters))
        return rasters

    def _noise_of_good(self, points: Numbered, count: int, good: str | None) -> CloudNoise | None:
        """The noise of so many good points: of stretches of them, found by the cells they are
        in.
        """
        first, many = stretches_of(count)
        more = [(points.curve, good)] * len(self.of.tiles)
        kept = ask_merged(self.workers, self.of, curve_tiles.count_good, more)
        table = read_arrays(points.curve.cells)
        before, end = np.cumsum(kept) - kept, np.r_[table["first"][1:], points.count]
        low, high = (
            np.searchsorted(before + kept, at, side="right") for at in (first, first + many - 1)
        )
        found = self._between(points, table["first"][low], end[high], good)
        cell = np.searchsorted(table["first"], found[:, 0], side="right") - 1
        at = before[cell] + np.arange(len(cell)) - np.searchsorted(cell, cell)
        stretch = np.searchsorted(first, at, side="right") - 1
        some = (stretch >= 0) & (at < first[stretch] + many)
        return noise_if_told(found[some, 1:])
