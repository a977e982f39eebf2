"""Ground by random sampling with a gravity prior, then least squares on the inliers, iterated to a fixed point.

Sources: seed 002 chapter 6 (RANSAC ground); UNCERTAINTY steps 2 and 3 (constant term, threshold of at least three robust sigma,
fixed point).
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from ladar_volume.ground.polynomial import COEFFICIENTS, base_gradient, base_height, design, solve
from ladar_volume.model.errors import GroundError
from ladar_volume.model.parameters import GroundParameters
from ladar_volume.model.records import F64, I64, Bool, Plane

MAD_TO_SIGMA = 1.4826
#: Inlier threshold in robust sigma; 3 is the least for which the printed covariance is true (UNCERTAINTY step 3).
THRESHOLD_SIGMAS = 3.5
MAX_REFITS = 50
#: RANSAC scores on at most this many points: a subset taken at equal index steps is as good for a start.
SCORED_POINTS = 2000


def robust_sigma(residuals: F64) -> float:
    """Median absolute residual times 1.4826, m."""
    return MAD_TO_SIGMA * float(np.median(np.abs(residuals))) if len(residuals) else 0.0


def sample_planes(points: F64, origin_xy: F64, parameters: GroundParameters) -> F64:
    """Candidate planes (k, 3) = (c, slope x, slope y) through random triples (one point for degree 0), none steeper than max_tilt."""
    rng = np.random.default_rng(parameters.seed)
    if parameters.degree == 0:
        z = points[rng.integers(0, len(points), parameters.trials), 2]
        return np.stack([z, np.zeros_like(z), np.zeros_like(z)], axis=1)
    pick = rng.integers(0, len(points), (parameters.trials, 3))
    p = points[pick]
    a, b = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    normal = np.cross(a, b)
    length = np.linalg.norm(normal, axis=1)
    good = np.abs(normal[:, 2]) > np.maximum(length * math.cos(parameters.max_tilt_rad), 1e-12)
    normal, p = normal[good], p[good]
    slope = -normal[:, :2] / normal[:, 2:]
    c = p[:, 0, 2] - ((p[:, 0, :2] - origin_xy) * slope).sum(axis=1)
    return np.concatenate([c[:, None], slope], axis=1)


def best_plane(points: F64, origin_xy: F64, threshold_m: float, parameters: GroundParameters, below_weight: float) -> F64:
    """The candidate (3,) with the highest score: points within the threshold minus ``below_weight`` times the points further below."""
    scored = points[:: max(1, len(points) // SCORED_POINTS)]
    X = design(scored[:, :2], origin_xy, 1)
    best: F64 | None = None
    best_score = -math.inf
    candidates = sample_planes(points, origin_xy, parameters)
    for start in range(0, len(candidates), 64):
        part = candidates[start : start + 64]
        r = scored[:, 2] - part @ X.T
        score = (np.abs(r) <= threshold_m).sum(axis=1) - below_weight * (r < -threshold_m).sum(axis=1)
        k = int(np.argmax(score))
        if score[k] > best_score:
            best, best_score = part[k], float(score[k])
    if best is None:
        raise GroundError(
            f"no plane through three points is within {math.degrees(parameters.max_tilt_rad):g} degrees of the horizontal",
            reason="ground_tilt",
        )
    return best


def refine(points: F64, variance: F64, start: Plane, parameters: GroundParameters, reach_m: float = math.inf) -> Plane:
    """Least squares on the inliers of a starting surface, iterated until the inliers no longer change.

    points : (n, 3) m · variance : (n,) m², independent vertical noise, for C_beta · reach_m : inliers of the first fit lie
    within it. The threshold is ``parameters.threshold_m``, or 3.5 robust sigma of the inliers where that is 0. ``support``
    indexes ``points``. Raises :class:`GroundError` where too few points are left or the surface tilts beyond max_tilt.
    """
    threshold = parameters.threshold_m
    origin, degree = start.origin_xy, parameters.degree
    inside: Bool = np.abs(points[:, 2] - base_height(start, points[:, :2])) <= (threshold or reach_m)
    seen: set[bytes] = set()
    for _ in range(MAX_REFITS):
        beta, H, _ = solve(points[inside], origin, degree)
        residual = points[:, 2] - design(points[:, :2], origin, degree) @ beta
        # a floor of rounding size keeps exact planes from losing points to the last bit
        floor = 1e-9 * (1.0 + float(np.abs(points[:, 2]).max()))
        limit = threshold or max(THRESHOLD_SIGMAS * robust_sigma(residual[inside]), floor)
        new = np.abs(residual) <= limit
        if np.array_equal(new, inside) or new.tobytes() in seen:
            break
        seen.add(new.tobytes())
        inside = new
    beta, H, _ = solve(points[inside], origin, degree)
    residual = points[inside, 2] - design(points[inside, :2], origin, degree) @ beta
    C_beta = (H * variance[inside]) @ H.T
    plane = Plane(origin, beta, C_beta, np.flatnonzero(inside).astype(np.int64), float(np.sqrt(np.mean(residual**2))))
    check_tilt(plane, parameters)
    return plane


def check_tilt(plane: Plane, parameters: GroundParameters) -> None:
    """Refuse a ground steeper than max_tilt at its origin."""
    tilt = math.atan(float(np.linalg.norm(base_gradient(plane, plane.origin_xy[None])[0])))
    if tilt > parameters.max_tilt_rad + 1e-9:
        raise GroundError(
            f"the ground tilts by {math.degrees(tilt):.2f} degrees, more than {math.degrees(parameters.max_tilt_rad):g}",
            reason="ground_tilt",
            value=tilt,
        )


def fit_ground(
    points: F64, variance: F64, parameters: GroundParameters, coarse_m: float = 0.1, below_weight: float = 1.0, select: I64 | None = None
) -> Plane:
    """The ground below and around a body.

    points : (n, 3) m, map frame · variance : (n,) m², independent vertical noise · coarse_m : threshold of the random search
    where ``parameters.threshold_m`` is 0 · below_weight : how much a point below a candidate counts against it; with 1 the
    lowest large surface wins over a larger flat top · select : indices of the points to use. ``support`` indexes ``points``.
    Degree 2 starts from a plane. Raises :class:`GroundError` for too few or degenerate points and for a tilt beyond max_tilt.
    """
    chosen = np.arange(len(points), dtype=np.int64) if select is None else np.asarray(select, dtype=np.int64)
    p = points[chosen]
    needed = COEFFICIENTS[parameters.degree]
    if len(p) < needed:
        raise GroundError(
            f"a ground of degree {parameters.degree} needs {needed} points, there are {len(p)}",
            reason="ground_too_few_points",
            value=len(p),
        )
    if not (np.isfinite(p).all() and np.isfinite(variance[chosen]).all()):
        raise GroundError("a ground point with a coordinate or variance that is not finite", reason="ground_not_finite")
    origin = np.round(p[:, :2].mean(axis=0))
    threshold = parameters.threshold_m or coarse_m
    start = best_plane(p, origin, threshold, parameters, below_weight)
    plane = refine(p, variance[chosen], Plane(origin, start, np.zeros((3, 3)), np.zeros(0, np.int64)), parameters, threshold)
    return dataclasses.replace(plane, support=chosen[plane.support])
