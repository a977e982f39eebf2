"""The hull of all points.

A side of the hull of some points is one of the hull of all where no corner of the latter lies
beyond it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ladar_volume.math.kernels import kernel
from ladar_volume.model.records import F64, I64, Bool
from ladar_volume.tin.predicates import orientation, workspace


def hull_of_places(xy: F64) -> F64:
    """Corners (h, 2) of the convex hull of distinct places (k, 2) by x, then y, counter-clockwise;
    both ends of what lies on one line.
    """
    xy = np.ascontiguousarray(xy)
    return xy[hull_kernel(xy, workspace())]


@kernel
def hull_kernel(xy: F64, w: F64) -> I64:
    """Rows of the corners of the hull of places (k, 2), by two chains (Andrew 1979), exactly."""
    n = len(xy)
    out = np.empty(2 * n + 1, np.int64)
    top, floor = 0, 1
    for step in range(2 * n - 1):
        k = step if step < n else 2 * n - 2 - step
        if step == n:
            floor = top
        while top > floor:
            a, b = xy[out[top - 2]], xy[out[top - 1]]
            if orientation(a[0], a[1], b[0], b[1], xy[k, 0], xy[k, 1], w) > 0.0:
                break
            top -= 1
        out[top] = k
        top += 1
    return out[: max(top - 1, min(n, 1))]


def joined_hull(hulls: Sequence[F64]) -> F64:
    """Corners (h, 2) of the hull of all, from those of parts."""
    return hull_of_places(np.unique(np.concatenate(hulls), axis=0))


def off_hull(ends: F64, hull: F64) -> Bool:
    """Which of sides (e, 2, 2), the surface to their left, have corners (h, 2) of the hull of all
    points beyond them.
    """
    return np.asarray(beyond_kernel(np.ascontiguousarray(ends), hull, workspace()))


@kernel
def beyond_kernel(ends: F64, hull: F64, w: F64) -> Bool:
    """See :func:`off_hull`."""
    out = np.zeros(len(ends), np.bool_)
    for e in range(len(ends)):
        ax, ay, bx, by = ends[e, 0, 0], ends[e, 0, 1], ends[e, 1, 0], ends[e, 1, 1]
        for h in range(len(hull)):
            if orientation(ax, ay, bx, by, hull[h, 0], hull[h, 1], w) < 0.0:
                out[e] = True
                break
    return out
