"""Degree 2 of the published filter (seed 002 section 4.1): a sampled quadric over the tangent
plane, refitted to its fixed point.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.clouds.published.published_records import (
    Neighbourhood,
    PublishedRule,
    inlier_threshold,
)
from ladar_volume.clouds.published.random_samples import (
    quadric_residuals,
    sampled_plane,
    sampled_quadric,
)
from ladar_volume.math.array_types import F64
from ladar_volume.math.kernels import inlined, kernel
from ladar_volume.rmls.tangent_frame import (
    Frame,
    Near,
    RefitRule,
    Terms,
    frame_coordinates,
    level_frame,
    mark_flat,
    move_to_surface,
    refit,
    tangent_of,
)
from ladar_volume.rmls.thinning_weights import unthinned

#: Rounds of laying the frame at the foot point.
LEVELS = 3
#: A frame whose surface is this flat and near at its centre, as slope and as share of the ball, is
#: not laid again.
FLAT = 1e-9


@kernel
def refit_rule(rule: PublishedRule) -> RefitRule:
    """How surfaces over twice the radius are refitted."""
    return RefitRule(2.0 * rule.radius, rule.sigmas, rule.floor, rule.iterations)


@inlined
def touch_surface(frame: Frame, beta: F64) -> None:
    """Move a frame to where its normal meets the surface, and turn it until it touches there."""
    move_to_surface(frame.centre, frame.normal, frame.tangent, beta)
    tangent_of(frame.normal, frame.tangent)


@inlined
def refit_quadric(
    near: Near, n: int, sigma: float, rule: PublishedRule, distances: F64, terms: Terms
) -> tuple[int, float, bool]:
    """Least squares from the start ``terms.beta`` over (u, v) / ball, which comes back in metres; a
    plane where a quadric has too few inliers.

    Returns (inliers, 0 where there is no surface; sigma; whether it is a quadric).
    """
    uvw, inside, beta = near.uvw, near.inside, terms.beta
    limit, refitting = inlier_threshold(sigma, rule), refit_rule(rule)
    quadric_residuals(uvw, n, beta, distances)
    for i in range(n):
        inside[i] = distances[i] <= limit
    beta[:] = 0.0
    used, new = refit(near, n, 6, sigma, refitting, unthinned(n), terms)
    if used >= rule.min_points:
        return used, new, True
    beta[:] = 0.0
    terms.inverse[:] = 0.0
    mark_flat(uvw, n, limit, inside)
    used, new = refit(near, n, 3, sigma, refitting, unthinned(n), terms)
    return (used if used >= rule.min_points else 0), new, False


@inlined
def refit_and_move(
    hood: Neighbourhood,
    m: int,
    near: Near,
    n: int,
    sigma: float,
    rule: PublishedRule,
    frame: Frame,
    terms: Terms,
) -> tuple[int, float]:
    """Refit a quadric over the n near ones of m points, and move its frame to it until it touches.
    Returns (inliers, 0 where there is no surface; sigma).
    """
    ball, beta, used = 2.0 * rule.radius, terms.beta, 0
    for level in range(LEVELS):
        used, sigma, curved = refit_quadric(near, n, sigma, rule, hood.sampler.distances, terms)
        if (
            used == 0
            or not curved
            or level + 1 == LEVELS
            or abs(beta[1]) + abs(beta[2]) + abs(beta[0]) / ball < FLAT
        ):
            break
        touch_surface(frame, beta)
        n = frame_coordinates(
            hood.x, m, frame.centre, frame.normal, frame.tangent, ball, near.uvw, near.slots
        )
        # in the new frame the surface is level at the centre; u and v are shares of the ball
        for e in range(6):
            beta[e] *= 0.0 if e < 3 else ball * ball
    return used, sigma


@inlined
def fit_quadric(
    hood: Neighbourhood, m: int, rule: PublishedRule, frame: Frame, terms: Terms
) -> tuple[int, float, int]:
    """A quadric over a neighbourhood of m points in a frame that touches it below the origin; a
    plane where a quadric is not determined.

    Returns (inliers, 0 where there is no surface; sigma; trials).
    """
    plane, origin, sampler = np.zeros(4), np.zeros(3), hood.sampler
    near = Near(np.empty((4, m)), np.empty(m, np.int64), np.empty(m, np.bool_))
    sigma, made = sampled_plane(hood.xt, m, rule.sampling, sampler, plane)
    if sigma < 0.0:
        return 0, sigma, made
    sigma = level_frame(hood.x, m, origin, plane, sigma, refit_rule(rule), near, frame)
    if sigma < 0.0:
        return 0, sigma, made
    n = frame_coordinates(
        hood.x,
        m,
        frame.centre,
        frame.normal,
        frame.tangent,
        2.0 * rule.radius,
        near.uvw,
        near.slots,
    )
    robust, more = sampled_quadric(near.uvw, n, rule.sampling, sampler, terms.beta)
    sigma = robust if robust >= 0.0 else sigma
    used, sigma = refit_and_move(hood, m, near, n, sigma, rule, frame, terms)
    return used, sigma, made + more
