"""The box beyond which a point is far from all others, of the points of all tiles:
:func:`~ladar_volume.clouds.sampling.isolation.far_from_cloud` by tiles.

It needs two heights, two x and two y by rank. Values are counted in bins, and the bin of each rank
is divided until all values in it are the same. Mostly the first bins tell that nothing is far.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ladar_volume.clouds.sampling.isolation import END, FAR
from ladar_volume.math.equal_rows import distinct_rows, rows_of
from ladar_volume.model.records import F64, I64
from ladar_volume.tiles.tile_batches import TiledCloud, ask, ask_merged
from ladar_volume.tiles.tile_store import Tile
from ladar_volume.tiles.tile_work import Workers

#: Bins of each search.
BINS = 1024
#: The box of points that are all near.
EVERYWHERE = np.array([-np.inf] * 3 + [np.inf] * 3)


@dataclass(frozen=True)
class Extent:
    """count : of distinct points · total : (3,) sums of their coordinates, m · low, high : (3,)
    least and greatest, m
    """

    count: int
    total: F64
    low: F64
    high: F64


class Search(NamedTuple):
    """The values of an axis from ``low`` to ``high``, m, and how many lie below these; the one of a
    rank is sought.
    """

    axis: int
    rank: int
    low: float
    high: float
    before: int = 0

    @property
    def found(self) -> bool:
        """All of them are the same."""
        return self.low == self.high


def near_points(of: TiledCloud, tile: Tile, near: F64) -> tuple[F64, I64, F64]:
    """The distinct points (n, 3), m, of a tile in a box (6,), their rows (n,) in the file, and
    those that are not in it (k, 3).
    """
    points = of.index.points(tile)
    some = distinct_rows(points)
    points, rows = rows_of(points, some), of.index.rows(tile)[some]
    inside = ((points >= near[:3]) & (points <= near[3:])).all(axis=1)
    return rows_of(points, np.flatnonzero(inside)), rows[inside], points[~inside]


def extent_of_tile(of: TiledCloud, tile: Tile, near: F64) -> Extent:
    """Of a tile's distinct points in a box (6,)."""
    points, _, _ = near_points(of, tile, near)
    total = np.array([points[:, k].sum() for k in range(3)])
    low, high = points.min(axis=0, initial=np.inf), points.max(axis=0, initial=-np.inf)
    return Extent(len(points), total, low, high)


def extent_together(tiles: Sequence[Extent]) -> Extent:
    """Of several."""
    return Extent(
        sum(t.count for t in tiles),
        np.sum([t.total for t in tiles], axis=0),
        np.min([t.low for t in tiles], axis=0),
        np.max([t.high for t in tiles], axis=0),
    )


class Binned(NamedTuple):
    """How many values are in each bin of some searches, and the least and greatest there, all
    (s, BINS).
    """

    many: I64
    low: F64
    high: F64


def binned(of: TiledCloud, tile: Tile, searches: Sequence[Search]) -> Binned:
    """The values of a tile's distinct points."""
    points, _, _ = near_points(of, tile, EVERYWHERE)
    shape = len(searches), BINS
    out = Binned(np.zeros(shape, np.int64), np.full(shape, np.inf), np.full(shape, -np.inf))
    for k, s in enumerate(searches):
        if s.found:
            continue
        values = points[:, s.axis]
        values = values[(values >= s.low) & (values <= s.high)]
        at = np.minimum(((values - s.low) / (s.high - s.low) * BINS).astype(np.int64), BINS - 1)
        out.many[k] = np.bincount(at, minlength=BINS)
        np.minimum.at(out.low[k], at, values)
        np.maximum.at(out.high[k], at, values)
    return out


def binned_together(tiles: Sequence[Binned]) -> Binned:
    """Of several tiles."""
    return Binned(
        np.sum([t.many for t in tiles], axis=0),
        np.min([t.low for t in tiles], axis=0),
        np.max([t.high for t in tiles], axis=0),
    )


def narrowed(searches: Sequence[Search], found: Binned) -> list[Search]:
    """Each search in the bin of its rank."""
    out = []
    for k, s in enumerate(searches):
        if s.found:
            out.append(s)
            continue
        below = s.before + np.cumsum(found.many[k])
        b = int(np.searchsorted(below, s.rank, side="right"))
        low, high = float(found.low[k, b]), float(found.high[k, b])
        out.append(Search(s.axis, s.rank, low, high, int(below[b] - found.many[k, b])))
    return out


def near_box(workers: Workers, of: TiledCloud, whole: Extent) -> F64:
    """The box (6,), m, of points that are not far from all others; everywhere for none."""
    n = whole.count
    left_out = max(1, int(END * n))
    if n < 4 * left_out:
        return EVERYWHERE
    ranks = (left_out, n - 1 - left_out)
    ends = list(zip(whole.low.tolist(), whole.high.tolist(), strict=True))
    searches = [Search(k, rank, *ends[k]) for k in range(3) for rank in ranks]
    while not all(s.found for s in searches):
        more = [(searches,)] * len(of.tiles)
        searches = narrowed(searches, ask_merged(workers, of, binned, more, binned_together))
        if surely_near(searches, whole):
            return EVERYWHERE
    low, high = (np.array([s.low for s in searches[k::2]]) for k in range(2))
    room = FAR * float((high - low).max())
    if not room > 0.0 or ((whole.low >= low - room) & (whole.high <= high + room)).all():
        return EVERYWHERE
    return np.asarray(np.r_[low - room, high + room])


def surely_near(searches: Sequence[Search], whole: Extent) -> bool:
    """Whether no point can be far, wherever in their bins the ranks are."""
    low, high = np.array([s.high for s in searches[::2]]), np.array([s.low for s in searches[1::2]])
    room = FAR * float((high - low).max())
    return bool(room > 0.0 and ((whole.low >= low - room) & (whole.high <= high + room)).all())


def extent_of_cloud(workers: Workers, of: TiledCloud, near: F64 = EVERYWHERE) -> Extent:
    """Of all tiles' distinct points in a box (6,), m."""
    return extent_together(ask(workers, of, extent_of_tile, [(near,)] * len(of.tiles)))
