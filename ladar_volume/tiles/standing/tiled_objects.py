"""The points of tiles without what stands on their surface: to what
:func:`~ladar_volume.clouds.sampling.cloud_objects.without_objects` leaves of all at once. One
process looks at the points of these things and around them, as far as they are no more than
:data:`~ladar_volume.tiles.standing.tiled_parts.MOST_POINTS`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from ladar_volume.clouds.sampling.object_search import Found, Located, ObjectSearch, Ring, searched
from ladar_volume.model.records import F64, I64
from ladar_volume.tiles.standing import tile_parts
from ladar_volume.tiles.standing.thinned_tiles import thinned
from ladar_volume.tiles.standing.tiled_parts import (
    PartsFinder,
    Standing,
    TooManyPointsError,
    check,
)
from ladar_volume.tiles.standing.tiled_steps import highest_of_all
from ladar_volume.tiles.tile_batches import TiledCloud, ask
from ladar_volume.tiles.tile_store import digest
from ladar_volume.tiles.tile_surface import EVERY, SAMPLED
from ladar_volume.tiles.tile_work import Workers
from ladar_volume.tiles.tiled_points import DealtOut, Progress, with_surfaces
from ladar_volume.tiles.without_points import without_points


def by_row(found: Sequence[Located]) -> tuple[Located, I64]:
    """What several tiles gave, and its order among that."""
    rows = np.concatenate([f.rows for f in found])
    order = np.argsort(rows)
    return Located(rows[order], np.concatenate([f.places for f in found])[order]), order


def near_tiles(of: TiledCloud, there: F64, cell_m: float) -> list[tuple[F64, float, F64]]:
    """What each tile is told of square cells that places ``there`` (m, 2) m lie in: those that lie
    near it, the side of a cell, and the corner (2,) m of the first.
    """
    low, reach = there.min(axis=0), 2.0 * cell_m
    there = there[np.argsort(there[:, 0])]
    out = []
    for tile in of.tiles:
        x0, y0, x1, y1 = of.index.box[tile]
        first = np.searchsorted(there[:, 0], x0 - reach)
        end = np.searchsorted(there[:, 0], x1 + reach, side="right")
        some = there[first:end]
        near = (some[:, 1] >= y0 - reach) & (some[:, 1] <= y1 + reach)
        out.append((some[near], cell_m, low))
    return out


@dataclass(frozen=True)
class ThinTiles:
    """A thinned surface in tiles. found : what stands on it · standing : its vertices"""

    found: Standing
    standing: Located
    workers: Workers

    def around(self, there: F64, cell_m: float) -> Ring:
        """The vertices in or beside the cells that places ``there`` (m, 2) m lie in."""
        of = self.found.of
        asked = [(self.found.folder, *near) for near in near_tiles(of, there, cell_m)]
        check(sum(ask(self.workers, of, tile_parts.ring_count, asked)))
        rings = ask(self.workers, of, tile_parts.ring_in_tile, asked)
        located, order = by_row([ring.located for ring in rings])
        standing, counted = (
            np.concatenate([getattr(ring, name) for ring in rings])[order]
            for name in ("standing", "counted")
        )
        return Ring(located, standing, counted)


def thin_points(points: DealtOut, how: ObjectSearch, workers: Workers) -> DealtOut:
    """The points, thinned where they lie close; all triangles between them count."""
    every = dataclasses.replace(points, limits=EVERY)
    return thinned(workers, every, how.thinned_m) if how.thinned_m else every


@dataclass(frozen=True)
class PointsInTiles:
    """The points of a site, as tiles."""

    points: DealtOut
    workers: Workers
    progress: Progress

    def thin_surface(self, how: ObjectSearch) -> ThinTiles | None:
        """Their surface, thinned; None where nothing stands on it."""
        points = thin_points(self.points, how, self.workers)
        if highest_of_all(self.workers, points, how.step_m) is None:
            return None
        by_area = dataclasses.replace(points, limits=SAMPLED)
        made = with_surfaces(by_area, self.workers, self.progress)
        found = PartsFinder(made, how, self.workers).found()
        if found is None:
            return None
        check(sum(map(len, found.stands)))
        asked = [(found.folder, found.outline, stands) for stands in found.stands]
        standing, _ = by_row(ask(self.workers, found.of, tile_parts.mark, asked))
        return ThinTiles(found, standing, self.workers) if len(standing.rows) else None

    def beside(self, there: F64, cell_m: float) -> Located:
        """Those in or beside the cells that places ``there`` (m, 2) m lie in."""
        of = TiledCloud(self.points.index, EVERY)
        asked = near_tiles(of, there, cell_m)
        check(sum(ask(self.workers, of, tile_parts.count_beside, asked)))
        return by_row(ask(self.workers, of, tile_parts.rows_beside, asked))[0]

    def without(self, things: Located) -> Self:
        """The others."""
        of = TiledCloud(self.points.index, EVERY)
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


def objects_in_tiles(
    points: DealtOut, how: ObjectSearch, workers: Workers, progress: Progress
) -> Found[PointsInTiles] | None:
    """The points that belong to the surface, and what stands on it; None where these have too many
    points.
    """
    try:
        return searched(PointsInTiles(points, workers, progress), how)
    except TooManyPointsError:
        return None
