"""``ladar_volume epochs`` on point clouds: change, map, registration by what did not change."""

from __future__ import annotations

import json
import math

import laspy
import numpy as np
import pytest

from ladar_volume.cli.main import main
from ladar_volume.io.meshfiles.mesh_files import read_mesh
from ladar_volume.math.se3 import exp_so3

#: Slope of the piles.
STEEP = 0.6


def truth(height):
    """Volume, m³, of a pile."""
    return math.pi * (height / STEEP) ** 2 * height / 3.0


def cloud(path, height, seed, turn=(0.0, 0.0, 0.0), shift=(0.0, 0.0, 0.0), noise=0.01):
    """A pile on ground with shape, moved."""
    rng = np.random.default_rng(seed)
    x, y = xy = rng.uniform(-16.0, 16.0, (2, 9000))
    z = 0.3 * np.sin(x / 3.0) * np.cos(y / 4.0) + 0.03 * x
    z += np.maximum(0.0, height - STEEP * np.hypot(x - 2.0, y + 1.0))
    r = np.c_[xy.T, z] @ exp_so3(np.array(turn)).T + np.array(shift)
    r[:, 2] += rng.normal(0.0, noise, len(r))
    np.savetxt(path, r + np.array([500_000.0, 5_400_000.0, 100.0]), fmt="%.5f")
    return path


@pytest.fixture
def epochs(tmp_path, capsys):
    def call(*words, code=0):
        given = ["epochs", *map(str, words), "--units", "m", "-o", str(tmp_path / "out"), "--json"]
        assert main(given) == code
        shown = capsys.readouterr()
        return json.loads(shown.out) if code in (0, 3) else shown.err

    return call


def names(facts):
    return [reason["name"] for reason in facts["verdict"]["reasons"]]


def test_the_change_of_a_pile_and_its_map(tmp_path, epochs):
    a, b = cloud(tmp_path / "a.xyz", 2.5, 1), cloud(tmp_path / "b.xyz", 2.0, 2)
    facts = epochs(a, b)
    change = truth(2.0) - truth(2.5)
    assert abs(facts["volume_m3"] - change) < 3.0 * facts["sigma_m3"] < 0.05 * abs(change)
    assert facts["significant"] and facts["verdict"]["status"] == "sound"
    kept = facts["level_of_detection"]
    assert kept["net_m3"] == pytest.approx(change, rel=0.05) and 0.01 < kept["level_m"] < 0.05
    # what the threshold took is what the whole has more
    assert kept["net_m3"] - kept["bias_m3"] == pytest.approx(facts["volume_m3"], abs=0.2)
    assert facts["stable_ground"]["share"] > 0.5 and not facts["stable_ground"]["named"]
    out = tmp_path / "out"
    assert {p.name for p in out.iterdir()} == {"epochs.json", "change.ply", "change.png"}
    columns = read_mesh(out / "change.ply", None).columns
    there = np.isfinite(columns["difference_m"])
    assert (columns["significant"][there] == (
        np.abs(columns["difference_m"]) > columns["level_m"])[there]).mean() > 0.999  # fmt: skip


def test_unchanged_ground_has_no_change(tmp_path, epochs):
    facts = epochs(cloud(tmp_path / "a.xyz", 2.0, 3), cloud(tmp_path / "b.xyz", 2.0, 4))
    assert (
        abs(facts["z"]) < 3.0 and facts["level_of_detection"]["area_m2"] < 0.12 * facts["area_m2"]
    )
    assert facts["verdict"]["status"] == "sound"


def test_a_moved_cloud_is_doubtful_and_laid_back(tmp_path, epochs):
    a = cloud(tmp_path / "a.xyz", 2.2, 5)
    b = cloud(tmp_path / "b.xyz", 2.6, 6, (0.001, -0.002, 0.004), (0.06, -0.09, 0.07))
    change = truth(2.6) - truth(2.2)
    assert "offset" in names(epochs(a, b))
    facts = epochs(a, b, "--register", "icp")
    assert abs(facts["volume_m3"] - change) < 3.0 * facts["sigma_m3"] < 1.5
    assert facts["budget_m6"]["transform"] > 0.0 and facts["verdict"]["status"] == "sound"
    assert facts["registration"]["lift_m"] == pytest.approx(-0.07, abs=0.02)
    facts = epochs(a, cloud(tmp_path / "c.xyz", 2.6, 7, shift=(0, 0, 0.3)), "--register", "height")
    assert abs(facts["volume_m3"] - change) < 3.0 * facts["sigma_m3"] < 3.0
    assert facts["registration"]["lift_m"] == pytest.approx(-0.3, abs=0.003)


def test_a_pile_that_grew_does_not_draw_the_cloud(tmp_path, epochs):
    """Its flank is steep, the ground nearly level: pairs on the flank, a quarter metre off, would
    move the cloud by as much.
    """
    a, b = tmp_path / "a.xyz", tmp_path / "b.xyz"
    cloud(a, 2.22, 8, noise=0.02), cloud(b, 2.47, 9, shift=(0.05, -0.1, 0.09), noise=0.02)
    facts = epochs(a, b, "--register", "icp", "--no-figure")
    assert abs(facts["volume_m3"] - truth(2.47) + truth(2.22)) < 3.0 * facts["sigma_m3"] < 2.0


def test_stable_ground_and_polygon_are_taken(tmp_path, epochs):
    a = cloud(tmp_path / "a.xyz", 2.5, 10)
    b = cloud(tmp_path / "b.xyz", 2.0, 11, shift=(0.0, 0.0, 0.1))

    def corners(x0, y0, x1, y1):
        ring = ((x0, y0), (x1, y0), (x1, y1), (x0, y1))
        return [f"{500_000 + x},{5_400_000 + y}" for x, y in ring]

    named = ("--stable", *corners(-15, -15, -5, 15))
    facts = epochs(a, b, *named)
    assert facts["stable_ground"]["named"] and "offset" in names(facts)
    assert facts["stable_ground"]["offset_m"] == pytest.approx(0.1, abs=0.01)
    around = ("--polygon", *corners(-4, -7, 8, 5))
    facts = epochs(a, b, *named, *around, "--register", "height")
    assert facts["area_m2"] == pytest.approx(144.0, rel=0.05)
    change = truth(2.0) - truth(2.5)
    assert abs(facts["volume_m3"] - change) < 3.0 * facts["sigma_m3"] < 2.0
    # on ground that is named no other is asked, however much of it changed
    moved = cloud(tmp_path / "m.xyz", 2.9, 12, (0.001, 0.0, 0.002), (0.05, 0.04, 0.1))
    facts = epochs(a, moved, "--stable", *corners(-15, -15, -3, 15), "--register", "icp")
    change = truth(2.9) - truth(2.5)
    assert facts["registration"]["pairs"] < 4000
    assert abs(facts["volume_m3"] - change) < 3.0 * facts["sigma_m3"] < 5.0
    assert "no such file" in epochs(a, tmp_path / "none.laz", code=2)
    assert "replay" not in epochs(a, tmp_path / "none.laz", code=2)
    assert "too little of the stable ground" in epochs(
        a, b, "--stable", *corners(0, 0, 1, 1), code=2
    )


def test_level_ground_is_lifted_and_not_turned(tmp_path, epochs):
    rng = np.random.default_rng(12)
    for name, lift in (("a", 0.0), ("b", 0.05)):
        xy = rng.uniform(0.0, 20.0, (4000, 2))
        rise = 0.5 * (np.hypot(*(xy - 10.0).T) < 3.0) * (name == "b")
        np.savetxt(tmp_path / f"{name}.xyz", np.c_[xy, rise + lift + rng.normal(0, 0.01, 4000)])
    a, b = tmp_path / "a.xyz", tmp_path / "b.xyz"
    assert "--register height lifts alone" in epochs(a, b, "--register", "icp", code=2)
    facts = epochs(a, b, "--register", "height")
    assert abs(facts["volume_m3"] - 0.5 * math.pi * 9.0) < 3.0 * facts["sigma_m3"]


def test_clouds_with_heights_in_unlike_units_are_doubtful(tmp_path, epochs):
    rng = np.random.default_rng(15)
    for name, size in (("m", 1.0), ("mm", 1000.0)):
        xy = rng.uniform(0.0, 20.0, (4000, 2))
        z = 50.0 + 0.1 * xy[:, 0] + rng.normal(0.0, 0.01, 4000)
        np.savetxt(tmp_path / f"{name}.xyz", np.c_[xy, size * z])
    facts = epochs(tmp_path / "m.xyz", tmp_path / "mm.xyz", "--no-figure")
    assert "apart" in names(facts)


def test_what_does_not_go_together_is_refused(tmp_path, epochs):
    a, b = cloud(tmp_path / "a.xyz", 1.0, 13), cloud(tmp_path / "b.xyz", 1.0, 14)
    (tmp_path / "bag").mkdir()
    assert "compare two of a kind" in epochs(a, tmp_path / "bag", code=2)
    assert "--separate is for surveys" in epochs(a, b, "--separate", "all", code=2)
    assert "--reach belongs to" in epochs(a, b, "--reach", "2", code=2)
    far = tmp_path / "far.xyz"
    np.savetxt(far, np.loadtxt(b) + np.array([1000.0, 0.0, 0.0]))
    assert "no area in common" in epochs(a, far, code=2)
    header = laspy.LasHeader(point_format=6, version="1.4")
    las = laspy.LasData(header)
    las.x, las.y, las.z = np.loadtxt(a).T
    las.write(tmp_path / "a.las")
    assert epochs(tmp_path / "a.las", b)["verdict"]["status"] == "sound"
