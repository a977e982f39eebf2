"""When turns of a scanner tell a lag, at the limits."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ladar_volume.georeference import turn_check
from ladar_volume.georeference.turn_check import (
    AGAIN,
    ATTITUDE_S,
    KEPT_S,
    LEAST_S,
    LIMIT_RAD,
    PAIR_S,
    PAIRS,
    REACH_S,
    Turns,
    best_lag,
)

S = 1_000_000_000


def swings(seed=1, seconds=70.0):
    """Times and angles of a platform that swings about one axis without a period."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 0.01)
    angle = sum(
        rng.uniform(0.1, 0.2) * np.sin(2.0 * math.pi * f * t + rng.uniform(0.0, 6.0))
        for f in (0.13, 0.31, 0.57, 0.83)
    )
    return t, angle


def pairs(t, angle, lag, slope=1.0, step=0.1):
    """Times of sweeps by a clock that is behind by the lag, and the turn between two of them."""
    first = np.arange(t[0] + 4.0, t[-1] - 4.0, step)
    times = np.column_stack([first, first + step])
    a, b = np.interp(times.T + lag, t, angle)
    return times, slope * (b - a)


@pytest.mark.parametrize("lag", [0.0, 0.013, -0.487, 1.999, -2.9])
def test_a_lag_is_found_between_the_steps_of_the_search(lag):
    t, angle = swings()
    found = best_lag(*pairs(t, angle, lag), t, angle)
    assert found.lag_s == pytest.approx(lag, abs=2e-3)
    assert found.explained > 0.9 and LEAST_S <= found.sigma_s < 1.1 * LEAST_S


def test_a_lag_beyond_reach_is_none():
    t, angle = swings()
    assert best_lag(*pairs(t, angle, REACH_S + 0.2), t, angle) is None


@pytest.mark.parametrize(
    ("slope", "told"), [(0.6, False), (0.7, True), (1.5, True), (1.7, False), (-1.0, False)]
)
def test_turns_of_another_size_are_not_the_same_turns(slope, told):
    t, angle = swings()
    small = 0.25 * angle  # all differences within the limit of a mistake
    found = best_lag(*pairs(t, small, 0.4, slope), t, small)
    assert (found is not None) == told


def test_turns_that_repeat_tell_no_lag_and_those_that_are_noise_neither():
    rng, t = np.random.default_rng(3), np.arange(0.0, 70.0, 0.01)
    even = 0.3 * np.sin(2.0 * math.pi * t)  # alike after each second
    times, seen = pairs(t, even, 0.1)
    assert best_lag(times, seen + rng.normal(0.0, 1e-4, len(seen)), t, even) is None
    t, angle = swings()
    times, seen = pairs(t, angle, 0.1)
    noise = rng.normal(0.0, 2.0 * np.std(seen), len(seen))
    assert best_lag(times, noise, t, angle) is None


def test_as_many_pairs_as_needed_within_reach_of_both_ends():
    t, angle = swings()
    times, seen = pairs(t, angle, 0.2, step=0.25)
    assert best_lag(times[:PAIRS], seen[:PAIRS], t, angle).pairs == PAIRS
    assert best_lag(times[: PAIRS - 1], seen[: PAIRS - 1], t, angle) is None
    early = t[0] + REACH_S + np.array([-0.001, 0.001])
    for begin, count in zip(early, (PAIRS, PAIRS + 1), strict=True):
        more = np.vstack([[begin, begin + 0.25], times[:PAIRS]])
        a, b = np.interp(more.T + 0.2, t, angle)
        assert best_lag(more, b - a, t, angle).pairs == count


def test_mistakes_count_no_more_than_their_limit_and_do_not_touch_the_slope():
    t, angle = swings()
    times, seen = pairs(t, angle, 0.3)
    wrong = seen.copy()
    wrong[::9] += 20.0 * LIMIT_RAD
    found = best_lag(times, wrong, t, angle)
    assert found.lag_s == pytest.approx(0.3, abs=0.01) and found.sigma_s < 2.0 * LEAST_S


def test_sums_of_attitudes_are_turns_and_those_close_in_time_are_left_out():
    step = Rotation.from_rotvec([0.01, -0.02, 0.03])
    both, q, t_ns = Turns(np.eye(3)), Rotation.identity(), 5 * S
    for k in range(20):
        both.add_attitude(t_ns, q.as_quat())
        both.add_attitude(t_ns + round(ATTITUDE_S * S) - 1000, (q * step).as_quat())  # too near
        assert len(both.attitudes) == k + 1
        q, t_ns = q * step, t_ns + round(ATTITUDE_S * S) + 1000
    times = np.array(both.attitudes)
    np.testing.assert_allclose(times[:, 0], (ATTITUDE_S + 1e-6) * np.arange(20), atol=1e-9)
    np.testing.assert_allclose(times[:, 1:], np.outer(np.arange(20), step.as_rotvec()), atol=1e-9)
    late = t_ns + round((KEPT_S + 2.0 * REACH_S) * S)
    both.add_attitude(late, q.as_quat())
    assert len(both.attitudes) == 1 + np.count_nonzero(times[:, 0] * S >= late - 5 * S - 66 * S)


def test_sweeps_are_compared_when_the_next_comes_in_time(monkeypatch):
    monkeypatch.setattr(turn_check, "sweep_image", lambda returns, t_s: SimpleNamespace(t_s=t_s))
    monkeypatch.setattr(turn_check, "turn_between", lambda old, new: np.ones(3))
    both, asked = Turns(np.eye(3)), []
    monkeypatch.setattr(Turns, "lag", lambda self: asked.append(len(self.pairs)))

    def sweep(t_s):
        t = round((100.0 + t_s) * S) + np.array([-1000, 0, 1000])
        both.add_sweep(SimpleNamespace(t_ns=t))
        return [(round(a, 6), round(b, 6)) for a, b, _ in both.pairs]

    assert sweep(0.0) == [] and sweep(PAIR_S) == [(0.0, 1.5)]
    assert len(sweep(2.0 * PAIR_S + 0.001)) == 1  # too late
    assert len(sweep(2.0 * PAIR_S + 0.001)) == 1  # the same again
    for k in range(1, 10):
        sweep(4.0 + 0.1 * k)
    assert asked == [AGAIN]
    sweep(KEPT_S + 0.9)
    assert sweep(KEPT_S + 1.4)[0] == (0.0, 1.5)  # its end is within the last minute
    assert sweep(KEPT_S + 1.6)[0][1] > 1.6
