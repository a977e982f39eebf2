"""One surface for a neighbourhood: the plane or quadric that needs no company, if there is one."""

from __future__ import annotations

from typing import Any

import numpy as np

from ladar_volume.clouds.filter import sharp_planes
from ladar_volume.clouds.filter.cell_records import Cell, CellRule, Pieces, Quadric
from ladar_volume.clouds.filter.orthogonal_quadric import (
    LEVELS,
    QuadricRule,
    quadric_cost,
    quadric_from,
    shrink_to_threshold,
)
from ladar_volume.math.array_types import F64, I64
from ladar_volume.math.hashing import mix_bits
from ladar_volume.math.kernels import inlined, kernel, leaf_kernel
from ladar_volume.math.normal_equations import basis, invert
from ladar_volume.rmls.patch_fit import StartRule, start_plane
from ladar_volume.rmls.tangent_frame import second_tangent, tangent_of

#: A bent surface is sought from a plane over the ball's radius over this, the best of so many.
BENT, TRIALS = 3.0, 60
#: A quadric's centre is its own, not the cell's: it is fitted to points within the ball's radius
#: times this.
WIDE = 1.5
#: Points that tell whether a quadric is worth a fit to all.
SCREEN = 150
#: Points about its start plane that it grows from.
FROM = 50
#: Mean square over sigma² of the points that a quadric explains from which it is no surface: in
#: leaves they fill the slab, which gives 3; the noise may be a third larger than believed. Few
#: points scatter by this over the root of their number.
HOPELESS, SCATTER = 2.0, 5.0
#: Most refits of a plane.
STEADY = 6
#: Share of the points that one surface must explain, with no more than the noise left, to need no
#: further search.
EXPLAINS = 0.85


@leaf_kernel
def nearest_to_origin(planes: F64, count: int) -> Any:
    """The plane that passes the origin most closely."""
    best = 0
    for a in range(count):
        if abs(planes[a, 3]) < abs(planes[best, 3]):
            best = a
    return best


@inlined
def least_median_plane(x: F64, m: int, reach: float, key: int, plane: F64) -> Any:
    """Least median of squares plane of the points (m, 3) within ``reach`` of the origin; returns
    its robust sigma, −1 for none.
    """
    near, work, n = np.empty((3, m)), np.empty(m), 0
    for i in range(m):
        if x[i, 0] ** 2 + x[i, 1] ** 2 + x[i, 2] ** 2 <= reach * reach:
            near[:, n] = x[i]
            n += 1
    return (
        start_plane(
            near, n, StartRule(3, TRIALS, False, 0.0), mix_bits(np.uint64(key)), plane, work
        )
        if n > 8
        else -1.0
    )


@kernel
def curvature_gain(x: F64, m: int, label: I64, plane: F64, mean: F64, ball: float) -> Any:
    """By how much quadratic terms would lower the squares of the points labelled 0 about their
    plane.
    """
    A, inverted, b, row = np.zeros((6, 6)), np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    tangent, side = np.empty(3), np.empty(3)
    tangent_of(plane[:3], tangent)
    second_tangent(plane[:3], tangent, side)
    for i in range(m):
        if label[i] == 0:
            u = v = 0.0
            for k in range(3):
                u += (x[i, k] - mean[k]) * tangent[k] / ball
                v += (x[i, k] - mean[k]) * side[k] / ball
            basis(u, v, 6, row)
            d = sharp_planes.distance(x[i], plane)
            for k in range(6):
                b[k] += row[k] * d
                for l in range(k + 1):
                    A[k, l] += row[k] * row[l]
    for k in range(6):
        for l in range(k):
            A[l, k] = A[k, l]
    gain = 0.0
    if invert(A, 6, inverted):
        for k in range(6):
            for l in range(6):
                gain += b[k] * inverted[k, l] * b[l]
    return gain


@inlined
def fit_single_plane(cell: Cell, ball: float, price: float, pieces: Pieces) -> Any:
    """Whether one plane describes the points (m, 3): it explains most of them, leaves no more than
    the noise, and quadratic terms would lower its squares by less than their price. Refits
    the first of the planes; returns (1 or 0, number of its points, sum of truncated squares).
    """
    x, m, sigma, threshold = cell.x, cell.m, cell.sigma, cell.threshold
    plane, mean, inverse = pieces.planes[0], pieces.means[0], pieces.inverses[0]
    label = pieces.label
    used, near, square = 0, -1, 0.0
    for _ in range(STEADY):
        count, square = 0, 0.0
        for i in range(m):
            d = sharp_planes.distance(x[i], plane)
            label[i] = 0 if abs(d) <= threshold else -1
            count += label[i] == 0
            square += d * d if label[i] == 0 else 0.0
        if count == near:
            break
        near = count
        used = sharp_planes.fit_plane(x, m, label, 0, plane, mean, inverse)
        if used < EXPLAINS * m:
            return 0, used, 0.0
    if square > used * sigma * sigma * (1.0 + 2.0 / np.sqrt(used)):
        return 0, used, 0.0
    gain = curvature_gain(x, m, label, plane, mean, ball)
    return np.int64(gain < price), used, square + (m - used) * threshold * threshold


@kernel
def points_within(r: F64, slots: I64, n: int, origin: F64, reach: float) -> Any:
    """The gathered points within ``reach`` of the origin (n, 3), and how many."""
    pts, m = np.empty((n, 3)), 0
    for i in range(n):
        square = 0.0
        for k in range(3):
            pts[m, k] = r[slots[i], k]
            square += (pts[m, k] - origin[k]) ** 2
        m += square <= reach * reach
    return pts, m


@leaf_kernel
def count_near_plane(pts: F64, n: int, origin: F64, plane: F64, width: float) -> Any:
    """How many of the points (n, 3) lie within ``width`` of a plane about ``origin``."""
    offset = plane[3] + plane[0] * origin[0] + plane[1] * origin[1] + plane[2] * origin[2]
    near = 0
    for i in range(n):
        near += (
            abs(plane[0] * pts[i, 0] + plane[1] * pts[i, 1] + plane[2] * pts[i, 2] - offset)
            <= width
        )
    return near


@kernel
def _start(cell: Cell, key: int, candidates: F64, rule: CellRule, start: F64) -> Any:
    """The plane a quadric grows from; returns (robust sigma about it, negative where there is none;
    how many points must lie on the quadric).

    No candidate is a plane within the threshold: a surface that bends by more than its noise, or
    none; half of the points must say so.
    """
    if len(candidates) > 0:
        start[:] = candidates[nearest_to_origin(candidates, len(candidates))]
        return 0.0, rule.least
    return least_median_plane(cell.x, cell.m, rule.ball / BENT, key, start), cell.m // 2


@kernel
def _too_few_on_quadric(cell: Cell, inliers: int, quadric: Quadric) -> Any:
    """Whether a few of the points say that a quadric with so many inliers is no surface: most
    neighbourhoods that are not flat are sharp or clutter.
    """
    every, limit = max(cell.m // SCREEN, 1), cell.threshold * cell.threshold
    some = (cell.m + every - 1) // every
    cost, near = quadric_cost(cell.x[: cell.m : every], some, cell.origin, quadric, limit)
    return (
        inliers < 8
        or 2 * near < some
        or cost - (some - near) * cell.threshold * cell.threshold
        > HOPELESS * near * cell.sigma * cell.sigma
    )


@kernel
def _quadric_cost(cell: Cell, quadric: Quadric) -> Any:
    """Cost of a quadric and how many planes may compete with it, as :func:`fit_curved_quadric`."""
    m, sigma, threshold = cell.m, cell.sigma, cell.threshold
    cost, near = quadric_cost(cell.x, m, cell.origin, quadric, threshold * threshold)
    leaves = (cost - (m - near) * threshold * threshold) / (max(near, 1) * sigma * sigma)
    if near < m // 2 or leaves > max(HOPELESS, 1.0 + SCATTER / np.sqrt(near)):
        return np.inf, sharp_planes.MOST
    alone = near > EXPLAINS * m and leaves < 1.0 + 2.0 / np.sqrt(near)
    return cost, 0 if alone else sharp_planes.MOST


@inlined
def fit_curved_quadric(
    cell: Cell, r: F64, key: int, candidates: F64, rule: CellRule, quadric: Quadric
) -> Any:
    """A ``quadric`` for the cell with this ``key`` among points r (n, 3), to the arrays given.
    Returns (its sum of truncated squares, infinite for none; how many planes may compete with it):
    where it leaves no more than the noise, none: several planes, which cost no less than it, have
    nothing to gain.
    """
    start, origin, threshold = np.empty(4), cell.origin, cell.threshold
    loose, most = _start(cell, key, candidates, rule, start)
    if loose < 0.0:
        return np.inf, sharp_planes.MOST
    pts, n = points_within(r, cell.slots, len(cell.slots), origin, WIDE * rule.ball)
    close = count_near_plane(pts, n, origin, start, max(3.0 * loose, threshold))
    thin = max(min(n // SCREEN, close // FROM), 1)
    few = (n + thin - 1) // thin
    levels = LEVELS if thin == 1 else 1  # the fit to all points levels the frame
    fit = QuadricRule(rule.ball, cell.sigma, threshold, rule.iterations)
    inliers = quadric_from(pts[:n:thin], few, origin, start, 3.0 * loose, fit, levels, quadric)
    if thin > 1:
        if _too_few_on_quadric(cell, inliers, quadric):
            return np.inf, sharp_planes.MOST
        inliers = shrink_to_threshold(pts, n, threshold, fit, LEVELS, quadric)
    if inliers < max(most, 8):
        return np.inf, sharp_planes.MOST
    return _quadric_cost(cell, quadric)
