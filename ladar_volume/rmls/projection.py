"""Projection of raw points onto the patch of their voxel, thinned to cells of its tangent plane.

Where a surface runs along the border of two layers of voxels, both have a patch of it, and both a
point in the same place. The two would count twice what lies near the border, a base that is fitted
to the points would be drawn there. So a patch keeps a cell's point with the share that its own
voxel has of the inliers there, by chance.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ladar_volume.math.array_types import F32, F64, I64, U64
from ladar_volume.math.hashing import mix_bits
from ladar_volume.math.kernels import inlined, kernel, leaf_kernel
from ladar_volume.math.normal_equations import basis
from ladar_volume.rmls.fit_store import Fits
from ladar_volume.rmls.tangent_frame import arc_height, polynomial_row, second_tangent
from ladar_volume.rmls.thinning_weights import COLUMNS, HASHES, column_of, steepest_axis
from ladar_volume.rmls.voxel_store import VoxelArrays

#: The column that a patch's own voxel lies in.
CENTRE = COLUMNS // 2


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


class PlaneCells(NamedTuple):
    """Points of a patch by cell of its tangent plane. cells : (cap, 2) · size : (cap,) points in
    each · place : (cap, 2) m, noise : (cap, 6) m² and time : (cap,) ns after that of the first,
    ``time0``, in sum · first : (cap,) hash of that · weight : (cap, 2) of the points, and of other
    voxels' points in the column
    """

    cells: I64
    size: I64
    place: F64
    noise: F64
    time0: I64
    time: I64
    first: U64
    weight: F64


@kernel
def _plane_cells(cap: int) -> PlaneCells:
    """Room for as many cells as a voxel has points."""
    return PlaneCells(
        np.empty((cap, 2), np.int64),
        np.zeros(cap, np.int64),
        np.zeros((cap, 2)),
        np.zeros((cap, 6)),
        np.zeros(cap, np.int64),
        np.zeros(cap, np.int64),
        np.zeros(cap, np.uint64),
        np.zeros((cap, 2)),
    )


@kernel
def _fill_cells(
    a: int, side: F64, store: VoxelArrays, fits: Fits, edge: float
) -> tuple[int, PlaneCells]:
    """The inliers of patch a that lie in its voxel, by cells of this edge, m; returns how many
    cells there are, and them.
    """
    into, x, m = _plane_cells(store.cap), np.zeros(6), 0
    cells, size, place = into.cells, into.size, into.place
    for i in range(fits.start[a], fits.start[a] + fits.used[a]):
        slot = fits.members[i]
        if slot // store.cap != fits.voxels[a]:
            continue
        polynomial_row(store.r, slot, fits.centre[a], fits.tangent[a], side, 3, x)
        cu, cv = np.int64(np.floor(x[1] / edge)), np.int64(np.floor(x[2] / edge))
        k = 0
        while k < m and (cells[k, 0] != cu or cells[k, 1] != cv):
            k += 1
        if k == m:
            cells[k, 0], cells[k, 1] = cu, cv
            into.time0[k], into.first[k] = store.t_ns[slot], store.hashes[slot]
            m += 1
        size[k] += 1
        into.weight[k, 0] += fits.weights[i]
        place[k, 0] += x[1]
        place[k, 1] += x[2]
        into.time[k] += store.t_ns[slot] - into.time0[k]
        for c in range(6):
            into.noise[k, c] += store.C[slot, c]
    return m, into


@kernel
def _weigh_column(
    a: int, side: F64, store: VoxelArrays, fits: Fits, edge: float, m: int, into: PlaneCells
) -> None:
    """Add to each of m cells the weights of those inliers of patch a that lie about its mean place,
    in a square of its size, and in the patch's column of voxels, but not in its voxel. Not those in
    the cell: a lone point lies at its patch's centre, where four cells meet.
    """
    x, own = np.zeros(6), fits.voxels[a]
    key, axis = store.keys[own], steepest_axis(fits.normal[a])
    last, beside = -1, False
    for i in range(fits.start[a], fits.start[a] + fits.used[a]):
        voxel = fits.members[i] // store.cap
        if voxel != last:
            last = voxel
            beside = voxel != own and column_of(store.keys[voxel], key, axis) == CENTRE
        if beside:
            polynomial_row(store.r, fits.members[i], fits.centre[a], fits.tangent[a], side, 3, x)
            for k in range(m):
                u, v = into.place[k, 0] / into.size[k], into.place[k, 1] / into.size[k]
                if abs(x[1] - u) <= 0.5 * edge and abs(x[2] - v) <= 0.5 * edge:
                    into.weight[k, 1] += fits.weights[i]


@leaf_kernel
def _keeps(first: np.uint64, weight: F64) -> Any:
    """Whether a voxel keeps the point of a cell of weights (2,): of it, and of others beside it.
    By the hash of its first point, whatever the rounding of its place.
    """
    if weight[1] == 0.0:
        return True
    chance = np.float64(mix_bits(first)) / HASHES
    return chance * (weight[0] + weight[1]) < weight[0]


@kernel
def _surface_at(
    u: float, v: float, beta: F64, C_beta: F32, p: int, x: F64
) -> tuple[float, float, float, float]:
    """Height of a patch over (u, v), its slopes along u and v, and the variance of the height; x :
    (6,) for the row.
    """
    basis(u, v, p, x)
    w, wu, wv, variance = 0.0, beta[1], beta[2], 0.0
    if p == 6:
        extra, gu, gv = arc_height(u, v, beta[3], beta[4], beta[5])
        w, wu, wv = w + extra, wu + gu, wv + gv
    for e in range(p):
        w += x[e] * beta[e]
        for f in range(p):
            variance += x[e] * C_beta[e, f] * x[f]
    return w, wu, wv, variance


@inlined
def _project_row(
    i_row: int,
    rows: I64,
    store: VoxelArrays,
    fits: Fits,
    C_beta: F32,
    p: int,
    edge: float,
    out: ProjectedArrays,
) -> None:
    """The filtered points of patch ``rows[i_row]``."""
    a = rows[i_row]
    n, t, s, x = fits.normal[a], fits.tangent[a], np.empty(3), np.zeros(6)
    second_tangent(n, t, s)
    found, cells = _fill_cells(a, s, store, fits, edge)
    _weigh_column(a, s, store, fits, edge, found, cells)
    for k in range(found):
        if not _keeps(cells.first[k], cells.weight[k]):
            continue
        i, size = i_row * store.cap + out.counts[i_row], cells.size[k]
        out.counts[i_row] += 1
        u, v = cells.place[k, 0] / size, cells.place[k, 1] / size
        w, wu, wv, variance = _surface_at(u, v, fits.beta[a], C_beta[i_row], p, x)
        slope = np.sqrt(1.0 + wu * wu + wv * wv)
        for c in range(3):
            out.r[i, c] = fits.centre[a, c] + u * t[c] + v * s[c] + w * n[c]
            out.normal[i, c] = (n[c] - wu * t[c] - wv * s[c]) / slope
        out.uv[i, 0], out.uv[i, 1] = u, v
        out.variance[i] = variance / (slope * slope)
        out.t_ns[i] = cells.time0[k] + cells.time[k] // size
        tangential_covariance(cells.noise[k], n, size, out.C[i])


@kernel
def project(
    index: I64,
    rows: I64,
    store: VoxelArrays,
    fits: Fits,
    C_beta: F32,
    p: int,
    edge: float,
    out: ProjectedArrays,
) -> None:
    """Project the own inliers of each patch of ``rows[index]``, and replace those in one cell of
    its tangent plane by their mean.

    Row i of every output belongs to patch ``rows[k]`` with i = k * cap + cluster.
    """
    for i_row in index:
        _project_row(i_row, rows, store, fits, C_beta, p, edge, out)


@kernel
def tangential_covariance(total: F64, n: F64, size: int, out: F32) -> None:
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
