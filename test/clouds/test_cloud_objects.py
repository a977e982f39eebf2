"""What stands on the surface of a cloud is taken out before its volume, and named."""

import json
import math

import numpy as np
import pytest

from ladar_volume.cli.main import main
from ladar_volume.clouds.sampling.cloud_objects import beside

RADIUS, HIGH = 6.0, 3.6
TRUE_M3 = math.pi * RADIUS**2 * HIGH / 3.0


def cone(xy):
    return HIGH * np.clip(1.0 - np.hypot(*xy.T) / RADIUS, 0.0, None)


def site(seed, density=15.0, half=13.0):
    """Points (n, 2) of a square, and their noise."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-half, half, (rng.poisson(density * (2.0 * half) ** 2), 2))
    return rng, xy, rng.normal(0.0, 0.012, len(xy))


def measured(tmp_path, capsys, points, *options):
    np.save(tmp_path / "cloud.npy", points)
    code = main(
        ["volume", str(tmp_path / "cloud.npy"), "--base", "ground", "--json", *options],
    )
    assert code == 0
    return json.loads(capsys.readouterr().out)


def names(facts):
    return {reason["name"] for reason in facts["verdict"]["reasons"]}


def holds(facts, true_m3=TRUE_M3):
    return abs(facts["net_m3"] - true_m3) < 3.0 * facts["sigma_m3"]


def test_wires_over_a_pile_are_no_volume(tmp_path, capsys):
    rng, xy, noise = site(1)
    wire = np.c_[rng.uniform(-13.0, 13.0, 400), rng.choice([-1.0, 1.0], 400)]
    points = np.r_[
        np.c_[xy, cone(xy) + noise], np.c_[wire, 9.0 + 0.01 * wire[:, 0] ** 2 + 0.0 * wire[:, 1]]
    ]
    facts = measured(tmp_path, capsys, points)
    assert holds(facts) and facts["sigma_m3"] < 0.02 * TRUE_M3
    assert names(facts) <= {"object", "further_bodies"} and "object" in names(facts)
    assert facts["objects"][0]["high_m"] > 5.0
    counted = measured(tmp_path, capsys, points, "--set", "volume.objects=count")
    assert counted["net_m3"] > TRUE_M3 + 10.0 and counted["objects"] == []


@pytest.mark.parametrize("seed", [2, 3])
def test_crowns_and_a_container_are_taken_out(tmp_path, capsys, seed):
    rng, xy, noise = site(seed)
    z = cone(xy)
    container = (np.abs(xy[:, 0] - 5.5) < 1.2) & (np.abs(xy[:, 1]) < 3.0)
    z[container] = 2.6
    for at in ((-3.0, -3.5), (8.0, 9.0)):
        crown = (np.hypot(*(xy - at).T) < 1.8) & (rng.random(len(xy)) < 0.6)
        z[crown] += rng.uniform(3.0, 6.0, int(crown.sum()))
    facts = measured(tmp_path, capsys, np.c_[xy, z + noise])
    assert holds(facts) and facts["sigma_m3"] < 0.05 * TRUE_M3
    assert "object" in names(facts)
    place = min(math.hypot(one["x_m"] - 5.5, one["y_m"]) for one in facts["objects"])
    assert place < 1.0


def test_a_machine_with_points_on_its_faces_is_taken_out(tmp_path, capsys):
    """No edge of the dense cloud is a step."""
    rng, xy, noise = site(4, density=200.0, half=4.0)
    small = 0.3 * cone(xy / 0.3)
    inside = (np.abs(xy[:, 0] - 2.6) < 0.4) & (np.abs(xy[:, 1]) < 0.4)
    small[inside] = 1.0
    n = 4000
    side = rng.uniform(-0.4, 0.4, n)
    faces = np.c_[np.where(rng.random(n) < 0.5, -0.4, 0.4), side]
    faces[::2] = faces[::2, ::-1]
    faces = np.c_[faces + np.array([2.6, 0.0]), rng.uniform(0.02, 1.0, n)]
    faces[:, :2] += rng.normal(0.0, 0.005, (n, 2))
    points = np.r_[np.c_[xy, small + 0.2 * noise], faces]
    facts = measured(tmp_path, capsys, points)
    assert holds(facts, 0.027 * TRUE_M3)
    assert any(math.hypot(one["x_m"] - 2.6, one["y_m"]) < 0.3 for one in facts["objects"])


def drawn(tmp_path, x, y):
    """A file with a ring about the middle, half axes x, y, m."""
    a = np.linspace(0.0, 2.0 * np.pi, 33)
    ring = np.c_[x * np.cos(a), y * np.sin(a)]
    corners = ", ".join(f"{px:.6f} {py:.6f}" for px, py in ring)
    (tmp_path / "ring.wkt").write_text(f"POLYGON(({corners}))", encoding="utf-8")
    return ("--piles", str(tmp_path / "ring.wkt"))


def test_a_container_within_a_drawn_outline_is_taken_out(tmp_path, capsys):
    _, xy, noise = site(7)
    z = cone(xy)
    z[(np.abs(xy[:, 0] - 5.5) < 1.2) & (np.abs(xy[:, 1]) < 3.0)] = 2.6
    facts = measured(tmp_path, capsys, np.c_[xy, z + noise], *drawn(tmp_path, 7.0, 7.0))
    assert holds(facts) and facts["sigma_m3"] < 0.05 * TRUE_M3
    assert "object" in names(facts)


def test_a_box_for_which_an_outline_was_drawn_stays(tmp_path, capsys):
    _, xy, noise = site(8)
    z = np.where((np.abs(xy) < (3.0, 2.0)).all(axis=1), 1.5, 0.0)
    facts = measured(tmp_path, capsys, np.c_[xy, z + noise], *drawn(tmp_path, 4.6, 3.4))
    assert facts["objects"] == [] and facts["net_m3"] == pytest.approx(36.0, rel=0.05)


def test_an_upright_thing_beside_the_body_is_named(tmp_path, capsys):
    """It may be a heap between walls, and is not counted."""
    _, xy, noise = site(9, half=16.0)
    z = cone(xy)
    z[(np.abs(xy - 12.0) < 2.0).all(axis=1)] = 2.0
    points = np.c_[xy, z + noise]
    facts = measured(tmp_path, capsys, points)
    assert holds(facts) and "further_bodies" in names(facts)
    away = [math.hypot(one["x_m"] - 12.0, one["y_m"] - 12.0) for one in facts["objects"]]
    assert min(away) < 0.5
    assert main(["volume", str(tmp_path / "cloud.npy"), "--base", "ground"]) == 0
    assert "beside it" in capsys.readouterr().out
    both = measured(
        tmp_path, capsys, points, "--set", "volume.objects=count", "--set", "volume.bodies=0"
    )
    assert both["net_m3"] == pytest.approx(TRUE_M3 + 32.0, rel=0.03)


def test_small_things_beside_the_body_are_printed_and_no_doubt(tmp_path, capsys):
    _, xy, noise = site(11, half=16.0)
    z = cone(xy)
    z[(np.abs(xy - 12.0) < (0.9, 2.2)).all(axis=1)] = 1.5
    facts = measured(tmp_path, capsys, np.c_[xy, z + noise])
    assert holds(facts) and facts["verdict"]["status"] == "sound"
    assert [one["inside"] for one in facts["objects"]] == [False]


def test_things_are_taken_out_of_piles_that_are_found(tmp_path, capsys):
    rng, xy, noise = site(10, half=22.0)
    z = cone(xy - [-10.0, -8.0]) + cone(xy - [9.0, 8.0])
    z[(np.abs(xy - [12.0, 8.0]) < (1.0, 1.5)).all(axis=1)] += 2.2
    crown = (np.hypot(*(xy - [-16.0, 16.0]).T) < 1.8) & (rng.random(len(xy)) < 0.6)
    z[crown] += rng.uniform(3.0, 6.0, int(crown.sum()))
    facts = measured(tmp_path, capsys, np.c_[xy, z + noise], "--piles", "found")
    assert len(facts["piles"]) == 2 and holds(facts, 2.0 * TRUE_M3)
    assert all(holds(pile) for pile in facts["piles"])
    assert "object" in names(facts) and len(facts["objects"]) >= 2
    assert not all(one["inside"] for one in facts["objects"])


def test_a_box_is_the_body(tmp_path, capsys):
    _, xy, noise = site(5)
    z = np.where((np.abs(xy) < (3.0, 2.0)).all(axis=1), 1.5, 0.0)
    facts = measured(tmp_path, capsys, np.c_[xy, z + noise])
    assert facts["objects"] == [] and facts["net_m3"] == pytest.approx(36.0, rel=0.05)


def test_a_pile_against_a_wall_holds_it_in_sigma(tmp_path, capsys):
    """A cut and a wall are doubts, and lines of the budget."""
    _, xy, noise = site(6)
    z = np.where(xy[:, 0] > 3.0, 5.0, cone(xy))
    facts = measured(tmp_path, capsys, np.c_[xy, z + noise], "--set", "volume.objects=count")
    assert {"wall", "cut"} & names(facts)
    assert facts["budget_m6"].get("wall", 0.0) + facts["budget_m6"].get("cut", 0.0) > 1.0


@pytest.mark.parametrize("seed", range(8))
def test_places_beside_cells_as_by_comparison(seed):
    rng = np.random.default_rng(seed)
    xy, there = rng.uniform(-7.0, 9.0, (500, 2)), rng.uniform(-2.0, 4.0, (12, 2))
    cell = rng.uniform(0.2, 1.5)
    low = there.min(axis=0)
    one, two = np.floor((xy - low) / cell), np.floor((there - low) / cell)
    near = (np.abs(one[:, None] - two[None]) <= 1.0).all(axis=2).any(axis=1)
    np.testing.assert_array_equal(beside(xy, there, cell, there.min(axis=0)), np.flatnonzero(near))


def truck_on(xy, z, at=(8.0, 8.0)):
    z[(np.abs(xy[:, 0] - at[0]) < 2.5) & (np.abs(xy[:, 1] - at[1]) < 1.2)] = 3.0
    return z


SQUARE = "volume.polygon_m=[-10,-10,10,-10,10,10,-10,10]"
BASES = {
    "level": (("--level", "-0.5"), 0.5 * 26.0**2),
    "plane": (("--plane", "-0.5", "0", "0"), 0.5 * 26.0**2),
    "polygon": (("--level", "-0.5", "--set", "volume.outline=polygon", "--set", SQUARE), 200.0),
}


@pytest.mark.parametrize("base", BASES)
def test_a_truck_is_not_counted_above_a_level_either(tmp_path, capsys, base):
    options, below = BASES[base]
    _, xy, noise = site(9)
    np.save(tmp_path / "cloud.npy", np.c_[xy, truck_on(xy, cone(xy)) + noise])
    words = ["volume", str(tmp_path / "cloud.npy"), "--json", *options]
    assert main(words) == 0
    facts = json.loads(capsys.readouterr().out)
    edge = 0.01 * below  # of the hull, half a spacing within the square
    assert abs(facts["net_m3"] - TRUE_M3 - below) < edge + 3.0 * facts["sigma_m3"]
    assert "object" in names(facts) and 25.0 < facts["objects"][0]["volume_m3"] < 45.0
    assert main([*words, "--clean", "off"]) == 0
    counted = json.loads(capsys.readouterr().out)
    assert counted["net_m3"] - facts["net_m3"] > 25.0


WITHIN = ("--set", "volume.outline=polygon", "--set", "volume.polygon_m=[3,3,12,3,12,12,3,12]")


@pytest.mark.parametrize("options", [("--level", "0.05"), ("--base", "ground", *WITHIN)])
def test_a_truck_that_is_all_there_is_is_measured(tmp_path, capsys, options):
    _, xy, noise = site(10)
    np.save(tmp_path / "cloud.npy", np.c_[xy, truck_on(xy, 0.0 * noise) + noise])
    assert main(["volume", str(tmp_path / "cloud.npy"), "--json", *options]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["objects"] == [] and "object" not in names(facts)
    assert facts["cut_m3"] == pytest.approx(5.0 * 2.4 * 2.95, rel=0.15)
