"""Elevation adjustment of a partial TIN (seed 000 section 3.2): the heights of its vertices that
fit all points best.

With ``B`` the barycentric coordinates of the points in their (fixed) triangles, the surface at the
points is ``B h``. *RMS* adjustment minimises ``Σ w (z − B h)²``: by one sparse solve, or by the
published iteration, in which every vertex in turn takes the height that is best over its own
triangles (Gauss-Seidel on the same equations). The ASD adjustment stands in ``least_sizes``.

A vertex that no point in a relevant triangle depends on keeps its height. The data themselves are
never changed.
"""

from __future__ import annotations

import dataclasses
import inspect
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import cg, splu

from ladar_volume.math.equal_rows import first_equal
from ladar_volume.math.kernels import kernel
from ladar_volume.math.sparse_diagonal import diagonal_matrix
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I32, I64, Bool, Tin
from ladar_volume.tin.delaunay import finite_points
from ladar_volume.tin.insertion_order import hilbert_order
from ladar_volume.tin.locate import barycentric, locate, triangle_index

#: Above this number of vertices the factors of a direct solve outgrow the matrix; conjugate
#: gradients then reach the same digits.
MAX_DIRECT = 20_000
#: Relative tolerance of these; before SciPy 1.12 (Ubuntu 24.04 has 1.11) it had another name.
TOLERANCE: dict[str, Any] = {"rtol" if "rtol" in inspect.signature(cg).parameters else "tol": 1e-14}
#: Relative weight that holds a height to its old value where the points leave it undetermined.
RIDGE = 1e-12


@dataclass(frozen=True)
class SurfaceFit:
    """How a surface follows the points it represents.

    B : (k, n) sparse, barycentric coordinates of the k points inside relevant triangles · point :
    (k,) int64, their indices in the cloud · triangle : (k,) int64, triangle of each · z : (k,) m ·
    weight : (k,) · adjusted : (n,) bool, vertices that some point depends on
    """

    B: sparse.csr_array
    point: I64
    triangle: I64
    z: F64
    weight: F64
    adjusted: Bool

    def residuals(self, heights: F64) -> F64:
        """Vertical residuals (k,) m, data minus surface, for vertex heights (n,)."""
        out: F64 = self.z - self.B @ heights
        return out


@dataclass(frozen=True)
class Adjustment:
    """tin : the surface with its new heights · fit : what it was adjusted to · iterations : sweeps
    or reweightings (0 for a direct solve) · converged : whether the tolerance was reached · rms_m,
    asd_m : measures of fit (unweighted) after the adjustment · rms_before_m, asd_before_m : before
    """

    tin: Tin
    fit: SurfaceFit
    iterations: int
    converged: bool
    rms_m: float
    asd_m: float
    rms_before_m: float
    asd_before_m: float


def fit_of(tin: Tin, points_map: F64, sigma_m: F64 | None = None) -> SurfaceFit:
    """The points (m, 3), m, map frame, in the relevant triangles of a surface; weights ``1 /
    sigma²`` where ``sigma_m`` (m,) is given.

    Raises :class:`SurfaceError` for a wrong shape, a value that is not finite, a sigma that is not
    positive, or no point inside.
    """
    points, sigma = checked(points_map, sigma_m)
    vertex = vertices_at_points(tin, points)
    where = lowest_kernel(tin.triangles, tin.relevant, len(tin.vertices))[vertex]
    rest = np.flatnonzero(vertex < 0)
    rest = rest[hilbert_order(points[rest, :2])]  # neighbours in turn are found faster
    if len(rest):
        where[rest] = locate(triangle_index(tin, tin.relevant), points[rest, :2])
    point = np.flatnonzero(where >= 0)
    if len(point) == 0:
        raise SurfaceError("no point lies in a relevant triangle", reason="surface_no_point")
    B = coordinates_of(tin, points[point, :2], where[point], vertex[point])
    adjusted = np.bincount(B.indices, B.data**2, len(tin.vertices)) > 0
    return SurfaceFit(B, point, where[point], points[point, 2], sigma[point] ** -2.0, adjusted)


def checked(points_map: F64, sigma_m: F64 | None) -> tuple[F64, F64]:
    """Points (m, 3) m and their standard deviations (m,), 1 where there are none. Raises as
    :func:`fit_of` does.
    """
    points = finite_points(points_map)
    sigma = np.ones(len(points)) if sigma_m is None else np.asarray(sigma_m, dtype=np.float64)
    if sigma.shape != (len(points),) or not (np.isfinite(sigma) & (sigma > 0)).all():
        raise SurfaceError(
            "every point needs a positive standard deviation", reason="surface_sigma"
        )
    return points, sigma


def fit_of_shared(tin: Tin, points_map: F64, sigma_m: F64 | None = None) -> tuple[SurfaceFit, int]:
    """:func:`fit_of` of a surface through all points, without those that are alone at their vertex
    and fit it exactly; and how many points it has with them. Where a point is no vertex, as one
    left out that a relevant triangle holds, it is that of all.
    """
    points, sigma = checked(points_map, sigma_m)
    vertex, n = vertices_at_points(tin, points), len(tin.vertices)
    first = lowest_kernel(tin.triangles, tin.relevant, n)
    rest = np.flatnonzero(vertex < 0)
    if len(rest) and (locate(triangle_index(tin, tin.relevant), points[rest, :2]) >= 0).any():
        fit = fit_of(tin, points, sigma_m)
        return fit, len(fit.point)
    several = np.bincount(vertex[vertex >= 0], minlength=n) > 1
    several &= first[:n] >= 0
    point = np.flatnonzero(np.append(several, False)[vertex])
    at = vertex[point].astype(np.int32)
    entries = (np.ones(len(at)), at, np.arange(len(at) + 1))
    B = sparse.csr_array(entries, shape=(len(at), n))
    count = int(np.count_nonzero(first[vertex] >= 0))
    return SurfaceFit(B, point, first[at], points[point, 2], sigma[point] ** -2.0, several), count


def vertices_at_points(tin: Tin, points: F64) -> I64:
    """The vertex (m,) that stands where each of points (m, 3) does, -1 for none."""
    out = np.full(len(points), -1, np.int64)
    own = np.flatnonzero((tin.source >= 0) & (tin.source < len(points)))
    at = tin.source[own]
    same = np.ones(len(own), bool)
    for k in range(2):
        same &= tin.vertices[own, k] == points[at, k]
    out[at[same]] = own[same]
    rest = np.flatnonzero(out < 0)
    if len(rest):
        # few, as a rule: where one of these stands is looked for among all vertices
        first = first_equal(np.concatenate([points[rest, :2], tin.vertices[:, :2]]), len(rest))
        here = np.flatnonzero(first[len(rest) :] < len(rest))
        at = np.full(len(rest), -1, np.int64)
        at[first[len(rest) + here]] = here
        out[rest] = at[first[: len(rest)]]
    return out


@kernel
def lowest_kernel(triangles: I32, relevant: Bool, n: int) -> I64:
    """The first relevant triangle (n + 1,) at each of n vertices; -1 where there is none, as for
    the last, which is no vertex.
    """
    out = np.full(n + 1, -1, np.int64)
    for t in range(len(triangles) - 1, -1, -1):
        if relevant[t]:
            for k in range(3):
                out[triangles[t, k]] = t
    return out


def coordinates_of(tin: Tin, xy: F64, triangle: I64, vertex: I64) -> sparse.csr_array:
    """Barycentric coordinates (k, n), sparse, of points (k, 2) in their triangles (k,); of those
    that are a vertex (k,), -1 for none, without a computation.
    """
    start = np.r_[0, np.cumsum(np.where(vertex >= 0, 1, 3))]
    column, value = np.empty(start[-1], np.int32), np.ones(start[-1])
    known, rest = np.flatnonzero(vertex >= 0), np.flatnonzero(vertex < 0)
    column[start[known]] = vertex[known]
    place = start[rest, None] + np.arange(3)
    column[place] = tin.triangles[triangle[rest]]
    value[place] = barycentric(tin, triangle[rest], xy[rest])
    B = sparse.csr_array((value, column, start), shape=(len(xy), len(tin.vertices)))
    B.sort_indices()
    B.eliminate_zeros()
    return B


def measures(residuals: F64, count: int | None = None) -> tuple[float, float]:
    """Measures of fit (seed 000 section 2.3): root mean square and average size of residuals (k,),
    m; ``count`` points in all, where others fit exactly.
    """
    k = max(len(residuals), 1) if count is None else count
    return float(np.sqrt(np.sum(residuals**2) / k)), float(np.sum(np.abs(residuals)) / k)


class Normal:
    """The normal equations ``BᵀWB`` of a fit, ready to be solved for any right-hand side. The
    factors have room for ``pairs`` (k, 2) of vertices too, whether a point joins them or not.
    """

    def __init__(
        self, B: sparse.csr_array, weight: F64, direct: bool = False, pairs: I64 | None = None
    ) -> None:
        self.factor = self.matrix = None
        # points that each hang on one vertex have means, and nothing to be solved
        means = not direct and int(np.diff(B.indptr).max(initial=0)) <= 1
        N = None if means else (B.T @ diagonal_matrix(weight) @ B).tocsc()
        diagonal = np.asarray(B.power(2).T @ weight).reshape(-1) if N is None else N.diagonal()
        self.free: Bool = diagonal > 0
        self.scale = np.where(self.free, diagonal, 1.0) ** -0.5
        if N is None:
            return
        S = diagonal_matrix(self.scale)
        self.matrix = (S @ N @ S + diagonal_matrix(np.where(self.free, RIDGE, 1.0))).tocsc()
        if pairs is not None:  # entries too small to matter, but there
            room = sparse.coo_array(
                (np.full(len(pairs), 1e-280), (pairs[:, 0], pairs[:, 1])), shape=N.shape
            )
            self.matrix = (self.matrix + room + room.T).tocsc()
        options = {"SymmetricMode": True}
        direct = direct or len(diagonal) <= MAX_DIRECT
        if direct:
            self.factor = splu(
                self.matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options
            )

    def solve(self, right: F64) -> F64:
        """Solution (n,) for a right-hand side (n,); zero at vertices without data."""
        b = np.where(self.free, right * self.scale, 0.0)
        x = b
        if self.factor is not None:
            x = self.factor.solve(b)
        elif self.matrix is not None:
            x, info = cg(self.matrix, b, atol=0.0, maxiter=5000, **TOLERANCE)
            if info != 0:
                raise SurfaceError(
                    "the adjustment did not converge", reason="surface_adjustment", value=info
                )
        out: F64 = self.scale * x
        return out


def adjustment_record(
    tin: Tin, fit: SurfaceFit, heights: F64, iterations: int, converged: bool
) -> Adjustment:
    """The record of an adjustment."""
    new = tin
    if not np.array_equal(heights, tin.vertices[:, 2]):
        new = dataclasses.replace(tin, vertices=np.c_[tin.vertices[:, :2], heights])
    after, before = measures(fit.residuals(heights)), measures(fit.residuals(tin.vertices[:, 2]))
    return Adjustment(new, fit, iterations, converged, *after, *before)


def adjust_rms(
    tin: Tin, points_map: F64, sigma_m: F64 | None = None, fit: SurfaceFit | None = None
) -> Adjustment:
    """The heights with the least weighted sum of squared vertical residuals, by one sparse solve
    (see :func:`fit_of`).
    """
    fit = fit_of(tin, points_map, sigma_m) if fit is None else fit
    z = tin.vertices[:, 2]
    change = Normal(fit.B, fit.weight).solve(fit.B.T @ (fit.weight * fit.residuals(z)))
    return adjustment_record(tin, fit, z + change, 0, True)


@kernel
def sweep(start: I64, row: I64, value: F64, weight: F64, residual: F64, heights: F64) -> float:
    """One step of the published iteration: every vertex in turn takes its best height. Points of
    vertex v are entries start[v] to start[v + 1] of ``row``, ``value``. Changes ``residual`` and
    ``heights``; returns the largest change, m.
    """
    largest = 0.0
    for v in range(len(heights)):
        top = bottom = 0.0
        for i in range(start[v], start[v + 1]):
            wb = weight[row[i]] * value[i]
            top += wb * residual[row[i]]
            bottom += wb * value[i]
        if bottom > 0.0:
            change = top / bottom
            heights[v] += change
            for i in range(start[v], start[v + 1]):
                residual[row[i]] -= value[i] * change
            largest = max(largest, abs(change))
    return largest


def sweep_plain(B: F64, weight: F64, residual: F64, heights: F64) -> float:
    """The plain numpy twin of :func:`sweep`, with dense B (k, n)."""
    largest = 0.0
    for v in np.flatnonzero((B != 0).any(axis=0)):
        b = B[:, v]
        change = float((weight * b) @ residual / ((weight * b) @ b))
        heights[v] += change
        residual -= b * change
        largest = max(largest, abs(change))
    return largest


def adjust_rms_by_iteration(
    tin: Tin,
    points_map: F64,
    max_iterations: int = 100,
    tolerance_m: float = 1e-4,
    sigma_m: F64 | None = None,
    fit: SurfaceFit | None = None,
) -> Adjustment:
    """RMS adjustment by the published iteration. It ends after ``max_iterations`` steps, or when no
    height changed by as much as ``tolerance_m`` (m) during a step; ``converged`` tells which.
    """
    if max_iterations < 0 or not tolerance_m >= 0:
        raise SurfaceError(
            "iterations and tolerance must be 0 or more",
            reason="surface_tolerance",
            value=(max_iterations, tolerance_m),
        )
    fit = fit_of(tin, points_map, sigma_m) if fit is None else fit
    columns = fit.B.tocsc()
    start, row = columns.indptr.astype(np.int64), columns.indices.astype(np.int64)
    heights = tin.vertices[:, 2].copy()
    residual = fit.residuals(heights)
    done, converged = 0, False
    while done < max_iterations and not converged:
        converged = sweep(start, row, columns.data, fit.weight, residual, heights) < tolerance_m
        done += 1
    return adjustment_record(tin, fit, heights, done, converged)


@kernel
def add_held(g: F64, source: I64, adjusted: Bool, out: F64) -> None:
    """Add rows of g (n, r) of the vertices that were not ``adjusted`` (n,) to those of the points
    (points, r) that they come from.
    """
    for v in range(len(source)):
        if not adjusted[v] and source[v] >= 0:
            for c in range(g.shape[1]):
                out[source[v], c] += g[v, c]


def raw_gradient(tin: Tin, fit: SurfaceFit, gradient_z: F64, points: int) -> F64:
    """From a gradient by the adjusted heights to one by the raw heights: the adjoint of the RMS
    adjustment, one sparse solve.

    gradient_z : (n,) or (n, r), derivatives of r results by the vertex heights · points : number of
    points in the cloud. Returns (points,) or (points, r): ``W B (BᵀWB)⁻¹ g``, and for a vertex that
    was not adjusted g at the point it came from. The variance of a result is then ``Σ_j s_j²
    sigma_j²`` for independent raw heights (UNCERTAINTY step 5).
    """
    g = np.asarray(gradient_z, dtype=np.float64).reshape(len(tin.vertices), -1)
    out = np.zeros((points, g.shape[1]))
    if fit.B.nnz:
        normal = Normal(fit.B, fit.weight)
        for c in range(g.shape[1]):
            out[fit.point, c] = fit.weight * (fit.B @ normal.solve(g[:, c]))
    add_held(g, tin.source, fit.adjusted, out)
    return out if np.ndim(gradient_z) == 2 else out[:, 0]
