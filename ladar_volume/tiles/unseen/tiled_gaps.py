"""What was not seen inside the outline of all tiles, to what
:mod:`ladar_volume.volume.field_checks.gaps` gives for surfaces of which all triangles count.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ladar_volume.model.records import F64, I64, Bool, Plane
from ladar_volume.tiles.tile_batches import ask
from ladar_volume.tiles.tile_store import digest
from ladar_volume.tiles.tile_surface import surface_folder
from ladar_volume.tiles.tile_work import results
from ladar_volume.tiles.tiled_ground import GroundFitter
from ladar_volume.tiles.tiled_outline import part_labels
from ladar_volume.tiles.tiled_ranks import median_of_tiles
from ladar_volume.tiles.unseen import tile_gaps
from ladar_volume.tiles.unseen.tile_gaps import GapTask, Spanned, WideParts
from ladar_volume.tiles.unseen.tile_spacing import Rasters
from ladar_volume.volume.field_checks.gaps import (
    MOST,
    BridgedVolume,
    bridged_together,
    gaps_among,
)


@dataclass(frozen=True)
class FoundGaps:
    """volume : what the gaps do to it · areas : (k,) m² of all, the largest first · folder : where
    it is at rest which part of a tile its triangles are of · told : of each tile, of which of its
    parts (p,) the surface is told
    """

    volume: BridgedVolume
    areas: F64
    folder: Path
    told: list[Bool]


@dataclass(frozen=True)
class GapFinder:
    """fitter : asks the tiles · outline : where the triangles inside are at rest, None for all ·
    base : that heights count from · rasters : that tell spacings, None for too few points
    """

    fitter: GroundFitter
    outline: Path | None
    base: Plane
    rasters: Rasters | None

    def found(self) -> FoundGaps:
        """The gaps, and what they do to the volume."""
        of, workers = self.fitter.of, self.fitter.workers
        usual = median_of_tiles(workers, of, tile_gaps.longest_edges, self.outline)
        folder = surface_folder(of.index, of.limits) / f"gaps_{digest([str(self.outline)])}"
        asked = Spanned(self.outline, usual, self.rasters, folder)
        wide = ask(workers, of, tile_gaps.wide_parts, [(asked,)] * len(of.tiles))
        rank, areas = gaps_of_parts(wide)
        each = np.cumsum([w.parts.count for w in wide])[:-1]
        if not len(areas):
            none = BridgedVolume(0.0, 0.0, (), 0.0)
            return FoundGaps(none, areas, folder, np.split(np.zeros(len(rank), np.bool_), each))
        tasks = [
            GapTask(corners, self.base, self.fitter.sigma_m, usual)
            for corners in self._corners(folder, wide, np.where(rank < MOST, rank, -1))
        ]
        task = partial(tile_gaps.gap_surface, of)
        made = dict(results(workers, task, list(enumerate(tasks)), lambda _: None))
        volume = bridged_together([made[k] for k in range(len(tasks))], areas)
        told = np.ones(len(areas) + 1, np.bool_)
        told[: len(volume.gaps)] = [math.isfinite(gap.sigma_m3) for gap in volume.gaps]
        told[-1] = False  # of what is no gap
        return FoundGaps(volume, areas, folder, np.split(told[rank], each))

    def _corners(self, folder: Path, wide: Sequence[WideParts], gap: I64) -> list[F64]:
        """The corners (t, 3, 3) of the triangles over each gap, from the gap (p,) of each part."""
        each = np.split(gap, np.cumsum([w.parts.count for w in wide])[:-1])
        more = [(folder, own, self.base) for own in each]
        found = ask(self.fitter.workers, self.fitter.of, tile_gaps.gap_corners, more)
        number, corners = (np.concatenate([f[k] for f in found]) for k in range(2))
        return [corners[number == k] for k in range(int(number.max()) + 1)]


def gaps_of_parts(wide: Sequence[WideParts]) -> tuple[I64, F64]:
    """The gap of each part of all tiles, one tile after the other, the largest first, -1 for none;
    and the areas, m², of all gaps.
    """
    label = part_labels([w.parts for w in wide])
    if not len(label):
        return label, np.zeros(0)
    area, square = (
        np.bincount(label, np.concatenate(values)).astype(np.float64)
        for values in ([w.parts.total for w in wide], [w.square for w in wide])
    )
    triangles = np.zeros(len(area), np.int64)
    np.add.at(triangles, label, np.concatenate([w.triangles for w in wide]))
    order = gaps_among(area, triangles, square)
    rank = np.full(len(area), -1, np.int64)
    rank[order] = np.arange(len(order))
    return rank[label], area[order]
