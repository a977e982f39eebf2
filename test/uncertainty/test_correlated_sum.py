"""The correlated sum against all pairs, its limits, and variograms found again in simulated
ground.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from benchmarks.correlated_sum import double_sum, lag_sum, maps
from ladar_volume.model.errors import VolumeError
from ladar_volume.uncertainty.correlated_sum import (
    Variogram,
    empirical_variogram,
    estimate_variogram,
    fit_variogram,
    sum_variance,
)


def field(shape, cell_m, v, seed, count=1):
    """Fields (count, r, c) of unit sigma times s, by the Cholesky factor of all cells'
    covariance.
    """
    y, x = (a.ravel() * cell_m for a in np.mgrid[: shape[0], : shape[1]])
    d = np.hypot(y[:, None] - y, x[:, None] - x)
    C = v.variance * ((1 - v.nugget) * np.exp(-d / v.length_m) + v.nugget * np.eye(len(y)))
    return (
        np.random.default_rng(seed).standard_normal((count, len(y))) @ np.linalg.cholesky(C).T
    ).reshape(count, *shape)


@pytest.mark.parametrize(
    ("shape", "v"),
    [
        ((37, 52), Variogram(1.3, 0.25, 4.0)),
        ((1, 90), Variogram(0.7, 0.0, 1.0)),
        ((50, 20), Variogram(1.0, 0.9, 60.0)),
    ],
)
def test_the_sum_over_all_pairs(shape, v):
    sigma, weight = maps(shape)
    weight = weight * np.random.default_rng(2).choice(
        [-1.0, 1.0, 2.0], shape
    )  # signs too: one area less another
    assert sum_variance(sigma, weight, 0.5, v) == pytest.approx(
        double_sum(sigma, weight, 0.5, v), rel=1e-11
    )
    unknown = np.where(weight == 0.0, np.nan, sigma)
    assert sum_variance(unknown, weight, 0.5, v) == sum_variance(sigma, weight, 0.5, v)
    assert sum_variance(sigma.T.copy(), weight.T.copy(), 0.5, v) == pytest.approx(
        sum_variance(sigma, weight, 0.5, v), rel=1e-12
    )


def test_limits():
    sigma, weight = maps((40, 30))
    load = weight * sigma
    assert sum_variance(sigma, weight, 0.5, Variogram(1.0, 1.0, 5.0)) == pytest.approx(
        (load**2).sum(), rel=1e-12
    )
    assert sum_variance(sigma, weight, 0.5, Variogram(1.0, 0.0, 1e9)) == pytest.approx(
        load.sum() ** 2, rel=1e-6
    )
    assert sum_variance(sigma, weight, 0.5, Variogram(1.0, 0.0, 1e-6)) == pytest.approx(
        (load**2).sum(), rel=1e-12
    )
    assert sum_variance(sigma, 0.0 * weight, 0.5, Variogram(1.0, 0.0, 5.0)) == 0.0
    equal, v = np.full((300, 200), 0.02), Variogram(1.2, 0.3, 9.0)
    assert sum_variance(equal, np.full((300, 200), 0.25), 0.5, v) == pytest.approx(
        lag_sum((300, 200), 0.02, 0.5, v), rel=1e-11
    )


def test_the_empirical_variogram_is_that_of_all_pairs():
    rng = np.random.default_rng(3)
    z, stable = rng.standard_normal((14, 17)) + 100.0, rng.random((14, 17)) < 0.7
    found = empirical_variogram(z, stable, 0.5, 3.0)
    rows, columns = np.nonzero(stable)
    d = 0.5 * np.hypot(rows[:, None] - rows, columns[:, None] - columns)
    half = 0.5 * (z[stable][:, None] - z[stable]) ** 2
    near = (d > 0) & (d <= 3.0)
    assert found.pairs.sum() == near.sum() / 2
    assert (found.gamma * found.pairs).sum() == pytest.approx(half[near].sum() / 2, rel=1e-10)
    assert (found.distance_m * found.pairs).sum() == pytest.approx(d[near].sum() / 2, rel=1e-10)
    first = np.isclose(d, 0.5)
    assert found.gamma[0] == pytest.approx(half[first].mean(), rel=1e-10)


def test_a_variogram_is_found_again():
    v = Variogram(1.7, 0.3, 3.0)
    exact = empirical_variogram(np.zeros((60, 60)), np.ones((60, 60), bool), 0.5, 10.0)
    gamma = v.variance * (1.0 - v.correlation(exact.distance_m))
    back = fit_variogram(type(exact)(exact.distance_m, gamma, exact.pairs))
    assert (back.variance, back.nugget, back.length_m) == pytest.approx((1.7, 0.3, 3.0), rel=1e-3)
    sigma = np.random.default_rng(4).uniform(0.01, 0.05, (40, 40))
    stable = np.ones((40, 40), bool)
    stable[10:20, 10:20] = False
    found = []
    for e in field((40, 40), 0.5, v, 5, 30):
        dirty = sigma * e
        dirty[30, 30] = np.nan
        found.append(estimate_variogram(dirty, sigma, stable, 0.5))
    # one piece of ground some correlation lengths wide tells little; their mean is right
    assert np.mean([f.variance for f in found]) == pytest.approx(1.7, rel=0.15)
    assert np.mean([f.nugget for f in found]) == pytest.approx(0.3, abs=0.06)
    assert np.median([f.length_m for f in found]) == pytest.approx(3.0, rel=0.25)


def test_the_sigma_of_a_mean_is_its_spread():
    v, shape = Variogram(1.2, 0.2, 2.0), (36, 36)
    sigma, weight = maps(shape, seed=6)
    means = (field(shape, 0.5, v, 7, 2000) * sigma * weight).sum(axis=(1, 2)) / weight.sum()
    predicted = math.sqrt(sum_variance(sigma, weight, 0.5, v)) / weight.sum()
    assert means.std() == pytest.approx(predicted, rel=4.0 / math.sqrt(2 * 2000))
    naive = math.sqrt(v.variance * ((weight * sigma) ** 2).sum()) / weight.sum()
    assert means.std() > 5.0 * naive


def test_constant_ground_and_refusals():
    flat = estimate_variogram(
        np.full((20, 20), 0.3), np.full((20, 20), 0.1), np.ones((20, 20), bool), 1.0
    )
    assert flat.variance == 0.0 and flat.nugget == 1.0
    sigma, v = np.full((20, 20), 0.1), Variogram(1.0, 0.1, 2.0)
    bad = [
        (sigma, sigma[:-1], 1.0, v),
        (sigma[0], sigma[0], 1.0, v),
        (-sigma, sigma, 1.0, v),
        (sigma * np.nan, sigma, 1.0, v),
        (sigma, sigma, 0.0, v),
        (sigma, sigma, 1.0, Variogram(-1.0, 0.1, 2.0)),
        (sigma, sigma, 1.0, Variogram(1.0, 1.1, 2.0)),
        (sigma, sigma, 1.0, Variogram(1.0, 0.1, 0.0)),
    ]
    for words in bad:
        with pytest.raises(VolumeError):
            sum_variance(*words)
    with pytest.raises(VolumeError) as caught:
        estimate_variogram(sigma, sigma, np.eye(20, dtype=bool), 1.0)
    assert caught.value.reason == "volume_stable_ground" and caught.value.value == 20
    with pytest.raises(VolumeError):
        estimate_variogram(sigma, sigma[:-1], np.ones((20, 20), bool), 1.0)
