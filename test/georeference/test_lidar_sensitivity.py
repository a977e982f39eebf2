"""The LiDAR equation and its Jacobians against an independent complex-step twin, and C_point's
values against Monte Carlo.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ladar_volume.georeference import error_budget as bud
from ladar_volume.georeference import lidar_equation, point_jacobian
from ladar_volume.math import packed_covariance
from ladar_volume.math.se3 import rotation_xyz, skew
from ladar_volume.model.parameters import BudgetParameters, CalibrationParameters
from ladar_volume.model.records import CAL_COLUMNS, MappedPoints, PlatformStates, select

BEAMS = 4
CALIBRATION = CalibrationParameters(
    boresight_roll_rad=0.3,
    boresight_pitch_rad=1.4,
    boresight_yaw_rad=-0.7,
    boresight_correction_rad=(0.01, -0.02, 0.03),
    lever_laser_m=(0.11, -0.22, 0.33),
    lever_antenna_m=(-0.4, 0.15, 0.9),
    clock_offset_s=0.003,
)


def _exp(rotvec):
    """Series of the matrix exponential; complex numbers pass through."""
    k = np.zeros((3, 3), dtype=complex)
    x, y, z = rotvec
    k[0, 1], k[0, 2], k[1, 0], k[1, 2], k[2, 0], k[2, 1] = -z, y, z, -x, -y, x
    term, total = np.eye(3, dtype=complex), np.eye(3, dtype=complex)
    for i in range(1, 30):
        term = term @ k / i
        total = total + term
    return total


def plain_lidar_equation(pose, r_az_w, errors):
    """Independent of the package: every error enters where it physically acts. errors: dict name ->
    number or vector.
    """
    e = {
        "p": np.zeros(3),
        "att": np.zeros(3),
        "bore": np.zeros(3),
        "b": np.zeros(3),
        "a": np.zeros(3),
        "meas": np.zeros(3),
        "bias": 0.0,
        "rho_k": 0.0,
        "eps_k": 0.0,
        "dt": 0.0,
    } | errors
    rho = r_az_w[0] + e["meas"][0] + e["bias"] + e["rho_k"]
    az = r_az_w[1] + e["meas"][1]
    w = r_az_w[2] + e["meas"][2] + e["eps_k"]
    r = np.array([rho * np.cos(w) * np.cos(az), rho * np.cos(w) * np.sin(az), rho * np.sin(w)])
    nominal = Rotation.from_euler("ZYX", [-0.7, 1.4, 0.3]).as_matrix()
    B = _exp(e["bore"]) @ _exp(np.array([0.01, -0.02, 0.03])) @ nominal
    a, b = np.array([-0.4, 0.15, 0.9]) + e["a"], np.array([0.11, -0.22, 0.33]) + e["b"]
    R = pose["R"] @ _exp(pose["omega"] * e["dt"]) @ _exp(e["att"])
    return pose["p"] + pose["v"] * e["dt"] + e["p"] - R @ a + R @ (B @ r + b)


def _case(seed):
    rng = np.random.default_rng(seed)
    q = rng.normal(size=4)
    pose = {
        "R": Rotation.from_quat(q / np.linalg.norm(q)).as_matrix(),
        "q": q / np.linalg.norm(q),
        "p": rng.normal(size=3) * 50,
        "v": rng.normal(size=3) * 5,
        "omega": rng.normal(size=3),
    }
    return pose, np.array([rng.uniform(1, 100), rng.uniform(-3, 3), rng.uniform(-1.3, 1.3)])


def _geometry(pose, measured):
    """Through the public door: a mapped point and two platform states around it, a frozen platform
    apart from its rates.
    """
    r_map = plain_lidar_equation(pose, measured, {}).real
    a = np.array(CALIBRATION.lever_antenna_m)
    states = PlatformStates(
        t_ns=np.array([0, 100]),
        p_map_body=np.tile(pose["p"] - pose["R"] @ a, (2, 1)),
        q_map_body=np.tile(pose["q"], (2, 1)),
        v_body=np.tile(pose["R"].T @ pose["v"] - np.cross(pose["omega"], a), (2, 1)),
        omega_body=np.tile(pose["omega"], (2, 1)),
        C_nav=np.zeros((2, 6, 6)),
        segment=np.zeros(2, np.int64),
    )
    points = MappedPoints(
        np.array([50]),
        r_map[None],
        np.zeros((1, 6), np.float32),
        np.array([2], np.uint16),
        np.zeros(1, np.float32),
    )
    return point_jacobian.point_geometry(points, states, CALIBRATION), points


def _complex_step(pose, measured, name, size):
    h, columns = 1e-30, []
    for i in range(max(size, 1)):
        step = 1j * h if size == 0 else 1j * h * np.eye(size)[i]
        columns.append(plain_lidar_equation(pose, measured, {name: step}).imag / h)
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("seed", range(6))
def test_jacobians_equal_complex_steps(seed):
    pose, measured = _case(seed)
    geometry, points = _geometry(pose, measured)
    nav = np.hstack(
        [_complex_step(pose, measured, "p", 3), _complex_step(pose, measured, "att", 3)]
    )
    cal = np.hstack(
        [
            _complex_step(pose, measured, n, s)
            for n, s in (("bias", 0), ("bore", 3), ("b", 3), ("a", 3), ("dt", 0))
        ]
    )
    beam = np.hstack([_complex_step(pose, measured, n, 0) for n in ("rho_k", "eps_k")])
    measurement = _complex_step(pose, measured, "meas", 3)
    for analytic, numeric in (
        (point_jacobian.navigation_jacobian(geometry)[0], nav),
        (point_jacobian.calibration_jacobian(geometry)[0], cal),
        (point_jacobian.beam_jacobian(geometry)[0], beam),
        (point_jacobian.measurement_jacobian(geometry)[0], measurement),
    ):
        for column in range(numeric.shape[1]):
            scale = np.linalg.norm(numeric[:, column])
            assert np.abs(analytic[:, column] - numeric[:, column]).max() <= 1e-8 * scale
    full = point_jacobian.full_calibration_jacobian(geometry, points.ring, BEAMS)[0]
    assert full.shape == (3, len(bud.calibration_columns(BEAMS)))
    shared = len(CAL_COLUMNS)
    np.testing.assert_array_equal(
        full[:, [shared + 2, shared + BEAMS + 2]], point_jacobian.beam_jacobian(geometry)[0]
    )
    assert not np.delete(full, [*range(shared), shared + 2, shared + BEAMS + 2], axis=1).any()


def test_package_equation_is_complex_capable_and_equals_the_plain_one():
    pose, measured = _case(11)
    mount = lidar_equation.mounting(CALIBRATION)
    got = lidar_equation.map_point(
        pose["p"], pose["R"], lidar_equation.laser_vector(*measured), mount
    )
    np.testing.assert_allclose(
        got, plain_lidar_equation(pose, measured, {}).real, rtol=0, atol=1e-11
    )
    step = (
        lidar_equation.map_point(
            pose["p"],
            pose["R"],
            lidar_equation.laser_vector(measured[0] + 1e-30j, *measured[1:]),
            mount,
        ).imag
        / 1e-30
    )
    np.testing.assert_allclose(step, _complex_step(pose, measured, "bias", 0)[:, 0], rtol=1e-12)


def test_point_covariance_values_equal_monte_carlo():
    pose, measured = _case(3)
    measured[0] = 40.0
    geometry, points = _geometry(pose, measured)
    rng = np.random.default_rng(20)
    L = rng.normal(size=(6, 6)) * np.array([0.02, 0.02, 0.03, 4e-4, 4e-4, 9e-4])[:, None]
    C_nav = L @ L.T
    budget = BudgetParameters(
        boresight_sigma_rad=(4e-4, 3e-4, 7e-4),
        lever_laser_sigma_m=(0.01, 0.02, 0.03),
        lever_antenna_sigma_m=(0.03, 0.01, 0.02),
        clock_sigma_s=0.002,
        beam_vertical_sigma_rad=3e-4,
    )
    C_cal, sigmas = bud.calibration_covariance(budget, BEAMS), bud.independent_sigmas(budget)
    C_ind = point_jacobian.independent_covariance(geometry, sigmas)
    C = point_jacobian.point_covariance(geometry, points.ring, C_ind, C_nav[None], C_cal)[0]
    n = 400_000
    nav = rng.normal(size=(n, 6)) @ L.T
    s = np.sqrt(np.diag(C_cal))
    cal = rng.normal(size=(n, 11)) * s[:11]
    meas = measured + rng.normal(size=(n, 3)) * sigmas
    meas[:, 0] += cal[:, 0] + rng.normal(size=n) * budget.beam_range_sigma_m
    meas[:, 2] += rng.normal(size=n) * budget.beam_vertical_sigma_rad
    rho, az, w = meas.T
    r = np.stack(
        [rho * np.cos(w) * np.cos(az), rho * np.cos(w) * np.sin(az), rho * np.sin(w)], axis=-1
    )
    r = Rotation.from_euler("ZYX", [-0.7, 1.4, 0.3]).apply(r)
    r = Rotation.from_rotvec(cal[:, 1:4]).apply(Rotation.from_rotvec([0.01, -0.02, 0.03]).apply(r))
    body = (
        r
        + np.array(CALIBRATION.lever_laser_m)
        + cal[:, 4:7]
        - np.array(CALIBRATION.lever_antenna_m)
        - cal[:, 7:10]
    )
    body = Rotation.from_rotvec(cal[:, 10:] * pose["omega"]).apply(
        Rotation.from_rotvec(nav[:, 3:]).apply(body)
    )
    drawn = pose["p"] + cal[:, 10:] * pose["v"] + nav[:, :3] + body @ pose["R"].T
    empirical = np.cov(drawn.T)
    # a variance from n draws has a relative sd of sqrt(2 / n) = 0.22 %; four of these, and
    # second-order terms below 0.1 %
    scale = np.sqrt(np.outer(np.diag(C), np.diag(C)))
    assert np.abs((empirical - C) / scale).max() < 0.01


def _reference_sigmas(preset, distance, beam):
    """Seed 004 section 5 in the geometry that reproduces it: level platform, lever arms zero, range
    along ``beam``.
    """
    budget = bud.PRESETS[preset]
    beam = np.asarray(beam) * distance
    mount = lidar_equation.mounting(CalibrationParameters())
    one = np.zeros((1, 3))
    geometry = point_jacobian.PointGeometry(
        np.ones(1, bool),
        np.eye(3)[None],
        beam[None],
        one,
        one,
        np.zeros(1, np.int64),
        np.zeros(1),
        mount,
    )
    C_nav = bud.navigation_covariance(budget, np.array([0.0, 0, 0, 1]))[None]
    C_ind = point_jacobian.independent_covariance(geometry, bud.independent_sigmas(budget))
    C = point_jacobian.point_covariance(
        geometry, np.zeros(1, np.uint16), C_ind, C_nav, bud.calibration_covariance(budget, 1)
    )[0]
    return np.sqrt(np.diag(C))


ALONG = (math.sin(math.radians(30)), 0.0, -math.cos(math.radians(30)))
ACROSS = (0.0, math.sin(math.radians(30)), -math.cos(math.radians(30)))


def test_reference_case_of_the_published_survey():
    printed = {150.0: (0.193627, 0.498572, 0.113703), 200.0: (0.257801, 0.664298, 0.150233)}
    for distance, sigmas in printed.items():
        assert np.abs(_reference_sigmas("survey", distance, ALONG) - sigmas).max() < 0.0013


def test_reference_case_tilted_across_as_a_scanner_would_be():
    np.testing.assert_allclose(
        _reference_sigmas("survey", 150.0, ACROSS), (0.399, 0.355, 0.206), atol=0.0005
    )


def test_the_published_table_of_typical_errors():
    """May & Toth (2007) as printed: 5 to 15 cm, up 7.5 to 22.5; 10 to 30 seconds of arc, heading 20
    to 60; misalignment 10, 10 and 30; range 1 cm; scan angle 2.52 seconds of arc.
    """
    for preset, cm, arc in (("table1_low", 5.0, 10.0), ("table1_high", 15.0, 30.0)):
        b = bud.PRESETS[preset]
        assert 100.0 * np.array(b.position_sigma_m) == pytest.approx([cm, cm, 1.5 * cm])
        seconds = 3600.0 * np.degrees([b.attitude_sigma_rad, b.boresight_sigma_rad])
        assert seconds == pytest.approx(np.array([[arc, arc, 2.0 * arc], [10.0, 10.0, 30.0]]))
        angles = [b.azimuth_noise_rad, b.vertical_noise_rad]
        assert 3600.0 * np.degrees(angles) == pytest.approx(2.52) and b.range_noise_m == 0.01
        rest = (*b.lever_laser_sigma_m, *b.lever_antenna_sigma_m, b.clock_sigma_s)
        assert not any(rest)


def test_the_thesis_budget():
    b = bud.PRESETS["thesis"]
    assert np.degrees(b.attitude_sigma_rad) == pytest.approx([0.25, 0.25, 0.8])
    assert b.position_sigma_m == (0.01, 0.01, 0.01) and b.range_noise_m == 0.03
    assert not any((*b.boresight_sigma_rad, b.azimuth_noise_rad, b.vertical_noise_rad))


def test_corrected_position_sigma_is_a_quadrature():
    corrected, printed = (
        bud.PRESETS["survey_corrected"].position_sigma_m,
        bud.PRESETS["survey"].position_sigma_m,
    )
    assert math.isclose(math.sqrt(sum(s * s for s in corrected)), 0.05, rel_tol=1e-12)
    assert abs(corrected[0] - 0.02425) < 5e-6
    # what that changes in the reference case: exactly the difference of the position variances
    change = (
        _reference_sigmas("survey_corrected", 150.0, ALONG) ** 2
        - _reference_sigmas("survey", 150.0, ALONG) ** 2
    )
    np.testing.assert_allclose(change, np.array(corrected) ** 2 - np.array(printed) ** 2, rtol=1e-9)


def test_angles_invert_and_the_axis_is_finite():
    rng = np.random.default_rng(5)
    r = rng.normal(size=(100, 3)) * 20
    x, y, z = r.T
    measured = np.linalg.norm(r, axis=1), np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))
    np.testing.assert_allclose(lidar_equation.laser_vector(*measured), r, atol=1e-12)
    J = lidar_equation.angle_derivatives(np.array([[0.0, 0.0, 5.0]]))[0]
    np.testing.assert_array_equal(J, [[0, 0, -5], [0, 0, 0], [1, 0, 0]])


def test_fixed_axes_and_euler_maps_agree_with_small_rotations():
    roll, pitch, yaw = 0.4, -0.6, 2.0
    R = rotation_xyz(roll, pitch, yaw)
    q = Rotation.from_matrix(R).as_quat()
    np.testing.assert_allclose(bud.roll_pitch_heading(q), (roll, pitch, yaw), atol=1e-12)
    sigma = np.array([1e-3, 2e-3, 5e-3])
    h, columns = 1e-7, []
    for i in range(3):
        e = np.array([roll, pitch, yaw])
        e[i] += h
        columns.append(Rotation.from_matrix(R.T @ rotation_xyz(*e)).as_rotvec() / h)
    E = np.stack(columns, axis=-1)
    np.testing.assert_allclose(
        bud.attitude_covariance_from_euler(q, sigma), E @ np.diag(sigma**2) @ E.T, atol=1e-11
    )
    C_axes = np.diag([1e-6, 4e-6, 9e-6])
    C_body = bud.attitude_covariance_from_axes(q, C_axes)
    d_map = np.array([1e-8, 2e-8, -3e-8])
    d_body = R.T @ d_map
    np.testing.assert_allclose(
        (np.eye(3) + skew(d_map)) @ R, R @ (np.eye(3) + skew(d_body)), atol=1e-15
    )
    np.testing.assert_allclose(R @ C_body @ R.T, C_axes, atol=1e-18)
    C6 = np.arange(36.0).reshape(6, 6)
    C6 = C6 @ C6.T
    mapped = bud.pose_covariance_from_axes(q, C6)
    np.testing.assert_allclose(mapped[:3, 3:], C6[:3, 3:] @ R, rtol=1e-12)


def test_odometry_has_no_antenna_lever():
    assert not lidar_equation.mounting(CALIBRATION, "odometry").lever_antenna.any()
    C = bud.calibration_covariance(BudgetParameters(), 2, "odometry")
    names = bud.calibration_columns(2)
    assert C.shape == (15, 15)
    assert all((C[i, i] == 0) == name.startswith("lever_antenna") for i, name in enumerate(names))


def test_uncovered_points_are_nan_and_never_extrapolated():
    n = 4
    states = PlatformStates(
        np.array([0, 100, 200, 300]),
        np.zeros((n, 3)),
        np.tile([0.0, 0, 0, 1], (n, 1)),
        np.zeros((n, 3)),
        np.zeros((n, 3)),
        np.zeros((n, 6, 6)),
        np.array([0, 0, 1, 1]),
    )
    t = np.array([-1, 0, 50, 100, 150, 200, 300, 301])
    many = MappedPoints(
        t,
        np.ones((8, 3)),
        np.zeros((8, 6), np.float32),
        np.zeros(8, np.uint16),
        np.zeros(8, np.float32),
    )
    g = point_jacobian.point_geometry(many, states, CALIBRATION)
    np.testing.assert_array_equal(g.covered, [False, True, True, True, False, True, True, False])
    assert np.isnan(g.v_body[~g.covered]).all() and np.isfinite(g.v_body[g.covered]).all()
    empty = select(states, slice(0, 0))
    assert not point_jacobian.point_geometry(many, empty, CALIBRATION).covered.any()
    assert np.array_equal(
        packed_covariance.unpack(packed_covariance.pack(np.eye(3)[None]))[0], np.eye(3)
    )
