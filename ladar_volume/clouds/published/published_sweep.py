"""The sequential sweep of Algorithm 1 (seed 002): one neighbourhood after the other, each point
projected at most once.

Kernels on points sorted by voxel. A neighbourhood is fitted over 2 r with the raw points, whatever
became of them, and projects those of its points within r that no earlier neighbourhood has
projected. The outcome depends on the order of the visits.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.clouds.filter.cell_planes import points_in_voxels
from ladar_volume.clouds.filter.cell_records import Quadric
from ladar_volume.clouds.filter.cell_surface import (
    BEYOND_EDGE,
    FEW_POINTS,
    KEPT,
    NO_SURFACE,
    OUTLIER,
)
from ladar_volume.clouds.filter.orthogonal_quadric import foot_on_quadric
from ladar_volume.clouds.filter.sharp_planes import plane_share
from ladar_volume.clouds.published.plane_facets import (
    fit_planes,
    foot_on_planes,
    nearest_distance,
)
from ladar_volume.clouds.published.published_quadric import fit_quadric
from ladar_volume.clouds.published.published_records import (
    CORNERS,
    EDGES,
    FITS,
    IN_BAND,
    INLIERS,
    PLANES,
    SQUARES,
    THRESHOLDS,
    TRIALS,
    Neighbourhood,
    Outcome,
    PublishedRule,
    Voxels,
    inlier_threshold,
    plane_set,
)
from ladar_volume.math.array_types import F64, I64
from ladar_volume.math.hashing import mix_bits
from ladar_volume.math.kernels import inlined, kernel
from ladar_volume.rmls.tangent_frame import Frame, Terms, second_tangent

#: Half width, as a share of the threshold, of the band in which residuals are counted to see how
#: dense they are at the threshold.
BAND = 0.2


@kernel
def collect_neighbourhood(
    r: F64, middle: int, n: int, radius: float, reason: I64, hood: Neighbourhood
) -> tuple[int, int]:
    """Keep of the n points ``hood.slots`` those within 2 radius of point ``middle``, about it, and
    mark those within the radius that are not projected yet; returns (m, how many are marked).
    """
    slots, x, xt, pending = hood.slots, hood.x, hood.xt, hood.pending
    m = marked = 0
    for a in range(n):
        i = slots[a]
        d0, d1, d2 = r[i, 0] - r[middle, 0], r[i, 1] - r[middle, 1], r[i, 2] - r[middle, 2]
        square = d0 * d0 + d1 * d1 + d2 * d2
        if square > 4.0 * radius * radius:
            continue
        slots[m] = i
        x[m, 0], x[m, 1], x[m, 2] = d0, d1, d2
        xt[0, m], xt[1, m], xt[2, m] = d0, d1, d2
        pending[m] = (
            1 if square <= radius * radius and reason[i] != KEPT and reason[i] != BEYOND_EDGE else 0
        )
        marked += pending[m]
        m += 1
    return m, marked


@kernel
def is_surface(
    distances: F64,
    m: int,
    threshold: float,
    sigma: float,
    facets: int,
    rule: PublishedRule,
    tally: F64,
) -> bool:
    """Whether enough of the distances (m,) are within the threshold; counts the fit, and what it
    found, if so.
    """
    inside, in_band = 0, 0
    for i in range(m):
        inside += distances[i] <= threshold
        in_band += abs(distances[i] - threshold) <= BAND * threshold
    if inside < rule.min_share * m:
        return False
    tally[FITS] += 1.0
    tally[EDGES] += facets == 2
    tally[CORNERS] += facets > 2
    tally[THRESHOLDS] += threshold
    tally[INLIERS] += inside
    tally[IN_BAND] += in_band
    tally[SQUARES] += inside * sigma * sigma
    return True


@inlined
def project_on_quadric(
    r: F64, middle: int, m: int, hood: Neighbourhood, rule: PublishedRule, out: Outcome
) -> bool:
    """Fit a neighbourhood of degree 2 and project its pending points; False where there is no
    surface.
    """
    frame, terms = (
        Frame(np.zeros(3), np.zeros(3), np.zeros(3)),
        Terms(np.zeros(6), np.zeros((6, 6))),
    )
    side, foot, n_foot = np.empty(3), np.empty(3), np.empty(3)
    used, sigma, made = fit_quadric(hood, m, rule, frame, terms)
    out.tally[TRIALS] += made
    if used == 0:
        return False
    quadric = Quadric(frame.centre, frame.normal, frame.tangent, terms.beta, terms.inverse)
    second_tangent(frame.normal, frame.tangent, side)
    threshold, distances = inlier_threshold(sigma, rule), hood.sampler.distances
    for a in range(m):
        distances[a], _ = foot_on_quadric(hood.x[a], quadric, side, foot, n_foot)
    if not is_surface(distances, m, threshold, sigma, 1, rule, out.tally):
        return False
    for a in range(m):
        if hood.pending[a] == 0:
            continue
        i = hood.slots[a]
        d, share = foot_on_quadric(hood.x[a], quadric, side, foot, n_foot)
        out.reason[i] = KEPT if d <= threshold else OUTLIER
        if d <= threshold:
            out.variance[i] = share * sigma * sigma
            for k in range(3):
                out.r[i, k] = r[middle, k] + foot[k]
                out.normal[i, k] = n_foot[k]
    return True


@inlined
def project_on_planes(
    r: F64, middle: int, m: int, hood: Neighbourhood, rule: PublishedRule, out: Outcome
) -> bool:
    """Fit a neighbourhood of degree 1, with its edges, and project its pending points; False where
    there is no surface.
    """
    planes, foot = plane_set(PLANES), np.empty(3)
    count, sigma, threshold, made = fit_planes(hood, m, rule, planes)
    out.tally[TRIALS] += made
    if count == 0:
        return False
    distances = hood.sampler.distances
    for a in range(m):
        distances[a] = nearest_distance(hood.x[a], planes.plane, count)
    if not is_surface(distances, m, threshold, sigma, count, rule, out.tally):
        return False
    for a in range(m):
        if hood.pending[a] == 0:
            continue
        i = hood.slots[a]
        p, d, beyond = foot_on_planes(hood.x[a], planes, count, rule.snap, foot)
        out.reason[i] = OUTLIER if d > threshold else BEYOND_EDGE if beyond else KEPT
        if out.reason[i] != KEPT:
            continue
        for k in range(3):
            out.r[i, k] = r[middle, k] + foot[k]
            out.normal[i, k] = planes.plane[p, k]
        share = plane_share(foot, planes.used[p], planes.mean[p], planes.inverse[p])
        out.variance[i] = share * sigma * sigma
    return True


@kernel
def sweep(
    visit: I64,
    voxels: Voxels,
    r: F64,
    rule: PublishedRule,
    hood: Neighbourhood,
    out: Outcome,
) -> None:
    """Visit the points r (n, 3), sorted by voxels of edge r, in the order ``visit``."""
    reason = out.reason
    for rank in range(len(visit)):
        middle = visit[rank]
        if reason[middle] == KEPT or reason[middle] == BEYOND_EDGE:
            continue
        n = points_in_voxels(
            voxels.voxel[middle], voxels.keys, voxels.table, voxels.first, r, hood.slots
        )
        m, marked = collect_neighbourhood(r, middle, n, rule.radius, reason, hood)
        if marked < rule.min_points:
            continue
        hood.sampler.state[0] = mix_bits(np.uint64(rank) ^ mix_bits(np.uint64(rule.seed)))
        if rule.degree == 2:
            found = project_on_quadric(r, middle, m, hood, rule, out)
        else:
            found = project_on_planes(r, middle, m, hood, rule, out)
        if not found:
            for a in range(m):
                if hood.pending[a] == 1 and reason[hood.slots[a]] == FEW_POINTS:
                    reason[hood.slots[a]] = NO_SURFACE
