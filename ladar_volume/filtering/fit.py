"""The robust fit of one patch (seed 002 Algorithm 1), as compiled kernels.

Random planes through few points, best median of residuals (LMedS) or best truncated squared residuals (weighted RANSAC,
MSAC) → tangent frame at the foot point → least-squares refit on its inliers, iterated to a fixed point. Residuals are
taken along the patch normal, never vertically, so that walls work as floors do.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ladar_volume.filtering.linear import basis, invert, select_kth
from ladar_volume.filtering.store import BITS, HALF, _mix, find_voxel
from ladar_volume.model.kernels import kernel

#: A patch looks at the voxels up to this many away; a ball of radius 2r about a centre in the voxel needs two.
REACH = 2
#: 1 / Phi^-1(3/4): the median of |normal residuals| to their standard deviation.
MAD = 1.4826
OK, FEW_POINTS, NO_PLANE, FEW_INLIERS, NOT_ON_PATCH = 0, 1, 2, 3, 4


@kernel
def gather(v: Any, keys: Any, table: Any, count: Any, hashes: Any, cap: Any, slots: Any) -> Any:
    """Slots of all points in the voxels around voxel v, in canonical order (voxel, then hash); returns how many."""
    key = keys[v]
    mask = (1 << BITS) - 1
    i0, j0, k0 = key >> (2 * BITS), (key >> BITS) & mask, key & mask
    n = 0
    for di in range(-REACH, REACH + 1):
        for dj in range(-REACH, REACH + 1):
            for dk in range(-REACH, REACH + 1):
                w = find_voxel(table, keys, ((i0 + di) << (2 * BITS)) | ((j0 + dj) << BITS) | (k0 + dk))
                if w < 0:
                    continue
                first = n
                for q in range(count[w]):
                    slot = w * cap + q
                    m = n
                    while m > first and hashes[slots[m - 1]] > hashes[slot]:
                        slots[m] = slots[m - 1]
                        m -= 1
                    slots[m] = slot
                    n += 1
    return n


@kernel
def _uniform(state: Any, n: Any) -> Any:
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    return np.int64(_mix(state[0]) % np.uint64(n))


@kernel
def _sample_plane(r: Any, n: Any, size: Any, state: Any, plane: Any) -> Any:
    """A plane (normal, offset) through three random points, or the mean plane of four; False where they are degenerate."""
    pick = np.empty(4, np.int64)
    for a in range(size):
        pick[a] = _uniform(state, n)
        for b in range(a):
            if pick[b] == pick[a]:
                return False
    p0, p1, p2 = r[pick[0]], r[pick[1]], r[pick[2]]
    if size == 4:
        p3 = r[pick[3]]
        # the cross product of a quadrangle's diagonals is the normal of its mean plane
        a0, a1, a2 = p2[0] - p0[0], p2[1] - p0[1], p2[2] - p0[2]
        b0, b1, b2 = p3[0] - p1[0], p3[1] - p1[1], p3[2] - p1[2]
    else:
        a0, a1, a2 = p1[0] - p0[0], p1[1] - p0[1], p1[2] - p0[2]
        b0, b1, b2 = p2[0] - p0[0], p2[1] - p0[1], p2[2] - p0[2]
    n0, n1, n2 = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
    length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    sides = np.sqrt((a0 * a0 + a1 * a1 + a2 * a2) * (b0 * b0 + b1 * b1 + b2 * b2))
    if not length > 1e-3 * sides:
        return False
    plane[0], plane[1], plane[2] = n0 / length, n1 / length, n2 / length
    offset = 0.0
    for a in range(size):
        p = r[pick[a]]
        offset += plane[0] * p[0] + plane[1] * p[1] + plane[2] * p[2]
    plane[3] = offset / size
    return True


@kernel
def start_plane(r: Any, n: Any, size: Any, trials: Any, ransac: Any, threshold: Any, seed: Any, plane: Any, work: Any) -> Any:
    """The best of ``trials`` random planes over r (n, 3); returns its robust sigma, −1 where every sample was degenerate."""
    state = np.empty(1, np.uint64)
    state[0] = seed
    trial = np.empty(4)
    best = np.inf
    for _ in range(trials):
        if not _sample_plane(r, n, size, state, trial):
            continue
        if ransac:
            score = 0.0
            for i in range(n):
                d = r[i, 0] * trial[0] + r[i, 1] * trial[1] + r[i, 2] * trial[2] - trial[3]
                score += min(d * d, threshold * threshold)
        else:
            for i in range(n):
                work[i] = abs(r[i, 0] * trial[0] + r[i, 1] * trial[1] + r[i, 2] * trial[2] - trial[3])
            score = select_kth(work, n, n // 2)
        if score < best:
            best = score
            plane[:] = trial
    if best == np.inf:
        return -1.0
    for i in range(n):
        work[i] = abs(r[i, 0] * plane[0] + r[i, 1] * plane[1] + r[i, 2] * plane[2] - plane[3])
    return MAD * (1.0 + 5.0 / max(n - 3, 1)) * select_kth(work, n, n // 2)


@kernel
def tangent_of(normal: Any, tangent: Any) -> None:
    """A unit vector across the normal: along map x where that is not nearly the normal, else along map y."""
    axis = 0 if abs(normal[0]) < 0.9 else 1
    d = normal[axis]
    length = np.sqrt(1.0 - d * d)
    for k in range(3):
        tangent[k] = ((1.0 if k == axis else 0.0) - d * normal[k]) / length


@kernel
def local(r: Any, centre: Any, n: Any, t: Any, out: Any) -> None:
    """Coordinates (u, v, w) of a point in the patch frame (tangent, normal x tangent, normal)."""
    x, y, z = r[0] - centre[0], r[1] - centre[1], r[2] - centre[2]
    out[0] = x * t[0] + y * t[1] + z * t[2]
    out[1] = x * (n[1] * t[2] - n[2] * t[1]) + y * (n[2] * t[0] - n[0] * t[2]) + z * (n[0] * t[1] - n[1] * t[0])
    out[2] = x * n[0] + y * n[1] + z * n[2]


@kernel
def refit(
    r: Any, n: Any, centre: Any, normal: Any, tangent: Any, radius: Any, p: Any, sigma: Any, sigmas: Any, floor: Any, iterations: Any,
    inlier: Any, beta: Any, inverse: Any,
) -> Any:  # fmt: skip
    """Least squares on the inliers, iterated until they stay the same. ``inlier`` holds the start; its ball is radius 2r.

    Coordinates are scaled by 2r inside, so the pivots mean the same at every scale; ``beta`` and ``inverse`` =
    (XᵀX)⁻¹ come back in metres. Returns (number of inliers, sigma); 0 inliers where the terms are not determined.
    """
    scale = 2.0 * radius
    x = np.zeros(6)
    q = np.empty(3)
    A = np.zeros((6, 6))
    b = np.zeros(6)
    used = 0
    threshold = max(sigmas * sigma, floor)
    for step in range(iterations + 1):
        used_before, changed, used = used, False, 0
        if step > 0:
            square = 0.0
            for i in range(n):
                local(r[i], centre, normal, tangent, q)
                if q[0] * q[0] + q[1] * q[1] + q[2] * q[2] > scale * scale:
                    inside = False
                else:
                    basis(q[0] / scale, q[1] / scale, p, x)
                    d = q[2]
                    for k in range(p):
                        d -= x[k] * b[k]
                    inside = abs(d) <= threshold
                    if inside:
                        square += d * d
                if inside != inlier[i]:
                    changed = True
                    inlier[i] = inside
                used += inside
            if used <= p:
                return 0, sigma
            sigma = np.sqrt(square / (used - p))
            # noise-free input: keep a threshold above the rounding of coordinates
            threshold = max(sigmas * sigma, floor, 1e-7 * scale)
            if step > 1 and not changed and used == used_before:
                break
        A[:] = 0.0
        b_new = np.zeros(6)
        for i in range(n):
            if not inlier[i]:
                continue
            local(r[i], centre, normal, tangent, q)
            basis(q[0] / scale, q[1] / scale, p, x)
            for k in range(p):
                b_new[k] += x[k] * q[2]
                for m in range(k + 1):
                    A[k, m] += x[k] * x[m]
        for k in range(p):
            for m in range(k):
                A[m, k] = A[k, m]
        if not invert(A, p, inverse):
            return 0, sigma
        for k in range(p):
            b[k] = 0.0
            for m in range(p):
                b[k] += inverse[k, m] * b_new[m]
    unit = np.ones(6)
    unit[1] = unit[2] = 1.0 / scale
    unit[3] = unit[4] = unit[5] = 1.0 / (scale * scale)
    for k in range(p):
        beta[k] = b[k] * unit[k]
        for m in range(p):
            inverse[k, m] *= unit[k] * unit[m]
    return used, sigma


@kernel
def level_frame(r: Any, n: Any, origin: Any, plane: Any, sigma: Any, radius: Any, sigmas: Any, floor: Any, iterations: Any,
                inlier: Any, centre: Any, normal: Any, tangent: Any) -> Any:  # fmt: skip
    """Turn a start plane into a frame at the foot point of ``origin``: a plane refit and re-tilt until it lies flat.

    Returns the plane's sigma, −1 where no plane is determined.
    """
    beta = np.zeros(6)
    inverse = np.zeros((6, 6))
    normal[:] = plane[:3]
    height = origin[0] * normal[0] + origin[1] * normal[1] + origin[2] * normal[2] - plane[3]
    for k in range(3):
        centre[k] = origin[k] - height * normal[k]
    threshold = max(sigmas * sigma, floor, 1e-7 * radius)
    q = np.empty(3)
    for _ in range(3):
        tangent_of(normal, tangent)
        for i in range(n):
            local(r[i], centre, normal, tangent, q)
            inlier[i] = abs(q[2]) <= threshold and q[0] * q[0] + q[1] * q[1] + q[2] * q[2] <= 4.0 * radius * radius
        used, sigma = refit(r, n, centre, normal, tangent, radius, 3, sigma, sigmas, floor, iterations, inlier, beta, inverse)
        if used == 0:
            return -1.0
        t0, t1, t2 = tangent[0], tangent[1], tangent[2]
        s0 = normal[1] * t2 - normal[2] * t1
        s1 = normal[2] * t0 - normal[0] * t2
        s2 = normal[0] * t1 - normal[1] * t0
        m0 = normal[0] - beta[1] * t0 - beta[2] * s0
        m1 = normal[1] - beta[1] * t1 - beta[2] * s1
        m2 = normal[2] - beta[1] * t2 - beta[2] * s2
        length = np.sqrt(m0 * m0 + m1 * m1 + m2 * m2)
        m0, m1, m2 = m0 / length, m1 / length, m2 / length
        # the plane passes through centre + beta0 normal; the foot point of origin on it is the new centre
        h = (
            (origin[0] - centre[0] - beta[0] * normal[0]) * m0
            + (origin[1] - centre[1] - beta[0] * normal[1]) * m1
            + (origin[2] - centre[2] - beta[0] * normal[2]) * m2
        )
        centre[0], centre[1], centre[2] = origin[0] - h * m0, origin[1] - h * m1, origin[2] - h * m2
        normal[0], normal[1], normal[2] = m0, m1, m2
        threshold = max(sigmas * sigma, floor, 1e-7 * radius)
        if abs(beta[1]) + abs(beta[2]) < 1e-6:
            break
    tangent_of(normal, tangent)
    for i in range(n):
        local(r[i], centre, normal, tangent, q)
        inlier[i] = abs(q[2]) <= threshold and q[0] * q[0] + q[1] * q[1] + q[2] * q[2] <= 4.0 * radius * radius
    return sigma
