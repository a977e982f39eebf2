"""The sums of the propagation over points, pairs of patches and time bins as compiled kernels: one
pass over the data each, no copies.

They add up in the order of the records, so a result does not depend on the number of threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ladar_volume.math.kernels import kernel, leaf_kernel
from ladar_volume.math.large_arrays import large_zeros
from ladar_volume.model.records import F32, F64, I8, I16, I32, I64
from ladar_volume.uncertainty.patch_merge import place_from


class BinRows(NamedTuple):
    """Sensitivities of patches to the navigation, listed by patch. start : (m + 1,) of each patch's
    rows · bins : (l,) time bin of each row · M : (l, p + 2, 4) · unit : (m, p + 2, 2) for position
    and attitude · normal, tangent : (m, 3) of the patches
    """

    start: I64
    bins: I32
    M: F32 | I16
    unit: F32
    normal: F64
    tangent: F64


class CalibrationRows(NamedTuple):
    """Sensitivities of patches to the calibration. M : (m, p or more, s) to what all beams share ·
    by_beam : (m, p or more, 2 beams) to ranges, then vertical angles · unit : (m, p or more, 2)
    """

    M: F32
    by_beam: F32 | I16
    unit: F32


class Entries(NamedTuple):
    """Entries (z,) of a matrix that are not zero: rows one, columns two and values."""

    one: I64
    two: I64
    value: F64


def neighbour_rows(key: I64, start: I64, cross_key: I64) -> I32:
    """Row (b,) of the patch with each cross key among ascending keys (m,), -1 for one that is not
    there. start : (m + 1,) of each patch's blocks.
    """
    row: I32 = large_zeros(cross_key.shape, np.int32)
    neighbour_kernel(key, start, cross_key, row)
    return row


@kernel
def neighbour_kernel(key: I64, start: I64, cross_key: I64, row: I32) -> None:
    """See :func:`neighbour_rows`."""
    for a in range(len(key)):
        low = a
        for i in range(start[a], start[a + 1]):
            wanted = cross_key[i]
            low = place_from(key, wanted, low)  # mostly near the one before
            low = min(low, len(key) - 1)
            row[i] = low if key[low] == wanted else -1


@kernel
def place_kernel(cut: F64, fill: F64, place: I64, out: F64) -> None:
    """``cut − fill`` (n, 3) as the first of k results into out (m, k, 3), each row to its place
    (n,) there, none below zero.
    """
    for i in range(len(place)):
        at = place[i]
        if at >= 0:
            for c in range(3):
                out[at, 0, c] = cut[i, c] - fill[i, c]


@kernel
def load_kernel(gradient: F64, normal: F64, tangent: F64, local: F64, row: I64, out: F64) -> None:
    """Adds to out (m, p + 2, k) the loads of k results: gradients (n, k, 3) along the normals
    (m, 3) of the points' patches row (n,) times the first p of ``(1, u, v, u², uv, v²)`` of tangent
    coordinates local (n, 2), then along their tangents (m, 3) and binormals.
    """
    results, p, side = gradient.shape[1], out.shape[1] - 2, np.empty(3)
    for i in range(len(gradient)):
        m, u, v = row[i], local[i, 0], local[i, 1]
        n, t, X = normal[m], tangent[m], (1.0, u, v, u * u, u * v, v * v)
        side[0], side[1], side[2] = (
            n[1] * t[2] - n[2] * t[1],
            n[2] * t[0] - n[0] * t[2],
            n[0] * t[1] - n[1] * t[0],
        )
        for k in range(results):
            x, y, z = gradient[i, k, 0], gradient[i, k, 1], gradient[i, k, 2]
            if x != 0.0 or y != 0.0 or z != 0.0:
                along = x * n[0] + y * n[1] + z * n[2]
                for a in range(p):
                    out[m, a, k] += X[a] * along
                out[m, p, k] += x * t[0] + y * t[1] + z * t[2]
                out[m, p + 1, k] += x * side[0] + y * side[1] + z * side[2]


@kernel
def cross_kernel(q: F64, four: F64, start: I64, right: I32, cross: F32 | I8) -> F64:
    """``Σ weight q_leftᵀ C f_right`` (k, 4) over the blocks C (b, p, p) of each patch from start (m
    + 1,) on, with patches right (b,), -1 for one that is not there, with loads q (m, p or more, k),
    of which the first p count, and f (m, p, 4): as many sums as stay in registers. The weight is 1
    for a patch's own block, 2 for another.
    """
    m, p, results = len(q), cross.shape[1], q.shape[2]
    loaded, out, summed = np.zeros(m, np.bool_), np.zeros((results, 4)), np.zeros((p, 4))
    for a in range(m):
        for r in range(p):
            for k in range(results):
                loaded[a] |= q[a, r, k] != 0.0
    for a in range(m):
        if not loaded[a]:
            continue
        summed[:] = 0.0
        for i in range(start[a], start[a + 1]):
            b = right[i]
            if b < 0 or not loaded[b]:
                continue
            w = 1.0 if b == a else 2.0
            for r in range(p):
                s0 = s1 = s2 = s3 = 0.0
                for c in range(p):
                    f = cross[i, r, c]
                    s0 += f * four[b, c, 0]
                    s1 += f * four[b, c, 1]
                    s2 += f * four[b, c, 2]
                    s3 += f * four[b, c, 3]
                summed[r, 0] += w * s0
                summed[r, 1] += w * s1
                summed[r, 2] += w * s2
                summed[r, 3] += w * s3
        for r in range(p):
            for k in range(results):
                for j in range(4):
                    out[k, j] += q[a, r, k] * summed[r, j]
    return out


@kernel
def pair_falls_kernel(
    q: F64, start: I64, right: I32, cross: F32 | I8, cell: I64, cells: int
) -> F64:
    """``Cov(T, a) − ½ Var(a)`` (cells,) of each cell's part a of the sum T of loads q (m, p or
    more) with the blocks of :func:`cross_kernel`, for patches in the cells cell (m,).
    """
    out, p = np.zeros(cells), cross.shape[1]
    for a in range(len(q)):
        for i in range(start[a], start[a + 1]):
            b, value = right[i], 0.0
            if b < 0:
                continue
            for r in range(p):
                for c in range(p):
                    value += q[a, r] * cross[i, r, c] * q[b, c]
            # of a pair in one cell the covariance counts twice, its variance half of that
            out[cell[a]] += 0.5 * value if b == a else value
            if cell[a] != cell[b]:
                out[cell[b]] += value
    return out


@kernel
def quadratic_kernel(gradient: F64, C: F32) -> float:
    """``Σ gᵀ C g`` of gradients (n, 3) and packed covariances (n, 6)."""
    total = 0.0
    for i in range(len(gradient)):
        x, y, z = gradient[i, 0], gradient[i, 1], gradient[i, 2]
        if x != 0.0 or y != 0.0 or z != 0.0:
            total += (
                C[i, 0] * x * x
                + C[i, 3] * y * y
                + C[i, 5] * z * z
                + 2.0 * (C[i, 1] * x * y + C[i, 2] * x * z + C[i, 4] * y * z)
            )
    return total


@kernel
def calibration_kernel(q: F64, M: F32, by_beam: F32 | I16, unit: F32) -> F64:
    """``Σ qᵀ M`` (c,) of loads q (m, p) and sensitivities in parts: M (m, p, s), by_beam (m, p, 2
    beams) and its units (m, p, 2).
    """
    s, beams = M.shape[2], by_beam.shape[2] // 2
    out = np.zeros(s + 2 * beams)
    for a in range(len(q)):
        for r in range(q.shape[1]):
            load = q[a, r]
            if load != 0.0:
                for c in range(s):
                    out[c] += load * M[a, r, c]
                for h in range(2):
                    part, row, scaled = (
                        out[s + h * beams : s + (h + 1) * beams],
                        by_beam[a, r, h * beams :],
                        load * unit[a, r, h],
                    )
                    for c in range(beams):
                        part[c] += scaled * row[c]
    return out


@leaf_kernel
def fill_calibration(M: F32, by_beam: F32 | I16, unit: F32, out: F64) -> None:
    """One row (c,) of sensitivities from its parts M (s,), by_beam (2 beams,) and unit (2,)."""
    s, beams = len(M), len(by_beam) // 2
    for c in range(s):
        out[c] = M[c]
    for c in range(2 * beams):
        out[s + c] = by_beam[c] * unit[c // beams]


@leaf_kernel
def add_bin(load: F64, M: F32 | I16, n: F64, t: F64, out: F64) -> None:
    """Adds to ``out`` (6,) what position and attitude in one bin do with loads (p + 2, 2), in units
    of the sensitivities M (p + 2, 4) to them, of a patch with this normal and tangent.
    """
    p = len(load) - 2
    x = u = v = w = 0.0  # as many sums as stay in registers
    for r in range(p):
        x += load[r, 0] * M[r, 0]
    for r in range(p + 2):
        u += load[r, 1] * M[r, 1]
        v += load[r, 1] * M[r, 2]
        w += load[r, 1] * M[r, 3]
    y, z = load[p, 0] * M[p, 0], load[p + 1, 0] * M[p + 1, 0]
    out[0] += x * n[0] + y * t[0] + z * (n[1] * t[2] - n[2] * t[1])
    out[1] += x * n[1] + y * t[1] + z * (n[2] * t[0] - n[0] * t[2])
    out[2] += x * n[2] + y * t[2] + z * (n[0] * t[1] - n[1] * t[0])
    out[3] += u
    out[4] += v
    out[5] += w


@leaf_kernel
def in_units(q: F64, unit: F32, load: F64) -> bool:
    """Loads q (p + 2,) times the units (p + 2, 2) of position and attitude, to ``load``; whether
    there is any.
    """
    some = False
    for r in range(len(q)):
        load[r, 0], load[r, 1] = q[r] * unit[r, 0], q[r] * unit[r, 1]
        some |= q[r] != 0.0
    return some


@kernel
def navigation_kernel(
    q: F64, start: I64, index: I32, M: F32 | I16, unit: F32, normal: F64, tangent: F64, bins: int
) -> F64:
    """``Σ qᵀ M`` (bins, 6) of loads q (m, p + 2) and sensitivities M (l, p + 2, 4), listed by patch
    from start (m + 1,), in bins index (l,), in units (m, p + 2, 2) for position and attitude, of
    patches with these normals and tangents (m, 3).
    """
    out, load = np.zeros((bins, 6)), np.empty((q.shape[1], 2))
    for a in range(len(q)):
        if in_units(q[a], unit[a], load):
            for e in range(start[a], start[a + 1]):
                add_bin(load, M[e], normal[a], tangent[a], out[index[e]])
    return out


@kernel
def deviation_kernel(which: I64, rows: BinRows, position: F64, attitude: F64, out: F32) -> None:
    """What one standard deviation of position and attitude, in three directions each, does to the p
    parameters of patches ``which`` (k,), to out (m, p, 6). position, attitude : (bins, 3, 3) roots
    of their covariances.
    """
    start, index, M, unit, normal = rows.start, rows.bins, rows.M, rows.unit, rows.normal
    own, along = np.empty(out.shape[1:]), np.empty(3)
    for a in which:
        own[:] = 0.0
        for e in range(start[a], start[a + 1]):
            P, A, n = position[index[e]], attitude[index[e]], normal[a]
            for c in range(3):
                along[c] = n[0] * P[0, c] + n[1] * P[1, c] + n[2] * P[2, c]
            for r in range(len(own)):
                for c in range(3):
                    own[r, c] += M[e, r, 0] * along[c]
                    own[r, 3 + c] += (
                        M[e, r, 1] * A[0, c] + M[e, r, 2] * A[1, c] + M[e, r, 3] * A[2, c]
                    )
        for r in range(len(own)):
            for c in range(3):
                out[a, r, c] = own[r, c] * unit[a, r, 0]
                out[a, r, 3 + c] = own[r, 3 + c] * unit[a, r, 1]


@kernel
def shared_kernel(which: I64, parts: CalibrationRows, C: Entries, deviation: F32, out: F32) -> None:
    """Covariance of the parameters of patches ``which`` (k,) from all that is shared, to out (m, p,
    p): sensitivities in parts, of which the first p rows count, with the covariances C of their
    columns, and deviations (m, p, d) of unit variance.
    """
    M_cal, by_beam, unit = parts.M, parts.by_beam, parts.unit
    one, two, value = C.one, C.two, C.value
    (p, d), columns = deviation.shape[1:], M_cal.shape[2] + by_beam.shape[2]
    turned, M, fours = np.zeros((p, columns)), np.empty((p, columns)), columns // 4 * 4
    for a in which:
        turned[:] = 0.0
        for r in range(p):
            w = turned[r]
            fill_calibration(M_cal[a, r], by_beam[a, r], unit[a, r], M[r])
            for z in range(len(value)):
                w[two[z]] += M[r, one[z]] * value[z]
            for s in range(r + 1):
                theirs = M[s]
                one_sum = two_sum = three_sum = four_sum = (
                    0.0  # four at a time: one sum would wait for itself
                )
                for c in range(0, fours, 4):
                    one_sum += w[c] * theirs[c]
                    two_sum += w[c + 1] * theirs[c + 1]
                    three_sum += w[c + 2] * theirs[c + 2]
                    four_sum += w[c + 3] * theirs[c + 3]
                for c in range(fours, columns):
                    one_sum += w[c] * theirs[c]
                for c in range(d):
                    two_sum += deviation[a, r, c] * deviation[a, s, c]
                out[a, r, s] = out[a, s, r] = (one_sum + two_sum) + (three_sum + four_sum)


@kernel
def height_kernel(X: F64, row: I64, C: F32) -> F64:
    """``x C xᵀ`` (k,) of design rows X (k, p) with the covariances C (m, p, p) of patches row
    (k,).
    """
    out = np.zeros(len(row))
    for a in range(len(row)):
        for r in range(X.shape[1]):
            for s in range(X.shape[1]):
                out[a] += X[a, r] * C[row[a], r, s] * X[a, s]
    return out


@kernel
def naive_kernel(gradient: F64, normal: F64, row: I64) -> tuple[I64, F64]:
    """Points (k,) at which gradients (n, 3) are not zero, and the squares (k,) of these along the
    normals (m, 3) of the points' patches row (n,).
    """
    which, square, k = np.empty(len(gradient), np.int64), np.empty(len(gradient)), 0
    for i in range(len(gradient)):
        x, y, z = gradient[i, 0], gradient[i, 1], gradient[i, 2]
        if x != 0.0 or y != 0.0 or z != 0.0:
            n = normal[row[i]]
            which[k], square[k] = i, (x * n[0] + y * n[1] + z * n[2]) ** 2
            k += 1
    return which[:k].copy(), square[:k].copy()


@kernel
def cell_kernel(
    q: F64, rows: BinRows, order: I64, cell: I64, cells: int, bins: int
) -> tuple[I64, I64, F64]:
    """``Σ qᵀ M`` as in :func:`navigation_kernel`, by cell of the patches: first (cells + 1,) of
    each cell's bins, these bins (k,) in order, and the sums (k, 6). order : (m,) patches by cell
    (m,).
    """
    start, index, M, unit = rows.start, rows.bins, rows.M, rows.unit
    normal, tangent = rows.normal, rows.tangent
    first, seen, sums = (
        np.zeros(cells + 1, np.int64),
        np.full(bins, -1, np.int64),
        np.zeros((bins, 6)),
    )
    for a in order:
        if (q[a] != 0.0).any():
            for e in range(start[a], start[a + 1]):
                first[cell[a] + 1] += seen[index[e]] != cell[a]
                seen[index[e]] = cell[a]
    first = np.cumsum(first)
    which, out = np.empty(first[-1], np.int64), np.empty((first[-1], 6))
    load, i = np.empty((q.shape[1], 2)), 0
    seen[:] = -1
    for g in range(cells):
        while i < len(order) and cell[order[i]] == g:
            a = order[i]
            i += 1
            if in_units(q[a], unit[a], load):
                for e in range(start[a], start[a + 1]):
                    seen[index[e]] = g
                    add_bin(load, M[e], normal[a], tangent[a], sums[index[e]])
        k = first[g]
        for b in range(bins if k < first[g + 1] else 0):
            if seen[b] == g:
                which[k], out[k], sums[b] = b, sums[b], 0.0
                k += 1
    return first, which, out


@kernel
def correlated_kernel(
    d: F64, decay: F64, bins: I64, shares: tuple[float, float, float, float], out: F64
) -> None:
    """Adds to the upper triangle of out (k, k) the covariance ``d_i·d_j c_ij`` of k values in order
    of time with deviations d (k, 3): c is the share of the constant, plus that of the Gauss-Markov
    part times the product of the decays between their times, plus the third share within one bin
    (k,), and on the diagonal the fourth instead. decay : (k,) from each value to the next.
    """
    constant, markov, same, own = shares
    for i in range(len(d)):
        x, y, z, left, row = d[i, 0], d[i, 1], d[i, 2], markov, out[i]
        row[i] += (x * x + y * y + z * z) * (constant + markov + own)
        for j in range(i + 1, len(d)):
            left *= decay[j - 1]
            row[j] += (constant + left + (same if bins[i] == bins[j] else 0.0)) * (
                x * d[j, 0] + y * d[j, 1] + z * d[j, 2]
            )
