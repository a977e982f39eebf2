"""The points of tiles, thinned to the one nearest to the middle of each cell of all, to the points
that :func:`~ladar_volume.clouds.cloud_noise.thin_by_cells` takes of a cloud.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ladar_volume.clouds.sampling.object_search import Located
from ladar_volume.math.own_axes import raster_between
from ladar_volume.model.records import F64, I64, Bool
from ladar_volume.tiles.array_file import at_rest, read_arrays, write, write_arrays
from ladar_volume.tiles.tile_batches import TiledCloud, ask
from ladar_volume.tiles.tile_outline import Box, box_of
from ladar_volume.tiles.tile_places import hull_of_places, joined_hull, places
from ladar_volume.tiles.tile_store import Tile
from ladar_volume.tiles.tile_surface import surface_folder
from ladar_volume.tiles.tile_work import Workers
from ladar_volume.tiles.unseen.tile_spacing import Cells, KeptPoints, first_of_cells, winners


@dataclass(frozen=True)
class ThinnedTiles(KeptPoints):
    """The points that are kept, as tiles. counts : of them, by tile"""

    counts: dict[Tile, int]


def thinned(workers: Workers, of: TiledCloud, cell_m: float) -> ThinnedTiles:
    """Of all points the nearest to the middle of each cell."""
    index = of.index
    boxes = np.array(list(index.box.values()))
    low, _ = raster_between((boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)), cell_m)
    folder = surface_folder(index, of.limits) / f"thinned_{cell_m:g}"
    cells = ask(workers, of, nearest_in_tile, [(low, cell_m, folder)] * len(of.tiles))
    every = Cells(*(np.concatenate([c[k] for c in cells]) for k in range(3)))
    loses = np.split(~winners(every), np.cumsum([len(c.row) for c in cells])[:-1])
    lost = [c.row[loses] for c, loses in zip(cells, loses, strict=True)]
    found = ask(workers, of, keep, [(folder, rows) for rows in lost])
    kept = {t: k for t, k in zip(of.tiles, found, strict=True) if k.box is not None}
    box = {t: k.box for t, k in kept.items() if k.box is not None}
    hull = joined_hull([k.hull for k in found])
    return ThinnedTiles(index.cloud, box, hull, folder, {t: k.count for t, k in kept.items()})


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
    """Put what is kept of a tile at rest: without the rows that ``lost`` to those of other tiles,
    as footprints for :func:`~ladar_volume.tiles.tile_stars.tile_stars` and with its rows.
    """
    found = read_arrays(at_rest(folder, "nearest", tile), ("points", "row"))
    left: Bool = ~np.isin(found["row"], lost)
    points, rows = found["points"][left], found["row"][left]
    kept = places(points)
    write(folder, "kept", tile, kept)
    write_arrays(at_rest(folder, "rows", tile), {"points": points, "row": rows})
    return KeptTile(len(rows), box_of(kept[:, :2]), hull_of_places(kept[:, :2]))


def kept_rows(of: TiledCloud, tile: Tile, kept: ThinnedTiles) -> Located:
    """The points kept of a tile."""
    if tile not in kept.box:
        return Located(np.zeros(0, np.int64), np.zeros((0, 3)))
    found = read_arrays(at_rest(kept.folder, "rows", tile), ("points", "row"))
    return Located(found["row"], found["points"])


def all_rows(of: TiledCloud, tile: Tile) -> Located:
    """All points of a tile."""
    return Located(of.index.rows(tile), of.index.points(tile))
