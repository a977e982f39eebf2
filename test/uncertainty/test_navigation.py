"""Navigation errors over time: the recursion against the dense sum, and the three parts in their
limits.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from volume_surfaces import BIN_NS, T0, platform

from ladar_volume.model.errors import VolumeError
from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.model.records import select
from ladar_volume.uncertainty.navigation_sum import (
    NavigationBins,
    markov_sum,
    matrix_root,
    navigation_loads,
    navigation_variance,
    part_variance,
)


def random_covariances(n, seed=0):
    A = np.random.default_rng(seed).standard_normal((n, 3, 3))
    return A @ np.swapaxes(A, 1, 2)


@pytest.mark.parametrize("n", [0, 1, 2, 60])
@pytest.mark.parametrize("tau", [0.05, 7.0, 1e5])
def test_recursion_equals_the_dense_sum(n, tau):
    rng = np.random.default_rng(n)
    t = np.sort(rng.uniform(0, 100, n))
    y = rng.standard_normal((n, 3))
    dense = float(((y @ y.T) * np.exp(-np.abs(t[:, None] - t) / tau)).sum())
    assert markov_sum(t, y, tau) == pytest.approx(dense, rel=1e-11, abs=1e-12)


def test_roots():
    C = random_covariances(10)
    C[0] = 0.0
    C[1] = np.diag([1.0, 0.0, 4.0])
    root = matrix_root(C)
    assert np.allclose(root @ root, C, atol=1e-12) and np.allclose(root, np.swapaxes(root, 1, 2))


def test_roots_are_made_anew_where_states_come():
    states, bin_s = platform(60), BIN_NS * 1e-9
    states = dataclasses.replace(
        states, C_nav=states.C_nav * (1.0 + np.arange(len(states)) / 100)[:, None, None]
    )
    known, half = NavigationBins(bin_s), len(states) // 2 + 1  # in the middle of a bin
    for part in (np.arange(len(states)) < half, np.arange(len(states)) >= half):
        known.add(select(states, part))
        bins = known.index
        mean = known.mean(bins)[0]
        for _ in range(2):
            for root, C in zip(known.roots(bins), (mean[:, :3, :3], mean[:, 3:, 3:]), strict=True):
                assert np.array_equal(root, matrix_root(C))
    assert np.array_equal(
        NavigationBins.from_sums(bin_s, *known.sums()).roots(bins[::-1])[1],
        known.roots(bins)[1][::-1],
    )
    with pytest.raises(VolumeError):
        known.roots(bins[-1:] + 1)


def with_fixes(seconds, gap_s, step_s=0.02):
    """States every ``step_s`` over ``seconds``, between fixes that lie gap_s(t) apart."""
    t = np.arange(0.0, seconds, step_s)
    return dataclasses.replace(
        select(platform(round(seconds)), np.zeros(len(t), np.int64)),
        t_ns=np.rint(t * 1e9).astype(np.int64),
        fix_gap_s=gap_s(t),
    )


def test_a_bin_holds_the_fixes_that_lie_in_it():
    known = NavigationBins(2.0)
    known.add(with_fixes(20.0, lambda t: np.full(len(t), 0.1)))
    # the first state covers nothing
    np.testing.assert_allclose(known.fixes(np.arange(1, 10), 0.6), 20.0)
    assert known.fixes(np.array([0]), 0.6)[0] == pytest.approx(19.8)
    rare = NavigationBins(2.0)
    rare.add(with_fixes(20.0, lambda t: np.full(len(t), 5.0)))
    np.testing.assert_allclose(rare.fixes(np.arange(10), 6.0), 1.0)


def test_a_mean_over_uneven_fixes_has_the_variance_of_drawn_ones():
    """A step of one second in a bin of two is one error over half of its time."""
    edges = np.concatenate([np.linspace(0.0, 1.0, 11), [2.0]])
    known = NavigationBins(2.0)
    known.add(
        with_fixes(2.0, lambda t: np.diff(edges)[np.searchsorted(edges, t, "right") - 1], 0.001)
    )
    rng = np.random.default_rng(5)
    means = rng.standard_normal((20_000, 11)) @ np.diff(edges) / 2.0
    assert known.fixes(np.array([0]), 3.0)[0] == pytest.approx(1.0 / means.var(), rel=0.05)


def test_part_of_a_bin_holds_part_of_the_fixes_and_a_pause_none():
    states = with_fixes(4.0, lambda t: np.full(len(t), 0.1))
    t = states.t_ns * 1e-9
    known = NavigationBins(2.0)
    known.add(select(states, (t < 0.5) | (t >= 1.5)))
    # 0.48 s, one interval of fixes at most across the pause, and 0.48 s
    assert known.fixes(np.array([0]), 0.6)[0] == pytest.approx(10.6)


def test_fixes_are_counted_alike_in_any_batches_and_read_back():
    states = with_fixes(30.0, lambda t: 0.1 + 0.3 * (t > 11.0))
    whole, parts = NavigationBins(2.0), NavigationBins(2.0)
    whole.add(states)
    for rows in np.array_split(np.arange(len(states)), 17):
        parts.add(select(states, rows))
    np.testing.assert_array_equal(whole.fix_sums, parts.fix_sums)
    back = NavigationBins.from_sums(2.0, *whole.sums(), whole.fix_sums)
    np.testing.assert_array_equal(back.fixes(back.index, 0.6), whole.fixes(whole.index, 0.6))


def test_fixes_that_are_not_known_lie_as_far_apart_as_may_be():
    states = platform(60)
    known, bin_s = NavigationBins(1.0), 1.0
    known.add(states)
    np.testing.assert_allclose(known.fixes(known.index, 0.25), 4.0)
    old = NavigationBins.from_sums(bin_s, *known.sums())
    np.testing.assert_allclose(old.fixes(old.index, 0.25), 4.0)


def test_parts_in_their_limits():
    rng = np.random.default_rng(1)
    t, y, count = np.arange(50.0), rng.standard_normal((50, 3)), np.full(50, 5.0)
    constant, single = float((y.sum(0) ** 2).sum()), float((y**2).sum())
    assert part_variance(t, y, count, 1.0, 0.0, 20.0) == pytest.approx(constant)
    assert part_variance(t, y, count, 0.0, 1.0, 20.0) == pytest.approx(single / 5)
    assert part_variance(t, y, count, 0.0, 0.0, 1e12) == pytest.approx(constant)
    assert part_variance(t, y, count, 0.0, 0.0, 1e-3) == pytest.approx(single)
    mixed = 0.2 * constant + 0.1 * single / 5 + 0.7 * markov_sum(t, y, 20.0)
    assert part_variance(t, y, count, 0.2, 0.1, 20.0) == pytest.approx(mixed)
    with pytest.raises(VolumeError):
        part_variance(t, y, count, 0.7, 0.7, 20.0)


def test_variance_against_a_dense_matrix_with_changing_covariance():
    bins = np.array([3, 4, 9, 30]) + T0 // BIN_NS
    states = platform(60)
    scale = 1.0 + np.arange(len(states)) / 100
    states = dataclasses.replace(states, C_nav=states.C_nav * scale[:, None, None])
    known = NavigationBins(1.0)
    known.add(states)
    J = np.random.default_rng(2).standard_normal((4, 6)) * [1, 1, 1, 30, 30, 30]
    budget = BudgetParameters(
        position_bias_fraction=0.3,
        position_white_fraction=0.2,
        attitude_bias_fraction=0.1,
        attitude_white_fraction=0.4,
    )
    got = navigation_variance(navigation_loads(J, bins, known, 0.5), budget)
    index = states.t_ns // BIN_NS
    C = np.array([states.C_nav[index == b].mean(axis=0) for b in bins])
    for name, block, tau, bias, white, n in (
        ("position", slice(0, 3), 300.0, 0.3, 0.2, 2.0),
        ("attitude", slice(3, 6), 20.0, 0.1, 0.4, 10.0),
    ):
        value = 0.0
        for e in range(4):
            for f in range(4):
                rho = (
                    bias
                    + (1 - bias - white) * np.exp(-abs(float(bins[e] - bins[f])) / tau)
                    + (white / n if e == f else 0.0)
                )
                value += (
                    rho
                    * J[e, block]
                    @ np.sqrt(C[e, block, block])
                    @ np.sqrt(C[f, block, block])
                    @ J[f, block]
                )
        assert got[name] == pytest.approx(value, rel=1e-10)


def test_means_do_not_depend_on_batches():
    states = platform(20)
    rng = np.random.default_rng(3)
    states = dataclasses.replace(
        states, C_nav=states.C_nav * rng.uniform(0.5, 2, (len(states), 1, 1))
    )
    whole, pieces = NavigationBins(1.0), NavigationBins(1.0)
    whole.add(states)
    for part in np.array_split(np.arange(len(states)), 17):
        pieces.add(select(states, part))
    bins = np.unique(states.t_ns // BIN_NS)
    assert whole.mean(bins)[0].tobytes() == pieces.mean(bins)[0].tobytes()
    assert np.array_equal(whole.mean(bins)[1], np.full(20, 10))


def test_an_unknown_time_is_refused():
    known = NavigationBins(1.0)
    with pytest.raises(VolumeError):
        known.mean(np.array([5]))
    known.add(platform(3))
    with pytest.raises(VolumeError):
        known.mean(np.array([T0 // BIN_NS + 3]))
    assert len(known.mean(np.zeros(0, np.int64))[0]) == 0
