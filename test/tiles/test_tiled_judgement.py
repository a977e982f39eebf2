"""Every line of the budget and every doubt of ``volume``, by tiles."""

import json

import laspy
import numpy as np
import pytest
from tiled_clouds import LEVEL, SIGMA, clustered, gridded, heights, random, write

from ladar_volume.cli.main import main
from ladar_volume.tiles.unseen import tile_gaps


def ragged(n, rng):
    """Two densities, a hole, a narrow one, and several points in one place."""
    xy = np.concatenate([rng.random((n, 2)) * [70, 45], rng.random((n // 3, 2)) * [20, 45]])
    xy = xy[np.hypot(xy[:, 0] - 45, xy[:, 1] - 25) > 6.0]
    xy = xy[(np.abs(xy[:, 0] - 10.0) > 1.2) | (np.abs(xy[:, 1] - 30.0) > 8.0)]
    return np.concatenate([xy, xy[:40]])


def told(capsys, *words):
    """What the JSON of a volume says."""
    common = ["--sigma", str(SIGMA), "--clean", "off", "--relevant", "all", "--json"]
    assert main(["volume", *map(str, words), *common]) == 0
    return json.loads(capsys.readouterr().out)


def check_same(one, two, rel=1e-9):
    for name in ("cut_m3", "fill_m3", "net_m3", "area_m2", "sigma_m3", "sigma_cut_m3"):
        assert two[name] == pytest.approx(one[name], rel=rel), name
    assert two["budget_m6"] == pytest.approx(one["budget_m6"], rel=rel)
    a, b = (told["verdict"] for told in (one, two))
    assert a["status"] == b["status"] and len(a["reasons"]) == len(b["reasons"])
    for first, second in zip(a["reasons"], b["reasons"], strict=True):
        assert second["value"] == pytest.approx(first["value"], rel=rel)
        assert (second["name"], second["text"]) == (first["name"], first["text"])


@pytest.mark.parametrize("kind", [random, gridded, clustered, ragged], ids=lambda k: k.__name__)
@pytest.mark.parametrize("base", [("--level", LEVEL), ("--plane", 10.4, 0.01, 0.005)])
def test_lines_and_verdict_are_those_of_volume(tmp_path, capsys, kind, base):
    path = write(tmp_path / "cloud.laz", kind(4000, np.random.default_rng(5)))
    one = told(capsys, path, *base)
    store = ("--store", tmp_path / "store")
    for tile_m in (16.0, 1000.0):
        check_same(one, told(capsys, path, *base, "--tile", tile_m, *store))
    assert one["budget_m6"]["unseen"] > 0.0 or kind in (random, gridded)


def test_gaps_of_a_body_move_its_volume_alike(tmp_path, capsys):
    path = write(tmp_path / "cloud.laz", ragged(4000, np.random.default_rng(5)))
    one = told(capsys, path, "--base", "ground")
    check_same(one, told(capsys, path, "--base", "ground", "--tile", 21))
    assert one["budget_m6"]["unseen"] > 1.0
    assert [r["name"] for r in one["verdict"]["reasons"]] == ["unseen", "ground_one_sided"]


def test_two_layers_are_told_alike(tmp_path, capsys):
    rng = np.random.default_rng(2)
    xy = random(6000, rng)
    z = heights(*xy.T) + 0.3 * rng.integers(0, 2, len(xy)) + rng.normal(0, SIGMA, len(xy))
    las = laspy.LasData(laspy.LasHeader(point_format=1, version="1.2"))
    las.header.scales = [1e-3] * 3
    las.x, las.y, las.z = *xy.T, z
    las.write(path := tmp_path / "layers.laz")
    one = told(capsys, path, "--level", LEVEL)
    two = told(capsys, path, "--level", LEVEL, "--tile", 16, "--store", tmp_path / "store")
    check_same(one, two)
    assert "layers" in [r["name"] for r in one["verdict"]["reasons"]]
    assert one["budget_m6"]["layers"] > 0.0


def test_a_gap_with_too_many_points_around_is_a_doubt_and_not_in_sigma(
    tmp_path, capsys, monkeypatch
):
    path = write(tmp_path / "cloud.laz", ragged(4000, np.random.default_rng(5)))
    monkeypatch.setattr(tile_gaps, "MOST_AROUND", 10)
    found = told(capsys, path, "--level", LEVEL, "--tile", 21, "--store", tmp_path / "store")
    assert found["budget_m6"].get("unseen", 0.0) == 0.0
    assert "unseen" in [r["name"] for r in found["verdict"]["reasons"]]


def test_points_around_a_long_gap_are_sought_along_it_and_not_in_its_box():
    t = np.linspace(0.0, 1.0, 30)[:, None]
    gap = np.array([100.0, 200.0]) + t * [600.0, 600.0] + [[0.0, 0.1]] * (t > 0.5)
    stretch = tile_gaps.Stretch.of(gap)
    rng = np.random.default_rng(1)
    xy = rng.uniform([50.0, 150.0], [750.0, 850.0], (4000, 2))
    along = (xy - [100.0, 200.0]) @ np.array([1.0, 1.0]) / 2**0.5
    across = np.abs((xy - [100.0, 200.0]) @ np.array([1.0, -1.0])) / 2**0.5
    inner = (along > -9.8) & (along < 600.0 * 2**0.5 + 9.8) & (across < 9.8)
    outer = (along > -10.2) & (along < 600.0 * 2**0.5 + 10.2) & (across < 10.2)
    held = stretch.holds(xy, 10.0)
    assert held[inner].all() and not held[~outer].any() and 50 < inner.sum() < 400
