"""The points of tiles without what stands on their surface: to what
:func:`~ladar_volume.clouds.sampling.cloud_objects.without_objects` leaves of all at once.

The thinned points of all tiles and what stands among them are looked at by one process, as far as
they are no more than :data:`MOST`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self, TypeVar

import numpy as np

from ladar_volume.clouds.sampling.cloud_objects import beside, standing_in
from ladar_volume.clouds.sampling.object_search import Found, Located, ObjectSearch, searched
from ladar_volume.model.records import F64
from ladar_volume.tiles.standing.thinned_tiles import all_rows, kept_rows, thinned
from ladar_volume.tiles.tile_batches import TiledCloud, ask
from ladar_volume.tiles.tile_store import Tile, digest
from ladar_volume.tiles.tile_surface import EVERY
from ladar_volume.tiles.tile_work import Workers
from ladar_volume.tiles.tiled_points import DealtOut
from ladar_volume.tiles.without_points import without_points

#: Most points that one process looks at: some 1.3 GB.
MOST = 3_000_000
R = TypeVar("R")


class TooManyPointsError(Exception):
    """What one process would look at is more than it may hold."""


@dataclass(frozen=True)
class PointsInTiles:
    """The points of a site, as tiles."""

    points: DealtOut
    workers: Workers

    @property
    def _of(self) -> TiledCloud:
        return TiledCloud(self.points.index, EVERY)

    def _gathered(
        self, op: Callable[..., Located], more: Sequence[tuple[object, ...]], count: int
    ) -> Located:
        """What the tiles answer, so many points, by row."""
        if count > MOST:
            raise TooManyPointsError
        found = ask(self.workers, self._of, op, more)
        rows = np.concatenate([f.rows for f in found])
        order = np.argsort(rows)
        return Located(rows[order], np.concatenate([f.places for f in found])[order])

    def thinned(self, cell_m: float) -> Located:
        """The nearest to the middle of each square cell; all for a cell of 0."""
        n = len(self._of.tiles)
        if cell_m == 0.0:
            return self._gathered(all_rows, [()] * n, sum(self.points.index.count.values()))
        kept = thinned(self.workers, self._of, cell_m)
        return self._gathered(kept_rows, [(kept,)] * n, sum(kept.counts.values()))

    def beside(self, there: F64, cell_m: float) -> Located:
        """Those in or beside the cells that places ``there`` (m, 2) m lie in."""
        low, boxes = there.min(axis=0), self.points.index.box
        there = there[np.argsort(there[:, 0])]
        asked = [(near_box(there, boxes[t], 2.0 * cell_m), cell_m, low) for t in self._of.tiles]
        count = sum(ask(self.workers, self._of, count_beside, asked))
        return self._gathered(rows_beside, asked, count)

    def without(self, things: Located) -> Self:
        """The others."""
        of = self._of
        cells = np.floor(things.places[:, :2] / of.index.cloud.tile_m).astype(np.int64)
        tiles, at = np.unique(cells, axis=0, return_inverse=True)
        order = np.argsort(at.reshape(-1), kind="stable")
        each = np.split(things.rows[order], np.cumsum(np.bincount(at.reshape(-1)))[:-1])
        gone = {(i, j): rows for (i, j), rows in zip(tiles.tolist(), each, strict=True)}
        rows = [gone.get(t, np.zeros(0, np.int64)) for t in of.tiles]
        name = f"without_{digest(np.sort(things.rows).tolist())}"
        left = without_points(self.workers, of, rows, name, self.points.hulls)
        points = dataclasses.replace(self.points, index=left.index, hulls=left.hulls)
        return dataclasses.replace(self, points=points)


def near_box(there: F64, box: Sequence[float], reach_m: float) -> F64:
    """Those of places (m, 2) m, by x, that lie in a box or so near it."""
    low, high = np.searchsorted(there[:, 0], [box[0] - reach_m, box[2] + reach_m])
    some = there[low : high + 1]
    return some[(some[:, 1] >= box[1] - reach_m) & (some[:, 1] <= box[3] + reach_m)]


def rows_beside(of: TiledCloud, tile: Tile, there: F64, cell_m: float, low: F64) -> Located:
    """The points of a tile in or beside the cells, of a raster from a corner low (2,) m, that
    places ``there`` (m, 2) m lie in.
    """
    if not len(there):
        return Located(np.zeros(0, np.int64), np.zeros((0, 3)))
    points = of.index.points(tile)
    near = beside(points[:, :2], there, cell_m, low)
    return Located(of.index.rows(tile)[near], points[near])


def count_beside(of: TiledCloud, tile: Tile, there: F64, cell_m: float, low: F64) -> int:
    """How many these are."""
    return len(rows_beside(of, tile, there, cell_m, low).rows)


def objects_in_tiles(
    points: DealtOut, how: ObjectSearch, workers: Workers
) -> Found[PointsInTiles] | None:
    """The points that belong to the surface, and what stands on it; None where too many would have
    to be looked at.
    """
    try:
        return searched(PointsInTiles(points, workers), how, standing_in)
    except TooManyPointsError:
        return None
