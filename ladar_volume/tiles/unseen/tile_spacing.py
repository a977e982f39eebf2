"""How far apart the points of a tile lie, place by place, as all points tell it; and one of them
for each cell that is wider than that.

A raster over all points, along their own axes, is filled by all tiles. What is filled around a
place follows from the place alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ladar_volume.clouds.between_points import CELL
from ladar_volume.math.kernels import kernel
from ladar_volume.math.own_axes import OwnAxes, extent_of, moments_about, raster_between
from ladar_volume.model.records import F64, I64, Bool
from ladar_volume.tiles.array_file import ENDING, at_rest, read, read_arrays, write, write_arrays
from ladar_volume.tiles.tile_batches import TiledCloud
from ladar_volume.tiles.tile_outline import Box, box_of
from ladar_volume.tiles.tile_places import hull_of_places
from ladar_volume.tiles.tile_store import CloudParts, Tile
from ladar_volume.tiles.tile_surface import used_of
from ladar_volume.tin.duplicates import places
from ladar_volume.tin.sampled_area import cell_in, lasting_sizes


@dataclass(frozen=True)
class Rasters:
    """axes : along which the rasters lie · low, high : (2,) least and greatest coordinates of all
    points along them, m · sizes : of their cells, m · folder : where it is at rest which of their
    cells are filled · count : of all points
    """

    axes: OwnAxes
    low: F64
    high: F64
    sizes: tuple[float, ...]
    folder: Path
    count: int

    @property
    def many(self) -> int:
        """How many rasters there are."""
        return len(self.sizes)

    def filled(self, k: int) -> Path:
        """Where the filled cells of a size are."""
        return self.folder / f"filled_{k}{ENDING}"

    def shape(self, k: int) -> tuple[int, int]:
        """Cells of a raster, with two empty ones on all sides."""
        count = raster_between((self.low, self.high), self.sizes[k])[1] + 4
        return int(count[0]), int(count[1])

    def cells(self, k: int, xy: F64) -> I64:
        """The cell (n,) of places (n, 2), m, along the axes, row by row."""
        low, _ = raster_between((self.low, self.high), self.sizes[k])
        return cells_in(xy, low, self.sizes[k], self.shape(k)[1])

    def spacings(self, xy: F64) -> F64:
        """How far apart points lie around places (n, 2), m, along the axes, (n,) m."""
        found = np.empty((self.many, len(xy)), np.bool_)
        for k in range(self.many):
            read_arrays(self.filled(k))["filled"].take(self.cells(k, xy), out=found[k])
        return lasting_sizes(found, self.sizes)


@kernel
def cells_in(xy: F64, low: F64, size: float, width: int) -> I64:
    """See :meth:`Rasters.cells`."""
    out = np.empty(len(xy), np.int64)
    for i in range(len(xy)):
        out[i] = cell_in(xy, i, low, size, width)
    return out


def extent(of: TiledCloud, tile: Tile, axes: OwnAxes | None) -> F64:
    """Number of vertices, the sums of x and y, and their least and greatest, m (7,); along axes
    where these are given.
    """
    xy = used_of(of.index, of.limits, tile)[0][:, :2]
    xy = np.ascontiguousarray(xy) if axes is None else axes.along(xy)
    low, high = extent_of(xy)
    return np.array([len(xy), xy[:, 0].sum(), xy[:, 1].sum(), *low, *high])


def moments(of: TiledCloud, tile: Tile, middle: F64) -> F64:
    """:func:`moments_about` a middle."""
    return moments_about(used_of(of.index, of.limits, tile)[0][:, :2], middle)


def filled_cells(of: TiledCloud, tile: Tile, rasters: Rasters) -> list[I64]:
    """The cells (k,) of each raster that the tile's vertices fill."""
    xy = rasters.axes.along(used_of(of.index, of.limits, tile)[0][:, :2])
    return [distinct_cells(rasters.cells(k, xy), rasters.shape(k)[1]) for k in range(rasters.many)]


@kernel
def distinct_cells(cells: I64, width: int) -> I64:
    """The cells (k,) of a raster so wide, row by row, that are named (n,), ascending."""
    n = len(cells)
    if not n:
        return cells
    first, last = cells.min() // width, cells.max() // width
    low, high = cells[0] % width, cells[0] % width
    for cell in cells:
        low, high = min(low, cell % width), max(high, cell % width)
    wide = high - low + 1
    filled = np.zeros((last - first + 1) * wide, np.bool_)
    for cell in cells:
        filled[(cell // width - first) * wide + cell % width - low] = True
    at = np.flatnonzero(filled)
    out: I64 = (at // wide + first) * width + at % wide + low
    return out


def tell_spacings(of: TiledCloud, tile: Tile, rasters: Rasters) -> F64:
    """The spacings at the tile's vertices, at rest: each value, how many there are, and the least
    and greatest coordinates of these, (k, 6).
    """
    xy = rasters.axes.along(used_of(of.index, of.limits, tile)[0][:, :2])
    spacing = rasters.spacings(xy)
    write(rasters.folder, "spacing", tile, spacing)
    out = []
    for value in np.unique(spacing).tolist():
        some = xy[spacing == value]
        low, high = extent_of(some)
        out.append([value, len(some), *low, *high])
    return np.array(out).reshape(-1, 6)


class Cells(NamedTuple):
    """One vertex of each cell: names (k, 3) of the cells, how far from their middle it is, in
    cells, and its row (k,).
    """

    name: I64
    off: F64
    row: I64


def nearest_to_middles(
    of: TiledCloud, tile: Tile, rasters: Rasters, extents: F64, shift: tuple[float, float]
) -> tuple[Cells, I64, F64]:
    """In each cell of 1.5 spacings, shifted by so many, the vertex nearest to its middle; their
    numbers (k,) among the tile's vertices; and how far, m, each is from the tile's edge. extents :
    (s, 6) as :func:`tell_spacings` gives them, of all tiles, the finite ones.
    """
    xyz, _, row = used_of(of.index, of.limits, tile)
    spacing, xy = read(rasters.folder, "spacing", tile), rasters.axes.along(xyz[:, :2])
    number = np.searchsorted(extents[:, 0], spacing)
    some = np.flatnonzero(np.isfinite(spacing))
    number = number[some]
    size = CELL * extents[number, 0]
    low = np.array([raster_between((e[2:4], e[4:6]), CELL * e[0])[0] for e in extents]).reshape(
        -1, 2
    )
    place = (xy[some] - low[number]) / size[:, None] + np.array(shift)
    cell = np.floor(place)
    x, y = (place - cell - 0.5).T
    off = x * x + y * y
    name = np.column_stack([number, cell.astype(np.int64)])
    best = first_of_cells(name, off, row[some])
    side, corner = of.index.cloud.tile_m, np.array(tile) * of.index.cloud.tile_m
    inner = xyz[some[best], :2] - corner
    edge = np.minimum(inner, side - inner).min(axis=1) - np.sqrt(2.0) * size[best]
    return Cells(name[best], off[best], row[some[best]]), some[best], edge


def first_of_cells(name: I64, off: F64, row: I64) -> I64:
    """Which (k,) of vertices in named cells (n, 3) are the least off (n,) in theirs, of equals the
    one of the first row (n,) of the file; by name.
    """
    if not len(name):
        return np.zeros(0, np.int64)
    low = np.array([column.min() for column in name.T])
    # a raster has at most some thousand cells along a side
    wide = np.array([column.max() for column in name.T]) - low + 1
    key = ((name[:, 0] - low[0]) * wide[1] + name[:, 1] - low[1]) * wide[2] + name[:, 2] - low[2]
    return np.asarray(first_kernel(np.argsort(key), key, off, row))


@kernel
def first_kernel(order: I64, key: I64, off: F64, row: I64) -> I64:
    """See :func:`first_of_cells`; order : (n,) of the keys (n,)"""
    out, k = np.empty(len(order), np.int64), 0
    for at in order:
        if k == 0 or key[at] != key[out[k - 1]]:
            out[k] = at
            k += 1
            continue
        best = out[k - 1]
        if off[at] < off[best] or (off[at] == off[best] and row[at] < row[best]):
            out[k - 1] = at
    return out[:k].copy()


def border_cells(
    of: TiledCloud, tile: Tile, rasters: Rasters, extents: F64, shift: tuple[float, float]
) -> Cells:
    """Of these, those whose cells may reach into other tiles; all are at rest for :func:`keep`."""
    cells, chosen, edge = nearest_to_middles(of, tile, rasters, extents, shift)
    path = at_rest(kept_folder(rasters, shift), "chosen", tile)
    write_arrays(path, {"row": cells.row, "some": chosen})
    some = edge <= 0.0
    return Cells(cells.name[some], cells.off[some], cells.row[some])


@dataclass(frozen=True)
class NearRaster:
    """Square cells along axes: those that hold a corner of a triangle that is looked at, and those
    beside them, are marked at rest. low : (2,) m · side : of a cell, m · shape : (2,) cells · path
    """

    axes: OwnAxes
    low: F64
    side: float
    shape: tuple[int, int]
    path: Path

    def cells(self, xy: F64) -> I64:
        """The cell (n,) of places (n, 2), m, row by row."""
        return cells_in(
            self.axes.along(np.ascontiguousarray(xy)), self.low, self.side, self.shape[1]
        )

    def near(self, xy: F64) -> Bool:
        """Which of places (n, 2), m, lie in marked cells."""
        return np.asarray(read_arrays(self.path, ("marked",))["marked"][self.cells(xy)])


def keep(
    of: TiledCloud,
    tile: Tile,
    rasters: Rasters,
    shift: tuple[float, float],
    lost: I64,
    near: NearRaster | None,
    folder: Path,
) -> tuple[int, Box | None, F64]:
    """The footprints kept of a tile, at rest in a folder: without the rows that ``lost`` to those
    of other tiles, and of the others those that are near; all for None. Returns how many there were
    before that, their box, and the corners (h, 2) m of their hull.
    """
    chosen = read_arrays(at_rest(kept_folder(rasters, shift), "chosen", tile), ("row", "some"))
    some = chosen["some"][~np.isin(chosen["row"], lost)]
    xyz = used_of(of.index, of.limits, tile)[0][some]
    kept = places(xyz if near is None else xyz[near.near(xyz[:, :2])])
    write(folder, "kept", tile, kept)
    return len(xyz), box_of(kept[:, :2]), hull_of_places(kept[:, :2])


def kept_folder(rasters: Rasters, shift: tuple[float, float]) -> Path:
    """Where what belongs to one coarser surface is at rest."""
    return rasters.folder / f"shift_{shift[0]:g}_{shift[1]:g}"


@dataclass(frozen=True)
class KeptPoints:
    """The vertices that a coarser surface has, as points in tiles. box : by tile · hull : (h, 2)
    corners of the hull of all, m
    """

    cloud: CloudParts
    box: dict[Tile, Box]
    hull: F64
    folder: Path

    def places(self, tile: Tile) -> F64:
        """Footprints (k, 4) of a tile: :func:`~ladar_volume.tin.duplicates.places`."""
        return read(self.folder, "kept", tile) if tile in self.box else np.zeros((0, 4))


def winners(cells: Cells) -> Bool:
    """Which of vertices (k,) are the nearest to the middle of their cell, of equals the first."""
    order = np.lexsort((cells.row, cells.off, cells.name[:, 2], cells.name[:, 1], cells.name[:, 0]))
    new = np.r_[True, (np.diff(cells.name[order], axis=0) != 0).any(axis=1)][: len(order)]
    out = np.zeros(len(order), np.bool_)
    out[order[new]] = True
    return out
