"""Plain numpy twins of the compiled fit: the same quantities for given inliers, written for
reading, not for speed.

Tests compare the kernels with them; nothing else uses them.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.georeference.point_jacobian import (
    full_calibration_jacobian,
    navigation_jacobian,
    point_geometry,
)
from ladar_volume.math.packed_covariance import unpack
from ladar_volume.math.se3 import matrix_from_quaternion, slerp
from ladar_volume.model.parameters import CalibrationParameters
from ladar_volume.model.records import F64, I64, Bool, MappedPoints, PlatformStates
from ladar_volume.rmls.tangent_frame import STEEPEST


def design(r_map: F64, centre: F64, normal: F64, tangent: F64, degree: int) -> tuple[F64, F64]:
    """Rows ``x(u, v)`` (n, 3 or 6) and heights w (n,) m of points (n, 3) in a patch's frame (see
    ``records.Patches``).
    """
    u, v, w = ((r_map - centre) @ axis for axis in (tangent, np.cross(normal, tangent), normal))
    columns = [np.ones_like(u), u, v]
    if degree == 2:
        columns += [u * u, u * v, v * v]
    return np.stack(columns, axis=-1), w


def arc(X: F64, beta: F64) -> tuple[F64, F64, F64]:
    """Height (n,) of the constant-curvature surface above its osculating quadric, and the slopes
    (n,) along u and v of the whole surface, at design rows X (n, 6); see
    ``tangent_frame.arc_height``. Zero height and the plane's slopes for rows (n, 3).
    """
    if X.shape[1] == 3:
        return np.zeros(len(X)), np.full(len(X), beta[1]), np.full(len(X), beta[2])

    def height(u: F64, v: F64) -> F64:
        square = (2 * beta[3] * u + beta[4] * v) ** 2 + (beta[4] * u + 2 * beta[5] * v) ** 2
        t = np.clip(square, 1e-12, STEEPEST)
        out: F64 = (
            (beta[3] * u * u + beta[4] * u * v + beta[5] * v * v) * 2 * (1 - np.sqrt(1 - t)) / t
        )
        return out

    u, v, h = X[:, 1], X[:, 2], 1e-6
    gu, gv = (
        (height(u + h, v) - height(u - h, v)) / (2 * h),
        (height(u, v + h) - height(u, v - h)) / (2 * h),
    )
    return height(u, v) - X[:, 3:] @ beta[3:], beta[1] + gu, beta[2] + gv


def thinning_weights(voxels: I64, stands: F64, normal: F64) -> F64:
    """Weights (n,) of points in voxels (n, 3) of which each stands for so many (n,), by columns of
    voxels along the axis nearest to the normal (see ``rmls/thinning_weights``).
    """
    across = np.delete(voxels, np.argmax(np.abs(normal)), axis=1)
    weights: F64 = np.ones(len(voxels))
    for column in np.unique(across, axis=0):
        own = (across == column).all(axis=1)
        weights[own] = stands[own] / float(stands[own].mean())
    return weights


def least_squares(X: F64, w: F64, weights: F64) -> tuple[F64, F64]:
    """``beta`` (p,) and ``(XᵀWX)⁻¹`` (p, p) by QR."""
    root: F64 = np.sqrt(weights)
    Q, R = np.linalg.qr(root[:, None] * X)
    back = np.linalg.inv(R)
    return back @ (Q.T @ (root * w)), back @ back.T


def solution(X: F64, weights: F64) -> F64:
    """``(XᵀWX)⁻¹ XᵀW`` (p, n)."""
    root: F64 = np.sqrt(weights)
    out: F64 = np.linalg.pinv(root[:, None] * X) * root
    return out


def shared_covariance(
    solutions: tuple[F64, F64], normals: tuple[F64, F64], ids: tuple[I64, I64], C_ind: F64
) -> F64:
    """``C_ab`` (p, p) m² of two patches by their :func:`solution`, with inliers ``ids`` into C_ind
    (n, 6) packed m² (UNCERTAINTY step 3).
    """
    _, at_a, at_b = np.intersect1d(*ids, return_indices=True)
    variance = np.einsum("i,nij,j->n", normals[0], unpack(C_ind[ids[0][at_a]]), normals[1])
    out: F64 = (solutions[0][:, at_a] * variance) @ solutions[1][:, at_b].T
    return out


def mean_sensitivities(
    X: F64,
    weights: F64,
    frame: tuple[F64, F64],
    points: MappedPoints,
    states: PlatformStates,
    calibration: CalibrationParameters,
    beams: int,
    bin_ns: int,
) -> tuple[F64, I64, F64]:
    """``M_cal`` (p + 2, 11 + 2 beams), time bins (l,) and ``M_nav`` (l, p + 2, 4) of one patch with
    inliers ``points`` of these weights (UNCERTAINTY step 4). frame : its normal and tangent
    """
    normal, tangent = frame
    geometry = point_geometry(points, states, calibration)
    solved, mean = solution(X, weights), (weights / weights.sum())[None, :]
    axes = ((normal, solved), (tangent, mean), (np.cross(normal, tangent), mean))
    cal, nav = (
        full_calibration_jacobian(geometry, points.ring, beams),
        navigation_jacobian(geometry),
    )

    def rows(J: F64, some: Bool) -> F64:
        return np.concatenate(
            [w[:, some] @ np.einsum("i,nic->nc", axis, J[some]) for axis, w in axes]
        )

    at = points.t_ns // bin_ns
    bins, along = np.unique(at), np.concatenate([np.tile(axis, (len(w), 1)) for axis, w in axes])
    M_nav = np.stack([rows(nav, at == b) for b in bins])
    by_position = (M_nav[..., :3] * along).sum(axis=2, keepdims=True)
    return (
        rows(cal, np.ones(len(X), bool)),
        bins,
        np.concatenate([by_position, M_nav[..., 3:]], axis=2),
    )


def geometry(
    r_map: F64, states: PlatformStates, state: I64, fraction: F64, lever_laser: F64
) -> F64:
    """Attitude xyzw, v_body and motion with the platform (map), (n, 10), of points (n, 3) between
    platform states.
    """
    after = np.minimum(state + 1, len(states) - 1)

    def between(values: F64) -> F64:
        out: F64 = values[state] + fraction[:, None] * (values[after] - values[state])
        return out

    q = slerp(states.q_map_body[state], states.q_map_body[after], fraction)
    R = matrix_from_quaternion(q)
    arm = np.einsum("nji,nj->ni", R, r_map - between(states.p_map_body))
    motion = np.einsum(
        "nij,nj->ni", R, between(states.v_body) + np.cross(between(states.omega_body), arm)
    )
    return np.concatenate([q, arm - lever_laser, motion], axis=1)
