"""All points in the order of one Hilbert curve, tile by tile at rest.

One process puts the points in this order before it asks about strays, and leaves them in it: of
neighbours at the same distance the first along the curve counts, and samples of the ground are
taken along it. Each point's number in that order is told here: the square cells of a coarse curve
are counted over all tiles, and within a cell the points of a tile and of those beside it are put in
order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ladar_volume.math.own_axes import OwnAxes, moments_about
from ladar_volume.model.records import F64, I64, Bool
from ladar_volume.tiles.array_file import ENDING, at_rest, read_arrays, write_arrays
from ladar_volume.tiles.cleaning.near_box import ends_of, near_points
from ladar_volume.tiles.tile_batches import TiledCloud
from ladar_volume.tiles.tile_outline import Box
from ladar_volume.tiles.tile_patch import in_box, tiles_in
from ladar_volume.tiles.tile_store import Tile
from ladar_volume.tin.insertion_order import BITS, hilbert_positions

#: Least number of cells of the coarse curve along the side of a tile.
CELLS = 4


@dataclass(frozen=True)
class Curve:
    """folder : where the points are at rest · near : (6,) m, box of those that are not far from all
    others · low : where the curve's square begins, m · side : of it, m · level : halvings of that
    side that make a cell of the coarse curve · middle : (2,) m, of all points
    """

    folder: Path
    near: F64
    low: tuple[float, float]
    side: float
    level: int
    middle: F64

    @property
    def cell_m(self) -> float:
        """The side of a coarse cell, and a little more than rounding."""
        return 1.001 * self.side / 2.0**self.level

    @property
    def shift(self) -> int:
        """Bits of a position beyond those of its cell."""
        return 2 * (BITS - self.level)

    @property
    def cells(self) -> Path:
        """Where the cells are at rest, with the number of the first point in each."""
        return self.folder / f"cells{ENDING}"


@dataclass(frozen=True)
class OwnFrame:
    """axes : of all points · level : height that heights are about, m"""

    axes: OwnAxes
    level: float

    def of(self, points: F64) -> F64:
        """Points (n, 3), m, along these axes."""
        return np.column_stack([self.axes.along(points[:, :2].copy()), points[:, 2] - self.level])


class Placed(NamedTuple):
    """moments : (5,) of the points about their middle · cells : (k,) coarse cells, ascending ·
    held : (k,) points in each
    """

    moments: F64
    cells: I64
    held: I64


def place(of: TiledCloud, tile: Tile, curve: Curve) -> Placed:
    """Put the points of a tile at rest with their positions along the curve, in its order."""
    points, rows, far = near_points(of, tile, curve.near)
    key = hilbert_positions(np.ascontiguousarray(points[:, :2]), curve.low, curve.side)
    order = np.lexsort((rows, key))
    points, rows, key = points[order], rows[order], key[order]
    arrays = {"points": points, "rows": rows, "key": key, "far": far}
    write_arrays(at_rest(curve.folder, "placed", tile), arrays)
    cells, count = np.unique(key >> curve.shift, return_counts=True)
    moments = moments_about(np.ascontiguousarray(points[:, :2]), curve.middle)
    return Placed(moments, cells, count.astype(np.int64))


def write_cells(curve: Curve, tiles: Sequence[Placed]) -> None:
    """Put the coarse cells of all tiles at rest."""
    cells, at = np.unique(np.concatenate([t.cells for t in tiles]), return_inverse=True)
    count = np.zeros(len(cells), np.int64)
    np.add.at(count, at.reshape(-1), np.concatenate([t.held for t in tiles]))
    write_arrays(curve.cells, {"cells": cells, "first": np.cumsum(count) - count})


class Along(NamedTuple):
    """total : (2,) m, sums of the points' places along all points' axes · low, high : (3,) m, least
    and greatest of them
    """

    total: F64
    low: F64
    high: F64


def number(of: TiledCloud, tile: Tile, curve: Curve, frame: OwnFrame) -> Along:
    """Put the points of a tile at rest with their numbers in the order of all."""
    own = read_arrays(at_rest(curve.folder, "placed", tile))
    points, key = own["points"], own["key"]
    keys, rows, mine = [key], [own["rows"]], [np.ones(len(key), np.bool_)]
    for other in tiles_in(of.index, around_tile(of, tile, curve.cell_m)):
        if other != tile:
            found = read_arrays(at_rest(curve.folder, "placed", other))
            some = in_box(found["points"], around_tile(of, tile, curve.cell_m))
            keys.append(found["key"][some])
            rows.append(found["rows"][some])
            mine.append(np.zeros(np.count_nonzero(some), np.bool_))
    every, ours = np.concatenate(keys), np.concatenate(mine)
    order = np.argsort(every, kind="stable")  # of runs that are in order: they are merged
    if (np.diff(every[order]) == 0).any():
        order = np.lexsort((np.concatenate(rows), every))
    cell, ours = every[order] >> curve.shift, ours[order]
    within = np.arange(len(cell)) - np.searchsorted(cell, cell)
    table = read_arrays(curve.cells)
    first = table["first"][np.searchsorted(table["cells"], cell[ours])]
    arrays = {"points": points, "rank": first + within[ours]}
    write_arrays(at_rest(curve.folder, "numbered", tile), arrays)
    r = frame.of(points)
    return Along(np.array([r[:, 0].sum(), r[:, 1].sum()]), *ends_of(r))


def around_tile(of: TiledCloud, tile: Tile, width_m: float) -> Box:
    """The box of a tile, wider on all sides."""
    side, (i, j) = of.index.cloud.tile_m, tile
    return (
        i * side - width_m,
        j * side - width_m,
        (i + 1) * side + width_m,
        (j + 1) * side + width_m,
    )


def numbered(curve: Curve, tile: Tile) -> tuple[F64, I64]:
    """Points (n, 3), m, of a tile in the order of the curve, and their numbers (n,)."""
    found = read_arrays(at_rest(curve.folder, "numbered", tile), ("points", "rank"))
    return found["points"], found["rank"]


def points_between(
    of: TiledCloud,
    tile: Tile,
    curve: Curve,
    frame: OwnFrame,
    begin: I64,
    end: I64,
    good: str | None,
) -> F64:
    """Number and place along all points' axes (k, 4) of a tile's points with numbers from ``begin``
    to before ``end`` (s,), ascending; of those that are good after a pass, or of all.
    """
    points, rank = numbered(curve, tile)
    at = np.searchsorted(begin, rank, side="right") - 1
    some = (at >= 0) & (rank < end[at])
    if good is not None:
        some &= good_of_pass(curve, tile, good)
    return np.column_stack([rank[some], frame.of(points[some])])


def good_of_pass(curve: Curve, tile: Tile, good: str) -> Bool:
    """Which points (n,) of a tile are good after a pass."""
    return read_arrays(at_rest(curve.folder, good, tile), ("good",))["good"]


def count_good(of: TiledCloud, tile: Tile, curve: Curve, good: str) -> I64:
    """How many points of a tile are good after a pass in each coarse cell (k,) of all tiles."""
    _, rank = numbered(curve, tile)
    first = read_arrays(curve.cells, ("first",))["first"]
    at = np.searchsorted(first, rank[good_of_pass(curve, tile, good)], side="right") - 1
    return np.bincount(at, minlength=len(first))
