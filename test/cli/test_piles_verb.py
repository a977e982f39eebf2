"""``ladar_volume volume --piles``: rows, tonnes, shared errors, files and refusals."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

import ladar_volume as lv
from ladar_volume.cli.main import main

pytest.importorskip("pyogrio", reason="pyogrio is not installed")
pytest.importorskip("shapely", reason="shapely is not installed")

#: Piles: centre, radius, height.
CONES = {"A": (-7.0, -4.0, 4.0, 2.0), "B": (6.0, 5.0, 5.0, 3.0)}

#: What the outlines say of it.
GRAVEL = {"material": "gravel", "density": 1.6, "density_sigma": 0.1}


def octagon(x, y, r):
    a = 2.0 * np.pi * (np.arange(8) + 0.3) / 8
    return np.column_stack([x + r * np.cos(a), y + r * np.sin(a)])


@pytest.fixture(scope="module")
def yard(tmp_path_factory):
    """Two piles on sloping ground, their outlines with densities, and the ground before."""
    folder = tmp_path_factory.mktemp("yard")
    rng = np.random.default_rng(4)
    xy = rng.uniform(-15.0, 15.0, (4000, 2))
    ground = 100.0 + 0.02 * xy[:, 0] + rng.normal(0.0, 0.01, len(xy))
    z = ground.copy()
    for x, y, r, h in CONES.values():
        z += np.maximum(0.0, h * (1.0 - np.hypot(xy[:, 0] - x, xy[:, 1] - y) / r))
    np.savetxt(folder / "yard.xyz", np.column_stack([xy, z]), fmt="%.6f")
    np.savetxt(folder / "before.xyz", np.column_stack([xy, ground]), fmt="%.6f")
    features = [
        {
            "type": "Feature",
            "properties": {
                "name": name,
                "material": "gravel",
                "density": 1.6,
                "density_sigma": 0.1,
            },
            "geometry": {
                "type": "Polygon",
                "coordinates": [np.vstack([ring, ring[:1]]).tolist()],
            },
        }
        for name, ring in ((n, octagon(x, y, r + 1.5)) for n, (x, y, r, _) in CONES.items())
    ]
    text = json.dumps({"type": "FeatureCollection", "features": features})
    (folder / "piles.geojson").write_text(text)
    return folder


def ran(capsys, *words):
    """Exit code, JSON or None, and the error."""
    code = main([str(word) for word in words])
    out = capsys.readouterr()
    return code, json.loads(out.out) if out.out.startswith("{") else None, out.err


def volume(capsys, folder, *words, below=()):
    clouds = [folder / "yard.xyz", *below]
    code, facts, err = ran(capsys, "volume", *clouds, "--units", "m", "--json", *words)
    assert code == 0, err
    return facts


def cone(name):
    _, _, r, h = CONES[name]
    return np.pi * r * r * h / 3.0


def test_a_row_for_each_pile_with_every_base_and_tonnes(yard, capsys):
    facts = volume(capsys, yard, "--piles", yard / "piles.geojson", "--base", "toe_plane")
    for row in facts["piles"]:
        assert row["net_m3"] == pytest.approx(cone(row["name"]), rel=0.02)
        assert row["mass_t"] == pytest.approx(1.6 * row["net_m3"])
        parts = np.hypot(1.6 * row["sigma_m3"], 0.1 * row["net_m3"])
        assert row["sigma_mass_t"] == pytest.approx(parts)
        assert set(row["bases"]) >= {"ground", "site_ground", "toe_tin", "toe_lowest"}
        assert row["bases"]["toe_plane"]["net_m3"] == row["net_m3"]
        assert row["bases"]["toe_lowest"]["net_m3"] > row["bases"]["toe_highest"]["net_m3"]
    assert facts["net_m3"] == pytest.approx(sum(r["net_m3"] for r in facts["piles"]))
    # one density is wrong in both alike
    by_density = 0.1 * facts["net_m3"]
    assert facts["sigma_mass_t"] > by_density
    assert facts["sigma_mass_holds"] == "volume and density"
    assert facts["outlines"]["piles"] == 2


def test_the_table_shows_piles_and_bases(yard, capsys):
    words = ("--units", "m", "--piles", str(yard / "piles.geojson"))
    assert main(["volume", str(yard / "yard.xyz"), *words]) == 0
    out = capsys.readouterr().out
    assert "A, gravel" in out and "toe_tin" in out and "V / m³ by base" in out and " t (" in out


def test_without_a_base_the_choice_is_in_sigma(yard, capsys):
    facts = volume(capsys, yard, "--piles", yard / "piles.geojson")
    assert facts["base"].startswith("ground around each pile")
    assert facts["budget_m6"]["base_choice"] > 0.0


def test_found_piles_need_no_file(yard, capsys):
    facts = volume(capsys, yard, "--piles", "found", "--density", 2.0)
    assert [row["name"] for row in facts["piles"]] == ["pile 1", "pile 2"]
    nets = [row["net_m3"] for row in facts["piles"]]
    assert nets == pytest.approx([cone("B"), cone("A")], rel=0.02)
    assert facts["piles"][0]["sigma_mass_holds"] == "volume only"
    assert facts["mass_t"] == pytest.approx(2.0 * facts["net_m3"])


def test_the_survey_before_is_a_base(yard, capsys):
    words = ("--piles", yard / "piles.geojson")
    facts = volume(capsys, yard, *words, below=[yard / "before.xyz"])
    for row in facts["piles"]:
        assert row["net_m3"] == pytest.approx(cone(row["name"]), rel=0.02)
    assert facts["base"] == "surface of before.xyz"


def test_heights_that_are_wrong_alike_widen_what_stands_above_a_level(yard, capsys):
    words = ("--piles", yard / "piles.geojson", "--level", 100)
    quiet = volume(capsys, yard, *words)
    wide = volume(capsys, yard, *words, "--height-sigma", 0.03)
    near = volume(capsys, yard, *words, "--height-sigma", 0.03, "--correlation", 5)
    assert "only" in quiet["sigma_holds"] and "height_error" in wide["sigma_holds"]
    assert wide["budget_m6"]["height_error"] == pytest.approx((0.03 * wide["area_m2"]) ** 2)
    assert quiet["sigma_m3"] < near["sigma_m3"] < wide["sigma_m3"]
    assert wide["shared_errors"] == {"height_error": {"sigma_m": 0.03, "correlation_m": None}}
    # the same for one surface without piles
    alone = volume(capsys, yard, "--level", 99, "--height-sigma", 0.03)
    assert alone["budget_m6"]["height_error"] == pytest.approx((0.03 * alone["area_m2"]) ** 2)
    # two surveys are wrong independently
    pair = volume(capsys, yard, "--height-sigma", 0.03, below=[yard / "before.xyz"])
    both = 2.0 * (0.03 * pair["area_m2"]) ** 2
    assert pair["budget_m6"]["height_error"] == pytest.approx(both)


def test_a_budget_of_several_errors(yard, capsys):
    file = yard / "errors.yaml"
    file.write_text(
        "height_errors:\n  - {name: datum, sigma_m: 0.01}\n"
        "  - {name: trajectory, sigma_m: 0.02, correlation_m: 30}\n"
    )
    facts = volume(capsys, yard, "--level", 99, "--budget", file)
    assert facts["budget_m6"]["datum"] == pytest.approx((0.01 * facts["area_m2"]) ** 2)
    assert 0.0 < facts["budget_m6"]["trajectory"] < (0.02 * facts["area_m2"]) ** 2
    lines = sum(facts["budget_m6"].values())
    assert facts["sigma_m3"] ** 2 == pytest.approx(lines, rel=1e-6)


def test_files_and_report_hold_every_pile(yard, tmp_path, capsys):
    out, page = tmp_path / "out", tmp_path / "report.html"
    words = ("-o", out, "--as", "csv,geojson,json,landxml", "--report", page)
    facts = volume(capsys, yard, "--piles", yard / "piles.geojson", "--base", "toe_tin", *words)
    rows = list(csv.DictReader((out / "volumes.csv").open(encoding="utf-8")))
    assert [row["name"] for row in rows] == ["A", "B"]
    assert [float(row["volume_m3"]) for row in rows] == [r["net_m3"] for r in facts["piles"]]
    shapes = json.loads((out / "outline.geojson").read_text())["features"]
    assert [f["properties"]["name"] for f in shapes] == ["A", "B"]
    for shape, (x, y, r, _) in zip(shapes, CONES.values(), strict=True):
        ring = np.array(shape["geometry"]["coordinates"][0])[:-1, :2]
        assert ring == pytest.approx(octagon(x, y, r + 1.5), abs=1e-6)
    surfaces = (out / "surface.xml").read_text(encoding="utf-8")
    assert '<Surface name="counted"' in surfaces and '<Surface name="around"' in surfaces
    text = page.read_text(encoding="utf-8")
    assert "Volume by base" in text and "gravel" in text


@pytest.mark.parametrize("crs", [(), ("--crs", "EPSG:25832")])
def test_piles_come_back_from_the_written_outlines(yard, tmp_path, crs, capsys):
    """In UTM the file is in degrees, without a CRS in the numbers of the points."""
    cloud = tmp_path / "yard.xyz"
    r = np.loadtxt(yard / "yard.xyz")
    np.savetxt(cloud, np.add(r, [433_000.0, 5_100_000.0, 0.0]), fmt="%.6f")
    words = ("volume", cloud, "--units", "m", *crs, "--base", "toe_plane", "--json")
    out = ("-o", tmp_path / "out", "--as", "geojson")
    first = ran(capsys, *words, "--piles", "found", *out)[1]
    code, again, err = ran(capsys, *words, "--piles", tmp_path / "out" / "outline.geojson")
    assert code == 0, err
    assert again["verdict"] == first["verdict"] and len(again["piles"]) == 2
    for one, two in zip(first["piles"], again["piles"], strict=True):
        assert two["name"] == one["name"]
        assert two["net_m3"] == pytest.approx(one["net_m3"], rel=1e-6)


def test_the_schema_holds_results_of_piles(yard, capsys):
    jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed")
    text = (Path(__file__).parents[2] / "docs" / "result.schema.json").read_text(encoding="utf-8")
    schema = jsonschema.Draft202012Validator(json.loads(text))
    facts = volume(capsys, yard, "--piles", yard / "piles.geojson")
    schema.validate(facts)
    assert not schema.is_valid({**facts, "piles": []})
    far = {**facts["piles"][0], "bases": {"ground": {"net_m3": "3"}}}
    assert not schema.is_valid({**facts, "piles": [far]})


def test_the_api_takes_the_same_options(yard):
    found = lv.volume(yard / "yard.xyz", base="toe_plane", piles=yard / "piles.geojson", units="m")
    assert len(found.facts["piles"]) == 2 and found.status == "sound"


def test_a_pile_beyond_the_survey_is_a_row_that_says_why(yard, tmp_path, capsys):
    shapes = json.loads((yard / "piles.geojson").read_text())
    far = octagon(80.0, 0.0, 3.0)
    shapes["features"].append(
        {
            "type": "Feature",
            "properties": {"name": "far"},
            "geometry": {"type": "Polygon", "coordinates": [np.vstack([far, far[:1]]).tolist()]},
        }
    )
    (tmp_path / "more.geojson").write_text(json.dumps(shapes))
    facts = volume(capsys, yard, "--piles", tmp_path / "more.geojson", "--base", "toe_plane")
    last = facts["piles"][-1]
    assert (last["name"], last["net_m3"], last["verdict"]["status"]) == ("far", None, "refused")
    assert facts["verdict"]["status"] == "doubtful"
    assert "pile_refused" in [r["name"] for r in facts["verdict"]["reasons"]]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--base", "toe_tin"), "goes with --piles"),
        (("--piles", "P", "--levels", "1", "2", "1"), "--levels does not go with --piles"),
        (("--piles", "P", "--outline", "all"), "--outline does not go with --piles"),
        (("--piles", "P", "--base", "floor"), "--base floor does not go with --piles"),
        (("--piles", "P", "--base", "level"), "--base level and --level go together"),
        (("--piles", "P", "--base", "toe_tin", "--level", "3"), "exclude each other"),
        (("--piles", "P", "--density-sigma", "0.1"), "--density-sigma alone"),
        (("--level", "3", "--density", "1.6"), "--density goes with --piles"),
        (("--level", "3", "--correlation", "30"), "--correlation goes with --height-sigma"),
        (("--level", "3", "--budget", "missing.yaml"), "missing.yaml"),
        (("--piles", "missing.geojson"), "no such file"),
    ],
)
def test_options_that_do_not_go_together_are_refused(yard, capsys, words, says):
    words = [str(yard / "piles.geojson") if word == "P" else word for word in words]
    code, _, err = ran(capsys, "volume", yard / "yard.xyz", "--units", "m", *words)
    assert code == 2
    assert says in err and err.count("\n") == 1


def test_without_pyogrio_the_error_names_what_to_install(yard, capsys, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyogrio", None)
    words = ("--units", "m", "--piles", yard / "piles.geojson")
    code, _, err = ran(capsys, "volume", yard / "yard.xyz", *words)
    assert code == 2 and "ladar_volume[geo]" in err


REAL = Path(__file__).parents[3] / "shared" / "data" / "isprs_ground" / "samp21.pcd"


@pytest.mark.skipif(not REAL.exists(), reason="the airborne samples are not here")
def test_an_outline_over_uneven_ground_of_a_real_survey_is_doubtful(tmp_path, capsys):
    ring = "513546 5403208, 513596 5403208, 513596 5403254, 513546 5403254, 513546 5403208"
    (tmp_path / "area.wkt").write_text(f"POLYGON(({ring}))")
    for base in ("ground", "toe_plane", "toe_tin"):
        words = ("--units", "m", "--piles", tmp_path / "area.wkt", "--base", base, "--json")
        code, facts, _ = ran(capsys, "volume", REAL, *words)
        assert code == 0
        assert facts["piles"][0]["verdict"]["status"] == "doubtful"
    words = ("--units", "m", "--piles", "found", "--json")
    code, facts, _ = ran(capsys, "volume", REAL.with_name("samp11.pcd"), *words)
    assert code == 0 and facts["verdict"]["status"] == "doubtful"
    assert {p["verdict"]["status"] for p in facts["piles"]} == {"doubtful", "refused"}
