"""Noise of neighbourhoods that hold several lines of points, by least trimmed squares.

The lines of a real scanner lie off each other by about their noise, each as a whole. A fit to the
best half of the points (least median of squares) chooses the lines that happen to agree and takes
the rest for outliers; one to four fifths cannot. Rousseeuw and van Driessen (2006), concentration
steps from the principal plane. Heights of a surface in plan have an estimate of their own
(:mod:`ladar_volume.clouds.cloud_noise`, which says why).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ladar_volume.math.array_types import F64, I64, Bool
from ladar_volume.math.kernels import inlined, kernel, leaf_kernel, run_in_threads
from ladar_volume.math.normal_equations import basis, eigen, select_kth

#: Share of the points that the fit goes through, and that quantile of a normal |residual|.
COVERED, QUANTILE = 0.8, 1.2816
#: Steps of concentration; refits to the points within CUT sigma, and what their squares miss.
STEPS, REFITS = 8, 4
CUT, MISSED = 3.0, 0.9733
#: Added to the diagonal of the normal equations, of their trace: points on a line have a fit.
RIDGE = 1e-9
#: A plane stands where a quadric leaves no less than this share of its noise.
PLANE = 0.8


def trimmed_noise(r: F64, near: I64) -> F64:
    """Standard deviation (s,) m along the normal of the points ``near`` (s, k), indices into r (n,
    3); fewer than k points end with −1. NaN where they tell none.
    """
    out = np.empty(len(near))
    run_in_threads(trimmed_kernel, np.arange(len(near)), r, near, out)
    return out


@kernel
def trimmed_kernel(index: I64, r: F64, near: I64, out: F64) -> None:
    """:func:`trimmed_noise` of the neighbourhoods at ``index``, to ``out``."""
    k = near.shape[1]
    x, rows, distance, ranked = np.empty((k, 3)), np.empty((k, 6)), np.empty(k), np.empty(k)
    used = np.empty(k, np.bool_)
    for s in index:
        n = 0
        for j in range(k):
            if near[s, j] >= 0:
                for c in range(3):
                    x[n, c] = r[near[s, j], c] - r[near[s, 0], c]
                n += 1
        size = _turn_to_axes(x, n)
        if not size > 0.0:
            out[s] = np.nan
            continue
        for i in range(n):
            basis(x[i, 2] / size, x[i, 1] / size, 6, rows[i])
        flat = _scatter(rows, 3, x, n, size, used, distance, ranked)
        curved = _scatter(rows, 6, x, n, size, used, distance, ranked)
        out[s] = curved if curved < PLANE * flat else flat


@inlined
def _turn_to_axes(x: F64, n: int) -> Any:
    """Turn points (n, 3) to their principal axes, the normal first; returns how far the last is
    from their mean.
    """
    mean, S, value, axes = np.zeros(3), np.zeros((3, 3)), np.empty(3), np.empty((3, 3))
    for i in range(n):
        mean += x[i] / n
    farthest = 0.0
    for i in range(n):
        x[i] -= mean
        square = 0.0
        for a in range(3):
            square += x[i, a] * x[i, a]
            for b in range(3):
                S[a, b] += x[i, a] * x[i, b] / n
        farthest = max(farthest, square)
    eigen(S, value, axes)
    for i in range(n):
        x0, x1, x2 = x[i, 0], x[i, 1], x[i, 2]
        for a in range(3):
            x[i, a] = x0 * axes[0, a] + x1 * axes[1, a] + x2 * axes[2, a]
    return np.sqrt(farthest)


@kernel
def _scatter(
    rows: F64, p: int, x: F64, n: int, size: float, used: Bool, distance: F64, ranked: F64
) -> Any:
    """Standard deviation, m, of the heights ``x[:n, 0]`` about the surface with p of the design
    ``rows`` (n, 6), the lateral unit being ``size``.
    """
    most, limit, beta = min(int(np.ceil(COVERED * n)), n) - 1, 0.0, np.empty(6)
    used[:n] = True
    for _ in range(STEPS):
        _fit(rows, p, x, n, used, beta)
        _distances(rows, p, x, n, size, beta, distance)
        ranked[:n] = distance[:n]
        limit = select_kth(ranked, n, most)
        for i in range(n):
            used[i] = distance[i] <= limit
    sigma = limit / QUANTILE
    for _ in range(REFITS):
        for i in range(n):
            used[i] = distance[i] <= CUT * sigma
        _fit(rows, p, x, n, used, beta)
        _distances(rows, p, x, n, size, beta, distance)
        square, count = 0.0, 0
        for i in range(n):
            if used[i]:
                square += distance[i] * distance[i]
                count += 1
        sigma = np.sqrt(square / max(count - p, 1) / MISSED)
    return sigma


@leaf_kernel
def _distances(rows: F64, p: int, x: F64, n: int, size: float, beta: F64, out: F64) -> None:
    """Distances ``out[:n]`` of the points from the surface with coefficients ``beta``."""
    slope = np.sqrt(1.0 + (beta[1] * beta[1] + beta[2] * beta[2]) / (size * size))
    for i in range(n):
        height = 0.0
        for a in range(p):
            height += rows[i, a] * beta[a]
        out[i] = abs(x[i, 0] - height) / slope


@kernel
def _fit(rows: F64, p: int, x: F64, n: int, used: Bool, beta: F64) -> None:
    """Coefficients ``beta[:p]`` of the least squares surface of the points used, by Cholesky."""
    A = np.zeros((6, 6))
    beta[:] = 0.0
    for i in range(n):
        if used[i]:
            for a in range(p):
                beta[a] += rows[i, a] * x[i, 0]
                for b in range(a + 1):
                    A[a, b] += rows[i, a] * rows[i, b]
    trace = 0.0
    for a in range(p):
        trace += A[a, a]
    for a in range(p):
        A[a, a] += RIDGE * trace
        for b in range(a + 1):
            s = A[a, b]
            for c in range(b):
                s -= A[a, c] * A[b, c]
            A[a, b] = np.sqrt(s) if a == b else s / A[b, b]
        for c in range(a):
            beta[a] -= A[a, c] * beta[c]
        beta[a] /= A[a, a]
    for a in range(p - 1, -1, -1):
        for c in range(a + 1, p):
            beta[a] -= A[c, a] * beta[c]
        beta[a] /= A[a, a]
