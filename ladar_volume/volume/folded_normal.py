"""Mean of the positive part of a noisy height over a triangle: quadrature, and the rule for
triangles that cross zero steeply.

Heights have means μ and covariance C at the corners and are linear between them. All means come
with their slopes by the heights (mean of ``λ Φ(μ/s)``) and their curvature (mean of ``λ λᵀ φ(μ/s) /
s``).
"""

from __future__ import annotations

import math

import numba
import numpy as np
from scipy.special import ndtr

from ladar_volume.math.kernels import kernel, leaf_kernel, parallel_kernel
from ladar_volume.model.records import F64
from ladar_volume.volume.neighbourhood import CHUNKS
from ladar_volume.volume.prismoids import positive_part

#: Standard deviations beyond which a height's positive part is that of the height without noise.
FAR = 6.0
#: Most parts an edge is divided into; a taller triangle crosses the base on a strip that is treated
#: as a line.
PARTS = 32
#: Quadrature of degree 5 on a triangle: weights, and the coordinates of each orbit (Radon 1948).
ROOT = math.sqrt(15.0)
ORBITS = (((6 - ROOT) / 21, (155 - ROOT) / 1200), ((6 + ROOT) / 21, (155 + ROOT) / 1200))
NODES = np.array(
    [[1 / 3, 1 / 3, 9 / 40]]
    + [[x, y, w] for r, w in ORBITS for x, y in ((r, r), (1 - 2 * r, r), (r, 1 - 2 * r))]
)
#: Standard deviations beyond which the normal distribution is 0 or 1, and its table: places, so
#: many per unit, density there, share below.
LAST, PER_UNIT = 8.0, 32.0
PLACES = np.arange(-LAST, LAST + 1 / PER_UNIT, 1 / PER_UNIT)
DENSITY, BELOW = np.exp(-0.5 * PLACES**2) / math.sqrt(2.0 * math.pi), ndtr(PLACES)
DENSITY[[0, -1]], BELOW[[0, -1]] = 0.0, (0.0, 1.0)
#: Columns of a packed symmetric 3 by 3 matrix.
PACKED = np.array([[0, 0], [0, 1], [0, 2], [1, 1], [1, 2], [2, 2]])


@leaf_kernel
def normal(t: float) -> tuple[float, float]:
    """Density of the normal distribution at t and its share below, to 1e-13, by Taylor's series
    about the nearest of tabulated places: many at a time, as the library's exponential and error
    function cannot be had.
    """
    t = min(max(-LAST, t), LAST)  # not a number: -LAST
    k = np.int32((t + LAST) * PER_UNIT + 0.5)
    x = k * (1 / PER_UNIT) - LAST
    d, y = t - x, x * x
    e = -d * (x + 0.5 * d)
    growth = 1.0 + e * (
        1.0
        + e * (1 / 2 + e * (1 / 6 + e * (1 / 24 + e * (1 / 120 + e * (1 / 720 + e * (1 / 5040))))))
    )
    fourth, fifth = (
        (y - 6.0) * y + 3.0,
        ((y - 10.0) * y + 15.0) * x,
    )  # Hermite polynomials: the density's derivatives over the density
    more = x * (y - 3.0) * (1 / 24) - d * (fourth * (1 / 120) - d * fifth * (1 / 720))
    more = x * (1 / 2) - d * ((y - 1.0) * (1 / 6) - d * more)
    return DENSITY[k] * growth, BELOW[k] + DENSITY[k] * d * (1.0 - d * more)


@leaf_kernel
def means_at(mu: F64, C: F64, count: int, work: F64) -> None:
    """Mean, weighted share above zero and weighted density over the standard deviation, rows 3 to 5
    of ``work``, at the ``count`` places with barycentric coordinates (1 − p − q, p, q) and weight
    in rows 0 to 2.
    """
    mu0, mu1, mu2, C00, C01, C02, C11, C12, C22 = (
        mu[0],
        mu[1],
        mu[2],
        C[0],
        C[1],
        C[2],
        C[3],
        C[4],
        C[5],
    )
    P, Q, weight, mean, share, curve = work[0], work[1], work[2], work[3], work[4], work[5]
    for k in range(count):  # without branches: compiled to vector instructions
        p, q = P[k], Q[k]
        o = 1.0 - p - q
        m = o * mu0 + p * mu1 + q * mu2
        s2 = (
            o * o * C00
            + p * p * C11
            + q * q * C22
            + 2.0 * (o * p * C01 + o * q * C02 + p * q * C12)
        )
        s = math.sqrt(max(s2, 1e-300))
        density, above = normal(m / s)
        mean[k] = weight[k] * (m * above + s * density)
        share[k] = weight[k] * above
        curve[k] = weight[k] * density / s


@leaf_kernel
def add_means(count: int, work: F64, out: F64) -> None:
    """Adds what :func:`means_at` found to ``out`` (10,): g, ∂g/∂μ (3), its curvature (6)."""
    P, Q, mean, share, curve = work[0], work[1], work[3], work[4], work[5]
    g, g0, g1, g2, c00, c01, c02, c11, c12, c22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(count):
        p, q = P[k], Q[k]
        o = 1.0 - p - q
        g += mean[k]
        g0, g1, g2 = g0 + o * share[k], g1 + p * share[k], g2 + q * share[k]
        a, b, c = o * curve[k], p * curve[k], q * curve[k]
        c00, c01, c02, c11, c12, c22 = (
            c00 + o * a,
            c01 + o * b,
            c02 + o * c,
            c11 + p * b,
            c12 + p * c,
            c22 + q * c,
        )
    out[0] += g
    out[1], out[2], out[3] = out[1] + g0, out[2] + g1, out[3] + g2
    out[4], out[5], out[6], out[7], out[8], out[9] = (
        out[4] + c00,
        out[5] + c01,
        out[6] + c02,
        out[7] + c11,
        out[8] + c12,
        out[9] + c22,
    )


@leaf_kernel
def add_mean(count: int, work: F64, out: F64) -> None:
    """The same for g alone."""
    g = 0.0
    for k in range(count):
        g += work[3, k]
    out[0] += g


@leaf_kernel
def add_far_mean(mu: F64, p: float, q: float, weight: float, out: F64) -> None:
    """Adds the mean and its slopes at a place with coordinates (1 − p − q, p, q) to ``out`` (10,)
    where zero is too far for the noise to matter; exact for the mean over a part of the triangle
    about its centre.
    """
    o = 1.0 - p - q
    m = o * mu[0] + p * mu[1] + q * mu[2]
    if m > 0.0:
        out[0] += weight * m
        out[1] += weight * o
        out[2] += weight * p
        out[3] += weight * q


@leaf_kernel
def by_quadrature(
    mu: F64, C: F64, s: float, parts: int, slopes: bool, nodes: F64, work: F64, out: F64
) -> None:
    """Adds the means over a triangle to ``out`` (10,): g and, with ``slopes``, ∂g/∂μ (3) and its
    curvature (6). The triangle is divided into parts² equal ones; s : largest standard deviation ·
    work : (6, parts² nodes at least), room for the places looked at.
    """
    size, count = 1.0 / parts, 0
    far = FAR * s + (max(mu[0], mu[1], mu[2]) - min(mu[0], mu[1], mu[2])) * size
    for i in range(parts):
        for j in range(parts - i):
            for flip in range(2 if j < parts - i - 1 else 1):
                p, q = (i + (1.0 + flip) / 3.0) * size, (j + (1.0 + flip) / 3.0) * size
                if abs((1.0 - p - q) * mu[0] + p * mu[1] + q * mu[2]) > far:
                    add_far_mean(mu, p, q, size * size, out)
                    continue
                for k in range(len(nodes)):
                    u, v = (
                        (nodes[k, 0], nodes[k, 1])
                        if flip == 0
                        else (1.0 - nodes[k, 0], 1.0 - nodes[k, 1])
                    )
                    work[0, count], work[1, count], work[2, count] = (
                        (i + u) * size,
                        (j + v) * size,
                        nodes[k, 2] * size * size,
                    )
                    count += 1
    means_at(mu, C, count, work)
    if slopes:
        add_means(count, work, out)
    else:
        add_mean(count, work, out)


@kernel
def by_line(mu: F64, C: F64, out: F64) -> None:
    """The same for a triangle so tall that the noise acts on the zero line only; adds to the values
    without noise in ``out`` (10,).
    """
    lone = 0
    for k in range(3):
        if (mu[k] > 0.0) != (mu[(k + 1) % 3] > 0.0) and (mu[k] > 0.0) != (mu[(k + 2) % 3] > 0.0):
            lone = k
    j, k = (lone + 1) % 3, (lone + 2) % 3
    s, t = mu[lone] / (mu[lone] - mu[j]), mu[lone] / (mu[lone] - mu[k])
    # the density of heights at zero: derivative of the tip's share s t by the level, whose two
    # halves are equal
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


@leaf_kernel
def least_deviation(C: F64) -> float:
    """Least standard deviation of the interpolated height at corners, midpoints of edges and
    centre, for packed covariances (6,).
    """
    least = min(C[0], C[3], C[5])
    least = min(
        least,
        0.25 * (C[0] + C[3] + 2.0 * C[1]),
        0.25 * (C[0] + C[5] + 2.0 * C[2]),
        0.25 * (C[3] + C[5] + 2.0 * C[4]),
    )
    return math.sqrt(max(min(least, (C[0] + C[3] + C[5] + 2.0 * (C[1] + C[2] + C[4])) / 9.0), 0.0))


@parallel_kernel
def folded_kernel(mu: F64, C: F64, plain: F64, slopes: bool, nodes: F64) -> F64:
    """Means (m, 10) over triangles with heights mu (m, 3) and packed node covariances C (m, 6): g
    and, right only with ``slopes``, its slopes (3) and its curvature (6). ``plain`` (m, 4): mean
    and slopes without noise, taken where the base is farther away than the noise reaches.
    """
    m, out = len(mu), np.zeros((len(mu), 10))
    for chunk in numba.prange(CHUNKS):
        work = np.empty((6, PARTS * PARTS * len(nodes)))
        for t in range(chunk * m // CHUNKS, (chunk + 1) * m // CHUNKS):
            low, high = min(mu[t, 0], mu[t, 1], mu[t, 2]), max(mu[t, 0], mu[t, 1], mu[t, 2])
            s = math.sqrt(max(C[t, 0], C[t, 3], C[t, 5]))
            small = least_deviation(C[t])
            if low >= FAR * s or high <= -FAR * s:
                out[t, :4] = plain[t]
            elif high - low > PARTS * s and low < 0.0 and high > 0.0:
                out[t, :4] = plain[t]
                by_line(mu[t], C[t], out[t])
            else:
                least = (
                    1 if high - low < 0.5 * small and small > 0.5 * s else 2
                )  # nearly level, and noise nearly alike: one part will do
                # two standard deviations a part: 1e-4 of the bias at most
                parts = (
                    PARTS
                    if high - low > 2.0 * PARTS * small
                    else max(least, math.ceil(0.5 * (high - low) / max(small, 1e-300)))
                )
                by_quadrature(mu[t], C[t], s, parts, slopes, nodes, work, out[t])
    return out


def positive_parts(mu: F64) -> F64:
    """Mean and slopes (m, 4) of the positive part of heights (m, 3) as they are."""
    mean, slope = positive_part(mu)
    out: F64 = np.c_[mean, slope]
    return out


def folded_means(mu: F64, C: F64, plain: F64 | None = None, slopes: bool = True) -> F64:
    """:func:`folded_kernel` of heights (m, 3), m, and packed covariances (m, 6), m²; ``plain`` is
    :func:`positive_parts` of the heights.
    """
    plain = positive_parts(mu) if plain is None else plain
    return np.asarray(
        folded_kernel(np.ascontiguousarray(mu), np.ascontiguousarray(C), plain, slopes, NODES)
    )
