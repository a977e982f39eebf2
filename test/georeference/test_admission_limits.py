"""What is admitted to the trajectory, in which order, and when time begins again: at the limits."""

import numpy as np
import pytest

from ladar_volume.georeference.clock_restart import AHEAD_NS, BACK_NS, HOLD_NS, Restart
from ladar_volume.georeference.fix_steps import LEAST_M, SIDE, TIMES, FixSteps, step_in_window
from ladar_volume.georeference.sample_admission import (
    UNIT_TOLERANCE,
    TimeOrder,
    fix_covariance,
    imu_attitude,
    odometry_pose,
    unit_quaternion,
)
from ladar_volume.model.errors import InputError
from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.model.records import Fix, ImuSample, OdometrySample

S = 1_000_000_000
BUDGET = BudgetParameters()


def reason(call):
    """Why something is refused; "" where it is not."""
    try:
        call()
    except InputError as error:
        return error.reason
    return ""


@pytest.mark.parametrize(
    ("norm", "said"),
    [
        (1.0 + 0.99 * UNIT_TOLERANCE, ""),
        (1.0 - 0.99 * UNIT_TOLERANCE, ""),
        (1.0 + 1.01 * UNIT_TOLERANCE, "imu_not_unit"),
        (1.0 - 1.01 * UNIT_TOLERANCE, "imu_not_unit"),
        (np.inf, "imu_nan"),
        (1e200, "imu_not_unit"),  # whose square no double holds
    ],
)
def test_a_quaternion_is_of_norm_one_to_a_hundredth(norm, said):
    q = np.array([0.48, -0.6, 0.64, 0.0]) * (norm if np.isfinite(norm) else 1.0)
    q[3] = 0.0 if np.isfinite(norm) else norm
    assert reason(lambda: unit_quaternion(q, "imu")) == said
    if not said:
        np.testing.assert_allclose(unit_quaternion(q, "imu"), [0.48, -0.6, 0.64, 0.0])


@pytest.mark.parametrize(
    ("lat", "lon", "said"),
    [
        (90.0, 360.0, ""),
        (-90.0, -360.0, ""),
        (90.001, 0.0, "fix_out_of_range"),
        (-90.001, 0.0, "fix_out_of_range"),
        (0.0, 360.001, "fix_out_of_range"),
        (0.0, -360.001, "fix_out_of_range"),
        (np.nan, 0.0, "fix_nan"),
    ],
)
def test_a_fix_is_on_the_earth(lat, lon, said):
    fix = Fix(0, lat, lon, 20.0, np.eye(3))
    assert reason(lambda: fix_covariance(fix, BUDGET, "refuse")) == said


SKEW = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])


@pytest.mark.parametrize(
    ("C", "said"),
    [
        (np.diag([4.0, 1.0, 0.0]), ""),
        (np.diag([4.0, 1.0, -3.9e-6]), ""),  # rounding of the largest, to a millionth
        (np.diag([4.0, 1.0, -4.1e-6]), "fix_bad_covariance"),
        (np.diag([4.0, 1.0, 1.0]) + 1.9e-6 * SKEW, ""),
        (np.diag([4.0, 1.0, 1.0]) + 2.1e-6 * SKEW, "fix_bad_covariance"),
        (1.7e308 * np.eye(3), ""),
        (np.eye(3) + 1.7e308 * SKEW, "fix_bad_covariance"),
        (np.eye(2), "fix_bad_covariance"),
        (np.diag([1.0, np.inf, 1.0]), "fix_bad_covariance"),
        (np.zeros((3, 3)), "fix_unknown_covariance"),
        (None, "fix_unknown_covariance"),
    ],
)
def test_a_covariance_is_symmetric_and_positive_or_unknown(C, said):
    fix = Fix(0, 50.0, 14.0, 20.0, C)
    assert reason(lambda: fix_covariance(fix, BUDGET, "refuse")) == said
    if said == "fix_unknown_covariance":
        found = fix_covariance(fix, BUDGET, "budget")
        np.testing.assert_allclose(found, np.diag(np.square(BUDGET.position_sigma_m)))


ONE = np.array([0.0, 0.0, 0.0, 1.0])


@pytest.mark.parametrize(
    ("rate", "said"),
    [
        ([0.1, 0.2, 0.3], ""),
        ([np.nan] * 3, ""),
        ([np.nan, 0.0, 0.0], "nan"),
        ([0.0, np.inf, 0.0], "nan"),
        ([0.0, 0.0], "nan"),
    ],
)
def test_a_rate_is_known_or_wholly_unknown(rate, said):
    rate = np.array(rate)
    imu = ImuSample(0, ONE, rate, np.eye(3))
    assert reason(lambda: imu_attitude(imu, BUDGET, "refuse")) == (said and "imu_nan")
    pose = OdometrySample(0, np.ones(3), ONE, np.zeros(3), rate, np.eye(6))
    assert reason(lambda: odometry_pose(pose, BUDGET, "refuse")) == (said and "odometry_nan")
    lost = OdometrySample(0, np.array([1.0, np.nan, 0.0]), ONE, np.zeros(3), rate, np.eye(6))
    assert reason(lambda: odometry_pose(lost, BUDGET, "refuse")) == "odometry_nan"


def ordered(times_ns, jump_s=10.0):
    order = TimeOrder("fix", jump_s)
    return [order.push(t, t) for t in times_ns], order


def test_a_jump_is_longer_than_its_limit_and_is_confirmed_within_it():
    told, _ = ordered([0, 10 * S, 20 * S + 1])
    assert told == [([0], []), ([10 * S], []), ([], [])]
    told, _ = ordered([0, 20 * S, 30 * S])
    assert told[2] == ([20 * S, 30 * S], [])
    told, order = ordered([0, 20 * S, 30 * S + 1])
    assert told[2] == ([], ["fix_time_jump"]) and order.finish() == ["fix_time_jump"]
    assert order.finish() == []
    told, _ = ordered([0, 20 * S, 20 * S, 0, 1])
    assert told[2:] == [([], ["fix_duplicate"]), ([], ["fix_duplicate"]), ([1], ["fix_time_jump"])]
    told, _ = ordered([5, 4, 5, 6])
    assert [t[1] for t in told] == [[], ["fix_time_backwards"], ["fix_duplicate"], []]


def test_a_clock_is_set_back_by_more_than_half_a_second():
    for step, said in ((S // 2, []), (S // 2 + 1, ["fix_clock_back"])):
        after = [10 * S - 4 * S // 10, 10 * S - 3 * S // 10, 10 * S - S // 10, 10 * S + S // 20]
        told, _ = ordered([10 * S, 10 * S - step, *after])
        assert told[-1][1] == said


def test_a_clock_that_was_set_back_is_believed_after_ten_seconds():
    steps = [20 * S, *range(15 * S, 26 * S, S)]
    for late, taken in ((0, False), (1, True)):
        told, _ = ordered([*steps[:-1], 25 * S + late])
        # at 25 s it has been back for ten seconds
        assert (told[-1][0] != []) == taken


def test_times_that_go_back_by_two_seconds_are_late_and_beyond_they_may_begin_again():
    for step, begun in ((BACK_NS - 1, False), (BACK_NS, True)):
        door, taken = Restart(), []
        for kind in ("a", "b"):
            door.push(kind, 100 * S, 0)
        for t in (100 * S - step - 1, 100 * S - step):
            for kind in ("a", "b"):
                taken.append(door.push(kind, t, t)[0])
        assert any(taken) == begun and door.count == int(begun)


@pytest.mark.parametrize(("other", "agree"), [(BACK_NS, True), (BACK_NS + 1, False)])
def test_two_topics_begin_again_by_the_same_step(other, agree):
    door = Restart()
    for kind in ("a", "b"):
        door.push(kind, 100 * S, 0)
    for t in (10 * S, 10 * S + 1):
        door.push("a", t, 0)
    said = [door.push("b", 10 * S + other + k, 0)[0] for k in (0, 1)]
    assert said == [False, agree]


def test_what_goes_back_waits_two_seconds_for_another_topic():
    for late, strays in ((HOLD_NS, 0), (HOLD_NS + 1, 1)):
        door = Restart()
        door.push("a", 100 * S, 0)
        door.push("a", 10 * S, 1)
        began, now, lost = door.push("a", 10 * S + late, 2)
        assert (began, len(now), lost) == (False, strays, [])
        assert [s for _, s in door.finish()] == ([1, 2] if not strays else [2])
        assert door.finish() == []


def test_one_stamp_far_ahead_makes_no_later_one_look_old():
    for step, old in ((AHEAD_NS, True), (AHEAD_NS + 1, False)):
        door = Restart()
        for kind in ("a", "b"):
            door.push(kind, 0, 0)
            door.push(kind, step, 0)
        held = door.push("a", S, 1)
        assert (held[1] == []) == old
    door = Restart()
    for t in (0, 50 * S, 60 * S):  # confirmed within ten seconds
        door.push("a", t, t)
    assert door.push("a", S, 1)[1] == []
    door = Restart()
    for t in (0, 50 * S, 60 * S + 1):
        door.push("a", t, t)
    assert door.push("a", S, 1)[1] == [("a", 1)]


def step_of(size_m, noise_m, fixes=6 * SIDE, seed=2):
    rng = np.random.default_rng(seed)
    found = FixSteps()
    for k in range(fixes):
        place = np.array([0.3 * k + size_m * (k >= fixes // 2), 0.1 * k, 5.0])
        found.add(k * S // 10, place + noise_m * rng.normal(size=3))
    return found.largest()


def test_a_step_is_so_many_times_the_usual_and_no_less_than_five_centimetres():
    for size, told in ((1.02 * LEAST_M, True), (0.98 * LEAST_M, False)):
        found = step_of(size, 0.0)
        assert (found is not None) == told
    found = step_of(2.0, 0.05)
    assert found.size_m > TIMES * found.usual_m and found.size_m == pytest.approx(2.0, rel=0.2)
    assert step_of(0.3, 0.05) is None
    assert step_of(1.0, 0.0, 6 * SIDE - 2) is None and step_of(1.0, 0.0, 6 * SIDE) is not None


def test_a_window_ends_at_a_gap_of_more_than_a_second():
    for gap, told in ((S, True), (S + 1, False)):
        found = FixSteps()
        for k in range(12 * SIDE):
            t = k * S // 10 + (gap - S // 10 if k >= 6 * SIDE else 0)
            found.add(t, np.array([float(k >= 6 * SIDE), 0.0, 0.0]))
        assert (found.largest() is not None) == told


def test_a_step_beside_any_cubic_is_found_whole():
    t = np.array([-0.6, -0.5, -0.33, -0.2, -0.11, -0.05, 0.0, 0.1, 0.2, 0.3, 0.4, 0.55])
    rng = np.random.default_rng(4)
    path, step = rng.normal(size=(4, 3)), np.array([0.2, -0.1, 0.05])
    p = np.vander(t, 4) @ path + step * (t >= 0.0)[:, None]
    np.testing.assert_allclose(step_in_window(t, list(p)), step, atol=1e-9)
    np.testing.assert_allclose(step_in_window(40.0 * t, list(p)), step, atol=1e-9)
