"""How an RMS-adjusted surface follows the raw points in all three directions (UNCERTAINTY step 5),
and the covariance of its heights.

With ``N = BᵀWB``, ``y = N⁻¹ g`` and residuals r, a result with gradient g by the adjusted heights
changes by

    ``dV = Σ_j w_j (B y)_j (dz_j − (dB h)_j) + w_j r_j (dB y)_j``,

and a point or vertex that moves sideways changes B as the slopes of the surfaces h and y under it
say. The triangulation is held fixed; a common shift of points and vertices then moves the surface
and nothing else.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from ladar_volume.math.equal_rows import distinct_cells
from ladar_volume.math.kernels import kernel
from ladar_volume.math.sparse_diagonal import diagonal_matrix
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I32, I64, Tin
from ladar_volume.tin.elevation_adjustment import Normal, SurfaceFit


@kernel
def slope_kernel(vertices: F64, triangles: I32, heights: F64) -> F64:
    """See :func:`triangle_slopes`."""
    out = np.zeros((len(triangles), 2))
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ux, uy = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1]
        vx, vy = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1]
        du, dv = heights[b] - heights[a], heights[c] - heights[a]
        twice = ux * vy - uy * vx
        if twice > 0.0:
            out[t, 0] = (du * vy - dv * uy) / twice
            out[t, 1] = (dv * ux - du * vx) / twice
    return out


def triangle_slopes(tin: Tin, heights: F64) -> F64:
    """Slopes (m, 2) of the plane over each triangle for vertex heights (n,); zero for slivers whose
    area rounds to nothing.
    """
    return np.asarray(slope_kernel(tin.vertices, tin.triangles, np.ascontiguousarray(heights)))


def raw_gradients(tin: Tin, fit: SurfaceFit, gradient: F64, points: int) -> F64:
    """From gradients (n, k, 3) of k results by the adjusted vertices to gradients (points, k, 3) by
    the raw points.

    ``tin`` is the adjusted surface. The sideways part of a vertex goes to the point it was made
    from; a vertex that was not adjusted gives its whole gradient to that point, an artificial
    corner gives it to nobody.
    """
    normal, h = Normal(fit.B, fit.weight), tin.vertices[:, 2]
    weighted, slope = fit.weight * fit.residuals(h), triangle_slopes(tin, h)[fit.triangle]
    out = np.zeros((points, gradient.shape[1], 3))
    own = np.flatnonzero(tin.source >= 0)
    held = own[~fit.adjusted[own]]
    for c in range(gradient.shape[1]):
        y = normal.solve(gradient[:, c, 2])
        vertical = fit.weight * (fit.B @ y)
        sideways = (
            weighted[:, None] * triangle_slopes(tin, y)[fit.triangle] - vertical[:, None] * slope
        )
        out[fit.point, c, :2], out[fit.point, c, 2] = sideways, vertical
        moved = gradient[:, c, :2] - fit.B.T @ sideways
        out[tin.source[own], c, :2] += moved[own]
        out[tin.source[held], c, 2] += gradient[held, c, 2]
    return out


@kernel
def selected_inverse(start: I64, row: I64, value: F64, diagonal: F64) -> tuple[F64, F64]:
    """Entries of ``(L D Lᵀ)⁻¹`` where the strict lower triangle L has entries (CSC: start, row,
    value), and its diagonal (n,).

    Takahashi, Fagan & Chin 1973: column by column from the last, each from those after it.
    """
    n = len(diagonal)
    off, own = np.zeros(len(row)), np.zeros(n)
    at = np.full(n, -1, np.int64)
    for j in range(n - 1, -1, -1):
        for a in range(start[j], start[j + 1]):
            at[row[a]] = a
        for a in range(start[j], start[j + 1]):
            k = row[a]
            off[a] -= value[a] * own[k]
            for b in range(start[k], start[k + 1]):
                other = at[row[b]]
                if other >= 0:
                    off[other] -= value[a] * off[b]
                    off[a] -= value[other] * off[b]
        own[j] = 1.0 / diagonal[j]
        for a in range(start[j], start[j + 1]):
            own[j] -= value[a] * off[a]
            at[row[a]] = -1
    return off, own


def height_covariance(tin: Tin, fit: SurfaceFit, unadjusted_m2: F64) -> Any:
    """Covariance (n, n), sparse, of the adjusted heights for points with independent variances ``1
    / weight``, m²: its diagonal and the pairs joined by an edge, exactly; other pairs are left out.
    Vertices that were not adjusted have the variance ``unadjusted_m2`` (n,).

    Raises :class:`SurfaceError` where the equations cannot be factored.
    """
    t, n = tin.triangles, len(tin.vertices)
    if int(np.diff(fit.B.indptr).max(initial=0)) <= 1:  # every point at a vertex: means of points
        N = np.asarray(fit.B.power(2).T @ fit.weight).reshape(-1)
        known = np.where(fit.adjusted, 1.0 / np.where(N > 0, N, 1.0), unadjusted_m2)
        return diagonal_matrix(known)
    sides = np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), axis=1)
    pairs = sides[distinct_cells(sides)[0]]
    normal = Normal(fit.B, fit.weight, direct=True, pairs=pairs)
    factor = normal.factor
    if factor is None or not np.array_equal(factor.perm_r, factor.perm_c):
        raise SurfaceError(
            "the equations of the adjustment cannot be factored", reason="surface_adjustment"
        )
    place, diagonal = factor.perm_c, factor.U.diagonal()
    lower = sparse.tril(factor.L, -1, format="csc")
    lower.sort_indices()
    start, row = lower.indptr.astype(np.int64), lower.indices.astype(np.int64)
    off, own = selected_inverse(start, row, lower.data, diagonal)
    i, j = place[pairs[:, 0]], place[pairs[:, 1]]
    value = (
        entries(start, row, off, np.minimum(i, j), np.maximum(i, j))
        * normal.scale[pairs[:, 0]]
        * normal.scale[pairs[:, 1]]
    )
    value[~(normal.free[pairs[:, 0]] & normal.free[pairs[:, 1]])] = 0.0
    variance = np.where(fit.adjusted, own[place] * normal.scale**2, unadjusted_m2)
    upper = sparse.coo_array((value, (pairs[:, 0], pairs[:, 1])), shape=(n, n)).tocsr()
    return sparse.csr_array(upper + upper.T + diagonal_matrix(variance))


def entries(start: I64, row: I64, value: F64, column: I64 | I32, wanted: I64 | I32) -> F64:
    """Entries (k,) of a matrix in CSC form with ascending rows: at ``wanted`` (k,) rows of
    ``column`` (k,); 0 where there is none.
    """
    n = len(start) - 1
    keys = np.repeat(np.arange(n, dtype=np.int64), np.diff(start)) * n + row
    at = np.minimum(
        np.searchsorted(keys, column.astype(np.int64) * n + wanted), max(len(keys) - 1, 0)
    )
    if not len(keys):
        return np.zeros(len(wanted))
    out: F64 = np.where(keys[at] == column.astype(np.int64) * n + wanted, value[at], 0.0)
    return out
