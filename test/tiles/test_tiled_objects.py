"""What stands on the surface of a cloud in tiles, against what ``volume`` takes out of all points
at once.
"""

from pathlib import Path

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

from ladar_volume.clouds.sampling.cloud_objects import PointsAtHand, standing_in
from ladar_volume.clouds.sampling.object_search import Located, ObjectSearch
from ladar_volume.io.pointfiles.cloud_files import read_cloud
from ladar_volume.io.pointfiles.crs import Reading
from ladar_volume.model.parameters import Parameters
from ladar_volume.tiles.standing import tiled_parts
from ladar_volume.tiles.standing.thinned_tiles import thinned
from ladar_volume.tiles.standing.tiled_objects import PointsInTiles, thin_points
from ladar_volume.tiles.standing.tiled_steps import highest_of_all, highest_step
from ladar_volume.tiles.tile_store import parts_of_file
from ladar_volume.tiles.tile_surface import EVERY
from ladar_volume.tiles.tile_work import OwnProcess
from ladar_volume.tiles.tiled_points import PointsTask, triangulated
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.volume.field_checks.standing_objects import STEEP


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
    again = rng.choice(len(p), n // 20, replace=False)  # later returns at the same footprints
    p = np.vstack([p, p[again] - np.array([0, 0, 1]) * rng.uniform(0.0, 0.6, (len(again), 1))])
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


@pytest.mark.parametrize("name", ["isprs_samp41.pcd", "automotive.ply"])
def test_real_surveys_are_as_in_one_process(name, tmp_path, capsys):
    p = read_cloud(Path(__file__).parents[1] / "data" / name).r
    p = p - np.floor(p.min(axis=0))  # to the millimetre in 32 bits
    path = write(tmp_path / "cloud.laz", p, np.random.default_rng(1))
    tile = float(np.ptp(p[:, :2], axis=0).max()) / 4.0
    store = ["--tile", f"{tile:.3g}", "--store", str(tmp_path / "s")]
    words = ["--level", f"{np.median(p[:, 2]) - 1.0:.2f}", "--units", "m"]
    whole, tiled = volume(capsys, path, *words), volume(capsys, path, *words, *store)
    assert differences(whole, tiled) == []
    assert len(whole["objects"]) == len(tiled["objects"])
    for one, two in zip(whole["objects"], tiled["objects"], strict=True):
        assert two == pytest.approx(one, rel=1e-7)


def test_one_store_holds_the_site_with_things_and_without(tmp_path, capsys):
    rng = np.random.default_rng(2)
    p = with_things(site(scattered, "L", 9000, rng, 5), THINGS)
    path = write(tmp_path / "cloud.laz", p, rng)
    words, count = ["--base", "ground"], ["--set", "volume.objects=count"]
    store = ["--tile", "25", "--store", str(tmp_path / "s")]
    whole, tiled = volume(capsys, path, *words), volume(capsys, path, *words, *store)
    counted = volume(capsys, path, *words, *count, *store)
    assert differences(whole, tiled) == []
    assert differences(volume(capsys, path, *words, *count), counted) == []
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


def test_things_of_too_many_points_are_doubtful(tmp_path, capsys, monkeypatch):
    rng = np.random.default_rng(7)
    p = with_things(site(scattered, "box", 9000, rng), THINGS[:1])
    path = write(tmp_path / "cloud.laz", p, rng)
    words = ["--base", "ground", "--tile", "25", "--store", str(tmp_path / "s")]
    whole = volume(capsys, path, "--base", "ground")
    monkeypatch.setattr(tiled_parts, "MOST_POINTS", 20)
    tiled = volume(capsys, path, *words)
    assert whole["objects"] and tiled["net_m3"] > whole["net_m3"] + 5.0  # it is counted
    (said,) = [r["text"] for r in tiled["verdict"]["reasons"] if r["name"] == "tiles_not_judged"]
    assert "steps above 0.25 m, the highest of 3." in said and "about (103" in said
    count = ["--set", "volume.objects=count"]
    whole = volume(capsys, path, "--base", "ground", *count)
    tiled = volume(capsys, path, *words, *count)
    assert differences(whole, tiled) == []


def tiles_of(path, folder, tile_m):
    """The points of a file in tiles."""
    parts = parts_of_file(path, folder, tile_m, Reading(), 2000)
    asked = PointsTask(EVERY, 0.02, False)
    return triangulated(parts, asked, OwnProcess(), lambda stage, total, done: None).points


def every_point(points):
    """Rows and places of all points of tiles."""
    tiles = sorted(points.index.count)
    rows = np.concatenate([points.index.rows(t) for t in tiles])
    order = np.argsort(rows)
    return rows[order], np.concatenate([points.index.points(t) for t in tiles])[order]


@pytest.mark.parametrize("seed", range(3))
def test_points_in_tiles_are_those_at_hand(seed, tmp_path):
    rng = np.random.default_rng(seed)
    path = write(tmp_path / "cloud.laz", site(scattered, "hole", 6000, rng, 20), rng)
    points = read_cloud(path).r
    tiled = PointsInTiles(tiles_of(path, tmp_path / "s", 9.0), OwnProcess(), lambda *_: None)
    whole = PointsAtHand(points, np.arange(len(points)), standing_in)
    rows, places = every_point(tiled.points)
    np.testing.assert_array_equal(places, points)
    for cell in (0.4, 1.7):
        one = whole.thinned(cell)
        two = every_point(thinned(OwnProcess(), tiled.points, cell))
        np.testing.assert_array_equal(rows[one.rows], two[0])
        there = one.places[rng.random(len(one.rows)) < 0.05, :2]
        one, two = whole.beside(there, cell), tiled.beside(there, cell)
        np.testing.assert_array_equal(rows[one.rows], two.rows)
        np.testing.assert_array_equal(one.places, two.places)
        things = rng.choice(len(whole.kept), 200, replace=False)
        taken = whole.kept[np.sort(things)]
        whole = whole.without(Located(taken, points[taken]))
        tiled = tiled.without(Located(rows[taken], points[taken]))
        left = every_point(tiled.points)
        np.testing.assert_array_equal(rows[whole.kept], left[0])
        np.testing.assert_array_equal(left[1], points[whole.kept])


@pytest.mark.parametrize("seed", range(4))
def test_the_thinned_surface_of_tiles_is_that_of_all_points(seed, tmp_path):
    rng = np.random.default_rng(seed)
    boxes = rng.uniform([5, 5, 0.4, 0.4, 0.8], [65, 40, 2.5, 2.5, 4.0], (12, 5))
    kind = (scattered, on_lines, gridded, scattered)[seed]
    shape = ("box", "two", "notch", "hole")[seed]
    p = with_things(site(kind, shape, 15000, rng, 0, seed > 1), boxes.tolist())
    path = write(tmp_path / "cloud.laz", p, rng)
    how = ObjectSearch(0.02, (0.3, 0.9)[seed % 2], Parameters())
    points = read_cloud(path).r
    one = PointsAtHand(points, np.arange(len(points)), standing_in).thin_surface(how)
    dealt = tiles_of(path, tmp_path / "s", 13.0)
    two = PointsInTiles(dealt, OwnProcess(), lambda *_: None).thin_surface(how)
    rows, _ = every_point(dealt)
    assert len(one.standing.rows) > 10
    np.testing.assert_array_equal(rows[one.standing.rows], two.standing.rows)
    np.testing.assert_array_equal(one.standing.places, two.standing.places)
    there = one.standing.places[::3, :2]
    a, b = one.around(there, 2.0), two.around(there, 2.0)
    np.testing.assert_array_equal(rows[a.located.rows], b.located.rows)
    np.testing.assert_array_equal(a.standing, b.standing)
    np.testing.assert_array_equal(a.counted, b.counted)
    points = thin_points(dealt, how, OwnProcess())
    highest = highest_of_all(OwnProcess(), points, how.step_m)
    tin = build_tin(every_point(points)[1])
    found = highest_step(tin.triangles, tin.vertices, how.step_m, STEEP)
    assert highest.rise == found[1] > 0.5
    assert (highest.x, highest.y) == pytest.approx(found[2:])
