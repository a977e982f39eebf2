"""From the derivative of a result by a fitted ground to its gradient by the ground points (UNCERTAINTY step 2)."""

from __future__ import annotations

import numpy as np

from ladar_volume.ground.polynomial import base_gradient, degree_of, design_gradient, solve
from ladar_volume.model.records import F64, Plane


def ground_weights(points: F64, plane: Plane, by_beta: F64) -> F64:
    """Derivatives (s, k) of k results by the heights of the points ``plane.support`` (s,), inliers held fixed: the vertical part of
    :func:`ground_gradient`."""
    _, X, N = solve(points[plane.support], plane.origin_xy, degree_of(plane))
    out: F64 = X @ (N @ by_beta)
    return out


def ground_gradient(points: F64, plane: Plane, by_beta: F64) -> F64:
    """Gradients (s, k, 3) of k results by the points ``plane.support`` (s,), inliers held fixed.

    points : (n, 3) m that ``support`` indexes · by_beta : (p, k) derivatives of the results by beta. The vertical part is
    ``dV/dbeta H``, the horizontal one ``−slope`` times it plus the term in which the design moves under the residual: with it a
    common shift or yaw cancels exactly.
    """
    p = points[plane.support]
    if len(p) == 0:
        return np.zeros((0, by_beta.shape[1], 3))
    xy = p[:, :2]
    _, X, N = solve(p, plane.origin_xy, degree_of(plane))
    residual, slope = p[:, 2] - X @ plane.beta, base_gradient(plane, xy)
    D, by_sums = design_gradient(xy, plane.origin_xy, degree_of(plane)), N @ by_beta
    out = np.empty((len(p), by_beta.shape[1], 3))
    out[..., 2] = X @ by_sums
    for c in range(2):
        out[..., c] = residual[:, None] * (D[:, c] @ by_sums) - slope[:, c, None] * out[..., 2]
    return out
