"""What stands on the surface of a cloud in tiles, against what ``volume`` takes out of all points
at once.
"""

import numpy as np
import pytest
from whole_and_tiles import (
    differences,
    gridded,
    on_lines,
    scattered,
    site,
    thinning_out,
    volume,
    write,
)

from ladar_volume.clouds.sampling.cloud_objects import PointsAtHand
from ladar_volume.clouds.sampling.object_search import Located
from ladar_volume.io.pointfiles.cloud_files import read_cloud
from ladar_volume.io.pointfiles.crs import Reading
from ladar_volume.tiles.standing import tiled_objects
from ladar_volume.tiles.standing.tiled_objects import PointsInTiles
from ladar_volume.tiles.tile_store import parts_of_file
from ladar_volume.tiles.tile_surface import EVERY
from ladar_volume.tiles.tile_work import OwnProcess
from ladar_volume.tiles.tiled_points import PointsTask, triangulated


def with_things(p, things):
    """Points with boxes on them: middles x and y, half widths and heights, m."""
    out = p.copy()
    for x, y, wide, deep, high in things:
        on = (np.abs(p[:, 0] - 1000.0 - x) < wide) & (np.abs(p[:, 1] + 500.0 - y) < deep)
        out[on, 2] += high
    return out


#: A machine at the toe with a cab on it, a wall, and a truck beside.
THINGS = [(35, 22, 1.5, 1.0, 2.5), (35, 22, 0.6, 0.5, 1.8), (20, 30, 2.5, 0.5, 1.5)]
THINGS += [(60, 8, 2.0, 1.2, 3.0)]
CASES = [
    (scattered, "box", 12000, 5, False, THINGS, ["--base", "ground"]),
    (on_lines, "hole", 60000, 0, True, THINGS, ["--base", "ground"]),
    (gridded, "L", 20000, 5, False, THINGS, ["--base", "ground", "--outline", "all"]),
    (scattered, "notch", 30000, 0, True, THINGS, ["--level", "98"]),
    (gridded, "box", 9000, 0, False, THINGS[-1:], ["--plane", "79", "0.02", "0"]),
    (thinning_out, "two", 20000, 5, False, THINGS, ["--base", "ground", "--max-edge", "5"]),
]


@pytest.mark.parametrize("case", CASES, ids=lambda c: f"{c[0].__name__} {c[1]} {c[-1][-1]}")
def test_what_stands_on_the_surface_is_taken_out_as_in_one_process(case, tmp_path, capsys):
    kind, shape, n, strays, alone, things, words = case
    rng = np.random.default_rng(n + strays)
    p = with_things(site(kind, shape, n, rng, strays, alone), things)
    path = write(tmp_path / "cloud.laz", p, rng)
    whole = volume(capsys, path, *words)
    assert whole["objects"]
    for tile in ("11", "40"):
        store = ["--tile", tile, "--store", str(tmp_path / tile)]
        tiled = volume(capsys, path, *words, *store)
        assert differences(whole, tiled) == []
        assert len(tiled["objects"]) == len(whole["objects"])
        for one, two in zip(whole["objects"], tiled["objects"], strict=True):
            assert two == pytest.approx(one, rel=1e-7)
    count = [*words, "--set", "volume.objects=count"]
    counted = volume(capsys, path, *count, *store)  # the same store, other parameters
    assert differences(volume(capsys, path, *count), counted) == []
    assert counted["net_m3"] > whole["net_m3"] + 3.0
    assert differences(whole, volume(capsys, path, *words, *store)) == []


def test_what_is_nearly_all_that_rises_is_measured(tmp_path, capsys):
    rng = np.random.default_rng(6)
    xy = scattered(9000, rng) + np.array([1000.0, -500.0])
    p = np.column_stack([xy, 100.0 + rng.normal(0, 0.02, len(xy))])
    path = write(tmp_path / "cloud.laz", with_things(p, THINGS[-1:]), rng)
    for words in (["--level", "100.2"], ["--plane", "100.1", "0", "0"]):
        whole = volume(capsys, path, *words)
        tiled = volume(capsys, path, *words, "--tile", "20", "--store", str(tmp_path / "s"))
        assert whole["objects"] == tiled["objects"] == []
        assert whole["cut_m3"] > 20.0
        assert differences(whole, tiled) == []


def test_more_than_one_process_can_look_at_is_doubtful(tmp_path, capsys, monkeypatch):
    rng = np.random.default_rng(7)
    p = with_things(site(scattered, "box", 9000, rng), THINGS[:1])
    path = write(tmp_path / "cloud.laz", p, rng)
    words = ["--base", "ground", "--tile", "25", "--store", str(tmp_path / "s")]
    whole = volume(capsys, path, "--base", "ground")
    monkeypatch.setattr(tiled_objects, "MOST", 1000)
    tiled = volume(capsys, path, *words)
    assert whole["objects"] and tiled["net_m3"] > whole["net_m3"] + 5.0  # it is counted
    (said,) = [r["text"] for r in tiled["verdict"]["reasons"] if r["name"] == "tiles_not_judged"]
    assert "steps above 0.25 m, the highest of 3." in said and "about (103" in said
    count = ["--set", "volume.objects=count"]
    whole = volume(capsys, path, "--base", "ground", *count)
    tiled = volume(capsys, path, *words, *count)
    assert differences(whole, tiled) == []


@pytest.mark.parametrize("seed", range(3))
def test_points_in_tiles_are_those_at_hand(seed, tmp_path):
    rng = np.random.default_rng(seed)
    path = write(tmp_path / "cloud.laz", site(scattered, "hole", 6000, rng, 20), rng)
    parts = parts_of_file(path, tmp_path / "s", 9.0, Reading(), 2000)
    asked = PointsTask(EVERY, 0.02, False)
    made = triangulated(parts, asked, OwnProcess(), lambda stage, total, done: None)
    tiled, points = PointsInTiles(made.points, OwnProcess()), read_cloud(path).r
    whole = PointsAtHand(points, np.arange(len(points)))
    every = tiled.thinned(0.0)
    np.testing.assert_array_equal(every.places, points)
    for cell in (0.4, 1.7):
        one, two = whole.thinned(cell), tiled.thinned(cell)
        np.testing.assert_array_equal(every.rows[one.rows], two.rows)
        there = two.places[rng.random(len(two.rows)) < 0.05, :2]
        one, two = whole.beside(there, cell), tiled.beside(there, cell)
        np.testing.assert_array_equal(every.rows[one.rows], two.rows)
        np.testing.assert_array_equal(one.places, two.places)
        things = rng.choice(len(whole.kept), 200, replace=False)
        taken = whole.kept[np.sort(things)]
        whole = whole.without(Located(taken, points[taken]))
        tiled = tiled.without(Located(every.rows[taken], points[taken]))
        left = tiled.thinned(0.0)
        np.testing.assert_array_equal(every.rows[whole.kept], left.rows)
        np.testing.assert_array_equal(left.places, points[whole.kept])
