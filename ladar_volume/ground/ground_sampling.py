"""Random sampling of ground surfaces with a gravity prior (RANSAC, seed 002 section 6.1).

Candidates go through random samples; none is steeper than max_tilt. The score is the number of
points within the threshold minus ``below_weight`` times the points further below: 0 is the
published rule, the largest surface; above 0 the lower of two surfaces wins unless the upper one has
more than ``1 + below_weight`` times its points.
"""

from __future__ import annotations

import math

import numpy as np

from ladar_volume.ground.polynomial import (
    COEFFICIENTS,
    design,
    design_gradient,
    exponents,
)
from ladar_volume.math.kernels import kernel
from ladar_volume.model.errors import GroundError
from ladar_volume.model.parameters import GroundParameters
from ladar_volume.model.records import F64, I64

#: Candidates are scored on at most this many points: a subset taken at equal index steps is as good
#: for a start.
SCORED_POINTS = 2000
#: Samples that are solved at once.
BATCH = 1000


def sample_planes(points: F64, origin_xy: F64, parameters: GroundParameters) -> F64:
    """Candidate planes (k, 3) = (c, slope x, slope y) through random triples (one point for degree
    0), none steeper than max_tilt.
    """
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


def sample_polynomials(points: F64, origin_xy: F64, parameters: GroundParameters) -> F64:
    """Candidate surfaces (k, p) by least squares through random samples, none steeper than max_tilt
    at a point of its sample.
    """
    degree = parameters.degree
    columns = COEFFICIENTS[degree]
    m = max(parameters.sample_size, columns)
    pick = np.random.default_rng([parameters.seed, degree]).integers(
        0, len(points), (parameters.trials, m)
    )
    # about the origin and in units of the extent, so that the powers are of one size
    size = max(float(np.abs(points[:, :2] - origin_xy).max()), 1e-9)
    unit = size ** -np.array([float(a + b) for a, b in exponents(degree)])
    found = []
    for start in range(0, len(pick), BATCH):
        p = points[pick[start : start + BATCH]]
        xy = (p[..., :2].reshape(-1, 2) - origin_xy) / size
        X = design(xy, np.zeros(2), degree).reshape(len(p), m, columns)
        beta = np.einsum("tpm,tm->tp", np.linalg.pinv(X), p[..., 2])
        slope = (
            np.einsum(
                "tmcp,tp->tmc",
                design_gradient(xy, np.zeros(2), degree).reshape(len(p), m, 2, columns),
                beta,
            )
            / size
        )
        found.append(
            (beta * unit)[
                np.linalg.norm(slope, axis=2).max(axis=1) <= math.tan(parameters.max_tilt_rad)
            ]
        )
    return np.concatenate(found)


def candidates(points: F64, origin_xy: F64, parameters: GroundParameters) -> F64:
    """Coefficients (k, p) of all candidates, p at least 3; above degree 1 the planes through three
    points are among them.
    """
    planes = sample_planes(points, origin_xy, parameters)
    columns = COEFFICIENTS[parameters.degree]
    if columns <= 3:
        return (
            planes
            if parameters.sample_size <= columns
            else sample_polynomials(points, origin_xy, parameters)
        )
    padded = np.concatenate([planes, np.zeros((len(planes), columns - 3))], axis=1)
    return np.concatenate([padded, sample_polynomials(points, origin_xy, parameters)])


def best_candidate(
    points: F64, origin_xy: F64, threshold_m: float, parameters: GroundParameters
) -> F64:
    """The candidate (p,) with the highest score among those with at least ``min_support`` of the
    points.

    Raises :class:`GroundError`: ``ground_tilt`` where no candidate is flat enough,
    ``ground_no_consensus`` where none has enough points.
    """
    scored = points[:: max(1, len(points) // SCORED_POINTS)]
    found = candidates(points, origin_xy, parameters)
    X = design(scored[:, :2], origin_xy, COEFFICIENTS.index(found.shape[1]))
    within, below = score_kernel(
        np.ascontiguousarray(X.T), np.ascontiguousarray(scored[:, 2]), found, threshold_m
    )
    enough = within >= parameters.min_support * len(scored)
    score = np.where(enough, within - parameters.below_weight * below, -math.inf)
    most = int(within.max(initial=0))
    if len(found) == 0:
        raise GroundError(
            f"no sampled surface is within {math.degrees(parameters.max_tilt_rad):g} "
            "degrees of the horizontal: turn the points "
            "upright, or raise ground.max_tilt_deg",
            reason="ground_tilt",
        )
    if not enough.any():
        raise GroundError(
            f"no surface holds {parameters.min_support:.1%} of the points within "
            f"{threshold_m:g} m (the best {most / len(scored):.1%}): "
            "raise ground.threshold_m, ground.trials or ground.degree, or lower ground.min_support",
            reason="ground_no_consensus",
            value=most / len(scored),
        )
    best: F64 = found[int(np.argmax(score))]
    return best


@kernel
def score_kernel(columns: F64, z: F64, beta: F64, threshold: float) -> tuple[I64, I64]:
    """How many of the points with design columns (p, n) and heights (n,) lie within a threshold of
    each surface beta (k, p), and how many further below it.
    """
    within, below, r = (
        np.zeros(len(beta), np.int64),
        np.zeros(len(beta), np.int64),
        np.empty(len(z)),
    )
    for k in range(len(beta)):
        r[:] = z
        for c in range(beta.shape[1]):
            for i in range(len(z)):
                r[i] -= beta[k, c] * columns[c, i]
        near, under = 0, 0
        for i in range(len(z)):
            near += abs(r[i]) <= threshold
            under += r[i] < -threshold
        within[k], below[k] = near, under
    return within, below
