"""Errors of calibration and navigation along a trajectory, against sums written out over all pairs
of points and derivatives of the LiDAR equation by differences.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ladar_volume.clouds.survey.flight_errors import FlightErrors, is_covered, vertex_slopes
from ladar_volume.georeference.lidar_equation import mounting
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import PlatformStates
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.uncertainty.navigation_sum import NavigationBins

BEAMS, BIN_S = 4, 2.0
P = Parameters.read(
    {
        "calibration": {
            "boresight_pitch_deg": 90.0,
            "boresight_roll_deg": 4.0,
            "lever_laser_m": [0.1, -0.05, -0.2],
            "lever_antenna_m": [0.3, 0.1, 0.4],
        },
        "georeference": {"beams": BEAMS},
        "budget": {"position_white_fraction": 0.0, "attitude_white_fraction": 0.0},
    }
)


def flown(seed=5, n=60):
    """A flight, one point in the middle of each time bin, and what the twin needs of it."""
    random = np.random.default_rng(seed)
    t = np.sort(random.choice(200, n, replace=False)) * BIN_S + 0.5 * BIN_S
    knots = np.arange(0.0, 404.0, 0.5)
    p = np.column_stack([3.0 * knots, 5.0 * np.sin(0.05 * knots), 40.0 + 0.0 * knots])
    angles = np.column_stack([0.2 * np.sin(0.3 * knots), 0.1 * np.cos(0.2 * knots), 0.02 * knots])
    R = Rotation.from_euler("xyz", angles)
    v = np.gradient(p, knots, axis=0)
    omega = (R[:-1].inv() * R[1:]).as_rotvec() / 0.5
    C = np.zeros((len(knots), 6, 6))
    C[:] = np.diag(np.r_[np.full(3, 0.02), np.full(3, 1e-3)] ** 2)
    states = PlatformStates(
        np.rint(knots * 1e9).astype(np.int64),
        p,
        R.as_quat(),
        R.inv().apply(v),
        np.vstack([omega, omega[-1:]]),
        C,
        np.zeros(len(knots), np.int64),
    )
    at = np.rint(t / 0.5).astype(int)
    r = p[at] + np.column_stack([random.normal(0, 15, (n, 2)), random.normal(-38, 2, n)])
    ring = random.integers(0, BEAMS, n).astype(np.uint16)
    navigation = NavigationBins(BIN_S)
    navigation.add(states)
    t_ns = np.rint(t * 1e9).astype(np.int64)
    errors = FlightErrors(states, P, mounting(P.calibration), t_ns, ring, navigation)
    return errors, r, t, p[at], R[at], v[at], states.omega_body[at]


def moved(r, p, R, mount, error, ring, velocity, omega):
    """Points (n, 3) that the same readings give under errors of calibration and pose."""
    B = Rotation.from_matrix(mount.R_body_laser)
    laser = B.inv().apply(R.inv().apply(r - p) - mount.lever_laser)
    rho, az = np.linalg.norm(laser, axis=1), np.arctan2(laser[:, 1], laser[:, 0])
    w = np.arcsin(laser[:, 2] / rho) + error.get("beam_vertical", np.zeros(BEAMS))[ring]
    rho = rho + error.get("range_bias", 0.0) + error.get("beam_range", np.zeros(BEAMS))[ring]
    seen = rho[:, None] * np.column_stack(
        [np.cos(w) * np.cos(az), np.cos(w) * np.sin(az), np.sin(w)]
    )
    zero = np.zeros(3)
    dt = error.get("clock", 0.0)
    turn = Rotation.from_rotvec(error.get("attitude", zero) + dt * omega)
    body = Rotation.from_rotvec(error.get("boresight", zero)).apply(B.apply(seen))
    antenna = p + R.apply(mount.lever_antenna)
    velocity = velocity + R.apply(np.cross(omega, mount.lever_antenna))
    antenna = antenna + error.get("position", zero) + dt * velocity
    arm = mount.lever_laser + error.get("lever_laser", zero)
    arm = arm - mount.lever_antenna - error.get("lever_antenna", zero)
    return antenna + (R * turn).apply(body + arm)


def test_lines_against_sums_over_all_pairs():
    errors, r, t, p, R, v, omega = flown()
    random = np.random.default_rng(6)
    gradient = random.normal(1.0, 0.5, (len(r), 2))
    slope = random.normal(0.0, 0.3, (len(r), 2))
    normal = np.column_stack([-slope, np.ones(len(r))])

    def height(h=1e-5, **error):
        """Derivative (n,) of the heights at a fixed place by one error."""
        args = (errors.mount, errors.ring, v, omega)
        high = moved(r, p, R, args[0], {k: h * e for k, e in error.items()}, *args[1:])
        low = moved(r, p, R, args[0], {k: -h * e for k, e in error.items()}, *args[1:])
        return np.einsum("ni,ni->n", normal, high - low) / (2 * h)

    b = P.budget
    found = errors.lines(r, slope, gradient)
    eye, beams = np.eye(3), np.eye(BEAMS)
    want = {
        "range_bias": [(b.range_bias_sigma_m, height(range_bias=1.0))],
        "clock": [(b.clock_sigma_s, height(clock=1.0))],
        "boresight": [
            (s, height(boresight=e)) for s, e in zip(b.boresight_sigma_rad, eye, strict=True)
        ],
        "lever_laser": [
            (s, height(lever_laser=e)) for s, e in zip(b.lever_laser_sigma_m, eye, strict=True)
        ],
        "lever_antenna": [
            (s, height(lever_antenna=e)) for s, e in zip(b.lever_antenna_sigma_m, eye, strict=True)
        ],
        "beam_range": [(b.beam_range_sigma_m, height(beam_range=e)) for e in beams],
        "beam_vertical": [(b.beam_vertical_sigma_rad, height(beam_vertical=e)) for e in beams],
    }
    for name, parts in want.items():
        exact = sum((sigma * (gradient.T @ by)) ** 2 for sigma, by in parts)
        # the clock's rates are between knots
        assert found[name] == pytest.approx(exact, rel=2e-2 if name == "clock" else 1e-5), name
    apart = np.abs(t[:, None] - t)
    for name, sigma, bias, tau in (
        ("position", 0.02, b.position_bias_fraction, b.tau_position_s),
        ("attitude", 1e-3, b.attitude_bias_fraction, b.tau_attitude_s),
    ):
        rho = bias + (1.0 - bias) * np.exp(-apart / tau)
        by = [height(**{name: e}) for e in eye]
        exact = [sum(sigma**2 * (g * d) @ rho @ (g * d) for d in by) for g in gradient.T]
        assert found[name] == pytest.approx(exact, rel=1e-5), name


def test_points_outside_the_trajectory_do_not_count():
    errors, r, *_ = flown()
    slope, gradient = np.zeros((len(r), 2)), np.ones((len(r), 1))
    late = errors.t_ns.copy()
    late[::2] += 1_000_000_000_000
    assert np.array_equal(is_covered(errors.states, late), np.arange(len(r)) % 2 == 1)
    ring, navigation = errors.ring, errors.navigation
    some = FlightErrors(errors.states, P, errors.mount, late, ring, navigation)
    half = errors.of_rows(np.arange(1, len(r), 2))
    a = some.lines(r, slope, gradient)
    b = half.lines(r[1::2], slope[1::2], gradient[1::2])
    assert all(a[name] == pytest.approx(b[name]) for name in b)


def test_slopes_of_a_plane_and_of_a_bowl():
    random = np.random.default_rng(7)
    xy = random.uniform(-5, 5, (2000, 2))
    plane = build_tin(np.column_stack([xy, 2.0 + 0.3 * xy[:, 0] - 0.1 * xy[:, 1]]))
    assert vertex_slopes(plane) == pytest.approx(np.tile([0.3, -0.1], (2000, 1)), abs=1e-9)
    bowl = build_tin(np.column_stack([xy, 0.05 * (xy**2).sum(axis=1)]))
    inner = np.abs(bowl.vertices[:, :2]).max(axis=1) < 4.0
    got = vertex_slopes(bowl)[inner]
    assert got == pytest.approx(0.1 * bowl.vertices[inner, :2], abs=0.03)
