"""The volume verb end to end: closed forms in every format, two clouds, floors, frames, and wrong
words in one line.
"""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from ladar_volume.cli.main import main
from ladar_volume.io.endings import ENCODINGS
from ladar_volume.io.pointfiles.cloud_files import write_cloud

ROOF = np.array([(0, 0, 0), (4, 0, 1), (4, 3, 2), (0, 3, -1), (2, 1.5, 3)], float)
CONE = 16.0 * math.pi


def cone(xy, top=3.0, radius=4.0):
    return np.maximum(0.0, top * (1.0 - np.hypot(*xy.T) / radius))


def scattered(n, seed, height=lambda xy: 0 * xy[:, 0], sigma=0.0, half=6.0):
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-half, half, (n, 2))
    return np.c_[xy, height(xy) + sigma * rng.normal(size=n)]


@pytest.fixture
def save(tmp_path):
    def write(name, r, columns=None):
        write_cloud(tmp_path / name, r, columns)
        return tmp_path / name

    return write


@pytest.fixture
def volume(capsys):
    def call(*words):
        assert main(["volume", *map(str, words), "--json"]) == 0
        return json.loads(capsys.readouterr().out)

    return call


@pytest.mark.parametrize(
    "level,cut,fill", [(0, 49 / 3, 1 / 3), (1, 20 / 3, 8 / 3), (2, 1, 9), (2.5, 0.125, 14.125)]
)
def test_the_roof_at_four_levels(level, cut, fill, save, volume):
    facts = volume(save("roof.csv", ROOF), "--level", level)
    assert (facts["cut_m3"], facts["fill_m3"]) == pytest.approx((cut, fill), abs=1e-12)
    assert facts["net_m3"] == pytest.approx(cut - fill, abs=1e-12) and facts[
        "area_m2"
    ] == pytest.approx(12.0)
    assert facts["base"] == f"level {level:.3f} m" and not facts["base_same_survey"]
    # five points do not show their noise: no number is made up
    assert (
        facts["sigma_m3"] is None
        and facts["correction"]["name"] is None
        and "too few" in facts["surfaces"][0]["sigma_from"]
    )


@pytest.mark.parametrize("ending", list(ENCODINGS))
def test_every_kind_of_file(ending, save, volume):
    facts = volume(save(f"roof{ending}", ROOF), "--level", 1, "--sigma", 1e-6)
    assert (facts["cut_m3"], facts["fill_m3"]) == pytest.approx((20 / 3, 8 / 3), abs=1e-9)
    # each vertex carries a third of the area of its triangles, 3 m² each
    shares = np.array([2.0, 2.0, 2.0, 2.0, 4.0])
    assert facts["sigma_m3"] == pytest.approx(1e-6 * math.sqrt((shares**2).sum()), rel=1e-9)


def test_the_json_says_what_a_program_needs(save, volume):
    facts = volume(save("c.ply", scattered(3000, 0, cone, 0.01)), "--level", 0.5)
    numbers = {
        "cut_m3",
        "fill_m3",
        "net_m3",
        "sigma_m3",
        "sigma_cut_m3",
        "sigma_fill_m3",
        "area_m2",
        "confidence",
        "coverage_factor",
    }
    assert all(isinstance(facts[key], float) for key in numbers) and isinstance(facts["base"], str)
    assert set(facts) >= numbers | {
        "interval_m3",
        "correction",
        "budget_m6",
        "surfaces",
        "frame",
        "options",
        "version",
    }
    assert (
        facts["net_m3"] == facts["cut_m3"] - facts["fill_m3"]
        and facts["cut_m3"] > 0
        and facts["fill_m3"] > 0
    )
    assert sum(facts["budget_m6"].values()) == pytest.approx(facts["sigma_m3"] ** 2, rel=1e-12)
    assert facts["interval_m3"] == pytest.approx(
        [facts["net_m3"] + s * 1.959963985 * facts["sigma_m3"] for s in (-1, 1)]
    )
    surface = facts["surfaces"][0]
    assert (
        surface["points"] == surface["used"] == surface["vertices"] == 3000
        and surface["path"] == "c.ply"
    )
    assert surface["sigma_from"] == "residuals of local quadrics" and surface[
        "sigma_point_m"
    ] == pytest.approx(0.01, rel=0.1)
    assert facts["frame"] == {"name": "level"} and facts["options"]["ratio"] == 1.0


def test_flat_ground_at_the_level_is_neither_cut_nor_fill(save, volume):
    cloud = save("c.npy", scattered(4000, 1, cone, 0.03))
    raw, facts = volume(cloud, "--level", 0, "--no-correction"), volume(cloud, "--level", 0)
    fix = facts["correction"]
    assert fix["name"] == "folded normal" and (fix["cut_raw_m3"], fix["fill_raw_m3"]) == (
        raw["cut_m3"],
        raw["fill_m3"],
    )
    assert (
        facts["net_m3"] == pytest.approx(raw["net_m3"], abs=1e-12)
        and facts["sigma_m3"] == raw["sigma_m3"]
    )
    assert facts["fill_m3"] < 0.25 * raw["fill_m3"] and raw["fill_m3"] == pytest.approx(
        0.28 * 0.03 * (144 - CONE), rel=0.1
    )
    assert facts["net_m3"] == pytest.approx(CONE, abs=4 * facts["sigma_m3"] + 0.005 * CONE)
    assert abs(facts["cut_m3"] - CONE) < abs(raw["cut_m3"] - CONE)


def test_a_box_with_its_ramps(save, volume):
    s = 0.05
    x, y = (a.ravel() for a in np.meshgrid(np.arange(-40, 41) * s, np.arange(-40, 41) * s))
    inside = (np.abs(x) <= 1.0 + 1e-9) & (np.abs(y) <= 0.75 + 1e-9)
    facts = volume(save("box.csv", np.c_[x, y, np.where(inside, 0.9, 0.0)]), "--level", 0)
    sides = 2.0 * 1.5 * 0.9 + 7.0 * 0.9 * s / 2
    # a corner of the ramp is a pyramid or its complement, as its diagonal lies
    assert (
        sides + 4 * 0.9 * s * s / 6 - 1e-9 <= facts["net_m3"] <= sides + 4 * 0.9 * s * s / 3 + 1e-9
    )
    assert facts["fill_m3"] == 0.0 and facts["area_m2"] == pytest.approx(16.0)


@pytest.mark.parametrize("vertices", [1, 0.3333, 700])
def test_a_stockpile_between_two_epochs(vertices, save, volume):
    after, before = (
        save("after.ply", scattered(4000, 2, cone, 0.02)),
        save("before.laz", scattered(5000, 3, sigma=0.02)),
    )
    facts = volume(after, before, "--vertices", vertices)
    assert facts["net_m3"] == pytest.approx(CONE, abs=4 * facts["sigma_m3"] + 0.004 * CONE)
    assert (
        "before.laz" in facts["base"]
        and facts["footprint"] == "common"
        and len(facts["surfaces"]) == 2
    )
    back = volume(before, after, "--vertices", vertices)
    assert back["net_m3"] == pytest.approx(-facts["net_m3"], abs=1e-9) and back[
        "sigma_m3"
    ] == pytest.approx(facts["sigma_m3"], rel=1e-9)
    assert back["fill_m3"] == pytest.approx(facts["cut_m3"], rel=1e-6)
    assert facts["correction"]["m3"] > 0 and facts["fill_m3"] < facts["correction"]["fill_raw_m3"]


def test_own_footprints_carry_their_difference_to_the_level(save, volume):
    one, two = (
        save("one.csv", scattered(3000, 4, cone)),
        save("two.csv", scattered(3000, 5, half=5.0)),
    )
    common, own = volume(one, two), volume(one, two, "--footprint", "own", "--level", -10)
    assert common["net_m3"] == pytest.approx(CONE, rel=0.005)
    areas = [s["area_m2"] for s in own["surfaces"]]
    assert own["net_m3"] == pytest.approx(common["net_m3"] + 10 * (areas[0] - areas[1]), rel=1e-3)
    assert len(own["each"]) == 2 and own["each"][0]["net_m3"] - own["each"][1][
        "net_m3"
    ] == pytest.approx(own["net_m3"])
    lowest = volume(one, two, "--footprint", "own")
    assert lowest["base"].startswith("level 0.000") and lowest["fill_m3"] == 0.0


def test_the_ground_of_the_cloud_itself(save, volume):
    cloud = save(
        "c.pcd",
        scattered(
            8000, 6, lambda xy: cone(xy) + 100 + 0.05 * xy[:, 0] - 0.02 * xy[:, 1], 0.01, half=9.0
        ),
    )
    facts = volume(cloud, "--base", "ground", "--set", "volume.outline_margin_m=1.5")
    assert facts["net_m3"] == pytest.approx(CONE, abs=4 * facts["sigma_m3"] + 0.003 * CONE)
    assert facts["base_same_survey"] and set(facts["budget_m6"]) == {
        "noise",
        "base_surface",
        "between_points",
        "unseen",
    }
    plane = volume(cloud, "--base", "plane", "--plane", 100, 0.05, -0.02)
    assert plane["net_m3"] == pytest.approx(
        CONE, abs=4 * plane["sigma_m3"] + 0.003 * CONE
    ) and plane["base"].startswith("given plane")
    assert plane == volume(cloud, "--plane", 100, 0.05, -0.02)


def test_levels_find_floor_and_top(save, volume):
    def step(xy):
        return np.where(np.abs(xy).max(axis=1) < 2.0, 1.0, 0.0)

    cloud = save("c.csv", scattered(20000, 7, step, 0.01))
    facts = volume(cloud, "--levels", -0.3, 1.3, 0.02)
    found = facts["sequences"][0]
    assert found["floor_m"] == pytest.approx(0.0, abs=0.003) and found["top_m"] == pytest.approx(
        1.0, abs=0.003
    )
    assert len(found["level_m"]) == len(found["cut_m3"]) == 81 and found["level_m"][
        -1
    ] == pytest.approx(1.3)
    assert all(0 < e["sigma_m"] < 0.001 for e in found["events"])
    assert (
        np.diff(found["first_m3"]) == pytest.approx(found["second_m3"], abs=1e-9)
        and len(found["first_m3"]) == 80
    )
    assert facts["base"].startswith("floor of the same cloud") and facts["base_same_survey"]
    fixed = volume(cloud, "--level", found["floor_m"])
    # the noise of the ground is in the volume and in the floor, and cancels between them
    assert (
        facts["net_m3"] == pytest.approx(fixed["net_m3"], abs=1e-9)
        and facts["budget_m6"]["noise"] < 0.6**2 * fixed["budget_m6"]["noise"]
    )
    at = volume(cloud, "--level", 0.5, "--levels", 0.5, 0.5, 1)
    # near the levels the sequence has the same correction as the volume
    row = at["sequences"][0]
    assert row["cut_m3"] == pytest.approx([at["cut_m3"]], rel=1e-9) and row[
        "fill_m3"
    ] == pytest.approx([at["fill_m3"]], rel=1e-9)
    assert (
        row["folded_m3"] == pytest.approx([at["correction"]["m3"]], rel=1e-9)
        and row["folded_m3"][0] > 0
    )
    raw = volume(cloud, "--level", 0.5, "--levels", 0.5, 0.5, 1, "--no-correction")
    assert raw["sequences"][0]["cut_m3"] == pytest.approx(
        [at["correction"]["cut_raw_m3"]], rel=1e-9
    )
    # shift identity
    two = volume(cloud, "--level", 0.2)
    assert two["net_m3"] - at["net_m3"] == pytest.approx(at["area_m2"] * 0.3, rel=1e-9)


def test_the_offset_of_two_sequences(save, volume):
    one = scattered(3000, 8, cone)
    facts = volume(
        save("a.csv", one + np.array([0, 0, 0.05])), save("b.csv", one), "--levels", 0.5, 2.5, 0.25
    )
    assert facts["offset"]["offset_m"] == pytest.approx(0.05, abs=1e-9) and facts[
        "net_m3"
    ] == pytest.approx(0.05 * facts["area_m2"], rel=1e-9)
    high = volume(
        save("a.csv", one), save("b.csv", one + np.array([0, 0, 0.1])), "--levels", 90, 91, 0.25
    )
    assert high["offset"]["offset_m"] is None and "above the surface" in high["offset"]["why"]


def test_a_wall_is_meshed_against_the_scan_direction(save, volume):
    bump, flat = scattered(4000, 9, cone, 0.01), scattered(4000, 10, sigma=0.01)
    wall = [
        np.c_[p[:, 0], -p[:, 2], p[:, 1]] + [1000.0, 2000.0, 50.0] for p in (bump, flat)
    ]  # bulges towards −y
    one, two = save("bump.ply", wall[0]), save("flat.ply", wall[1])
    facts = volume(one, two, "--frame", "scan", "--direction", 0, 1, 0)
    assert facts["net_m3"] == pytest.approx(CONE, abs=4 * facts["sigma_m3"] + 0.004 * CONE)
    assert facts["frame"]["name"] == "scan" and np.allclose(
        facts["frame"]["axes_map"][2], [0, -1, 0]
    )
    seen = volume(one, two, "--frame", "scan", "--scanner", 1000, 1970, 50)
    assert seen["net_m3"] == pytest.approx(CONE, abs=4 * seen["sigma_m3"] + 0.004 * CONE)
    # 30 m before the scanner, along the axis that points back at it
    level = volume(one, "--frame", "scan", "--scanner", 1000, 1970, 50, "--level", -30)
    assert level["net_m3"] == pytest.approx(CONE, rel=0.02)


def test_a_plane_means_the_same_in_every_frame(save, volume):
    cloud = save("c.csv", scattered(4000, 11, lambda xy: cone(xy) + 0.1 * xy[:, 0] + 2))
    turned = volume(cloud, "--plane", 2, 0.1, 0, "--frame", "scan", "--direction", 0.2, -0.1, -1)
    assert turned["net_m3"] == pytest.approx(
        volume(cloud, "--plane", 2, 0.1, 0)["net_m3"], rel=2e-3
    )
    assert turned["base"] == "given plane z = 2 + 0.1 x + 0 y"


def test_sigma_comes_from_the_option_the_column_or_the_residuals(save, volume):
    r = scattered(2000, 12, sigma=0.02)
    tilted = np.tile([0.6, 0.0, 0.8], (2000, 1))
    cloud = save("c.ply", r, {"sigma": np.full(2000, 0.04), "normal": tilted})
    column, given = volume(cloud, "--level", -1), volume(cloud, "--level", -1, "--sigma", 0.05)
    assert column["surfaces"][0]["sigma_from"] == "column 'sigma' along the normals"
    assert (
        column["sigma_m3"] == pytest.approx(given["sigma_m3"], rel=1e-6)
        and given["surfaces"][0]["sigma_from"] == "given"
    )
    own = volume(save("z.ply", r, {"sigma_z": np.full(2000, 0.05)}), "--level", -1)
    assert own["surfaces"][0]["sigma_from"] == "column 'sigma_z'" and own[
        "sigma_m3"
    ] == pytest.approx(given["sigma_m3"], rel=1e-9)
    free = volume(save("n.ply", r), "--level", -1)
    noise = [math.sqrt(facts["budget_m6"]["noise"]) for facts in (free, given)]
    assert noise[0] == pytest.approx(0.4 * noise[1], rel=0.1)
    pair = volume(
        save("n.ply", r),
        save("z.ply", r + np.array([0, 0, 1.0])),
        "--sigma",
        0.03,
        "--sigma-b",
        0.0,
    )
    assert math.sqrt(pair["budget_m6"]["noise"]) == pytest.approx(0.6 * noise[1], rel=1e-6)


def test_far_coordinates_change_nothing(save, volume):
    r = np.round(scattered(2000, 13, cone, 0.01), 4)
    near, far = (
        volume(save("a.csv", r), "--level", 0.5),
        volume(save("b.csv", r + np.array([499_000, 5_432_000, 250])), "--level", 250.5),
    )
    assert far["net_m3"] == pytest.approx(near["net_m3"], rel=1e-6) and far[
        "sigma_m3"
    ] == pytest.approx(near["sigma_m3"], rel=1e-3)


def test_a_person_sees_a_short_table(save, capsys):
    cloud = save("c.csv", scattered(2000, 14, cone, 0.02))
    assert main(["volume", str(cloud), "--level", "0", "--levels", "-0.2", "3", "0.1"]) == 0
    shown = capsys.readouterr().out
    assert (
        "net volume" in shown
        and "±" in shown
        and "folded normal" in shown
        and "level 0.000 m" in shown
        and "flat part" in shown
    )
    assert main(["volume", str(save("r.csv", ROOF)), "--level", "0"]) == 0
    shown = capsys.readouterr().out
    assert "16.0000" in shown and "nan" not in shown and "too few" in shown


def test_wrong_words_are_one_line(save, tmp_path, capsys):
    cloud, other = (
        save("c.csv", scattered(200, 15)),
        save("d.csv", scattered(200, 16) + np.array([100, 0, 0])),
    )
    bad, flat = save("bad.csv", scattered(3, 17)), tmp_path / "line.csv"
    bad.write_text("x,y,z\n1,2,nan\n")
    flat.write_text("x,y,z\n" + "\n".join(f"{k},{k},0" for k in range(50)))
    sigma = save("s.csv", scattered(200, 18), {"sigma": np.full(200, -1.0)})
    cases = [
        ([tmp_path / "none.ply", "--level", 0], "no such file"),
        ([tmp_path / "none.fls", "--level", 0], "no known kind"),
        ([bad, "--level", 0], "not finite"),
        ([flat, "--level", 0], "collinear"),
        ([sigma, "--level", 0], "holds no standard deviations"),
        ([cloud, other], "no area in common"),
        ([cloud, "--base", "level"], "go together"),
        ([cloud, "--base", "plane"], "go together"),
        ([cloud, "--base", "ground", "--level", 1], "go together"),
        ([cloud, "--base", "floor"], "needs --levels"),
        ([cloud, "--levels", 0, 1, 0], "make no sequence"),
        ([cloud, "--levels", 1, 0, 0.1], "make no sequence"),
        ([cloud, "--levels", 50, 51, 0.1], "no level stands out"),
        ([cloud, other, "--level", 0], "--footprint own"),
        ([cloud, "--footprint", "own", "--level", 0], "two clouds"),
        ([cloud, "--base", "ground", "--frame", "scan"], "level frame"),
        ([cloud, "--level", 0, "--scanner", 0, 0, 1], "--frame scan"),
        ([cloud, "--level", 0, "--vertices", 1.5], "whole number"),
        ([cloud, "--level", 0, "--vertices", 0], "whole number"),
        ([cloud, "--level", 0, "--relevant", "edge"], "go together"),
        ([cloud, "--level", 0, "--max-edge", 1e-3], "no relevant triangle"),
        ([cloud, "--level", 0, "--sigma", -1], "0 or more"),
        ([cloud, "--level", 0, "--window", 50, 50, 60, 60], "three points, there are 0"),
        ([cloud, "--level", 0, "--set", "filter.radius_m=1"], "'volume' and 'ground'"),
        ([cloud, "--level", 0, "--set", "volume.base=plane"], "use --base"),
        ([cloud, "--level", 0, "--set", "volume.confidance=0.9"], "did you mean 'confidence'"),
        ([cloud, "--level", 0, "--outline", "auto"], "nothing rises"),
        ([cloud, cloud, "--outline", "auto"], "common footprint"),
    ]
    for words, text in cases:
        assert main(["volume", *map(str, words)]) == 2, words
        err = capsys.readouterr().err
        assert text in err and "Traceback" not in err and err.count("\n") == 1, (words, err)
    for words in (
        [],
        [cloud, "--level", "nan"],
        [cloud, "--level", "inf"],
        [cloud, "--base", "sea"],
        [cloud, "--level", 0, "--criterion", "best"],
    ):
        with pytest.raises(SystemExit):
            main(["volume", *map(str, words)])


def test_both_published_methods_with_an_offset(save, volume, capsys):
    # a block on a plane that the first scan shows 0.3 m higher; its walls slant over one spacing
    def block(xy):
        return 2.0 * ((np.abs(xy[:, 0]) < 0.5) & (np.abs(xy[:, 1]) < 1.0))

    g = np.linspace(-6.0, 6.0, 241)
    xy = np.stack(np.meshgrid(g, g), axis=-1).reshape(-1, 2)
    one = save("one.ply", np.c_[xy, block(xy) + 0.3])
    two = save("two.ply", np.c_[xy, 0.0 * xy[:, 0]])
    options = (one, two, "--footprint", "own", "--clean", "off", "--sigma", 0.001)
    for method, part in ((1, "fill"), (2, "cut")):
        facts = volume(*options, "--method", method, "--offset", 0.3)
        assert facts["net_m3"] == pytest.approx(2.0 * 0.95 * 1.95, rel=1e-3)
        assert facts["pairs"]["part"] == part and facts["pairs"]["offset_m"] == 0.3
        assert facts["pairs"]["volume_m3"] == pytest.approx([facts["net_m3"]], rel=1e-3)
        without = volume(*options, "--method", method)
        assert without["net_m3"] == pytest.approx(facts["net_m3"] + 0.3 * 144.0, rel=2e-2)
    levels = ("--levels", -1.0, -0.5, 0.1)
    pairs = volume(*options, "--method", 2, "--offset", 0.3, *levels)["pairs"]
    assert len(pairs["volume_m3"]) == 6 and abs(pairs["slope_m2"]) < 1e-6
    assert main(["volume", *map(str, (*options, "--method", 2, "--offset", 0.3, *levels))]) == 0
    assert "per centimetre of level" in capsys.readouterr().out
    front = volume(*options, "--method", 1, "--offset", 0.3, "--levels", 2.4, 3.4, 0.5)["pairs"]
    assert front["volume_m3"] == pytest.approx([2.0 * 0.95 * 1.95] * 3, rel=1e-3)
    assert main(["volume", *map(str, (*options, "--method", 1, "--offset", 0.3, *levels))]) == 2
    assert "cuts the body" in capsys.readouterr().err
    for words in (["--method", "1", "--level", "0"], ["--method", "1", "--footprint", "common"]):
        assert main(["volume", str(one), str(two), "--footprint", "own", *words]) == 2


def test_published_settings_of_the_ground_have_names(tmp_path, volume):
    rng = np.random.default_rng(3)
    xy = rng.uniform(-5.0, 5.0, (3000, 2))
    z = np.maximum(1.0 - np.hypot(*xy.T) / 2.0, 0.0) + 0.01 * rng.normal(size=3000)
    cloud = tmp_path / "cone.npy"
    np.save(cloud, np.c_[xy, z])
    own = volume(cloud, "--base", "ground")
    named = volume(cloud, "--base", "ground", "--ground-preset", "box")
    by_hand = [
        word
        for key in ("trials=1000", "sample_size=10", "threshold_m=0.05", "below_weight=0")
        for word in ("--set", f"ground.{key}")
    ]
    assert named["net_m3"] == volume(cloud, "--base", "ground", *by_hand)["net_m3"]
    assert named["net_m3"] == pytest.approx(own["net_m3"], rel=0.02)
    with pytest.raises(AssertionError):
        volume(cloud, "--level", 0, "--ground-preset", "box")
