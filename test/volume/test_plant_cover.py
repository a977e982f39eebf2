"""Plants of a height that the user knows, and plants that only their scatter tells of."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from volume_surfaces import cone, platform, surface_update

from ladar_volume.cli.main import main
from ladar_volume.io.pointfiles.cloud_files import write_cloud
from ladar_volume.model.errors import ParameterValueError
from ladar_volume.model.parameters import Parameters
from ladar_volume.tin.full_tin import build_tin, footprint_areas
from ladar_volume.volume.estimator import VolumeEstimator
from ladar_volume.volume.field_checks.plant_cover import (
    bush_doubts,
    bush_volume,
    cover_sigma,
    known_cover,
)

CONE, FOOT_M2 = math.pi * 16.0, math.pi * 16.0
GRASS_M, SIGMA_M = 0.1, 0.03


def read(**volume):
    return Parameters.read({"filter": {"nav_bin_s": 1.0}, "volume": volume}).checked()


def estimate(height, **volume):
    e = VolumeEstimator(read(**volume))
    e.add_platform(platform())
    e.add(surface_update(height, spacing=0.25))
    return e.estimate().volume


def in_grass(x, y):
    """A cone of 3 m on level ground, out of grass that returns see 10 cm above the soil."""
    return np.maximum(GRASS_M, cone(x, y))


def overgrown(x, y):
    """The same, grass on the cone alone."""
    return cone(x, y) + GRASS_M * (np.hypot(x, y) < 4.0)


def test_grass_around_a_cone_is_put_right_where_its_height_is_given():
    seen, right = estimate(in_grass), estimate(in_grass, ground_cover_m=[GRASS_M, SIGMA_M])
    assert seen.volume_m3 < CONE - 0.9 * GRASS_M * FOOT_M2 and seen.cover_m3 == 0.0
    assert right.volume_m3 == pytest.approx(CONE, abs=0.1 * GRASS_M * FOOT_M2)
    assert right.cover_m3 == pytest.approx(right.volume_m3 - seen.volume_m3)
    assert right.cut_m3 - right.fill_m3 == pytest.approx(right.volume_m3)
    assert math.sqrt(right.budget_m6["vegetation"]) == pytest.approx(SIGMA_M * FOOT_M2, rel=0.15)
    assert sum(right.budget_m6.values()) == pytest.approx(right.sigma_m3**2)


def test_plants_on_the_body_are_taken_off_and_cancel_those_around_it():
    right = estimate(overgrown, body_cover_m=[GRASS_M, SIGMA_M])
    assert right.volume_m3 == pytest.approx(CONE, abs=0.1 * GRASS_M * FOOT_M2)
    assert right.cover_m3 < -0.85 * GRASS_M * FOOT_M2
    given = [GRASS_M, SIGMA_M]
    both = estimate(cone, ground_cover_m=given, body_cover_m=given)
    assert both.cover_m3 == 0.0 and both.volume_m3 == estimate(cone).volume_m3
    wide = math.sqrt(2.0) * SIGMA_M * FOOT_M2
    assert math.sqrt(both.budget_m6["vegetation"]) == pytest.approx(wide, rel=0.15)


def test_grass_around_does_nothing_to_a_volume_above_a_level():
    level = {"base": "level", "level_m": 0.2}
    bare, grassy = estimate(cone, **level), estimate(cone, ground_cover_m=[0.1, 0.1], **level)
    assert (grassy.volume_m3, grassy.sigma_m3) == (bare.volume_m3, bare.sigma_m3)
    body = estimate(cone, body_cover_m=[0.1, 0.02], **level)
    assert body.cover_m3 == pytest.approx(-0.1 * body.area_m2)


def test_plants_are_in_sigma_unless_the_user_knows_of_them():
    v = read(ground_cover_m=[0.0, 0.0]).volume
    known = known_cover(v, own_ground=True)
    assert known.ground and not known.body and known.shift_m == known.sigma_m == 0.0
    sigma, doubts = cover_sigma(0.0, 0.0, 50.0, 100.0)
    assert sigma == 0.0 and not doubts
    for ground, body, word in ((0.01, 0.0, "ground_cover_m"), (0.0, 0.01, "body_cover_m")):
        sigma, doubts = cover_sigma(ground, body, 50.0, 100.0)
        assert sigma == pytest.approx(2.0) and word in doubts[0].text
    assert cover_sigma(0.0, 1.0, 50.0, 100.0)[0] == 100.0


def plane_of_patches(faces=False):
    """Ten by ten metres of patches that scatter by 1 cm, by 5 cm on 2 by 2 m in the middle, which
    with ``faces`` lie along a wall.
    """
    u = np.arange(0.0, 10.01, 0.25)
    xy = np.stack(np.meshgrid(u, u), axis=-1).reshape(-1, 2)
    tin = build_tin(np.column_stack([xy, np.zeros(len(xy))]))
    bush = (np.abs(tin.vertices[:, :2] - 5.0) <= 1.0).all(axis=1)
    on_face = bush & (np.abs(tin.vertices[:, 0] - 5.0) < 0.1) & faces
    return tin, footprint_areas(tin.vertices, tin.triangles), np.where(bush, 0.05, 0.01), on_face


def test_single_plants_on_a_body_are_what_scatters_beyond_the_rest():
    tin, part, scatter, on_face = plane_of_patches()
    found = bush_volume(tin, part, scatter, on_face, 0.6)
    assert 0.8 < found / (4.0 * math.sqrt(0.05**2 - 0.01**2)) < 1.3
    tripled = bush_volume(tin, 3.0 * part, scatter, on_face, 0.6)
    assert tripled == pytest.approx(3.0 * found)
    assert bush_volume(tin, part, np.full(len(scatter), 0.02), on_face, 0.6) == 0.0
    assert bush_volume(tin, 0.0 * part, scatter, on_face, 0.6) == 0.0


def test_breaks_of_the_slope_are_no_plants():
    tin, part, scatter, on_face = plane_of_patches()
    assert bush_volume(tin, part, scatter, on_face, 0.6) > 0.0
    assert bush_volume(tin, part, scatter, on_face, 0.7) == 0.0


def test_patches_along_steep_faces_are_no_plants():
    whole = bush_volume(*plane_of_patches(), 0.6)
    assert bush_volume(*plane_of_patches(faces=True), 0.6) < 0.7 * whole


def test_single_plants_are_doubted_beyond_a_sigma():
    assert not bush_doubts(0.9, 1.0)
    assert bush_doubts(1.1, 1.0)[0].name == "vegetation"


@pytest.mark.parametrize(
    ("given", "word"),
    [
        ({"ground_cover_m": [0.1]}, "two numbers"),
        ({"body_cover_m": [0.1, 0.1, 0.1]}, "two numbers"),
        ({"body_cover_m": [-0.1, 0.1]}, "body_cover_m"),
        ({"kind": "bodies", "ground_cover_m": [0.1, 0.1]}, "kind surface"),
    ],
)
def test_a_height_and_its_sigma_are_two_numbers(given, word):
    with pytest.raises(ParameterValueError, match=word):
        read(**given)


@pytest.fixture(scope="module")
def meadow(tmp_path_factory):
    """Files of a cone out of grass, from soil to 20 cm, and of a second day."""
    rng = np.random.default_rng(3)
    xy = rng.uniform(-9.0, 9.0, (40_000, 2))
    soil = cone(*xy.T)
    z = np.where(soil > 0.0, soil, rng.uniform(0.0, 2.0 * GRASS_M, len(xy)))
    folder = tmp_path_factory.mktemp("meadow")
    write_cloud(folder / "one.ply", np.c_[xy, z + rng.normal(0.0, 0.005, len(xy))], None)
    return folder


def said(capsys, meadow, *words):
    code = main(["volume", str(meadow / "one.ply"), "--units", "m", "--json", *map(str, words)])
    out = capsys.readouterr()
    return code, json.loads(out.out) if code == 0 else None, out.err


def test_a_cloud_with_grass_is_put_right_too(meadow, capsys):
    given = f"volume.ground_cover_m=[{GRASS_M},{SIGMA_M}]"
    _, seen, _ = said(capsys, meadow)
    _, right, _ = said(capsys, meadow, "--set", given)
    names = {d["name"] for d in seen["verdict"]["reasons"]}
    assert "vegetation" in names and seen["cover_m3"] == 0.0
    assert "vegetation" not in {d["name"] for d in right["verdict"]["reasons"]}
    assert abs(right["net_m3"] - CONE) < 2.0 * right["sigma_m3"] < 5.0
    assert right["net_m3"] - right["cover_m3"] == pytest.approx(seen["net_m3"])
    assert math.sqrt(right["budget_m6"]["vegetation"]) == pytest.approx(SIGMA_M * FOOT_M2, rel=0.2)


def test_a_volume_of_unknown_noise_is_put_right_too(tmp_path, capsys):
    roof = np.array([(0, 0, 0.5), (4, 0, 1), (4, 3, 2), (0, 3, 1), (2, 1.5, 3)], float)
    write_cloud(tmp_path / "one.ply", roof, None)
    level = ("--level", "0", "--set", "volume.body_cover_m=[0.1,0.02]")
    _, found, _ = said(capsys, tmp_path, *level)
    _, seen, _ = said(capsys, tmp_path, "--level", "0")
    assert found["sigma_m3"] is None
    assert found["net_m3"] == pytest.approx(seen["net_m3"] - 0.1 * 12.0)


def test_piles_are_put_right_above_every_base(meadow, capsys):
    words = ("--piles", "found", "--base", "toe_plane")
    _, seen, _ = said(capsys, meadow, *words)
    given = f"volume.ground_cover_m=[{GRASS_M},{SIGMA_M}]"
    _, right, _ = said(capsys, meadow, *words, "--set", given)
    before, after = seen["piles"][0], right["piles"][0]
    assert after["cover_m3"] == pytest.approx(GRASS_M * FOOT_M2, rel=0.15)
    for name, base in after["bases"].items():
        more = base["net_m3"] - before["bases"][name]["net_m3"]
        assert more == pytest.approx(after["cover_m3"], rel=0.02), name
    assert right["net_m3"] == pytest.approx(after["net_m3"])


@pytest.mark.parametrize("words", [["--levels", 0, 1, 0.5], ["--level", 0, "--frame", "scan"]])
def test_plants_are_of_one_surface_above_one_base(words, meadow, capsys):
    given = ("--set", "volume.ground_cover_m=[0.1,0.02]")
    code, _, err = said(capsys, meadow, *words, *given)
    assert code == 2 and "leave out" in err and err.count("\n") == 1
