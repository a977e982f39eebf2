"""Gaps of positions and attitudes to the nanosecond, and states between positions."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ladar_volume.georeference.trajectory import Trajectory
from ladar_volume.model.parameters import GeoreferenceParameters

S = 1_000_000_000
T0 = 1_700_000_000 * S


def made(lever=(0.0, 0.0, 0.0), **more):
    given = {"position_interpolation": "linear", "max_position_gap_s": 1.0}
    given |= {"max_attitude_gap_s": 0.5} | more
    return Trajectory(GeoreferenceParameters(**given), np.array(lever))


def place(t_ns):
    return np.array([2.0, -1.0, 0.5]) * (t_ns - T0) * 1e-9


def feed(stage, position_ns, attitude_ns, rate=None, C=None):
    for k, t in enumerate(position_ns):
        stage.add_position(T0 + t, place(T0 + t), (k + 1.0) * np.eye(3) if C is None else C[k])
    omega = np.zeros(3) if rate is None else rate
    for t in attitude_ns:
        q = Rotation.from_rotvec(omega * t * 1e-9).as_quat()
        stage.add_attitude(T0 + t, q, omega, 0.01 * np.eye(3))


@pytest.mark.parametrize(("late_ns", "covered"), [(0, True), (1, False)])
def test_positions_a_whole_gap_apart_are_joined_and_a_nanosecond_more_is_a_gap(late_ns, covered):
    stage = made()
    positions = [0, S, 2 * S + late_ns, 3 * S]
    feed(stage, positions, range(0, 3 * S, S // 4))
    states = stage.decide()
    inside = (states.t_ns > T0 + S) & (states.t_ns < T0 + 2 * S + late_ns)
    assert inside.any() == covered
    # the last position before a gap still ends what lies before it
    assert T0 + S in states.t_ns
    segments = np.unique(states.segment)
    assert len(segments) == (1 if covered else 2)
    np.testing.assert_allclose(states.p_map_body, [place(t) for t in states.t_ns], atol=1e-9)
    np.testing.assert_allclose(states.v_body, np.tile([2.0, -1.0, 0.5], (len(states), 1)))


@pytest.mark.parametrize(("late_ns", "segments"), [(0, 1), (1, 2)])
def test_attitudes_a_whole_gap_apart_are_joined_and_a_nanosecond_more_is_a_gap(late_ns, segments):
    stage = made()
    feed(stage, range(0, 4 * S, S // 2), [0, S // 4, 3 * S // 4 + late_ns, S])
    assert len(np.unique(stage.decide().segment)) == segments


def test_a_covariance_goes_over_from_one_position_to_the_next():
    stage = made()
    C = [np.diag([1.0, 4.0, 9.0]), np.diag([2.0, 2.0, 1.0]), np.eye(3)]
    feed(stage, [0, S, 2 * S], [0, S // 4, S, 3 * S // 2], C=C)
    states = stage.decide()
    expected = [C[0], 0.75 * C[0] + 0.25 * C[1], C[1], 0.5 * (C[1] + C[2])]
    np.testing.assert_allclose(states.C_nav[:, :3, :3], expected)
    np.testing.assert_allclose(states.C_nav[:, 3:, 3:], np.tile(0.01 * np.eye(3), (4, 1, 1)))


def test_the_body_swings_about_its_antenna():
    """Its velocity by small steps of its place."""
    lever, rate = np.array([0.3, -0.2, 1.1]), np.array([0.2, 0.5, -0.7])
    stage = made(lever)
    feed(stage, range(0, 3 * S, S // 2), range(0, 2 * S, S // 10), rate)
    states = stage.decide()
    assert len(states) == 20

    def body(t_s):
        return np.array([2.0, -1.0, 0.5]) * t_s - Rotation.from_rotvec(rate * t_s).apply(lever)

    h = 1e-3
    for i in (0, 7, 19):
        t_s = (int(states.t_ns[i]) - T0) * 1e-9
        np.testing.assert_allclose(states.p_map_body[i], body(t_s), atol=1e-6)
        R = Rotation.from_quat(states.q_map_body[i])
        v = (body(t_s + h) - body(t_s - h)) / (2.0 * h)
        np.testing.assert_allclose(R.apply(states.v_body[i]), v, atol=1e-5)


def test_what_is_decided_waits_for_the_position_after_and_begins_with_the_first_of_both():
    stage = made()
    assert stage.begin_ns is None and stage.decided_ns is None and stage.decide() is None
    feed(stage, [S // 2], [0, S // 2, S])
    assert stage.begin_ns == T0 + S // 2 and stage.decided_ns == T0
    assert stage.decide() is None  # no position before it
    stage.add_position(T0 + S, place(T0 + S), np.eye(3))
    assert stage.decided_ns == T0 + S // 2
    assert stage.decide().t_ns.tolist() == [T0 + S // 2]
    stage.add_position(T0 + 2 * S, place(T0 + 2 * S), np.eye(3))
    assert stage.decide().t_ns.tolist() == [T0 + S] and stage.begin_ns == T0 + S // 2


def test_a_window_holds_one_knot_to_spare_on_either_side():
    stage = made()
    feed(stage, range(0, 5 * S, S // 2), range(0, 4 * S, S // 10))
    stage.decide()
    window = stage.window(T0 + S + 1, T0 + 2 * S - 1)
    assert window.state_t[0] == T0 + S and window.state_t[-1] == T0 + 2 * S
    whole = stage.window(T0 + S, T0 + 2 * S)
    assert whole.state_t[0] == T0 + S and whole.state_t[-1] == T0 + 2 * S
    assert len(stage.window(T0 - S, T0 - 1).state_t) <= 1
