"""The compiled pass against its plain twin, and interpolation against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ladar_volume.georeference import mapping, trajectory
from ladar_volume.georeference.lidar_equation import mounting
from ladar_volume.georeference.trajectory import PathWindow
from ladar_volume.model.parameters import CalibrationParameters

CALIBRATION = CalibrationParameters(
    boresight_roll_rad=0.2,
    boresight_pitch_rad=1.5,
    boresight_yaw_rad=0.4,
    lever_laser_m=(0.1, 0.2, -0.3),
    lever_antenna_m=(0.3, -0.1, 0.8),
)
SIGMAS = np.array([0.02, 3e-4, 4e-4])


def _path(rule, seed=0):
    rng = np.random.default_rng(seed)
    state_t = np.cumsum(rng.integers(4_000_000, 12_000_000, 200))
    q = Rotation.from_rotvec(np.cumsum(rng.normal(scale=0.05, size=(200, 3)), axis=0)).as_quat()
    q[::3] *= -1  # either sign is the same attitude
    q[50:53] = q[50]  # standing still
    position_t = np.arange(-1, 30) * 60_000_000
    p = np.cumsum(rng.normal(size=(31, 3)), axis=0)
    segment = np.repeat([0, 1, -1, 2], [60, 70, 10, 60])
    ends = trajectory.interval_velocities(position_t, p, np.zeros(31, np.int64), rule)
    return PathWindow(state_t, q, segment, position_t, p, *ends, rule != "linear")


@pytest.mark.parametrize("rule", ["linear", "parabola", "hermite"])
def test_kernel_equals_its_plain_twin(rule):
    path, rng = _path(rule), np.random.default_rng(7)
    n = 5000
    t = rng.integers(path.state_t[0] - 50_000_000, path.state_t[-1] + 50_000_000, n)
    t[:200] = path.state_t
    t[200:220] = path.position_t[1:21]
    r = rng.normal(size=(n, 3)) * 20
    r[300] = (0, 0, 4.0)
    vehicle, region = (
        mapping.vehicle_box((-5, -5, -5, 5, 5, 5)),
        mapping.region_box((-30, -30, -20, 30, 30, 50)),
    )
    args = (t, r, path, mounting(CALIBRATION), SIGMAS, vehicle, region)
    fast, plain = mapping.map_returns(*args), mapping.map_returns_numpy(*args)
    np.testing.assert_array_equal(fast.status, plain.status)
    assert set(np.unique(fast.status)) == {
        mapping.MAPPED,
        mapping.NO_POSE,
        mapping.IN_VEHICLE,
        mapping.OUTSIDE_REGION,
    }
    np.testing.assert_allclose(fast.r_map, plain.r_map, rtol=0, atol=1e-11)
    np.testing.assert_allclose(fast.C_ind, plain.C_ind, rtol=1e-5, atol=1e-12)
    # any order and any cut of the cloud gives the same bits
    order = rng.permutation(n)
    shuffled = mapping.map_returns(t[order], r[order], *args[2:])
    np.testing.assert_array_equal(shuffled.r_map, fast.r_map[order])
    np.testing.assert_array_equal(shuffled.C_ind, fast.C_ind[order])


def test_no_states_no_pose():
    none = PathWindow(*(knots[:0] for knots in _path("linear")[:-1]), False)
    args = (
        np.arange(5),
        np.ones((5, 3)),
        none,
        mounting(CALIBRATION),
        SIGMAS,
        mapping.vehicle_box(()),
        mapping.region_box(()),
    )
    for result in (mapping.map_returns(*args), mapping.map_returns_numpy(*args)):
        assert (result.status == mapping.NO_POSE).all() and np.isnan(result.r_map).all()


def test_covariance_of_a_return_straight_ahead_is_the_closed_form():
    t = np.array([0, 100])
    path = PathWindow(
        t,
        np.tile([0.0, 0, 0, 1], (2, 1)),
        np.zeros(2, np.int64),
        t,
        np.zeros((2, 3)),
        np.zeros((2, 3)),
        np.zeros((2, 3)),
        False,
    )
    mount = mounting(CalibrationParameters())
    got = mapping.map_returns(
        np.array([50]),
        np.array([[30.0, 0, 0]]),
        path,
        mount,
        SIGMAS,
        mapping.vehicle_box(()),
        mapping.region_box(()),
    )
    np.testing.assert_allclose(
        got.C_ind[0], [0.02**2, 0, 0, (30 * 3e-4) ** 2, 0, (30 * 4e-4) ** 2], rtol=1e-6
    )
    np.testing.assert_array_equal(got.r_map[0], [30.0, 0, 0])


@pytest.mark.parametrize("rule", ["parabola", "hermite"])
def test_a_parabola_on_uneven_knots_comes_back_and_linear_a_line(rule):
    t = np.array([0, 100, 230, 300, 420, 500], np.int64) * 1_000_000
    seconds = t[:, None] * 1e-9
    p = (
        np.array([1.0, 2, 3])
        + seconds * np.array([4.0, -5, 6])
        + seconds**2 * np.array([7.0, 8, -9])
    )
    ends = trajectory.interval_velocities(t, p, np.zeros(6, np.int64), rule)
    empty = np.zeros(0, np.int64)
    query = (
        np.linspace(101, 419, 50).astype(np.int64) * 1_000_000
    )  # inside, where both ends have three knots
    j = np.searchsorted(t, query, side="right") - 1
    s = query[:, None] * 1e-9
    window = PathWindow(empty, np.zeros((0, 4)), empty, t, p, *ends, True)
    got, velocity = trajectory.interpolate_position(window, query, j)
    np.testing.assert_allclose(
        got,
        np.array([1.0, 2, 3]) + s * np.array([4.0, -5, 6]) + s**2 * np.array([7.0, 8, -9]),
        atol=1e-12,
    )
    np.testing.assert_allclose(
        velocity, np.array([4.0, -5, 6]) + 2 * s * np.array([7.0, 8, -9]), atol=1e-10
    )
    line = PathWindow(
        empty, np.zeros((0, 4)), empty, t, seconds * np.array([1.0, 2, 3]), *ends, False
    )
    got, velocity = trajectory.interpolate_position(line, query, j)
    np.testing.assert_allclose(got, s * np.array([1.0, 2, 3]), atol=1e-14)
    np.testing.assert_allclose(velocity, np.tile([1.0, 2, 3], (50, 1)), rtol=1e-12)


def test_tangents_do_not_reach_across_a_gap():
    t, gap = np.array([0, 1, 2, 10, 11]) * 10**9, np.array([0, 0, 0, 1, 1])
    p = np.array([[0.0], [1], [4], [100], [107]]) * np.ones(3)
    np.testing.assert_allclose(trajectory.tangents(t, p, gap)[:, 0], [1, 2, 3, 7, 7], rtol=1e-12)
    assert trajectory.tangents(t[:1], p[:1], gap[:1]).shape == (1, 3)


def test_a_path_round_a_body_is_not_drawn_inwards():
    """Chords of a circle lie inside it: on the mean by h² / 12 of the acceleration, towards what is
    driven round. The parabola through the fix before does not; where none is, at the first interval
    and after a gap, the chord stays.
    """
    t = np.arange(40) * 100_000_000
    radius, turn = 5.0, 0.5  # m, rad/s
    angle = turn * t * 1e-9
    p = radius * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    gap = (np.arange(40) >= 20).astype(np.int64)
    query = np.arange(1, 390) * 10_000_000
    j = np.searchsorted(t, query, side="right") - 1
    empty, off = np.zeros(0, np.int64), {}
    for rule in ("linear", "parabola"):
        ends = trajectory.interval_velocities(t, p, gap, rule)
        window = PathWindow(empty, np.zeros((0, 4)), empty, t, p, *ends, rule != "linear")
        at, _ = trajectory.interpolate_position(window, query, j)
        off[rule] = np.linalg.norm(at, axis=1) - radius
    whole = (j != 19) & (j != 20) & (j > 0)  # the gap, and where no fix is before
    assert off["linear"][whole].mean() == pytest.approx(-radius * turn**2 * 0.01 / 12.0, rel=0.02)
    assert np.abs(off["parabola"][whole]).max() < 1e-6
    chords = (j == 0) | (j == 20)
    np.testing.assert_allclose(off["parabola"][chords], off["linear"][chords], atol=1e-12)
