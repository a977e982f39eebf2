"""Advice about clocks is given as far as the data bear it: arrival names a difference, the turns
tell whether stamps are off or messages are late.
"""

import pytest

from ladar_volume.georeference.clock_check import Lead
from ladar_volume.georeference.turn_check import TurnLag
from ladar_volume.nodes.watch.clock_words import clock_state, clock_words, known_step

S = 10**9


def leads(cloud_s, fix_s):
    """Leads of attitudes at 100 Hz over clouds and fixes that come with them, s."""
    cloud, fix = Lead(), Lead()
    for i in range(3000):
        now = i * S // 100
        for lead, late in ((cloud, cloud_s), (fix, fix_s)):
            lead.reference(now)
            if i % 10 == 0:
                lead.add_reference_clock(now - round(late * S))
    return cloud, fix


def turns(lag_s, sigma_s=0.02):
    return TurnLag(lag_s, sigma_s, 0.8, 90)


def test_a_late_message_with_the_right_stamp_is_latency_and_no_fault():
    cloud, fix = leads(0.4, 0.0)
    assert clock_words(cloud, fix, turns(0.01)) == []
    assert clock_state(cloud, turns(0.01), 0.0) == "latency"
    cloud, fix = leads(-2.0, -2.0)  # an IMU whose messages are late
    assert clock_words(cloud, fix, turns(-0.03)) == []


def test_stamps_that_are_off_get_a_number_that_the_turns_bear():
    cloud, fix = leads(0.4, 0.0)
    (words,) = clock_words(cloud, fix, turns(0.4))
    assert "stamps of the clouds are 0.40 +- 0.02 s behind" in words and "way of the" not in words
    assert "clock_offset_s to 0.40" in words and clock_state(cloud, turns(0.4), 0.0) == "offset"


def test_offset_and_latency_are_told_apart():
    (words,) = clock_words(*leads(0.5, 0.0), turns(0.3))
    assert "0.30 +- 0.02 s behind" in words and "s more are the way of the messages" in words


def test_an_imu_whose_clock_is_off_is_named_and_the_lidars_offset_is_not_advised():
    (words,) = clock_words(*leads(-2.0, -2.0), turns(-2.0))
    assert "stamps of the attitudes are 2.00 +- 0.02 s behind" in words
    assert "fixes agree with the clouds" in words and "clock_offset_s to" not in words


@pytest.mark.parametrize(("cloud_s", "fix_s"), [(0.4, 0.0), (-2.0, -2.0)])
def test_without_a_turn_no_value_is_advised(cloud_s, fix_s):
    (words,) = clock_words(*leads(cloud_s, fix_s))
    assert "a turn that the LiDAR sees, too, will" in words and "clock_offset_s to" not in words


def test_what_was_declared_counts():
    cloud, fix = leads(0.0, 0.0)
    assert clock_words(cloud, fix, turns(0.4), 0.4) == []
    (words,) = clock_words(*leads(0.1, 0.0), turns(0.5), 0.4)
    assert "0.10 +- 0.02 s behind" in words and "clock_offset_s to 0.50" in words


def test_a_receiver_that_is_late_is_still_said():
    (words,) = clock_words(*leads(0.4, 0.9), turns(0.0))
    assert words.startswith("fixes are 0.9")


@pytest.mark.parametrize(
    ("apart_s", "words"),
    [
        (18.01, "GPS time is 18 s ahead"),
        (-37.0, "TAI"),
        (19.2, "19 s"),
        (315_964_782.1, "from 1980"),
        (7200.1, "2 h: local time"),
        (-3600.0, "1 h"),
        (17.0, ""),
        (0.4, ""),
        (60.0, ""),
        (5400.0, ""),
        (90_000.0, ""),
    ],
)
def test_differences_of_time_scales_are_known(apart_s, words):
    found = known_step(apart_s)
    assert words in found and bool(found) == bool(words)


def test_a_clock_of_another_time_scale_is_named_as_that():
    (words,) = clock_words(*leads(18.0, 0.0))
    assert "(GPS time is 18 s ahead of UTC)" in words


def test_clocks_that_have_nothing_in_common_get_no_advice():
    assert clock_words(*leads(1.0e6, 0.0)) == [] and clock_words(*leads(0.0, -3600.0)) == []


def test_fixes_that_come_early_are_newer():
    (words,) = clock_words(*leads(0.0, -0.5))
    assert words.startswith("fixes are 0.50 s newer than attitudes")
