"""The sequential sweep of Algorithm 1 (seed 002): one neighbourhood after the other, each point
projected at most once.

Kernels on points sorted by voxel. A neighbourhood is fitted over 2 r with the raw points, whatever
became of them, and projects those of its points within r that no earlier neighbourhood has settled.
The outcome depends on the order of the visits.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ladar_volume.clouds.filter.cell_surface import (
    BEYOND_EDGE,
    FEW_POINTS,
    KEPT,
    NO_SURFACE,
    OUTLIER,
    gather,
)
from ladar_volume.clouds.filter.orthogonal_quadric import foot_on_quadric
from ladar_volume.clouds.filter.sharp_planes import plane_share
from ladar_volume.clouds.published.facets import (
    FACETS,
    fit_facets,
    nearest_distance,
    project_on_facets,
)
from ladar_volume.clouds.published.published_quadric import fit_quadric
from ladar_volume.clouds.published.published_rules import limit_of
from ladar_volume.math.kernels import kernel
from ladar_volume.rmls.tangent_frame import across
from ladar_volume.rmls.voxel_store import _mix

#: Half width, as a share of the threshold, of the band in which residuals are counted to see how
#: dense they are at the threshold.
BAND = 0.2
#: Entries of the tally: fits, fits with an edge, fits with a corner, trials, inliers, points in the
#: band, sum of squares, thresholds.
FITS, EDGES, CORNERS, TRIALS, INLIERS, IN_BAND, SQUARES, THRESHOLDS = range(8)


@kernel
def around(
    r: Any, s: Any, slots: Any, n: Any, reach: Any, reason: Any, near: Any, x: Any, xt: Any
) -> Any:
    """Points within 2 reach of point s, about it, to x (m, 3) and xt (3, m), their slots to
    ``slots``, and which of them lie within reach and are not settled to ``near`` (m,); returns (m,
    how many are near).
    """
    m = fresh = 0
    for a in range(n):
        i = slots[a]
        d0, d1, d2 = r[i, 0] - r[s, 0], r[i, 1] - r[s, 1], r[i, 2] - r[s, 2]
        square = d0 * d0 + d1 * d1 + d2 * d2
        if square > 4.0 * reach * reach:
            continue
        slots[m] = i
        x[m, 0], x[m, 1], x[m, 2] = d0, d1, d2
        xt[0, m], xt[1, m], xt[2, m] = d0, d1, d2
        near[m] = (
            1 if square <= reach * reach and reason[i] != KEPT and reason[i] != BEYOND_EDGE else 0
        )
        fresh += near[m]
        m += 1
    return m, fresh


@kernel
def is_surface(
    tally: Any, work: Any, m: Any, threshold: Any, sigma: Any, facets: Any, made: Any, rules: Any
) -> Any:
    """Whether enough of the distances work (m,) are within the threshold; counts the fit, and what
    it found, if so.
    """
    tally[TRIALS] += made
    inside, in_band = 0, 0
    for i in range(m):
        inside += work[i] <= threshold
        in_band += abs(work[i] - threshold) <= BAND * threshold
    if inside < rules.share * m:
        return False
    tally[FITS] += 1.0
    tally[EDGES] += facets == 2
    tally[CORNERS] += facets > 2
    tally[THRESHOLDS] += threshold
    tally[INLIERS] += inside
    tally[IN_BAND] += in_band
    tally[SQUARES] += inside * sigma * sigma
    return True


@kernel
def settle_quadric(
    r: Any,
    at: Any,
    m: Any,
    s: Any,
    near: Any,
    rules: Any,
    state: Any,
    tally: Any,
    q: Any,
    normals: Any,
    variance: Any,
    reason: Any,
) -> Any:
    """Fit a neighbourhood of degree 2 and project its near points; False where there is no
    surface.
    """
    centre, normal, tangent, side = np.zeros(3), np.zeros(3), np.zeros(3), np.empty(3)
    beta, inverse, foot, n_foot = np.zeros(6), np.zeros((6, 6)), np.empty(3), np.empty(3)
    used, sigma, made = fit_quadric(
        s.x, s.xt, m, rules, state, s, centre, normal, tangent, beta, inverse
    )
    if used == 0:
        tally[TRIALS] += made
        return False
    across(normal, tangent, side)
    threshold = limit_of(sigma, rules)
    for a in range(m):
        s.work[a], _ = foot_on_quadric(
            s.x[a], centre, normal, tangent, side, beta, inverse, foot, n_foot
        )
    if not is_surface(tally, s.work, m, threshold, sigma, 1, made, rules):
        return False
    for a in range(m):
        if near[a] == 0:
            continue
        i = s.slots[a]
        d, share = foot_on_quadric(
            s.x[a], centre, normal, tangent, side, beta, inverse, foot, n_foot
        )
        reason[i] = KEPT if d <= threshold else OUTLIER
        if d <= threshold:
            variance[i] = share * sigma * sigma
            for k in range(3):
                q[i, k] = r[at, k] + foot[k]
                normals[i, k] = n_foot[k]
    return True


@kernel
def settle_facets(
    r: Any,
    at: Any,
    m: Any,
    s: Any,
    near: Any,
    rules: Any,
    state: Any,
    tally: Any,
    q: Any,
    normals: Any,
    variance: Any,
    reason: Any,
) -> Any:
    """Fit a neighbourhood of degree 1, with its edges, and project its near points; False where
    there is no surface.
    """
    planes, means, inverses = np.zeros((FACETS, 4)), np.zeros((FACETS, 3)), np.zeros((FACETS, 3, 3))
    used, side, foot = np.zeros(FACETS, np.int64), np.zeros((FACETS, FACETS), np.int64), np.empty(3)
    count, sigma, threshold, made = fit_facets(
        s.x, s.xt, m, rules, state, s, planes, means, inverses, used, side
    )
    if count == 0:
        tally[TRIALS] += made
        return False
    for a in range(m):
        s.work[a] = nearest_distance(s.x[a], planes, count)
    if not is_surface(tally, s.work, m, threshold, sigma, count, made, rules):
        return False
    for a in range(m):
        if near[a] == 0:
            continue
        i = s.slots[a]
        p, d, beyond = project_on_facets(s.x[a], planes, count, side, rules.snap, foot)
        reason[i] = OUTLIER if d > threshold else BEYOND_EDGE if beyond else KEPT
        if reason[i] != KEPT:
            continue
        for k in range(3):
            q[i, k] = r[at, k] + foot[k]
            normals[i, k] = planes[p, k]
        variance[i] = plane_share(foot, used[p], means[p], inverses[p]) * sigma * sigma
    return True


@kernel
def sweep(
    visit: Any,
    home: Any,
    keys: Any,
    table: Any,
    first: Any,
    r: Any,
    rules: Any,
    scratch: Any,
    tally: Any,
    q: Any,
    normals: Any,
    variance: Any,
    reason: Any,
) -> None:
    """Visit the points r (n, 3), sorted by voxels of edge r, in the order ``visit``; home (n,) is
    the voxel of each.
    """
    state, near = np.empty(1, np.uint64), np.empty(len(r), np.int8)
    for rank in range(len(visit)):
        at = visit[rank]
        if reason[at] == KEPT or reason[at] == BEYOND_EDGE:
            continue
        n = gather(home[at], keys, table, first, r, scratch.slots)
        m, fresh = around(
            r, at, scratch.slots, n, rules.radius, reason, near, scratch.x, scratch.xt
        )
        if fresh < rules.least:
            continue
        state[0] = _mix(np.uint64(rank) ^ _mix(np.uint64(rules.seed)))
        if rules.degree == 2:
            found = settle_quadric(
                r, at, m, scratch, near, rules, state, tally, q, normals, variance, reason
            )
        else:
            found = settle_facets(
                r, at, m, scratch, near, rules, state, tally, q, normals, variance, reason
            )
        if not found:
            for a in range(m):
                if near[a] == 1 and reason[scratch.slots[a]] == FEW_POINTS:
                    reason[scratch.slots[a]] = NO_SURFACE
