"""Two layers of points are told from noise of one, whatever its shape."""

from __future__ import annotations

import json

import numpy as np
import pytest

from ladar_volume.cli.main import main
from ladar_volume.clouds.sampling.layers import Layers, layer_doubts, two_layers
from ladar_volume.io.pointfiles.cloud_files import write_cloud

SIGMA_M = 0.01
NOISES = {
    "normal": lambda rng, n: rng.normal(0.0, SIGMA_M, n),
    "even": lambda rng, n: rng.uniform(-2.0 * SIGMA_M, 2.0 * SIGMA_M, n),
    "heavy tails": lambda rng, n: SIGMA_M * rng.standard_t(3, n),
    "grass": lambda rng, n: rng.gamma(2.0, 3.0 * SIGMA_M, n),
}


def mound(rng, count=12_000):
    xy = rng.uniform(-10.0, 10.0, (count, 2))
    return np.c_[xy, np.maximum(0.0, 3.0 - 0.4 * np.hypot(*xy.T))]


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("count", [1500, 12_000])
def test_noise_of_one_layer_is_one(noise, count):
    rng = np.random.default_rng(5)
    r = mound(rng, count)
    r[:, 2] += NOISES[noise](rng, count)
    assert two_layers(r, np.arange(count)).share < 0.05


@pytest.mark.parametrize("step_m", [0.02, 0.25])
def test_rounded_heights_are_one(step_m):
    rng = np.random.default_rng(6)
    r = mound(rng)
    r[:, 2] = np.round((r[:, 2] + rng.normal(0.0, SIGMA_M, len(r))) / step_m) * step_m
    assert two_layers(r, np.arange(len(r))) == Layers(0.0, 0.0)


@pytest.mark.parametrize("apart", [6.0, 20.0, 300.0])
def test_two_layers_are_told_with_their_distance_and_where_they_are(apart):
    rng = np.random.default_rng(7)
    r = mound(rng)
    r[:, 2] += rng.normal(0.0, SIGMA_M, len(r))
    half = (r[:, 0] > 0.0) & (rng.random(len(r)) < 0.5)
    r[half, 2] += apart * SIGMA_M
    found = two_layers(r, np.arange(len(r)))
    assert found.share == pytest.approx(0.5, abs=0.08)
    assert found.apart_m == pytest.approx(apart * SIGMA_M, rel=0.1)
    doubts, more = layer_doubts(found, 400.0, 0.1)
    assert doubts[0].name == "layers" and more == pytest.approx(apart, rel=0.3)
    assert layer_doubts(found, 400.0, 1e6) == ([], 0.0)


def told(capsys, path, *words):
    assert main(["volume", str(path), "--units", "m", "--json", *words]) == 0
    facts = json.loads(capsys.readouterr().out)
    return facts, {d["name"] for d in facts["verdict"]["reasons"]}


def test_strips_that_do_not_fit_are_in_sigma_above_a_level_alone(tmp_path, capsys):
    rng = np.random.default_rng(8)
    r = mound(rng)
    r[:, 2] += rng.normal(0.0, SIGMA_M, len(r))
    true_m3 = np.pi * 7.5**2 * 3.0 / 3.0
    r[rng.random(len(r)) < 0.5, 2] += 0.08
    write_cloud(tmp_path / "strips.ply", r, None)
    level, names = told(capsys, tmp_path / "strips.ply", "--level", "0")
    assert "layers" in names and abs(level["net_m3"] - true_m3) < 1.5 * level["sigma_m3"]
    assert level["budget_m6"]["layers"] == pytest.approx(
        (0.5 * 0.08 * level["area_m2"]) ** 2, rel=0.2
    )
    ground, names = told(capsys, tmp_path / "strips.ply")
    assert "layers" not in names and abs(ground["net_m3"] - true_m3) < 3.0 * ground["sigma_m3"]
