"""Cross covariance blocks of patches that share raw points (UNCERTAINTY step 3).

``C_ab = N_a⁻¹ (Σ_{j in a and b} w_j^a x_j^a n_aᵀ C_ind,j n_b x_j^bᵀ w_j^b) N_b⁻¹`` with
``N = XᵀWX``, stored once with key_b >= key_a. W: what each return stands for
(``thinning_weights``).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np

from ladar_volume.math.array_types import F32, F64, I32, I64, U32, Bool
from ladar_volume.math.kernels import inlined, kernel, parallel_kernel, signed
from ladar_volume.math.normal_equations import basis
from ladar_volume.rmls.fit_store import Fits
from ladar_volume.rmls.tangent_frame import polynomial_row as row_of
from ladar_volume.rmls.tangent_frame import second_tangent
from ladar_volume.rmls.voxel_store import BITS, VoxelArrays, find_voxel

#: Balls of radius 2r about centres in voxels more than this apart do not meet.
SPAN = 4


class Pairs(NamedTuple):
    """Pairs of patches in CSR form: ``rows[i]`` and ``others[offset[i] : offset[i + 1]]``."""

    rows: I64
    offset: I64
    others: I64


class Balls(NamedTuple):
    """Balls of radius 2r, r in m, about the centres (v, 3) m of the patches of all voxels. good :
    (v,) voxels with a patch · mine : (v,) those among the rows
    """

    good: Bool
    mine: Bool
    centre: F64
    radius: float


class LocalSlots(NamedTuple):
    """number : (n,) of the slot of each member, from 0 on · total : how many numbers there are."""

    number: I32
    total: int


class Marks(NamedTuple):
    """Which patch marked a local slot last, as which of its inliers; the local slot of each of the
    members (see :func:`local_slots`).
    """

    owner: I32
    place: I32
    local: I32


class Work(NamedTuple):
    """Rows of the inliers of one patch: X (n, 10), and of those shared with another G (n, 6), Y
    (n, 5).
    """

    X: F64
    G: F64
    Y: F64


def chunks_of(rows: int) -> int:
    """How many contiguous chunks rows are handled in, each with its own marks: two per thread, none
    tiny.
    """
    return min(2 * numba.get_num_threads(), 1 + rows // 64)


@kernel
def _candidates_of(
    row: int, pairs: Pairs, balls: Balls, store: VoxelArrays, fill: bool, counts: I64
) -> None:
    """The candidates of ``pairs.rows[row]``."""
    mask, keys, centre = (1 << BITS) - 1, store.keys, balls.centre
    a = pairs.rows[row]
    key = keys[a]
    i0, j0, k0 = key >> (2 * BITS), (key >> BITS) & mask, key & mask
    n = 0
    for lower in range(2):
        for di in range(-SPAN * lower, SPAN * (1 - lower) + 1):
            for dj in range(-SPAN, SPAN + 1):
                for dk in range(-SPAN, SPAN + 1):
                    other = ((i0 + di) << (2 * BITS)) | ((j0 + dj) << BITS) | (k0 + dk)
                    b = (
                        find_voxel(store.table, keys, other)
                        if (other < key) == (lower == 1)
                        else -1
                    )
                    if b < 0 or not balls.good[b] or (lower == 1 and balls.mine[b]):
                        continue
                    d0, d1, d2 = (
                        centre[a, 0] - centre[b, 0],
                        centre[a, 1] - centre[b, 1],
                        centre[a, 2] - centre[b, 2],
                    )
                    if d0 * d0 + d1 * d1 + d2 * d2 <= 16.0 * balls.radius * balls.radius:
                        if fill:
                            pairs.others[pairs.offset[row] + n] = b
                        n += 1
    counts[row] = n


@parallel_kernel
def candidates(pairs: Pairs, balls: Balls, store: VoxelArrays, fill: bool, counts: I64) -> None:
    """Patches whose balls meet the ball of each of ``rows`` (voxel indices): those with key >= own,
    then those with a lower key that are not ``mine``, each in order of their keys; counted, or with
    ``fill`` listed from ``offset`` on.
    """
    for row in numba.prange(len(pairs.rows)):
        _candidates_of(signed(row), pairs, balls, store, fill, counts)


@parallel_kernel
def pairs_sharing_inliers(
    pairs: Pairs, first: I64, held: I64, entries: U32, voxels: int, chunks: int, out: Bool
) -> None:
    """Whether each candidate pair shares an inlier, by their entries (see ``fits``). ``voxels``:
    how many there are.
    """
    rows, offset, others = pairs.rows, pairs.offset, pairs.others
    for chunk in numba.prange(chunks):
        # which patch last listed a voxel, and the number of its entry: one array per chunk of rows,
        # never cleared
        owner, entry = np.full(voxels, -1, np.int32), np.empty(voxels, np.int64)
        for row in range(chunk * len(rows) // chunks, (chunk + 1) * len(rows) // chunks):
            a = rows[row]
            for e in range(first[a], first[a] + held[a]):
                owner[entries[e, 0]], entry[entries[e, 0]] = a, e
            for k in range(offset[row], offset[row + 1]):
                b = others[k]
                out[k] = False
                for e in range(first[b], first[b] + held[b]):
                    if owner[entries[e, 0]] == a:
                        mine = entries[entry[entries[e, 0]]]
                        for word in range(1, entries.shape[1]):
                            out[k] |= (mine[word] & entries[e, word]) != 0
                    if out[k]:
                        break


@kernel
def local_slots(members: I32, cap: int, voxels: int) -> LocalSlots:
    """A number for the slot of each of the members (n,), the same for the same slot: few patches of
    a large map have few slots, and marks for these stay in the cache. voxels : of the map.
    """
    rank, out, used = np.full(voxels, -1, np.int32), np.empty(len(members), np.int32), 0
    for i in range(len(members)):
        v = members[i] // cap
        if rank[v] < 0:
            rank[v] = used
            used += 1
        out[i] = rank[v] * cap + members[i] - v * cap
    return LocalSlots(out, used * cap)


@kernel
def _noise_along(C: F32, n: F64, out: F64) -> None:
    """``C n`` of a packed covariance."""
    out[0] = C[0] * n[0] + C[1] * n[1] + C[2] * n[2]
    out[1] = C[1] * n[0] + C[3] * n[1] + C[4] * n[2]
    out[2] = C[2] * n[0] + C[4] * n[1] + C[5] * n[2]


@kernel
def _rows_of(a: int, store: VoxelArrays, fits: Fits, p: int, X: F64) -> None:
    """Of each inlier of patch a: its row in X[:, :6], ``C n`` in X[:, 6:9], its weight."""
    side = np.empty(3)
    second_tangent(fits.normal[a], fits.tangent[a], side)
    for i in range(fits.used[a]):
        slot = fits.members[fits.start[a] + i]
        row_of(store.r, slot, fits.centre[a], fits.tangent[a], side, p, X[i, :6])
        _noise_along(store.C[slot], fits.normal[a], X[i, 6:9])
        X[i, 9] = fits.weights[fits.start[a] + i]


@kernel
def _sum_products(G: F64, Y: F64, m: int, p: int, S: F64) -> None:
    """``S[:p, :p] = Σ_j G[j] Y[j]ᵀ`` over m rows, one row of S at a time in registers."""
    for l in range(p):
        s0 = s1 = s2 = s3 = s4 = s5 = 0.0
        if p == 6:
            for j in range(m):
                g = G[j, l]
                s0 += g
                s1 += g * Y[j, 0]
                s2 += g * Y[j, 1]
                s3 += g * Y[j, 2]
                s4 += g * Y[j, 3]
                s5 += g * Y[j, 4]
        else:
            for j in range(m):
                g = G[j, l]
                s0 += g
                s1 += g * Y[j, 0]
                s2 += g * Y[j, 1]
        S[l, 0], S[l, 1], S[l, 2], S[l, 3], S[l, 4], S[l, 5] = s0, s1, s2, s3, s4, s5


@kernel
def _sandwich(left: F64, S: F64, right: F64, p: int, out: F32) -> None:
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


@kernel
def _shared_products(
    a: int, b: int, swap: bool, store: VoxelArrays, fits: Fits, p: int, marks: Marks, work: Work
) -> Any:
    """Of each inlier that patch b shares with a: ``w_a n_aᵀ C n_b w_b`` times its row on the one
    patch to G, u, v, u², uv, v² on the other to Y; returns how many. The row is that on a, with
    ``swap`` that on b: the same numbers as from the other patch's side.
    """
    side, x, w, na, nb = np.empty(3), np.empty(6), np.empty(3), fits.normal[a], fits.normal[b]
    centre, tangent, r = fits.centre, fits.tangent, store.r
    X, G, Y = work
    second_tangent(nb, tangent[b], side)
    c0, c1, c2 = centre[b, 0], centre[b, 1], centre[b, 2]
    t0, t1, t2 = tangent[b, 0], tangent[b, 1], tangent[b, 2]
    m = 0
    for j in range(fits.start[b], fits.start[b] + fits.used[b]):
        if marks.owner[marks.local[j]] != a:
            continue
        slot, i = fits.members[j], marks.place[marks.local[j]]
        x0, x1, x2 = r[slot, 0] - c0, r[slot, 1] - c1, r[slot, 2] - c2
        u, v = x0 * t0 + x1 * t1 + x2 * t2, x0 * side[0] + x1 * side[1] + x2 * side[2]
        weight = X[i, 9] * fits.weights[j]
        if swap:
            _noise_along(store.C[slot], nb, w)
            variance = weight * (w[0] * na[0] + w[1] * na[1] + w[2] * na[2])
            basis(u, v, p, x)
            for l in range(p):
                G[m, l] = variance * x[l]
            u, v = X[i, 1], X[i, 2]
        else:
            variance = weight * (X[i, 6] * nb[0] + X[i, 7] * nb[1] + X[i, 8] * nb[2])
            for l in range(p):
                G[m, l] = variance * X[i, l]
        Y[m, 0], Y[m, 1], Y[m, 2], Y[m, 3], Y[m, 4] = u, v, u * u, u * v, v * v
        m += 1
    return m


@inlined
def _blocks_of(
    chunk: int,
    chunks: int,
    pairs: Pairs,
    store: VoxelArrays,
    fits: Fits,
    slots: LocalSlots,
    p: int,
    out: F32,
) -> None:
    """The blocks of one of so many chunks of the rows."""
    rows, offset, others = pairs.rows, pairs.offset, pairs.others
    most = 0
    for a in rows:
        most = max(most, fits.used[a])
    local = slots.number
    marks = Marks(np.full(slots.total, -1, np.int32), np.empty(slots.total, np.int32), local)
    work = Work(np.zeros((most, 10)), np.zeros((most, 6)), np.zeros((most, 5)))
    S = np.zeros((6, 6))
    for row in range(chunk * len(rows) // chunks, (chunk + 1) * len(rows) // chunks):
        a = rows[row]
        _rows_of(a, store, fits, p, work.X)
        for i in range(fits.used[a]):
            marks.owner[local[fits.start[a] + i]] = a
            marks.place[local[fits.start[a] + i]] = i
        for k in range(offset[row], offset[row + 1]):
            b = others[k]
            swap = store.keys[b] < store.keys[a]
            m = _shared_products(a, b, swap, store, fits, p, marks, work)
            _sum_products(work.G, work.Y, m, p, S)
            if swap:
                _sandwich(fits.inverse[b], S, fits.inverse[a], p, out[k])
            else:
                _sandwich(fits.inverse[a], S, fits.inverse[b], p, out[k])


@kernel
def cross_blocks(
    index: I64,
    pairs: Pairs,
    store: VoxelArrays,
    fits: Fits,
    slots: LocalSlots,
    p: int,
    chunks: int,
    out: F32,
) -> None:
    """The blocks of the pairs that share points, the patch with the lower key first, of those of so
    many chunks of the rows that ``index`` names. slots : of the members, see :func:`local_slots`
    """
    for chunk in index:
        _blocks_of(chunk, chunks, pairs, store, fits, slots, p, out)
