"""A body on the ground of its own cloud, by tiles: every line and every doubt of ``volume``."""

import json
from pathlib import Path

import laspy
import numpy as np
import pytest
from yards import SIGMA, write_yard

from ladar_volume.cli.main import main
from ladar_volume.io.pointfiles.cloud_files import read_cloud
from ladar_volume.tiles.readings import tile_body

LINES = {
    "flat": set(),
    "bent": {"outline_open", "base_bends", "cut", "ground_one_sided"},
    "pad": {"base_uneven", "base_toe"},
    "two": {"further_bodies"},
    "edge": {"outline_open", "cut", "ground_one_sided", "further_bodies"},
    "grass": {"base_uneven", "vegetation"},
    "dune": {"base_toe"},
    "hole": {"unseen"},
}


def told(capsys, path, *words):
    """What the JSON of a volume above the ground says."""
    common = ["--base", "ground", "--sigma", str(SIGMA), "--clean", "off", "--relevant", "all"]
    assert main(["volume", str(path), *common, *map(str, words), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def check_same(one, two, rel=1e-9):
    for name in ("cut_m3", "fill_m3", "net_m3", "area_m2", "sigma_m3", "coverage_factor"):
        assert two[name] == pytest.approx(one[name], rel=rel), name
    assert two["budget_m6"] == pytest.approx(one["budget_m6"], rel=rel)
    texts = [[r["text"] for r in told["verdict"]["reasons"]] for told in (one, two)]
    assert texts[0] == texts[1]


@pytest.mark.parametrize("kind", LINES)
def test_lines_and_doubts_of_a_body_are_those_of_volume(tmp_path, capsys, kind):
    path, store = write_yard(tmp_path / "yard.laz", kind), ("--store", tmp_path / "store")
    one = told(capsys, path)
    check_same(one, told(capsys, path, "--tile", 17, *store))
    assert {r["name"] for r in one["verdict"]["reasons"]} == LINES[kind]


@pytest.mark.parametrize(
    "words",
    [
        ("wall", "--set", "volume.bodies=0", "--set", "ground.degree=2"),
        ("two", "--set", "volume.bodies=0"),
        ("pad", "--outline", "all"),
        ("grass", "--outline", "all", "--set", "ground.degree=2"),
    ],
    ids=" ".join,
)
def test_several_bodies_and_no_outline_are_those_of_volume(tmp_path, capsys, words):
    path, store = write_yard(tmp_path / "yard.laz", words[0]), ("--store", tmp_path / "store")
    one = told(capsys, path, *words[1:])
    check_same(one, told(capsys, path, *words[1:], "--tile", 23, *store))


def test_a_body_too_large_to_look_at_is_doubtful(tmp_path, capsys, monkeypatch):
    path, store = write_yard(tmp_path / "yard.laz", "flat"), ("--store", tmp_path / "store")
    one = told(capsys, path)
    monkeypatch.setattr(tile_body, "MOST_OF_BODY", 100)
    two = told(capsys, path, "--tile", 17, *store)
    assert two["budget_m6"] == pytest.approx(one["budget_m6"], rel=1e-9)
    assert one["verdict"]["status"] == "sound"
    (reason,) = two["verdict"]["reasons"]
    assert reason["name"] == "tiles_not_judged" and "more than 100" in reason["text"]


def test_a_real_survey_is_that_of_volume(tmp_path, capsys):
    """Airborne returns: on a lattice, several to a place, houses and trees."""
    r = read_cloud(Path(__file__).parents[1] / "data" / "isprs_samp41.pcd").r
    las = laspy.LasData(laspy.LasHeader(point_format=1, version="1.2"))
    las.header.scales, las.header.offsets = [1e-3] * 3, np.floor(r.min(axis=0))
    las.x, las.y, las.z = r.T
    las.write(path := tmp_path / "real.laz")
    store = ("--tile", 43, "--store", tmp_path / "store")
    for words in (("--sigma", 0.05), ("--outline", "all"), ("--outline", "all", "--no-correction")):
        one = told(capsys, path, *words)
        # coordinates of 5·10⁶ m leave nine digits to an area
        check_same(one, told(capsys, path, *words, *store), rel=1e-8)
    assert "vegetation" in one["budget_m6"]
