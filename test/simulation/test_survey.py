"""The simulated scanner, its platform and errors; recordings with nothing of the truth in them."""

import dataclasses
import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ladar_volume.io.bags import BagReader
from ladar_volume.io.cloud_messages import returns_from_cloud
from ladar_volume.model.errors import OutputError, SimulationError
from ladar_volume.model.losses import Losses
from ladar_volume.model.parameters import BudgetParameters, GeoreferenceParameters
from ladar_volume.model.survey_parameters import SurveyParameters
from ladar_volume.simulation import velodyne
from ladar_volume.simulation.bag import write_bag
from ladar_volume.simulation.drawn_errors import draw_errors
from ladar_volume.simulation.platforms import make_platform
from ladar_volume.simulation.scenes import make_scene
from ladar_volume.simulation.survey import EPOCH_NS, Survey

BAGS = Path(__file__).parents[2] / "bags"
ZERO = {
    f.name: (0.0, 0.0, 0.0) if isinstance(f.default, tuple) else 0.0
    for f in dataclasses.fields(BudgetParameters)
    if "sigma" in f.name or "noise" in f.name or "divergence" in f.name
}


def test_firing_pattern_is_the_vlp_16s():
    f = velodyne.sweep(0.0, 1)
    assert len(f.time_s) == 16 * 1808
    assert np.diff(f.time_s[:16]) == pytest.approx(2.304e-6) and f.time_s[16] - f.time_s[
        0
    ] == pytest.approx(55.296e-6)
    assert np.degrees(f.elevation[:4]).tolist() == pytest.approx([-15, 1, -13, 3])
    assert f.ring[:4].tolist() == [
        0,
        8,
        1,
        9,
    ]  # the driver's ring numbers count elevations from below
    assert np.degrees(f.azimuth[16] - f.azimuth[0]) == pytest.approx(-0.199, abs=1e-3)
    assert len(velodyne.sweep(0.0, 6).time_s) == 16 * 302


def test_drawn_errors_have_their_variance_and_correlation():
    t = np.arange(0, 4000, 0.5)
    rng = np.random.default_rng(8)
    sigma = np.array([2.0, 0.5])
    markov = np.stack([draw_errors(t, sigma, 0.0, 0.0, 20.0, rng).total for _ in range(20)])
    assert markov.std(axis=(0, 1)) == pytest.approx(sigma, rel=0.06)
    lag = 40  # 20 s: one correlation time
    r = np.mean(markov[:, :-lag] * markov[:, lag:]) / np.mean(markov**2)
    assert r == pytest.approx(np.exp(-1), abs=0.06)
    bias = np.stack([draw_errors(t[:50], sigma, 1.0, 0.0, 20.0, rng).total for _ in range(2000)])
    assert np.ptp(bias, axis=1).max() == 0.0 and bias[:, 0].std(axis=0) == pytest.approx(
        sigma, rel=0.06
    )


def _flawless(platform, seed=1, **options):
    scene = make_scene("cone")
    budget = BudgetParameters(**ZERO)
    return Survey(
        scene,
        make_platform(platform, scene.extent_m, 20.0),
        budget,
        SurveyParameters(0.4, 12, mixed_share=0.0, seed=seed, **options),
    )


@pytest.mark.parametrize("platform", ["uav", "rover"])
def test_an_error_free_survey_lies_on_the_scene(platform):
    survey = _flawless(platform)
    height = 10.0 * np.tan(np.radians(35.0))
    nominal = Rotation.from_euler("ZYX", np.radians(survey.platform.boresight_deg[::-1]))
    count = 0
    for sweep in survey.sweeps():
        t = (sweep.stamp_ns - EPOCH_NS) * 1e-9 + sweep.time_s.astype(float)
        body = nominal.apply(sweep.xyz.astype(float)) + survey.platform.lever_laser_m
        r = survey.platform.position(t) + survey.platform.rotation(t).apply(body)
        surface = np.maximum(0.0, height * (1.0 - np.hypot(r[:, 0], r[:, 1]) / 10.0))
        # ranges are reported in 2 mm steps; vertical error is at most that of the slant range
        assert np.abs(r[:, 2] - surface).max() < 2.5e-3
        count += len(r)
    assert count > 500


def test_the_seed_decides_everything_and_outages_show():
    first, again, other = (_flawless("uav", seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(next(first.sweeps()).xyz, next(again.sweeps()).xyz)
    assert not np.array_equal(next(first.sweeps()).time_s, next(other.sweeps()).time_s)
    status = _flawless("uav", outages_s=((0.0, 0.2),), float_spans_s=((0.2, 0.3),)).fixes()[3]
    assert {-1, 0, 2} <= set(status.tolist())
    with pytest.raises(SimulationError, match="no platform"):
        make_platform("submarine", 10.0, 10.0)


def test_a_recording_says_nothing_of_the_truth(tmp_path):
    scene = make_scene("cone")
    survey = Survey(
        scene,
        make_platform("uav", scene.extent_m, 20.0),
        BudgetParameters(),
        SurveyParameters(0.5, 20, seed=3),
    )
    write_bag(survey, tmp_path / "bag", {"filter": {"radius_m": 0.5}}, lambda share: None)
    truth = json.loads((tmp_path / "bag" / "truth.json").read_text())
    assert truth["volume_m3"] == scene.volume_m3
    text = (tmp_path / "bag" / "config.yaml").read_text()
    assert f"{scene.volume_m3:.2f}" not in text and str(truth["lever_laser_m"][0]) not in text
    with BagReader(tmp_path / "bag") as bag:
        assert set(bag.topics()) == {"velodyne_points", "gnss/fix", "imu/data"}
        cloud = next(bag.message(r) for r in bag.raw({"velodyne_points"}))
        assert [f.name for f in cloud.fields] == ["x", "y", "z", "intensity", "ring", "time"]
        returns = returns_from_cloud(cloud, GeoreferenceParameters(), Losses())
        assert np.all(np.diff(returns.t_ns) >= 0)
    with pytest.raises(OutputError, match="exists already"):
        write_bag(survey, tmp_path / "bag", {}, lambda share: None)


@pytest.mark.parametrize("name", ["stockpile", "box", "leo_cut"])
def test_bundled_recordings_are_small_and_as_described(name):
    file = BAGS / name / f"{name}.mcap"
    assert file.stat().st_size < 15e6
    assert hashlib.sha256(file.read_bytes()).hexdigest() in (BAGS / "README.md").read_text()


def test_defaults_are_those_of_the_sensor():
    assert SurveyParameters().range_step_m == velodyne.RANGE_STEP_M
    assert SurveyParameters(velodyne.TURN_S).duration_s == velodyne.TURN_S
