"""What neighbouring vertices of a filtered surface have in common of the noise of the returns
(UNCERTAINTY steps 3 and 7).

A filtered height is ``x·beta`` of its patch, and patches share returns: ``cov(h_i, h_j) = x_iᵀ C_ab
x_j``, divided by the vertical components of both normals. An adjusted height of a partial TIN is
taken as that of its own point: the points it is a mean of lie on the same patches.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy import sparse

from ladar_volume.math.kernels import kernel, leaf_kernel
from ladar_volume.math.large_arrays import large_zeros, taken
from ladar_volume.math.sparse_diagonal import diagonal_matrix
from ladar_volume.model.records import (
    F32,
    F64,
    I8,
    I32,
    I64,
    LEAST_UPWARD,
    Bool,
    FilteredPoints,
    PatchTable,
    Tin,
)
from ladar_volume.uncertainty.packing import factor_rows
from ladar_volume.uncertainty.propagation import SurfaceGeometry

#: Rings of a neighbourhood of independent heights, and the most for heights that share noise.
RINGS, MOST_RINGS = 4, 12


def upward(points: FilteredPoints, rows: I64) -> F64:
    """Vertical components (k,) of the normals of some points (k,), no less than of a wall."""
    out: F64 = taken(points.normal[:, 2], rows)
    return np.maximum(np.abs(out, out=out), LEAST_UPWARD, out=out)


def vertex_rows(
    tin: Tin, points: FilteredPoints, patches: PatchTable, geometry: SurfaceGeometry
) -> tuple[F64, I64]:
    """Rows (n, p) that give each vertex' height from that of its patch whose covariances the blocks
    are, and that patch (n,).
    """
    row, X = taken(geometry.row, tin.source), geometry.design(tin.source)
    X /= upward(points, tin.source)[:, None]
    return factor_rows(X, row, patches), row


def corner_covariances(
    patches: PatchTable, geometry: SurfaceGeometry, X: F64, row: I64, variance: F64, triangles: I32
) -> F64:
    """Packed covariances (k, 6) m² of the heights at the corners of ``triangles`` (k, 3), for their
    variances (n,).

    X, row : see :func:`vertex_rows`.
    """
    return np.asarray(
        corner_kernel(
            triangles, variance, row, X, patches.cross_start, geometry.right, patches.cross
        )
    )


def height_pairs(
    tin: Tin,
    patches: PatchTable,
    geometry: SurfaceGeometry,
    X: F64,
    row: I64,
    variance: F64,
    triangles: I32,
) -> Any:
    """Covariance (n, n), sparse, m², of the vertex heights: their variances (n,), and the pairs
    that edges of ``triangles`` (m, 3) join.

    X, row : see :func:`vertex_rows`.
    """
    n = len(tin.vertices)
    pairs = np.concatenate(
        [triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]
    ).astype(np.int64)
    one, two = np.divmod(np.unique(pairs.min(axis=1) * n + pairs.max(axis=1)), n)
    value, shared = pair_kernel(
        one, two, row, X, patches.cross_start, geometry.right, patches.cross
    )
    upper = sparse.coo_array((value[shared], (one[shared], two[shared])), shape=(n, n)).tocsr()
    return sparse.csr_array(upper + upper.T + diagonal_matrix(variance))


@leaf_kernel
def height_product(
    i: int, j: int, row: I64, X: F64, start: I64, right: I32, cross: F32 | I8
) -> tuple[float, bool]:
    """``x_i C x_j`` of two vertices, and whether there is such a block: see :func:`pair_kernel`."""
    if row[i] > row[j]:
        i, j = j, i
    for b in range(start[row[i]], start[row[i] + 1]):
        if right[b] == row[j]:
            value = 0.0
            for a in range(X.shape[1]):
                for c in range(X.shape[1]):
                    value += X[i, a] * cross[b, a, c] * X[j, c]
            return value, True
    return 0.0, False


@kernel
def pair_kernel(
    one: I64, two: I64, row: I64, X: F64, start: I64, right: I32, cross: F32 | I8
) -> tuple[F64, Bool]:
    """``x_i C x_j`` (k,) of vertices one and two (k,) on patches row (n,) by design rows X (n, p),
    and whether there is such a block.

    start : (m + 1,) of each patch's blocks · right : (b,) the other patch of each, -1 where that is
    not known
    """
    value, shared = np.zeros(len(one)), np.zeros(len(one), np.bool_)
    for e in range(len(one)):
        value[e], shared[e] = height_product(one[e], two[e], row, X, start, right, cross)
    return value, shared


@kernel
def corner_kernel(
    triangles: I32, variance: F64, row: I64, X: F64, start: I64, right: I32, cross: F32 | I8
) -> F64:
    """See :func:`corner_covariances`; the rest as in :func:`pair_kernel`."""
    out = np.empty((len(triangles), 6))
    for t in range(len(triangles)):
        k = 0
        for a in range(3):
            out[t, k] = variance[triangles[t, a]]
            for b in range(a + 1, 3):
                out[t, k + b - a] = height_product(
                    triangles[t, a], triangles[t, b], row, X, start, right, cross
                )[0]
            k += 3 - a
    return out


def height_sums(
    patches: PatchTable, geometry: SurfaceGeometry, X: F64, row: I64, chosen: I64, variance: F64
) -> tuple[F64, float]:
    """Sums (n,) m² of the covariances of each of the ``chosen`` (k,) vertices' heights with all
    heights, and how many heights share their noise: the median of sum over variance, which stands
    for the vertices that are not chosen.
    """
    m, p = len(patches), X.shape[1]
    load: F64 = large_zeros((m, p))
    for k in range(p):
        load[:, k] = np.bincount(row, X[:, k], m)
    touched = np.zeros(m, bool)
    touched[row[chosen]] = True
    total = sum_kernel(patches.cross_start, geometry.right, patches.cross, load, touched)
    own = np.maximum((X[chosen] * total[row[chosen]]).sum(axis=1), 0.0)
    alike = (
        max(1.0, float(np.median(own / np.maximum(variance[chosen], 1e-300))))
        if len(chosen)
        else 1.0
    )
    out = large_zeros(variance.shape)
    np.multiply(alike, variance, out=out)
    out[chosen] = own
    return out, alike


@kernel
def sum_kernel(start: I64, right: I32, cross: F32 | I8, load: F64, touched: Bool) -> F64:
    """``Σ_b C_ab f_b`` (m, p) over all patches b of those ``touched`` (m,), for loads f (m, p) and
    the blocks of :func:`pair_kernel`.
    """
    p, out = load.shape[1], np.zeros(load.shape)
    for a in range(len(load)):
        for e in range(start[a], start[a + 1]):
            b = right[e]
            if b < 0:
                continue
            if touched[a]:
                for r in range(p):
                    for c in range(p):
                        out[a, r] += cross[e, r, c] * load[b, c]
            if touched[b] and b != a:
                for r in range(p):
                    for c in range(p):
                        out[b, c] += cross[e, r, c] * load[a, r]
    return out


def rings_for(alike: float) -> int:
    """Rings of a neighbourhood where ``alike`` heights share their noise: for nearly as many
    independent heights as :data:`RINGS` hold.
    """
    return int(min(MOST_RINGS, max(RINGS, math.ceil(0.75 * RINGS * math.sqrt(alike)))))
