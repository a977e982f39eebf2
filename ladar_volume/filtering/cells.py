"""One pass over a whole cloud: every cell finds its surface, one quadric or several planes, and projects its own points.

The choice is by the Bayesian information criterion on residuals cut off at the outlier threshold: a quadric costs six
parameters, a plane three. All residuals are distances to the surface along its normal.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from ladar_volume.filtering import choice, pieces
from ladar_volume.filtering.fit import REACH
from ladar_volume.filtering.frame import across, arc, coordinates, level_frame, mark_flat, refit, tangent_of
from ladar_volume.filtering.linear import basis, invert
from ladar_volume.filtering.store import BITS, _mix, find_voxel
from ladar_volume.model.kernels import kernel, parallel_kernel

KEPT, OUTLIER, FEW_POINTS, NO_SURFACE, BEYOND_EDGE, UNSUPPORTED = 0, 1, 2, 3, 4, 5
#: Planes each cell finds for itself and its neighbours.
OFFERED = 3
#: What lies within this many sigma of a plane found is not searched for the next one.
EXPLAINED = 2.02
#: Support of a projected point: this many points within the radius that holds PATCH of them on a full surface.
SUPPORT, PATCH = 4, 20
#: Re-levelling of a quadric's frame.
LEVELS = 3


@kernel
def gather(v: Any, keys: Any, table: Any, first: Any, r: Any, out: Any) -> Any:
    """Indices of all points (sorted by voxel) in the voxels around voxel v; returns how many. With an empty ``out`` only counts."""
    key, mask = keys[v], (1 << BITS) - 1
    i0, j0, k0 = key >> (2 * BITS), (key >> BITS) & mask, key & mask
    n = 0
    for di in range(-REACH, REACH + 1):
        for dj in range(-REACH, REACH + 1):
            for dk in range(-REACH, REACH + 1):
                w = find_voxel(table, keys, ((i0 + di) << (2 * BITS)) | ((j0 + dj) << BITS) | (k0 + dk))
                if w >= 0:
                    for i in range(first[w], first[w + 1]):
                        if len(out):
                            out[n] = i
                        n += 1
    return n


@kernel
def geometric_refit(near: Any, m: Any, ball: Any, threshold: Any, iterations: Any, sigma: Any, beta: Any, inverse: Any) -> Any:
    """Orthogonal least squares of a quadric from a start: distances along the local normal, design rows at the foot points.

    A fit of heights over the points' own u and v is biased on a curved surface: noise moves a point across the slope and along
    the surface at once (errors in variables). Rows at the foot points do not depend on the noise. near (4, m): u / ball,
    v / ball, w. ``inverse`` comes back as ``(Σ x xᵀ / (1 + slope²))⁻¹``. Returns the number of inliers, 0 where undetermined.
    """
    A, b, x = np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    reach = ball * max(1.0 - threshold / ball, 0.5)
    unit = np.ones(6)
    unit[1] = unit[2] = 1.0 / ball
    unit[3] = unit[4] = unit[5] = 1.0 / (ball * ball)
    used = 0
    for _ in range(iterations):
        A[:] = 0.0
        b[:] = 0.0
        used = 0
        for i in range(m):
            u, v, w = near[0, i] * ball, near[1, i] * ball, near[2, i]
            fu, fv, fw, gu, gv, d = foot_in_frame(u, v, w, beta)
            if abs(d) > threshold or fu * fu + fv * fv + fw * fw > reach * reach:
                continue
            used += 1
            slope = 1.0 + gu * gu + gv * gv
            basis(fu / ball, fv / ball, 6, x)
            for k in range(6):
                b[k] += x[k] * d / np.sqrt(slope)
                for l in range(k + 1):
                    A[k, l] += x[k] * x[l] / slope
        if used <= 8:
            return 0
        for k in range(6):
            for l in range(k):
                A[l, k] = A[k, l]
        if not invert(A, 6, inverse):
            return 0
        shift = 0.0
        for k in range(6):
            step = 0.0
            for l in range(6):
                step += inverse[k, l] * b[l]
            shift = max(shift, abs(step))
            beta[k] += step * unit[k]
        if shift < 1e-3 * sigma:
            break
    for k in range(6):
        for l in range(6):
            inverse[k, l] *= unit[k] * unit[l]
    return used


@kernel
def foot_in_frame(u: Any, v: Any, w: Any, beta: Any) -> Any:
    """(u, v, w of the foot point, slopes there, signed distance) of a point in a quadric's frame."""
    fu, fv, gu, gv = u, v, 0.0, 0.0
    height, along = 0.0, 0.0
    for _ in range(4):  # the foot moves down the slope by what the distance says there
        height, gu, gv = height_at(fu, fv, beta)
        along = (w - height + gu * (fu - u) + gv * (fv - v)) / (1.0 + gu * gu + gv * gv)
        fu, fv = u + along * gu, v + along * gv
    height, gu, gv = height_at(fu, fv, beta)
    return fu, fv, height, gu, gv, along * np.sqrt(1.0 + gu * gu + gv * gv)


@kernel
def height_at(u: Any, v: Any, beta: Any) -> Any:
    """(height, slope along u, slope along v) of a quadric with its arc term."""
    extra, gu, gv = arc(u, v, beta[3], beta[4], beta[5])
    height = beta[0] + u * beta[1] + v * beta[2] + u * u * beta[3] + u * v * beta[4] + v * v * beta[5] + extra
    return height, beta[1] + gu, beta[2] + gv


@kernel
def quadric_from(
    pts: Any, n: Any, origin: Any, start: Any, ball: Any, sigma: Any, threshold: Any, iterations: Any, centre: Any, normal: Any,
    tangent: Any, beta: Any, inverse: Any,
) -> Any:  # fmt: skip
    """A quadric grown from a start plane over the ball; its frame touches it at the centre. Returns the number of inliers."""
    near, index, inside = np.empty((4, n)), np.empty(n, np.int64), np.empty(n, np.bool_)
    plane = start.copy()
    plane[3] += plane[0] * origin[0] + plane[1] * origin[1] + plane[2] * origin[2]
    if level_frame(pts, n, origin, plane, sigma, ball, 0.0, threshold, iterations, near, index, inside, centre, normal, tangent) < 0.0:
        return 0
    used = 0
    side = np.empty(3)
    for level in range(LEVELS):
        m = coordinates(pts, n, centre, normal, tangent, ball, near, index)
        if level == 0:
            mark_flat(near, m, threshold, inside)
            used, _ = refit(near, m, ball, 6, sigma, 0.0, threshold, iterations, inside, beta, inverse)
            if used == 0:
                return 0
        used = geometric_refit(near, m, ball, threshold, iterations, sigma, beta, inverse)
        if used == 0:
            return 0
        if level + 1 < LEVELS and abs(beta[1]) + abs(beta[2]) + abs(beta[0]) / ball > 1e-3:
            across(normal, tangent, side)
            length = np.sqrt(1.0 + beta[1] * beta[1] + beta[2] * beta[2])
            for k in range(3):
                centre[k] += beta[0] * normal[k]
                normal[k] = (normal[k] - beta[1] * tangent[k] - beta[2] * side[k]) / length
            tangent_of(normal, tangent)
            beta[0], beta[1], beta[2] = 0.0, 0.0, 0.0
        else:
            break
    return used


@kernel
def foot_on_quadric(x: Any, centre: Any, normal: Any, tangent: Any, side: Any, beta: Any, inverse: Any, q: Any, n_out: Any) -> Any:
    """Foot point q and normal of the surface under x; returns (distance, variance of the surface there over sigma²)."""
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
def quadric_cost(x: Any, m: Any, origin: Any, centre: Any, normal: Any, tangent: Any, beta: Any, limit: Any) -> Any:
    """Sum of squared distances of points (m, 3) about ``origin``, each at most ``limit``."""
    side, cost = np.empty(3), 0.0
    across(normal, tangent, side)
    for i in range(m):
        u = v = w = 0.0
        for k in range(3):
            d = x[i, k] + origin[k] - centre[k]
            u += d * tangent[k]
            v += d * side[k]
            w += d * normal[k]
        d = foot_in_frame(u, v, w, beta)[5]
        cost += min(d * d, limit)
    return cost


@kernel
def around(r: Any, first: Any, v: Any, slots: Any, n: Any, ball: Any, origin: Any, x: Any) -> Any:
    """Mean of the cell's own points to origin (3,), and the gathered points within ``ball`` of it, about it, to x; returns how many."""
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
def supported(x: Any, m: Any, origin: Any, q: Any, square: Any) -> Any:
    """Whether enough points (m, 3) about ``origin`` lie around q: planes end nowhere, surfaces do."""
    near = 0
    for i in range(m):
        d = 0.0
        for k in range(3):
            d += (x[i, k] + origin[k] - q[k]) ** 2
        near += d <= square
        if near > SUPPORT:  # one of them is the projected point itself
            return True
    return False


@parallel_kernel
def main_planes(
    keys: Any, table: Any, first: Any, r: Any, ball: Any, sigma: Any, threshold: Any, trials: Any, least: Any, seed: Any, planes: Any,
    found: Any,
) -> None:  # fmt: skip
    """The planes that the points near each cell lie on, most points first, as ``n·x = o`` (v, OFFERED, 4) and their number (v,).

    Each is sought among what the former ones do not explain. They are what a cell and its neighbours have to choose from.
    """
    for v in numba.prange(len(keys)):
        empty = np.empty(0, np.int64)
        n = gather(v, keys, table, first, r, empty)
        slots, x, origin = np.empty(n, np.int64), np.empty((n + 1, 3)), np.empty(3)
        gather(v, keys, table, first, r, slots)
        m = around(r, first, v, slots, n, ball, origin, x)
        found[v] = 0
        state, label, mean, inverse = np.empty(1, np.uint64), np.full(m, -1), np.empty(3), np.empty((3, 3))
        state[0] = _mix(np.uint64(keys[v]) ^ _mix(np.uint64(seed)))
        free = np.arange(m)
        left = m
        for _ in range(OFFERED):
            plane = planes[v, found[v]]
            if left < least or pieces.best_plane(x, free, left, ball, pieces.SCORE_SIGMAS * sigma, trials, state, plane) <= 0.0:
                break
            used = 0
            for _ in range(3):
                label[:] = -1
                for i in range(left):
                    label[free[i]] = 0 if abs(pieces.distance(x[free[i]], plane)) <= threshold else -1
                used, _ = pieces.fit_plane(x, m, label, 0, plane, mean, inverse)
            if used < least:
                break
            rest = 0
            for i in range(left):
                if abs(pieces.distance(x[free[i]], plane)) > EXPLAINED * sigma:
                    free[rest] = free[i]
                    rest += 1
            left = rest
            plane[3] += plane[0] * origin[0] + plane[1] * origin[1] + plane[2] * origin[2]
            found[v] += 1


@kernel
def offers(v: Any, keys: Any, table: Any, planes: Any, found: Any, origin: Any, out: Any) -> Any:
    """Planes of the cells around cell v, about ``origin``; returns how many."""
    key, mask = keys[v], (1 << BITS) - 1
    i0, j0, k0 = key >> (2 * BITS), (key >> BITS) & mask, key & mask
    n = 0
    for di in range(-REACH, REACH + 1):
        for dj in range(-REACH, REACH + 1):
            for dk in range(-REACH, REACH + 1):
                w = find_voxel(table, keys, ((i0 + di) << (2 * BITS)) | ((j0 + dj) << BITS) | (k0 + dk))
                for a in range(found[w] if w >= 0 else 0):
                    out[n] = planes[w, a]
                    out[n, 3] -= out[n, 0] * origin[0] + out[n, 1] * origin[1] + out[n, 2] * origin[2]
                    n += 1
    return n


@kernel
def filter_cell(
    v: Any, keys: Any, table: Any, main: Any, found: Any, slots: Any, n: Any, r: Any, first: Any, ball: Any, degree: Any, sigma: Any,
    threshold: Any, least: Any, iterations: Any, snap: Any, q: Any, normals: Any, variance: Any, reason: Any,
) -> Any:  # fmt: skip
    """Surface of one cell, and its own points projected. Returns the number of planes, −1 for a quadric, 0 for none."""
    lo, hi = first[v], first[v + 1]
    origin, x = np.zeros(3), np.empty((n + 1, 3))
    m = around(r, first, v, slots, n, ball, origin, x)
    if m < least:
        reason[lo:hi] = FEW_POINTS
        return 0
    candidates = np.empty((OFFERED * (2 * REACH + 1) ** 3, 4))
    offered = offers(v, keys, table, main, found, origin, candidates)
    if offered == 0:
        reason[lo:hi] = NO_SURFACE
        return 0
    planes, means, inverses = np.zeros((pieces.MOST, 4)), np.zeros((pieces.MOST, 3)), np.zeros((pieces.MOST, 3, 3))
    used, label, side = np.zeros(pieces.MOST, np.int64), np.empty(m, np.int64), np.zeros((pieces.MOST, pieces.MOST), np.int64)
    count = choice.choose_planes(x, m, candidates, offered, sigma, threshold, least, planes, means, inverses, used, side, label)
    start = planes[0] if count > 0 else candidates[0]
    limit, used_here = threshold * threshold, np.empty(pieces.MOST, np.int64)
    best = limit * m
    if count > 0:
        best = choice.pieces_cost(x, m, planes, count, side, limit, sigma, used_here) + sigma * sigma * 3 * count * np.log(m)
    centre, normal, tangent, beta, inverse = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(6), np.zeros((6, 6))
    curved = False
    if degree == 2:
        pts = np.empty((n, 3))
        for i in range(n):
            pts[i] = r[slots[i]]
        inliers = quadric_from(pts, n, origin, start, ball, sigma, threshold, iterations, centre, normal, tangent, beta, inverse)
        if inliers >= max(least, 8):
            cost = quadric_cost(x, m, origin, centre, normal, tangent, beta, limit) + sigma * sigma * 6 * np.log(m)
            curved = cost < best
    if not curved and count == 0:
        reason[lo:hi] = NO_SURFACE
        return 0
    across_t, y, foot = np.empty(3), np.empty(3), np.empty(3)
    across(normal, tangent, across_t)
    reach = ball * ball * PATCH / m + 4.0 * sigma * sigma
    for i in range(lo, hi):
        on = 0
        if curved:
            d, share = foot_on_quadric(r[i], centre, normal, tangent, across_t, beta, inverse, q[i], normals[i])
        else:
            for k in range(3):
                y[k] = r[i, k] - origin[k]
            a, d, on = pieces.nearest_piece(y, planes, count, side, foot)
            share = 1.0 / used[a]
            for k in range(3):
                q[i, k] = foot[k] + origin[k]
                normals[i, k] = planes[a, k]
                for l in range(3):
                    share += (foot[k] - means[a, k]) * inverses[a, k, l] * (foot[l] - means[a, l])
        variance[i] = share * sigma * sigma
        if d > threshold:
            reason[i] = OUTLIER
        elif on > 0 and not snap:
            reason[i] = BEYOND_EDGE
        else:
            reason[i] = KEPT if supported(x, m, origin, q[i], reach) else UNSUPPORTED
    return -1 if curved else count


@parallel_kernel
def filter_cells(
    keys: Any, table: Any, first: Any, r: Any, main: Any, found: Any, ball: Any, degree: Any, sigma: Any, threshold: Any, least: Any,
    iterations: Any, snap: Any, q: Any, normals: Any, variance: Any, reason: Any, kind: Any,
) -> None:  # fmt: skip
    """All cells of points (n, 3) sorted by voxel; each writes only its own points."""
    for v in numba.prange(len(keys)):
        empty = np.empty(0, np.int64)
        n = gather(v, keys, table, first, r, empty)
        slots = np.empty(n, np.int64)
        gather(v, keys, table, first, r, slots)
        kind[v] = filter_cell(
            v, keys, table, main, found, slots, n, r, first, ball, degree, sigma, threshold, least, iterations, snap, q, normals,
            variance, reason,
        )  # fmt: skip
