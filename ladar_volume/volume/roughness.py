"""The ground is not the polynomial fitted to it: roughness as a source of its own.

Residuals of the ground points beyond what their noise, calibration and navigation explain are a random field with variance s² and
correlation ``(1 − g) exp(−d / L) + g exp(−d² / 2 L²)``. Both have the integral 2 pi L² over the plane, which decides what a body much
larger than L feels; g, how smooth the field is, what one of a few L feels. What calibration and navigation do to the residuals is in the
lines of the budget that are theirs: on smooth ground it is the larger part, and would count twice.

The field acts twice: through the fit, and under the body, where the ground is not seen. Both are one linear functional of the field, ``Σ
w e``, with the outline's area as weight inside and the fit's weights outside; its variance ``s² Σ_ij w_i w_j rho(d_ij)`` is summed on a
grid by FFT.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.fft import dctn, next_fast_len, rfft2

from ladar_volume.ground.polynomial import COEFFICIENTS, design
from ladar_volume.model.kernels import kernel
from ladar_volume.model.records import F64, I64, Bool

#: Points used for the autocorrelation, taken at equal index steps: half a million pairs.
MAX_POINTS = 1000
MAX_CELLS = 400
#: Estimates of the field, each with what the fit took of the one before given back.
ROUNDS = 3
#: Scatter of an empirical correlation that no number of pairs takes away: a survey has few independent errors that are shared, and few
#: lengths of the field. Lengths that are tried at a time; pairs of points below which a distance says nothing.
CHANCE, LENGTHS, LEAST_PAIRS = 0.1, 60, 30
#: Standard deviation of the believed variance of the noise, over itself; and by how much a field must lessen the weighted sum of squares
#: where the mean square says that there is none.
DOUBT, SIGNIFICANT = 0.5, 4.0


@dataclass(frozen=True)
class Roughness:
    """variance_m2 : s², m² · length_m : L, m · spacing_m : mean distance of the points it was estimated from · gaussian : share g of the
    Gaussian correlation, the rest is exponential"""

    variance_m2: float
    length_m: float
    spacing_m: float
    gaussian: float = 0.0

    def correlation(self, d: F64) -> F64:
        """Correlation at distances d, m."""
        x, g = d / self.length_m, self.gaussian
        if 0.0 < g < 1.0:
            return np.asarray((1.0 - g) * np.exp(-x) + g * np.exp(-0.5 * x * x))
        return np.asarray(np.exp(-x) if g == 0.0 else np.exp(-0.5 * x * x))


def mean_spacing(xy: F64) -> float:
    """Side (m) of the square that one of the points (n, 2) occupies on average: of the occupied cells of a coarse grid."""
    low, high = bounds(xy)
    side = max(float((high - low).max()) / 40.0, 1e-9)
    occupied = int(np.count_nonzero(squares_grid(xy, np.ones(len(xy)), np.zeros(len(xy), bool), low, side, (41, 41))[0]))
    return math.sqrt(occupied * side * side / len(xy))


@kernel
def bounds(xy: F64) -> tuple[F64, F64]:
    """Least and greatest x and y, (2,) each, of points (n, 2)."""
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for i in range(len(xy)):
        for c in range(2):
            low[c], high[c] = min(low[c], xy[i, c]), max(high[c], xy[i, c])
    return low, high


@kernel
def squares_grid(xy: F64, weight: F64, point: Bool, low: F64, side: float, shape: tuple[int, int]) -> tuple[F64, float]:
    """Sums ``shape`` of the weights (n,) of points xy (n, 2) by square from ``low`` (2,) on, and the sum of the squares of those that act
    at a point (n,)."""
    grid, alone = np.zeros(shape), 0.0
    for i in range(len(xy)):
        grid[int((xy[i, 0] - low[0]) / side), int((xy[i, 1] - low[1]) / side)] += weight[i]
        if point[i]:
            alone += weight[i] * weight[i]
    return grid, alone


@kernel
def pair_sums(xy: F64, e: F64, C: F64, Q: F64, edges: F64) -> tuple[F64, F64, F64, F64]:
    """Of points xy (n, 2) and their pairs whose distance lies between two of ascending edges (k + 1,), from 0 on: sums (k,) of
    ``e_i e_j − C_ij``, numbers of pairs (k,), for every point sums (k, n, p) of the rows of Q (n, p) of its partners; and the distances of
    all pairs i < j, row by row. C : (n, n) covariance that is known."""
    n, p, k = len(xy), Q.shape[1], len(edges) - 1
    products, counts, partners, d = np.zeros(k), np.zeros(k), np.zeros((k, n, p)), np.empty(n * (n - 1) // 2)
    at = 0
    for i in range(n):
        for j in range(i + 1, n):
            d[at] = math.sqrt((xy[i, 0] - xy[j, 0]) ** 2 + (xy[i, 1] - xy[j, 1]) ** 2)
            b = np.searchsorted(edges, d[at], side="right") - 1
            at += 1
            if b < k:
                products[b] += e[i] * e[j] - C[i, j]
                counts[b] += 1.0
                for c in range(p):
                    partners[b, i, c] += Q[j, c]
                    partners[b, j, c] += Q[i, c]
    return products, counts, partners, d


@kernel
def condensed_product(rho: F64, Q: F64) -> F64:
    """``R Q`` (n, p) of a correlation matrix R whose elements i < j are rho (n (n − 1) / 2,), row by row."""
    n, p = Q.shape
    out, at = Q.copy(), 0
    for i in range(n):
        for j in range(i + 1, n):
            for c in range(p):
                out[i, c] += rho[at] * Q[j, c]
                out[j, c] += rho[at] * Q[i, c]
            at += 1
    return out


def basis(xy: F64, parameters: int) -> F64:
    """Orthonormal columns (n, parameters) that span the polynomials of so many coefficients at xy (n, 2)."""
    X = design((xy - xy.mean(axis=0)) / max(float(np.ptp(xy)), 1e-9), np.zeros(2), COEFFICIENTS.index(parameters))
    return np.ascontiguousarray(np.linalg.qr(X)[0])


def taken_by_fit(CQ: F64, Q: F64) -> tuple[F64, float]:
    """What a least-squares fit with the basis Q (n, p) takes of heights of covariance C, ``T = PC + CP − PCP`` with ``P = QQᵀ``: W (n, p)
    with ``T = WQᵀ + QWᵀ``, and its trace. CQ : (n, p)."""
    S = Q.T @ CQ
    return CQ - 0.5 * Q @ S, float(np.trace(S))


def estimate_roughness(
    xy: F64, residual: F64, noise_variance: F64, parameters: int, shared: Callable[[I64], F64] | None = None
) -> Roughness:
    """s², L and g from ground residuals (n,) m at xy (n, 2) m with known independent noise variances (n,) m².

    shared : gives the covariance (k, k) m² of the heights of k of the points from errors that returns share, None for none. What the fit
    of the ground takes of the field is given back, by the field as first estimated. The field is fitted to the products of residuals at
    different points, which their noise does not enter; their mean square minus the noise counts as far as the noise is believed: were it
    subtracted for certain, a noise believed a third too large would leave no roughness. (The distance at which the correlation falls to 1/e
    makes the sigma of a smooth ground 1.4 times too large; the integral of the autocorrelation up to its first zero scatters twice as much
    as the fit, and is too long by it.)
    """
    n = len(residual)
    spacing = mean_spacing(xy)
    some = np.arange(0, n, max(1, math.ceil(n / MAX_POINTS)), dtype=np.int64)
    p, none = xy[some], Roughness(0.0, spacing / 2, spacing)
    if len(some) <= parameters:
        return none
    noise, square = float(noise_variance.mean()) * (1.0 - parameters / n), float(residual @ residual) / n
    if square == 0.0:  # an exact ground
        return none
    C = np.zeros((len(some), len(some))) if shared is None else shared(some)
    Q, extent = basis(p, parameters), float(np.linalg.norm(p.max(axis=0) - p.min(axis=0)))
    edges = np.geomspace(max(spacing, extent / 1000), max(extent / 2, 2 * spacing), 25)
    products, counts, partners, d = pair_sums(p, residual[some], C, Q, np.concatenate([[0.0], edges]))
    known, trace = taken_by_fit(C @ Q, Q)
    lag = np.concatenate([[0.0, edges[0] / 2], np.sqrt(edges[:-1] * edges[1:])])
    ok = np.append(True, counts >= LEAST_PAIRS)
    pairs = np.maximum(np.append(0.5 * n, counts), 1.0)
    variance = square**2 / pairs + np.append((DOUBT * noise) ** 2, np.zeros(len(counts)))
    left = square - noise - (float(np.trace(C)) - trace) / len(some)
    rough, own, trace = none, np.zeros_like(Q), 0.0
    for number in range(ROUNDS):
        if number:  # what the fit took of the field is given back
            own, trace = taken_by_fit(rough.variance_m2 * condensed_product(rough.correlation(d), Q), Q)
        value = np.append(left + trace / len(some), (products + np.tensordot(partners, known + own)) / pairs[1:])
        rough = of_products(lag[ok], value[ok], variance[ok], spacing, 2.0 * float(edges[-1]))
    return rough


def of_products(lag: F64, value: F64, variance: F64, spacing_m: float, most_m: float) -> Roughness:
    """The field whose covariances at lags (k,), the first of them 0, were found to be ``value`` (k,) with variances (k,) from the number of
    pairs; what else scatters is in proportion to the field. None where neither the variance nor what is between points speaks for one."""
    s2, length, g, gain = max(float(value[0]), 0.0), spacing_m / 2, 0.0, 0.0
    for _ in range(ROUNDS):
        s2, length, g, gain = fitted_field(lag, value, 1.0 / (variance + (CHANCE * s2) ** 2), spacing_m / 2, most_m)
    if value[0] <= 0.0 and gain < SIGNIFICANT:
        return Roughness(0.0, spacing_m / 2, spacing_m)
    return Roughness(s2, length, spacing_m, g)


def fitted_field(lag: F64, value: F64, weight: F64, least_m: float, most_m: float) -> tuple[float, float, float, float]:
    """Variance, length, between two limits, and share g of the Gaussian of the field whose covariances at lags (k,) are nearest to
    ``value`` (k,) in the sense of weighted least squares, and by how much the weighted sum of squares is less than without a field. For
    each of many lengths the parts of exponential and Gaussian are the solution of a linear problem, neither below zero; the second round
    looks between the neighbours of the best length."""
    part, length, gain, k = np.zeros((1, 2)), np.array([least_m]), np.zeros(1), 0
    for _ in range(2):
        length = np.geomspace(least_m, max(most_m, least_m), LENGTHS)
        x = lag / length[:, None]
        shape = np.stack([np.exp(-x), np.exp(-0.5 * x * x)], axis=1)
        part = parts_of(np.einsum("lak,lbk,k->lab", shape, shape, weight), shape @ (weight * value))
        found = np.einsum("la,lak->lk", part, shape)
        gain = (2.0 * value - found) * found @ weight
        k = int(np.argmax(gain))
        least_m, most_m = float(length[max(k - 1, 0)]), float(length[min(k + 1, LENGTHS - 1)])
    s2 = float(part[k].sum())
    return s2, float(length[k]), float(part[k, 1]) / s2 if s2 > 0.0 else 0.0, float(gain[k])


def parts_of(N: F64, right: F64) -> F64:
    """Solutions (l, 2), neither part below zero, of pairs of normal equations ``N x = right`` (l, 2, 2), (l, 2)."""
    one, two, both = N[:, 0, 0], N[:, 1, 1], N[:, 0, 1]
    det = np.maximum(one * two - both * both, 1e-12 * one * two)
    out = np.stack([two * right[:, 0] - both * right[:, 1], one * right[:, 1] - both * right[:, 0]], axis=1) / det[:, None]
    alone = np.maximum(right, 0.0) / np.stack([one, two], axis=1)  # one part by itself: it gains right times itself
    first = right[:, 0] * alone[:, 0] >= right[:, 1] * alone[:, 1]
    single = alone * np.stack([first, ~first], axis=1)
    whole = (out[:, 0] >= 0.0) & (out[:, 1] >= 0.0)
    return np.asarray(np.where(whole[:, None], out, single))


def field_variance(xy: F64, weight: F64, point: Bool, rough: Roughness) -> float:
    """Variance of ``Σ w e`` for weights (n,) at xy (n, 2) m: unit² of w times m².

    point : (n,) whether a weight acts at a point; the others are spread over their surroundings, about one spacing wide.
    """
    if rough.variance_m2 == 0.0 or len(xy) == 0:
        return 0.0
    low, high = bounds(xy)
    h = max(rough.spacing_m, float((high - low).max()) / MAX_CELLS, 1e-9)
    shape = [int(s) + 1 for s in (high - low) / h]
    grid, squares = squares_grid(xy, weight, point, low, h, (shape[0], shape[1]))
    half = [next_fast_len(s, real=True) for s in shape]  # of a torus on which the grid does not reach round
    quarter = rough.correlation(h * np.hypot(np.arange(half[0] + 1)[:, None], np.arange(half[1] + 1)))
    # two points of one cell are 0.52 h apart on average; for L below h the cell's mean correlation is its integral over its area
    quarter[0, 0] = min(float(rough.correlation(np.array(0.5214 * h))), 2 * math.pi * (rough.length_m / h) ** 2)
    power = np.abs(rfft2(grid, s=[2 * s for s in half])) ** 2  # by Parseval's theorem: no way back
    spectrum = dctn(quarter, type=1)  # of the even kernel whose quarter it is
    folded = power[: half[0] + 1].copy()
    folded[1 : half[0]] += power[: half[0] : -1]
    folded[:, 1 : half[1]] *= 2.0
    total = float((folded * spectrum).sum()) / (4.0 * half[0] * half[1])
    # a point is fully correlated with itself, not as two points of one cell are
    return rough.variance_m2 * max(0.0, total + (1.0 - float(quarter[0, 0])) * squares)
