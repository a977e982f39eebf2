"""Cross covariance blocks of patches that share raw points (UNCERTAINTY step 3), and the projection of points.

``C_ab = (X_aᵀX_a)⁻¹ (Σ_{j in a and b} x_j^a n_aᵀ C_ind,j n_b x_j^bᵀ) (X_bᵀX_b)⁻¹``, stored once with key_b >= key_a.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from ladar_volume.filtering.kernels import _row
from ladar_volume.filtering.linear import basis
from ladar_volume.filtering.store import BITS, find_voxel
from ladar_volume.model.kernels import kernel, parallel_kernel

#: Balls of radius 2r about centres in voxels more than this apart do not meet.
SPAN = 4


@kernel
def _shares(a: Any, b: Any, start: Any, used: Any, members: Any, keys: Any, hashes: Any, cap: Any) -> Any:
    """Whether two patches share an inlier; both lists are in canonical order, so one merge tells."""
    i, j = start[a], start[b]
    end_i, end_j = start[a] + used[a], start[b] + used[b]
    while i < end_i and j < end_j:
        s, t = members[i], members[j]
        if s == t:
            return True
        ks, kt = keys[s // cap], keys[t // cap]
        if ks < kt or (ks == kt and hashes[s] < hashes[t]):
            i += 1
        else:
            j += 1
    return False


@parallel_kernel
def neighbours(
    rows: Any, voxels: Any, patch_of: Any, start: Any, used: Any, members: Any, centre: Any, radius: Any, keys: Any, table: Any,
    hashes: Any, cap: Any, fill: Any, offset: Any, out: Any, counts: Any,
) -> None:  # fmt: skip
    """Patches with key >= own that share points with each of ``rows``: counted, or with ``fill`` listed from ``offset`` on."""
    mask = (1 << BITS) - 1
    for row in numba.prange(len(rows)):
        a = rows[row]
        key = keys[voxels[a]]
        i0, j0, k0 = key >> (2 * BITS), (key >> BITS) & mask, key & mask
        n = 0
        for di in range(SPAN + 1):
            for dj in range(-SPAN, SPAN + 1):
                for dk in range(-SPAN, SPAN + 1):
                    other = ((i0 + di) << (2 * BITS)) | ((j0 + dj) << BITS) | (k0 + dk)
                    if other < key:
                        continue
                    w = find_voxel(table, keys, other)
                    if w < 0 or patch_of[w] < 0:
                        continue
                    b = patch_of[w]
                    d = 0.0
                    for k in range(3):
                        d += (centre[a, k] - centre[b, k]) ** 2
                    if d > 16.0 * radius * radius or not _shares(a, b, start, used, members, keys, hashes, cap):
                        continue
                    if fill:
                        out[offset[row] + n] = b
                    n += 1
        counts[row] = n


@parallel_kernel
def cross_blocks(
    rows: Any, offset: Any, others: Any, start: Any, used: Any, members: Any, r: Any, C: Any, keys: Any, hashes: Any, cap: Any,
    centre: Any, normal: Any, tangent: Any, inverse: Any, p: Any, out: Any,
) -> None:  # fmt: skip
    """The blocks of the pairs found by :func:`neighbours`."""
    for row in numba.prange(len(rows)):
        a = rows[row]
        na = normal[a]
        q, xa, xb = np.empty(3), np.zeros(6), np.zeros(6)
        for k in range(offset[row], offset[row + 1]):
            b = others[k]
            nb = normal[b]
            S = np.zeros((6, 6))
            i, j = start[a], start[b]
            end_i, end_j = start[a] + used[a], start[b] + used[b]
            while i < end_i and j < end_j:
                s, t = members[i], members[j]
                if s != t:
                    ks, kt = keys[s // cap], keys[t // cap]
                    if ks < kt or (ks == kt and hashes[s] < hashes[t]):
                        i += 1
                    else:
                        j += 1
                    continue
                c = C[s]
                variance = (
                    na[0] * (c[0] * nb[0] + c[1] * nb[1] + c[2] * nb[2])
                    + na[1] * (c[1] * nb[0] + c[3] * nb[1] + c[4] * nb[2])
                    + na[2] * (c[2] * nb[0] + c[4] * nb[1] + c[5] * nb[2])
                )
                _row(r, s, centre[a], na, tangent[a], p, q, xa)
                _row(r, s, centre[b], nb, tangent[b], p, q, xb)
                for l in range(p):
                    for m in range(p):
                        S[l, m] += variance * xa[l] * xb[m]
                i += 1
                j += 1
            for l in range(p):
                for m in range(p):
                    total = 0.0
                    for e in range(p):
                        for f in range(p):
                            total += inverse[a, l, e] * S[e, f] * inverse[b, f, m]
                    out[k, l, m] = total


@parallel_kernel
def project(
    rows: Any, voxels: Any, start: Any, used: Any, members: Any, r: Any, C: Any, t_ns: Any, cap: Any, centre: Any, normal: Any,
    tangent: Any, beta: Any, C_beta: Any, p: Any, cell: Any, r_out: Any, n_out: Any, var_out: Any, C_out: Any, t_out: Any, uv_out: Any,
    counts: Any, own: Any,
) -> None:  # fmt: skip
    """Project each patch's own inliers and replace those in one cell of its tangent plane by their mean.

    Row i of every output belongs to patch ``rows[row]`` with i = row * cap + cluster; ``own`` is the number projected.
    """
    for row in numba.prange(len(rows)):
        a = rows[row]
        n = normal[a]
        q, x = np.empty(3), np.zeros(6)
        cells = np.empty((cap, 2), np.int64)
        size = np.zeros(cap, np.int64)
        mean = np.zeros((cap, 2))
        noise = np.zeros((cap, 6))
        time0 = np.zeros(cap, np.int64)
        time = np.zeros(cap, np.int64)
        m = 0
        own[row] = 0
        for i in range(start[a], start[a] + used[a]):
            slot = members[i]
            if slot // cap != voxels[a]:
                continue
            own[row] += 1
            _row(r, slot, centre[a], n, tangent[a], p, q, x)
            cu, cv = np.int64(np.floor(q[0] / cell)), np.int64(np.floor(q[1] / cell))
            k = 0
            while k < m and (cells[k, 0] != cu or cells[k, 1] != cv):
                k += 1
            if k == m:
                cells[k, 0], cells[k, 1] = cu, cv
                time0[k] = t_ns[slot]
                m += 1
            size[k] += 1
            mean[k, 0] += q[0]
            mean[k, 1] += q[1]
            time[k] += t_ns[slot] - time0[k]
            for c in range(6):
                noise[k, c] += C[slot, c]
        counts[row] = m
        t = tangent[a]
        s = np.array([n[1] * t[2] - n[2] * t[1], n[2] * t[0] - n[0] * t[2], n[0] * t[1] - n[1] * t[0]])
        for k in range(m):
            i = row * cap + k
            u, v = mean[k, 0] / size[k], mean[k, 1] / size[k]
            basis(u, v, p, x)
            w, wu, wv, variance = 0.0, beta[a, 1], beta[a, 2], 0.0
            if p == 6:
                wu += 2.0 * beta[a, 3] * u + beta[a, 4] * v
                wv += beta[a, 4] * u + 2.0 * beta[a, 5] * v
            for e in range(p):
                w += x[e] * beta[a, e]
                for f in range(p):
                    variance += x[e] * C_beta[row, e, f] * x[f]
            slope = np.sqrt(1.0 + wu * wu + wv * wv)
            for c in range(3):
                r_out[i, c] = centre[a, c] + u * t[c] + v * s[c] + w * n[c]
                n_out[i, c] = (n[c] - wu * t[c] - wv * s[c]) / slope
            uv_out[i, 0], uv_out[i, 1] = u, v
            var_out[i] = variance / (slope * slope)
            t_out[i] = time0[k] + time[k] // size[k]
            tangential(noise[k], n, size[k], C_out[i])


@kernel
def tangential(total: Any, n: Any, size: Any, out: Any) -> None:
    """``P C P / size²`` with P = I − n nᵀ: the noise of a mean of ``size`` points within the tangent plane, packed."""
    C = np.empty((3, 3))
    C[0, 0], C[0, 1], C[0, 2], C[1, 1], C[1, 2], C[2, 2] = total[0], total[1], total[2], total[3], total[4], total[5]
    C[1, 0], C[2, 0], C[2, 1] = total[1], total[2], total[4]
    P = np.eye(3)
    for i in range(3):
        for j in range(3):
            P[i, j] -= n[i] * n[j]
    D = P @ C @ P / (size * size)
    out[0], out[1], out[2], out[3], out[4], out[5] = D[0, 0], D[0, 1], D[0, 2], D[1, 1], D[1, 2], D[2, 2]
