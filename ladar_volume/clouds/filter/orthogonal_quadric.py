"""A quadric by orthogonal least squares: distances along the local normal, design rows at the foot
points.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ladar_volume.clouds.filter.cell_records import Quadric
from ladar_volume.math.array_types import F64
from ladar_volume.math.kernels import inlined, kernel, leaf_kernel
from ladar_volume.math.normal_equations import basis, invert
from ladar_volume.rmls.tangent_frame import (
    Frame,
    Near,
    RefitRule,
    Terms,
    arc_height,
    frame_coordinates,
    level_frame,
    mark_flat,
    move_to_surface,
    refit,
    second_tangent,
)
from ladar_volume.rmls.thinning_weights import unthinned

#: Re-levellings of a quadric's frame.
LEVELS = 3
#: Most steps of an orthogonal fit in one frame: on a surface that is a quadric two suffice.
STEPS = 3
#: Most reductions of what counts as an inlier.
SHRINKS = 24
#: Mean square over sigma² from which the inliers are no surface's: they fill the slab, which gives
#: 3.
LOST = 2.0
#: Most steps of a point towards its foot, and the change, as a share of its distance, below which
#: it has found it.
FEET, FOUND = 4, 3e-3


class QuadricRule(NamedTuple):
    """ball : radius of the neighbourhood, m · sigma : noise, m · threshold : of an inlier, m ·
    iterations : most refits
    """

    ball: float
    sigma: float
    threshold: float
    iterations: int


@kernel
def _step(inverse: F64, b: F64, unit: F64, beta: F64) -> Any:
    """Move ``beta`` (6,) by the solution of the normal equations; returns the largest change, m."""
    shift = 0.0
    for k in range(6):
        step = 0.0
        for l in range(6):
            step += inverse[k, l] * b[l]
        shift = max(shift, abs(step))
        beta[k] += step * unit[k]
    return shift


@kernel
def geometric_refit(
    near: F64,
    m: int,
    ball: float,
    threshold: float,
    iterations: int,
    sigma: float,
    beta: F64,
    inverse: F64,
) -> Any:
    """Orthogonal least squares of a quadric from a start: distances along the local normal, design
    rows at the foot points.

    A fit of heights over the points' own u and v is biased on a curved surface: noise moves a point
    across the slope and along the surface at once (errors in variables). Rows at the foot points do
    not depend on the noise. near (4, m): u / ball, v / ball, w. ``inverse`` comes back as ``(Σ x xᵀ
    / (1 + slope²))⁻¹``. Returns (number of inliers, their mean square), 0 where undetermined.
    """
    A, b = np.zeros((6, 6)), np.zeros(6)
    reach = ball * max(1.0 - threshold / ball, 0.5)
    unit = np.ones(6)
    unit[1] = unit[2] = 1.0 / ball
    unit[3] = unit[4] = unit[5] = 1.0 / (ball * ball)
    used, square = 0, 0.0
    for _ in range(iterations):
        used, square = normal_equations(near, m, ball, threshold, reach, beta, A, b)
        if used <= 8:
            return 0, 0.0
        if not invert(A, 6, inverse):
            return 0, 0.0
        shift = _step(inverse, b, unit, beta)
        if shift < 1e-3 * sigma:
            break
    for k in range(6):
        for l in range(6):
            inverse[k, l] *= unit[k] * unit[l]
    return used, square / used


@kernel
def normal_equations(
    near: F64, m: int, ball: float, threshold: float, reach: float, beta: F64, A: F64, b: F64
) -> Any:
    """``A = Σ x xᵀ / (1 + slope²)`` and ``b = Σ x d / √(1 + slope²)`` of the points within
    threshold and reach of the surface, x in units of the ball; returns (their number, sum of
    squared distances).
    """
    x, used, square = np.zeros(6), 0, 0.0
    A[:] = 0.0
    b[:] = 0.0
    for i in range(m):
        u, v, w = near[0, i] * ball, near[1, i] * ball, near[2, i]
        fu, fv, fw, gu, gv, d = foot_in_frame(u, v, w, beta)
        if abs(d) > threshold or fu * fu + fv * fv + fw * fw > reach * reach:
            continue
        used += 1
        square += d * d
        weight = 1.0 / (1.0 + gu * gu + gv * gv)
        along = d * np.sqrt(weight)
        basis(fu / ball, fv / ball, 6, x)
        for k in range(6):
            b[k] += x[k] * along
            weighted = x[k] * weight
            for l in range(k + 1):
                A[k, l] += weighted * x[l]
    for k in range(6):
        for l in range(k):
            A[l, k] = A[k, l]
    return used, square


@leaf_kernel
def foot_in_frame(u: float, v: float, w: float, beta: F64) -> Any:
    """(u, v, w of the foot point, slopes there, signed distance) of a point in a quadric's
    frame.
    """
    fu, fv, gu, gv = u, v, 0.0, 0.0
    height, along = 0.0, 0.0
    for _ in range(FEET):  # the foot moves down the slope by what the distance says there
        height, gu, gv = height_at(fu, fv, beta)
        before, along = (
            along,
            (w - height + gu * (fu - u) + gv * (fv - v)) / (1.0 + gu * gu + gv * gv),
        )
        fu, fv = u + along * gu, v + along * gv
        if abs(along - before) <= FOUND * abs(along):
            break
    height, gu, gv = height_at(fu, fv, beta)
    return fu, fv, height, gu, gv, along * np.sqrt(1.0 + gu * gu + gv * gv)


@leaf_kernel
def height_at(u: float, v: float, beta: F64) -> Any:
    """(height, slope along u, slope along v) of a quadric with its arc term."""
    extra, gu, gv = arc_height(u, v, beta[3], beta[4], beta[5])
    height = (
        beta[0]
        + u * beta[1]
        + v * beta[2]
        + u * u * beta[3]
        + u * v * beta[4]
        + v * v * beta[5]
        + extra
    )
    return height, beta[1] + gu, beta[2] + gv


@inlined
def quadric_from(
    pts: F64,
    n: int,
    origin: F64,
    start: F64,
    start_m: float,
    rule: QuadricRule,
    levels: int,
    quadric: Quadric,
) -> Any:
    """A quadric grown from a start plane over the ball; its frame touches it at the centre. Returns
    the number of inliers.

    ``start_m``: how far the points may lie from the start plane; what counts as an inlier shrinks
    from there to the threshold, as fast as the quadric explains the points, so that a surface may
    bend by more than the threshold within the neighbourhood.
    """
    centre, normal, tangent, beta, inverse = quadric
    near, index, inside = np.empty((4, n)), np.empty(n, np.int64), np.empty(n, np.bool_)
    plane, frame = start.copy(), Frame(centre, normal, tangent)
    plane[3] += plane[0] * origin[0] + plane[1] * origin[1] + plane[2] * origin[2]
    start_m = max(start_m, rule.threshold)
    few = min(rule.iterations, STEPS)  # a start; the fixed point is sought with right distances
    refitting, hood = RefitRule(rule.ball, 0.0, start_m, few), Near(near, index, inside)
    if level_frame(pts, n, origin, plane, rule.sigma, refitting, hood, frame) < 0.0:
        return 0
    m = frame_coordinates(pts, n, centre, normal, tangent, rule.ball, near, index)
    mark_flat(near, m, start_m, inside)
    used, _ = refit(hood, m, 6, rule.sigma, refitting, unthinned(m), Terms(beta, inverse))
    if used == 0:
        return 0
    return shrink_to_threshold(pts, n, start_m, rule, levels, quadric)


@kernel
def _touch(quadric: Quadric) -> None:
    """Turn a quadric's frame so that it touches it at the centre."""
    centre, normal, tangent, beta, _ = quadric
    move_to_surface(centre, normal, tangent, beta)
    # the old tangent leaned into the new plane: the quadratic terms belong to these axes
    along = tangent[0] * normal[0] + tangent[1] * normal[1] + tangent[2] * normal[2]
    length = np.sqrt(1.0 - along * along)
    for k in range(3):
        tangent[k] = (tangent[k] - along * normal[k]) / length
    beta[0], beta[1], beta[2] = 0.0, 0.0, 0.0


@kernel
def shrink_to_threshold(
    pts: F64, n: int, start_m: float, rule: QuadricRule, levels: int, quadric: Quadric
) -> Any:
    """A quadric refitted to the points around it until ``start_m`` is the threshold and its frame
    touches it, ``levels`` frames at most; returns the number of inliers, 0 where it gets lost.
    """
    centre, normal, tangent, beta, inverse = quadric
    ball, sigma, threshold = rule.ball, rule.sigma, rule.threshold
    near, index, used = np.empty((4, n)), np.empty(n, np.int64), 0
    for level in range(levels + SHRINKS):
        m = frame_coordinates(pts, n, centre, normal, tangent, ball, near, index)
        used, square = geometric_refit(
            near, m, ball, start_m, min(rule.iterations, STEPS), sigma, beta, inverse
        )
        if used == 0 or (start_m == threshold and square > LOST * sigma * sigma):
            return 0
        level_now = abs(beta[1]) + abs(beta[2]) + abs(beta[0]) / ball <= 1e-3
        if start_m == threshold and (level_now or level + 1 >= levels):
            break
        start_m = max(threshold, min(0.5 * start_m, 3.0 * np.sqrt(square)))
        _touch(quadric)
    return used if start_m == threshold else 0


@kernel
def foot_on_quadric(x: F64, quadric: Quadric, side: F64, q: F64, n_out: F64) -> Any:
    """Foot point q and normal of the surface under x; returns (distance, variance of the surface
    there over sigma²). side : (3,) the frame's second axis in the tangent plane
    """
    centre, normal, tangent, beta, inverse = quadric
    u = v = w = 0.0
    for k in range(3):
        d = x[k] - centre[k]
        u += d * tangent[k]
        v += d * side[k]
        w += d * normal[k]
    fu, fv, fw, gu, gv, _ = foot_in_frame(u, v, w, beta)
    slope = np.sqrt(1.0 + gu * gu + gv * gv)
    row = np.empty(6)
    row[0], row[1], row[2], row[3], row[4], row[5] = 1.0, fu, fv, fu * fu, fu * fv, fv * fv
    variance = 0.0
    for e in range(6):
        for f in range(6):
            variance += row[e] * inverse[e, f] * row[f]
    square = 0.0
    for k in range(3):
        q[k] = centre[k] + fu * tangent[k] + fv * side[k] + fw * normal[k]
        n_out[k] = (normal[k] - gu * tangent[k] - gv * side[k]) / slope
        square += (x[k] - q[k]) ** 2
    return np.sqrt(square), variance / (slope * slope)


@kernel
def quadric_cost(x: F64, m: int, origin: F64, quadric: Quadric, limit: float) -> Any:
    """Sum of squared distances of points (m, 3) about ``origin``, each at most ``limit``; and how
    many are below it.
    """
    centre, normal, tangent, beta, _ = quadric
    side, cost, below = np.empty(3), 0.0, 0
    second_tangent(normal, tangent, side)
    for i in range(m):
        u = v = w = 0.0
        for k in range(3):
            d = x[i, k] + origin[k] - centre[k]
            u += d * tangent[k]
            v += d * side[k]
            w += d * normal[k]
        d = foot_in_frame(u, v, w, beta)[5]
        cost += min(d * d, limit)
        below += d * d < limit
    return cost, below
