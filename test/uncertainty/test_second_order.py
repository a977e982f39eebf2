"""Second order of boresight and attitude: single patches in closed form, and volumes against exact
rotations drawn at random.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from volume_surfaces import BIN_NS, T0, normal_frame

from ladar_volume.georeference.error_budget import PRESETS
from ladar_volume.math.se3 import exp_so3
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.parameters import BudgetParameters, Parameters
from ladar_volume.model.records import (
    FilteredPoints,
    FilterUpdate,
    Patches,
    PlatformStates,
    Tin,
    select,
)
from ladar_volume.uncertainty import volume_budget
from ladar_volume.uncertainty.navigation_sum import NavigationBins
from ladar_volume.uncertainty.second_order import (
    SIGMA_RAD,
    AttitudeCurvature,
    SecondOrder,
    attitude_second_order,
    combine_second_orders,
    curvatures,
    second_order,
)
from ladar_volume.volume.estimator import VolumeEstimator
from ladar_volume.volume.polygon import clipped_prismoids

SPEED, STEP = 2.0, 0.5
SURVEY = PRESETS["survey"].boresight_sigma_rad


def states(height, aside, half, yaw=0.0, attitude=0.0):
    """A lane along x, 10 states a second, at y = aside; attitude : its standard deviation, rad."""
    n = int(2 * half / SPEED * 10) + 20
    t = T0 + np.arange(n) * (BIN_NS // 10)
    p = np.stack([-half + np.arange(n) * SPEED / 10, np.full(n, aside), np.full(n, height)], axis=1)
    q = np.tile([0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)], (n, 1))
    C = np.zeros((n, 6, 6))
    C[:, range(3, 6), range(3, 6)] = attitude**2
    return PlatformStates(t, p, q, np.zeros((n, 3)), np.zeros((n, 3)), C, np.zeros(n, np.int64))


def survey(height_of, half, height, aside, yaw=0.0, moving=True):
    """One point per patch on a grid, seen from abeam on the lane: the update, and the sensor's
    position (m, 3) for each. Around a patch the sensor moves with the point along x, or stands.
    """
    grid = (np.arange(round(2 * half / STEP)) + 0.5) * STEP - half
    x, y = (a.ravel() for a in np.meshgrid(grid, grid, indexing="ij"))
    e = 1e-4
    slope = np.stack(
        [height_of(x + e, y) - height_of(x - e, y), height_of(x, y + e) - height_of(x, y - e)],
        axis=1,
    ) / (2 * e)
    n = np.concatenate([-slope, np.ones((len(x), 1))], axis=1)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    tangent, side = normal_frame(n)
    r = np.stack([x, y, height_of(x, y)], axis=1)
    sensor = np.stack([x, np.full(len(x), aside), np.full(len(x), height)], axis=1)
    R = exp_so3(np.array([0.0, 0.0, yaw]))
    v, m = (r - sensor) @ R, n @ R
    count = len(x)
    M_cal, M_nav = np.zeros((count, 5, 11 + 2), np.float32), np.zeros((count, 5, 4), np.float32)
    for k, axis in ((0, n), (3, tangent), (4, side)):
        M_cal[:, k, 1:4] = M_nav[:, k, 1:] = np.cross(v, axis @ R)
        M_nav[:, k, 0] = 1.0
    for number, along in enumerate((tangent, side), start=1):
        change = along * [0.0, 1.0, 1.0] if moving else along
        M_cal[:, number, 1:4] = M_nav[:, number, 1:] = np.cross(change @ R, m)
    bins = (T0 + np.round((x + half) / SPEED * 1e9).astype(np.int64)) // BIN_NS
    key = np.arange(count, dtype=np.int64)
    C = np.zeros((count, 3, 3))
    C[:, 0, 0] = 1e-10
    patches = Patches(
        key,
        r,
        n,
        tangent,
        np.zeros((count, 3)),
        np.ones(count),
        np.full(count, 9, np.int32),
        bins * BIN_NS,
        np.arange(count + 1),
        key,
        C,
        M_cal,
        np.arange(count + 1),
        bins,
        M_nav,
    )
    points = FilteredPoints(
        r,
        n,
        np.full(count, 1e-10),
        np.zeros((count, 6), np.float32),
        bins * BIN_NS,
        key,
        np.zeros((count, 2)),
    )
    return FilterUpdate(T0, np.zeros(0, np.int64), points, patches), sensor


def estimate(update, path, half, base, ring=None, **budget):
    flat = [c * (ring or half) for c in (-1.0, -1.0, 1.0, -1.0, 1.0, 1.0, -1.0, 1.0)]
    parameters = Parameters.read(
        {
            "filter": {"nav_bin_s": 1.0},
            "georeference": {"beams": 1},
            "volume": {"outline": "polygon", "polygon_m": flat, **base},
            "budget": {"boresight_sigma_deg": [math.degrees(s) for s in SURVEY], **budget},
        }
    )
    e = VolumeEstimator(parameters)
    e.add_platform(path)
    e.add(update)
    return e.estimate()


def turned_volume(found, sensor, half, theta, yaw=0.0):
    """The volume over the fixed outline with every point turned exactly about its sensor by the
    boresight error theta (3,), or each by its own (n, 3).
    """
    R, tin = exp_so3(np.array([0.0, 0.0, yaw])), found.tin
    at = sensor[tin.source]
    body = Rotation.from_rotvec(theta if theta.ndim == 1 else theta[tin.source]).apply(
        (tin.vertices - at) @ R
    )
    moved = at + body @ R.T
    outline = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    turned = Tin(moved, tin.triangles, tin.neighbours, tin.relevant, tin.source)
    return clipped_prismoids(turned, found.base, outline, tin.relevant).net_m3


def exact_curvature(found, sensor, half, yaw, step=3e-3):
    """The Hessian (3, 3) of the volume by differences."""
    E, H = step * np.eye(3), np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            parts = [
                s * t * turned_volume(found, sensor, half, s * E[i] + t * E[j], yaw)
                for s in (1, -1)
                for t in (1, -1)
            ]
            H[i, j] = sum(parts) / (4 * step * step)
    return H


def hill(x, y):
    return 3.6 * np.exp(-(x**2 + y**2) / (2.0 * 2.1**2))


@pytest.mark.parametrize("yaw", [0.0, 2.1])
def test_a_single_patch_turns_about_the_sensor(yaw):
    normal = np.array([0.3, -0.2, 1.0]) / np.linalg.norm([0.3, -0.2, 1.0])
    update, sensor = survey(lambda x, y: -0.3 * x + 0.2 * y, 0.25, 20.0, 6.0, yaw, moving=False)
    known = NavigationBins(1.0)
    known.add(states(20.0, 6.0, 0.25, yaw))
    q = np.zeros((1, 3))
    q[0, 0] = 2.0
    patches = update.patches
    # the platform stands where it saw the patch: only then is the mean position exact
    known.pose_sums[:, 0] = known.count[:, None] * sensor[0]
    H = curvatures(q, patches, known).sum(axis=0)
    # wherever in the map both are
    away = np.array([5.0, -3.0, 2.0])
    known.pose_sums[:, 0] += known.count[:, None] * away
    moved = dataclasses.replace(patches, centre=patches.centre + away)
    np.testing.assert_allclose(curvatures(q, moved, known).sum(axis=0), H, rtol=1e-9, atol=1e-9)
    R, d = exp_so3(np.array([0.0, 0.0, yaw])), patches.centre[0] - sensor[0]
    for theta in 1e-3 * np.random.default_rng(1).standard_normal((6, 3)):
        T = R @ exp_so3(theta) @ R.T
        turned = T @ normal
        # the plane through the turned point, met on the vertical through the old place
        exact = normal[2] * (turned @ (sensor[0] + T @ d - patches.centre[0])) / turned[2]
        first = theta @ patches.M_cal[0, 0, 1:4]
        assert 2.0 * (exact - first) == pytest.approx(0.5 * theta @ H @ theta, rel=0.01, abs=1e-9)


def test_flat_ground_straight_below():
    known = NavigationBins(1.0)
    known.add(states(30.0, 0.0, 0.25))
    q = np.array([[1.0, 0.0, 0.0]])
    for moving, expected in ((False, [-30.0, -30.0, 0.0]), (True, [-30.0, 30.0, 0.0])):
        update, _ = survey(lambda x, y: 0.0 * x, 0.25, 30.0, 0.0, moving=moving)
        # a standing sensor turns the ground about itself; a moving one lifts it by the cosine under
        # a turn about the axis across
        assert curvatures(q, update.patches, known).sum(axis=0) == pytest.approx(
            np.diag(expected), abs=1.0
        )
    s, h = 2e-3, 30.0
    found = second_order(np.diag([-h, 0.0, 0.0]), np.diag([s * s, s * s, s * s]), 0.0)
    assert (found.shift_m3, found.variance_m6) == pytest.approx(
        (-0.5 * h * s**2, 0.5 * h**2 * s**4)
    )
    assert (
        found.matters
        and not second_order(np.zeros((3, 3)), np.eye(3) * (0.5 * SIGMA_RAD) ** 2, 1.0).matters
    )


@pytest.mark.parametrize(("aside", "yaw"), [(0.0, 0.0), (0.0, 0.7), (20.0, 0.0)])
def test_the_curvature_of_a_volume_under_exact_rotations(aside, yaw, monkeypatch):
    half, seen = 8.0, []
    monkeypatch.setattr(
        volume_budget, "curvatures", lambda *words: seen.append(curvatures(*words)) or seen[-1]
    )
    update, sensor = survey(hill, half + 2.0, 30.0, aside, yaw)
    found = estimate(update, states(30.0, aside, half + 2.0, yaw), half, {"base": "level"})
    exact = exact_curvature(found, sensor, half, yaw)
    assert np.abs(seen[0].sum(axis=0) - exact).max() < 0.02 * np.abs(exact).max()


def test_the_spread_where_the_first_order_cancels():
    half = 8.0
    update, sensor = survey(hill, half + 2.0, 30.0, 0.0)
    v = (found := estimate(update, states(30.0, 0.0, half + 2.0), half, {"base": "level"})).volume
    rng, count = np.random.default_rng(3), 400
    error = (
        np.array(
            [turned_volume(found, sensor, half, rng.normal(0.0, SURVEY)) for _ in range(count)]
        )
        - v.volume_m3
        - v.chord_m3
    )
    first, line = v.budget_m6["boresight"], v.budget_m6["boresight_second_order"]
    square = error**2
    assert (
        square.mean() > 100.0 * first
    )  # a pile straight below: the first order says next to nothing
    assert abs(square.mean() - first - line) < 3.0 * square.std() / math.sqrt(count)
    assert abs(error.mean() - v.second_order_m3) < 3.0 * error.std() / math.sqrt(count)
    assert v.second_order_matters and v.second_order_m3 < 0.0
    assert sum(v.budget_m6.values()) == pytest.approx(v.sigma_m3**2, rel=1e-12)


@pytest.mark.parametrize("tau", [3.0, 40.0])
def test_the_attitude_against_draws_in_time(tau, monkeypatch):
    half, sigma, bias, seen = 8.0, math.radians(0.25), 0.2, []
    monkeypatch.setattr(
        volume_budget, "curvatures", lambda *words: seen.append(curvatures(*words)) or seen[-1]
    )
    update, sensor = survey(hill, half + 2.0, 30.0, 0.0)
    v = (
        found := estimate(
            update,
            states(30.0, 0.0, half + 2.0, attitude=sigma),
            half,
            {"base": "level"},
            tau_attitude_s=tau,
            attitude_bias_fraction=bias,
            attitude_white_fraction=0.0,
            boresight_sigma_deg=[0.0, 0.0, 0.0],
        )
    ).volume
    bins, of = np.unique(update.patches.nav_bin, return_inverse=True)
    rho = bias + (1.0 - bias) * np.exp(-np.abs(bins[:, None] - bins) / tau)
    root, rng, count = (
        np.linalg.cholesky(rho + 1e-12 * np.eye(len(bins))),
        np.random.default_rng(4),
        500,
    )
    plain, second = np.zeros(count), np.zeros(count)
    for k in range(count):
        theta = sigma * root @ rng.standard_normal((len(bins), 3))
        # half the sum of both signs is the second order alone
        up, down = (
            turned_volume(found, sensor, half, sign * theta[of]) - v.volume_m3
            for sign in (1.0, -1.0)
        )
        plain[k], second[k] = up, 0.5 * (up + down)
    line = v.budget_m6["attitude_second_order"]
    assert abs(second.mean() - v.second_order_m3) < 3.0 * second.std() / math.sqrt(count)
    assert math.sqrt(line) == pytest.approx(math.sqrt((second**2).mean()), rel=0.1)
    assert math.sqrt(v.budget_m6["attitude"] + line) == pytest.approx(
        math.sqrt((plain**2).mean()), rel=0.1
    )
    # the same in all bins is a boresight
    still = BudgetParameters(attitude_bias_fraction=1.0, attitude_white_fraction=0.0)
    constant = attitude_second_order(
        AttitudeCurvature(np.zeros(len(seen[0])), sigma**2 * seen[0]), still, 0.0
    )
    whole = second_order(seen[0].sum(axis=0), sigma**2 * np.eye(3), 0.0)
    assert (constant.shift_m3, constant.variance_m6) == (
        pytest.approx(whole.shift_m3),
        pytest.approx(whole.variance_m6),
    )


def test_the_second_order_of_a_swing_in_closed_form():
    rng, budget_ = (
        np.random.default_rng(6),
        BudgetParameters(
            attitude_bias_fraction=0.3, attitude_white_fraction=0.1, tau_attitude_s=5.0
        ),
    )
    t, S = np.cumsum(rng.uniform(1.0, 3.0, 7)), rng.standard_normal((7, 3, 3))
    S += np.swapaxes(S, 1, 2)
    rho = 0.3 + 0.6 * np.exp(-np.abs(t[:, None] - t) / 5.0)
    found = attitude_second_order(AttitudeCurvature(t, S), budget_, 1e9)
    assert found.variance_m6 == pytest.approx(0.5 * np.einsum("ef,eij,fij->", rho**2, S, S))
    assert found.shift_m3 == pytest.approx(0.45 * np.einsum("eii->", S)) and not found.matters


def test_means_of_several_second_orders_add_up():
    parts = {
        "a": SecondOrder(0.3, 0.01, False),
        "b": SecondOrder(0.2, 0.02, True),
        "c": SecondOrder(-0.05, 0.06, False),
    }
    lines, whole = combine_second_orders(parts)
    assert sum(lines.values()) == pytest.approx(0.09 + 0.45**2) and whole.line_m6 == pytest.approx(
        sum(lines.values())
    )
    assert (
        whole.matters
        and combine_second_orders({"a": parts["a"], "c": SecondOrder(-0.2, 0.0, False)})[0]["c"]
        == 0.0
    )


def test_own_ground_cancels_the_second_order_too_and_aside_the_first_order_rules():
    half = 8.0
    update, _ = survey(hill, half + 2.0, 30.0, 0.0)
    path = states(30.0, 0.0, half + 2.0)
    level = estimate(update, path, half, {"base": "level"}).volume
    own = estimate(update, path, half, {"base": "ground", "ground_ring_m": 0.0}, ring=6.0).volume
    assert (
        own.budget_m6["boresight_second_order"] < 0.05 * level.budget_m6["boresight_second_order"]
    )
    aside, _ = survey(hill, half + 2.0, 30.0, 20.0)
    v = estimate(aside, states(30.0, 20.0, half + 2.0), half, {"base": "level"}).volume
    assert v.budget_m6["boresight_second_order"] < 1e-4 * v.budget_m6["boresight"]


def test_mean_poses_whatever_the_batches():
    s = states(20.0, 3.0, 4.0, 0.4)
    whole, pieces = NavigationBins(1.0), NavigationBins(1.0)
    whole.add(s)
    for part in (slice(0, 7), slice(7, 30), slice(30, None)):
        pieces.add(select(s, part))
    position, R = whole.mean_pose(whole.index)
    assert np.array_equal(position, pieces.mean_pose(whole.index)[0]) and np.array_equal(
        R, pieces.mean_pose(whole.index)[1]
    )
    first = s.t_ns // BIN_NS == whole.index[1]
    assert position[1] == pytest.approx(s.p_map_body[first].mean(axis=0)) and R[1] == pytest.approx(
        exp_so3(np.array([0.0, 0.0, 0.4]))
    )
    with pytest.raises(VolumeError):
        whole.mean_pose(np.array([0]))
