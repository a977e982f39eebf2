"""A flight over a pyramid on level ground, made by ray geometry alone: an independent generator for
the tests of self-calibration.
"""

from types import SimpleNamespace

import numpy as np
from scipy.spatial.transform import Rotation

from ladar_volume.calibration.flight import Flight, smooth_velocity, strips
from ladar_volume.georeference.lidar_equation import mounting
from ladar_volume.model.parameters import BudgetParameters, CalibrationParameters
from ladar_volume.model.records import PlatformStates

CALIBRATION = CalibrationParameters(
    boresight_pitch_rad=np.pi / 2,
    lever_laser_m=(0.1, 0.02, -0.15),
    lever_antenna_m=(-0.1, 0.05, 0.25),
)
RATE, SPEED, HEIGHT, HALF, T0 = 100.0, 6.0, 20.0, 5.0, 1_700_000_000_000_000_000


def path(t, course, sway=1.0):
    """True position of the IMU, and rotation, at times t (n,) of one lane around its middle."""
    along, across = (
        np.array([np.cos(course), np.sin(course), 0]),
        np.array([-np.sin(course), np.cos(course), 0]),
    )
    p = SPEED * t[:, None] * along + 2.0 * np.sin(0.7 * t + course)[:, None] * across
    p[:, 2] += HEIGHT + 0.4 * np.sin(0.9 * t)
    rpy = np.column_stack(
        [0.03 * np.sin(2.0 * t), 0.03 + 0.02 * np.sin(1.3 * t + 1), course + 0.03 * np.sin(0.8 * t)]
    ) * [sway, sway, 1]
    return p, Rotation.from_euler("ZYX", rpy[:, ::-1])


def hit(origin, ray, slope):
    """Range to a pyramid of half base 7 m over z = 0, or to the ground."""
    down = -origin[:, 2] / ray[:, 2]
    if slope == 0.0:
        return down
    faces = np.array([[1, 0, 1 / slope], [-1, 0, 1 / slope], [0, 1, 1 / slope], [0, -1, 1 / slope]])
    toward, room = ray @ faces.T, 7.0 - origin @ faces.T
    t = room / toward
    enter, leave = (
        np.where(toward < 0, t, -np.inf).max(axis=1),
        np.where(toward > 0, t, np.inf).min(axis=1),
    )
    return np.where(enter < np.minimum(leave, down), enter, down)


def markov(t, tau, rng, size):
    out = rng.normal(size=size)
    y = [out]
    for d in np.diff(t):
        keep = np.exp(-d / tau)
        out = keep * out + np.sqrt(1 - keep**2) * rng.normal(size=size)
        y.append(out)
    return np.array(y)


def fly(
    budget=None,
    seed=1,
    boresight=(0, 0, 0),
    lever=(0, 0, 0),
    clock=0.0,
    slope=0.6,
    courses=(0.0, np.pi, np.pi / 2, -np.pi / 2),
    per_s=1500,
    errors=True,
    sway=1.0,
    shuffle=False,
):
    """Flight with drawn errors of the budget (none without ``errors``) and constants that are wrong
    by what is given.
    """
    rng, b = np.random.default_rng(seed), budget or BudgetParameters()
    on = 1.0 if errors else 0.0
    mount = mounting(CALIBRATION)
    sigma_p, sigma_a = np.array(b.position_sigma_m), np.array(b.attitude_sigma_rad)
    times = np.concatenate(
        [np.arange(-HALF, HALF, 1 / RATE) + 13.0 * k for k in range(len(courses))]
    )
    bias_p, bias_a = (
        rng.normal(size=3) * np.sqrt(f)
        for f in (b.position_bias_fraction, b.attitude_bias_fraction)
    )
    drift_p = (
        markov(times, b.tau_position_s, rng, 3)
        * np.sqrt(1 - b.position_bias_fraction - b.position_white_fraction)
        + bias_p
    )
    drift_a = (
        markov(times, b.tau_attitude_s, rng, 3)
        * np.sqrt(1 - b.attitude_bias_fraction - b.attitude_white_fraction)
        + bias_a
    )
    true_B = Rotation.from_rotvec(boresight).as_matrix() @ mount.R_body_laser
    rho_k, eps_k = (
        on * rng.normal(0, b.beam_range_sigma_m, 16),
        on * rng.normal(0, b.beam_vertical_sigma_rad, 16),
    )
    rho_0 = on * rng.normal(0, b.range_bias_sigma_m)
    out = {k: [] for k in ("t", "r", "ring", "st", "p", "q", "v", "w", "C", "seg")}
    for k, course in enumerate(courses):
        t = np.arange(-HALF, HALF, 1 / RATE)
        part = slice(k * len(t), (k + 1) * len(t))
        p, R = path(t, course, sway)
        antenna = p + R.apply(np.array(mount.lever_antenna)) + on * sigma_p * drift_p[part]
        R_seen = R * Rotation.from_rotvec(on * sigma_a * drift_a[part])
        h = 1e-4
        w = (path(t - h, course, sway)[1].inv() * path(t + h, course, sway)[1]).as_rotvec() / (
            2 * h
        )
        velocity = (path(t + h, course, sway)[0] - path(t - h, course, sway)[0]) / (2 * h)
        out["st"].append(T0 + np.rint((t + 13.0 * k) * 1e9).astype(np.int64))
        out["p"].append(antenna - R_seen.apply(mount.lever_antenna))
        out["q"].append(R_seen.as_quat())
        out["v"].append(R.inv().apply(velocity))
        out["w"].append(w)
        C = np.zeros((len(t), 6, 6))
        C[:, range(6), range(6)] = np.concatenate([sigma_p, sigma_a]) ** 2
        out["C"].append(C)
        out["seg"].append(np.full(len(t), k))
        n = int(per_s * (2 * HALF - 1))
        s = np.sort(rng.uniform(-HALF + 0.5, HALF - 0.5, n))
        s = (np.rint((s + 13.0 * k) * 1e9) / 1e9) - 13.0 * k
        ring = rng.integers(0, 16, n)
        az, w0 = rng.uniform(-0.6, 0.6, n), np.radians(2.0 * ring - 15.0)
        el = w0 + eps_k[ring]
        direction = np.column_stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)])
        p, R = path(s, course, sway)
        ray = R.apply(direction @ true_B.T)
        origin = p + R.apply(np.array(mount.lever_laser) + lever)
        rho = hit(origin, ray, slope) + rho_0 + rho_k[ring] + on * rng.normal(0, b.range_noise_m, n)
        nominal = np.column_stack([np.cos(w0) * np.cos(az), np.cos(w0) * np.sin(az), np.sin(w0)])
        order = rng.permutation(n) if shuffle else np.arange(n)
        out["t"].append((T0 + np.rint((s + 13.0 * k - clock) * 1e9).astype(np.int64))[order])
        out["r"].append((rho[:, None] * nominal)[order])
        out["ring"].append(ring.astype(np.uint16)[order])
    j = SimpleNamespace(**{k: np.concatenate(v) for k, v in out.items()})
    states = PlatformStates(j.st, j.p, j.q, j.v, j.w, j.C, j.seg)
    return Flight(j.t, j.r, j.ring, smooth_velocity(states, mount), strips(states), mount, 100.0)
