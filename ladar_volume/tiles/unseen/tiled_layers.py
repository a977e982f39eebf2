"""Two layers of points, one above the other, in all tiles:
:mod:`ladar_volume.clouds.sampling.layers` to what one process gives.
"""

from __future__ import annotations

import math

import numpy as np

from ladar_volume.clouds.cloud_noise import NEIGHBOURS, neighbours
from ladar_volume.clouds.sampling.layers import FEWEST, MOST, Layers, layers_of
from ladar_volume.clouds.sampling.rounding_step import lowest_hashes, rounding_steps
from ladar_volume.model.records import F64, I64
from ladar_volume.tiles import tile_fit
from ladar_volume.tiles.tile_batches import TiledCloud, ask
from ladar_volume.tiles.tile_fit import VertexSelection
from ladar_volume.tiles.tile_patch import in_box, tiles_in
from ladar_volume.tiles.tile_store import Tile
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
    """The points (k, :data:`NEIGHBOURS`, 3) of all tiles nearest over the plane to vertices (k, 3)
    m, these tile by tile, and their rows (k,) among those given.
    """
    of = fitter.of
    cells = np.floor(some[:, :2] / of.index.cloud.tile_m).astype(np.int64)
    own = [np.flatnonzero((cells == tile).all(axis=1)) for tile in of.tiles]
    near = ask(fitter.workers, of, neighbours_of, [(some[rows],) for rows in own])
    order = np.concatenate(own)
    return np.concatenate(near), some[order], order


def height_step(fitter: GroundFitter) -> float:
    """The step, m, to which the heights of all tiles were rounded; 0 for none."""
    of = fitter.of
    some = ask(fitter.workers, of, hashed, [()] * len(of.tiles))
    return float(rounding_steps(lowest_hashes(np.concatenate(some)))[2])


def hashed(of: TiledCloud, tile: Tile) -> F64:
    """The points (k, 3) of a tile that may tell the step."""
    return lowest_hashes(of.index.places(tile)[:, :3])


def neighbours_of(of: TiledCloud, tile: Tile, own: F64) -> F64:
    """The points (k, :data:`NEIGHBOURS`, 3) of all tiles nearest over the plane to vertices (k, 3)
    of a tile.
    """
    if not len(own):
        return np.zeros((0, NEIGHBOURS, 3))
    width = WIDTH * of.index.cloud.tile_m / of.index.count[tile] ** 0.5
    low, high = own[:, :2].min(axis=0), own[:, :2].max(axis=0)
    while True:
        box = (*(low - width).tolist(), *(high + width).tolist())
        tiles = tiles_in(of.index, box)
        points = np.concatenate([of.index.places(t)[:, :3] for t in tiles])
        points = points[in_box(points, box)]
        everything = len(points) == sum(of.index.count.values())
        if len(points) > NEIGHBOURS:
            rows = row_of(points, own)
            near = neighbours(points, np.arange(len(points)), rows)
            far = np.hypot(*(near[..., :2] - own[:, None, :2]).transpose(2, 0, 1)).max()
            if far <= width or everything:
                return near
        width *= 2.0


def row_of(points: F64, own: F64) -> np.ndarray:
    """The rows (m,) of places (m, 3) among points (n, 3) by tile, then x and y."""
    order = np.lexsort((points[:, 1], points[:, 0]))
    names = np.ascontiguousarray(points[order, :2]).view(np.complex128).reshape(-1)
    asked = np.ascontiguousarray(own[:, :2]).view(np.complex128).reshape(-1)
    return np.asarray(order[np.searchsorted(names, asked)])
