"""Volumes of clouds with stray points, open outlines, scan lines and rounding, through the door: a
result is within three sigma of the truth, or it says why it is not.
"""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from ladar_volume.cli.main import main
from ladar_volume.cli.verdict_lines import DOUBTFUL
from ladar_volume.clouds.cloud_cleaning import clean
from ladar_volume.clouds.cloud_noise import cloud_noise, rounding_step
from ladar_volume.clouds.cloud_surface import cloud_surface
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.tin.sampled_area import sampled_area


@pytest.fixture
def volume(tmp_path, capsys):
    def call(points, *words, code=0):
        np.save(tmp_path / "c.npy", points)
        assert main(["volume", str(tmp_path / "c.npy"), *map(str, words), "--json"]) == code
        return json.loads(capsys.readouterr().out)

    return call


def names(facts):
    return [reason["name"] for reason in facts["verdict"]["reasons"]]


def with_strays(points, share, low, high, rng, beyond=1.1):
    count = int(share * len(points))
    half = beyond * np.abs(points[:, :2]).max(axis=0)
    xy = rng.uniform(-half, half, (count, 2))
    return np.r_[points, np.c_[xy, rng.uniform(low, high, count)]]


def box(seed):
    rng = np.random.default_rng(seed)
    half, sigma = rng.uniform(2.0, 3.0), rng.choice([0.002, 0.005])
    xy = rng.uniform(-half, half, (6000, 2))
    top = (np.abs(xy[:, 0]) < 0.6) & (np.abs(xy[:, 1]) < 0.4)
    p = np.c_[xy, np.where(top, 0.5, 0.0)] + sigma * rng.normal(size=(6000, 3))
    return with_strays(p, rng.uniform(0.003, 0.03), -rng.choice([0, 0.5]), 2.0, rng), 0.48


def pile(seed):
    rng = np.random.default_rng(seed)
    radius, height = rng.uniform(3, 5), rng.uniform(1, 2)
    xy = rng.uniform(-9, 9, (6000, 2))
    z = np.maximum(0.0, height * (1.0 - np.hypot(*xy.T) / radius)) + 0.03 * xy[:, 0]
    p = np.c_[xy, z + 0.02 * rng.normal(size=6000)]
    truth = math.pi * radius**2 * height / 3.0
    return with_strays(p, rng.uniform(0.003, 0.03), -1.0, 2 * height, rng), truth


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("scene", [box, pile])
def test_strays_are_neither_ground_nor_body(scene, seed, volume):
    points, truth = scene(seed)
    facts = volume(points, "--base", "ground")
    assert abs(facts["net_m3"] - truth) < 3.0 * facts["sigma_m3"] or names(facts)
    # the bar must not be bought with a sigma that holds anything
    assert facts["sigma_m3"] < 0.05 * truth and abs(facts["net_m3"] - truth) < 0.06 * truth
    assert facts["clean"]["strays"] > 0
    low, high = np.array(facts["outline_parts"][0]["extent_m"]).reshape(2, 2)
    added = points[6000:, :2]
    if ((added > low + 0.2) & (added < high - 0.2)).all(axis=1).any():
        assert facts["clean"]["effect_m3"] != 0.0
    assert len(facts["outline_parts"]) == 1 and abs(facts["outline_parts"][0]["x_m"]) < 0.3
    assert sum(facts["budget_m6"].values()) == pytest.approx(facts["sigma_m3"] ** 2, rel=1e-9)


def test_a_clean_cloud_loses_nothing(volume):
    points, _ = box(50)
    own = points[:6000]
    kept = clean(own)
    assert len(kept.strays) <= 6
    off = volume(points, "--base", "ground", "--clean", "off")
    assert off["clean"] == {
        "how": "off", "strays": 0, "share": 0.0, "effect_m3": None
    }  # fmt: skip


def test_many_strays_are_a_doubt_and_strict_says_so(volume):
    rng = np.random.default_rng(3)
    points = with_strays(box(7)[0][:6000], 0.08, 0.0, 3.0, rng)
    facts = volume(points, "--base", "ground", "--strict", code=DOUBTFUL)
    assert "outliers" in names(facts) and "%" in facts["verdict"]["reasons"][0]["text"]


def site(kind, rng, scale):
    x, y = xy = rng.uniform(0, 10, (2, 6000))
    if kind == "L":
        keep, area = (x < 4) | (y < 4), 64.0
    elif kind == "U":
        keep, area = (y < 3) | (x < 3) | (x > 7), 72.0
    elif kind == "notch":
        keep, area = ~((y > 5) & (np.abs(x - 5) < 1)), 90.0
    else:
        far = np.hypot(x - 5, y - 5)
        keep, area = (far < 5) & (far > 2.5), math.pi * (25 - 6.25)
    a = rng.uniform(0, 6)
    turn = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
    p = np.c_[xy.T[keep] @ turn, 1.0 + 0.01 * rng.normal(size=np.count_nonzero(keep))]
    return scale * p, scale**2 * area


@pytest.mark.parametrize("kind", ["L", "U", "notch", "ring"])
def test_the_hull_is_not_the_boundary(kind, volume):
    for seed, scale in enumerate((0.03, 50.0)):
        points, area = site(kind, np.random.default_rng(seed), scale)
        facts = volume(points, "--level", 0)
        sampled = facts["surfaces"][0]["sampled"]
        if kind == "ring":  # an enclosed hole is bridged, and named
            assert sampled["holes"] == 1 and "unseen" in names(facts)
            assert sampled["area_m2"] - sampled["hole_m2"] == pytest.approx(area, rel=0.05)
            continue
        assert facts["net_m3"] == pytest.approx(scale * area, rel=0.03)
        assert sampled["area_m2"] == pytest.approx(facts["area_m2"], rel=1e-9)
        assert sampled["hull_m2"] > 1.09 * area and sampled["holes"] == 0
        hull = volume(points, "--level", 0, "--relevant", "corners")
        assert hull["area_m2"] == pytest.approx(sampled["hull_m2"], rel=1e-9)
        assert hull["surfaces"][0]["sampled"] is None


def test_a_partial_tin_counts_where_points_are():
    points, area = site("U", np.random.default_rng(4), 1.0)
    made = cloud_surface(points, SurfaceParameters(ratio=0.3, relevant="sampled")).representation
    p = made.tin.vertices[made.tin.triangles[made.tin.relevant], :2]
    d, e = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    assert 0.5 * (d[:, 0] * e[:, 1] - d[:, 1] * e[:, 0]).sum() == pytest.approx(area, rel=0.05)


def rings(seed, stations=4, sigma=0.01):
    """Sixteen rings from scanners 3 m above a level, noise along the beam."""
    rng, out = np.random.default_rng(seed), []
    for k in range(stations):
        place = np.array([6.0 * math.cos(1.6 * k), 6.0 * math.sin(1.6 * k), 3.0])
        el, az = np.meshgrid(np.radians(np.arange(-15, 0, 2.0)), np.radians(np.arange(0, 360, 0.4)))
        el, az = el.ravel(), az.ravel()
        beam = np.c_[np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)]
        r = -3.0 / beam[:, 2]
        near = r < 30.0
        out.append(place + (r + sigma * rng.normal(size=len(r)))[near, None] * beam[near])
    return np.concatenate(out)


@pytest.mark.parametrize("stations", [1, 4])
def test_noise_across_rings_is_not_zero(stations):
    points = rings(stations, stations)
    true = 1.4826 * np.median(np.abs(points[:, 2]))
    found = cloud_noise(points)
    assert 0.8 < found.sigma_m / true < 1.25 and found.on_lines > 0.2
    # whole rings are surface: nothing goes, and no strip between them is a gap
    assert len(clean(points).strays) < 0.002 * len(points)
    area = sampled_area(build_tin(points))
    assert area.area_m2 > 0.99 * area.hull_m2 and area.parts == 1


@pytest.mark.parametrize("step,sigma", [(0.01, 0.005), (0.005, 0.003), (0.01, 0.001), (0.1, 0.001)])
def test_rounding_and_copies_leave_the_noise(step, sigma):
    rng = np.random.default_rng(8)
    xy = rng.uniform(0, 10, (6000, 2))
    p = step * np.round(np.c_[xy, 0.2 * np.sin(xy[:, 0]) + sigma * rng.normal(size=6000)] / step)
    floor = step / math.sqrt(12.0)
    found = cloud_noise(p)
    assert found.step_m == pytest.approx(step, rel=1e-6) and found.sigma_m >= floor * (1 - 1e-9)
    assert found.sigma_m == pytest.approx(math.hypot(sigma, floor), rel=0.3 if step < 0.1 else 0.6)
    thrice = cloud_noise(np.r_[p, p, p])
    assert thrice.sigma_m == found.sigma_m
    assert rounding_step(p[:, 2] + 0.5 * sigma * rng.normal(size=6000)) == 0.0
    one, three = (cloud_surface(q, SurfaceParameters(ratio=1.0)) for q in (p, np.r_[p, p, p]))
    assert np.array_equal(one.points, three.points) and three.copies == one.copies + 12000


def test_a_ground_that_is_no_plane_is_doubtful_or_refused(volume, tmp_path, capsys):
    rng = np.random.default_rng(9)
    xy = rng.uniform(-20, 20, (5000, 2))
    z = 0.3 * np.sin(xy[:, 0] / 4) * np.cos(xy[:, 1] / 5) + 0.02 * rng.normal(size=5000)
    z += np.maximum(0.0, 3.0 * (1.0 - np.hypot(*xy.T) / 5.0))
    facts = volume(
        np.c_[xy, z], "--base", "ground", "--set", "volume.object_height_m=0.6"
    )  # fmt: skip
    assert facts["verdict"]["status"] == "doubtful" and facts["readings"]["uneven_m"] > 0.02
    # in a bowl everything rises above the plane through its bottom
    z = 0.006 * (xy**2).sum(axis=1) + np.maximum(0.0, 3.0 * (1.0 - np.hypot(*xy.T) / 5.0))
    np.save(tmp_path / "bowl.npy", np.c_[xy, z + 0.02 * rng.normal(size=5000)])
    words = ["volume", str(tmp_path / "bowl.npy"), "--base", "ground", "--json"]
    code = main(words)
    out = capsys.readouterr()
    assert (code == 2 and "--level" in out.err) or json.loads(out.out)["verdict"]["reasons"]


def test_what_a_centimetre_means_is_said(volume, tmp_path, capsys):
    points, _ = site("L", np.random.default_rng(10), 10.0)
    facts = volume(points, "--level", 5)
    assert facts["centimetre_m3"] == pytest.approx(0.01 * facts["area_m2"])
    assert main(["volume", str(tmp_path / "c.npy"), "--level", "5"]) == 0
    shown = capsys.readouterr().out
    assert "noise only" in shown and "1 cm of height" in shown and "verdict" in shown
    assert "convex hull" in shown and "sound" in shown
