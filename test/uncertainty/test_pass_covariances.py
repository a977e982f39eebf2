"""What errors do within a time bin and between bins, by drawing and in closed form."""

import dataclasses
import math

import numpy as np
import pytest

from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.uncertainty.pass_differences import (
    FEW_BEAMS,
    INEXACT,
    Sizes,
    bin_covariances,
    less_mean,
    rms,
    times_root,
)

GIVEN = BudgetParameters()
SIZES = Sizes(0.02, 0.03, 0.015, 0.01, 5.0)


def at_speed(speed_mps):
    return Sizes(*SIZES[:4], speed_mps)


def blocks(sizes=SIZES, given=GIVEN, bins=(3, 4, 9), bin_s=2.0, fixes=10.0, states=50.0):
    white = np.full(len(bins), fixes), np.full(len(bins), states)
    return bin_covariances(np.array(bins), bin_s, white, sizes, given)


def test_slopes_of_a_walk_are_those_of_drawn_ones():
    """A random walk of variance 2 t / tau, and the slope of the line fitted to it."""
    rng, n, bin_s, tau = np.random.default_rng(1), 400, 2.0, 300.0
    t = (np.arange(n) + 0.5) / n * bin_s
    walk = np.cumsum(rng.normal(0.0, math.sqrt(2.0 * bin_s / n / tau), (4000, n)), axis=1)
    centred = t - t.mean()
    slope = walk @ centred / (centred @ centred)
    given = dataclasses.replace(GIVEN, tau_position_s=tau, beam_vertical_sigma_rad=0.0)
    found = blocks(given=given)["position"]
    wandering = 1.0 - given.position_bias_fraction - given.position_white_fraction
    # a slope along the flight of 1 m/s at 5 m/s looks like a pitch of 0.2 rad, here in units of
    # its standard deviation
    per = 0.02 / 5.0 / 0.01
    expected = np.var(slope) * wandering * per**2
    pitch = 7 + 9 + 3 * np.arange(3) + 1
    np.testing.assert_allclose(np.diag(found)[pitch], expected, rtol=0.1)
    others = np.setdiff1d(np.arange(16, 25), pitch)
    assert not np.diag(found)[others].any()


def test_a_platform_that_stands_counts_as_one_of_a_metre_a_second():
    still, slow = (blocks(at_speed(v))["position"] for v in (0.0, 1.0))
    np.testing.assert_allclose(still, slow)
    assert not np.allclose(slow, blocks(at_speed(1.1))["position"])


def test_a_constant_is_a_little_different_in_every_bin():
    found = blocks()["boresight"]
    place, turn = 7 + np.arange(9), 16 + np.arange(9)
    bent = INEXACT * 0.015
    np.testing.assert_allclose(np.diag(found)[:3], 1.0)
    assert not np.diag(found)[3:7].any()
    np.testing.assert_allclose(np.diag(found)[place], (bent / 0.02) ** 2)
    np.testing.assert_allclose(np.diag(found)[turn], (bent / 0.03) ** 2)


def test_beams_in_common_look_like_a_pitch():
    given = dataclasses.replace(GIVEN, beam_vertical_sigma_rad=0.004)
    none = dataclasses.replace(GIVEN, beam_vertical_sigma_rad=0.0)
    more = blocks(given=given)["attitude"] - blocks(given=none)["attitude"]
    expected = np.zeros(25)
    expected[16 + 1 :: 3] = FEW_BEAMS * (0.004 / 0.01) ** 2
    np.testing.assert_allclose(more, np.diag(expected), atol=1e-12)


@pytest.mark.parametrize(
    ("name", "first", "white"), [("position", 7, 10.0), ("attitude", 16, 50.0)]
)
def test_bins_are_correlated_by_the_time_between_them_and_axes_are_not(name, first, white):
    given = dataclasses.replace(
        GIVEN,
        position_bias_fraction=0.2,
        position_white_fraction=0.1,
        tau_position_s=7.0,
        attitude_bias_fraction=0.2,
        attitude_white_fraction=0.1,
        tau_attitude_s=7.0,
        beam_vertical_sigma_rad=0.0,
    )
    found = blocks(given=given)[name][first : first + 9, first : first + 9]
    apart = np.array([[0.0, 2.0, 12.0], [2.0, 0.0, 10.0], [12.0, 10.0, 0.0]])
    expected = 0.2 + 0.7 * np.exp(-apart / 7.0) + 0.1 / white * np.eye(3)
    for axis in range(3):
        np.testing.assert_allclose(found[axis::3, axis::3], expected)
        assert not found[axis::3, (axis + 1) % 3 :: 3].any()
    for single, at in (("lever_arms", slice(3, 6)), ("clock", slice(6, 7))):
        whole = np.zeros(25)
        whole[at] = 1.0
        np.testing.assert_array_equal(blocks()[single], np.diag(whole))


def test_means_are_taken_off_within_runs_by_weight():
    x = np.array([[1.0], [4.0], [10.0], [2.0], [6.0]])
    weight, start = np.array([1.0, 2.0, 5.0, 1.0, 3.0]), np.array([0, 2, 3, 5])
    np.testing.assert_allclose(less_mean(x, weight, start)[:, 0], [-2.0, 1.0, 0.0, -3.0, 1.0])


def test_sizes_and_roots_of_vectors():
    v = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 1.0]])
    assert rms(v) == pytest.approx(math.sqrt(13.0))
    root = np.random.default_rng(2).normal(size=(2, 3, 3))
    C = root @ root.transpose(0, 2, 1)
    found = times_root(C, v)
    # the variance of v · error
    np.testing.assert_allclose((found**2).sum(axis=1), np.einsum("li,lij,lj->l", v, C, v))
