"""Spikes and offsets of sequences of volumes, made of densities that are known."""

from itertools import pairwise

import numpy as np
import pytest

from ladar_volume.model.errors import VolumeError
from ladar_volume.volume.floors import (
    SPIKE_FOOT,
    check_pair,
    checked_levels,
    offset_sums,
    parabola_minimum,
    reach,
    sequence_offset,
    spikes,
)

STEP = 0.01


def cut_of(area):
    """Levels and cut volumes whose second differences over a step are these areas (m,)."""
    area = np.asarray(area, dtype=float)
    second = np.concatenate([[0.0], area, [0.0]]) * STEP
    above = np.cumsum(second[::-1])[::-1]
    cut = np.cumsum(above[::-1])[::-1] - np.cumsum(second[::-1])[::-1]
    return STEP * np.arange(len(cut)), cut


def test_the_sequence_is_of_the_areas_it_is_made_of():
    area = np.array([1.0, 0.0, 7.0, 2.0, 2.0])
    cut = cut_of(area)[1]
    np.testing.assert_allclose(np.diff(cut, 2) / STEP, area, atol=1e-9)


@pytest.mark.parametrize(("size", "count"), [(2.02, 1), (1.98, 0)])
def test_a_spike_has_its_share_of_all_area(size, count):
    """Over ground that rises evenly, of which nothing is a spike."""
    area = np.full(99, 1.0)
    area[40:43] += [0.25 * size, 0.5 * size, 0.25 * size]
    share = 0.02 * 100.0 / float(area.sum()) * 1.0
    found = spikes(*cut_of(area), least_share=share)
    assert len(found) == count
    if count:
        (event,) = found
        assert event.area_m2 == pytest.approx(size) and event.level_m == pytest.approx(42 * STEP)
        # of a hat of one step each way nothing is left but what is wider than it
        own = (0.5 * STEP**2 - STEP**2 / 6.0) ** 0.5
        assert event.width_m == pytest.approx(own, rel=1e-6)
        assert event.first <= 41 and event.last >= 43


def test_of_several_spikes_each_ends_where_the_next_begins_and_they_come_upwards():
    area = np.zeros(60)
    area[[10, 11, 12]] = [1.0, 3.0, 1.0]
    area[[18, 19, 20]] = [2.0, 8.0, 2.0]
    area[40] = 5.0
    found = spikes(*cut_of(area))
    assert [round(e.level_m / STEP) for e in found] == [12, 20, 41]
    np.testing.assert_allclose(sum(e.area_m2 for e in found), area.sum())
    spans = [(e.first, e.last) for e in found]
    assert all(a[1] < b[0] for a, b in pairwise(spans))
    assert found[2].width_m == 0.0


def test_a_spike_reaches_to_its_foot_or_to_its_neighbour():
    smooth = np.array([0.0, 0.031, 0.5, 1.0, 0.2, SPIKE_FOOT, 0.4, 0.0])
    free = np.ones(8, bool)
    assert reach(smooth, free, 3) == (0, 5)  # the foot belongs to it, on either side
    free[1] = False
    assert reach(smooth, free, 3) == (2, 5)
    assert reach(np.array([0.2, 1.0]), np.ones(2, bool), 1) == (0, 1)
    assert reach(np.array([-1.0, -0.5, -2.0]), np.ones(3, bool), 1) == (0, 2)


@pytest.mark.parametrize(
    ("level", "good"),
    [
        (STEP * np.arange(5), True),
        (STEP * np.arange(4), False),
        (-STEP * np.arange(5), False),
        (STEP * np.array([0, 1, 2, 3, 4.00001]), False),
        (np.zeros(5), False),
    ],
)
def test_levels_are_five_and_ascend_by_equal_steps(level, good):
    cut = np.linspace(1.0, 0.0, len(level))
    if good:
        assert checked_levels(level, cut)[1] == pytest.approx(STEP)
        cut[2] = np.nan
    with pytest.raises(VolumeError) as caught:
        checked_levels(level, cut)
    assert caught.value.reason == "volume_levels"


def test_pairs_of_sequences_are_put_in_order_and_have_four_levels():
    level, a, b = np.array([3.0, 1.0, 2.0, 0.0]), np.arange(4.0), 10.0 + np.arange(4.0)
    found = check_pair(level, a, b)
    assert [v.tolist() for v in found] == [[0, 1, 2, 3], [3, 1, 2, 0], [13, 11, 12, 10]]
    for bad in ((level[:3], a[:3], b[:3]), (level, a, b[:3]), (level * 0.0, a, b)):
        with pytest.raises(VolumeError) as caught:
            check_pair(*bad)
        assert caught.value.reason == "volume_levels"


def bent(level):
    return (1.0 - level) ** 2 * (1.0 + 0.3 * level)  # a cubic: a spline holds it exactly


@pytest.mark.parametrize("offset", [0.0, 0.0123, -0.041])
def test_an_offset_between_two_sequences_is_found_whatever_their_order(offset):
    level = np.linspace(0.0, 1.0, 51)
    found = sequence_offset(level, bent(level), bent(level + offset), 0.05)
    assert found.offset_m == pytest.approx(offset, abs=1e-7)
    inside = (level >= 0.05 - 1e-12) & (level <= 0.95 + 1e-12)
    assert abs(found.levels - np.count_nonzero(inside)) <= 2
    back = sequence_offset(level[::-1], bent(level[::-1]), bent(level[::-1] + offset), 0.05)
    assert back == found
    sums = offset_sums(level, bent(level), bent(level + offset), np.array([offset, 0.05]))
    assert sums[0] < 1e-18 < sums[1]


@pytest.mark.parametrize(("reach_m", "good"), [(0.4, True), (0.41, False), (0.0, False)])
def test_three_levels_are_left_to_compare(reach_m, good):
    level = np.array([0.0, 0.4, 0.5, 0.6, 1.0])
    calls = [lambda: sequence_offset(level, bent(level), bent(level), reach_m)]
    if reach_m:
        offsets = np.array([-reach_m, reach_m])
        calls.append(lambda: offset_sums(level, bent(level), bent(level), offsets))
    for call in calls:
        if good:
            call()
            continue
        with pytest.raises(VolumeError) as caught:
            call()
        assert caught.value.reason == "volume_offset"


@pytest.mark.parametrize(
    ("least", "expected"), [(1.7, 1.7), (0.3, 0.3), (-0.4, -0.4), (4.6, 4.6), (2.0, 2.0)]
)
def test_the_lowest_point_of_a_parabola_through_three_sums(least, expected):
    d = np.arange(5.0)
    assert parabola_minimum(d, 3.0 * (d - least) ** 2 + 0.7) == pytest.approx(expected)
    assert parabola_minimum(d, -((d - 2.2) ** 2)) in (1.0, 3.0)
    assert parabola_minimum(d, np.zeros(5)) == 1.0
