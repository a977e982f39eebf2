"""Formulas, units and signs in closed form: each of these fails when its bug is planted
(benchmarks/planted_rooms.py plants them).
"""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from ladar_volume.change import cut_and_fill
from ladar_volume.change.cut_and_fill import point_variance, positive_part
from ladar_volume.change.density import relative_errors
from ladar_volume.change.epoch_change import within_outline
from ladar_volume.change.excavation import Scan
from ladar_volume.change.ring_budget import ring_line, transform_scan
from ladar_volume.change.ring_fit import ALONG, STRETCHES, sandwich
from ladar_volume.clouds import volume_verdict
from ladar_volume.clouds.cloud_noise import cloud_noise, fit_residuals
from ladar_volume.georeference.clock_check import Lead
from ladar_volume.georeference.error_budget import independent_sigmas
from ladar_volume.georeference.georeferencer import Georeferencer
from ladar_volume.georeference.point_jacobian import navigation_covariance_at
from ladar_volume.georeference.sample_admission import TimeOrder
from ladar_volume.math.se3 import rotation_xyz
from ladar_volume.model.parameters import BudgetParameters, GeoreferenceParameters, Parameters
from ladar_volume.model.records import OdometrySample, Returns
from ladar_volume.registration.transform import Transform
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.uncertainty.pass_differences import Sizes, bin_covariances
from ladar_volume.volume.cutfill import cut_sequence, with_net
from ladar_volume.volume.floors import spikes, surface_offset

S = 1_000_000_000


def waiting_stage():
    given = GeoreferenceParameters(pose_source="odometry", max_pending_s=2.0)
    return Georeferencer(Parameters(georeference=given))


def pose(stage, t_ns):
    q, p = np.array([0.0, 0.0, 0.0, 1.0]), np.array([1.0, 2.0, 3.0])
    stage.add_odometry(OdometrySample(t_ns, p, q, np.zeros(3), np.zeros(3), 1e-4 * np.eye(6)))


def cloud(stage, t_ns):
    r, ring = np.tile([5.0, 1.0, 0.0], (10, 1)), np.zeros(10, np.uint16)
    stage.add_returns(Returns(np.full(10, t_ns, np.int64), r, ring, np.full(10, 9.0, np.float32)))


def test_poses_may_go_on_for_twice_the_time_that_returns_wait():
    stage = waiting_stage()
    pose(stage, 100 * S)
    cloud(stage, 900 * S)  # one cloud whose clock is ahead
    waiting = {}
    for k in range(1, 50):
        pose(stage, 100 * S + k * S // 10)
        waiting[k] = stage.pending
    assert waiting[25] == waiting[39] == 10 and waiting[45] == 0
    assert stage.losses.as_dict()["point_pose_timeout"] == 10


def test_one_corrupt_stamp_expires_nothing_that_waits():
    stage = waiting_stage()
    pose(stage, 100 * S)
    cloud(stage, 101 * S)
    cloud(stage, 4000 * S)  # an hour ahead
    assert stage.pending == 20 and not stage.losses.as_dict()


def test_a_quarter_of_the_divergence_is_noise_of_the_angles():
    budget = BudgetParameters(
        range_noise_m=0.02,
        azimuth_noise_rad=3e-4,
        vertical_noise_rad=0.0,
        beam_divergence_rad=1.6e-3,
    )
    assert independent_sigmas(budget) == pytest.approx([0.02, 5e-4, 4e-4])


def test_a_sweep_is_half_a_period_older_than_the_next_attitude():
    lead = Lead()
    for k in range(60):
        lead.reference(k * 10_000_000)
        lead.add_reference_clock(k * 10_000_000 - 30_000_000)
    assert lead.estimate_s == pytest.approx((0.035, 0.0))


def test_the_covariance_of_navigation_is_that_of_the_nearer_state():
    states = SimpleNamespace(C_nav=np.stack([np.eye(6), 5.0 * np.eye(6)]))
    states = type("States", (), {"C_nav": states.C_nav, "__len__": lambda self: 2})()
    geometry = SimpleNamespace(state=np.array([0]), fraction=np.array([0.25]))
    assert np.allclose(navigation_covariance_at(geometry, states), 2.0 * np.eye(6))


def test_a_clock_that_was_set_back_comes_forward_by_half_the_step():
    order = TimeOrder("imu")
    told = {}
    for t in (99.9, 100.0, 96.0, 96.1, 97.4, 98.4, 99.4, 100.2):
        told[t] = order.push(round(t * 1e9), t)
    assert told[100.0] == ([100.0], [])
    assert told[97.4] == ([], ["imu_time_backwards"])  # by 1.3 s of four: not yet
    assert told[100.2] == ([], ["imu_clock_back"])
    whole = TimeOrder("imu")
    for t in (99.9, 100.0, 96.0, 96.1):
        whole.push(round(t * 1e9), t)
    assert whole.push(round(100.1 * 1e9), 100.1) == ([100.1], [])


def test_what_errors_along_a_length_are_of_a_volume():
    found = relative_errors(600.0, 1000.0, correlated_m=0.02, correlation_length_m=3.0)
    area = 2.0 * math.pi * 3.0**2  # of a correlation that falls exponentially, in the plane
    assert found["correlated"] == pytest.approx(0.02 * math.sqrt(area * 600.0) / 1000.0)


def test_a_registration_that_is_known_to_be_uncertain_explains_the_ring():
    fit = SimpleNamespace(effect_m3=5.0, effect_sigma_m3=1.0)
    known = SimpleNamespace(budget_m6={"noise_a": 1.0, "registration_b": 1.0})
    unknown = SimpleNamespace(budget_m6={"noise_a": 1.0})
    assert ring_line(known, fit, "none", stated=True) == ({**known.budget_m6, "ring": 0.0}, False)
    assert ring_line(unknown, fit, "none", stated=True)[1]


def test_the_width_of_a_floor_is_that_of_its_heights():
    # heights evenly between -w and w: their standard deviation is w / sqrt(3)
    step, w, area = 0.01, 0.025, 40.0
    level = step * np.arange(-40, 41) + 0.003
    x = np.clip(level, -w, w)
    cut = area * np.where(level > w, 0.0, np.where(level < -w, -level, (w - x) ** 2 / (4.0 * w)))
    (event,) = spikes(level, cut)
    assert event.area_m2 == pytest.approx(area, rel=1e-3)
    assert event.width_m == pytest.approx(w / math.sqrt(3.0), rel=0.01)


def test_sigma_of_an_offset_is_that_of_one_parameter():
    rng = np.random.default_rng(3)
    xy = rng.uniform(0.0, 4.0, (200, 2))
    one, two = (
        build_tin(np.column_stack([xy, 0.4 * xy[:, 0] + rng.normal(0.0, 0.05, 200)]))
        for _ in range(2)
    )
    z = np.linspace(0.2, 1.2, 9)
    found = surface_offset(one, two, z)
    d, h = found.offset_m, 1e-5
    low, mid, high = (cut_sequence(one, z + d + k * h).cut_m3 for k in (-1.0, 0.0, 1.0))
    slope, r = (high - low) / (2.0 * h), mid - cut_sequence(two, z).cut_m3
    assert abs(slope @ r) < 1e-6 * np.linalg.norm(slope) * np.linalg.norm(r)
    assert found.sigma_m == pytest.approx(math.sqrt(r @ r / 8.0 / (slope @ slope)), rel=1e-6)


def test_a_triangle_counts_where_half_of_it_lies_in_the_outline():
    """Of a square of 2 m cut along its diagonal, outlines that hold more or less than half."""
    r = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 2.0, 0.0], [0.0, 2.0, 0.0]])
    tin = build_tin(r)
    at_left = np.isclose(r[tin.triangles][:, :, 0], 0.0).sum(axis=1) == 2
    for far, held in ((0.5, False), (0.7, True)):  # of the triangle at x = 0: 1 - (1 - far / 2)^2
        strip = np.array([[-1.0, -1.0], [far, -1.0], [far, 3.0], [-1.0, 3.0]])
        kept = within_outline(tin, strip).relevant
        assert kept[at_left].tolist() == [held] and not kept[~at_left].any()
    assert tin.relevant.all() and within_outline(tin, None) is tin


def test_the_noise_of_a_height_grows_with_the_slope_squared():
    normal = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, -0.8, 0.6]])
    points = SimpleNamespace(variance=np.full(3, 4e-4), normal=normal)
    found = point_variance(SimpleNamespace(sources=SimpleNamespace(points=points)))
    np.testing.assert_allclose(found, [4e-4, 4e-4 / 0.64, 4e-4 / 0.36])


def test_the_noise_of_a_scan_turns_with_it():
    R = rotation_xyz(0.1, -0.2, 0.7)
    home = Transform(R, np.array([1.0, 2.0, 3.0]), np.zeros(3), 1.0, np.zeros((7, 7)))
    C = np.array([np.diag([1.0, 4.0, 9.0]), np.diag([2.0, 1.0, 0.5])]) * 1e-4
    points = np.array([[1.0, 0.0, 2.0], [0.0, 3.0, 1.0]])
    moved = transform_scan(Scan(points, np.zeros(3), C), SimpleNamespace(home=home))
    axis = np.array([0.0, 1.0, 0.0])  # known with 4e-4 and 1e-4 along y before, so along R y now
    found = np.einsum("i,nij,j->n", R @ axis, moved.noise, R @ axis)
    np.testing.assert_allclose(found, [4e-4, 1e-4])


def test_three_parameters_take_their_freedom_from_the_stretches_of_a_ring():
    k = 4 * STRETCHES
    scores = np.random.default_rng(2).normal(size=(k, 2))
    length = k // STRETCHES
    sums = [np.roll(scores, -s, axis=0)[:length].sum(axis=0) for s in range(k)]
    mean = np.mean([np.outer(v, v) for v in sums], axis=0)
    Q = np.array([[2.0, 0.3], [0.3, 1.0]])
    expected = Q @ mean @ Q * STRETCHES * STRETCHES / (STRETCHES - ALONG)
    np.testing.assert_allclose(sandwich(scores, Q), expected)


@pytest.mark.parametrize("alike", [0.0, 0.6, 1.0])
def test_cut_of_level_ground_has_half_the_square_of_a_common_lift_and_a_quarter_of_others(
    alike, monkeypatch
):
    """Of x with mean 0: the square of its positive part is half of it in the mean, that of half
    its size a quarter.
    """
    tin = build_tin(np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [4.0, 5.0, 0.0], [0.0, 5.0, 0.0]]))
    tau, area = 0.03, 20.0
    monkeypatch.setattr(cut_and_fill, "shared_sigma", lambda *given: np.full(4, tau))
    monkeypatch.setattr(cut_and_fill, "calibration_cross", lambda *given: np.zeros((1, 1)))
    budget = SimpleNamespace(lines={"attitude": max(alike * area * tau, 1e-9) ** 2})
    difference = SimpleNamespace(tin=tin, upper_carries=True)
    found = cut_and_fill.shared_shift_variances(None, None, difference, budget, ())
    slope = positive_part(np.zeros((1, 3)))[1].sum()
    expected = alike**2 / 2.0 + (1.0 - alike**2) / 4.0 - (alike * slope) ** 2
    np.testing.assert_allclose(found, expected * (area * tau) ** 2, rtol=1e-6)


@pytest.mark.parametrize(
    ("cut", "fill", "more", "expected"),
    [(6.0, 1.0, 0.7, (6.7, 1.0)), (1.0, 5.0, -0.7, (1.0, 5.7)), (1.0, 5.0, 0.4, (1.0, 4.6))],
)
def test_what_gaps_hold_is_cut_of_a_heap_and_fill_of_a_pit(cut, fill, more, expected):
    """more : what the net volume grows by, m³."""
    assert with_net(cut, fill, more) == pytest.approx(expected)


def test_an_attitude_that_wanders_looks_like_a_place_by_the_ratio_of_what_both_do():
    given = BudgetParameters()
    sizes = Sizes(0.02, 0.03, 0.0, 0.01, 5.0)
    bins = np.array([3, 8])
    white = np.full(2, 10.0), np.full(2, 10.0)
    found = bin_covariances(bins, 2.0, white, sizes, given)["attitude"]
    wandering = 1.0 - given.attitude_bias_fraction - given.attitude_white_fraction
    expected = (0.03 / 0.02) ** 2 * wandering * 2.0 / (3.0 * given.tau_attitude_s)
    np.testing.assert_allclose(np.diag(found)[7:13], expected)


def test_what_lies_unseen_between_points_counts_with_its_square(monkeypatch):
    volume = SimpleNamespace(sigma_m3=0.1, budget_m6={"unseen": 0.01})
    between = SimpleNamespace(unseen_m3=0.3, variance_m6=0.002)
    monkeypatch.setattr(volume_verdict, "with_lines", lambda volume, lines: lines)
    found = volume_verdict.with_between_points(volume, between)
    assert found == {"between_points": 0.002, "unseen": pytest.approx(0.01 + 0.09)}


def test_noise_of_rounded_heights_is_that_of_an_even_distribution_at_least():
    rng = np.random.default_rng(4)
    xy = rng.uniform(0.0, 30.0, (3000, 2))
    terraces = 0.01 * np.floor(xy[:, 0] / 6.0)  # of one height wherever a neighbourhood looks
    found = cloud_noise(np.column_stack([xy, terraces]))
    assert found.step_m == pytest.approx(0.01)
    assert found.sigma_m == pytest.approx(0.01 / math.sqrt(12.0), rel=1e-6)


def test_residuals_of_quadrics_have_the_size_of_the_noise():
    rng = np.random.default_rng(5)
    near = rng.normal(size=(4000, 14, 3))
    points = np.column_stack([np.zeros((4000, 2)), rng.normal(size=4000)])
    residual, _ = fit_residuals(points, near, np.arange(4000))
    spread = 1.4826 * np.median(np.abs(residual))  # of noise of 1, whatever the neighbours' places
    assert spread == pytest.approx(1.0, abs=0.05)
