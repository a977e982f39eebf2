"""``volume`` by tiles against ``volume`` of all points at once, as a user gives both: with its
cleaning, its sampled area, its noise and what it says against the result.
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

from ladar_volume.cli.main import main

CASES = [
    (scattered, "L", 6000, 40, False, ["--base", "ground"]),
    (scattered, "two", 3000, 5, True, ["--base", "ground", "--outline", "all"]),
    (gridded, "notch", 4000, 5, False, ["--level", "100.5"]),
    (gridded, "ellipse", 3000, 0, True, ["--plane", "79", "0.02", "0"]),
    (on_lines, "hole", 7000, 40, False, ["--base", "ground"]),
    (on_lines, "notch", 9000, 40, True, ["--level", "100.5", "--clean", "off"]),
    (thinning_out, "box", 4000, 5, False, ["--base", "ground", "--relevant", "all"]),
    (thinning_out, "hole", 4000, 0, True, ["--base", "ground"]),
    (scattered, "notch", 5000, 5, True, ["--level", "100.5", "--max-edge", "4"]),
    (gridded, "hole", 3000, 5, False, ["--base", "ground", "--max-circle", "5"]),
]


@pytest.mark.parametrize("case", CASES, ids=lambda c: f"{c[0].__name__} {c[1]} {c[-1][-1]}")
def test_tiles_say_what_the_whole_says(case, tmp_path, capsys):
    kind, shape, n, strays, alone, words = case
    rng = np.random.default_rng(n + strays)
    path = write(tmp_path / "cloud.laz", site(kind, shape, n, rng, strays, alone), rng)
    whole = volume(capsys, path, *words)
    for tile in ("9", "33"):
        store = ["--tile", tile, "--store", str(tmp_path / tile)]
        tiled = volume(capsys, path, *words, *store)
        assert differences(whole, tiled) == []
        assert tiled["tiles"]["count"] > 4
        assert (
            differences(tiled, volume(capsys, path, *words, *store)) == []
        )  # from what is at rest


def test_what_strays_would_change(tmp_path, capsys):
    rng = np.random.default_rng(3)
    path = write(tmp_path / "cloud.laz", site(scattered, "box", 8000, rng, 60), rng)
    words = ["--base", "ground"]
    whole = volume(capsys, path, *words)["clean"]
    tiled = volume(capsys, path, *words, "--tile", "12", "--store", str(tmp_path / "s"))["clean"]
    assert whole["strays"] > 40 and abs(whole["effect_m3"]) > 0.1
    assert tiled["effect_m3"] == pytest.approx(whole["effect_m3"], rel=1e-9)
    assert tiled["share"] == whole["share"]


def test_what_is_left_out_is_named(tmp_path, capsys):
    rng = np.random.default_rng(5)
    path = write(tmp_path / "cloud.laz", site(gridded, "ellipse", 4000, rng, 0, True), rng)
    words = ["--level", "98", "--tile", "20", "--store", str(tmp_path / "s")]
    tiled = volume(capsys, path, *words)
    (whole,) = volume(capsys, path, "--level", "98")["surfaces"]
    left = whole["sampled"]["beyond"], tiled["clean"]["strays"]
    assert tiled["tiles"]["alone"] == left[0] and sum(left) == 3
    assert main(["volume", str(path), *words]) == 0
    out = capsys.readouterr().out
    assert all(f"left out: {n:,} " in out for n in left if n)


def test_strays_over_a_tile_of_which_nothing_counts(tmp_path, capsys):
    rng = np.random.default_rng(538)
    p = site(on_lines, "box", 800, rng, 30, True)
    path = write(tmp_path / "cloud.laz", p, rng)
    words = ["--base", "ground", "--max-edge", "3"]
    whole = volume(capsys, path, *words)
    tiled = volume(capsys, path, *words, "--tile", "7", "--store", str(tmp_path / "s"))
    effect = whole["clean"]["effect_m3"]
    assert tiled["clean"]["effect_m3"] == pytest.approx(effect, rel=1e-9, abs=1e-9)
    assert tiled["net_m3"] == pytest.approx(whole["net_m3"], rel=1e-9)


def test_points_that_show_no_spacing_count_up_to_their_hull(tmp_path, capsys):
    rng = np.random.default_rng(4)
    path = write(tmp_path / "cloud.laz", site(scattered, "box", 90, rng), rng)
    words = ["--level", "100", "--sigma", "0.02"]
    whole = volume(capsys, path, *words)
    tiled = volume(capsys, path, *words, "--tile", "20", "--store", str(tmp_path / "s"))
    assert differences(whole, tiled) == []


def test_where_nothing_rises_the_pit_is_named(tmp_path, capsys):
    rng = np.random.default_rng(4)
    p = site(scattered, "box", 5000, rng)
    p[:, 2] = 100.0 + rng.normal(0.0, 0.005, len(p))
    p[np.hypot(*(p[:, :2] - [1045.0, -480.0]).T) < 6.0, 2] -= 3.0
    path = str(write(tmp_path / "cloud.laz", p, rng))
    said = []
    for more in ([], ["--tile", "15", "--store", str(tmp_path / "s")]):
        assert main(["volume", path, "--base", "ground", *more]) == 2
        said.append(capsys.readouterr().err)
    assert "a pit of 90.6 m² is up to 3.02 m deep" in said[0]
    assert said[0].split("nothing rises")[1] == said[1].split("nothing rises")[1]
