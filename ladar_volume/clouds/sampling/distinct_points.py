"""Points that a cloud holds more than once: they count once, and all stand in the answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ladar_volume.clouds.filter.filter_result import FLAGS, REASONS, CloudResult
from ladar_volume.clouds.filter.point_reduction import ReducedCloud
from ladar_volume.math.equal_rows import first_equal
from ladar_volume.math.space_curve import curve_order
from ladar_volume.model.records import F64

SPARSE = FLAGS.index("sparse")


def distinct_rows(r: F64) -> ReducedCloud:
    """Points (n, 3) without those that are equal in every coordinate to one before them, along a
    curve through space: what is done with them then finds neighbours in the cache.
    """
    order = curve_order(r)
    along = r[order]
    first = first_equal(along)
    cell = np.empty(len(r), np.int64)
    rows = np.flatnonzero(first == np.arange(len(r)))
    if len(rows) == len(r):
        cell[order] = rows
        return ReducedCloud(along, order.astype(np.int64), np.ones(len(r), np.int64), cell)
    place = np.zeros(len(r), np.int64)
    place[rows] = np.arange(len(rows))
    cell[order] = place[first]
    count = np.bincount(cell, minlength=len(rows))
    return ReducedCloud(along[rows], order[rows].astype(np.int64), count.astype(np.int64), cell)


def restore_copies(result: CloudResult, once: ReducedCloud) -> CloudResult:
    """The result of a filter on ``once.r`` for all points that stand behind it, in their order:
    copies get the answer of the point they repeat, and their number.
    """
    copied = len(once.r) < len(once.cell)
    reason, row = np.zeros(len(once.r), np.int64), np.full(len(once.r), -1)
    reason[result.outliers] = result.reason
    row[result.index] = np.arange(len(result.index))
    index = np.flatnonzero(row[once.cell] >= 0)
    outliers = np.flatnonzero(row[once.cell] < 0)
    of = row[once.cell[index]]
    reasons = reason[once.cell[outliers]]
    report = {**result.report, "points": len(once.cell), "kept": len(index)}
    report |= {"distinct_points": len(once.r)} if copied else {}
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
        copies=once.count[once.cell[index]] if copied else None,
    )
