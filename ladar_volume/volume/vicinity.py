"""Which of many places in the plane lie within a distance of some of them.

Whole cells of a grid are decided at once, and single distances are taken only where a cell lies across the limit.
"""

from __future__ import annotations

import math

import numpy as np

from ladar_volume.model.kernels import kernel, leaf_kernel
from ladar_volume.model.records import F64, I64, Bool

#: Cells per distance: more decide more at once and take longer to go through.
FINE = 12.0
#: What rounding may be of a squared distance.
SAFE = 1e-9


@kernel
def sorted_in(xy: F64, some: Bool, low: F64, side: float, rows: int, columns: int) -> tuple[I64, I64]:
    """The places ``some`` (n,) cell by cell, in CSR form: start (cells + 1,) and their indices."""
    start = np.zeros(rows * columns + 1, np.int64)
    cell = np.full(len(xy), -1, np.int64)
    for i in range(len(xy)):
        if some[i]:
            cell[i] = int((xy[i, 1] - low[1]) / side) * columns + int((xy[i, 0] - low[0]) / side)
            start[cell[i] + 1] += 1
    for c in range(rows * columns):
        start[c + 1] += start[c]
    member, at = np.empty(start[-1], np.int64), start[:-1].copy()
    for i in range(len(xy)):
        if cell[i] >= 0:
            member[at[cell[i]]] = i
            at[cell[i]] += 1
    return start, member


@kernel
def away_in_row(start: I64, rows: int, columns: int) -> I64:
    """Cells (rows, columns) to the next occupied one of the same row; the number of columns and rows together where there is none."""
    out = np.empty((rows, columns), np.int64)
    for r in range(rows):
        last = rows + columns
        for k in range(columns):
            last = 0 if start[r * columns + k + 1] > start[r * columns + k] else last + 1
            out[r, k] = last
        last = rows + columns
        for k in range(columns - 1, -1, -1):
            last = min(last + 1, out[r, k])
            out[r, k] = last
    return out


@leaf_kernel
def near_one(xy: F64, i: int, r: int, k: int, cells: float, away: I64, start: I64, member: I64, distance: float) -> bool:
    """Whether place i, in row r and column k, has a member within the distance, which is so many ``cells``."""
    rows, columns = away.shape
    reach = int(cells) + 2
    for q in range(max(r - reach, 0), min(r + reach + 1, rows)):
        aside = int(math.sqrt(max(cells**2 - max(abs(q - r) - 1.0, 0.0) ** 2, 0.0))) + 2
        if away[q, k] > aside:
            continue
        for e in range(start[q * columns + max(k - aside, 0)], start[q * columns + min(k + aside, columns - 1) + 1]):
            dx, dy = xy[member[e], 0] - xy[i, 0], xy[member[e], 1] - xy[i, 1]
            if math.sqrt(dx * dx + dy * dy) <= distance:
                return True
    return False


@kernel
def verdicts(away: I64, cells: float) -> I64:
    """For each cell (rows, columns): 1 where all of it is within so many ``cells`` of a member, -1 where none of it is, else 0."""
    rows, columns = away.shape
    reach, limit = int(cells) + 2, cells**2
    out = np.zeros((rows, columns), np.int64)
    for r in range(rows):
        for k in range(columns):
            least, most = 1e300, 1e300
            for q in range(max(r - reach, 0), min(r + reach + 1, rows)):
                across, along = abs(q - r), away[q, k]
                most = min(most, (across + 1.0) ** 2 + (along + 1.0) ** 2)
                least = min(least, max(across - 1.0, 0.0) ** 2 + max(along - 1.0, 0.0) ** 2)
            if most < limit * (1.0 - SAFE):
                out[r, k] = 1
            elif least > limit * (1.0 + SAFE):
                out[r, k] = -1
    return out


@kernel
def within_kernel(xy: F64, some: Bool, distance: float) -> Bool:
    """Which places (n, 2) lie within the distance of one of ``some`` (n,); these themselves do."""
    out, low, high = some.copy(), np.full(2, np.inf), np.full(2, -np.inf)
    for i in range(len(xy)):
        if some[i]:
            for c in range(2):
                low[c], high[c] = min(low[c], xy[i, c]), max(high[c], xy[i, c])
    if low[0] > high[0]:
        return out
    margin = 1.001 * distance + 1e-6
    low -= margin
    high += margin
    wide, tall = high[0] - low[0], high[1] - low[1]
    side = max(distance / FINE, math.sqrt(wide * tall / len(xy)), (wide + tall) / len(xy))
    rows, columns = int(tall / side) + 1, int(wide / side) + 1
    start, member = sorted_in(xy, some, low, side, rows, columns)
    away, cells = away_in_row(start, rows, columns), distance / side
    verdict = verdicts(away, cells)
    for i in range(len(xy)):
        if not some[i] and low[0] < xy[i, 0] < high[0] and low[1] < xy[i, 1] < high[1]:
            r, k = int((xy[i, 1] - low[1]) / side), int((xy[i, 0] - low[0]) / side)
            out[i] = verdict[r, k] > 0 or (verdict[r, k] == 0 and near_one(xy, i, r, k, cells, away, start, member, distance))
    return out
