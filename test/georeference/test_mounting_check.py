"""A scanner that is mounted a quarter of a turn, or half of one, other than configured is named,
with the angles that fit; one that is mounted as configured, or that sees nothing to tell by, is
not.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ladar_volume.georeference.lidar_equation import Mounting
from ladar_volume.georeference.mounting_check import (
    MountingCheck,
    angles_of,
    cube_rotations,
    distance_from_planes,
    mounting_doubts,
)
from ladar_volume.georeference.sweep_turns import sweep_image, turn_between
from ladar_volume.math.se3 import quaternion_from_matrix, rotation_xyz
from ladar_volume.model.records import PlatformStates, Returns

NANO = 1_000_000_000
RINGS = np.radians(np.arange(-15.0, 16.0, 2.0))
ROOM = np.array([[-9.0, -6.0, 0.0], [14.0, 8.0, 6.0]])
TRUE = np.radians([0.0, 10.0, 90.0])


def directions():
    azimuth = np.radians(np.arange(0.0, 360.0, 1.0))
    a, v = np.meshgrid(azimuth, RINGS)
    xyz = np.stack([np.cos(v) * np.cos(a), np.cos(v) * np.sin(a), np.sin(v)], axis=-1)
    return xyz.reshape(-1, 3), np.repeat(np.arange(len(RINGS)), len(azimuth))


def in_room(p, d):
    """Ranges from a place to the walls of a room with a step in it."""
    with np.errstate(divide="ignore"):
        far = np.where(d == 0, np.inf, np.where(d > 0, (ROOM[1] - p) / d, (ROOM[0] - p) / d))
        step = np.where(d[:, 0] > 0, (6.0 - p[0]) / d[:, 0], np.inf)
    low = (p + step[:, None] * d)[:, 2] < 2.5
    return np.minimum(far.min(axis=1), np.where(low, step, np.inf))


def over_plane(p, d):
    with np.errstate(divide="ignore"):
        return np.where(d[:, 2] < -0.05, -p[2] / d[:, 2], np.nan)


def flown(configured, ranges=in_room, speed=(1.0, 0.4), seconds=12.0, turn=0.3, noise=0.01):
    """A check that saw sweeps at 10 Hz and states at 100 Hz, its mounting given by angles."""
    rng = np.random.default_rng(3)
    check = MountingCheck(Mounting(rotation_xyz(*configured), np.zeros(3), np.zeros(3), 0))
    R_body_laser, (d_laser, ring) = rotation_xyz(*TRUE), directions()
    for k in range(int(10 * seconds)):
        now = 0.1 * (k + 1)
        t = np.round((0.1 * k + 0.01 * np.arange(10)) * NANO).astype(np.int64)
        p = np.column_stack([*(np.outer(t / NANO, speed).T), np.full(10, 1.5)])
        R = np.array([rotation_xyz(0.0, 0.0, turn * s) for s in t / NANO])
        check.add_states(
            PlatformStates(
                t,
                p,
                np.array([quaternion_from_matrix(each) for each in R]),
                np.zeros((10, 3)),
                np.zeros((10, 3)),
                np.zeros((10, 6, 6)),
                np.zeros(10, np.int64),
            )
        )
        place = np.array([*(now * np.array(speed)), 1.5])
        R_now = rotation_xyz(0.0, 0.0, turn * now) @ R_body_laser
        far = ranges(place, d_laser @ R_now.T) + rng.normal(0.0, noise, len(ring))
        seen = np.isfinite(far) & (far < 60.0)
        times = np.full(np.count_nonzero(seen), round(now * NANO))
        r = (far[:, None] * d_laser)[seen]
        check.add_returns(Returns(times, r, ring[seen].astype(np.uint16), np.ones(len(times))))
    return check


def test_a_mounting_as_configured_is_not_doubted():
    check = flown(TRUE)
    assert check.found() is None and not mounting_doubts(None, np.eye(3)).doubts
    assert check.told > 10
    pairs, better, other, own, every = check.sums
    # pairs that tell are some of all pairs, of which the first rotation has none
    assert (better <= pairs).all() and (own >= 0.0).all() and (own <= every[0] + 1e-9).all()
    assert (other >= 0.0).all() and (other <= every + 1e-9).all() and pairs[0] == own[0] == 0.0


@pytest.mark.parametrize("off", [90.0, 180.0, 270.0])
def test_a_turned_yaw_is_named_with_the_angles_that_fit(off):
    wrong = TRUE + np.radians([0.0, 0.0, off])
    found = flown(wrong).found()
    assert found.alike == 1 and found.better == found.pairs >= 10
    (doubt,) = mounting_doubts(found, rotation_xyz(*wrong)).doubts
    assert doubt.name == "mounting_turned" and "roll 0, pitch 10, yaw 90 deg" in doubt.text
    assert doubt.value > 1.5


def test_axes_of_the_attitude_in_another_order_are_named():
    down = rotation_xyz(np.pi, 0.0, 0.0) @ rotation_xyz(*TRUE)
    angles = np.radians(angles_of(down))
    np.testing.assert_allclose(rotation_xyz(*angles), down, atol=1e-12)
    found = flown(angles).found()
    np.testing.assert_allclose(found.R_body @ down, rotation_xyz(*TRUE), atol=1e-9)


@pytest.mark.parametrize(
    "how",
    [
        {"ranges": over_plane},
        {"speed": (0.0, 0.0), "turn": 0.0},
        {"seconds": 0.4},
    ],
)
def test_where_nothing_tells_nothing_is_said(how):
    assert flown(TRUE + np.radians([0.0, 0.0, 180.0]), **how).found() is None


def test_a_few_degrees_are_not_a_turn():
    assert flown(TRUE + np.radians([0.0, 0.0, 8.0])).found() is None


def test_cube_rotations_are_all_and_no_mirror():
    turns = cube_rotations()
    assert len({R.tobytes() for R in turns}) == 24 and (np.linalg.det(turns) > 0.5).all()
    np.testing.assert_array_equal(turns[0], np.eye(3))
    for R in turns:
        np.testing.assert_allclose(rotation_xyz(*np.radians(angles_of(R))), R, atol=1e-12)


def test_distances_are_those_of_the_planes_in_sight():
    d, ring = directions()
    far = in_room(np.array([0.0, 0.0, 1.5]), d)
    zero = np.zeros(len(ring), np.int64)
    sweep = sweep_image(Returns(zero, far[:, None] * d, ring, np.ones(len(ring))), 0.0)
    rows, cells = np.nonzero(sweep.seen)
    points = sweep.points[rows, cells]
    assert distance_from_planes(points, rows, sweep) < 0.01
    assert distance_from_planes(points * 1.01, rows, sweep) > 0.05
    assert distance_from_planes(points * 9.0, rows, sweep) == pytest.approx(0.2)  # out of reach
    assert np.isnan(distance_from_planes(points[:100], rows[:100], sweep))


def test_sweeps_without_poses_around_them_are_left_out():
    """States too far apart, or of two segments."""

    def states(t_s, segment):
        t, n = (np.array(t_s) * NANO).astype(np.int64), len(t_s)
        q = np.tile([0.0, 0.0, 0.0, 1.0], (n, 1))
        p = np.column_stack([np.array(t_s), np.zeros(n), np.full(n, 1.5)])
        zero = np.zeros((n, 3))
        return PlatformStates(t, p, q, zero, zero, np.zeros((n, 6, 6)), np.array(segment))

    d, ring = directions()

    def sweep(t_s):
        far = in_room(np.array([t_s, 0.0, 1.5]), d)
        times = np.full(len(ring), round(t_s * NANO))
        return Returns(times, far[:, None] * d, ring.astype(np.uint16), np.ones(len(ring)))

    def told(t_s, segment):
        half_turn = rotation_xyz(0.0, 0.0, np.pi)
        check = MountingCheck(Mounting(half_turn, np.zeros(3), np.zeros(3), 0))
        for t in (1.05, 1.35):
            check.add_returns(sweep(t))
        check.add_states(states(t_s, segment))
        return check.told

    assert told([1.0, 1.1, 1.3, 1.4], [0, 0, 0, 0]) == 1
    assert told([1.0, 1.1, 1.29, 1.4], [0, 0, 0, 0]) == 0
    assert told([1.0, 1.1, 1.3, 1.4], [0, 0, 0, 1]) == 0
    assert told([1.06, 1.1, 1.3, 1.4], [0, 0, 0, 0]) == 0
    assert told([1.0, 1.1, 1.3, 1.34], [0, 0, 0, 0]) == 0


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.06), (0.02, 0.0, 0.0), (0.01, -0.015, -0.2)])
def test_the_turn_between_two_sweeps_is_that_of_the_scanner(turn):
    d, ring = directions()
    place, zero = np.array([0.0, 0.0, 1.5]), np.zeros(len(ring), np.int64)

    def seen(R):
        far = in_room(place, d @ R.T)
        return sweep_image(Returns(zero, far[:, None] * d, ring, np.ones(len(ring))), 0.0)

    R = Rotation.from_rotvec(turn).as_matrix()
    np.testing.assert_allclose(turn_between(seen(np.eye(3)), seen(R)), turn, atol=0.004)


def test_a_scanner_that_is_blind_behind_tells_its_turn_by_what_it_sees_ahead():
    d, ring = directions()
    ahead = np.abs(np.arctan2(d[:, 1], d[:, 0])) < 0.5 * np.pi
    d, ring = d[ahead], ring[ahead]
    place, zero, turn = np.array([0.0, 0.0, 1.5]), np.zeros(len(ring), np.int64), (0.01, -0.01, 0.1)

    def seen(R):
        far = in_room(place, d @ R.T)
        return sweep_image(Returns(zero, far[:, None] * d, ring, np.ones(len(ring))), 0.0)

    R = Rotation.from_rotvec(turn).as_matrix()
    np.testing.assert_allclose(turn_between(seen(np.eye(3)), seen(R)), turn, atol=0.004)
