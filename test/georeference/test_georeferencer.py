"""The streaming stage: what comes out, in any interleaving, and everything that can be wrong with
what goes in.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ladar_volume.georeference import point_jacobian, trajectory
from ladar_volume.georeference.error_budget import independent_sigmas
from ladar_volume.georeference.geodesy import LocalFrame
from ladar_volume.georeference.georeferencer import Georeferencer
from ladar_volume.georeference.knot_table import Knots
from ladar_volume.georeference.sample_admission import TimeOrder
from ladar_volume.math import packed_covariance
from ladar_volume.model.errors import ParameterValueError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import (
    Datum,
    Fix,
    ImuSample,
    MappedPoints,
    OdometrySample,
    PlatformStates,
    Returns,
    concatenate,
    select,
)

DATUM = Datum(50.0, 14.0, 200.0)
FRAME = LocalFrame(DATUM)
T0 = 1_700_000_000_000_000_000
LEVER_LASER, LEVER_ANTENNA = np.array([0.1, 0.02, -0.2]), np.array([-0.3, 0.1, 0.5])
START, SPEED, RATE = (
    np.array([3.0, -2.0, 20.0]),
    np.array([4.0, 1.0, -0.5]),
    np.array([0.1, -0.2, 0.4]),
)


def _parameters(**georeference):
    settings = {
        "datum_latitude_deg": 50.0,
        "datum_longitude_deg": 14.0,
        "datum_height_m": 200.0,
    } | georeference
    return Parameters.read(
        {
            "calibration": {
                "boresight_pitch_deg": 90.0,
                "boresight_roll_deg": 5.0,
                "lever_laser_m": LEVER_LASER.tolist(),
                "lever_antenna_m": LEVER_ANTENNA.tolist(),
            },
            "georeference": settings,
        }
    )


def _rotation(seconds):
    """Constant body rate: slerp is exact."""
    return Rotation.from_rotvec([0.1, 0.2, 0.3]) * Rotation.from_rotvec(
        np.multiply.outer(seconds, RATE)
    )


def _fix(seconds, **changes):
    lat, lon, h = FRAME.to_geodetic(START + SPEED * seconds)
    return dataclasses.replace(
        Fix(T0 + round(seconds * 1e9), lat, lon, h, np.diag([1e-4, 2e-4, 4e-4])), **changes
    )


def _imu(seconds, **changes):
    sample = ImuSample(
        T0 + round(seconds * 1e9), _rotation(seconds).as_quat(), RATE, np.diag([1e-7, 1e-7, 4e-7])
    )
    return dataclasses.replace(sample, **changes)


def _odometry(seconds, **changes):
    q = _rotation(seconds).as_quat()
    sample = OdometrySample(
        T0 + round(seconds * 1e9), START + SPEED * seconds, q, np.zeros(3), RATE, np.eye(6) * 1e-4
    )
    return dataclasses.replace(sample, **changes)


def _cloud(start, n=40, length=0.1, seed=0):
    rng = np.random.default_rng(seed + round(start * 1000) % 2**31)
    t = T0 + round(start * 1e9) + np.linspace(0, length * 1e9, n, endpoint=False).astype(np.int64)
    r = rng.normal(size=(n, 3))
    r *= rng.uniform(5, 60, (n, 1)) / np.linalg.norm(r, axis=1, keepdims=True)
    return Returns(
        t, r, rng.integers(0, 16, n).astype(np.uint16), rng.uniform(1, 100, n).astype(np.float32)
    )


def _truth(cloud, parameters):
    s = (cloud.t_ns - T0) * 1e-9
    B = Rotation.from_euler("ZYX", [0, math.pi / 2, math.radians(5)])
    a = np.zeros(3) if parameters.georeference.pose_source == "odometry" else LEVER_ANTENNA
    return START + s[:, None] * SPEED + _rotation(s).apply(B.apply(cloud.r_laser) + LEVER_LASER - a)


def _feed(stage, events):
    for event in events:
        {
            Fix: stage.add_fix,
            ImuSample: stage.add_imu,
            OdometrySample: stage.add_odometry,
            Returns: stage.add_returns,
        }[type(event)](event)
    return stage


def _survey(duration=2.0, start=0.0):
    """Fixes at 10 Hz, attitudes at 100 Hz, and clouds inside."""
    fixes = [_fix(start + i * 0.1) for i in range(round(duration * 10) + 1)]
    imus = [_imu(start - 0.003 + i * 0.01) for i in range(round(duration * 100) + 2)]
    clouds = [_cloud(start + 0.15 + i * 0.1) for i in range(round(duration * 10) - 4)]
    return fixes, imus, clouds


def _by_time(*topics):
    flat = [e for topic in topics for e in topic]
    return sorted(flat, key=lambda e: int(e.t_ns[-1]) if isinstance(e, Returns) else e.t_ns)


def _run(parameters, events):
    stage = _feed(Georeferencer(parameters), events)
    stage.finish()
    return stage, stage.take_points(), stage.take_platform()


@pytest.mark.parametrize("interpolation", ["linear", "parabola", "hermite"])
def test_points_and_states_are_the_closed_form(interpolation):
    parameters = _parameters(position_interpolation=interpolation)
    fixes, imus, clouds = _survey()
    stage, points, states = _run(parameters, _by_time(fixes, imus, clouds))
    assert (
        not stage.losses
        and stage.pending == 0
        and stage.datum == DATUM
        and len(points) > len(clouds)
    )  # in parts
    whole = concatenate(points)
    assert len(whole) == sum(len(c) for c in clouds)
    for number, cloud in enumerate(clouds):
        got = select(whole, slice(len(cloud) * number, len(cloud) * (number + 1)))
        np.testing.assert_array_equal(got.t_ns, cloud.t_ns)
        np.testing.assert_array_equal(got.ring, cloud.ring)
        # the platform leaves the datum by 22 m: its vertical turns by 3.5e-6 rad, 0.2 mm at 60 m
        np.testing.assert_allclose(got.r_map, _truth(cloud, parameters), atol=3e-4)
    s = (states.t_ns - T0) * 1e-9
    assert (np.diff(states.t_ns) > 0).all() and (states.segment == 0).all()
    np.testing.assert_allclose(
        states.p_map_body, START + s[:, None] * SPEED - _rotation(s).apply(LEVER_ANTENNA), atol=5e-6
    )
    v_map = SPEED - _rotation(s).apply(np.cross(RATE, LEVER_ANTENNA))
    np.testing.assert_allclose(_rotation(s).apply(states.v_body), v_map, atol=5e-5)
    np.testing.assert_allclose(
        states.C_nav[:, :3, :3],
        np.tile(np.diag([1e-4, 2e-4, 4e-4]), (len(states), 1, 1)),
        atol=1e-8,
    )
    R = _rotation(s).as_matrix()
    C_axes = np.tile(np.diag([1e-7, 1e-7, 4e-7]), (len(s), 1, 1))
    np.testing.assert_allclose(
        R @ states.C_nav[:, 3:, 3:] @ np.swapaxes(R, 1, 2), C_axes, atol=1e-20
    )


@pytest.mark.parametrize("order", ["time", "attitudes_first", "attitudes_last"])
def test_missing_rates_come_from_the_attitudes(order):
    fixes, imus, clouds = _survey()
    imus = [m for m in imus if not T0 + 300_000_000 < m.t_ns < T0 + 500_000_000]
    imus = [dataclasses.replace(m, omega_body=np.full(3, np.nan)) for m in imus]
    events = {
        "time": _by_time(fixes, imus, clouds),
        "attitudes_first": imus + clouds + fixes,
        "attitudes_last": fixes + clouds + imus,
    }[order]
    stage, points, states = _run(_parameters(), events)
    assert set(stage.losses.as_dict()) == {"point_pose_gap"}
    np.testing.assert_allclose(states.omega_body, np.tile(RATE, (len(states), 1)), atol=1e-7)
    reference = _run(_parameters(), _by_time(fixes, imus, clouds))
    _assert_same([concatenate(points)], [concatenate(reference[1])])
    _assert_same([states], [reference[2]])


def test_an_attitude_alone_has_no_rate():
    t = np.array([0, 10, 20, 1000, 2000]) * 10**6
    q = Rotation.from_rotvec(np.multiply.outer(t * 1e-9, RATE)).as_quat()
    rates = trajectory.rates_from_attitudes(t, q, 100 * 10**6)
    np.testing.assert_allclose(rates[:3], np.tile(RATE, (3, 1)), rtol=1e-9)
    assert (
        np.isnan(rates[3:]).all()
        and np.isnan(trajectory.rates_from_attitudes(t[:1], q[:1], 1)).all()
    )
    assert not trajectory.rates_from_attitudes(t[:2], q[[0, 0]], 10**9).any()


def test_attitude_is_turned_from_the_local_vertical_into_the_map():
    """A level sensor 5 km from the datum is not level in the map."""
    place = FRAME.to_geodetic([0.0, 5000.0, 0.0])
    stage = Georeferencer(_parameters())
    for i in range(4):
        stage.add_fix(Fix(T0 + i * 10**8, *place, np.eye(3) * 1e-4))
    for i in range(30):
        stage.add_imu(
            ImuSample(T0 + i * 10**7, np.array([0.0, 0, 0, 1]), np.zeros(3), np.eye(3) * 1e-7)
        )
    states = stage.take_platform()
    up = Rotation.from_quat(states.q_map_body[5]).apply([0, 0, 1.0])
    np.testing.assert_allclose(up, FRAME.convergence(place[0], place[1])[:, 2], atol=1e-12)
    assert math.isclose(up[1], 5000 / 6.38e6, rel_tol=0.01)


def _assert_same(a, b):
    for x, y in zip(a, b, strict=True):
        for f in dataclasses.fields(x):
            np.testing.assert_array_equal(getattr(x, f.name), getattr(y, f.name))


@pytest.mark.parametrize("interpolation", ["linear", "parabola", "hermite"])
def test_result_does_not_depend_on_interleaving(interpolation):
    parameters = _parameters(position_interpolation=interpolation)
    fixes, imus, clouds = _survey()
    fixes = [
        f for f in fixes if not T0 + 700_000_000 < f.t_ns < T0 + 1_500_000_000
    ]  # a gap of 0.8 s
    imus = [m for m in imus if not T0 + 300_000_000 < m.t_ns < T0 + 500_000_000]
    reference = _run(parameters, _by_time(fixes, imus, clouds))
    assert reference[0].losses["point_pose_gap"] > 0
    orders = [fixes + imus + clouds, clouds + fixes + imus, imus + clouds + fixes]
    rng = np.random.default_rng(3)
    for _ in range(3):
        queues, mixed = [list(fixes), list(imus), list(clouds)], []
        while any(queues):
            queue = queues[rng.integers(3)]
            if queue:
                mixed.append(queue.pop(0))
        orders.append(mixed)
    for order in orders:
        stage, points, states = _run(parameters, order)
        _assert_same([concatenate(points)], [concatenate(reference[1])])
        _assert_same([states], [reference[2]])
        assert stage.losses.as_dict() == reference[0].losses.as_dict()


def test_taking_often_equals_taking_once():
    fixes, imus, clouds = _survey()
    events = _by_time(fixes, imus, clouds)
    _, points, states = _run(_parameters(), events)
    stage, taken, platform = Georeferencer(_parameters()), [], []
    for event in events:
        _feed(stage, [event])
        taken += stage.take_points()
        new = stage.take_platform()
        platform += [new] if new is not None else []
    _assert_same(taken, points)
    _assert_same([concatenate(platform)], [states])


def test_every_mapped_point_has_its_platform_states():
    """The filter interpolates between published states: what is mapped must lie between two of one
    segment.
    """
    fixes, imus, clouds = _survey()
    fixes = [f for f in fixes if not T0 + 700_000_000 < f.t_ns < T0 + 1_500_000_000]
    parameters = _parameters()
    _, points, states = _run(parameters, _by_time(fixes, imus, clouds))
    everything = concatenate(points)
    geometry = point_jacobian.point_geometry(everything, states, parameters.calibration)
    assert geometry.covered.all()
    distance = np.linalg.norm(geometry.v_body, axis=1)
    by_time = {
        int(t): np.linalg.norm(r) for c in clouds for t, r in zip(c.t_ns, c.r_laser, strict=True)
    }
    np.testing.assert_allclose(distance, [by_time[int(t)] for t in everything.t_ns], atol=1e-4)
    # and the kernel's C_ind is the one of the numpy Jacobian
    C = packed_covariance.pack(
        point_jacobian.independent_covariance(geometry, independent_sigmas(parameters.budget))
    )
    scale = np.abs(C).max(axis=1, keepdims=True)
    assert np.abs((everything.C_ind - C) / scale).max() < 1e-4
    assert set(np.unique(states.segment)) == {0, 1}


def test_gap_in_positions_loses_only_what_lies_in_it():
    fixes, imus, clouds = _survey()
    hole = (T0 + 700_000_000, T0 + 1_500_000_000)
    fixes = [f for f in fixes if not hole[0] < f.t_ns < hole[1]]
    stage, points, _ = _run(_parameters(), _by_time(fixes, imus, clouds))
    got = np.concatenate([p.t_ns for p in points])
    want = np.concatenate([c.t_ns for c in clouds])
    lost = np.setdiff1d(want, got)
    # one attitude interval on either side goes with the gap
    assert lost.min() > hole[0] - 10_000_000 and lost.max() < hole[1] + 10_000_000
    inside = want[(want > hole[0]) & (want < hole[1])]
    assert np.isin(inside, lost).all() and stage.losses.as_dict() == {"point_pose_gap": len(lost)}


def test_gap_in_attitudes_and_a_wider_limit_bridges_it():
    fixes, imus, clouds = _survey()
    imus = [m for m in imus if not T0 + 300_000_000 < m.t_ns < T0 + 600_000_000]
    stage, _, states = _run(_parameters(), _by_time(fixes, imus, clouds))
    assert stage.losses["point_pose_gap"] > 0 and set(states.segment) == {0, 1}
    stage, points, states = _run(_parameters(max_attitude_gap_s=0.5), _by_time(fixes, imus, clouds))
    assert not stage.losses and set(states.segment) == {0}
    np.testing.assert_allclose(
        concatenate(points).r_map,
        np.concatenate([_truth(c, _parameters()) for c in clouds]),
        atol=3e-4,
    )


def test_no_extrapolation_at_either_end():
    fixes, imus, _ = _survey()
    stage, points, _ = _run(_parameters(), [*fixes, *imus, _cloud(-0.05), _cloud(1.95)])
    first, last = points
    assert (first.t_ns > T0).all() and stage.losses["point_before_trajectory"] + len(first) == 40
    assert (
        (last.t_ns < T0 + 2 * 10**9).all()
        and 0 < len(last)
        and stage.losses["point_trajectory_end"] + len(last) == 40
    )


@pytest.mark.parametrize(
    "interpolation,fixes_later", [("linear", 1), ("parabola", 1), ("hermite", 2)]
)
def test_a_return_waits_for_the_fixes_its_position_is_made_of_and_no_longer(
    interpolation, fixes_later
):
    fixes, imus, _ = _survey()
    stage, cloud = Georeferencer(_parameters(position_interpolation=interpolation)), _cloud(0.45)
    _feed(stage, [*fixes[:5], *imus, cloud])
    got = []
    for after, fix in enumerate(fixes[5:8], start=1):
        _feed(stage, [fix])
        got += stage.take_points()
        first, last = (
            T0 + round(1e8 * (4 + after + k - fixes_later)) for k in (0, 1)
        )  # of the interval that is known now, and its end
        sent = cloud.t_ns[
            (cloud.t_ns >= first) & (cloud.t_ns < last - 10_000_000)
        ]  # but for the attitude before the end
        new = concatenate(got).t_ns if got else np.zeros(0, np.int64)
        assert np.isin(sent, new).all() and (new <= last).all()
    assert len(got) == 2 and stage.pending == 0


def test_small_parts_wait_for_the_rest():
    """Poses a hundred times a second would cut every cloud to pieces."""
    imus = [_imu(i * 0.01) for i in range(40)]
    stage, sizes = Georeferencer(_parameters(pose_source="odometry")), []
    _feed(stage, [_odometry(0.0), _cloud(0.005, n=400)])
    for i in range(1, 20):
        _feed(stage, [_odometry(i * 0.01)])
        sizes += [len(p) for p in stage.take_points()]
    assert (
        sum(sizes) == 400 and stage.pending == 0 and len(imus) > len(sizes) and 1 < len(sizes) < 8
    )


@pytest.mark.parametrize("hours", [-1, 1])
def test_clocks_an_hour_apart_lose_every_return_and_say_so(hours):
    fixes, imus, _ = _survey(20.0)
    clouds = [_cloud(hours * 3600 + i * 0.1, n=10) for i in range(200)]
    events = [e for i in range(200) for e in (fixes[i], *imus[10 * i : 10 * i + 10], clouds[i])]
    stage = Georeferencer(_parameters(max_pending_s=2.0))
    most = 0
    for event in events:
        _feed(stage, [event])
        most = max(most, stage.pending)
    stage.finish()
    assert stage.take_points() == [] and stage.losses.total("point_") == 2000 and most <= 10 * 22
    assert stage.losses["point_before_trajectory" if hours < 0 else "point_pose_timeout"] >= 1700


def test_one_cloud_with_a_corrupt_stamp_harms_no_other():
    fixes, imus, clouds = _survey()
    events = _by_time(fixes, imus, clouds)
    reference = _run(_parameters(), events)[1]
    for hours, reason in ((-1, "point_before_trajectory"), (1, "point_trajectory_end")):
        stage, points, _ = _run(
            _parameters(), [*events[:100], _cloud(hours * 3600.0), *events[100:]]
        )
        assert stage.losses.as_dict() == {reason: 40}
        _assert_same(points, reference)


def test_bad_fixes_are_refused_by_name_and_the_rest_is_kept():
    fixes, imus, clouds = _survey()
    bad = [
        ({"status": -1}, "fix_no_fix"),
        ({"latitude_deg": math.nan}, "fix_nan"),
        ({"height_m": math.inf}, "fix_nan"),
        ({"latitude_deg": 95.0}, "fix_out_of_range"),
        ({"C_enu": None}, "fix_unknown_covariance"),
        ({"C_enu": np.zeros((3, 3))}, "fix_unknown_covariance"),
        ({"C_enu": np.full((3, 3), np.nan)}, "fix_bad_covariance"),
        ({"C_enu": np.diag([1.0, -1.0, 1.0])}, "fix_bad_covariance"),
        ({"t_ns": T0 + 5}, "fix_time_backwards"),
        ({"t_ns": fixes[3].t_ns}, "fix_duplicate"),
    ]
    reference = _run(_parameters(), fixes + imus + clouds)
    for changes, reason in bad:
        spoiled = [*fixes[:4], _fix(0.35, **changes), *fixes[4:]]
        stage, points, _ = _run(_parameters(), spoiled + imus + clouds)
        assert stage.losses.as_dict() == {reason: 1}
        _assert_same(points, reference[1])


def test_bad_attitudes_are_refused_by_name_and_the_rest_is_kept():
    fixes, imus, clouds = _survey()
    q = imus[50].q_map_body
    bad = [
        ({"q_map_body": np.full(4, np.nan)}, "imu_no_orientation"),
        ({"q_map_body": np.array([0, 0, math.nan, 1])}, "imu_nan"),
        ({"q_map_body": q * 1.1}, "imu_not_unit"),
        ({"q_map_body": np.zeros(4)}, "imu_not_unit"),
        ({"omega_body": np.array([0, math.nan, 0])}, "imu_nan"),
        ({"C_axes": None}, "imu_unknown_covariance"),
        ({"C_axes": np.zeros((3, 3))}, "imu_unknown_covariance"),
        ({"C_axes": np.eye(2)}, "imu_bad_covariance"),
        ({"t_ns": imus[5].t_ns}, "imu_time_backwards"),
        ({"t_ns": imus[50].t_ns}, "imu_duplicate"),
    ]
    reference = _run(_parameters(), fixes + imus + clouds)
    for changes, reason in bad:
        spoiled = [
            *imus[:51],
            dataclasses.replace(imus[50], **({"t_ns": imus[50].t_ns + 7} | changes)),
            *imus[51:],
        ]
        stage, points, _ = _run(_parameters(), fixes + spoiled + clouds)
        assert stage.losses.as_dict() == {reason: 1}
        _assert_same(points, reference[1])


def test_one_corrupt_stamp_ahead_does_not_shut_out_what_follows():
    fixes, imus, clouds = _survey()
    reference = _run(_parameters(), fixes + imus + clouds)
    ahead = [*fixes[:4], _fix(0.35, t_ns=T0 + 3600 * 10**9), *fixes[4:]]
    stage, points, _ = _run(_parameters(), ahead + imus + clouds)
    assert stage.losses.as_dict() == {"fix_time_jump": 1}
    _assert_same(points, reference[1])


def test_time_order_accepts_a_confirmed_jump():
    order = TimeOrder("fix")
    second = 10**9
    assert order.push(0, "a") == (["a"], [])
    assert order.push(60 * second, "b") == ([], [])
    assert order.push(61 * second, "c") == (["b", "c"], [])
    assert order.push(200 * second, "d") == ([], [])
    assert order.push(200 * second, "d") == ([], ["fix_duplicate"])
    assert order.push(400 * second, "e") == ([], ["fix_time_jump"])
    assert order.push(62 * second, "f") == (["f"], ["fix_time_jump"])
    assert order.push(500 * second, "g") == ([], []) and order.finish() == ["fix_time_jump"]


def test_time_order_refuses_a_clock_that_was_set_back_until_it_comes_forward():
    order, tenth = TimeOrder("fix"), 10**8
    for k in range(50):
        assert order.push(k * tenth, k) == ([k], [])
    for k in range(20, 60):  # three seconds back, for four seconds
        late = "fix_duplicate" if k == 49 else "fix_time_backwards" if k < 49 else "fix_clock_back"
        assert order.push(k * tenth, k) == ([], [late])
    assert order.push(90 * tenth, 90) == ([90], []) and order.push(91 * tenth, 91) == ([91], [])


def test_time_order_believes_a_clock_that_stays_back_after_ten_seconds():
    order, tenth = TimeOrder("fix"), 10**8
    order.push(50 * tenth, "a")
    seen = [order.push(k * tenth, k) for k in range(20, 130)]
    assert [r[1][0] for r in seen[31:101]] == ["fix_clock_back"] * 70
    assert all(r == ([k], []) for k, r in zip(range(121, 130), seen[101:], strict=True))


def test_time_order_takes_what_follows_late_messages():
    order, tenth = TimeOrder("fix"), 10**8
    order.push(50 * tenth, "a")
    assert [order.push(k * tenth, k)[1] for k in (30, 31, 32)] == [["fix_time_backwards"]] * 3
    assert order.push(51 * tenth, "b") == (["b"], [])
    assert order.push(0, "c")[1] == ["fix_time_backwards"] and order.push(-tenth, "d")[1] == [
        "fix_time_backwards"
    ]
    assert order.push(52 * tenth, "e") == (["e"], [])


def test_unknown_covariances_take_the_budget_only_when_told():
    fixes = [dataclasses.replace(f, C_enu=None) for f in _survey()[0]]
    imus = [dataclasses.replace(m, C_axes=None) for m in _survey()[1]]
    clouds = _survey()[2]
    stage, points, states = _run(_parameters(), fixes + imus + clouds)
    assert points == [] and states is None and stage.datum == DATUM
    assert stage.losses["fix_unknown_covariance"] == len(fixes) and stage.losses[
        "imu_unknown_covariance"
    ] == len(imus)
    parameters = _parameters(unknown_covariance="budget")
    stage, points, states = _run(parameters, fixes + imus + clouds)
    assert not stage.losses and len(points) == len(clouds)
    sigma = np.array(parameters.budget.position_sigma_m)
    np.testing.assert_allclose(
        states.C_nav[:, :3, :3], np.tile(np.diag(sigma**2), (len(states), 1, 1)), atol=1e-9
    )
    assert (np.linalg.eigvalsh(states.C_nav)[:, 0] > 0).all()


def test_gates_are_counted_and_cut_every_column_alike():
    fixes, imus, _ = _survey()
    cloud = _cloud(0.5)
    r, intensity, ring = cloud.r_laser.copy(), cloud.intensity.copy(), cloud.ring.copy()
    r[0], r[1], r[2], r[3] = np.nan, (0, 0, 0), (0.1, 0, 0), (500, 0, 0)
    intensity[4], intensity[5], ring[6] = 200, 0.5, 16
    r[7] = np.array([0.9, 0.0, 0.0])  # pitched by 90 degrees: 0.9 m below the body
    spoiled = Returns(cloud.t_ns, r, ring, intensity)
    parameters = _parameters(
        intensity_min=0.9, intensity_max=150.0, vehicle_box_m=[-2.0, -2.0, -2.0, 2.0, 2.0, 2.0]
    )
    stage, points, _ = _run(parameters, [*fixes, *imus, spoiled])
    assert stage.losses.as_dict() == {
        "point_nan": 1,
        "point_range": 3,
        "point_intensity": 2,
        "point_ring": 1,
        "point_vehicle": 1,
    }
    np.testing.assert_array_equal(points[0].t_ns, cloud.t_ns[8:])
    np.testing.assert_array_equal(points[0].intensity, cloud.intensity[8:])
    np.testing.assert_allclose(points[0].r_map, _truth(cloud, parameters)[8:], atol=3e-4)
    truth = _truth(cloud, parameters)
    stage, points, _ = _run(
        _parameters(region_m=[-1e3, -1e3, 20.0, 1e3, 1e3, 1e3]), [*fixes, *imus, cloud]
    )
    assert stage.losses["point_region"] == np.count_nonzero(truth[:, 2] < 20.0) and len(
        points[0]
    ) == np.count_nonzero(truth[:, 2] >= 20.0)


def test_clouds_that_hold_nothing():
    fixes, imus, clouds = _survey()
    empty = Returns(
        np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0, np.uint16), np.zeros(0, np.float32)
    )
    nothing = dataclasses.replace(clouds[0], r_laser=np.full((40, 3), np.nan))
    short = dataclasses.replace(clouds[0], ring=clouds[0].ring[:5])
    stage, points, _ = _run(_parameters(), [empty, nothing, short, *fixes, *imus, clouds[1]])
    assert len(points) == 1 and stage.losses.as_dict() == {"cloud_malformed": 1, "point_nan": 40}


def test_odometry_is_a_pose_source_of_its_own():
    parameters = _parameters(pose_source="odometry", max_position_gap_s=0.2)
    poses = [_odometry(i * 0.05) for i in range(41)]
    clouds = _survey()[2]
    stage, points, states = _run(parameters, [_fix(0.0), _imu(0.0), *poses, *clouds])
    assert stage.losses.as_dict() == {"fix_unused": 1, "imu_unused": 1}
    for got, cloud in zip(points, clouds, strict=True):
        np.testing.assert_allclose(got.r_map, _truth(cloud, parameters), atol=1e-9)
    s = (states.t_ns - T0) * 1e-9
    np.testing.assert_allclose(states.p_map_body, START + s[:, None] * SPEED, atol=1e-12)
    np.testing.assert_allclose(
        _rotation(s).apply(states.v_body), np.tile(SPEED, (len(s), 1)), atol=1e-9
    )
    np.testing.assert_allclose(states.C_nav, np.tile(np.eye(6) * 1e-4, (len(s), 1, 1)), atol=1e-18)
    bad = [
        _odometry(0.0, C_pose=None),
        _odometry(0.1, q_map_body=np.zeros(4)),
        _odometry(0.1, p_map_body=np.full(3, np.nan)),
    ]
    refused = _run(parameters, bad)
    assert refused[0].losses.as_dict() == {
        "odometry_unknown_covariance": 1,
        "odometry_not_unit": 1,
        "odometry_nan": 1,
    }


def test_odometry_that_does_not_always_tell_its_rates_gives_the_same_states():
    parameters = _parameters(pose_source="odometry", max_position_gap_s=0.2)
    silent = np.full(3, np.nan)
    whole = [_odometry(i * 0.05) for i in range(41)]
    some = [_odometry(i * 0.05, **({"omega_body": silent} if i % 7 < 4 else {})) for i in range(41)]
    one, two = (_run(parameters, poses)[2] for poses in (whole, some))
    assert np.array_equal(one.t_ns, two.t_ns)
    np.testing.assert_allclose(two.omega_body, one.omega_body, atol=1e-9)
    np.testing.assert_allclose(two.v_body, one.v_body, atol=1e-9)


def test_odometry_carries_cross_covariance():
    rng = np.random.default_rng(2)
    L = rng.normal(size=(6, 6)) * 1e-2
    C = L @ L.T
    poses = [_odometry(i * 0.05, C_pose=C) for i in range(5)]
    _, _, states = _run(_parameters(pose_source="odometry"), poses)
    T = np.zeros((6, 6))
    T[:3, :3], T[3:, 3:] = np.eye(3), _rotation(0.05).as_matrix().T
    np.testing.assert_allclose(states.C_nav[1], T @ C @ T.T, atol=1e-16)


def test_clock_offset_moves_returns_to_navigation_time():
    fixes, imus, clouds = _survey()
    reference = _run(_parameters(), fixes + imus + clouds)[1]
    base = _parameters()
    shifted = dataclasses.replace(
        base, calibration=dataclasses.replace(base.calibration, clock_offset_s=1.25)
    )
    early = [dataclasses.replace(c, t_ns=c.t_ns - 1_250_000_000) for c in clouds]
    _assert_same(_run(shifted, fixes + imus + early)[1], reference)


def test_first_usable_fix_is_the_datum_when_none_is_given():
    stage = Georeferencer(Parameters())
    assert stage.datum is None
    stage.add_fix(_fix(0.0, status=-1))
    assert stage.datum is None
    stage.add_fix(_fix(0.1))
    fix = _fix(0.1)
    assert stage.datum == Datum(fix.latitude_deg, fix.longitude_deg, fix.height_m)


def test_settings_that_make_no_sense_are_errors():
    with pytest.raises(ParameterValueError, match="datum"):
        Georeferencer(Parameters.read({"georeference": {"datum_latitude_deg": 50.0}}))
    for box in ([1.0, 2.0], [0.0, 0.0, 0.0, 1.0, -1.0, 1.0]):
        with pytest.raises(ParameterValueError, match="vehicle_box_m"):
            Georeferencer(Parameters.read({"georeference": {"vehicle_box_m": box}}))


def test_missing_topics_lose_everything_and_say_so():
    fixes, imus, clouds = _survey()
    for events in (fixes + clouds, imus + clouds, clouds):
        stage, points, states = _run(_parameters(), events)
        assert (
            points == []
            and states is None
            and stage.losses.as_dict() == {"point_trajectory_end": 40 * len(clouds)}
        )


def test_knots_forget_the_oldest_and_keep_the_rest():
    knots = Knots(100, 10**9, p=(3,))
    forgotten = sum(knots.append(i, -i, p=(i, 0, 0)) for i in range(1234))
    assert len(knots) <= 200 and forgotten + len(knots) == 1234
    np.testing.assert_array_equal(knots.t_ns, np.arange(forgotten, 1234))
    np.testing.assert_array_equal(knots["p"][:, 0], knots.t_ns)
    np.testing.assert_array_equal(knots.tag, -knots.t_ns)


def test_knots_forget_what_is_too_old_and_keep_what_is_not():
    knots, held = Knots(10_000, 50, p=(3,)), []
    forgotten = 0
    for i in range(1000):
        forgotten += knots.append(i, i, p=(i, 0, 0))
        assert forgotten + len(knots) == i + 1 and knots.t_ns[0] <= max(i - 50, 0)
        held.append(len(knots))
    np.testing.assert_array_equal(knots.t_ns, np.arange(forgotten, 1000))
    np.testing.assert_array_equal(knots["p"][:, 0], knots.t_ns)
    assert max(held) == 128  # the power of two of which half is old
    everything = Knots(10_000, 10**9, p=(3,))
    assert (
        sum(everything.append(i, i, p=(i, 0, 0)) for i in range(1000)) == 0
        and len(everything) == 1000
    )


@pytest.mark.parametrize(("name", "value"), [("KNOT_LIMIT", 60), ("KNOTS_KEPT_S", 0.0)])
def test_memory_limit_changes_nothing_for_clouds_in_time(monkeypatch, name, value):
    fixes, imus, clouds = _survey(4.0)
    events = _by_time(fixes, imus, clouds)
    parameters = _parameters(max_pending_s=0.5)
    _, points, states = _run(parameters, events)
    monkeypatch.setattr(f"ladar_volume.georeference.trajectory.{name}", value)
    stage, few, few_states = _run(parameters, events)
    assert len(stage.trajectory.attitude) < len(imus)
    _assert_same(few, points)
    _assert_same([few_states], [states])


def test_records_are_the_contract():
    fixes, imus, clouds = _survey()
    _, points, states = _run(_parameters(), fixes + imus + clouds)
    assert isinstance(points[0], MappedPoints) and isinstance(states, PlatformStates)
    assert (
        points[0].C_ind.dtype == np.float32
        and points[0].r_map.dtype == np.float64
        and points[0].t_ns.dtype == np.int64
    )
    assert points[0].ring.dtype == np.uint16 and points[0].intensity.dtype == np.float32
    assert (
        states.t_ns.dtype == np.int64
        and states.segment.dtype == np.int64
        and states.C_nav.shape == (len(states), 6, 6)
    )


def test_total_covariance_adds_the_shared_errors_to_the_independent_ones():
    fixes, imus, clouds = _survey()
    parameters = _parameters()
    _, points, states = _run(parameters, fixes + imus + clouds)
    cloud = points[3]
    total = packed_covariance.unpack(point_jacobian.total_covariance(cloud, states, parameters))
    shared = total - packed_covariance.unpack(cloud.C_ind)
    assert (np.linalg.eigvalsh(shared)[:, 0] > 0).all()
    # the position error enters every point in full
    assert (shared[:, 0, 0] > 1e-4).all() and (shared[:, 2, 2] > 4e-4).all()
    far = dataclasses.replace(cloud, t_ns=cloud.t_ns + 3600 * 10**9)
    assert np.isnan(point_jacobian.total_covariance(far, states, parameters)).all()
