"""The points of tiles, thinned to the one nearest to the middle of each cell of all, as tiles: to
the points that :func:`~ladar_volume.clouds.cloud_noise.thin_by_cells` takes of a cloud.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from ladar_volume.math.own_axes import raster_between
from ladar_volume.model.records import F64, I64, Bool
from ladar_volume.tiles.array_file import ENDING, at_rest, read_arrays, write_arrays
from ladar_volume.tiles.tile_batches import TiledCloud, ask
from ladar_volume.tiles.tile_outline import Box, box_of
from ladar_volume.tiles.tile_places import hull_of_places, joined_hull
from ladar_volume.tiles.tile_store import CloudParts, Tile, TileIndex, member
from ladar_volume.tiles.tile_surface import surface_folder
from ladar_volume.tiles.tile_work import Workers
from ladar_volume.tiles.tiled_points import DealtOut
from ladar_volume.tiles.unseen.tile_spacing import Cells, first_of_cells, winners
from ladar_volume.tin.duplicates import places


@dataclass(frozen=True)
class ThinnedTiles(TileIndex):
    """Tiles of the points that are kept; ``cloud.folder`` is where they are."""

    def __reduce__(self) -> tuple[Callable[..., TileIndex], tuple[object, ...]]:
        """Workers read it from what is at rest, once: it goes with every task."""
        return thinned_at_rest, (self.cloud, self.hull.tobytes())

    def points(self, tile: Tile) -> F64:
        """Points (n, 3) m of a tile, by cell."""
        return member(at_rest(self.cloud.folder, "kept", tile), "points")

    def rows(self, tile: Tile) -> I64:
        """Their numbers (n,) in the order of all."""
        return member(at_rest(self.cloud.folder, "kept", tile), "row")


def thinned(workers: Workers, points: DealtOut, cell_m: float) -> DealtOut:
    """Of all points the nearest to the middle of each cell."""
    of = TiledCloud(points.index, points.limits)
    boxes = np.array(list(of.index.box.values()))
    low, _ = raster_between((boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)), cell_m)
    folder = surface_folder(of.index, of.limits) / f"thinned_{cell_m!r}"
    cells = ask(workers, of, nearest_in_tile, [(low, cell_m, folder)] * len(of.tiles))
    every = Cells(*(np.concatenate([c[k] for c in cells]) for k in range(3)))
    loses = np.split(~winners(every), np.cumsum([len(c.row) for c in cells])[:-1])
    lost = [c.row[loses] for c, loses in zip(cells, loses, strict=True)]
    kept = ask(workers, of, keep, [(folder, rows) for rows in lost])
    found = {t: k for t, k in zip(of.tiles, kept, strict=True) if k.box is not None}
    index = ThinnedTiles(
        dataclasses.replace(of.index.cloud, folder=folder),
        {},
        {t: k.count for t, k in found.items()},
        {t: k.box for t, k in found.items() if k.box is not None},
        {},
        (),
        joined_hull([k.hull for k in found.values()]),
    )
    write_index(index)
    hulls = {t: k.hull for t, k in found.items()}
    return dataclasses.replace(points, index=index, hulls=hulls)


def nearest_in_tile(of: TiledCloud, tile: Tile, low: F64, cell_m: float, folder: Path) -> Cells:
    """In each cell the point of a tile nearest to its middle, at rest; those in cells that reach
    into other tiles.
    """
    points, rows = of.index.points(tile), of.index.rows(tile)
    at = (points[:, :2] - low) / cell_m
    cell = np.floor(at)
    off = ((at - cell - 0.5) ** 2).sum(axis=1)
    name = np.column_stack([np.zeros(len(cell), np.int64), cell.astype(np.int64)])
    best = first_of_cells(name, off, rows)
    write_arrays(at_rest(folder, "nearest", tile), {"points": points[best], "row": rows[best]})
    side = of.index.cloud.tile_m
    inner = points[best, :2] - np.array(tile) * side
    edge = np.minimum(inner, side - inner).min(axis=1) <= np.sqrt(2.0) * cell_m
    return Cells(name[best[edge]], off[best[edge]], rows[best[edge]])


@dataclass(frozen=True)
class KeptTile:
    """count, box : of the points kept of a tile · hull : (h, 2) m, corners of theirs"""

    count: int
    box: Box | None
    hull: F64


def keep(of: TiledCloud, tile: Tile, folder: Path, lost: I64) -> KeptTile:
    """Put what is kept of a tile at rest: without the rows that ``lost`` to those of other
    tiles.
    """
    found = read_arrays(at_rest(folder, "nearest", tile), ("points", "row"))
    left: Bool = ~np.isin(found["row"], lost)
    points = found["points"][left]
    write_arrays(at_rest(folder, "kept", tile), {"points": points, "row": found["row"][left]})
    hull = hull_of_places(places(points)[:, :2])
    return KeptTile(len(points), box_of(points[:, :2]), hull)


def write_index(index: ThinnedTiles) -> None:
    """Put it at rest, when all tiles are."""
    tiles = sorted(index.count)
    arrays = {
        "tiles": np.array(tiles, np.int64).reshape(-1, 2),
        "count": np.array([index.count[t] for t in tiles], np.int64),
        "box": np.array([index.box[t] for t in tiles]).reshape(-1, 4),
    }
    write_arrays(index.cloud.folder / f"index{ENDING}", arrays)


@lru_cache(maxsize=4)
def thinned_at_rest(cloud: CloudParts, hull: bytes) -> ThinnedTiles:
    """The index of a process, with the hull's corners."""
    found = read_arrays(cloud.folder / f"index{ENDING}")
    tiles = [(i, j) for i, j in found["tiles"].tolist()]
    box = {t: tuple(b) for t, b in zip(tiles, found["box"].tolist(), strict=True)}
    corners = np.frombuffer(hull, np.float64).reshape(-1, 2).copy()
    count = dict(zip(tiles, found["count"].tolist(), strict=True))
    return ThinnedTiles(cloud, {}, count, box, {}, (), corners)
