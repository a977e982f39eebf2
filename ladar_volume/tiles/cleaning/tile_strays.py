"""The strays among the points of a tile: :mod:`ladar_volume.clouds.cloud_cleaning` by tiles.

A point is isolated by what lies around it and around its neighbours; whether it is off a plane, by
the neighbours that are not isolated and were no strays in the pass before. So a tile tells the one,
puts it at rest, and every pass reads what its neighbours told in the one before.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ladar_volume.clouds.cloud_cleaning import (
    AROUND,
    COMPANY,
    ISOLATED,
    LIMITS,
    PART,
    Cloud,
    beside_planes,
    nearby_minimum,
)
from ladar_volume.clouds.cloud_noise import CELL
from ladar_volume.clouds.sampling.plain_places import PlainCells, plain_in_cells
from ladar_volume.math.nearest import nearest, nearest_distances, nearest_index
from ladar_volume.math.own_axes import extent_where
from ladar_volume.model.records import F64, I64, Bool
from ladar_volume.tiles.array_file import Array, at_rest, read_arrays, write_arrays
from ladar_volume.tiles.cleaning.curve_tiles import Curve, OwnFrame, numbered
from ladar_volume.tiles.cleaning.points_around import Around, Asker, settled
from ladar_volume.tiles.tile_batches import TiledCloud
from ladar_volume.tiles.tile_outline import Box
from ladar_volume.tiles.tile_patch import tiles_in
from ladar_volume.tiles.tile_store import Tile
from ladar_volume.tiles.unseen.tile_spacing import Rasters

FLAT = np.array([1.0, 1.0, 0.0])
#: Rings of cells that :func:`plain_in_cells` looks at, by their diagonals, in cells.
CELLS_AROUND = 3.0


@dataclass(frozen=True)
class StrayTuning:
    """What is told of all points first. sigma_m : their noise · rasters : that tell how far apart
    they lie, where lines are to be crossed · plain : cells of plain places, where they are not
    """

    curve: Curve
    frame: OwnFrame
    sigma_m: float
    rasters: Rasters | None
    plain: PlainCells | None


class Good(NamedTuple):
    """low, high : (2,) m, between what the points of a tile lie that are good, and not isolated ·
    strays : how many points are not good · isolated : how many of these are
    """

    low: F64
    high: F64
    strays: int
    isolated: int


def isolated(of: TiledCloud, tile: Tile, tuning: StrayTuning) -> Good:
    """Which points of a tile may be strays, and which of these are isolated, at rest."""
    points, rank = numbered(tuning.curve, tile)
    asker = Asker(of, tile, tuning.curve, tuning.frame)
    cells, r = np.zeros(0), tuning.frame.of(points)
    width = 0.0 if tuning.plain is None else CELLS_AROUND * tuning.plain.side
    if tuning.rasters is not None:
        cells = CELL * tuning.rasters.spacings(tuning.rasters.axes.along(flat_xy(r)))

    def answer(around: Around, rows: I64) -> tuple[tuple[Array, ...], Bool]:
        some = np.ones(len(rows), np.bool_)
        # those asked again are not plain, and not all around them is here
        if tuning.plain is not None and len(rows) == len(rank):
            some = ~plain_in_cells(around.r, tuning.plain, tuning.sigma_m)[rows]
        out, sure = np.zeros(len(rows), np.bool_), np.ones(len(rows), np.bool_)
        out[some], sure[some] = isolated_here(around, rows[some])
        return (out, some), sure

    alone = asked = np.zeros(0, np.bool_)
    if len(rank):
        alone, asked = settled(asker, rank, width, answer)
    arrays = {"asked": asked, "isolated": alone, "cells": cells}
    write_arrays(at_rest(tuning.curve.folder, "isolated", tile), arrays)
    good = np.ones(len(points), np.bool_)
    return good_of(r, good, alone)


def good_of(r: F64, good: Bool, alone: Bool) -> Good:
    """Of the points of a tile along all points' axes, (n, 3) m."""
    low, high = extent_where(flat_xy(r), good & ~alone)
    strays = int(np.count_nonzero(~good))
    return Good(low, high, strays, int(np.count_nonzero(alone & ~good)))


def flat_xy(r: F64) -> F64:
    """Places (n, 2) of points (n, 3)."""
    return np.ascontiguousarray(r[:, :2])


def isolated_here(around: Around, asked: I64) -> tuple[Bool, Bool]:
    """:func:`~ladar_volume.clouds.cloud_cleaning.isolated_points` of those asked (k,), and of which
    that is sure: a neighbour may be nearer than the nearest that is here, though not nearer than
    the edge.
    """
    points, n = around.r, len(around.r)
    out, sure = np.zeros(len(asked), np.bool_), np.zeros(len(asked), np.bool_)
    if n < AROUND or not len(asked):
        return out, sure
    flat, edge = points * FLAT, np.maximum(around.edge, 0.0)
    index, over, high = nearest_index(points), nearest_index(flat), np.full(n, np.inf)
    some = np.arange(len(asked))
    if len(asked) > PART * n:
        high = nearest_distances(index, points, COMPANY + 1)
        near, reach = nearby_minimum(points, np.minimum(high, edge))
        sure = (high <= ISOLATED * near)[asked] & (edge[asked] > reach)
        some = np.flatnonzero(~sure)
        beside, far = nearest(over, flat[asked[some]], AROUND)
    else:
        beside, far = nearest(over, flat[asked], AROUND)
        needed = np.zeros(n, np.bool_)
        needed[beside], needed[asked] = True, True
        high[needed] = nearest_distances(index, points[needed], COMPANY + 1)
    low, own = np.minimum(high, edge), asked[some]
    least, most = (quartile(d[beside]) for d in (low, high))
    out[some] = low[own] > ISOLATED * most
    certain = out[some] | (high[own] <= ISOLATED * least)
    sure[some] = certain & (far <= edge[own])
    return out, sure


def quartile(distance: F64) -> F64:
    """The lower quartile (k,) of distances (k, :data:`AROUND`)."""
    out: F64 = np.partition(distance, AROUND // 4, axis=1)[:, AROUND // 4]
    return out


def beside(
    of: TiledCloud, tile: Tile, tuning: StrayTuning, number: int, extent: tuple[F64, F64]
) -> Good:
    """A pass: which points of a tile are good after it, at rest. extent : between what the good
    ones that are not isolated lie, (2,) m each
    """
    points, rank = numbered(tuning.curve, tile)
    own = read_arrays(at_rest(tuning.curve.folder, "isolated", tile))
    alone, r = own["isolated"], tuning.frame.of(points)
    good, chosen = np.ones(len(points), np.bool_), np.flatnonzero(own["asked"])
    if number > 1:
        before = read_arrays(at_rest(tuning.curve.folder, f"pass_{number - 1}", tile))
        good, chosen = before["good"], before["chosen"]
        chosen = chosen[reached(of, tuning, number, (points, r), before)]
    found, far = np.zeros(len(chosen), np.bool_), np.zeros(len(chosen))
    if len(chosen):
        flags = [("isolated", "isolated")] + [(f"pass_{number - 1}", "good")] * (number > 1)
        asker = Asker(of, tile, tuning.curve, tuning.frame, flags)
        cells = None if tuning.rasters is None else own["cells"][chosen]

        def answer(around: Around, rows: I64) -> tuple[tuple[Array, ...], Bool]:
            size = (
                None if cells is None else cells[np.searchsorted(rank[chosen], around.rank[rows])]
            )
            return planes_here(around, rows, tuning.sigma_m, size, extent)

        found, far = settled(asker, rank[chosen], 0.0, answer)
    good = good.copy()
    good[chosen[found]] = False
    gone = flat_xy(points)[chosen[found & ~alone[chosen]]]
    left = ~found
    arrays = {"good": good, "chosen": chosen[left], "far": far[left], "gone": gone}
    write_arrays(at_rest(tuning.curve.folder, f"pass_{number}", tile), arrays)
    return good_of(r, good, alone)


def planes_here(
    around: Around, rows: I64, sigma_m: float, size: F64 | None, extent: tuple[F64, F64]
) -> tuple[tuple[Array, ...], Bool]:
    """:func:`~ladar_volume.clouds.cloud_cleaning.beside_planes` of those asked (k,), with cells of
    sizes (k,) m; and of which that is sure.
    """
    alone = around.flags["isolated"]
    good = around.flags.get("good", np.ones(len(alone), np.bool_)) & ~alone
    cloud, cells = Cloud(around.r, around.r * FLAT, alone, sigma_m, LIMITS), None
    slack = np.zeros(len(rows))
    if size is not None:
        cells = np.full(len(good), np.inf)
        cells[rows] = size
        # a cell may lack points that are not here
        slack = np.where(np.isfinite(size), np.sqrt(2.0) * size, 0.0)
    found, far = beside_planes(cloud, good, rows, cells, extent)
    return (found, far), far <= around.edge[rows] - slack


def reached(
    of: TiledCloud, tuning: StrayTuning, number: int, own: tuple[F64, F64], before: dict[str, Array]
) -> Bool:
    """Which of the chosen (k,) of the pass before may see another plane now: those beside a stray
    that it found. own : (n, 3) m, points of the tile, and along all points' axes
    """
    points, r = own
    chosen, far = before["chosen"], before["far"]
    if not len(chosen):
        return np.zeros(0, np.bool_)
    low, high = points[chosen, :2].min(axis=0), points[chosen, :2].max(axis=0)
    width = 1.001 * min(float(far.max()), 4.0 * tuning.curve.side)
    box: Box = (*(low - width).tolist(), *(high + width).tolist())
    folder, name = tuning.curve.folder, f"pass_{number - 1}"
    gone = [
        read_arrays(at_rest(folder, name, t), ("gone",))["gone"] for t in tiles_in(of.index, box)
    ]
    xy = np.concatenate(gone)
    if not len(xy):
        return np.zeros(len(chosen), np.bool_)
    level = np.full((len(xy), 1), tuning.frame.level)
    flat = tuning.frame.of(np.hstack([xy, level])) * FLAT
    return np.asarray(nearest(nearest_index(flat), r[chosen] * FLAT, 1)[1] <= far)
