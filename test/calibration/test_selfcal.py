"""Self-calibration on flights whose errors are known, made without the simulator."""

import dataclasses

import numpy as np
import pytest
from pyramid_flight import fly

from ladar_volume.calibration.flight import remap_returns
from ladar_volume.calibration.selfcal import CORRECTED, calibrate
from ladar_volume.georeference.error_budget import calibration_covariance
from ladar_volume.model.errors import CalibrationError
from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.model.survey_parameters import StripParameters

BUDGET = BudgetParameters(
    azimuth_noise_rad=0.0,
    vertical_noise_rad=0.0,
    beam_divergence_rad=0.0,
    attitude_sigma_rad=tuple(np.radians([0.002, 0.002, 0.003])),
    position_sigma_m=(0.006, 0.006, 0.009),
    boresight_sigma_rad=tuple(np.radians([0.16, 0.09, 0.27])),
    clock_sigma_s=0.02,
    position_white_fraction=0.0,
    attitude_white_fraction=0.0,
    lever_laser_sigma_m=(1e-6, 1e-6, 1e-6),
    lever_antenna_sigma_m=(1e-6, 1e-6, 1e-6),
)
PRIOR = calibration_covariance(BUDGET, 16)
BORESIGHT = np.radians([0.15, -0.09, 0.25])
OPTIONS = StripParameters(edge_m=1.2, min_points=5)


def test_boresight_to_a_hundredth_of_a_degree_and_the_clock_to_half_a_millisecond():
    nees, before, errors = [], [], []
    for seed in (1, 2, 3):
        found = calibrate(fly(BUDGET, seed, BORESIGHT, clock=0.020), BUDGET, PRIOR, OPTIONS)
        error = found.theta[[1, 2, 3, 10]] - np.append(BORESIGHT, 0.020)
        errors.append(error)
        C = found.posterior[np.ix_([1, 2, 3, 10], [1, 2, 3, 10])]
        assert (np.abs(error) < 3.5 * np.sqrt(np.diag(C))).all() and abs(error[3]) < 0.5e-3
        nees.append(error @ np.linalg.solve(C, error))
        before.append(found.before_m / found.after_m)
        assert [found.status(k) for k in (1, 2, 3, 10)] == ["estimated"] * 4 and found.status(
            4
        ) == "held at its prior"
        assert found.noise == pytest.approx(1.0, abs=0.03)
        assert found.chi2 / found.freedom == pytest.approx(1.0, abs=5 * np.sqrt(2 / found.freedom))
    assert (
        12 * 0.25 < sum(nees) < 12 * 2.6
    )  # chi-square with 12 degrees of freedom: 2.2 to 32 at 99.8 %
    assert min(before) > 3
    assert np.degrees(np.sqrt(np.mean(np.square(errors), axis=0)))[:3].max() < 0.01


def test_without_errors_the_constants_are_found_exactly():
    small = dataclasses.replace(
        BUDGET,
        range_noise_m=1e-5,
        position_sigma_m=(1e-5,) * 3,
        attitude_sigma_rad=(1e-7,) * 3,
        beam_range_sigma_m=1e-6,
        beam_vertical_sigma_rad=1e-8,
        range_bias_sigma_m=1e-6,
        lever_laser_sigma_m=(0.05, 0.05, 0.05),
    )
    lever = np.array([0.02, -0.03, 0.0])
    found = calibrate(
        fly(small, 4, BORESIGHT, lever, 0.02, errors=False, per_s=700),
        small,
        calibration_covariance(small, 16),
        OPTIONS,
    )
    assert np.degrees(np.abs(found.theta[1:4] - BORESIGHT)).max() < 1e-3
    assert found.theta[10] == pytest.approx(0.02, abs=2e-5)
    assert found.theta[4:6] == pytest.approx(lever[:2], abs=2e-3)
    assert found.status(4) == "estimated"


def test_level_ground_hardly_tells_the_heading_and_says_so():
    found = calibrate(
        fly(BUDGET, 5, BORESIGHT, slope=0.0, sway=0.0, per_s=900), BUDGET, PRIOR, OPTIONS
    )
    assert found.status(3) != "estimated"
    assert found.status(1) == "estimated"
    assert found.condition > 10


def test_the_covariance_for_the_budget():
    found = calibrate(fly(BUDGET, 6, BORESIGHT, per_s=700), BUDGET, PRIOR, OPTIONS)
    rest = np.setdiff1d(np.arange(len(PRIOR)), CORRECTED)
    C = found.C_cal
    assert found.beyond_prior == ()
    assert np.array_equal(
        C[np.ix_(rest, rest)], PRIOR[np.ix_(rest, rest)]
    )  # range bias and beams have no constant: their prior stays
    assert np.array_equal(
        C[np.ix_(CORRECTED, CORRECTED)], found.posterior[np.ix_(CORRECTED, CORRECTED)]
    )
    s = np.sqrt(np.diag(C))
    assert np.linalg.eigvalsh(C / np.outer(s, s))[0] > -1e-9
    assert (np.diag(found.posterior) <= np.diag(PRIOR) * (1 + 1e-9)).all()
    assert not found.theta[rest].any()


def test_constants_fixed_by_a_zero_sigma_stay():
    fixed = dataclasses.replace(
        BUDGET, lever_laser_sigma_m=(0.0, 0.0, 0.0), lever_antenna_sigma_m=(0.0, 0.0, 0.0)
    )
    found = calibrate(
        fly(BUDGET, 7, BORESIGHT, per_s=700), fixed, calibration_covariance(fixed, 16), OPTIONS
    )
    assert (
        not found.theta[4:10].any() and found.status(5) == "fixed" and not found.C_cal[4:10].any()
    )
    everything = np.zeros_like(PRIOR)
    with pytest.raises(CalibrationError, match="prior sigma of zero"):
        calibrate(fly(BUDGET, 7), BUDGET, everything, OPTIONS)


def test_a_correction_far_beyond_its_prior_is_named():
    sure = dataclasses.replace(BUDGET, boresight_sigma_rad=tuple(np.radians([0.01, 0.01, 0.01])))
    found = calibrate(
        fly(BUDGET, 12, np.radians([0.15, 0.0, 0.0]), per_s=700),
        sure,
        calibration_covariance(sure, 16),
        OPTIONS,
    )
    assert "boresight_x" in found.beyond_prior


def test_one_lane_is_refused():
    with pytest.raises(CalibrationError) as error:
        calibrate(fly(BUDGET, 8, courses=(0.0,)), BUDGET, PRIOR, OPTIONS)
    assert error.value.reason == "calibration_no_overlap"


def test_strips_that_tell_nothing_are_refused():
    sure = dataclasses.replace(BUDGET, boresight_sigma_rad=(1e-7,) * 3, clock_sigma_s=1e-7)
    with pytest.raises(CalibrationError) as error:
        calibrate(fly(sure, 9, per_s=700), sure, calibration_covariance(sure, 16), OPTIONS)
    assert error.value.reason == "calibration_unobservable"


def test_the_order_of_returns_does_not_matter():
    # the same returns in another order: sums differ by rounding alone
    flight = fly(BUDGET, 10, BORESIGHT, per_s=600)
    order = np.random.default_rng(1).permutation(len(flight.t_ns))
    other = dataclasses.replace(
        flight, t_ns=flight.t_ns[order], r_laser=flight.r_laser[order], ring=flight.ring[order]
    )
    a, b = (calibrate(f, BUDGET, PRIOR, OPTIONS) for f in (flight, other))
    assert a.theta == pytest.approx(b.theta, abs=1e-9) and a.posterior == pytest.approx(
        b.posterior, rel=1e-6, abs=1e-20
    )


def test_what_moved_between_the_strips_is_left_out_and_counted():
    flight = fly(BUDGET, 11, BORESIGHT, per_s=700)
    points, _, index = remap_returns(
        flight, np.append([0.0], np.append(BORESIGHT, np.zeros(39))), np.zeros(3)
    )
    lane = (flight.t_ns[index] - flight.t_ns.min()) // 13_000_000_000
    parked = (lane == 1) & (np.abs(points.r_map[:, 0] - 10) < 2) & (np.abs(points.r_map[:, 1]) < 2)
    r = flight.r_laser.copy()
    r[index[parked]] *= 0.993  # 15 cm high, in one lane only
    found = calibrate(dataclasses.replace(flight, r_laser=r), BUDGET, PRIOR, OPTIONS)
    error = found.theta[1:4] - BORESIGHT
    assert parked.sum() > 50 and found.moved_patches >= 1
    assert (np.abs(error) < 3.5 * np.sqrt(np.diag(found.posterior)[1:4])).all()
