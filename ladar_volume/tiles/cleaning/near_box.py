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
    if np.isinf(near).all():
        return points, rows, points[:0]
    inside = ((points >= near[:3]) & (points <= near[3:])).all(axis=1)
    return rows_of(points, np.flatnonzero(inside)), rows[inside], points[~inside]


def extent_of_tile(of: TiledCloud, tile: Tile, near: F64) -> Extent:
    """Of a tile's distinct points in a box (6,)."""
    points, _, _ = near_points(of, tile, near)
    total = np.array([points[:, k].sum() for k in range(3)])
    return Extent(len(points), total, *ends_of(points))


def ends_of(points: F64) -> tuple[F64, F64]:
    """Least and greatest coordinates (3,), m, of points (n, 3); by column, which is faster."""
    low, high = (
        [end(points[:, k], initial=first) for k in range(3)]
        for end, first in ((np.min, np.inf), (np.max, -np.inf))
    )
    return np.array(low), np.array(high)


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


def near_box(workers: Workers, of: TiledCloud, tiles: Sequence[Extent]) -> F64:
    """The box (6,), m, of points that are not far from all others; everywhere for none. tiles : the
    extents of all
    """
    whole = extent_together(tiles)
    n = whole.count
    left_out = max(1, int(END * n))
    if n < 4 * left_out:
        return EVERYWHERE
    ranks = (left_out, n - 1 - left_out)
    if all_near(whole, *bounds(tiles, left_out)):
        return EVERYWHERE
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


def bounds(tiles: Sequence[Extent], left_out: int) -> tuple[F64, F64]:
    """What the values with so many below them, and above them, are at most and at least, (3,) m."""
    count = np.array([t.count for t in tiles])
    at_most, at_least = np.empty(3), np.empty(3)
    for k in range(3):
        high, low = np.array([t.high[k] for t in tiles]), np.array([t.low[k] for t in tiles])
        up, down = np.argsort(high), np.argsort(-low)
        at_most[k] = high[up][np.searchsorted(np.cumsum(count[up]), left_out, side="right")]
        at_least[k] = low[down][np.searchsorted(np.cumsum(count[down]), left_out, side="right")]
    return at_most, at_least


def all_near(whole: Extent, low: F64, high: F64) -> bool:
    """Whether no point can be far, where the values by rank are at most ``low`` and at least
    ``high`` (3,), m.
    """
    room = FAR * float((high - low).max())
    return bool(room > 0.0 and ((whole.low >= low - room) & (whole.high <= high + room)).all())


def surely_near(searches: Sequence[Search], whole: Extent) -> bool:
    """Whether no point can be far, wherever in their bins the ranks are."""
    low, high = np.array([s.high for s in searches[::2]]), np.array([s.low for s in searches[1::2]])
    return all_near(whole, low, high)


def extents_of_tiles(workers: Workers, of: TiledCloud, near: F64 = EVERYWHERE) -> list[Extent]:
    """Of the distinct points of each tile in a box (6,), m."""
    return ask(workers, of, extent_of_tile, [(near,)] * len(of.tiles))
