"""What clocks may differ by before it is named, at the limits."""

import numpy as np
import pytest

from ladar_volume.georeference.clock_check import Lead, SweepTimes

MS = 1_000_000


def led(leads_ms):
    """A clock whose samples arrive with these leads of the reference, whose period is 0."""
    lead = Lead()
    lead.reference(10**12)
    for ms in leads_ms:
        lead.add_reference_clock(10**12 - round(ms * MS))
    return lead


def scattered(middle_ms, off_ms, count=20):
    """Half of them this much above, and half below: with a sigma of 1.4826 of it."""
    return [middle_ms + off_ms * (1 if k % 2 else -1) for k in range(count)]


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("middle_ms", "off_ms", "state"),
    [
        (49.9, 0.0, "good"),
        (50.1, 0.0, "offset"),
        (94.0, 10.0, "good"),  # 50 ms of latency and three sigmas of 14.8 ms
        (95.0, 10.0, "offset"),
        (0.0, 33.7, "good"),
        (0.0, 33.8, "unsteady"),  # a sigma of 50.1 ms
    ],
)
def test_an_offset_is_beyond_latency_and_three_sigmas(sign, middle_ms, off_ms, state):
    lead = led([sign * ms for ms in scattered(middle_ms, off_ms)])
    middle, sigma = lead.estimate_s
    assert middle == pytest.approx(sign * middle_ms * 1e-3, abs=1e-9)
    assert sigma == pytest.approx(1.4826e-3 * off_ms, abs=1e-9)
    assert lead.state == state


def test_a_verdict_needs_ten_samples_and_forgets_those_before_the_last_fifty():
    assert led([0.0] * 9).state == "unknown" and led([0.0] * 10).state == "good"
    half = led([0.0] * 100 + [200.0] * 25)
    assert half.estimate_s[0] == pytest.approx(0.1)
    assert led([0.0] * 100 + [200.0] * 26).estimate_s[0] == pytest.approx(0.2)
    assert led([0.0] * 100 + [200.0] * 24).estimate_s[0] == pytest.approx(0.0)


def test_a_reference_that_does_not_move_on_has_no_period():
    lead = Lead()
    for t in (0, 40, 40, 10, 50):
        lead.reference(t * MS)
        for _ in range(4):
            lead.add_reference_clock(t * MS)
    # steps of 40 ms alone, forwards: half of one of them is what the other clock is behind
    assert lead.estimate_s[0] == pytest.approx(0.02)
    lead.add_reference_clock(0)
    assert Lead().estimate_s is None


def test_a_return_is_corrupt_beyond_a_second_from_the_middle_of_its_cloud():
    sweeps, second = SweepTimes(), 10**9
    assert sweeps.corrupt(np.array([0, second])) is None  # all within a second
    t = np.array([0, 10, 20, 10 - second, 9 - second, 10 + second, 11 + second])
    assert sweeps.corrupt(t).tolist() == [False] * 4 + [True, False, True]


@pytest.mark.parametrize(("begin_ms", "count"), [(98.0, 0), (97.9, 1), (-10.0, 1)])
def test_sweeps_overlap_by_more_than_two_milliseconds(begin_ms, count):
    sweeps = SweepTimes()
    sweeps.add(0, 100 * MS)
    sweeps.add(round(begin_ms * MS), 150 * MS)
    assert sweeps.overlapping == count
    sweeps.add(149 * MS, 250 * MS)
    assert sweeps.overlapping == count


def test_a_cloud_that_ends_before_the_last_one_is_late_and_does_not_overlap():
    sweeps = SweepTimes()
    sweeps.add(100 * MS, 200 * MS)
    sweeps.add(50 * MS, 150 * MS)
    assert sweeps.overlapping == 0
