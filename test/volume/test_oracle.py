"""The whole propagation against a slow one of its own, written from UNCERTAINTY.md with dense
matrices and differences.

The oracle shares no formula with the package: Delaunay triangles of scipy, volumes by integrating
each triangle, every derivative by central differences of the LiDAR equation with true rotation
matrices, one covariance matrix over all coordinates of all points, with the times of all returns in
it.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

from ladar_volume.experiments.coverage.coverage_survey import MappedSurvey, vertices
from ladar_volume.georeference.lidar_equation import mounting
from ladar_volume.model.parameters import (
    BudgetParameters,
    CalibrationParameters,
    GeoreferenceParameters,
    GroundParameters,
    Parameters,
    VolumeParameters,
)
from ladar_volume.model.records import MappedPoints, PlatformStates
from ladar_volume.volume.estimator import VolumeEstimator

BEAMS, BIN_S, RATE = 16, 2.0, 200.0
LASER, ANTENNA = np.array([0.12, -0.03, -0.15]), np.array([-0.1, 0.05, 0.25])
NOMINAL = Rotation.from_euler("ZYX", [0.3, 1.4, -0.2])
BUDGET = BudgetParameters(
    position_bias_fraction=0.2,
    position_white_fraction=0.1,
    attitude_bias_fraction=0.15,
    attitude_white_fraction=0.05,
    tau_position_s=9.0,
    tau_attitude_s=3.0,
    boresight_sigma_rad=(4e-4, 5e-4, 8e-4),
    clock_sigma_s=2e-3,
    position_sigma_m=(0.014, 0.02, 0.03),
)


def pose(t):
    """Antenna (n, 3) and attitude of a swaying flight at times (n,) s; linear between the states,
    so that both codes see one path.
    """
    k = np.minimum(np.floor(t * RATE).astype(int), len(STATES_T) - 2)
    f = t * RATE - k
    antenna = ANTENNA_AT[k] + f[:, None] * (ANTENNA_AT[k + 1] - ANTENNA_AT[k])
    step = (ATTITUDE[k].inv() * ATTITUDE[k + 1]).as_rotvec()
    return antenna, ATTITUDE[k] * Rotation.from_rotvec(f[:, None] * step)


STATES_T = np.arange(0.0, 12.01, 1.0 / RATE)
ATTITUDE = Rotation.from_euler(
    "ZYX",
    np.stack(
        [0.4 + 0.05 * STATES_T, 0.03 * np.sin(STATES_T), 0.1 * np.cos(0.7 * STATES_T)], axis=1
    ),
)
ANTENNA_AT = np.stack([STATES_T - 6.0, np.sin(STATES_T / 3.0), 20.0 + 0.1 * STATES_T], axis=1)


ZERO = np.zeros(3)


def lidar(antenna, R, laser, boresight=ZERO, b=ZERO, a=ZERO, attitude=ZERO):
    """The LiDAR equation for one return, with errors: boresight and attitude as rotation vectors on
    the body's side.
    """
    B = (Rotation.from_rotvec(boresight) * NOMINAL).as_matrix()
    turned = R @ Rotation.from_rotvec(attitude).as_matrix()
    return antenna - turned @ (ANTENNA + a) + turned @ (B @ laser + LASER + b)


def polar(laser):
    r = np.linalg.norm(laser)
    return r, math.atan2(laser[1], laser[0]), math.asin(laser[2] / r)


def cartesian(r, azimuth, vertical):
    return r * np.array(
        [
            math.cos(vertical) * math.cos(azimuth),
            math.cos(vertical) * math.sin(azimuth),
            math.sin(vertical),
        ]
    )


def slope_of(function, size, h):
    """Jacobian of a vector function of ``size`` arguments at zero by central differences."""
    return np.stack([(function(h * e) - function(-h * e)) / (2 * h) for e in np.eye(size)], axis=-1)


def surface(seed, n=90):
    """A random mesh: points (n, 3) of a bumpy height field with unit normals, and when, by which
    beam and how each was measured.
    """
    rng = np.random.default_rng(seed)
    xy = np.concatenate(
        [rng.uniform(-6, 6, (n - 4, 2)), [[-6.5, -6.5], [6.5, -6.5], [6.5, 6.5], [-6.5, 6.5]]]
    )
    z = 2.0 * np.exp(-(xy**2).sum(axis=1) / 8.0) + 0.05 * rng.standard_normal(n)
    normal = np.c_[0.5 * xy * np.exp(-(xy**2).sum(axis=1) / 8.0)[:, None], np.ones(n)]
    t = np.sort(rng.uniform(0.3, 11.7, n))
    return (
        np.c_[xy, z],
        normal / np.linalg.norm(normal, axis=1, keepdims=True),
        t,
        rng.integers(0, BEAMS, n),
    )


def laser_of(point, antenna, R):
    """What the laser measured, if nothing was wrong."""
    return NOMINAL.as_matrix().T @ (R.T @ (point - antenna) + ANTENNA - LASER)


def rows_of(point, antenna, R):
    """How the point moves with every source, by central differences."""
    laser = laser_of(point, antenna, R)
    r = np.array(polar(laser))
    moved = {
        "boresight": lambda e: lidar(antenna, R, laser, boresight=e),
        "attitude": lambda e: lidar(antenna, R, laser, attitude=e),
        "laser": lambda e: lidar(antenna, R, laser, b=e),
        "antenna": lambda e: lidar(antenna, R, laser, a=e),
        "ray": lambda e: lidar(antenna, R, cartesian(*(r + e))),
    }
    return {name: slope_of(function, 3, 1e-6) for name, function in moved.items()}


def dense(points, normal, t, ring, gradient):
    """Variance (m⁶) by source of a result with gradient (n, 3): every return's Jacobian, that of
    its noise along its normal, and full covariances.
    """
    antenna, R = pose(t)
    before, after = pose(t - 1e-4), pose(t + 1e-4)
    b, n = BUDGET, len(points)
    J = {
        name: np.zeros((n, 3))
        for name in ("boresight", "laser", "antenna", "ray", "attitude", "noise")
    }  # of the result
    clock = np.zeros(n)
    for i in range(n):
        moved = rows_of(points[i], antenna[i], R[i].as_matrix())
        for name, rows in moved.items():
            J[name][i] = gradient[i] @ rows
        J["noise"][i] = (gradient[i] @ normal[i]) * (normal[i] @ moved["ray"])
        ends = [
            lidar(p[0][i], p[1][i].as_matrix(), laser_of(points[i], antenna[i], R[i].as_matrix()))
            for p in (before, after)
        ]
        clock[i] = gradient[i] @ (ends[1] - ends[0]) / 2e-4
    spot = b.beam_divergence_rad / 4
    ray = np.array(
        [
            b.range_noise_m,
            math.hypot(b.azimuth_noise_rad, spot),
            math.hypot(b.vertical_noise_rad, spot),
        ]
    )
    out = {"noise": float((J["noise"] ** 2 @ ray**2).sum())}
    same = ring[:, None] == ring
    out["range_bias"] = b.range_bias_sigma_m**2 * float(J["ray"][:, 0].sum()) ** 2
    for line, column, sigma in (
        ("beam_range", 0, b.beam_range_sigma_m),
        ("beam_vertical", 2, b.beam_vertical_sigma_rad),
    ):
        s = J["ray"][:, column]
        out[line] = sigma**2 * float(s @ same @ s)
    constants = {
        "boresight": b.boresight_sigma_rad,
        "laser": b.lever_laser_sigma_m,
        "antenna": b.lever_antenna_sigma_m,
    }
    for name, sigma in constants.items():
        out[name] = float((J[name].sum(axis=0) ** 2) @ np.array(sigma) ** 2)
    out["clock"] = b.clock_sigma_s**2 * float(clock.sum()) ** 2
    out["clock_apart"] = b.clock_sigma_s**2 * float(np.abs(clock).sum()) ** 2
    # navigation: errors of one time bin are one error, white ones average over the samples in it
    bins = np.floor(t / BIN_S)
    lag = np.abs(bins[:, None] - bins) * BIN_S
    for line, s, bias, white, tau, samples in (
        (
            "position",
            gradient * np.array(b.position_sigma_m),
            b.position_bias_fraction,
            b.position_white_fraction,
            b.tau_position_s,
            BIN_S / 0.5,
        ),
        (
            "attitude",
            J["attitude"] * np.array(b.attitude_sigma_rad),
            b.attitude_bias_fraction,
            b.attitude_white_fraction,
            b.tau_attitude_s,
            BIN_S * RATE,
        ),
    ):
        rho = bias + (1 - bias - white) * np.exp(-lag / tau) + white / samples * (lag == 0)
        out[line] = float(((s @ s.T) * rho).sum())
    return out


def net(points, triangles, base):
    """Volume above a base, triangle by triangle: area times mean height."""
    p = points[triangles]
    u, v = p[:, 1, :2] - p[:, 0, :2], p[:, 2, :2] - p[:, 0, :2]
    return float(
        (
            0.5
            * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
            * (p[:, :, 2] - base(p[:, :, :2])).mean(axis=1)
        ).sum()
    )


def oriented(points):
    t = Delaunay(points[:, :2]).simplices
    p = points[t, :2]
    u, v = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    return np.where((u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] > 0)[:, None], t, t[:, ::-1])


def by_package(points, normal, t, ring, volume):
    """The package's estimate of the same points; attitudes' covariance is that of body axes, as the
    oracle's.
    """
    P = Parameters(
        budget=BUDGET,
        volume=volume,
        georeference=GeoreferenceParameters(max_position_gap_s=0.5, beams=BEAMS),
        calibration=CalibrationParameters(),
        ground=GroundParameters(trials=50),
    )
    mount = dataclasses.replace(
        mounting(CalibrationParameters(lever_laser_m=tuple(LASER), lever_antenna_m=tuple(ANTENNA))),
        R_body_laser=NOMINAL.as_matrix(),
    )
    n = len(STATES_T)
    C = np.zeros((n, 6, 6))
    C[:, range(6), range(6)] = np.array([*BUDGET.position_sigma_m, *BUDGET.attitude_sigma_rad]) ** 2
    k = np.arange(n)
    low, high = np.maximum(k - 1, 0), np.minimum(k + 1, n - 1)
    span = ((high - low) / RATE)[:, None]
    velocity, omega = (
        (ANTENNA_AT[high] - ANTENNA_AT[low]) / span,
        (ATTITUDE[low].inv() * ATTITUDE[high]).as_rotvec() / span,
    )
    body = ATTITUDE.inv().apply(velocity) - np.cross(omega, ANTENNA)
    states = PlatformStates(
        np.rint(STATES_T * 1e9).astype(np.int64),
        ANTENNA_AT - ATTITUDE.apply(ANTENNA),
        ATTITUDE.as_quat(),
        body,
        omega,
        C,
        np.zeros(n, np.int64),
    )
    mapped = MappedPoints(
        np.rint(t * 1e9).astype(np.int64),
        points,
        np.zeros((len(points), 6), np.float32),
        ring.astype(np.uint16),
        np.ones(len(points), np.float32),
    )
    estimator = VolumeEstimator(P)
    estimator.add_platform(states)
    estimator.add(vertices(MappedSurvey(mapped, lambda: states, mount, normal), P))
    return estimator.estimate()


WHOLE = {"outline": "all", "relevant": "all", "max_edge_m": 100.0}
NAMES = {"lever_laser": "laser", "lever_antenna": "antenna"}
FIRST_ORDER = (
    "noise",
    "range_bias",
    "beam_range",
    "beam_vertical",
    "boresight",
    "lever_laser",
    "lever_antenna",
    "position",
    "attitude",
)


def compare(estimate, expected):
    for line in FIRST_ORDER:
        assert estimate.volume.budget_m6[line] == pytest.approx(
            expected[NAMES.get(line, line)], rel=2e-4, abs=1e-12
        ), line
    # the platform's velocity is known at the states and linear between them, the path is not; most
    # of what it does cancels
    slack = 2e-4 * math.sqrt(expected["clock_apart"])
    assert math.sqrt(estimate.volume.budget_m6["clock"]) == pytest.approx(
        math.sqrt(expected["clock"]), rel=1e-3, abs=slack
    )


def by_differences(V, points):
    """Gradient (n, 3) of V by central differences."""
    out = np.zeros_like(points)
    for i in range(points.size):
        e = np.zeros(points.size)
        e[i] = 1e-5
        e = e.reshape(points.shape)
        out.ravel()[i] = (V(points + e) - V(points - e)) / 2e-5
    return out


@pytest.mark.parametrize("seed", range(4))
def test_above_a_level(seed):
    points, normal, t, ring = surface(seed)
    estimate = by_package(
        points, normal, t, ring, VolumeParameters(base="level", level_m=-0.3, **WHOLE)
    )
    triangles = oriented(points)

    def V(p):
        return net(p, triangles, lambda xy: np.full(xy.shape[:-1], -0.3))

    assert estimate.volume.volume_m3 + estimate.volume.chord_m3 == pytest.approx(
        V(points), rel=1e-9
    )
    compare(estimate, dense(points, normal, t, ring, by_differences(V, points)))


@pytest.mark.parametrize("seed", range(4))
def test_above_a_ground_of_the_same_survey(seed):
    points, normal, t, ring = surface(seed)
    estimate = by_package(points, normal, t, ring, VolumeParameters(**WHOLE))
    ground = estimate.tin.source[
        estimate.base.support
    ]  # which points are ground is the package's choice; how they act is not
    assert 10 < len(ground) < len(points)
    triangles = oriented(points)

    def V(p):
        X = np.c_[np.ones(len(ground)), p[ground, :2]]
        beta = np.linalg.lstsq(X, p[ground, 2], rcond=None)[0]
        return net(p, triangles, lambda xy: beta[0] + xy @ beta[1:])

    assert estimate.volume.volume_m3 + estimate.volume.chord_m3 == pytest.approx(
        V(points), rel=1e-9
    )
    gradient = by_differences(V, points)
    assert np.abs(gradient.sum(axis=0)).max() < 1e-6  # a common shift changes nothing
    compare(estimate, dense(points, normal, t, ring, gradient))
