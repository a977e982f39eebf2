"""The pieces of self-calibration: each against an independent computation or a closed form."""

import dataclasses

import numpy as np
import pytest
from pyramid_flight import CALIBRATION, SPEED, fly

from ladar_volume.calibration.flight import (
    apply_corrections,
    flight,
    remap_returns,
    smooth_velocity,
    strips,
)
from ladar_volume.calibration.navigation_drift import drift
from ladar_volume.calibration.strip_adjustment import drop_patches, observations, off_plane, solve
from ladar_volume.calibration.strip_patches import average_normals, medians, overlap, voxel_numbers
from ladar_volume.georeference.error_budget import calibration_covariance, independent_sigmas
from ladar_volume.georeference.lidar_equation import mounting
from ladar_volume.georeference.point_jacobian import calibration_jacobian, navigation_jacobian
from ladar_volume.math.packed_covariance import unpack
from ladar_volume.model.errors import CalibrationError
from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.model.records import MappedPoints

BUDGET = BudgetParameters()
SIGMAS = independent_sigmas(BUDGET)


@pytest.fixture(scope="module")
def problem():
    """A small flight, its patches and observations."""
    flown = fly(BUDGET, 1, np.radians([0.1, -0.05, 0.1]), per_s=250)
    points, geometry, _ = remap_returns(flown, np.zeros(43), SIGMAS)
    found = overlap(points.r_map, flown.strip[geometry.state], unpack(points.C_ind), 2.0, 4, 60)
    effects = drift(flown, BUDGET)
    sigma = np.full(len(found.point), 0.01)
    return found, effects, observations(points, geometry, found, effects, sigma), geometry, points


def test_elimination_equals_the_adjustment_of_everything(problem):
    _, effects, o, _, _ = problem
    prior = calibration_covariance(BUDGET, 16)
    theta = np.random.default_rng(2).normal(size=43) * np.sqrt(np.diag(prior))
    columns = np.arange(43)
    found = solve(o, effects, columns, 16, np.linalg.inv(prior), theta)
    u, patches = 43 + effects.unknowns, int(o.patch.max()) + 1
    A = np.zeros((len(o.e), u + 3 * patches))
    for i in range(len(o.e)):  # every row written out, planes as unknowns of their own
        A[i, :11] = o.shared_jacobian[i]
        A[i, 11 + o.ring[i]], A[i, 27 + o.ring[i]] = o.own_jacobian[i]
        at = 43 + 6 * o.knot[i]
        A[i, at : at + 6] += (1 - o.share[i]) * o.nav[i]
        A[i, at + 6 : at + 12] += o.share[i] * o.nav[i]
        A[i, u + 3 * o.patch[i] : u + 3 * o.patch[i] + 3] = o.Q[i]
    P = np.zeros((u + 3 * patches,) * 2)
    P[:43, :43] = np.linalg.inv(prior)
    P[43:u, 43:u] = effects.prior()
    full = np.concatenate([theta, np.zeros(len(P) - 43)])
    N = A.T @ A + P
    x = -np.linalg.solve(N, A.T @ o.e + P @ full)
    scale = np.sqrt(np.diag(prior))
    assert found.x[:43] / scale == pytest.approx(x[:43] / scale, abs=1e-6)
    assert found.C / np.outer(scale, scale) == pytest.approx(
        np.linalg.inv(N)[:43, :43] / np.outer(scale, scale), abs=1e-6
    )
    residual = o.e + A @ x
    assert found.residual == pytest.approx(residual, abs=1e-6)
    chi2 = residual @ residual + (x + full)[:u] @ P[:u, :u] @ (x + full)[:u]
    assert found.chi2 == pytest.approx(chi2, rel=1e-8) and found.freedom == len(o.e) - 3 * patches


def test_rows_say_how_heights_move(problem):
    found, _, o, geometry, points = problem
    theta = np.zeros(43)
    theta[1:11] = [1e-5, -2e-5, 1e-5, 1e-4, 2e-4, -1e-4, 1e-4, 0, 1e-4, 1e-5]
    flown = fly(BUDGET, 1, np.radians([0.1, -0.05, 0.1]), per_s=250)
    moved, _, _ = remap_returns(flown, theta, SIGMAS)
    change = moved.r_map - points.r_map
    assert change == pytest.approx(calibration_jacobian(geometry)[:, :, 1:] @ theta[1:11], abs=2e-5)
    assert np.abs(change).max() > 2e-4
    order = np.argsort(o.knot, kind="stable")
    assert (np.diff(o.knot) >= 0).all() and len(order) == len(found.point)


def test_without_takes_whole_patches_away(problem):
    _, _, o, _, _ = problem
    cut = drop_patches(o, np.array([0, 3]))
    assert (
        len(cut.e) == np.count_nonzero(~np.isin(o.patch, [0, 3]))
        and int(cut.patch.max()) == int(o.patch.max()) - 2
    )
    assert off_plane(cut, cut.e) == pytest.approx(
        off_plane(o, o.e)[~np.isin(o.patch, [0, 3])], abs=1e-9
    )
    for a in range(3):  # a plane is taken whole
        assert np.abs(off_plane(o, o.Q[:, a])).max() < 1e-9


def test_navigation_errors_have_the_budgets_covariance(problem):
    _, effects, _, geometry, _ = problem
    K = np.linalg.inv(effects.prior()).reshape(len(effects.t_ns), 6, len(effects.t_ns), 6)
    lag = abs(int(effects.t_ns[5] - effects.t_ns[2])) * 1e-9
    b = BUDGET
    assert K[2, 0, 5, 0] == pytest.approx(
        b.position_bias_fraction + 0.7 * np.exp(-lag / b.tau_position_s), rel=1e-6
    )
    assert K[2, 4, 5, 4] == pytest.approx(
        b.attitude_bias_fraction + 0.8 * np.exp(-lag / b.tau_attitude_s), rel=1e-6
    )
    step = float(effects.t_ns[1] - effects.t_ns[0]) * 1e-9  # 100 fixes a second
    assert np.abs(K[:, 0, :, 1]).max() < 1e-12 and K[2, 0, 2, 0] == pytest.approx(
        0.9 + 0.1 / (100.0 * step), rel=1e-6
    )
    normal = np.tile([0.0, 0.0, 1.0], (len(geometry), 1))
    rows = effects.rows(normal, geometry)
    J = navigation_jacobian(geometry)[:, 2]
    sigma = np.concatenate([b.position_sigma_m, b.attitude_sigma_rad])
    assert rows == pytest.approx(J * sigma, rel=1e-6, abs=1e-12)
    k, share = effects.place(effects.t_ns)
    assert k[:-1].tolist() == list(range(len(effects.t_ns) - 1)) and (k[-1], share[-1]) == (
        len(effects.t_ns) - 2,
        1.0,
    )


def test_a_constant_offset_between_strips_does_not_tilt_a_patch():
    rng = np.random.default_rng(3)
    n, slope = 4000, np.array([0.3, -0.2])
    xy = rng.uniform(0.05, 0.95, (n, 2))
    strip = (xy[:, 0] + 0.3 * rng.normal(size=n) > 0.5).astype(
        int
    )  # strips that see different halves
    z = xy @ slope + 0.2 * strip + 0.005 * rng.normal(size=n)
    z[:40] += rng.uniform(0.1, 0.4, 40)  # grass
    found = overlap(
        np.column_stack([xy, z]),
        strip,
        np.broadcast_to(np.eye(3) * 0.005**2, (n, 3, 3)),
        1.0,
        10,
        10,
    )
    n0 = np.append(-slope, 1.0) / np.sqrt(1 + slope @ slope)
    biggest = np.argmax(np.bincount(found.patch))
    assert abs(found.normal[biggest] @ n0) > np.cos(2e-3)
    assert not np.isin(np.arange(40), found.point).any()


def test_level_ground_is_not_cut_by_a_face_of_a_cell():
    rng = np.random.default_rng(4)
    r = np.column_stack([rng.uniform(0, 5, (5000, 2)), 0.01 * rng.normal(size=5000)])
    assert len(np.unique(voxel_numbers(r, 1.0))) == 25
    r[:2500, 2] += 3.0  # a roof above: its own cells
    assert len(np.unique(voxel_numbers(r, 1.0))) == 50


def test_medians_are_values_of_their_label():
    rng = np.random.default_rng(5)
    label, values = rng.integers(0, 7, 100), rng.normal(size=100)
    assert medians(values, label) == pytest.approx(
        [np.sort(values[label == k])[(np.count_nonzero(label == k) - 1) // 2] for k in range(7)]
    )


def test_averaged_normals_lose_their_noise_and_keep_edges():
    rng = np.random.default_rng(6)
    centre = np.column_stack(
        [np.repeat(np.arange(20.0), 20), np.tile(np.arange(20.0), 20), np.zeros(400)]
    )
    normal = np.tile([0.0, 0.0, 1.0], (400, 1)) + 0.01 * rng.normal(size=(400, 3)) * [1, 1, 0]
    normal[200:] = [0.0, 0.5, 1.0]
    normal *= rng.choice([-1.0, 1.0], 400)[:, None]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    out = average_normals(centre, normal, 3.0)
    tilt = out[:200, :2] * np.sign(out[:200, 2:])
    assert np.std(tilt) < 0.01 / 2.5  # 15 to 29 neighbours, and they share some
    assert np.abs(out[200:] * np.sign(out[200:, 2:])) == pytest.approx(
        np.tile(normal[399] * np.sign(normal[399, 2]), (200, 1)), abs=1e-12
    )


def test_a_figure_turned_and_hovering_is_cut_into_strips():
    flown = fly(BUDGET, 1, per_s=50, errors=False)
    assert np.unique(flown.strip).tolist() == [0, 1, 2, 3]  # one per lane
    s = flown.states
    still = dataclasses.replace(s, v_body=np.zeros_like(s.v_body))
    assert np.array_equal(strips(still), flown.strip)
    crab = dataclasses.replace(
        s, q_map_body=np.broadcast_to(s.q_map_body[0], s.q_map_body.shape)
    )  # constant heading, lanes by course
    assert strips(crab).max() >= 3


def test_steady_velocity_is_exact_on_a_line_and_quieter_than_the_fixes():
    s = fly(BUDGET, 1, per_s=50, errors=False).states
    mount = mounting(CALIBRATION)
    t = (s.t_ns - s.t_ns[0]) * 1e-9
    level = np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1))
    rng = np.random.default_rng(7)
    line = dataclasses.replace(
        s,
        q_map_body=level,
        omega_body=np.zeros_like(s.omega_body),
        p_map_body=np.outer(t, [SPEED, 1.0, 0.2]),
        v_body=rng.normal(size=(len(t), 3)),
    )
    assert smooth_velocity(line, mount).v_body == pytest.approx(
        np.tile([SPEED, 1.0, 0.2], (len(t), 1)), abs=1e-9
    )
    noisy = dataclasses.replace(
        line, p_map_body=line.p_map_body + 0.005 * rng.normal(size=(len(t), 3))
    )
    assert (
        np.std(smooth_velocity(noisy, mount).v_body[200:800] - [SPEED, 1.0, 0.2]) < 0.005
    )  # between neighbours it is 0.7 m/s


def test_a_flight_from_mapped_points_gives_back_its_returns():
    flown = fly(BUDGET, 1, per_s=100)
    points, _, index = remap_returns(flown, np.zeros(43), SIGMAS)
    again = flight(points, flown.states, flown.mount, 100.0)
    assert np.array_equal(again.t_ns, flown.t_ns[index])
    assert again.r_laser == pytest.approx(flown.r_laser[index], abs=1e-7)
    late = MappedPoints(
        points.t_ns + 10**12, points.r_map, points.C_ind, points.ring, points.intensity
    )
    with pytest.raises(CalibrationError, match="no return lies"):
        flight(late, flown.states, flown.mount, 100.0)


def test_turned_corrects_on_the_body_side():
    mount = mounting(CALIBRATION)
    theta = np.zeros(43)
    theta[1:11] = [0.01, 0.02, -0.01, 1, 2, 3, 4, 5, 6, 0.5]
    t = apply_corrections(mount, theta)
    assert np.allclose(
        t.R_body_laser @ mount.R_body_laser.T - np.eye(3),
        np.array([[0, 0.01, 0.02], [-0.01, 0, -0.01], [-0.02, 0.01, 0]]),
        atol=3e-4,
    )
    assert (
        t.lever_laser - mount.lever_laser == pytest.approx([1, 2, 3]) and t.clock_ns == 500_000_000
    )
