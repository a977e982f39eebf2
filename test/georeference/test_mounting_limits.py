"""When another mounting is said to fit, and which sweeps are laid on each other, at the limits."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from ladar_volume.georeference import mounting_check
from ladar_volume.georeference.lidar_equation import Mounting
from ladar_volume.georeference.mounting_check import (
    MountingCheck,
    TurnedMounting,
    mounting_doubts,
)
from ladar_volume.model.records import PlatformStates, Returns

S = 1_000_000_000


def check():
    return MountingCheck(Mounting(np.eye(3), np.zeros(3), np.zeros(3), 0))


def sums_of(**rotations):
    """Sums by rotation, of which all but these have nothing."""
    sums = np.zeros((5, 24))
    sums[4] = 10.0
    for name, given in rotations.items():
        sums[:, int(name[1:])] = given
    return sums


def found_by(sums):
    one = check()
    one.merge(0.5 * sums)
    one.merge(sums - one.sums)  # as from two parts of a recording
    return one.found()


@pytest.mark.parametrize(
    ("sums", "told"),
    [
        ({}, True),
        ({"pairs": 6, "better": 6}, True),
        ({"pairs": 5, "better": 5}, False),
        ({"better": 17}, True),
        ({"better": 16}, False),
        ({"other": 1.5}, True),
        ({"other": 1.51}, False),
        ({"own": 1.33}, False),
    ],
)
def test_another_mounting_needs_pairs_most_of_them_and_far_smaller_distances(sums, told):
    given = {"pairs": 20, "better": 20, "other": 1.0, "own": 2.0} | sums
    found = found_by(sums_of(r5=[*given.values(), 5.0]))
    assert (found is not None) == told
    if told:
        n = given["pairs"]
        assert (found.pairs, found.better, found.alike) == (n, given["better"], 1)
        assert found.own_m == given["own"] / n and found.other_m == given["other"] / n
        np.testing.assert_array_equal(found.R_body, mounting_check.cube_rotations()[5])


def test_the_best_is_that_of_the_least_distances_in_all_pairs_with_those_alike():
    sums = sums_of(r5=[20, 20, 1.0, 2.0, 5.0], r7=[9, 9, 0.1, 2.0, 5.2])
    sums[4, 8:10] = 5.25, 5.26
    found = found_by(sums)
    np.testing.assert_array_equal(found.R_body, mounting_check.cube_rotations()[5])
    assert found.alike == 3  # itself, 7, and 8 to five parts in a hundred
    (doubt,) = mounting_doubts(found, np.eye(3)).doubts
    assert "(2 more turns fit alike)" in doubt.text and "100 mm" in doubt.text
    assert "50 mm" in doubt.text and doubt.value == pytest.approx(2.0)
    alone = TurnedMounting(np.eye(3), 0.1, 0.05, 20, 18, 1)
    (doubt,) = mounting_doubts(alone, np.eye(3)).doubts
    assert "alike" not in doubt.text and "18 of 20 pairs" in doubt.text


def sweep(t_s, range_m=20.0, n=40):
    a = np.linspace(-math.pi, math.pi, n)
    r = range_m * np.column_stack([np.cos(a), np.sin(a), 0.0 * a])
    t = np.full(n, round(t_s * S), np.int64)
    return Returns(t, r, np.zeros(n, np.uint16), np.ones(n, np.float32))


def compared(times_s, speed, range_m=20.0, told=0, monkeypatch=None):
    """Times of the pairs that are laid on each other, of sweeps along a straight path."""
    one, found = check(), []
    monkeypatch.setattr(
        mounting_check, "sweep_image", lambda returns, t_s: SimpleNamespace(t_s=t_s)
    )
    monkeypatch.setattr(
        MountingCheck, "_compare", lambda self, a, b: found.append((a.t_ns / S, b.t_ns / S))
    )
    one.merge(sums_of(r3=[told, 0, 0.0, 0.0, 0.0]))
    t = np.arange(0.0, times_s[-1] + 0.2, 0.05)
    p = np.column_stack([speed * t, 0.0 * t, 0.0 * t])
    zero = np.zeros((len(t), 3))
    q = np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1))
    for first in range(0, len(t), 5):
        part = slice(first, first + 5)
        now = float(t[part][-1])
        for x in [x for x in times_s if now - 0.25 < x <= now]:
            one.add_returns(sweep(x, range_m))
        states = (np.rint(t * S).astype(np.int64), p, q, zero, zero)
        segment, C = np.zeros(len(t), np.int64), np.zeros((len(t), 6, 6))
        one.add_states(PlatformStates(*(a[part] for a in (*states, C, segment))))
    return [(round(a, 3), round(b, 3)) for a, b in found]


@pytest.mark.parametrize(
    ("range_m", "speed", "late"),
    [
        (20.0, 0.41, 1.0),  # 0.4 m of 20
        (20.0, 0.39, 2.0),
        (1.0, 0.11, 1.0),  # no less than 0.1 m
        (1.0, 0.09, 2.0),
        (200.0, 1.01, 1.0),  # no more than 1 m
        (200.0, 0.99, 2.0),
        (20.0, 0.0, 2.0),  # or after two seconds
    ],
)
def test_a_pair_is_laid_on_each_other_once_the_scanner_has_moved(range_m, speed, late, monkeypatch):
    found = compared([0.1, 1.1, 2.1], speed, range_m, 0, monkeypatch)
    assert found[0] == (0.1, 0.1 + late)


def test_sweeps_four_seconds_apart_are_a_pair_and_later_ones_are_not(monkeypatch):
    for late, count in ((4.0, 1), (4.1, 0)):
        assert len(compared([0.1, 0.1 + late], 5.0, 20.0, 0, monkeypatch)) == count


@pytest.mark.parametrize(
    ("told", "pause_s"), [(0, 0.0), (11, 0.0), (12, 0.4), (39, 0.4), (40, 2.0)]
)
def test_the_more_is_told_the_longer_is_the_pause(told, pause_s, monkeypatch):
    times = [0.1, 0.3, 0.5, 0.7, 0.9, 1.1, 1.3, 1.5, 1.7, 1.9, 2.1, 2.3, 2.5, 2.7]
    found = compared(times, 5.0, 20.0, told, monkeypatch)
    assert found[0] == (0.1, 0.3)
    pause = found[1][0] - found[0][1]
    assert pause_s - 1e-9 <= pause < pause_s + 0.25
