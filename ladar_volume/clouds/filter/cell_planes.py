"""What a cell sees: the points within its ball, the planes it finds for itself and its neighbours,
and those that these offer and lend it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ladar_volume.clouds.filter import sharp_planes
from ladar_volume.clouds.filter.cell_records import (
    Cell,
    CellNoise,
    CellRule,
    Cells,
    NeighbourPlanes,
    NeighbourSets,
)
from ladar_volume.math.array_types import F64, I32, I64, U64
from ladar_volume.math.hashing import mix_bits
from ladar_volume.math.kernels import inlined, kernel, leaf_kernel
from ladar_volume.rmls.patch_fit import AROUND, REACH
from ladar_volume.rmls.voxel_store import voxels_around

#: Planes each cell finds for itself and its neighbours.
OFFERED = 3
#: What lies within this many sigma of a plane found is not searched for the next one.
EXPLAINED = 2.0
#: A cell and those next to it.
NEXT = 27


@kernel
def points_in_voxels(v: int, keys: I64, table: I32, first: I64, r: F64, out: I64) -> Any:
    """Indices of all points (sorted by voxel) in the voxels around voxel v; returns how many. With
    an empty ``out`` only counts.
    """
    near, n = np.empty(AROUND, np.int64), 0
    for a in range(voxels_around(keys[v], keys, table, REACH, near)):
        for i in range(first[near[a]], first[near[a] + 1]):
            if len(out):
                out[n] = i
            n += 1
    return n


@leaf_kernel
def points_in_ball(
    r: F64, first: I64, v: int, slots: I64, n: int, ball: float, origin: F64, x: F64
) -> Any:
    """Mean of the cell's own points to origin (3,), and the gathered points within ``ball`` of it,
    about it, to x; returns how many.
    """
    lo, hi = first[v], first[v + 1]
    origin[:] = 0.0
    for i in range(lo, hi):
        for k in range(3):
            origin[k] += r[i, k] / (hi - lo)
    m = 0
    for i in range(n):
        square = 0.0
        for k in range(3):
            x[m, k] = r[slots[i], k] - origin[k]
            square += x[m, k] * x[m, k]
        if square <= ball * ball:
            m += 1
    return m


@kernel
def cell_at(v: int, turn: int, cells: Cells, rule: CellRule, noise: CellNoise) -> Cell:
    """Cell v with the points within its ball."""
    n = points_in_voxels(v, cells.keys, cells.table, cells.first, cells.r, np.empty(0, np.int64))
    slots, x, origin = np.empty(n, np.int64), np.empty((n + 1, 3)), np.empty(3)
    points_in_voxels(v, cells.keys, cells.table, cells.first, cells.r, slots)
    m = points_in_ball(cells.r, cells.first, v, slots, n, rule.ball, origin, x)
    return Cell(v, turn, x, m, slots, origin, noise.sigma[v], noise.threshold[v], noise.width[v])


@inlined
def _fit_in_slab(cell: Cell, free: I64, label: I64, plane: F64, mean: F64, inverse: F64) -> Any:
    """Refit a plane to the points ``free`` within the threshold of it; returns their number."""
    used = 0
    for _ in range(3):
        label[:] = -1
        for j in range(len(free)):
            label[free[j]] = (
                0 if abs(sharp_planes.distance(cell.x[free[j]], plane)) <= cell.threshold else -1
            )
        used = sharp_planes.fit_plane(cell.x, cell.m, label, 0, plane, mean, inverse)
    return used


@leaf_kernel
def _points_off_plane(x: F64, free: I64, left: int, plane: F64, width: float) -> Any:
    """Keep those of the points ``free[:left]`` that lie farther than ``width`` from a plane;
    returns how many.
    """
    rest = 0
    for j in range(left):
        if abs(sharp_planes.distance(x[free[j]], plane)) > width:
            free[rest] = free[j]
            rest += 1
    return rest


@inlined
def _planes_of(cell: Cell, rule: CellRule, state: U64, planes: F64) -> Any:
    """Planes (OFFERED, 4) of one cell, as :func:`main_planes`; returns their number."""
    label, mean, inverse = np.full(cell.m, -1), np.empty(3), np.empty((3, 3))
    x, origin, free, left, found = cell.x, cell.origin, np.arange(cell.m), cell.m, 0
    score = sharp_planes.SCORE_SIGMAS * cell.sigma
    for _ in range(OFFERED):
        plane = planes[found]
        if left < rule.least:
            break
        best = sharp_planes.best_plane(x, free, left, rule.ball, score, rule.trials, state, plane)
        if best <= 0.0:
            break
        used = _fit_in_slab(cell, free[:left], label, plane, mean, inverse)
        if used < rule.least:
            break
        left = _points_off_plane(x, free, left, plane, EXPLAINED * cell.sigma)
        if sharp_planes.on_line(used, inverse, cell.width):
            continue
        plane[3] += plane[0] * origin[0] + plane[1] * origin[1] + plane[2] * origin[2]
        found += 1
    return found


@kernel
def main_planes(
    which: I64, cells: Cells, rule: CellRule, noise: CellNoise, known: NeighbourPlanes
) -> None:
    """The planes that the points near the cells ``which`` lie on, most points first, as ``n·x = o``
    (v, OFFERED, 4) and their number (v,), to ``known``.

    Each is sought among what the former ones do not explain. They are what a cell and its
    neighbours have to choose from. Points on a line less than ``width`` (v,) wide tell none.
    """
    for v in which:
        cell, state = cell_at(v, 0, cells, rule, noise), np.empty(1, np.uint64)
        state[0] = mix_bits(np.uint64(cells.keys[v]) ^ mix_bits(np.uint64(rule.seed)))
        known.counts[v] = _planes_of(cell, rule, state, known.planes[v])


@inlined
def neighbour_candidates(
    v: int, cells: Cells, known: NeighbourPlanes, origin: F64, out: F64
) -> Any:
    """Planes of the cells around cell v, about ``origin``; returns how many."""
    near, n = np.empty(AROUND, np.int64), 0
    for i in range(voxels_around(cells.keys[v], cells.keys, cells.table, REACH, near)):
        for a in range(known.counts[near[i]]):
            out[n] = known.planes[near[i], a]
            out[n, 3] -= out[n, 0] * origin[0] + out[n, 1] * origin[1] + out[n, 2] * origin[2]
            n += 1
    return n


@inlined
def neighbour_sets(v: int, cells: Cells, known: NeighbourPlanes, origin: F64) -> NeighbourSets:
    """The sets of several planes of the cells next to cell v and its own, about ``origin``."""
    near, n = np.empty(NEXT, np.int64), 0
    out, out_sizes = np.empty((NEXT, sharp_planes.MOST, 4)), np.empty(NEXT, np.int64)
    sets, sizes = known.sets, known.sizes
    for i in range(voxels_around(cells.keys[v], cells.keys, cells.table, 1, near)):
        w = near[i]
        if sizes[w] > 1:
            out_sizes[n] = sizes[w]
            for a in range(sizes[w]):
                out[n, a] = sets[w, a]
                out[n, a, 3] -= (
                    sets[w, a, 0] * origin[0]
                    + sets[w, a, 1] * origin[1]
                    + sets[w, a, 2] * origin[2]
                )
            n += 1
    return NeighbourSets(out[:n], out_sizes[:n])
