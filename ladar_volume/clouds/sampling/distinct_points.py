"""Points that a cloud holds more than once: they count once, and all stand in the answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ladar_volume.clouds.filter.filter_result import FLAGS, REASONS, CloudResult
from ladar_volume.clouds.filter.noise_estimate import hashes
from ladar_volume.clouds.filter.point_reduction import ReducedCloud
from ladar_volume.model.records import F64

SPARSE = FLAGS.index("sparse")


def distinct_rows(r: F64) -> ReducedCloud:
    """Points (n, 3) without those that are equal in every coordinate to one before them."""
    n = len(r)
    mixed = np.zeros(n, np.uint64)
    for axis in range(3):
        mixed = hashes(mixed ^ (r[:, axis] + 0.0).view(np.uint64))  # + 0.0: one zero
    order = np.argsort(mixed, kind="stable")
    same = np.concatenate([[False], (r[order[1:]] == r[order[:-1]]).all(axis=1)])
    if not same.any():
        return ReducedCloud(r, np.arange(n), np.ones(n, np.int64), np.arange(n))
    group = np.cumsum(~same) - 1
    first = order[~same]
    rank = np.argsort(first)
    place = np.empty(len(first), np.int64)
    place[rank] = np.arange(len(first))
    cell = np.empty(n, np.int64)
    cell[order] = place[group]
    count = np.bincount(cell, minlength=len(first))
    return ReducedCloud(r[first[rank]], first[rank], count.astype(np.int64), cell)


def restore_copies(result: CloudResult, once: ReducedCloud) -> CloudResult:
    """The result of a filter on ``once.r`` for all points that stand behind it: copies get the
    answer of the point they repeat, and their number.
    """
    if len(once.r) == len(once.cell):
        return result
    reason, row = np.zeros(len(once.r), np.int64), np.full(len(once.r), -1)
    reason[result.outliers] = result.reason
    row[result.index] = np.arange(len(result.index))
    index = np.flatnonzero(row[once.cell] >= 0)
    outliers = np.flatnonzero(row[once.cell] < 0)
    of = row[once.cell[index]]
    reasons = reason[once.cell[outliers]]
    report = {
        **result.report,
        "points": len(once.cell),
        "distinct_points": len(once.r),
        "kept": len(index),
    }
    report |= {name: int(np.count_nonzero(reasons == i)) for i, name in enumerate(REASONS) if i}
    if result.flag is not None:
        report["sparse"] = int(np.count_nonzero(result.flag[of] == SPARSE))
    return replace(
        result,
        r=result.r[of],
        index=index,
        normal=result.normal[of],
        sigma=result.sigma[of],
        outliers=outliers,
        reason=reasons,
        report=report,
        noise=None if result.noise is None else result.noise[of],
        reach=None if result.reach is None else result.reach[of],
        curved=None if result.curved is None else result.curved[of],
        flag=None if result.flag is None else result.flag[of],
        copies=once.count[once.cell[index]],
    )
