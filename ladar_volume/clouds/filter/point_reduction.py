"""Fewer points: rounding to a grid and cluster means (seed 002 chapter 4 and section 4.3), before
and after the filter.

Published are rounding with removal of identical points before the filter, and the means of clusters
after it. A cell of the grid is what rounds to the same multiple of the step, for both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from ladar_volume.clouds.filter.filter_result import REASONS, CloudResult
from ladar_volume.math.array_types import F64, I32, I64
from ladar_volume.math.kernels import parallel_kernel
from ladar_volume.model.errors import FilterError
from ladar_volume.rmls.voxel_store import HALF, insert_keys, pack_key


@dataclass(frozen=True)
class ReducedCloud:
    """r : (k, 3) m, one point per occupied cell, in the order of ``index`` · index : (k,) lowest
    input point of each cell, ascending · count : (k,) input points in it · cell : (n,) row of r
    every input point went into
    """

    r: F64
    index: I64
    count: I64
    cell: I64


def sorted_by_voxel(r: F64, edge_m: float) -> tuple[I64, I64, I64, I32]:
    """Order (n,) of points by voxel of the given edge, keys (v,), first point of each voxel (v +
    1,), hash table.
    """
    ijk = np.floor(r / edge_m).astype(np.int64)
    if np.abs(ijk).max(initial=0) >= HALF - 8:
        raise FilterError(
            f"a cloud wider than {2 * HALF} voxels of {edge_m} m",
            reason="filter_too_wide",
            value=edge_m,
        )
    key = pack_key(ijk)
    order = np.argsort(key, kind="stable")
    key = key[order]
    first = np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1], [True]])[: len(key) + 1])
    keys = key[first[:-1]]
    sort_within(r, first, order)
    table = np.full(1 << max(4, int(4 * len(keys) - 1).bit_length()), -1, np.int32)
    insert_keys(table, keys, len(keys))
    return order, keys, first, table


@parallel_kernel
def sort_within(r: F64, first: I64, order: I64) -> None:
    """Points of each voxel, order[first[v]:first[v + 1]], by x, y and z: what is summed then does
    not depend on the order given.
    """
    for v in numba.prange(len(first) - 1):
        own = order[first[v] : first[v + 1]].copy()
        for axis in (2, 1, 0):  # stable: the last one counts most
            own = own[np.argsort(r[own, axis], kind="mergesort")]
        order[first[v] : first[v + 1]] = own


def _grid_key(ijk: F64, step_m: float) -> I64:
    """One number (n,) per cell, in no order that matters; raises FilterError where cells cannot be
    told apart.
    """
    low = ijk.min(axis=0)
    span = ijk.max(axis=0) - low + 1
    # digits: beyond 2^53 multiples of the step neighbouring cells are one float
    if np.abs(ijk).max() >= 2.0**53 or np.prod(span) >= 2.0**62:
        raise FilterError(
            f"a cloud of {span} cells of {step_m} m", reason="filter_too_wide", value=step_m
        )
    i, j, k = (ijk - low).astype(np.int64).T
    wide = span.astype(np.int64)
    key: I64 = (i * wide[1] + j) * wide[2] + k
    return key


def reduce_points(r: F64, step_m: float, how: str) -> ReducedCloud:
    """Points (n, 3) m reduced to one per cell of edge ``step_m``: ``round`` to its middle, a
    multiple of the step, or their ``mean``.

    The same set of points gives the same bytes in any order. A step of 0 changes nothing. Raises
    FilterError where the cloud is wider than numbers can count cells.
    """
    n = len(r)
    if step_m == 0.0:
        return ReducedCloud(r, np.arange(n), np.ones(n, np.int64), np.arange(n))
    ijk = np.rint(r / step_m)
    key = _grid_key(ijk, step_m)
    order = np.lexsort((r[:, 2], r[:, 1], r[:, 0], key))
    _, first, count = np.unique(key[order], return_index=True, return_counts=True)
    lowest = np.minimum.reduceat(order, first)
    rank = np.argsort(lowest)
    middle = ijk[lowest] * step_m
    if how == "mean":  # about the middle of the cell, so that map coordinates cost no digits
        offset = r[order] - np.repeat(middle, count, axis=0)
        middle = middle + np.add.reduceat(offset, first, axis=0) / count[:, None]
    cell = np.empty(n, np.int64)
    place = np.empty(len(rank), np.int64)
    place[rank] = np.arange(len(rank))
    cell[order] = np.repeat(place, count)
    return ReducedCloud(middle[rank], lowest[rank], count[rank].astype(np.int64), cell)


def rounding_variance(step_m: float, noise_m: float) -> float:
    """Variance, m², of what rounding to a grid leaves in the mean of many points with the scatter
    ``noise_m`` after rounding.

    Noise that is wide against the step makes the errors of rounding independent, and they average
    out; a quiet surface along the grid moves as a whole, by up to half a step, and its scatter does
    not show it. With the mean of rounded normal numbers as a Fourier series over the place between
    two multiples of the step (Sheppard's corrections), its mean square over all places is ``step² /
    (2 π²) Σ exp(−4 π² k² s² / step²) / k²`` for the scatter s before rounding. Below 0.3 steps the
    scatter after rounding hides part of s: the answer is then up to 2.3 times too large.
    """
    if step_m == 0.0:
        return 0.0
    k = np.arange(1, 200)
    before = max(noise_m**2 - step_m**2 / 12, 0.0) / step_m**2
    return float(step_m**2 / (2 * np.pi**2) * np.sum(np.exp(-4 * np.pi**2 * k**2 * before) / k**2))


def expand_result(result: CloudResult, before: ReducedCloud, rounded_m: float) -> CloudResult:
    """The result of a filter on ``before.r`` in terms of the points that were reduced: who stood
    behind an outlier is one too.

    rounded_m : step to which the points were rounded, 0 for means; sigmas grow by what the filter
    could not see of it.
    """
    reason = np.zeros(len(before.r), np.int64)
    reason[result.outliers] = result.reason
    all_reasons = reason[before.cell]
    outliers = np.flatnonzero(all_reasons)
    report = {**result.report, "points": len(before.cell), "points_reduced": len(before.r)}
    report |= {name: int(np.count_nonzero(all_reasons == i)) for i, name in enumerate(REASONS) if i}
    sigma = np.sqrt(result.sigma**2 + rounding_variance(rounded_m, float(result.report["noise_m"])))
    index, count = before.index[result.index], before.count[result.index]
    return CloudResult(
        result.r,
        index,
        result.normal,
        sigma,
        outliers,
        all_reasons[outliers],
        report,
        count,
        flag=result.flag,
        verdict=result.verdict,
    )


def merge_results(result: CloudResult, step_m: float, how: str) -> CloudResult:
    """Filtered points reduced to one per cell. ``index`` stays one whose cell it is, ``count`` adds
    up.

    Neighbours share the raw points of their fits, so a mean is not surer than its points: its sigma
    is their mean. Rounding adds the variance step² / 12 in every direction.
    """
    if step_m == 0.0 or len(result.r) == 0:
        return result
    cells = reduce_points(result.r, step_m, how)
    first = cells.index
    count = np.ones(len(result.r), np.int64) if result.count is None else result.count
    # normals have no side: all of a cell are turned to that of its first point before they are
    # added
    sign = np.sign(np.einsum("ni,ni->n", result.normal, result.normal[first[cells.cell]]))
    normal, sigma, total = (
        np.zeros((len(first), 3)),
        np.zeros(len(first)),
        np.zeros(len(first), np.int64),
    )
    np.add.at(normal, cells.cell, np.where(sign == 0.0, 1.0, sign)[:, None] * result.normal)
    np.add.at(sigma, cells.cell, result.sigma)
    np.add.at(total, cells.cell, count)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    sigma /= cells.count
    if how == "round":
        sigma = np.sqrt(sigma**2 + step_m**2 / 12)
    report = {**result.report, "kept_merged": len(first)}
    return CloudResult(
        cells.r,
        result.index[first],
        normal,
        sigma,
        result.outliers,
        result.reason,
        report,
        total,
        flag=None if result.flag is None else result.flag[first],
        verdict=result.verdict,
    )
