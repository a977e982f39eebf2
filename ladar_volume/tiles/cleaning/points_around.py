"""The points around those of a tile that a question is about: all within a width, and where that
does not settle it, those of the nearest tiles, more and more of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ladar_volume.model.records import F64, I64, Bool
from ladar_volume.tiles.array_file import Array, at_rest, read_arrays
from ladar_volume.tiles.cleaning.curve_tiles import Curve, OwnFrame, around_tile, numbered
from ladar_volume.tiles.tile_batches import TiledCloud
from ladar_volume.tiles.tile_outline import Box, box_of
from ladar_volume.tiles.tile_patch import in_box, tiles_in
from ladar_volume.tiles.tile_store import Tile

#: Width around a tile, in mean distances of its points.
WIDTH = 6.0
#: Tiles that are asked first where that is not enough; each time they are twice as many.
NEAREST = 8
#: What rounding may change of a distance, relative to the extent of the points.
ROUNDING = 1e-12


@dataclass(frozen=True)
class Asker:
    """A tile that asks: curve, frame : of all points · flags : what of each point is at rest that
    answers depend on, as folder and name
    """

    of: TiledCloud
    tile: Tile
    curve: Curve
    frame: OwnFrame
    flags: Sequence[tuple[str, str]] = ()


@dataclass(frozen=True)
class Around:
    """points : (n, 3) m in the order of the curve · r : (n, 3) the same along all points' axes ·
    rank : (n,) their numbers · flags : (n,) of each name · edge : (n,) m, within which all points
    around each are here
    """

    points: F64
    r: F64
    rank: I64
    flags: Mapping[str, Array]
    edge: F64

    def rows(self, rank: I64) -> I64:
        """Where points with these numbers (k,) are."""
        return np.searchsorted(self.rank, rank)


def flags_of(asker: Asker, tile: Tile) -> dict[str, Array]:
    """What is at rest of the points of a tile."""
    folder = asker.curve.folder
    return {
        name: read_arrays(at_rest(folder, kind, tile), (name,))[name] for kind, name in asker.flags
    }


def gathered(asker: Asker, tiles: Sequence[Tile], box: Box | None) -> Around:
    """The points of some tiles, or those of them in a box, of which there are no others."""
    points, rank, flags = list[F64](), list[I64](), list[dict[str, Array]]()
    for tile in tiles:
        p, k = numbered(asker.curve, tile)
        more = flags_of(asker, tile)
        if box is not None and tile != asker.tile:
            some = in_box(p, box)
            p, k, more = p[some], k[some], {name: v[some] for name, v in more.items()}
        points.append(p)
        rank.append(k)
        flags.append(more)
    numbers = np.concatenate(rank)
    order = np.argsort(numbers, kind="stable")  # of runs that are in order: they are merged
    every = np.concatenate(points)[order]
    told = {name: np.concatenate([f[name] for f in flags])[order] for _, name in asker.flags}
    if box is None:
        edge = to_other_tiles(asker.of, tiles, every)
    else:
        edge = to_sides(asker.of, box, every)
    edge -= ROUNDING * asker.curve.side
    return Around(every, asker.frame.of(every), numbers[order], told, edge)


def to_sides(of: TiledCloud, box: Box, points: F64) -> F64:
    """How far points (n, 3) in a box are from its sides, (n,) m; those beyond which there is no
    tile do not count.
    """
    boxes = np.array(list(of.index.box.values()))
    low, high = boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)
    out = np.full(len(points), np.inf)
    for k in range(2):
        if low[k] < box[k]:
            out = np.minimum(out, points[:, k] - box[k])
        if high[k] > box[k + 2]:
            out = np.minimum(out, box[k + 2] - points[:, k])
    return out


def to_other_tiles(of: TiledCloud, tiles: Sequence[Tile], points: F64) -> F64:
    """How far points (n, 3) are from the boxes of all tiles but these, (n,) m; infinite for
    none.
    """
    known, out = set(tiles), np.full(len(points), np.inf)
    others = np.array([b for t, b in of.index.box.items() if t not in known]).reshape(-1, 4)
    if len(others):
        # the nearest of them alone count
        some = np.argsort(box_distance(others, box_of(points[:, :2])), kind="stable")
        far = box_distance(others[some], box_of(points[:, :2]))
        for box, least in zip(others[some].tolist(), far.tolist(), strict=True):
            if least > out.max():
                break
            out = np.minimum(out, place_distance(box, points))
    return out


def box_distance(boxes: F64, box: Box | None) -> F64:
    """How far boxes (t, 4) are from one, (t,) m."""
    assert box is not None, "of points"
    x = np.maximum(np.maximum(boxes[:, 0] - box[2], box[0] - boxes[:, 2]), 0.0)
    y = np.maximum(np.maximum(boxes[:, 1] - box[3], box[1] - boxes[:, 3]), 0.0)
    return np.asarray(np.hypot(x, y))


def place_distance(box: Sequence[float], points: F64) -> F64:
    """How far points (n, 3) are from a box, (n,) m."""
    x = np.maximum(np.maximum(box[0] - points[:, 0], points[:, 0] - box[2]), 0.0)
    y = np.maximum(np.maximum(box[1] - points[:, 1], points[:, 1] - box[3]), 0.0)
    return np.asarray(np.hypot(x, y))


def settled(
    asker: Asker,
    own: I64,
    width_m: float,
    answer: Callable[[Around, I64], tuple[tuple[Array, ...], Bool]],
) -> tuple[Array, ...]:
    """The answers (k,) about the points with numbers (k,) of a tile.

    ``answer`` is given points around, and where among them are those that it is asked about; it
    returns answers, and of which of them it is sure. It is sure of all where all points are around.
    """
    of, tile = asker.of, asker.tile
    mean = of.index.cloud.tile_m / max(of.index.count[tile], 1) ** 0.5
    width = min(max(WIDTH * mean, width_m), max(of.index.cloud.tile_m, width_m))
    box = around_tile(of, tile, width)
    around = gathered(asker, tiles_in(of.index, box), box)
    found, sure = answer(around, around.rows(own))
    out, left, many = tuple(f.copy() for f in found), np.flatnonzero(~sure), NEAREST
    if not len(left):
        return out
    tiles = of.tiles
    boxes = np.array([of.index.box[t] for t in tiles])
    while len(left):
        here = around.points[around.rows(own[left])]
        order = np.argsort(box_distance(boxes, box_of(here[:, :2])), kind="stable")[:many]
        around = gathered(asker, [tiles[k] for k in order.tolist()], None)
        found, sure = answer(around, around.rows(own[left]))
        if len(order) == len(tiles):
            sure = np.ones(len(left), np.bool_)
        for whole, some in zip(out, found, strict=True):
            whole[left[sure]] = some[sure]
        left, many = left[~sure], 2 * many
    return out
