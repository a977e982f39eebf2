"""Random samples of k points and the polynomial through them (seed 002 sections 4.1.2 and 4.3):
LMedS or weighted RANSAC.

The best of T trials has the least median of residuals, or the least squared residuals cut off at a
threshold (MSAC; the source leaves the weighting open). Trials end early once a sample without
outliers was drawn with the confidence asked for.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ladar_volume.clouds.filter.sharp_planes import distance, fit_plane, plane_through
from ladar_volume.math.kernels import kernel
from ladar_volume.math.normal_equations import basis, invert, select_kth
from ladar_volume.rmls.patch_fit import MAD, _median_if_better, _truncated_square, _uniform

#: Residuals within this many robust sigma count as inliers of a trial by the median (Rousseeuw and
#: Leroy 1987).
LMEDS_SIGMAS = 2.5

#: A median below this share of the extent is rounding: the first sample with such a one is as good
#: as any other.
ROUNDING = 1e-12


@kernel
def draw(state: Any, pick: Any, n: Any, k: Any) -> None:
    """``pick[:k]`` becomes k different numbers of the permutation ``pick[:n]`` (a partial
    Fisher-Yates shuffle).
    """
    for a in range(k):
        b = a + _uniform(state, n - a)
        pick[a], pick[b] = pick[b], pick[a]


@kernel
def trials_needed(share: Any, k: Any, confidence: Any) -> Any:
    """Trials until one of them drew k inliers with the given confidence, where ``share`` of the
    points are inliers.
    """
    if confidence >= 1.0:
        return np.inf
    good = share**k
    if good >= 1.0:
        return 1.0
    return np.log(1.0 - confidence) / np.log1p(-good) if good > 0.0 else np.inf


@kernel
def plane_and_scatter(
    x: Any, m: Any, label: Any, own: Any, plane: Any, mean: Any, inverse: Any
) -> Any:
    """Least squares of the points labelled ``own``, see ``pieces.fit_plane``; returns (number,
    standard deviation of residuals).
    """
    used = fit_plane(x, m, label, own, plane, mean, inverse)
    square = 0.0
    for i in range(m):
        if label[i] == own and used > 0:
            square += distance(x[i], plane) ** 2
    return used, np.sqrt(square / (used - 3)) if used > 3 else 0.0


@kernel
def plane_of(x: Any, pick: Any, k: Any, plane: Any) -> Any:
    """The plane through three points, or the one nearest to k in least squares; False where they
    are in line.
    """
    if k == 3:
        return plane_through(x[:, pick[0]], x[:, pick[1]], x[:, pick[2]], plane)
    some, label, mean, inverse = (
        np.empty((k, 3)),
        np.zeros(k, np.int64),
        np.empty(3),
        np.empty((3, 3)),
    )
    for a in range(k):
        for c in range(3):
            some[a, c] = x[c, pick[a]]
    used = fit_plane(some, k, label, 0, plane, mean, inverse)
    return used > 0


@kernel
def _robust_sigma(work: Any, n: Any, p: Any, ransac: Any, threshold: Any) -> Any:
    """Standard deviation from the median of residuals, after RANSAC of those within its threshold
    only; reorders ``work``.
    """
    m = n
    if ransac:  # more than half of the points may lie on other surfaces
        m = 0
        for i in range(n):
            if work[i] <= threshold:
                work[m] = work[i]
                m += 1
    if m <= p:
        return -1.0
    return MAD * (1.0 + 5.0 / (m - p)) * select_kth(work, m, m // 2)


@kernel
def _share(work: Any, n: Any, limit: Any) -> Any:
    inside = 0
    for i in range(n):
        inside += work[i] <= limit
    return inside / n


@kernel
def plane_residuals(x: Any, n: Any, plane: Any, work: Any) -> None:
    """Distances of x (3, n) to a plane, to work (n,)."""
    for i in range(n):
        work[i] = abs(x[0, i] * plane[0] + x[1, i] * plane[1] + x[2, i] * plane[2] - plane[3])


@kernel
def sampled_plane(
    x: Any,
    n: Any,
    k: Any,
    trials: Any,
    ransac: Any,
    threshold: Any,
    confidence: Any,
    state: Any,
    pick: Any,
    work: Any,
    plane: Any,
) -> Any:
    """The best plane of random samples of x (3, n). Returns (robust sigma, −1 where every sample
    was degenerate; trials made).
    """
    for i in range(n):
        pick[i] = i
    trial, rounding = np.zeros(4), 0.0
    for i in range(n):
        rounding = max(rounding, ROUNDING * (abs(x[0, i]) + abs(x[1, i]) + abs(x[2, i])))
    best, needed, made = np.inf, np.inf, 0
    while k <= n and made < trials and made < needed:
        made += 1
        draw(state, pick, n, k)
        if not plane_of(x, pick, k, trial):
            continue
        if ransac:
            score = _truncated_square(x, n, trial, best, threshold * threshold)
        else:
            score = max(_median_if_better(x, n, trial, best, work), rounding)
        if score < best:
            best = score
            plane[:] = trial
            plane_residuals(x, n, plane, work)
            needed = trials_needed(
                _share(work, n, threshold if ransac else LMEDS_SIGMAS * MAD * best), k, confidence
            )
    if best == np.inf:
        return -1.0, made
    plane_residuals(x, n, plane, work)
    return _robust_sigma(work, n, 3, ransac, threshold), made


@kernel
def quadric_of(uvw: Any, pick: Any, k: Any, beta: Any) -> Any:
    """Coefficients (6,) of the quadric over (u, v) through six points of uvw (3, m), or nearest to
    k; False where undetermined.
    """
    A, right, inverse, row = np.zeros((6, 6)), np.zeros(6), np.empty((6, 6)), np.empty(6)
    for a in range(k):
        basis(uvw[0, pick[a]], uvw[1, pick[a]], 6, row)
        for i in range(6):
            right[i] += row[i] * uvw[2, pick[a]]
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
def quadric_residuals(uvw: Any, m: Any, beta: Any, work: Any) -> None:
    """Heights uvw[2, :m] off a quadric over (u, v), without sign, to work (m,)."""
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
        work[i] = abs(uvw[2, i] - h)


@kernel
def sampled_quadric(
    uvw: Any,
    m: Any,
    k: Any,
    trials: Any,
    ransac: Any,
    threshold: Any,
    confidence: Any,
    state: Any,
    pick: Any,
    work: Any,
    beta: Any,
) -> Any:
    """As :func:`sampled_plane` for a quadric over the tangent plane; the plane itself is the first
    candidate.
    """
    for i in range(m):
        pick[i] = i
    trial = np.zeros(6)
    best, needed, made = np.inf, np.inf, -1
    while k <= m and made < trials and made < needed:
        made += 1
        if made > 0:
            draw(state, pick, m, k)
            if not quadric_of(uvw, pick, k, trial):
                continue
        quadric_residuals(uvw, m, trial, work)
        if ransac:
            score = 0.0
            for i in range(m):
                score += min(work[i], threshold) ** 2
        else:
            score = select_kth(work, m, m // 2)
        if score < best:
            best = score
            beta[:] = trial
            share = _share(work, m, threshold if ransac else LMEDS_SIGMAS * MAD * best)
            # the plane was not drawn at random: it says nothing about how many draws are enough
            needed = trials_needed(share, k, confidence) if made > 0 else np.inf
    if best == np.inf:
        return -1.0, max(made, 0)
    quadric_residuals(uvw, m, beta, work)
    return _robust_sigma(work, m, 6, ransac, threshold), made
