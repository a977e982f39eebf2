"""Order statistics of all tiles, without all values in one place: which rows of the file some of
their vertices have, by their rank, and medians.

Rows are counted in blocks, and the blocks that hold a rank are divided, until they are small. A
median is found among the values in its bins.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ladar_volume.model.records import F64, I64
from ladar_volume.tiles import tile_fit
from ladar_volume.tiles.tile_batches import TiledCloud, ask, ask_merged
from ladar_volume.tiles.tile_fit import VertexSelection
from ladar_volume.tiles.tile_work import Workers

#: Blocks that a file is divided into first, about, and that each is divided into after that; rows
#: of those that are small.
FIRST, PARTS, SMALL = 1 << 16, 16, 16


def rows_at_ranks(
    workers: Workers, of: TiledCloud, chosen: VertexSelection, ranks: I64, first: int = FIRST
) -> I64:
    """Rows (k,) of the file of the chosen vertices at ranks (k,), ascending, in the order of the
    file.
    """
    tiles, points = len(of.tiles), of.index.cloud.points
    size = 1 << (points // first).bit_length()
    begin, before = np.arange(0, points, size, dtype=np.int64), np.zeros(1, np.int64)
    while True:
        asked = [(chosen, begin, size)] * tiles
        counted = ask_merged(workers, of, tile_fit.count_in_blocks, asked)
        count = counted.reshape(len(before), -1)  # by the block before, and its parts
        start = before[:, None] + np.cumsum(count, axis=1) - count
        wanted = np.searchsorted((start + count).reshape(-1), ranks, side="right")
        some, at = np.unique(wanted, return_inverse=True)
        begin, before, held = begin[some], start.reshape(-1)[some], counted[some]
        if size <= SMALL:
            break
        size //= PARTS
        begin = (begin[:, None] + size * np.arange(PARTS)).reshape(-1)
    asked = [(chosen, begin, size)] * tiles
    rows = np.sort(np.concatenate(ask(workers, of, tile_fit.rows_in_blocks, asked)))
    place = np.cumsum(held) - held
    return np.asarray(rows[place[at] + ranks - before[at]])


def bins_together(found: Sequence[tuple[I64, I64]]) -> tuple[I64, I64]:
    """Bins (k,), ascending, and how many values are in each, from those of several tiles."""
    bins, at = np.unique(np.concatenate([b for b, _ in found]), return_inverse=True)
    count = np.zeros(len(bins), np.int64)
    np.add.at(count, at.reshape(-1), np.concatenate([c for _, c in found]))
    return bins, count


def median_of_bins(found: tuple[I64, I64], fetch: Callable[[int, int], Sequence[F64]]) -> float:
    """The median of the values of all tiles from their bins, ascending with the values, and how
    many are in each. fetch : takes the first and the last of some bins, and gives the values in
    them, by tile
    """
    bins, below = found[0], np.cumsum(found[1])
    ranks = np.array([(below[-1] - 1) // 2, below[-1] // 2])
    first, last = np.searchsorted(below, ranks, side="right")
    values = np.sort(np.concatenate(fetch(int(bins[first]), int(bins[last]))))
    before = int(below[first - 1]) if first else 0
    return float(np.mean(values[ranks - before]))


def median_of_tiles(
    workers: Workers, of: TiledCloud, values: Callable[..., F64], *more: object
) -> float:
    """The median of what ``values(of, tile, *more)`` gives of all tiles; 0 for none."""
    tiles = len(of.tiles)
    asked = [(values, *more)] * tiles
    found = ask_merged(workers, of, tile_fit.binned, asked, bins_together)
    if not len(found[0]):
        return 0.0
    return median_of_bins(
        found,
        lambda low, high: ask(
            workers, of, tile_fit.values_in, [(low, high, values, *more)] * tiles
        ),
    )
