"""How far apart the points of all tiles lie, place by place, where their neighbours lie on scan
lines: :func:`~ladar_volume.tin.sampled_area.spacings` by tiles.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ladar_volume.math.own_axes import OwnAxes, extent_of, moments_about
from ladar_volume.model.records import F64, I64
from ladar_volume.tiles.cleaning.curve_tiles import Curve, OwnFrame, numbered
from ladar_volume.tiles.tile_batches import TiledCloud
from ladar_volume.tiles.tile_store import Tile
from ladar_volume.tiles.unseen.tile_spacing import Rasters, distinct_cells
from ladar_volume.tin.sampled_area import cell_sizes


def places_of(tile: Tile, curve: Curve, frame: OwnFrame) -> F64:
    """The places (n, 2), m, of a tile along all points' axes."""
    return np.ascontiguousarray(frame.of(numbered(curve, tile)[0])[:, :2])


def moments(of: TiledCloud, tile: Tile, curve: Curve, frame: OwnFrame, middle: F64) -> F64:
    """:func:`moments_about` a middle."""
    return moments_about(places_of(tile, curve, frame), middle)


def extent(of: TiledCloud, tile: Tile, curve: Curve, frame: OwnFrame, axes: OwnAxes) -> F64:
    """Least and greatest coordinates (4,), m, along axes of these places."""
    return np.concatenate(extent_of(axes.along(places_of(tile, curve, frame))))


def filled(
    of: TiledCloud, tile: Tile, curve: Curve, frame: OwnFrame, rasters: Rasters
) -> list[I64]:
    """The cells (k,) of each raster that the tile's points fill."""
    xy = rasters.axes.along(places_of(tile, curve, frame))
    return [distinct_cells(rasters.cells(k, xy), rasters.shape(k)[1]) for k in range(rasters.many)]


def rasters_of(
    axes: OwnAxes, extent: tuple[F64, F64], some: F64, count: int, folder: Path
) -> Rasters:
    """The rasters of so many places, some (k, 2) of which tell the least spacing."""
    some = axes.along(np.ascontiguousarray(some))
    sizes = tuple(cell_sizes(some, count, extent))
    return Rasters(axes, *extent, sizes, folder / "spacings", count)
