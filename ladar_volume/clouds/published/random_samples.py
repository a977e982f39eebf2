"""Random samples of k points and the polynomial through them (seed 002 sections 4.1.2 and 4.3):
LMedS or weighted RANSAC.

The best of T trials has the least median of residuals, or the least squared residuals cut off at a
threshold (MSAC; the source leaves the weighting open). Trials end early once a sample without
outliers was drawn with the confidence asked for.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.clouds.filter.sharp_planes import distance, fit_plane, plane_through
from ladar_volume.clouds.published.published_records import Sampler, Sampling
from ladar_volume.math.array_types import F64, I64, U64
from ladar_volume.math.kernels import inlined, kernel
from ladar_volume.math.normal_equations import basis, invert, select_kth
from ladar_volume.rmls.patch_fit import MAD, median_or_bound, random_below, truncated_squares

#: Residuals within this many robust sigma count as inliers of a trial by the median (Rousseeuw and
#: Leroy 1987).
LMEDS_SIGMAS = 2.5

#: Points a sampled quadric takes at least: the number of its terms.
QUADRIC_SAMPLE = 6
#: A median below this share of the extent is rounding: the first sample with such a one is as good
#: as any other.
ROUNDING = 1e-12


@kernel
def draw_sample(state: U64, permutation: I64, n: int, k: int) -> None:
    """``permutation[:k]`` becomes k different numbers of those in ``permutation[:n]`` (a partial
    Fisher-Yates shuffle).
    """
    for a in range(k):
        b = a + random_below(state, n - a)
        permutation[a], permutation[b] = permutation[b], permutation[a]


@kernel
def trials_needed(share: float, k: int, confidence: float) -> float:
    """Trials until one of them drew k inliers with the given confidence, where ``share`` of the
    points are inliers.
    """
    if confidence >= 1.0:
        return np.inf
    good = share**k
    if good >= 1.0:
        return 1.0
    return np.log(1.0 - confidence) / np.log1p(-good) if good > 0.0 else np.inf


@inlined
def plane_and_scatter(
    x: F64, m: int, label: I64, own: int, plane: F64, mean: F64, inverse: F64
) -> tuple[int, float]:
    """Least squares of the points labelled ``own``, see ``sharp_planes.fit_plane``; returns
    (number, standard deviation of residuals).
    """
    used = fit_plane(x, m, label, own, plane, mean, inverse)
    square = 0.0
    for i in range(m):
        if label[i] == own and used > 0:
            square += distance(x[i], plane) ** 2
    return used, np.sqrt(square / (used - 3)) if used > 3 else 0.0


@inlined
def plane_of_sample(x: F64, sample: I64, k: int, plane: F64) -> bool:
    """The plane through three points of x (3, n), or the one nearest to k in least squares; False
    where they are in line.
    """
    if k == 3:
        return bool(plane_through(x[:, sample[0]], x[:, sample[1]], x[:, sample[2]], plane))
    some, label = np.empty((k, 3)), np.zeros(k, np.int64)
    for a in range(k):
        for c in range(3):
            some[a, c] = x[c, sample[a]]
    used = fit_plane(some, k, label, 0, plane, np.empty(3), np.empty((3, 3)))
    return bool(used > 0)


@kernel
def _robust_sigma(distances: F64, n: int, p: int, sampling: Sampling) -> float:
    """Standard deviation from the median of residuals, after RANSAC of those within its threshold
    only; reorders ``distances``.
    """
    m = n
    if sampling.ransac:  # more than half of the points may lie on other surfaces
        m = 0
        for i in range(n):
            if distances[i] <= sampling.threshold:
                distances[m] = distances[i]
                m += 1
    if m <= p:
        return -1.0
    return float(MAD * (1.0 + 5.0 / (m - p)) * select_kth(distances, m, m // 2))


@kernel
def _inlier_share(distances: F64, n: int, score: float, sampling: Sampling) -> float:
    """Share of the distances (n,) that count as inliers of a trial with this score."""
    limit = sampling.threshold if sampling.ransac else LMEDS_SIGMAS * MAD * score
    inside = 0
    for i in range(n):
        inside += distances[i] <= limit
    return inside / n


@kernel
def plane_residuals(x: F64, n: int, plane: F64, distances: F64) -> None:
    """Distances of x (3, n) to a plane, to distances (n,)."""
    for i in range(n):
        distances[i] = abs(x[0, i] * plane[0] + x[1, i] * plane[1] + x[2, i] * plane[2] - plane[3])


@kernel
def sampled_plane(
    x: F64, n: int, sampling: Sampling, sampler: Sampler, plane: F64
) -> tuple[float, int]:
    """The best plane of random samples of x (3, n). Returns (robust sigma, −1 where every sample
    was degenerate; trials made).
    """
    k, order, distances = sampling.size, sampler.permutation, sampler.distances
    trial, rounding = np.zeros(4), 0.0
    for i in range(n):
        order[i] = i
        rounding = max(rounding, ROUNDING * (abs(x[0, i]) + abs(x[1, i]) + abs(x[2, i])))
    best, needed, made = np.inf, np.inf, 0
    while k <= n and made < sampling.trials and made < needed:
        made += 1
        draw_sample(sampler.state, order, n, k)
        if not plane_of_sample(x, order, k, trial):
            continue
        if sampling.ransac:
            score = truncated_squares(x, n, trial, best, sampling.threshold * sampling.threshold)
        else:
            score = max(median_or_bound(x, n, trial, best, distances), rounding)
        if score < best:
            best = score
            plane[:] = trial
            plane_residuals(x, n, plane, distances)
            share = _inlier_share(distances, n, best, sampling)
            needed = trials_needed(share, k, sampling.confidence)
    if best == np.inf:
        return -1.0, made
    plane_residuals(x, n, plane, distances)
    return _robust_sigma(distances, n, 3, sampling), made


@inlined
def quadric_of_sample(uvw: F64, sample: I64, k: int, beta: F64) -> bool:
    """Coefficients (6,) of the quadric over (u, v) through six points of uvw (3, m), or nearest to
    k; False where undetermined.
    """
    A, right, inverse, row = np.zeros((6, 6)), np.zeros(6), np.empty((6, 6)), np.empty(6)
    for a in range(k):
        basis(uvw[0, sample[a]], uvw[1, sample[a]], 6, row)
        for i in range(6):
            right[i] += row[i] * uvw[2, sample[a]]
            for j in range(6):
                A[i, j] += row[i] * row[j]
    if not invert(A, 6, inverse):
        return False
    for i in range(6):
        beta[i] = 0.0
        for j in range(6):
            beta[i] += inverse[i, j] * right[j]
    return True


@kernel
def quadric_residuals(uvw: F64, m: int, beta: F64, distances: F64) -> None:
    """Heights uvw[2, :m] off a quadric over (u, v), without sign, to distances (m,)."""
    for i in range(m):
        u, v = uvw[0, i], uvw[1, i]
        h = (
            beta[0]
            + u * beta[1]
            + v * beta[2]
            + u * u * beta[3]
            + u * v * beta[4]
            + v * v * beta[5]
        )
        distances[i] = abs(uvw[2, i] - h)


@kernel
def _score(distances: F64, m: int, sampling: Sampling) -> float:
    """Truncated squares or median of the distances (m,); reorders them for the median."""
    if not sampling.ransac:
        return float(select_kth(distances, m, m // 2))
    score = 0.0
    for i in range(m):
        score += min(distances[i], sampling.threshold) ** 2
    return score


@kernel
def sampled_quadric(
    uvw: F64, m: int, sampling: Sampling, sampler: Sampler, beta: F64
) -> tuple[float, int]:
    """As :func:`sampled_plane` for a quadric over the tangent plane; the plane itself is the first
    candidate.
    """
    k, order, distances = (
        max(sampling.size, QUADRIC_SAMPLE),
        sampler.permutation,
        sampler.distances,
    )
    for i in range(m):
        order[i] = i
    trial = np.zeros(6)
    best, needed, made = np.inf, np.inf, -1
    while k <= m and made < sampling.trials and made < needed:
        made += 1
        if made > 0:
            draw_sample(sampler.state, order, m, k)
            if not quadric_of_sample(uvw, order, k, trial):
                continue
        quadric_residuals(uvw, m, trial, distances)
        score = _score(distances, m, sampling)
        if score < best:
            best = score
            beta[:] = trial
            share = _inlier_share(distances, m, best, sampling)
            # the plane was not drawn at random: it says nothing about how many draws are enough
            needed = trials_needed(share, k, sampling.confidence) if made > 0 else np.inf
    if best == np.inf:
        return -1.0, max(made, 0)
    quadric_residuals(uvw, m, beta, distances)
    return _robust_sigma(distances, m, 6, sampling), made
