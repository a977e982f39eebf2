"""The ground is not the polynomial fitted to it: roughness as a source of its own.

Residuals of the ground points beyond what their noise, calibration and navigation explain are a
random field with variance s² and correlation ``(1 − g) exp(−d / L) + g exp(−d² / 2 L²)``. Both have
the integral 2 pi L² over the plane, which decides what a body much larger than L feels; g, how
smooth the field is, what one of a few L feels. What calibration and navigation do to the residuals
is in the lines of the budget that are theirs: on smooth ground it is the larger part, and would
count twice.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.linalg.blas import dspmv

from ladar_volume.ground.polynomial import COEFFICIENTS, design
from ladar_volume.math.kernels import kernel
from ladar_volume.model.records import F64, I64
from ladar_volume.uncertainty.ground_field import Roughness, mean_spacing

#: Points used for the autocorrelation, taken at equal index steps: half a million pairs.
MAX_POINTS = 1000
#: Estimates of the field, each with what the fit took of the one before given back.
ROUNDS = 3
#: Scatter of an empirical correlation that no number of pairs takes away: a survey has few
#: independent errors that are shared, and few lengths of the field. Lengths that are tried at a
#: time; pairs of points below which a distance says nothing.
CHANCE, LENGTHS, LEAST_PAIRS = 0.1, 60, 30
#: Standard deviation of the believed variance of the noise, over itself.
DOUBT = 0.5
#: By how much a field lessens the weighted sum of squares where it begins to count, and where it
#: counts whole: where the mean square says that there is one, and where it says that there is none.
#: In between lie mean squares that exceed the noise by less than this part of its doubt.
SAID, NOT_SAID, UNDECIDED = (0.0, 0.5), (2.0, 6.0), 0.1


@kernel
def pair_sums(xy: F64, e: F64, C: F64, Q: F64, edges: F64) -> tuple[F64, F64, F64, F64, F64]:
    """Of points xy (n, 2) and their pairs whose distance lies between two of ascending edges (k +
    1,), from 0 on: sums (k,) of ``e_i e_j − C_ij``, numbers of pairs (k,), for every point sums (k,
    n, p) of the rows of Q (n, p) of its partners; ``C Q`` (n, p); and the distances (n (n + 1) /
    2,) of all pairs i <= j, row by row. C : (n, n) covariance that is known, its upper triangle.
    """
    n, p, k, at = len(xy), Q.shape[1], len(edges) - 1, 0
    products, counts, partners = np.zeros(k + 1), np.zeros(k + 1), np.zeros((k + 1, n, p))
    CQ, d, bins = np.zeros((n, p)), np.zeros(n * (n + 1) // 2), np.empty(n, np.int64)
    x, y = xy[:, 0].copy(), xy[:, 1].copy()
    for i in range(n):
        row = d[at : at + n - i]
        at += n - i
        for c in range(p):
            CQ[i, c] += C[i, i] * Q[i, c]
        for j in range(i + 1, n):
            row[j - i] = math.sqrt((x[i] - x[j]) ** 2 + (y[i] - y[j]) ** 2)
        for j in range(i + 1, n):  # counted, not searched for: without a branch
            above = -1
            for b in range(k + 1):
                above += row[j - i] >= edges[b]
            bins[j] = above
        for j in range(i + 1, n):
            b, cov = bins[j], C[i, j]
            products[b] += e[i] * e[j] - cov
            counts[b] += 1.0
            for c in range(p):
                partners[b, i, c] += Q[j, c]
                partners[b, j, c] += Q[i, c]
                CQ[i, c] += cov * Q[j, c]
                CQ[j, c] += cov * Q[i, c]
    return products[:k], counts[:k], partners[:k], CQ, d


def packed_product(packed: F64, Q: F64) -> F64:
    """``R Q`` (n, p) of a symmetric matrix R whose elements i <= j are ``packed`` (n (n + 1) / 2,),
    row by row.
    """
    return np.stack(
        [dspmv(len(Q), 1.0, packed, q, lower=1) for q in np.ascontiguousarray(Q.T)], axis=1
    )


def basis(xy: F64, parameters: int) -> F64:
    """Orthonormal columns (n, parameters) that span the polynomials of so many coefficients at xy
    (n, 2).
    """
    X = design(
        (xy - xy.mean(axis=0)) / max(float(np.ptp(xy)), 1e-9),
        np.zeros(2),
        COEFFICIENTS.index(parameters),
    )
    return np.ascontiguousarray(np.linalg.qr(X)[0])


def fit_reduction(CQ: F64, Q: F64) -> tuple[F64, float]:
    """What a least-squares fit with the basis Q (n, p) takes of heights of covariance C, ``T = PC +
    CP − PCP`` with ``P = QQᵀ``: W (n, p) with ``T = WQᵀ + QWᵀ``, and its trace. CQ : (n, p).
    """
    S = Q.T @ CQ
    return CQ - 0.5 * Q @ S, float(np.trace(S))


def estimate_roughness(
    xy: F64,
    residual: F64,
    noise_variance: F64,
    parameters: int,
    shared: Callable[[I64], tuple[I64, F64]] | None = None,
) -> Roughness:
    """s², L and g from ground residuals (n,) m at xy (n, 2) m with known independent noise
    variances (n,) m².

    shared : gives, for k of the points, an order of these (k,) and in this order the covariance (k,
    k) m² of their heights from errors that returns share, its upper triangle; None for none. What
    the fit of the ground takes of the field is given back, by the field as first estimated. The
    field is fitted to the products of residuals at different points, which their noise does not
    enter; their mean square minus the noise counts as far as the noise is believed: were it
    subtracted for certain, a noise believed a third too large would leave no roughness. (The
    distance at which the correlation falls to 1/e makes the sigma of a smooth ground 1.4 times too
    large; the integral of the autocorrelation up to its first zero scatters twice as much as the
    fit, and is too long by it.)
    """
    n = len(residual)
    some = np.arange(0, n, sample_step(n), dtype=np.int64)
    square, noise, C = float(residual @ residual) / n, float(noise_variance.mean()), None
    if shared is not None and len(some) > parameters and square > 0.0:
        order, C = shared(some)
        some = some[order]
    sample = FieldSample(xy[some], residual[some], n, mean_spacing(xy), noise, square)
    return roughness_of(sample, parameters, C)


def sample_step(n: int) -> int:
    """Every how many of n points the field is told from, in their order."""
    return max(1, math.ceil(n / MAX_POINTS))


class FieldSample(NamedTuple):
    """What a field is told from. xy (k, 2) m, residual (k,) m : of some of the points · n : how
    many there are in all · spacing_m, noise_m2, square_m2 : of all: their mean spacing, the means
    of their noise variances and of their squared residuals
    """

    xy: F64
    residual: F64
    n: int
    spacing_m: float
    noise_m2: float
    square_m2: float


def roughness_of(sample: FieldSample, parameters: int, C: F64 | None = None) -> Roughness:
    """:func:`estimate_roughness` from a sample. C : (k, k) m² known covariance of its heights, the
    upper triangle; None for none.
    """
    p, e, n, spacing, noise, square = sample
    none = Roughness(0.0, spacing / 2, spacing)
    if len(p) <= parameters or square == 0.0:  # few points, or an exact ground
        return none
    C = np.zeros((len(p), len(p))) if C is None else C
    noise *= 1.0 - parameters / n
    Q, edges = basis(p, parameters), lag_edges(p, spacing)
    products, counts, partners, CQ, d = pair_sums(p, e, C, Q, np.append(0.0, edges))
    known, trace = fit_reduction(CQ, Q)
    sums = PairSums(products, counts, partners, d, known)
    left = square - noise - (float(np.trace(C)) - trace) / len(p)
    return _iterate_field(sums, Q, edges, left, _weights(counts, n, square, noise), none)


def lag_edges(p: F64, spacing_m: float) -> F64:
    """Edges (25,) m of the lags of points p (n, 2) m apart: up to half their extent."""
    extent = float(np.linalg.norm(p.max(axis=0) - p.min(axis=0)))
    low, high = max(spacing_m, extent / 1000), max(extent / 2, 2 * spacing_m)
    return np.asarray(np.geomspace(low, high, 25))


def lag_middles(edges: F64) -> F64:
    """Lags (k + 1,) m that stand for none, for those below the first of the edges (k,) m, and for
    those between two of them.
    """
    return np.concatenate([[0.0, edges[0] / 2], np.sqrt(edges[:-1] * edges[1:])])


def _weights(counts: F64, n: int, square: float, noise: float) -> tuple[F64, F64]:
    """Numbers of pairs at lag zero, where they are the n points, and the other lags (k + 1,), and
    variances of the mean products there (k + 1,) m⁴.
    """
    pairs = np.maximum(np.append(0.5 * n, counts), 1.0)
    return pairs, square**2 / pairs + np.append((DOUBT * noise) ** 2, np.zeros(len(counts)))


class PairSums(NamedTuple):
    """What :func:`_iterate_field` fits the field to. products, counts : (k,) m² of pairs by lag ·
    partners : (k, n, p), d : distances, packed, as :func:`pair_sums` gives them · known_covariance
    : (n, p) what the fit took of the covariances that are known
    """

    products: F64
    counts: F64
    partners: F64
    d: F64
    known_covariance: F64


def _iterate_field(
    sums: PairSums,
    Q: F64,
    edges: F64,
    left: float,
    weights: tuple[F64, F64],
    start: Roughness,
) -> Roughness:
    """The field in ``ROUNDS`` rounds, of which each gives back what the fit of the ground, with
    orthonormal rows Q (n, p), took of the field of the one before. edges : (k + 1,) m of the lags ·
    left : m², mean square but for noise and what is known · weights : pairs and variances of the
    products at lag zero and the others, (k + 1,) each · start : no roughness
    """
    (products, counts, partners, d, known), (pairs, variance) = sums, weights
    lag = lag_middles(edges)
    ok = np.append(True, counts >= LEAST_PAIRS)
    rough, own, trace, most_m = start, np.zeros_like(Q), 0.0, 2.0 * float(edges[-1])
    for number in range(ROUNDS):
        if number:  # what the fit took of the field is given back
            own, trace = fit_reduction(
                rough.variance_m2 * packed_product(rough.correlation(d), Q), Q
            )
        value = np.append(
            left + trace / len(Q), (products + np.tensordot(partners, known + own)) / pairs[1:]
        )
        rough = field_from_products(lag[ok], value[ok], variance[ok], start.spacing_m, most_m)
    return rough


def field_from_products(
    lag: F64, value: F64, variance: F64, spacing_m: float, most_m: float
) -> Roughness:
    """The field whose covariances at lags (k,), the first of them 0, were found to be ``value``
    (k,) with variances (k,) from the number of pairs; what else scatters is in proportion to the
    field. It counts as far as the variance, or what is between points, speaks for one: a limit, at
    which it counts or does not, would let rounding choose.
    """
    s2, length, g, gain = max(float(value[0]), 0.0), spacing_m / 2, 0.0, 0.0
    for _ in range(ROUNDS):
        s2, length, g, gain = fit_field(
            lag, value, 1.0 / (variance + (CHANCE * s2) ** 2), spacing_m / 2, most_m
        )
    counts = counting_share(float(value[0]) / max(math.sqrt(float(variance[0])), 1e-300), gain)
    if counts * s2 == 0.0:
        return Roughness(0.0, spacing_m / 2, spacing_m)
    return Roughness(counts * s2, length, spacing_m, g)


def counting_share(excess: float, gain: float) -> float:
    """How much of a fitted field's variance counts, 0 to 1. excess : of the mean square over the
    noise, in its standard deviations · gain : what the field takes from the weighted sum of squares
    """
    said = min(max(0.5 + 0.5 * excess / UNDECIDED, 0.0), 1.0)
    first, whole = (said * a + (1.0 - said) * b for a, b in zip(SAID, NOT_SAID, strict=True))
    return min(max((gain - first) / (whole - first), 0.0), 1.0)


def fit_field(
    lag: F64, value: F64, weight: F64, least_m: float, most_m: float
) -> tuple[float, float, float, float]:
    """Variance, length, between two limits, and share g of the Gaussian of the field whose
    covariances at lags (k,) are nearest to ``value`` (k,) in the sense of weighted least squares,
    and by how much the weighted sum of squares is less than without a field. The second round looks
    between the neighbours of the best of many lengths.
    """
    found, length, k = np.zeros((1, 3)), np.array([least_m]), 0
    for _ in range(2):
        length = np.geomspace(least_m, max(most_m, least_m), LENGTHS)
        found = fields_kernel(lag, value, weight, length)
        k = int(np.argmax(found[:, 2]))
        least_m, most_m = float(length[max(k - 1, 0)]), float(length[min(k + 1, LENGTHS - 1)])
    s2 = float(found[k, 0] + found[k, 1])
    return s2, float(length[k]), float(found[k, 1]) / s2 if s2 > 0.0 else 0.0, float(found[k, 2])


@kernel
def fields_kernel(lag: F64, value: F64, weight: F64, length: F64) -> F64:
    """For each length (l,) the variances of exponential and Gaussian, neither below zero, whose sum
    is nearest to ``value`` (k,) at lags (k,), and what they take from the weighted sum of squares:
    (l, 3). The variances are the solution of a linear problem.
    """
    out = np.zeros((len(length), 3))
    for a in range(len(length)):
        one = two = both = right_one = right_two = 0.0
        for i in range(len(lag)):
            x, w = lag[i] / length[a], weight[i]
            first, second = math.exp(-x), math.exp(-0.5 * x * x)
            one += w * first * first
            two += w * second * second
            both += w * first * second
            right_one += w * first * value[i]
            right_two += w * second * value[i]
        det = max(one * two - both * both, 1e-12 * one * two)
        s, t = (
            (two * right_one - both * right_two) / det,
            (one * right_two - both * right_one) / det,
        )
        if s < 0.0 or t < 0.0:  # one of them by itself: the one that gains more, right times itself
            s, t = max(right_one, 0.0) / one, max(right_two, 0.0) / two
            if right_one * s >= right_two * t:
                t = 0.0
            else:
                s = 0.0
        out[a] = (
            s,
            t,
            2.0 * (s * right_one + t * right_two)
            - (s * s * one + 2.0 * s * t * both + t * t * two),
        )
    return out
