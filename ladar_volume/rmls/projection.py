"""Projection of raw points onto the patch of their voxel, thinned to cells of its tangent plane."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from ladar_volume.math.array_types import F32, F64, I64
from ladar_volume.math.kernels import kernel, parallel_kernel
from ladar_volume.math.normal_equations import basis
from ladar_volume.rmls.fit_store import Fits
from ladar_volume.rmls.tangent_frame import across, arc, row
from ladar_volume.rmls.voxel_store import VoxelArrays


class ProjectedArrays(NamedTuple):
    """Filtered points by row: place, normal, variance along it, noise within the tangent plane,
    time, place on the patch; ``counts`` (m,) is how many each patch has.
    """

    r: F64
    normal: F64
    variance: F64
    C: F32
    t_ns: I64
    uv: F64
    counts: I64


@kernel
def _project_row(
    i_row: int,
    rows: I64,
    store: VoxelArrays,
    fits: Fits,
    C_beta: F32,
    p: int,
    cell: float,
    out: ProjectedArrays,
) -> None:
    """The filtered points of patch ``rows[i_row]``."""
    cap = store.cap
    a = rows[i_row]
    n, beta = fits.normal[a], fits.beta[a]
    x, t, s = np.zeros(6), fits.tangent[a], np.empty(3)
    across(n, t, s)
    cells = np.empty((cap, 2), np.int64)
    size = np.zeros(cap, np.int64)
    mean = np.zeros((cap, 2))
    noise = np.zeros((cap, 6))
    time0 = np.zeros(cap, np.int64)
    time = np.zeros(cap, np.int64)
    m = 0
    for i in range(fits.start[a], fits.start[a] + fits.used[a]):
        slot = fits.members[i]
        if slot // cap != fits.voxels[a]:
            continue
        row(store.r, slot, fits.centre[a], t, s, p, x)
        cu, cv = np.int64(np.floor(x[1] / cell)), np.int64(np.floor(x[2] / cell))
        k = 0
        while k < m and (cells[k, 0] != cu or cells[k, 1] != cv):
            k += 1
        if k == m:
            cells[k, 0], cells[k, 1] = cu, cv
            time0[k] = store.t_ns[slot]
            m += 1
        size[k] += 1
        mean[k, 0] += x[1]
        mean[k, 1] += x[2]
        time[k] += store.t_ns[slot] - time0[k]
        for c in range(6):
            noise[k, c] += store.C[slot, c]
    out.counts[i_row] = m
    for k in range(m):
        i = i_row * cap + k
        u, v = mean[k, 0] / size[k], mean[k, 1] / size[k]
        basis(u, v, p, x)
        w, wu, wv, variance = 0.0, beta[1], beta[2], 0.0
        if p == 6:
            extra, gu, gv = arc(u, v, beta[3], beta[4], beta[5])
            w, wu, wv = w + extra, wu + gu, wv + gv
        for e in range(p):
            w += x[e] * beta[e]
            for f in range(p):
                variance += x[e] * C_beta[i_row, e, f] * x[f]
        slope = np.sqrt(1.0 + wu * wu + wv * wv)
        for c in range(3):
            out.r[i, c] = fits.centre[a, c] + u * t[c] + v * s[c] + w * n[c]
            out.normal[i, c] = (n[c] - wu * t[c] - wv * s[c]) / slope
        out.uv[i, 0], out.uv[i, 1] = u, v
        out.variance[i] = variance / (slope * slope)
        out.t_ns[i] = time0[k] + time[k] // size[k]
        tangential(noise[k], n, size[k], out.C[i])


@parallel_kernel
def project(
    rows: I64,
    store: VoxelArrays,
    fits: Fits,
    C_beta: F32,
    p: int,
    cell: float,
    out: ProjectedArrays,
) -> None:
    """Project each patch's own inliers and replace those in one cell of its tangent plane by their
    mean.

    Row i of every output belongs to patch ``rows[k]`` with i = k * cap + cluster.
    """
    for i_row in numba.prange(len(rows)):
        _project_row(i_row, rows, store, fits, C_beta, p, cell, out)


@kernel
def tangential(total: F64, n: F64, size: int, out: F32) -> None:
    """``P C P / size²`` with P = I − n nᵀ: the noise of a mean of ``size`` points within the
    tangent plane, packed.
    """
    C = np.empty((3, 3))
    C[0, 0], C[0, 1], C[0, 2], C[1, 1], C[1, 2], C[2, 2] = (
        total[0],
        total[1],
        total[2],
        total[3],
        total[4],
        total[5],
    )
    C[1, 0], C[2, 0], C[2, 1] = total[1], total[2], total[4]
    P = np.eye(3)
    for i in range(3):
        for j in range(3):
            P[i, j] -= n[i] * n[j]
    D, e = np.empty((3, 3)), 0  # D = P C
    for i in range(3):
        for j in range(3):
            D[i, j] = P[i, 0] * C[0, j] + P[i, 1] * C[1, j] + P[i, 2] * C[2, j]
    for i in range(3):
        for j in range(i, 3):
            out[e] = (D[i, 0] * P[0, j] + D[i, 1] * P[1, j] + D[i, 2] * P[2, j]) / (size * size)
            e += 1
