"""Two layers of points, one above the other, in all tiles:
:mod:`ladar_volume.clouds.sampling.layers` to what one process gives.
"""

from __future__ import annotations

import math

import numpy as np

from ladar_volume.clouds.cloud_noise import NEIGHBOURS, neighbours
from ladar_volume.clouds.sampling.layers import FEWEST, MOST, Layers, layers_of
from ladar_volume.clouds.sampling.rounding_step import lowest_hashes, rounding_steps
from ladar_volume.math.equal_rows import distinct_rows
from ladar_volume.model.records import F64, I64
from ladar_volume.tiles import tile_fit
from ladar_volume.tiles.tile_batches import TiledCloud, ask
from ladar_volume.tiles.tile_fit import VertexSelection
from ladar_volume.tiles.tile_outline import Box
from ladar_volume.tiles.tile_patch import in_box, names_of, tiles_in
from ladar_volume.tiles.tile_store import Tile, TileIndex
from ladar_volume.tiles.tiled_ground import GroundFitter

#: First width around the tile in which neighbours are sought, in mean distances of its points.
WIDTH = 6.0


def found_layers(fitter: GroundFitter) -> Layers:
    """The layers of all tiles, about some of their vertices."""
    of, workers = fitter.of, fitter.workers
    n = sum(n for n, _ in ask(workers, of, tile_fit.extent, [(None,)] * len(of.tiles)))
    if n < 10 * FEWEST:
        return Layers(0.0, 0.0)
    every = VertexSelection((0.0, 0.0), (0.0,), math.inf)
    some = fitter.at_ranks(every, n, max(1, math.ceil(n / MOST)))[:, 1:4]
    near, places, _ = near_places(fitter, some)
    return layers_of(near, places, lambda: height_step(fitter))


def near_places(fitter: GroundFitter, some: F64) -> tuple[F64, F64, I64]:
    """The points (k, :data:`NEIGHBOURS`, 3) of all tiles nearest over the plane to those at
    vertices (k, 3) m; these points, tile by tile, and their rows (k,) among the vertices.
    """
    of = fitter.of
    cells = np.floor(some[:, :2] / of.index.cloud.tile_m).astype(np.int64)
    own = [np.flatnonzero((cells == tile).all(axis=1)) for tile in of.tiles]
    told = ask(fitter.workers, of, neighbours_of, [(some[rows],) for rows in own])
    near, points = (np.concatenate([t[k] for t in told]) for k in range(2))
    return near, points, np.concatenate(own)


def height_step(fitter: GroundFitter) -> float:
    """The step, m, to which the heights of all tiles were rounded; 0 for none."""
    of = fitter.of
    some = ask(fitter.workers, of, hashed, [()] * len(of.tiles))
    return float(rounding_steps(lowest_hashes(np.concatenate(some)))[2])


def hashed(of: TiledCloud, tile: Tile) -> F64:
    """The points (k, 3) of a tile that may tell the step."""
    return lowest_hashes(of.index.every_point.places(tile)[:, :3])


def neighbours_of(of: TiledCloud, tile: Tile, own: F64) -> tuple[F64, F64]:
    """The points (k, :data:`NEIGHBOURS`, 3) of all tiles nearest over the plane to those at
    vertices (k, 3) of a tile, the first of the file where there are several, and these (k, 3).
    """
    if not len(own):
        return np.zeros((0, NEIGHBOURS, 3)), own
    width = WIDTH * of.index.cloud.tile_m / of.index.count[tile] ** 0.5
    low, high = own[:, :2].min(axis=0), own[:, :2].max(axis=0)
    while True:
        box = (*(low - width).tolist(), *(high + width).tolist())
        points = distinct_in_box(of.index.every_point, box)
        if len(points) > NEIGHBOURS:
            rows = first_at(points, own)
            near = neighbours(points, np.arange(len(points)), rows)
            far = np.hypot(*(near[..., :2] - own[:, None, :2]).transpose(2, 0, 1)).max()
            if far <= width or len(points) >= sum(of.index.every_point.count.values()):
                return near, points[rows]
        width *= 2.0


def distinct_in_box(index: TileIndex, box: Box) -> F64:
    """The points (n, 3) in a box, each once, in the order of the file."""
    found, rows = [np.zeros((0, 3))], [np.zeros(0, np.int64)]
    for tile in tiles_in(index, box):
        places = index.places(tile)
        if (places[:, 3] == 1.0).all():  # as most tiles are: no need for the parts
            points, row = places[:, :3], index.place_rows(tile)
        else:
            points, row = index.points(tile), index.rows(tile)
        some = in_box(points, box)
        found.append(points[some])
        rows.append(row[some])
    points = np.concatenate(found)[np.argsort(np.concatenate(rows))]
    return points[distinct_rows(points)]


def first_at(points: F64, own: F64) -> I64:
    """The first of points (n, 3) at each of the places (m, 3), by row."""
    x = np.unique(own[:, 0])
    some = np.flatnonzero(
        x[np.minimum(np.searchsorted(x, points[:, 0]), len(x) - 1)] == points[:, 0]
    )
    order = some[np.lexsort((points[some, 1], points[some, 0]))]
    asked, names = names_of(own), names_of(points[order])
    out: I64 = order[np.searchsorted(names, asked)].astype(np.int64)
    return out
