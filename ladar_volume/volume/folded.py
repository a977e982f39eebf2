"""Mean of the positive part of a noisy height over a triangle: quadrature, and the rule for triangles that cross zero steeply.

Heights have means μ and covariance C at the corners and are linear between them. All means come with their slopes by the heights (mean of
``λ Φ(μ/s)``) and their curvature (mean of ``λ λᵀ φ(μ/s) / s``).
"""

from __future__ import annotations

import math

import numba
import numpy as np

from ladar_volume.model.kernels import kernel, parallel_kernel
from ladar_volume.model.records import F64
from ladar_volume.volume.prismoids import positive_part

#: Standard deviations beyond which a height's positive part is that of the height without noise.
FAR = 6.0
#: Most parts an edge is divided into; a taller triangle crosses the base on a strip that is treated as a line.
PARTS = 32
#: Quadrature of degree 5 on a triangle: weights, and the coordinates of each orbit (Radon 1948).
ROOT = math.sqrt(15.0)
ORBITS = (((6 - ROOT) / 21, (155 - ROOT) / 1200), ((6 + ROOT) / 21, (155 + ROOT) / 1200))
NODES = np.array([[1 / 3, 1 / 3, 9 / 40]] + [[x, y, w] for r, w in ORBITS for x, y in ((r, r), (1 - 2 * r, r), (r, 1 - 2 * r))])
#: Columns of a packed symmetric 3 by 3 matrix.
PACKED = np.array([[0, 0], [0, 1], [0, 2], [1, 1], [1, 2], [2, 2]])


@kernel
def add_point(mu: F64, C: F64, p: float, q: float, weight: float, out: F64) -> None:
    """Adds one quadrature point with barycentric coordinates (1 − p − q, p, q) to ``out`` (10,): g, ∂g/∂μ (3), its curvature (6)."""
    o = 1.0 - p - q
    m = o * mu[0] + p * mu[1] + q * mu[2]
    s2 = o * o * C[0] + p * p * C[3] + q * q * C[5] + 2.0 * (o * p * C[1] + o * q * C[2] + p * q * C[4])
    s = math.sqrt(max(s2, 1e-300))
    t = m / s
    density = math.exp(-0.5 * t * t) * 0.3989422804014327
    share = 0.5 * math.erfc(-t * 0.7071067811865476)
    out[0] += weight * (m * share + s * density)
    out[1] += weight * o * share
    out[2] += weight * p * share
    out[3] += weight * q * share
    curve = weight * density / s
    out[4] += curve * o * o
    out[5] += curve * o * p
    out[6] += curve * o * q
    out[7] += curve * p * p
    out[8] += curve * p * q
    out[9] += curve * q * q


@kernel
def add_far(mu: F64, p: float, q: float, weight: float, out: F64) -> None:
    """The same where zero is too far for the noise to matter; exact for the mean over a part of the triangle about its centre."""
    o = 1.0 - p - q
    m = o * mu[0] + p * mu[1] + q * mu[2]
    if m > 0.0:
        out[0] += weight * m
        out[1] += weight * o
        out[2] += weight * p
        out[3] += weight * q


@kernel
def by_quadrature(mu: F64, C: F64, s: float, parts: int, nodes: F64, out: F64) -> None:
    """Means over a triangle of :func:`add_point`, divided into parts² equal triangles; s : largest standard deviation."""
    size = 1.0 / parts
    far = FAR * s + (max(mu[0], mu[1], mu[2]) - min(mu[0], mu[1], mu[2])) * size
    for i in range(parts):
        for j in range(parts - i):
            for flip in range(2 if j < parts - i - 1 else 1):
                p, q = (i + (1.0 + flip) / 3.0) * size, (j + (1.0 + flip) / 3.0) * size
                if abs((1.0 - p - q) * mu[0] + p * mu[1] + q * mu[2]) > far:
                    add_far(mu, p, q, size * size, out)
                    continue
                for k in range(len(nodes)):
                    u, v = (nodes[k, 0], nodes[k, 1]) if flip == 0 else (1.0 - nodes[k, 0], 1.0 - nodes[k, 1])
                    add_point(mu, C, (i + u) * size, (j + v) * size, nodes[k, 2] * size * size, out)


@kernel
def by_line(mu: F64, C: F64, out: F64) -> None:
    """The same for a triangle so tall that the noise acts on the zero line only; adds to the values without noise in ``out`` (10,)."""
    lone = 0
    for k in range(3):
        if (mu[k] > 0.0) != (mu[(k + 1) % 3] > 0.0) and (mu[k] > 0.0) != (mu[(k + 2) % 3] > 0.0):
            lone = k
    j, k = (lone + 1) % 3, (lone + 2) % 3
    s, t = mu[lone] / (mu[lone] - mu[j]), mu[lone] / (mu[lone] - mu[k])
    # the density of heights at zero: derivative of the tip's share s t by the level, whose two halves are equal
    density = 2.0 * abs(mu[lone] / ((mu[lone] - mu[j]) * (mu[lone] - mu[k])))
    w = np.zeros(3)
    for i in range(3):  # Simpson along the zero line, exact for the quadratic s²
        f = 0.5 * i
        w[j], w[k] = s * (1.0 - f), t * f
        w[lone] = 1.0 - w[j] - w[k]
        weight = density * (4.0 if i == 1 else 1.0) / 6.0
        s2 = w[0] * w[0] * C[0] + w[1] * w[1] * C[3] + w[2] * w[2] * C[5]
        s2 += 2.0 * (w[0] * w[1] * C[1] + w[0] * w[2] * C[2] + w[1] * w[2] * C[4])
        out[0] += 0.5 * weight * s2
        out[4] += weight * w[0] * w[0]
        out[5] += weight * w[0] * w[1]
        out[6] += weight * w[0] * w[2]
        out[7] += weight * w[1] * w[1]
        out[8] += weight * w[1] * w[2]
        out[9] += weight * w[2] * w[2]


@kernel
def least_deviation(C: F64) -> float:
    """Least standard deviation of the interpolated height at corners, midpoints of edges and centre, for packed covariances (6,)."""
    least = min(C[0], C[3], C[5])
    least = min(least, 0.25 * (C[0] + C[3] + 2.0 * C[1]), 0.25 * (C[0] + C[5] + 2.0 * C[2]), 0.25 * (C[3] + C[5] + 2.0 * C[4]))
    return math.sqrt(max(min(least, (C[0] + C[3] + C[5] + 2.0 * (C[1] + C[2] + C[4])) / 9.0), 0.0))


@parallel_kernel
def folded_kernel(mu: F64, C: F64, plain: F64, nodes: F64) -> F64:
    """Means (m, 10) over triangles with heights mu (m, 3) and packed node covariances C (m, 6): g, its slopes (3), its curvature (6).
    ``plain`` (m, 4): mean and slopes without noise, taken where the base is farther away than the noise reaches."""
    out = np.zeros((len(mu), 10))
    for t in numba.prange(len(mu)):
        low, high = min(mu[t, 0], mu[t, 1], mu[t, 2]), max(mu[t, 0], mu[t, 1], mu[t, 2])
        s = math.sqrt(max(C[t, 0], C[t, 3], C[t, 5]))
        small = least_deviation(C[t])
        if low >= FAR * s or high <= -FAR * s:
            out[t, :4] = plain[t]
        elif high - low > PARTS * s and low < 0.0 and high > 0.0:
            out[t, :4] = plain[t]
            by_line(mu[t], C[t], out[t])
        else:
            least = 1 if high - low < 0.5 * small and small > 0.5 * s else 2  # nearly level, and noise nearly alike: one part will do
            # two standard deviations a part: 1e-4 of the bias at most
            parts = PARTS if high - low > 2.0 * PARTS * small else max(least, math.ceil(0.5 * (high - low) / max(small, 1e-300)))
            by_quadrature(mu[t], C[t], s, parts, nodes, out[t])
    return out


def without_noise(mu: F64) -> F64:
    """Mean and slopes (m, 4) of the positive part of heights (m, 3) as they are."""
    mean, slope = positive_part(mu)
    out: F64 = np.c_[mean, slope]
    return out


def folded(mu: F64, C: F64, plain: F64 | None = None) -> F64:
    """:func:`folded_kernel` of heights (m, 3), m, and packed covariances (m, 6), m²; ``plain`` is :func:`without_noise` of the heights."""
    plain = without_noise(mu) if plain is None else plain
    return np.asarray(folded_kernel(np.ascontiguousarray(mu), np.ascontiguousarray(C), plain, NODES))
