"""Edges and corners as published (seed 002 section 4.2): up to three planes in one neighbourhood,
each in what the last left over.

Where the points off a plane are more than a share of the neighbourhood, they are fitted again. Two
planes meet in a line, three in a vertex; of each plane only the half with more of its points
counts. The source tells halves apart by octants of the map's axes; here they are the two sides of
the other plane, so any orientation works.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.clouds.filter.sharp_planes import distance, nearest_piece
from ladar_volume.clouds.published.published_records import (
    PLANES,
    Neighbourhood,
    PlaneSet,
    PublishedRule,
    Sampler,
    inlier_threshold,
    plane_set,
)
from ladar_volume.clouds.published.random_samples import plane_and_scatter, sampled_plane
from ladar_volume.math.array_types import F64, I64
from ladar_volume.math.kernels import inlined, kernel

#: Planes at less than this sine of their angle have no intersection that means anything.
PARALLEL = 0.1
#: Depth beyond an edge, m, that is still on it.
ON_EDGE = 1e-9


@inlined
def nearest_distance(x: F64, planes: F64, count: int) -> float:
    """Distance of a point (3,) to the nearest of the planes, without bounds."""
    best = np.inf
    for k in range(count):
        best = min(best, abs(distance(x, planes[k])))
    return best


@inlined
def label_by_plane(x: F64, m: int, planes: F64, count: int, threshold: float, label: I64) -> bool:
    """Label points (m, 3) with their nearest plane, −1 beyond the threshold of all; returns whether
    any label changed.
    """
    changed = False
    for i in range(m):
        own, best = -1, threshold
        for k in range(count):
            d = abs(distance(x[i], planes[k]))
            if d <= best:
                own, best = k, d
        changed |= label[i] != own
        label[i] = own
    return changed


@kernel
def refit_planes(
    x: F64,
    m: int,
    label: I64,
    planes: PlaneSet,
    count: int,
    sigma: float,
    adapt: bool,
    rule: PublishedRule,
) -> tuple[float, float]:
    """Label points (m, 3) and refit ``count`` planes until no label changes. Returns (sigma, −1
    where a plane lost its support; threshold).

    adapt : the threshold follows the scatter of the inliers, else it stays with the ``sigma``
    given.
    """
    label[:m] = -2
    threshold = inlier_threshold(sigma, rule)
    for _ in range(rule.iterations):
        if not label_by_plane(x, m, planes.plane, count, threshold, label):
            break
        square, free = 0.0, 0
        for k in range(count):
            used, s = plane_and_scatter(
                x, m, label, k, planes.plane[k], planes.mean[k], planes.inverse[k]
            )
            planes.used[k] = used
            if used < rule.min_points:
                return -1.0, threshold
            square += s * s * (used - 3)
            free += used - 3
        sigma = np.sqrt(square / free)
        if adapt:
            threshold = inlier_threshold(sigma, rule)
    return sigma, threshold


@inlined
def next_plane(
    x: F64, free: I64, left: int, rule: PublishedRule, sampler: Sampler, plane: F64
) -> tuple[float, int, int]:
    """A plane, refitted to a fixed point, among the points free[:left] of x (m, 3), which become
    those it leaves over.

    Returns (sigma, −1 for none; how many it leaves over; trials).
    """
    some, some_t, label = np.empty((left, 3)), np.empty((3, left)), np.empty(left, np.int64)
    for a in range(left):
        for k in range(3):
            some[a, k] = some_t[k, a] = x[free[a], k]
    one = plane_set(1)
    sigma, made = sampled_plane(some_t, left, rule.sampling, sampler, one.plane[0])
    if sigma < 0.0:
        return sigma, left, made
    # no adaption yet: across an edge the scatter would grow with the threshold, and the threshold
    # with it
    sigma, threshold = refit_planes(some, left, label, one, 1, sigma, False, rule)
    if sigma < 0.0:
        return sigma, left, made
    plane[:] = one.plane[0]
    rest = 0
    for a in range(left):
        if abs(distance(some[a], plane)) > threshold:
            free[rest] = free[a]
            rest += 1
    return sigma, rest, made


@inlined
def half_planes(x: F64, m: int, label: I64, planes: PlaneSet, count: int) -> None:
    """``planes.side``: on which side of each other plane more of a plane's points (m, 3) lie."""
    plane = planes.plane
    for a in range(count):
        for b in range(count):
            planes.side[a, b] = 0
            c = plane[a, 0] * plane[b, 0] + plane[a, 1] * plane[b, 1] + plane[a, 2] * plane[b, 2]
            if a == b or 1.0 - c * c < PARALLEL * PARALLEL:
                continue
            balance = 0
            for i in range(m):
                if label[i] == a:
                    balance += 1 if distance(x[i], plane[b]) > 0.0 else -1
            planes.side[a, b] = 1 if balance > 0 else -1 if balance < 0 else 0


@inlined
def start_planes(
    hood: Neighbourhood, m: int, rule: PublishedRule, start: F64
) -> tuple[int, float, int]:
    """Planes to start (3, 4), one after the other in what is left over, while the ratio of outliers
    asks for another. Returns (how many, sigma of the first, trials).
    """
    for i in range(m):
        hood.free[i] = i
    left, count, made, first_sigma = m, 0, 0, -1.0
    while count < PLANES and left >= rule.min_points and (count == 0 or left > rule.edge_ratio * m):
        sigma, rest, more = next_plane(hood.x, hood.free, left, rule, hood.sampler, start[count])
        made += more
        # a plane through scattered outliers is no facet: its points must pass the same ratio test
        if sigma < 0.0 or (count > 0 and left - rest <= rule.edge_ratio * m):
            break
        first_sigma = sigma if count == 0 else first_sigma
        count += 1
        left = rest
    return count, first_sigma, made


@kernel
def fit_planes(
    hood: Neighbourhood, m: int, rule: PublishedRule, planes: PlaneSet
) -> tuple[int, float, float, int]:
    """One plane, or two or three where the ratio of outliers says so, fitted together to a
    neighbourhood of m points, with their halves.

    Returns (number of planes, sigma, threshold, trials).
    """
    start, sigma, threshold = np.empty((PLANES, 4)), -1.0, -1.0
    count, first_sigma, made = start_planes(hood, m, rule, start)
    while count > 0:  # together; where one of them starves, without the last
        planes.plane[:count] = start[:count]
        sigma, threshold = refit_planes(
            hood.x, m, hood.label, planes, count, first_sigma, True, rule
        )
        if sigma >= 0.0:
            break
        count -= 1
    if count > 1:
        half_planes(hood.x, m, hood.label, planes, count)
    return count, sigma, threshold, made


@kernel
def foot_on_planes(
    x: F64, planes: PlaneSet, count: int, snap: bool, foot: F64
) -> tuple[int, float, bool]:
    """Where a point (3,) goes, to foot (3,). Returns (plane, distance, whether it is to be taken
    out as beyond an intersection).

    snap : to the nearest point of the half planes, which may lie on an edge or in a vertex. Else to
    the nearest plane, if the foot lies in its half.
    """
    plane, side = planes.plane, planes.side
    p, square, _ = nearest_piece(x, plane, count, side, foot)
    d = np.sqrt(square)
    if snap:
        return p, d, False
    p, best = 0, np.inf
    for k in range(count):
        if abs(distance(x, plane[k])) < best:
            p, best = k, abs(distance(x, plane[k]))
    height = distance(x, plane[p])
    for k in range(3):
        foot[k] = x[k] - height * plane[p, k]
    for b in range(count):
        if side[p, b] * distance(foot, plane[b]) < -ON_EDGE:
            return p, d, True
    return p, best, False
