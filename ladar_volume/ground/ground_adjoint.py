"""From the derivative of a result by a fitted ground to its gradient by the ground points
(UNCERTAINTY step 2).
"""

from __future__ import annotations

import numpy as np

from ladar_volume.ground.heights import solve_points
from ladar_volume.ground.polynomial import degree_of
from ladar_volume.math.kernels import kernel
from ladar_volume.model.records import F64, I64, Plane


def ground_inverse(points: F64, plane: Plane) -> F64:
    """``N = (XᵀX)⁻¹`` (p, p) of the points (n, 3) ``plane.support``: coefficients follow heights by
    ``N Xᵀ``. Raises as :func:`~ladar_volume.ground.polynomial.inverse_root`.
    """
    inside = np.zeros(len(points), np.bool_)
    inside[plane.support] = True
    return solve_points(points, inside, plane.origin_xy, degree_of(plane))[1]


@kernel
def fill_rows(x: float, y: float, row: F64, east: F64, north: F64) -> None:
    """The design row at (x, y) and its derivatives by both, each (p,): every power from the ones
    before.
    """
    row[0], east[0], north[0] = 1.0, 0.0, 0.0
    c, k = 1, 1
    while c < len(row):
        for j in range(k):  # all of one power less, times x
            east[c + j] = east[c - k + j] * x + row[c - k + j]
            north[c + j] = north[c - k + j] * x
            row[c + j] = row[c - k + j] * x
        east[c + k] = east[c - 1] * y
        north[c + k] = north[c - 1] * y + row[c - 1]
        row[c + k] = row[c - 1] * y
        c, k = c + k + 1, k + 1


@kernel
def gradient_kernel(
    points: F64, support: I64, place: I64, origin: F64, beta: F64, by_sums: F64, out: F64
) -> None:
    """Adds to out (m, k, 3) the gradients of k results by the points (n, 3) ``support`` (s,), each
    at its place (n,) there, none below zero. by_sums : (p, k) derivatives of the results by the
    sums ``Xᵀz``.
    """
    p, results = by_sums.shape
    row, east, north = np.empty(p), np.empty(p), np.empty(p)
    for s in support:
        fill_rows(points[s, 0] - origin[0], points[s, 1] - origin[1], row, east, north)
        residual, slope_x, slope_y, at = points[s, 2], 0.0, 0.0, place[s]
        for c in range(p):
            residual -= row[c] * beta[c]
            slope_x += east[c] * beta[c]
            slope_y += north[c] * beta[c]
        if at < 0:
            continue
        for k in range(results):
            x = y = z = 0.0
            for c in range(p):
                x += east[c] * by_sums[c, k]
                y += north[c] * by_sums[c, k]
                z += row[c] * by_sums[c, k]
            out[at, k, 0] += residual * x - slope_x * z
            out[at, k, 1] += residual * y - slope_y * z
            out[at, k, 2] += z


@kernel
def residual_kernel(
    points: F64, support: I64, origin: F64, beta: F64, by_sums: F64, xy: F64, weight: F64
) -> F64:
    """Heights (s,) m of the points (n, 3) ``support`` (s,) above a surface; their places into xy
    (s, 2), and the derivatives of a result by their heights into weight (s,). by_sums : (p,) its
    derivatives by the sums ``Xᵀz``.
    """
    p = len(beta)
    row, east, north, residual = np.empty(p), np.empty(p), np.empty(p), np.empty(len(support))
    for i in range(len(support)):
        x, y, z = points[support[i]]
        fill_rows(x - origin[0], y - origin[1], row, east, north)
        total = 0.0
        for c in range(p):
            z -= row[c] * beta[c]
            total += row[c] * by_sums[c]
        xy[i, 0], xy[i, 1], residual[i], weight[i] = x, y, z, total
    return residual


def ground_residuals(
    points: F64, plane: Plane, by_beta: F64, inverse: F64 | None = None
) -> tuple[F64, F64, F64]:
    """Of the points ``plane.support`` (s,) among (n, 3) m: their places (s, 2) m, heights above the
    plane (s,) m, and the derivatives (s,) of a result by their heights, inliers held fixed: the
    vertical part of :func:`ground_gradient`.

    by_beta : (p,) derivatives of the result by beta · inverse : :func:`ground_inverse`, where
    known.
    """
    N, s = ground_inverse(points, plane) if inverse is None else inverse, plane.support
    xy, weight = np.empty((len(s), 2)), np.empty(len(s))
    residual = residual_kernel(
        np.ascontiguousarray(points), s, plane.origin_xy, plane.beta, N @ by_beta, xy, weight
    )
    return xy, np.asarray(residual), weight


def add_ground_gradient(
    out: F64, place: I64, points: F64, plane: Plane, by_beta: F64, inverse: F64 | None = None
) -> None:
    """Adds to out (m, k, 3) the gradients of k results by the points ``plane.support`` (s,),
    inliers held fixed, each at its place (n,) there, none below zero.

    points : (n, 3) m that ``support`` indexes · by_beta : (p, k) derivatives of the results by beta
    · inverse : :func:`ground_inverse`, where known. The vertical part is ``dV/dbeta H``, the
    horizontal one ``−slope`` times it plus the term in which the design moves under the residual:
    with it a common shift or yaw cancels exactly.
    """
    if len(plane.support):
        by_sums = np.ascontiguousarray(
            (ground_inverse(points, plane) if inverse is None else inverse) @ by_beta
        )
        gradient_kernel(
            np.ascontiguousarray(points),
            plane.support,
            place,
            plane.origin_xy,
            plane.beta,
            by_sums,
            out,
        )


def ground_gradient(points: F64, plane: Plane, by_beta: F64) -> F64:
    """Gradients (s, k, 3) of k results by the points ``plane.support`` (s,): see
    :func:`add_ground_gradient`.
    """
    s = plane.support
    out, place = np.zeros((len(s), by_beta.shape[1], 3)), np.full(len(points), -1)
    place[s] = np.arange(len(s))
    add_ground_gradient(out, place, points, plane, by_beta)
    return out
