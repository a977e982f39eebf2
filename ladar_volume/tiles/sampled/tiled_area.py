"""The sampled area of all tiles, to what :func:`~ladar_volume.tin.sampled_area.sampled_area` tells
of one surface: what of it is reached from the hull is decided by parts that span tiles.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ladar_volume.model.records import F64, I64, Bool
from ladar_volume.tiles.sampled import tile_area
from ladar_volume.tiles.sampled.tile_area import AreaTask, OpenTile, SmallParts
from ladar_volume.tiles.tile_batches import TiledCloud, ask
from ladar_volume.tiles.tile_store import Tile
from ladar_volume.tiles.tile_surface import EVERY, SAMPLED, surface_folder
from ladar_volume.tiles.tile_work import Workers
from ladar_volume.tiles.tiled_ground import GroundFitter
from ladar_volume.tiles.tiled_outline import part_labels
from ladar_volume.tiles.unseen.tile_spacing import Rasters
from ladar_volume.tiles.unseen.tiled_between import filled_rasters
from ladar_volume.tiles.without_points import without_points
from ladar_volume.tin.sampled_area import FEWEST, PASSES, deep_parts

R = TypeVar("R")


@dataclass(frozen=True)
class SampledCloud:
    """of : the tiles without the points that stand alone beyond, with the triangles that were
    sampled to count, or all where the points do not show their spacing · rasters : that tell it ·
    told : whether they do
    """

    of: TiledCloud
    rasters: Rasters | None
    told: bool


@dataclass(frozen=True)
class AreaFinder:
    """Finds the sampled area of tiles that are triangulated. hulls : by tile, corners (h, 2) m of
    the hull of its points · progress : takes the stage, and how many tiles have just been done
    """

    of: TiledCloud
    workers: Workers
    hulls: dict[Tile, F64]
    progress: Callable[[str, int], None]

    def _each(
        self, stage: str, op: Callable[..., R], more: Sequence[tuple[object, ...]]
    ) -> list[R]:
        return ask(
            self.workers, self.of, op, more, lambda done: self.progress(f"sampled: {stage}", done)
        )

    def found(self, passes: int = PASSES) -> SampledCloud:
        """The sampled area, and the tiles without what stands alone outside it."""
        n = len(self.of.tiles)
        # only where vertices are is asked: their noise does not matter
        rasters = filled_rasters(GroundFitter(self.of, self.workers, 0.0), None)
        if rasters is None:
            return SampledCloud(self.of, None, False)
        task = AreaTask(rasters, surface_folder(self.of.index, SAMPLED) / "area")
        opened = self._each("open to the hull", tile_area.open_tile, [(task,)] * n)
        if sum(o.known for o in opened) < 0.5 * rasters.count:
            return SampledCloud(self.of, rasters, False)
        asked = [(task, deep) for deep in deep_of(opened)]
        small = self._each("parts", tile_area.left_parts, asked)
        asked = [(task, kept) for kept in kept_of(small)]
        rest = self._each("counted", tile_area.counted_area, asked)
        counted = dataclasses.replace(self.of, limits=SAMPLED)
        if passes == 0 or not any(rest):
            return SampledCloud(counted, rasters, True)
        found = self._each("alone", tile_area.alone_points, [(task,)] * n)
        if not any(map(len, found)):
            return SampledCloud(counted, rasters, True)
        return self._without(found).found(passes - 1)

    def _without(self, alone: Sequence[I64]) -> AreaFinder:
        """The same of the tiles without the points that stand alone, triangulated."""
        left = without_points(self.workers, self.of, alone, "without_alone", self.hulls, alone=True)
        of = TiledCloud(left.index, EVERY)
        finder = AreaFinder(of, self.workers, left.hulls, self.progress)
        every: list[tuple[object, ...]] = [()] * len(finder.of.tiles)
        finder._each("surface", tile_area.with_surface, every)
        return finder


def deep_of(opened: Sequence[OpenTile]) -> list[Bool]:
    """Which parts (k,) of each tile are open to the hull and deep, with all they are joined to."""
    label = part_labels([o.parts for o in opened])
    sums = np.zeros((int(label.max(initial=-1)) + 1, 3))
    np.add.at(sums, label, np.concatenate([o.sums for o in opened]))
    deep = deep_parts(sums)[label] if len(label) else np.zeros(0, np.bool_)
    return np.split(deep, np.cumsum([o.parts.count for o in opened])[:-1])


def kept_of(small: Sequence[SmallParts]) -> list[Bool]:
    """Which small parts (k,) of each tile are kept: those that are large with all they are joined
    to. A triangle that fewer tiles name than know it is in a part of another tile that is large
    there.
    """
    label = part_labels([s.parts for s in small])
    n = int(label.max(initial=-1)) + 1
    size = np.bincount(label, np.concatenate([s.parts.total for s in small]), n)
    first = np.r_[0, np.cumsum([s.parts.count for s in small])]
    corners = np.concatenate([s.parts.corners for s in small])
    own = np.concatenate([a + s.parts.label for a, s in zip(first[:-1], small, strict=True)])
    large = size > FEWEST // 10
    if len(corners):
        _, at, named = np.unique(corners, axis=0, return_inverse=True, return_counts=True)
        know = np.concatenate([s.tiles for s in small])
        large[label[own[named[at.reshape(-1)] < know]]] = True
    kept = large[label] if len(label) else np.zeros(0, np.bool_)
    return np.split(kept, first[1:-1])
