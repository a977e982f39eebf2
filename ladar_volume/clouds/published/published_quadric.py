"""Degree 2 of the published filter (seed 002 section 4.1): a sampled quadric over the tangent
plane, refitted to its fixed point.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ladar_volume.clouds.published.published_rules import limit_of
from ladar_volume.clouds.published.random_samples import (
    quadric_residuals,
    sampled_plane,
    sampled_quadric,
)
from ladar_volume.math.kernels import kernel
from ladar_volume.rmls.tangent_frame import (
    Frame,
    Near,
    RefitRule,
    Terms,
    across,
    coordinates,
    level_frame,
    mark_flat,
    refit,
    tangent_of,
)

#: Rounds of laying the frame at the foot point.
LEVELS = 3
#: Points a sampled quadric takes at least: the number of its terms.
QUADRIC_SAMPLE = 6
#: A frame whose surface is this flat and near at its centre, as slope and as share of the ball, is
#: not laid again.
FLAT = 1e-9


@kernel
def lay_flat(centre: Any, normal: Any, tangent: Any, beta: Any) -> None:
    """Move a frame to where its normal meets the surface, and turn it until it touches there."""
    side = np.empty(3)
    across(normal, tangent, side)
    length = np.sqrt(1.0 + beta[1] * beta[1] + beta[2] * beta[2])
    for k in range(3):
        centre[k] += beta[0] * normal[k]
        normal[k] = (normal[k] - beta[1] * tangent[k] - beta[2] * side[k]) / length
    tangent_of(normal, tangent)


@kernel
def refit_quadric(
    near: Any, n: Any, sigma: Any, rules: Any, work: Any, inside: Any, beta: Any, inverse: Any
) -> Any:
    """Least squares from the start ``beta`` over (u, v) / ball, which comes back in metres; a plane
    where a quadric has too few inliers.

    Returns (inliers, 0 where there is no surface; sigma; whether it is a quadric).
    """
    ball, limit = 2.0 * rules.radius, limit_of(sigma, rules)
    refitting = RefitRule(ball, rules.sigmas, rules.floor, rules.iterations)
    terms = Terms(beta, inverse)
    quadric_residuals(near, n, beta, work)
    for i in range(n):
        inside[i] = work[i] <= limit
    beta[:] = 0.0
    used, new = refit(near, n, 6, sigma, refitting, inside, terms)
    if used >= rules.least:
        return used, new, True
    beta[:] = 0.0
    inverse[:] = 0.0
    mark_flat(near, n, limit, inside)
    used, new = refit(near, n, 3, sigma, refitting, inside, terms)
    return (used if used >= rules.least else 0), new, False


@kernel
def fit_quadric(
    x: Any,
    xt: Any,
    m: Any,
    rules: Any,
    state: Any,
    s: Any,
    centre: Any,
    normal: Any,
    tangent: Any,
    beta: Any,
    inverse: Any,
) -> Any:
    """A quadric over the points x (m, 3) in a frame that touches it below the origin; a plane where
    a quadric is not determined.

    Returns (inliers, 0 where there is no surface; sigma; trials).
    """
    plane, origin, near = np.zeros(4), np.zeros(3), np.empty((4, m))
    index, inside, ball = np.empty(m, np.int64), np.empty(m, np.bool_), 2.0 * rules.radius
    sigma, made = sampled_plane(
        xt,
        m,
        rules.sample,
        rules.trials,
        rules.ransac,
        rules.ransac_threshold,
        rules.confidence,
        state,
        s.pick,
        s.work,
        plane,
    )
    if sigma < 0.0:
        return 0, sigma, made
    sigma = level_frame(
        x,
        m,
        origin,
        plane,
        sigma,
        RefitRule(ball, rules.sigmas, rules.floor, rules.iterations),
        Near(near, index, inside),
        Frame(centre, normal, tangent),
    )
    if sigma < 0.0:
        return 0, sigma, made
    n = coordinates(x, m, centre, normal, tangent, ball, near, index)
    robust, more = sampled_quadric(
        near,
        n,
        max(rules.sample, QUADRIC_SAMPLE),
        rules.trials,
        rules.ransac,
        rules.ransac_threshold,
        rules.confidence,
        state,
        s.pick,
        s.work,
        beta,
    )
    sigma = robust if robust >= 0.0 else sigma
    used = 0
    for level in range(LEVELS):
        used, sigma, curved = refit_quadric(near, n, sigma, rules, s.work, inside, beta, inverse)
        if (
            used == 0
            or not curved
            or level + 1 == LEVELS
            or abs(beta[1]) + abs(beta[2]) + abs(beta[0]) / ball < FLAT
        ):
            break
        lay_flat(centre, normal, tangent, beta)
        n = coordinates(x, m, centre, normal, tangent, ball, near, index)
        for e in range(
            6
        ):  # in the new frame the surface is level at the centre; u and v are shares of the ball
            beta[e] *= 0.0 if e < 3 else ball * ball
    return used, sigma, made + more
