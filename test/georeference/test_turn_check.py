"""Turns that LiDAR and attitudes both see tell an offset of the stamps from messages that are late,
on simulated flights and on a real rover; where they do not tell, nothing is said.
"""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ladar_volume.georeference.georeferencer import mounting
from ladar_volume.georeference.sweep_turns import CELL_RAD, CELLS, misfit_by_shift, sweep_image
from ladar_volume.georeference.turn_check import PAIRS, TurnLag, Turns, best_lag, turn_from
from ladar_volume.io.bags import BagReader
from ladar_volume.io.cloud_messages import returns_from_cloud
from ladar_volume.io.config import read_config
from ladar_volume.io.sensor_messages import imu_from_message
from ladar_volume.model.losses import Losses
from ladar_volume.model.records import Returns

ROOT = Path(__file__).parents[2]
REAL = ROOT.parent / "shared/data/leo_rover/leo_bag.mcap"
S = 10**9


def recorded(path, config, seconds):
    """The begin of a recording: its mounting, clouds and attitudes."""
    p = read_config(config)
    clouds, attitudes = [], []
    with BagReader(path) as bag:
        roles = {topic: role for role, topic in bag.roles().items()}
        for raw in bag.raw({t for t, r in roles.items() if r in ("cloud", "imu")}):
            if raw.t_ns > bag.start_ns + seconds * S:
                break
            message = bag.message(raw)
            if roles[raw.topic] == "cloud":
                clouds.append(returns_from_cloud(message, p.georeference, Losses()))
            else:
                attitudes.append(imu_from_message(message))
    return mounting(p.calibration, "gnss_imu").R_body_laser, clouds, attitudes


def turns_of(survey):
    """The turns that a survey's sweeps saw."""
    R, clouds, _ = survey
    turns = Turns(R)
    for cloud in clouds:
        turns.add_sweep(cloud)
    return turns


@pytest.fixture(scope="module")
def box():
    survey = recorded(ROOT / "bags/box", ROOT / "bags/box/config.yaml", 13.0)
    return survey, turns_of(survey)


def lag_of(survey, turns, attitudes, late_s=0.0):
    """What the turns tell beside attitudes whose stamps are late by late_s."""
    both = Turns(survey[0])
    for sample in attitudes:
        both.add_attitude(sample.t_ns - round(late_s * S), sample.q_map_body)
    apart = (int(survey[1][0].t_ns.mean()) - attitudes[0].t_ns) * 1e-9 + late_s
    both.pairs.extend((a + apart, b + apart, turn) for a, b, turn in turns.pairs)
    return both.lag()


def test_an_offset_of_the_stamps_is_seen_in_the_turns_and_none_is_none(box):
    survey, turns = box
    for late_s in (0.0, 1.4, -0.3):
        lag = lag_of(survey, turns, survey[2], late_s)
        assert lag is not None and lag.pairs > PAIRS
        assert abs(lag.lag_s + late_s) < 3.0 * lag.sigma_s < 0.1


def test_turns_of_another_flight_and_no_turns_say_nothing(box):
    survey, turns = box
    rng = np.random.default_rng(4)
    steps = np.cumsum(rng.normal(0.0, 0.002, (len(survey[2]), 3)), axis=0)
    other = [
        dataclasses.replace(a, q_map_body=Rotation.from_rotvec(v).as_quat())
        for a, v in zip(survey[2], steps, strict=True)
    ]
    assert lag_of(survey, turns, other) is None
    still = [dataclasses.replace(a, q_map_body=np.array([0.0, 0.0, 0.0, 1.0])) for a in survey[2]]
    assert lag_of(survey, turns, still) is None


@pytest.mark.skipif(not REAL.exists(), reason="real recordings are not here")
def test_a_real_rovers_stamps_agree_and_two_seconds_are_found():
    survey = recorded(REAL, ROOT / "bags/leo_cut/config.yaml", 60.0)
    turns = turns_of(survey)
    for late_s in (0.0, 2.0):
        lag = lag_of(survey, turns, survey[2], late_s)
        assert lag is not None and abs(lag.lag_s + late_s) < 3.0 * lag.sigma_s < 0.1


def test_turn_between_attitudes_is_that_of_rotation_matrices():
    rng = np.random.default_rng(2)
    for _ in range(50):
        a, step = Rotation.random(random_state=rng), Rotation.from_rotvec(rng.normal(0, 0.4, 3))
        b = a * step
        for sign in (1.0, -1.0):  # both quaternions of an attitude
            found = turn_from(tuple(a.as_quat()), tuple(sign * b.as_quat()))
            np.testing.assert_allclose(found, step.as_rotvec(), atol=1e-12)
    assert turn_from((0, 0, 0, 1), (0, 0, 0, 1)) == (0.0, 0.0, 0.0)


def test_misfit_by_shift_is_the_sum_over_cells_that_both_have():
    rng = np.random.default_rng(5)
    n = 4000
    azimuth = rng.uniform(-np.pi, np.pi, n)
    r = rng.uniform(2.0, 9.0, (n, 1)) * np.column_stack(
        [np.cos(azimuth), np.sin(azimuth), 0 * azimuth]
    )
    rings = rng.integers(0, 3, n).astype(np.uint16)
    one, two = (
        sweep_image(Returns(np.arange(len(k)), r[k], rings[k], np.ones(len(k), np.float32)), 0.0)
        for k in (np.arange(n), np.flatnonzero(azimuth > -1.0))
    )
    misfit, common = misfit_by_shift(one, two)
    for shift in (0, 7, CELLS - 30):
        moved = np.roll(two.log_range, -shift, axis=1), np.roll(two.seen, -shift, axis=1)
        both = one.seen * moved[1]
        assert common[shift] == pytest.approx(both.sum(), abs=1e-6)
        assert misfit[shift] == pytest.approx((both * (one.log_range - moved[0]) ** 2).sum())


@pytest.mark.parametrize("seed", range(3))
def test_sigma_of_a_lag_is_its_scatter(seed):
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 70.0, 0.01)
    rate = np.convolve(rng.normal(0.0, 4.0, len(t)), np.ones(80) / 80, "same")
    angle = np.cumsum(rate) * 0.01
    first = np.arange(5.0, 65.0, 0.1)
    times = np.column_stack([first, first + 0.1])
    errors = []
    for _ in range(15):
        true = rng.uniform(-2.0, 2.0)
        a, b = np.interp(times.T + true, t, angle)
        lag = best_lag(times, b - a + rng.normal(0.0, 0.004, len(a)), t, angle)
        assert isinstance(lag, TurnLag)
        errors.append((lag.lag_s - true) / lag.sigma_s)
    assert np.sqrt(np.mean(np.square(errors))) < 1.3
    assert CELLS * CELL_RAD == pytest.approx(2 * np.pi)
