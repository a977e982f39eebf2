"""Frames, covariances and clocks of the autopilot against independent computations."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ladar_volume.io.mavlink.mavlink_clock import (
    ClockInUse,
    ClockOffset,
    S,
    lower_line,
    middle_line,
)
from ladar_volume.io.mavlink.mavlink_frames import (
    D,
    enu_flu_from_ned_frd,
    euler_from_matrix,
    flu_from_frd,
    local_from_frd,
    pose_covariance,
    quaternion_from_euler,
)
from ladar_volume.io.mavlink.mavlink_frames import S as NED_TO_ENU
from ladar_volume.io.mavlink.mavlink_poses import accuracy_covariance

rng = np.random.default_rng(3)
ANGLES = [
    (0, 0, 0),
    (0.1, 0, 0),
    (0, 0.2, 0),
    (0, 0, 1.0),
    (-0.3, 0.7, -2.5),
    (3.0, -1.5, 3.1),
    *rng.uniform(-1.5, 1.5, (20, 3)).tolist(),
]


def seen(roll, pitch, yaw, v_flu):
    """Where a body vector points in east, north, up: by hand, through scipy's rotations of the
    aerospace sequence.
    """
    frd = np.array([v_flu[0], -v_flu[1], -v_flu[2]])
    ned = Rotation.from_euler("ZYX", [yaw, pitch, roll]).apply(frd)
    return np.array([ned[1], ned[0], -ned[2]])


@pytest.mark.parametrize("angles", ANGLES)
def test_attitudes_turn_vectors_as_an_independent_rotation_does(angles):
    q = enu_flu_from_ned_frd(quaternion_from_euler(*angles))
    for v in np.eye(3):
        np.testing.assert_allclose(Rotation.from_quat(q).apply(v), seen(*angles, v), atol=1e-14)
    np.testing.assert_allclose(
        euler_from_matrix(Rotation.from_quat(quaternion_from_euler(*angles)).as_matrix()),
        [Rotation.from_euler("ZYX", angles[::-1]).as_euler("ZYX")[i] for i in (2, 1, 0)],
        atol=1e-12,
    )


def test_what_a_pilot_would_say():
    def axes(roll, pitch, yaw):
        return (
            Rotation.from_quat(enu_flu_from_ned_frd(quaternion_from_euler(roll, pitch, yaw)))
            .as_matrix()
            .T
        )

    forward, left, up = axes(0, 0, 0)  # level, heading north
    np.testing.assert_allclose([forward, left, up], [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-15)
    assert axes(0, 0, math.pi / 2)[0] == pytest.approx([1, 0, 0])  # heading east
    assert axes(0, 0.1, 0)[0][2] == pytest.approx(math.sin(0.1))  # nose up
    assert axes(0.1, 0, 0)[1][2] == pytest.approx(
        math.sin(0.1)
    )  # right wing down: the left one rises
    np.testing.assert_allclose(flu_from_frd(np.array([1.0, 2.0, 3.0])), [1, -2, -3])


def test_a_local_frame_keeps_its_heading():
    q = quaternion_from_euler(0.0, 0.0, 0.3)  # to the right
    assert Rotation.from_quat(local_from_frd(q)).as_euler("ZYX")[0] == pytest.approx(-0.3)


@pytest.mark.parametrize(("parent", "north"), [(NED_TO_ENU, True), (D, False)])
def test_a_pose_covariance_is_that_of_the_turned_errors(parent, north):
    angles = np.array([0.4, -0.6, 2.1])
    A = rng.normal(size=(6, 6)) * 1e-2
    C = A @ A.T
    R = Rotation.from_euler("ZYX", angles[::-1])
    turned = pose_covariance(C[np.triu_indices(6)], angles[0], angles[1], R.as_matrix(), parent)

    def pose(x):
        # position, and the rotation from the nominal attitude about the parent's axes
        q = quaternion_from_euler(*(angles + x[3:]))
        q0 = quaternion_from_euler(*angles)
        convert = enu_flu_from_ned_frd if north else local_from_frd
        return np.concatenate(
            [
                parent @ x[:3],
                (
                    Rotation.from_quat(convert(q)) * Rotation.from_quat(convert(q0)).inv()
                ).as_rotvec(),
            ]
        )

    h = 1e-6
    J = np.column_stack([(pose(h * e) - pose(-h * e)) / (2 * h) for e in np.eye(6)])
    np.testing.assert_allclose(turned, J @ C @ J.T, rtol=1e-7, atol=1e-12)


def test_an_unknown_accuracy_is_never_zero():
    np.testing.assert_allclose(
        accuracy_covariance(14, 20, False), np.diag([1.96e-4, 1.96e-4, 4e-4])
    )
    assert np.sqrt(np.trace(accuracy_covariance(14, 20, True)[:2, :2])) == pytest.approx(0.014)
    for h, v in ((0, 20), (14, 0), (2**32 - 1, 20), (14, 2**32 - 1), (0, 0)):
        assert accuracy_covariance(h, v, False) is None


def arrivals(seed, seconds, drift=0.0, least=0.004, mean=0.02, start=1_700_000_000 * S):
    """(remote, local) with exponential delays at 20 Hz."""
    r = np.random.default_rng(seed)
    remote = (np.arange(0, seconds, 0.05) * S).astype(np.int64) + 5 * S
    delay = least + r.exponential(mean, len(remote))
    local = start + (remote * (1 + drift)).astype(np.int64) + (delay * S).astype(np.int64)
    return list(
        zip(remote.tolist(), local.tolist(), strict=True)
    ), lambda t: start + int(t * (1 + drift)) + int(least * S)


@pytest.mark.parametrize("drift", [0.0, 4e-5, -4e-5])
def test_arrivals_give_offset_and_drift_within_sigma(drift):
    errors, sigmas = [], []
    for seed in range(20):
        clock = ClockOffset(60.0, 2.0, False, 0.0)
        pairs, true = arrivals(seed, 50.0, drift)
        for remote, local in pairs:
            clock.add(remote, local)
        remote = pairs[-1][0]
        errors.append(remote + clock.line.offset(remote) - true(remote))
        sigmas.append(clock.line.sigma_ns)
    assert (
        np.sqrt(np.mean(np.square(errors))) < 2.0 * np.mean(sigmas) and np.mean(sigmas) < 0.01 * S
    )
    assert np.max(np.abs(errors)) < 0.006 * S  # of delays of 20 ms on average


def test_stamps_never_run_backwards_and_settle_first():
    clock, use = ClockOffset(60.0, 2.0, False, 0.0), ClockInUse()
    pairs, true = arrivals(1, 40.0)
    worst = (
        pairs[:5] + [(r, v + S // 5) for r, v in pairs[5:200]] + pairs[200:]
    )  # the link is slow at first
    last, stamps = 0, 0
    for remote, local in worst:
        clock.add(remote, local)
        assert clock.ready == (remote - worst[0][0] >= 2 * S - S // 20) or not clock.ready
        if clock.ready:
            t = use.local(remote, clock.line)
            assert t > last
            last, stamps = t, stamps + 1
    assert stamps > 700 and abs(last - true(worst[-1][0])) < 0.01 * S


@pytest.mark.parametrize("step", [5.0, -5.0])
def test_a_clock_that_was_set_is_noticed_and_a_jam_on_the_link_is_not_taken_for_it(step):
    clock = ClockOffset(60.0, 2.0, False, 0.0)
    pairs, true = arrivals(2, 60.0)
    for i, (remote, local) in enumerate(pairs):
        jam = S if 400 <= i < 440 else 0  # two seconds of messages a second late
        clock.add(remote, local + jam + (int(step * S) if i >= 800 else 0))
        if i == 790:
            assert (
                clock.resets == 0
                and abs(remote + clock.line.offset(remote) - true(remote)) < 0.01 * S
            )
    assert clock.resets == 1
    assert abs(remote + clock.line.offset(remote) - true(remote) - int(step * S)) < 0.01 * S


def test_round_trips_take_the_quick_ones():
    r, clock = np.random.default_rng(5), ClockOffset(60.0, 2.0, True, 0.0)
    offset = 1_700_000_000 * S
    for i in range(60):
        out, back = 0.002 + r.exponential(0.01, 2)
        boot = 10 * S + i * S
        sent, got = boot + offset - int(out * S), boot + offset + int(back * S)
        clock.add(boot, (sent + got) // 2, 0.5 * (got - sent))
    error = clock.line.offset(boot) - offset
    assert abs(error) < 3 * clock.line.sigma_ns and clock.line.sigma_ns < 0.004 * S


def test_lines_through_exact_points_are_exact():
    points = [(i * S, 100.0 + 2e-5 * i * S) for i in range(30)]
    for line in (lower_line(points), middle_line(points)):
        assert line.residual_ns(17 * S) == pytest.approx(
            100.0 + 2e-5 * 17 * S
        ) and line.sigma_ns == pytest.approx(0.0, abs=1e-3)
    outlier = [*points[:10], (10 * S, 9e9), *points[11:]]
    assert lower_line(outlier).drift == pytest.approx(2e-5) and middle_line(
        outlier
    ).drift == pytest.approx(2e-5)
    assert lower_line(points[:3]).drift == 0.0  # too short to tell
