"""Parallel kernels over patches: fits, sensitivities, cross blocks, projection. Each iteration writes its own outputs.

Sums over points run in canonical order (voxel key, then hash), so the same points give the same bytes whatever the
order of arrival, the batching or the number of threads.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from ladar_volume.filtering.fit import (
    FEW_INLIERS, FEW_POINTS, NO_PLANE, NOT_ON_PATCH, OK, REACH, gather, level_frame, local, refit, start_plane, tangent_of,
)  # fmt: skip
from ladar_volume.filtering.linear import basis
from ladar_volume.filtering.store import BITS, _mix, find_voxel
from ladar_volume.model.kernels import kernel, parallel_kernel


@parallel_kernel
def count_candidates(voxels: Any, keys: Any, table: Any, count: Any, out: Any) -> None:
    """Points in the voxels around each of ``voxels``: an upper bound of its inliers."""
    mask = (1 << BITS) - 1
    for a in numba.prange(len(voxels)):
        key = keys[voxels[a]]
        i0, j0, k0 = key >> (2 * BITS), (key >> BITS) & mask, key & mask
        n = 0
        for di in range(-REACH, REACH + 1):
            for dj in range(-REACH, REACH + 1):
                for dk in range(-REACH, REACH + 1):
                    w = find_voxel(table, keys, ((i0 + di) << (2 * BITS)) | ((j0 + dj) << BITS) | (k0 + dk))
                    if w >= 0:
                        n += count[w]
        out[a] = n


@kernel
def rotate(q: Any, v: Any, out: Any) -> None:
    """``R(q) v`` for a unit quaternion xyzw."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    t0 = 2.0 * (y * v[2] - z * v[1])
    t1 = 2.0 * (z * v[0] - x * v[2])
    t2 = 2.0 * (x * v[1] - y * v[0])
    out[0] = v[0] + w * t0 + y * t2 - z * t1
    out[1] = v[1] + w * t1 + z * t0 - x * t2
    out[2] = v[2] + w * t2 + x * t1 - y * t0


@kernel
def _fit_one(
    voxel: Any, slots: Any, n: Any, r: Any, aux: Any, cap: Any, radius: Any, p: Any, size: Any, trials: Any, ransac: Any,
    ransac_threshold: Any, sigmas: Any, floor: Any, min_points: Any, iterations: Any, seed: Any, inlier: Any, centre: Any, normal: Any,
    tangent: Any, beta: Any, inverse: Any,
) -> Any:  # fmt: skip
    """One patch; returns (status, inliers, sigma)."""
    pts = np.empty((n, 3))
    own = 0
    origin = np.zeros(3)
    for i in range(n):
        for k in range(3):
            pts[i, k] = r[slots[i], k]
        if slots[i] // cap == voxel:
            own += 1
            for k in range(3):
                origin[k] += pts[i, k]
    for k in range(3):
        origin[k] /= own
    near = np.empty((n, 3))
    m = 0
    for i in range(n):
        d = 0.0
        for k in range(3):
            d += (pts[i, k] - origin[k]) ** 2
        if d <= 4.0 * radius * radius:
            for k in range(3):
                # relative to the centroid: offsets of planes keep their digits far from the map's origin
                near[m, k] = pts[i, k] - origin[k]
            m += 1
    if m < min_points:
        return FEW_POINTS, 0, 0.0
    plane = np.empty(4)
    work = np.empty(m)
    sigma = start_plane(near, m, size, trials, ransac, ransac_threshold, seed, plane, work)
    if sigma < 0.0:
        return NO_PLANE, 0, 0.0
    plane[3] += plane[0] * origin[0] + plane[1] * origin[1] + plane[2] * origin[2]
    sigma = level_frame(pts, n, origin, plane, sigma, radius, sigmas, floor, iterations, inlier, centre, normal, tangent)
    if sigma < 0.0:
        return NO_PLANE, 0, 0.0
    facing = 0.0
    beam = np.empty(3)
    for i in range(n):
        if inlier[i]:
            rotate(aux[slots[i], 0:4], aux[slots[i], 4:7], beam)
            facing += beam[0] * normal[0] + beam[1] * normal[1] + beam[2] * normal[2]
    if facing > 0.0:
        for k in range(3):
            normal[k] = -normal[k]
        tangent_of(normal, tangent)
    start = inlier.copy()
    beta[:] = 0.0
    inverse[:] = 0.0
    used, s = refit(pts, n, centre, normal, tangent, radius, p, sigma, sigmas, floor, iterations, inlier, beta, inverse)
    if used < min_points and p == 6:
        # too few or too one-sided points for a quadric: the plane stands, its quadratic terms are zero with certainty
        inlier[:] = start
        beta[:] = 0.0
        inverse[:] = 0.0
        used, s = refit(pts, n, centre, normal, tangent, radius, 3, sigma, sigmas, floor, iterations, inlier, beta, inverse)
    if used < min_points:
        return FEW_INLIERS, used, s
    for i in range(n):
        if inlier[i] and slots[i] // cap == voxel:
            return OK, used, s
    return NOT_ON_PATCH, used, s


@parallel_kernel
def fit_patches(
    voxels: Any, start: Any, keys: Any, table: Any, count: Any, hashes: Any, r: Any, t_ns: Any, aux: Any, cap: Any, radius: Any, p: Any,
    size: Any, trials: Any, ransac: Any, ransac_threshold: Any, sigmas: Any, floor: Any, min_points: Any, iterations: Any, seed: Any,
    members: Any, status: Any, used: Any, sigma: Any, time: Any, centre: Any, normal: Any, tangent: Any, beta: Any, inverse: Any,
) -> None:  # fmt: skip
    """Fit every voxel of ``voxels``; inlier slots of patch a go to ``members[start[a]:start[a] + used[a]]``."""
    for a in numba.prange(len(voxels)):
        v = voxels[a]
        slots = members[start[a] : start[a + 1]]
        n = gather(v, keys, table, count, hashes, cap, slots)
        inlier = np.zeros(n, np.bool_)
        own_seed = _mix(np.uint64(keys[v]) ^ _mix(np.uint64(seed)))
        status[a], used[a], sigma[a] = _fit_one(
            v, slots, n, r, aux, cap, radius, p, size, trials, ransac, ransac_threshold, sigmas, floor, min_points, iterations, own_seed,
            inlier, centre[a], normal[a], tangent[a], beta[a], inverse[a],
        )  # fmt: skip
        m = 0
        first = np.int64(0)
        total = np.int64(0)
        if status[a] == OK:
            for i in range(n):
                if inlier[i]:
                    slots[m] = slots[i]
                    if m == 0:
                        first = t_ns[slots[i]]
                    total += t_ns[slots[i]] - first
                    m += 1
            time[a] = first + total // m
        used[a] = m


@kernel
def _row(r: Any, slot: Any, centre: Any, normal: Any, tangent: Any, p: Any, q: Any, x: Any) -> None:
    local(r[slot], centre, normal, tangent, q)
    basis(q[0], q[1], p, x)


@kernel
def distinct_bins(members: Any, n: Any, t_ns: Any, bin_ns: Any, bins: Any) -> Any:
    """Sorted distinct time bins of a patch's inliers; returns how many."""
    m = 0
    for i in range(n):
        b = np.int64(np.floor_divide(t_ns[members[i]], bin_ns))
        lo = m
        while lo > 0 and bins[lo - 1] > b:
            lo -= 1
        if lo > 0 and bins[lo - 1] == b:
            continue
        for k in range(m, lo, -1):
            bins[k] = bins[k - 1]
        bins[lo] = b
        m += 1
    return m


@parallel_kernel
def count_bins(start: Any, used: Any, members: Any, t_ns: Any, bin_ns: Any, out: Any) -> None:
    """Distinct navigation time bins of each patch."""
    for a in numba.prange(len(used)):
        bins = np.empty(used[a] + 1, np.int64)
        out[a] = distinct_bins(members[start[a] : start[a + 1]], used[a], t_ns, bin_ns, bins)


@parallel_kernel
def sensitivities(
    start: Any, used: Any, members: Any, r: Any, t_ns: Any, ring: Any, aux: Any, centre: Any, normal: Any, tangent: Any, inverse: Any,
    p: Any, beams: Any, lever_laser: Any, lever_antenna: Any, axis_body: Any, bin_ns: Any, nav_start: Any, nav_bin: Any, M_cal: Any,
    M_nav: Any,
) -> None:  # fmt: skip
    """Mean sensitivities of beta (UNCERTAINTY step 4): ``(XᵀX)⁻¹ Σ_j x_j n·∂r_j/∂theta``, over all inliers and per time bin.

    With m = Rᵀn and arm = v + b − a: position n, attitude arm x m, boresight v x m, b m, a −m, range u·m, clock
    n·velocity + (omega x arm)·m, vertical angle m·(range (axis − u sin eps)/cos eps) with ``axis_body`` the laser's z axis.
    """
    shift = lever_laser - lever_antenna
    for a in numba.prange(len(used)):
        n = normal[a]
        nb = nav_start[a + 1] - nav_start[a]
        bins = nav_bin[nav_start[a] : nav_start[a + 1]]
        all_bins = np.empty(used[a] + 1, np.int64)
        distinct_bins(members[start[a] : start[a + 1]], used[a], t_ns, bin_ns, all_bins)
        bins[:] = all_bins[:nb]
        cal = np.zeros((6, 11 + 2 * beams))
        nav = np.zeros((nb, 6, 6))
        q, x, h = np.empty(3), np.zeros(6), np.zeros(13)
        m, conj = np.empty(3), np.empty(4)
        for i in range(used[a]):
            slot = members[start[a] + i]
            _row(r, slot, centre[a], n, tangent[a], p, q, x)
            g = aux[slot]
            conj[0], conj[1], conj[2], conj[3] = -g[0], -g[1], -g[2], g[3]
            rotate(conj, n, m)
            v0, v1, v2 = g[4], g[5], g[6]
            w0, w1, w2 = v0 + shift[0], v1 + shift[1], v2 + shift[2]
            length = np.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
            u0, u1, u2 = v0 / length, v1 / length, v2 / length
            h[0] = u0 * m[0] + u1 * m[1] + u2 * m[2]
            h[1], h[2], h[3] = v1 * m[2] - v2 * m[1], v2 * m[0] - v0 * m[2], v0 * m[1] - v1 * m[0]
            for k in range(3):
                h[4 + k] = m[k]
                h[7 + k] = -m[k]
            o0, o1, o2 = g[10], g[11], g[12]
            h[10] = (
                n[0] * g[7] + n[1] * g[8] + n[2] * g[9]
                + (o1 * w2 - o2 * w1) * m[0] + (o2 * w0 - o0 * w2) * m[1] + (o0 * w1 - o1 * w0) * m[2]
            )  # fmt: skip
            sine = u0 * axis_body[0] + u1 * axis_body[1] + u2 * axis_body[2]
            along = axis_body[0] * m[0] + axis_body[1] * m[1] + axis_body[2] * m[2]
            h[12] = length * (along - sine * h[0]) / np.sqrt(max(1.0 - sine * sine, 1e-12))
            b = np.searchsorted(bins, np.int64(np.floor_divide(t_ns[slot], bin_ns)))
            beam = min(np.int64(ring[slot]), beams - 1)
            for k in range(p):
                for c in range(11):
                    cal[k, c] += x[k] * h[c]
                cal[k, 11 + beam] += x[k] * h[0]
                cal[k, 11 + beams + beam] += x[k] * h[12]
                for c in range(3):
                    nav[b, k, c] += x[k] * n[c]
                nav[b, k, 3] += x[k] * (w1 * m[2] - w2 * m[1])
                nav[b, k, 4] += x[k] * (w2 * m[0] - w0 * m[2])
                nav[b, k, 5] += x[k] * (w0 * m[1] - w1 * m[0])
        for k in range(p):
            for c in range(11 + 2 * beams):
                s = 0.0
                for l in range(p):
                    s += inverse[a, k, l] * cal[l, c]
                M_cal[a, k, c] = s
            for b in range(nb):
                for c in range(6):
                    s = 0.0
                    for l in range(p):
                        s += inverse[a, k, l] * nav[b, l, c]
                    M_nav[nav_start[a] + b, k, c] = s

@parallel_kernel
def near_marked(keys: Any, used: Any, table: Any, marked: Any, reach: Any, out: Any) -> None:
    """Which voxels lie within ``reach`` voxels of a marked one."""
    mask = (1 << BITS) - 1
    for v in numba.prange(used):
        key = keys[v]
        i0, j0, k0 = key >> (2 * BITS), (key >> BITS) & mask, key & mask
        found = marked[v]
        for di in range(-reach, reach + 1):
            for dj in range(-reach, reach + 1):
                for dk in range(-reach, reach + 1):
                    if not found:
                        w = find_voxel(table, keys, ((i0 + di) << (2 * BITS)) | ((j0 + dj) << BITS) | (k0 + dk))
                        found = w >= 0 and marked[w]
        out[v] = found
