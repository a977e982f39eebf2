"""One pile in metres, feet, feet and metres, degrees, with and without words about it: the same
volume, or a refusal that says what to do.
"""

from __future__ import annotations

import json

import laspy
import numpy as np
import pyproj
import pytest

from ladar_volume.cli.main import main
from ladar_volume.io.pointfiles.cloud_files import read_cloud, write_cloud

US_FOOT, FOOT = 1200.0 / 3937.0, 0.3048
#: UTM 10N, where California's zone 3 is near.
MIDDLE = np.array([552_000.0, 4_183_000.0, 50.0])
UTM, STATE, STATE_FT = "EPSG:26910", "EPSG:26943", "EPSG:2227"


def site(n=4000, seed=3):
    """A cone 9 m high and 24 m wide, and the floor about it, in m about its middle."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-20.0, 20.0, (n, 2))
    z = np.maximum(0.0, 9.0 * (1.0 - np.hypot(*xy.T) / 12.0))
    return np.column_stack([xy, z + rng.normal(0.0, 0.01, n)])


def state_plane():
    """The middle in the state's grid, m."""
    change = pyproj.Transformer.from_crs(UTM, STATE, always_xy=True)
    return np.array([*change.transform(*MIDDLE[:2]), 50.0])


def save_las(path, r, crs=None, point_format=6, version="1.4", scale=1e-4, **columns):
    header = laspy.LasHeader(point_format=point_format, version=version)
    header.scales = np.broadcast_to(scale, 3)
    header.offsets = np.floor(r.min(axis=0))
    if crs is not None:
        header.add_crs(pyproj.CRS.from_user_input(crs))
    las = laspy.LasData(header)
    las.x, las.y, las.z = r.T
    for name, values in columns.items():
        las[name] = values
    las.write(str(path))
    return path


@pytest.fixture
def volume(capsys):
    def call(*words):
        code = main(["volume", *map(str, words), "--json"])
        out = capsys.readouterr()
        return json.loads(out.out) if code == 0 else out.err

    return call


@pytest.fixture
def metres(tmp_path, volume):
    facts = volume(save_las(tmp_path / "m.las", site() + state_plane(), STATE), "--level", 50)
    assert facts["net_m3"] == pytest.approx(np.pi * 144 * 9 / 3, rel=0.01)
    return facts["net_m3"]


@pytest.mark.parametrize(
    "name,crs,across,up",
    [
        ("US survey feet, heights as well", "EPSG:2227+6360", US_FOOT, US_FOOT),
        ("US survey feet, no word about heights", STATE_FT, US_FOOT, US_FOOT),
        ("international feet", "EPSG:2223+8228", FOOT, FOOT),
        ("metres across, feet up", "EPSG:26943+6360", 1.0, US_FOOT),
        ("feet across, metres up", "EPSG:2227+5703", US_FOOT, 1.0),
        ("metres across and up", "EPSG:26943+5703", 1.0, 1.0),
    ],
)
def test_one_pile_in_the_units_of_its_header(name, crs, across, up, metres, volume, tmp_path):
    place = state_plane()
    if crs.startswith("EPSG:2223"):  # Arizona: the only grid with international feet at hand
        change = pyproj.Transformer.from_crs("EPSG:4269", "EPSG:26948", always_xy=True)
        place[:2] = change.transform(-110.0, 33.0)
        change = pyproj.Transformer.from_crs("EPSG:4269", "EPSG:2222", always_xy=True)
        crs = "EPSG:2222+8228"
        place[:2] = np.array(change.transform(-110.0, 33.0)) * FOOT
    r = (site() + place) / [across, across, up]
    facts = volume(save_las(tmp_path / "f.laz", r, crs), "--level", 50)
    assert facts["net_m3"] == pytest.approx(metres, rel=1e-5), name
    read = facts["surfaces"][0]["coordinates"]
    words = {US_FOOT: "US survey foot", FOOT: "international foot", 1.0: "metre"}
    assert (read["units_read"], read["units_read_z"]) == (words[across], words[up])
    assert read["heights"] == {
        "6360": "NAVD88 height (ftUS)",
        "8228": "NAVD88 height (ft)",
        "5703": "NAVD88 height",
    }.get(crs.partition("+")[2])
    # the header that says nothing of z leaves a doubt, which the user can settle
    assert (facts["verdict"]["status"] == "doubtful") == (crs == STATE_FT)
    if crs == STATE_FT:
        facts = volume(tmp_path / "f.laz", "--level", 50, "--units", "us-ft")
        assert facts["verdict"]["status"] == "sound"


@pytest.mark.parametrize("crs,utm", [("EPSG:4326", "EPSG:32610"), ("EPSG:4269", "EPSG:26910")])
def test_degrees_are_projected_to_their_zone(crs, utm, volume, tmp_path):
    r = site() + MIDDLE
    plain = volume(save_las(tmp_path / "m.las", r, utm), "--level", 50)
    lon, lat = pyproj.Transformer.from_crs(utm, crs, always_xy=True).transform(r[:, 0], r[:, 1])
    path = save_las(tmp_path / "d.laz", np.c_[lon, lat, r[:, 2]], crs, scale=(1e-9, 1e-9, 1e-4))
    facts = volume(path, "--level", 50)
    assert facts["net_m3"] == pytest.approx(plain["net_m3"], rel=1e-5)
    at = facts["surfaces"][0]["coordinates"]
    assert at["code"] == utm and at["units_read"] == "degree"
    # and in feet up, since the vertical part says so
    r_ft = np.c_[lon, lat, r[:, 2] / US_FOOT]
    path = save_las(tmp_path / "e.laz", r_ft, f"{crs}+6360", scale=(1e-9, 1e-9, 1e-4))
    assert volume(path, "--level", 50)["net_m3"] == pytest.approx(plain["net_m3"], rel=1e-5)


def test_degrees_on_a_sphere_have_no_zone(volume, tmp_path):
    r = np.c_[site()[:, :2] * 1e-5, site()[:, 2]]
    said = volume(save_las(tmp_path / "d.las", r, "EPSG:4047"), "--level", 50)
    assert "has no UTM zone" in said and "--crs" in said and said.count("\n") == 1


def test_degrees_without_a_word_are_refused_and_told_from_metres(volume, tmp_path):
    r = site() + MIDDLE
    lon, lat = pyproj.Transformer.from_crs(UTM, "EPSG:4326", always_xy=True).transform(*r.T[:2])
    write_cloud(tmp_path / "d.csv", np.c_[lon, lat, r[:, 2]])
    assert "look like degrees" in (error := volume(tmp_path / "d.csv", "--level", 50))
    assert "--crs EPSG:4326" in error and error.count("\n") == 1 and len(error) < 320
    plain = volume(save_las(tmp_path / "m.las", r, "EPSG:32610"), "--level", 50)["net_m3"]
    facts = volume(tmp_path / "d.csv", "--level", 50, "--crs", "EPSG:4326")
    assert facts["net_m3"] == pytest.approx(plain, rel=1e-5)
    text = "longitude,latitude,height\n" + "\n".join(
        f"{a:.10f},{b:.10f},{c:.4f}" for a, b, c in np.c_[lon, lat, r[:, 2]].tolist()
    )
    (tmp_path / "n.csv").write_text(text)
    assert "--crs" in volume(tmp_path / "n.csv", "--level", 50)
    facts = volume(tmp_path / "n.csv", "--level", 50, "--crs", "EPSG:4326")
    assert facts["net_m3"] == pytest.approx(plain, rel=1e-4)
    # a header in metres over degrees is a lie
    path = save_las(tmp_path / "l.las", np.c_[lon, lat, r[:, 2]], UTM, scale=(1e-9, 1e-9, 1e-4))
    assert "the header says" in volume(path, "--level", 50)


def test_which_column_is_longitude_is_not_guessed_in_silence(volume, tmp_path):
    r = site(600) + np.array([400_000.0, 5_550_000.0, 50.0])
    lon, lat = pyproj.Transformer.from_crs("EPSG:32632", "EPSG:4326", always_xy=True).transform(
        *r.T[:2]
    )
    doubts = {}
    for name, columns in (("right", [lon, lat, r[:, 2]]), ("other", [lat, lon, r[:, 2]])):
        np.savetxt(tmp_path / f"{name}.xyz", np.c_[tuple(columns)], fmt="%.10f")
        facts = volume(tmp_path / f"{name}.xyz", "--level", 50, "--crs", "EPSG:4326")
        doubts[name] = {d["name"]: d["value"] for d in facts["verdict"]["reasons"]}
        doubts[name]["net"] = facts["net_m3"]
    assert doubts["right"]["axis_order"] == pytest.approx(1 / doubts["other"]["axis_order"])
    assert doubts["right"]["net"] * doubts["right"]["axis_order"] == pytest.approx(
        doubts["other"]["net"], rel=0.02
    )
    facts = volume(tmp_path / "right.xyz", "--level", 50, "--crs", "OGC:CRS84")
    assert "axis_order" not in {d["name"] for d in facts["verdict"]["reasons"]}
    assert facts["net_m3"] == pytest.approx(doubts["right"]["net"], rel=1e-6)
    text = "longitude latitude z\n" + (tmp_path / "right.xyz").read_text()
    (tmp_path / "named.xyz").write_text(text)
    facts = volume(tmp_path / "named.xyz", "--level", 50, "--crs", "EPSG:4326")
    assert "axis_order" not in {d["name"] for d in facts["verdict"]["reasons"]}


def test_whole_numbers_without_a_unit_are_doubtful(volume, tmp_path):
    np.savetxt(tmp_path / "mm.xyz", np.rint(1000.0 * site()), fmt="%d")
    facts = volume(tmp_path / "mm.xyz", "--base", "ground")
    assert "units_whole" in [r["name"] for r in facts["verdict"]["reasons"]]
    facts = volume(tmp_path / "mm.xyz", "--base", "ground", "--units", "mm")
    assert facts["net_m3"] == pytest.approx(np.pi * 144.0 * 3.0, rel=0.01)
    assert facts["verdict"]["status"] == "sound"


def test_two_clouds_in_unlike_units_are_doubtful(volume, tmp_path):
    r = site(800) + np.array([0.0, 0.0, 50.0])
    np.savetxt(tmp_path / "mm.xyz", 1e3 * r)
    np.savetxt(tmp_path / "m.xyz", r + np.array([0.0, 0.0, 0.1]))
    for names in (("mm.xyz", "m.xyz"), ("m.xyz", "mm.xyz")):
        facts = volume(*(tmp_path / name for name in names))
        assert "apart" in {d["name"] for d in facts["verdict"]["reasons"]}
    facts = volume(tmp_path / "m.xyz", tmp_path / "m.xyz")
    assert "apart" not in {d["name"] for d in facts["verdict"]["reasons"]}


@pytest.mark.parametrize("size", [0.1, 1.0, 30.0])
def test_small_and_steep_clouds_in_metres_are_not_taken_for_degrees(size, volume, tmp_path):
    r = site(500) / 40.0 * size + [12.0 * size, 45.0 * size, 3.0]
    write_cloud(tmp_path / "c.ply", r)
    assert volume(tmp_path / "c.ply", "--level", 3)["net_m3"] > 0.0


@pytest.mark.parametrize(
    "word,factor", [("us-ft", US_FOOT), ("ft", FOOT), ("mm", 1e-3), ("km", 1e3)]
)
@pytest.mark.parametrize("ending", [".csv", ".ply", ".pcd", ".npy"])
def test_units_where_the_file_says_nothing(word, factor, ending, volume, tmp_path):
    write_cloud(tmp_path / f"m{ending}", site(800))
    plain = volume(tmp_path / f"m{ending}", "--level", 0)
    write_cloud(tmp_path / f"c{ending}", site(800) / factor)
    facts = volume(tmp_path / f"c{ending}", "--level", 0, "--units", word)
    assert facts["net_m3"] == pytest.approx(plain["net_m3"], rel=1e-9)
    at = facts["surfaces"][0]["coordinates"]
    assert at["units_from"] == "--units" and at["crs"] is None
    assert plain["surfaces"][0]["coordinates"]["units_from"] == "assumed"


@pytest.mark.parametrize(
    "words,values",
    [
        (("--units", "m"), ("US survey foot", "metre")),
        (("--units", "us-ft,m"), ("US survey foot", "metre")),
        (("--units", "ft"), ("US survey foot", "international foot")),
        (("--crs", "EPSG:32610"), ("EPSG:2227", "EPSG:32610")),
        (("--crs", "EPSG:2227+5703"), ("ftUS", "NAVD88 height (EPSG")),
        (("--units", "yards"), ("yards", "us-ft")),
        (("--crs", "EPSG:123456"), ("EPSG:123456", "cannot be understood")),
        (("--classes", "two"), ("two", "whole numbers")),
    ],
)
def test_contradictions_name_both_values(words, values, volume, tmp_path):
    r = (site(500) + state_plane()) / US_FOOT
    path = save_las(tmp_path / "f.las", r, "EPSG:2227+6360")
    error = volume(path, "--level", 50, *words)
    assert all(v in error for v in values), error
    assert error.count("\n") == 1


def test_two_clouds_of_unlike_systems(volume, tmp_path):
    r = site(1500)
    a = save_las(tmp_path / "a.las", r + state_plane(), "EPSG:26943+5703")
    b = save_las(tmp_path / "b.las", (r + state_plane()) / US_FOOT, "EPSG:2227+6360")
    c = save_las(tmp_path / "c.las", r + MIDDLE, UTM)
    d = save_las(tmp_path / "d.las", r + state_plane())
    assert abs(volume(a, b)["net_m3"]) < 0.05
    assert "unlike systems" in volume(a, c)
    facts = volume(a, d)
    assert facts["verdict"]["reasons"][0]["name"] == "crs_of_one"


def test_web_mercator_is_refused(volume, tmp_path):
    r = site(500) + MIDDLE
    x, y = pyproj.Transformer.from_crs(UTM, "EPSG:3857", always_xy=True).transform(*r.T[:2])
    path = save_las(tmp_path / "w.las", np.c_[x, y, r[:, 2]], "EPSG:3857")
    assert "1.6" in (error := volume(path, "--level", 50)) and "UTM" in error


def test_noise_and_withheld_points_do_not_count(volume, tmp_path, capsys):
    r, kind = site(), np.full(4000, 2)
    rng = np.random.default_rng(0)
    kind[:200], kind[200:300], kind[300:900] = 7, 18, 5
    r[:300, 2] += rng.choice([-30.0, 40.0], 300)
    withheld = np.zeros(4000, np.uint8)
    withheld[900:950], r[900:950, 2] = 1, 90.0
    path = save_las(tmp_path / "c.laz", r + MIDDLE, UTM, classification=kind, withheld=withheld)
    facts = volume(path, "--level", 50)
    assert facts["net_m3"] == pytest.approx(np.pi * 144 * 3, rel=0.03)
    assert facts["surfaces"][0]["left_out"] == {
        "withheld": 50,
        "noise (class 7)": 200,
        "noise (class 18)": 100,
    }
    assert facts["surfaces"][0]["points"] == 3650
    ground = volume(path, "--level", 50, "--classes", "2,9")["surfaces"][0]
    assert ground["points"] == 3050 and ground["left_out"] == {"withheld": 50, "other classes": 900}
    assert volume(path, "--level", 50, "--classes", "all")["surfaces"][0]["points"] == 4000
    assert "classes in it: 2, 5, 7, 18" in volume(path, "--level", 50, "--classes", "64")
    assert main(["volume", str(path), "--level", "50"]) == 0
    text = capsys.readouterr().out
    assert "200 noise (class 7)" in text and "EPSG:26910" in text and "units: metre" in text


def test_the_table_says_what_was_read(tmp_path, capsys):
    r = (site(800) + state_plane()) / US_FOOT
    path = save_las(tmp_path / "f.las", r, "EPSG:2227+6360")
    assert main(["volume", str(path), "--level", "50"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "units: US survey foot → m" in text and "NAVD88 height (ftUS)" in text


def test_the_tin_carries_the_system(tmp_path, capsys):
    r = (site(800) + state_plane()) / US_FOOT
    path = save_las(tmp_path / "f.las", r, "EPSG:2227+6360")
    assert main(["tin", str(path), "-o", str(tmp_path / "t.ply"), "--json"]) == 0
    capsys.readouterr()
    back = read_cloud(tmp_path / "t.ply")
    assert "in metres" in back.coordinates.crs.name and "NAVD88" in back.coordinates.crs.name
    assert back.coordinates.across.name == "metre"
    np.testing.assert_allclose(back.r.mean(axis=0), r.mean(axis=0) * US_FOOT, atol=2.0)


def test_bodies_of_a_mesh_in_millimetres(tmp_path, capsys):
    corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], float) * 500.0
    faces = "2 1 3,2 3 4,5 6 8,5 8 7,1 2 6,1 6 5,3 7 8,3 8 4,1 5 7,1 7 3,2 4 8,2 8 6"
    text = "".join(f"v {x} {y} {z}\n" for x, y, z in corners.tolist())
    (tmp_path / "box.obj").write_text(text + "".join(f"f {f}\n" for f in faces.split(",")))
    words = ["body", tmp_path / "box.obj", "-o", tmp_path / "o.ply", "--units", "mm", "--json"]
    assert main([str(w) for w in words]) == 0
    assert json.loads(capsys.readouterr().out)["volume_m3"] == pytest.approx(0.125)
