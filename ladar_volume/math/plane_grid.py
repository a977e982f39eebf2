"""The points of a plane that are nearest to a few places: by a grid whose cells hold a few points
each, searched in rings about the cell of a place.

It costs one pass over the points, where a tree sorts them. Clumps would fill single cells: those
who ask look at :func:`fullest` first.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ladar_volume.math.array_types import F64, I32, I64
from ladar_volume.math.kernels import kernel
from ladar_volume.math.own_axes import extent_of

#: Mean number of points in a cell, and most cells for a point.
MEAN, MOST = 3.0, 2.0


class PlaneGrid(NamedTuple):
    """xy : (n, 2) m, points · low : (2,) m · cell : m · size : (2,) numbers of cells · start : (c +
    1,) of each cell among the rows · rows : (n,) by cell, ascending in each
    """

    xy: F64
    low: F64
    cell: float
    size: I64
    start: I32
    rows: I32


@kernel
def cell_of(grid_low: float, cell: float, count: int, x: float) -> int:
    """The cell of a coordinate, the first or last of ``count`` for one beyond."""
    return int(min(max(math.floor((x - grid_low) / cell), 0.0), count - 1.0))


@kernel
def sort_by_cell(xy: F64, low: F64, cell: float, count: I64) -> tuple[I32, I32]:
    """Start (c + 1,) of each cell and the rows (n,) by cell, ascending in each."""
    start = np.zeros(count[0] * count[1] + 1, np.int32)
    own, rows = np.empty(len(xy), np.int32), np.empty(len(xy), np.int32)
    for i in range(len(xy)):
        u, v = (
            cell_of(low[0], cell, count[0], xy[i, 0]),
            cell_of(low[1], cell, count[1], xy[i, 1]),
        )
        own[i] = u * count[1] + v
        start[own[i] + 1] += 1
    for c in range(len(start) - 1):
        start[c + 1] += start[c]
    at = start.copy()
    for i in range(len(xy)):
        rows[at[own[i]]] = i
        at[own[i]] += 1
    return start, rows


def plane_grid(xy: F64) -> PlaneGrid:
    """The grid of points (n, 2), m."""
    low, high = extent_of(xy)
    wide = high - low
    least = float(wide.max()) / (MOST * len(xy))
    cell = max(math.sqrt(float(wide.prod()) * MEAN / len(xy)), least, 1e-300)
    count = np.floor(wide / cell).astype(np.int64) + 1
    return PlaneGrid(xy, low, cell, count, *sort_by_cell(xy, low, cell, count))


def fullest(grid: PlaneGrid) -> int:
    """Number of points in the fullest cell."""
    return int(np.diff(grid.start).max())


@kernel
def take_in(grid: PlaneGrid, cell: int, place: F64, rows: I64, square: F64) -> None:
    """Put the points of a cell that are nearer to a place (2,) than the last of ``rows`` (k,) among
    these, which are in the order of their squared distances (k,), then of their rows.
    """
    k = len(rows)
    for j in range(grid.start[cell], grid.start[cell + 1]):
        i = grid.rows[j]
        dx, dy = grid.xy[i, 0] - place[0], grid.xy[i, 1] - place[1]
        d = dx * dx + dy * dy
        if d > square[k - 1] or (d == square[k - 1] and i > rows[k - 1]):
            continue
        at = k - 1
        while at > 0 and (square[at - 1] > d or (square[at - 1] == d and rows[at - 1] > i)):
            square[at], rows[at] = square[at - 1], rows[at - 1]
            at -= 1
        square[at], rows[at] = d, i


@kernel
def nearest_in_grid(grid: PlaneGrid, places: F64, rows: I64, square: F64) -> None:
    """Write the rows (m, k) of the points nearest to places (m, 2), by distance, then row, and
    their squared distances (m, k), m²; there are k points or more.
    """
    a, b = grid.size
    for p in range(len(places)):
        square[p], rows[p] = np.inf, np.iinfo(np.int64).max
        u = cell_of(grid.low[0], grid.cell, a, places[p, 0])
        v = cell_of(grid.low[1], grid.cell, b, places[p, 1])
        for ring in range(max(a, b)):
            # what lies beyond the rings before is at least so far
            sure = np.inf
            for c, at in ((0, u), (1, v)):
                x = places[p, c] - grid.low[c]
                sure = min(sure, x - (at - ring + 1) * grid.cell, (at + ring) * grid.cell - x)
            if ring > 0 and square[p, -1] < max(sure, 0.0) ** 2:
                break
            for i in range(max(u - ring, 0), min(u + ring, a - 1) + 1):
                step = 1 if abs(i - u) == ring else max(2 * ring, 1)
                for j in range(v - ring, v + ring + 1, step):
                    if 0 <= j < b:
                        take_in(grid, i * b + j, places[p], rows[p], square[p])
