"""Cross covariance blocks of patches that share raw points (UNCERTAINTY step 3).

``C_ab = (X_aᵀX_a)⁻¹ (Σ_{j in a and b} x_j^a n_aᵀ C_ind,j n_b x_j^bᵀ) (X_bᵀX_b)⁻¹``, stored once with key_b >= key_a.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from ladar_volume.filtering.frame import across
from ladar_volume.filtering.frame import row as row_of
from ladar_volume.filtering.store import BITS, find_voxel
from ladar_volume.model.kernels import kernel, parallel_kernel

#: Balls of radius 2r about centres in voxels more than this apart do not meet.
SPAN = 4


def chunks_of(rows: int) -> int:
    """How many contiguous chunks rows are handled in, each with its own marks (a slot array each): two per thread, none tiny."""
    return min(2 * numba.get_num_threads(), 1 + rows // 64)


@parallel_kernel
def candidates(
    rows: Any, voxels: Any, patch_of: Any, centre: Any, radius: Any, keys: Any, table: Any, fill: Any, offset: Any, out: Any, counts: Any
) -> None:
    """Patches with key >= own whose balls meet the ball of each of ``rows``: counted, or with ``fill`` listed from ``offset`` on."""
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
                    w = find_voxel(table, keys, other) if other >= key else -1
                    b = patch_of[w] if w >= 0 else -1
                    if b < 0:
                        continue
                    d0, d1, d2 = centre[a, 0] - centre[b, 0], centre[a, 1] - centre[b, 1], centre[a, 2] - centre[b, 2]
                    if d0 * d0 + d1 * d1 + d2 * d2 <= 16.0 * radius * radius:
                        if fill:
                            out[offset[row] + n] = b
                        n += 1
        counts[row] = n


@parallel_kernel
def sharing(rows: Any, offset: Any, others: Any, start: Any, used: Any, members: Any, slots: Any, chunks: Any, out: Any) -> None:
    """Whether each candidate pair shares an inlier. ``slots``: length of the slot arrays."""
    for chunk in numba.prange(chunks):
        # which patch last marked a slot: one array per chunk of rows, never cleared
        owner = np.full(slots, -1, np.int32)
        for row in range(chunk * len(rows) // chunks, (chunk + 1) * len(rows) // chunks):
            a = rows[row]
            for i in range(start[a], start[a] + used[a]):
                owner[members[i]] = a
            for k in range(offset[row], offset[row + 1]):
                b = others[k]
                out[k] = False
                for i in range(start[b], start[b] + used[b]):
                    if owner[members[i]] == a:
                        out[k] = True
                        break


@kernel
def _noise_along(C: Any, n: Any, out: Any) -> None:
    """``C n`` of a packed covariance."""
    out[0] = C[0] * n[0] + C[1] * n[1] + C[2] * n[2]
    out[1] = C[1] * n[0] + C[3] * n[1] + C[4] * n[2]
    out[2] = C[2] * n[0] + C[4] * n[1] + C[5] * n[2]


@kernel
def _rows_of(a: Any, start: Any, used: Any, members: Any, r: Any, C: Any, centre: Any, normal: Any, tangent: Any, p: Any, X: Any) -> None:
    """Of each inlier of patch a: its row in X[:, :6] and ``C n`` in X[:, 6:9]."""
    side = np.empty(3)
    across(normal[a], tangent[a], side)
    for i in range(used[a]):
        slot = members[start[a] + i]
        row_of(r, slot, centre[a], tangent[a], side, p, X[i, :6])
        _noise_along(C[slot], normal[a], X[i, 6:9])


@kernel
def _add_quadric(X: Any, i: Any, variance: Any, u: Any, v: Any, S: Any) -> None:
    y3, y4, y5 = u * u, u * v, v * v
    for l in range(6):
        g = variance * X[i, l]
        S[l, 0] += g
        S[l, 1] += g * u
        S[l, 2] += g * v
        S[l, 3] += g * y3
        S[l, 4] += g * y4
        S[l, 5] += g * y5


@kernel
def _add_plane(X: Any, i: Any, variance: Any, u: Any, v: Any, S: Any) -> None:
    for l in range(3):
        g = variance * X[i, l]
        S[l, 0] += g
        S[l, 1] += g * u
        S[l, 2] += g * v


@kernel
def _sandwich(left: Any, S: Any, right: Any, p: Any, out: Any) -> None:
    """``left S right`` of (p, p) matrices."""
    T = np.zeros((6, 6))
    for l in range(p):
        for e in range(p):
            g = left[l, e]
            for m in range(p):
                T[l, m] += g * S[e, m]
    for l in range(p):
        for m in range(p):
            total = 0.0
            for e in range(p):
                total += T[l, e] * right[e, m]
            out[l, m] = total


@parallel_kernel
def cross_blocks(
    rows: Any, offset: Any, others: Any, start: Any, used: Any, members: Any, r: Any, C: Any, centre: Any, normal: Any, tangent: Any,
    inverse: Any, p: Any, most: Any, chunks: Any, out: Any,
) -> None:  # fmt: skip
    """The blocks of the pairs that share points. ``most``: largest number of inliers."""
    for chunk in numba.prange(chunks):
        owner, place = np.full(len(r), -1, np.int32), np.empty(len(r), np.int32)
        X, S, side = np.zeros((most, 9)), np.zeros((6, 6)), np.empty(3)
        for row in range(chunk * len(rows) // chunks, (chunk + 1) * len(rows) // chunks):
            a = rows[row]
            _rows_of(a, start, used, members, r, C, centre, normal, tangent, p, X)
            for i in range(used[a]):
                owner[members[start[a] + i]] = a
                place[members[start[a] + i]] = i
            for k in range(offset[row], offset[row + 1]):
                b = others[k]
                across(normal[b], tangent[b], side)
                c0, c1, c2 = centre[b, 0], centre[b, 1], centre[b, 2]
                t0, t1, t2 = tangent[b, 0], tangent[b, 1], tangent[b, 2]
                n0, n1, n2 = normal[b, 0], normal[b, 1], normal[b, 2]
                S[:] = 0.0
                for j in range(start[b], start[b] + used[b]):
                    slot = members[j]
                    if owner[slot] != a:
                        continue
                    i = place[slot]
                    x, y, z = r[slot, 0] - c0, r[slot, 1] - c1, r[slot, 2] - c2
                    u = x * t0 + y * t1 + z * t2
                    v = x * side[0] + y * side[1] + z * side[2]
                    variance = X[i, 6] * n0 + X[i, 7] * n1 + X[i, 8] * n2
                    if p == 6:
                        _add_quadric(X, i, variance, u, v, S)
                    else:
                        _add_plane(X, i, variance, u, v, S)
                _sandwich(inverse[a], S, inverse[b], p, out[k])
