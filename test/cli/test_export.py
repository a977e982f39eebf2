"""Files for other programs, read back by the programs' own readers: volume, system, units.

The site lies at a northing of 5,000,000 m, where float32 has steps of half a metre.
"""

import csv
import json
import math
from pathlib import Path
from xml.etree import ElementTree

import laspy
import numpy as np
import pyproj
import pytest
from volume_surfaces import platform, surface_update

from ladar_volume.cli.main import main
from ladar_volume.io.export.formats import FORMATS
from ladar_volume.io.results import result_dict
from ladar_volume.io.surveys import write_survey
from ladar_volume.model.losses import Losses
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import Datum
from ladar_volume.volume.estimator import VolumeEstimator

EAST, NORTH, HEIGHT = 500_000.0, 5_000_000.0, 100.0
#: US survey foot, m.
FOOT = 1200.0 / 3937.0
LAND = "{http://www.landxml.org/schema/LandXML-1.2}"


def pile(path, crs, unit=1.0, north=NORTH, n=600, seed=1):
    """A cone of 5 m on level ground with 1 cm of noise as LAS, numbers in ``unit`` m."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-14.0, 14.0, (n, 2))
    z = np.maximum(0.0, 5.0 - 0.6 * np.hypot(*xy.T)) + rng.normal(0.0, 0.01, n)
    kind = (3, "1.2") if unit == 1.0 else (6, "1.4")  # GeoTIFF keys, and WKT
    header = laspy.LasHeader(point_format=kind[0], version=kind[1])
    header.scales, header.offsets = [0.0001] * 3, [EAST / unit, north / unit, 0.0]
    header.add_crs(pyproj.CRS.from_user_input(crs))
    las = laspy.LasData(header)
    las.x, las.y, las.z = (np.c_[xy, z] + [EAST, north, HEIGHT]).T / unit
    las.gps_time, las.intensity = np.arange(n) * 1e-3, np.arange(n) % 999
    las.classification = np.where(np.arange(n) % 2, 2, 5)
    las.write(path)
    return path


def ran(capsys, *words):
    """Exit code, and JSON or error."""
    code = main(list(map(str, words)))
    shown = capsys.readouterr()
    return code, json.loads(shown.out) if shown.out.startswith("{") else shown.out + shown.err


@pytest.fixture(scope="module")
def metres(tmp_path_factory):
    """Every file of the pile above its ground, in metres."""
    folder = tmp_path_factory.mktemp("metres")
    cloud = pile(folder / "pile.las", "EPSG:25832")
    words = ["--base", "ground", "-o", folder / "out", "--as", "all", "--cell", "0.5"]
    assert main(list(map(str, ["volume", cloud, *words]))) == 0
    return folder / "out"


@pytest.fixture(scope="module")
def feet(tmp_path_factory):
    """Every file of the pile above a level, in the US survey feet of its file."""
    folder = tmp_path_factory.mktemp("feet")
    cloud = pile(folder / "pile.laz", "EPSG:6576+6360", FOOT, 150_000.0)  # Tennessee, NAVD 88
    words = ["--level", "98.5", "-o", folder / "out", "--as", "all", "--file-units"]
    assert main(list(map(str, ["volume", cloud, *words]))) == 0
    return folder / "out"


def result(folder):
    return json.loads((folder / "result.json").read_text())


def prisms(r, faces):
    """Volume between faces (m, 3) over vertices (n, 3) and height zero of a near origin."""
    a, b, c = ((r - near(r))[faces[:, k]] for k in range(3))
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    return float((area * (a + b + c)[:, 2]).sum() / 3.0), float(area.sum())


def near(r):
    return np.array([*np.floor(r.min(axis=0))[:2], 0.0])


def signed_area(ring):
    """Area of a closed ring, positive counter-clockwise."""
    d = ring[:, :2] - ring[0, :2]
    return 0.5 * (d[:-1, 0] * d[1:, 1] - d[1:, 0] * d[:-1, 1]).sum()


def between(top, base):
    return prisms(*top)[0] - prisms(*base)[0]


def landxml(path):
    """Surfaces by name, and the root, as an XML parser reads them."""
    root = ElementTree.parse(path).getroot()
    out = {}
    for surface in root.iter(f"{LAND}Surface"):
        points = {p.get("id"): tuple(map(float, p.text.split())) for p in surface.iter(f"{LAND}P")}
        place = {key: k for k, key in enumerate(points)}
        faces = [[place[key] for key in f.text.split()] for f in surface.iter(f"{LAND}F")]
        out[surface.get("name")] = np.array(list(points.values()))[:, [1, 0, 2]], np.array(faces)
    return out, root


def dxf(path):
    """3DFACEs by layer, and the document, as ezdxf reads them."""
    ezdxf = pytest.importorskip("ezdxf", reason="ezdxf is not installed")
    document = ezdxf.readfile(path)
    assert not document.audit().has_issues
    rows = {}
    for face in document.modelspace().query("3DFACE"):
        corners = [tuple(face.dxf.get(f"vtx{k}")) for k in range(4)]
        assert corners[2] == corners[3]
        rows.setdefault(face.dxf.layer, []).append(corners[:3])
    soup = {name: np.array(corners).reshape(-1, 3) for name, corners in rows.items()}
    return {name: (r, np.arange(len(r)).reshape(-1, 3)) for name, r in soup.items()}, document


def trimesh_parts(path):
    """Parts by name, as trimesh reads them."""
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    scene = trimesh.load(path, process=False, split_objects=True, group_material=False)
    if not hasattr(scene, "geometry"):
        return {"counted": (np.array(scene.vertices), np.array(scene.faces))}, scene
    return {n: (np.array(g.vertices), np.array(g.faces)) for n, g in scene.geometry.items()}, scene


def test_landxml_gives_the_volume_the_system_and_the_units(metres, feet):
    found, root = landxml(metres / "surface.xml")
    facts = result(metres)
    assert between(found["counted"], found["base"]) == pytest.approx(facts["net_m3"], rel=1e-9)
    assert set(found) == {"counted", "around", "base"}
    assert root.find(f"{LAND}Units/{LAND}Metric").get("linearUnit") == "meter"
    system = root.find(f"{LAND}CoordinateSystem")
    assert system.get("epsgCode") == "25832"
    assert pyproj.CRS.from_wkt(system.get("ogcWktCode")).equals(pyproj.CRS("EPSG:25832"))
    found, root = landxml(feet / "surface.xml")
    cubic = between(found["counted"], found["base"])
    assert cubic * FOOT**3 == pytest.approx(result(feet)["net_m3"], rel=1e-9)
    assert root.find(f"{LAND}Units/{LAND}Imperial").get("linearUnit") == "USSurveyFoot"
    system = pyproj.CRS.from_wkt(root.find(f"{LAND}CoordinateSystem").get("ogcWktCode"))
    assert "ftUS" in system.name and len(system.sub_crs_list) == 2


def test_this_program_reads_its_landxml_as_the_same_surface(metres, feet, capsys):
    for folder in (metres, feet):
        words = ["--surface", "counted", "--level", "98.5", "--json"]
        facts = ran(capsys, "volume", folder / "surface.xml", *words)[1]
        top, _ = landxml(folder / "surface.xml")
        unit = FOOT if folder is feet else 1.0
        volume, area = prisms(*top["counted"])
        assert facts["net_m3"] == pytest.approx(volume * unit**3 - 98.5 * area * unit**2, rel=1e-9)


def test_dxf_gives_the_volume_and_the_units(metres, feet):
    found, document = dxf(metres / "surface.dxf")
    assert between(found["counted"], found["base"]) == pytest.approx(
        result(metres)["net_m3"], rel=1e-9
    )
    assert document.header["$INSUNITS"] == 6
    assert ("CRS", "EPSG:25832") in document.header.custom_vars.properties
    (outline,) = document.modelspace().query("POLYLINE")
    ring = np.array([tuple(v.dxf.location) for v in outline.vertices])
    area = signed_area(np.vstack([ring, ring[:1]]))
    assert outline.is_closed and area == pytest.approx(result(metres)["area_m2"], rel=1e-9)
    found, document = dxf(feet / "surface.dxf")
    cubic = between(found["counted"], found["base"])
    assert cubic * FOOT**3 == pytest.approx(result(feet)["net_m3"], rel=1e-9)
    assert document.header["$INSUNITS"] == 21 and document.header["$MEASUREMENT"] == 0


def test_obj_gives_the_volume_to_the_last_digit(metres, feet):
    for folder, unit in ((metres, 1.0), (feet, FOOT)):
        found, _ = trimesh_parts(folder / "surface.obj")
        volume = between(found["counted"], found["base"]) * unit**3
        assert volume == pytest.approx(result(folder)["net_m3"], rel=1e-9)
        head = (folder / "surface.obj").read_text()[:4000]
        assert ("us-ft" if folder is feet else "units: m\n") in head
        assert ("ftUS" if folder is feet else "UTM zone 32N") in head


def test_stl_and_glb_hold_24_bits_about_an_origin_that_they_name(metres, feet):
    facts = result(metres)
    found, _ = trimesh_parts(metres / "surface.glb")
    upright = {n: (r[:, [0, 2, 1]] * [1, -1, 1], faces) for n, (r, faces) in found.items()}
    # 28 m in 24 bits: 2e-6 m, so 1e-6 of a volume of some metres' height
    assert between(upright["counted"], upright["base"]) == pytest.approx(facts["net_m3"], rel=1e-6)
    content = (metres / "surface.glb").read_bytes()
    extras = json.loads(content[20 : 20 + int.from_bytes(content[12:16], "little")])["asset"]
    origin = np.array(extras["extras"]["origin_m"])
    assert pyproj.CRS.from_wkt(extras["extras"]["crs"]).equals(pyproj.CRS("EPSG:25832"))
    top, _ = landxml(metres / "surface.xml")
    assert np.abs(upright["counted"][0] + origin - top["counted"][0]).max() < 2e-6
    for folder in (metres, feet):
        found, _ = trimesh_parts(folder / "surface.stl")
        words = (folder / "surface.stl").read_bytes()[:80].decode().split("origin ")[1].split()
        top, _ = landxml(folder / "surface.xml")
        r = found["counted"][0] + np.array(words[:3], float)
        assert prisms(r, found["counted"][1])[1] == pytest.approx(
            prisms(*top["counted"])[1], rel=1e-6
        )
        assert words[3] == ("US" if folder is feet else "metre")


def test_geotiff_gives_heights_sigma_base_and_system(metres, feet):
    rasterio = pytest.importorskip("rasterio", reason="rasterio is not installed")
    with rasterio.open(metres / "surface.tif") as file:
        height, sigma, base = file.read()
        assert set(file.dtypes) == {"float64"} and file.crs.to_epsg() == 25832
        assert file.res == (0.5, 0.5) and file.units[0] == "metre"
        to_map = file.transform
    facts = result(metres)
    counted = np.isfinite(base)
    # by cells, not by triangles: good to a part in a hundred at 0.5 m
    assert ((height - base)[counted].sum() * 0.25) == pytest.approx(facts["net_m3"], rel=0.01)
    assert 0.003 < np.nanmedian(sigma) < 0.015 and np.isfinite(sigma[np.isfinite(height)]).all()
    # cells are at their middles: the top of the cone is where it was put
    row, column = np.unravel_index(np.nanargmax(height), height.shape)
    assert np.hypot(*(np.array(to_map @ (column + 0.5, row + 0.5)) - [EAST, NORTH])) < 1.5
    top, _ = landxml(metres / "surface.xml")
    assert np.nanmax(height) == pytest.approx(top["counted"][0][:, 2].max(), abs=0.6)
    with rasterio.open(feet / "surface.tif") as file:
        assert file.crs.linear_units_factor[1] == pytest.approx(FOOT, rel=1e-9)
        assert np.nanmin(file.read(1)) == pytest.approx((HEIGHT - 0.03) / FOOT, abs=0.2)
        assert file.units[0] == "US survey foot"


def test_las_keeps_every_attribute_and_has_sigma_and_the_system(metres, feet):
    for folder, unit, code in ((metres, 1.0, 25832), (feet, FOOT, None)):
        for name in ("points.las", "points.laz"):
            las = laspy.read(folder / name)
            assert str(las.header.version) == "1.4" and len(las) == 600
            crs = las.header.parse_crs()
            assert crs.to_epsg() == code or "Tennessee (ftUS)" in crs.name
            index = np.array(las["index"])
            assert (np.array(las.gps_time) == index * 1e-3).all()
            assert (np.array(las.intensity) == index % 999).all()
            assert (np.array(las.classification) == np.where(index % 2, 2, 5)).all()
            assert 0.005 < np.median(las["sigma_z"]) * unit < 0.02
            source = laspy.read(folder.parent / ("pile.las" if unit == 1.0 else "pile.laz"))
            assert np.abs(np.c_[las.x, las.y, las.z] - source.xyz[index]).max() < 1e-9


def test_ply_is_double_and_has_sigma(metres):
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    mesh = trimesh.load(metres / "surface.ply", process=False)
    found, _ = landxml(metres / "surface.xml")
    whole = sum(prisms(*found[name])[0] for name in ("counted", "around"))
    assert prisms(np.array(mesh.vertices), np.array(mesh.faces))[0] == pytest.approx(
        whole, rel=1e-9
    )
    assert "sigma_z" in (metres / "surface.ply").read_bytes()[:4000].decode("latin-1")


def from_degrees(positions, crs):
    """Longitude and latitude (n, 2) in a projected system, by pyproj."""
    change = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    return np.column_stack(change.transform(*np.array(positions).T))


def test_outline_and_contours_are_longitude_and_latitude(metres, feet):
    outline = json.loads((metres / "outline.geojson").read_text())
    assert "crs" not in outline and outline["accuracy_m"] == 1.0  # of ETRS89 in WGS 84
    (part,) = outline["features"]
    (degrees,) = part["geometry"]["coordinates"]
    ring = from_degrees(degrees, "EPSG:25832")
    assert degrees[0] == degrees[-1] and signed_area(np.array(degrees)) > 0.0
    assert signed_area(ring) == pytest.approx(result(metres)["area_m2"], rel=1e-6)
    facts = part["properties"]
    assert facts["volume_m3"] == result(metres)["net_m3"]
    assert facts["area_m2"] == pytest.approx(result(metres)["area_m2"], rel=1e-9)
    top = landxml(metres / "surface.xml")[0]["counted"][0]  # its corners are vertices
    apart = np.abs(ring[:, None] - top[None, :, :2]).max(axis=2)
    assert apart.min(axis=1).max() < 1e-3
    z = top[apart.argmin(axis=1), 2]
    heights = [facts["outline_lowest_m"], facts["outline_highest_m"]]
    assert heights == pytest.approx([z.min(), z.max()], abs=1e-9)
    contours = json.loads((metres / "contours.geojson").read_text())["features"]
    for feature in contours:
        line = from_degrees(feature["geometry"]["coordinates"], "EPSG:25832")
        height = feature["properties"]["height_m"]
        closed = np.allclose(line[0], line[-1], rtol=0.0, atol=1e-6)
        if height > HEIGHT + 1.0 and closed and len(line) > 20:
            radius = np.hypot(line[:, 0] - EAST, line[:, 1] - NORTH)
            assert np.abs(radius - (HEIGHT + 5.0 - height) / 0.6).max() < 0.3
            assert signed_area(line) > 0.0  # higher ground on its left
    levels = {feature["properties"]["height_m"] for feature in contours}
    assert {101.0, 102.0, 103.0, 104.0} <= levels
    in_feet = json.loads((feet / "contours.geojson").read_text())["features"]
    assert min(f["properties"]["height_us_ft"] for f in in_feet) > 320
    line = from_degrees(in_feet[0]["geometry"]["coordinates"], "EPSG:6576") * FOOT
    assert np.abs(line - [EAST, 150_000.0]).max() < 14.1


def test_outlines_that_lie_nowhere_known_keep_their_numbers_and_say_so(tmp_path, capsys):
    words = ["--level", "99", "--as", "geojson", "-o", tmp_path / "out"]
    for crs, why in (
        ([], "no CRS is known"),
        (["--crs", "+proj=tmerc +x_0=500000 +lat_0=0 +ellps=bessel"], "in WGS 84 is not known"),
    ):
        code, text = ran(capsys, "volume", mound(tmp_path / "a.csv"), *words, *crs)
        assert code == 0 and why in " ".join(text.split())
        outline = json.loads((tmp_path / "out" / "outline.geojson").read_text())
        assert why in outline["positions"] and outline["units"] == "metre"
        assert (outline["crs"] is None) is not bool(crs)
        ring = np.array(outline["features"][0]["geometry"]["coordinates"][0])
        assert (np.abs(ring[:, :2] - [EAST + 5.0, 150_005.0]) < 5.1).all()


def test_table_and_json_say_the_same(metres):
    with (metres / "volumes.csv").open() as file:
        (row,) = csv.DictReader(file)
    facts = result(metres)
    assert float(row["volume_m3"]) == facts["net_m3"]
    assert float(row["faces_m3"]) == facts["files"]["faces_m3"][0]
    assert facts["files"]["faces_m3"][0] == pytest.approx(facts["net_m3"], rel=1e-9)
    assert facts["files"]["code"] == "EPSG:25832" and facts["files"]["units"] == "metre"


@pytest.fixture(scope="module")
def schema():
    """The published schema, as a validator."""
    jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed")
    text = (Path(__file__).parents[2] / "docs" / "result.schema.json").read_text(encoding="utf-8")
    jsonschema.Draft202012Validator.check_schema(json.loads(text))
    return jsonschema.Draft202012Validator(json.loads(text))


def test_results_are_as_the_published_schema_says(schema, metres, feet, survey, tmp_path, capsys):
    cloud = metres.parent / "pile.las"
    pair = ran(capsys, "volume", cloud, cloud, "--json")[1]
    levels = ran(
        capsys, "volume", cloud, "--levels", "99", "104", "0.5", "--base", "floor", "--json"
    )
    assert main(["export", str(survey), "-o", str(tmp_path / "out"), "--as", "json"]) == 0
    results = [result(metres), result(feet), pair, levels[1], result(tmp_path / "out")]
    for facts in results:
        schema.validate(facts)
    # what the schema says is more than nothing
    for change in ({"sigma_m3": "3"}, {"area_m2": -1.0}, {"version": None}):
        assert not schema.is_valid({**results[0], **change})
        assert not schema.is_valid({**results[-1], **change})
    wrong = {"status": "sound", "reasons": [{"name": "a", "text": "b", "value": 1.0}]}
    assert not schema.is_valid({**results[0], "verdict": wrong})


def test_all_files_are_there_and_a_second_run_removes_those_it_does_not_write(metres, tmp_path):
    assert {p.name for p in metres.iterdir()} == {kind.file for kind in FORMATS.values()}
    cloud = metres.parent / "pile.las"
    for formats in ("obj,csv", "stl"):
        words = ["volume", cloud, "--level", "98", "-o", tmp_path, "--as", formats]
        assert main(list(map(str, words))) == 0
    assert {p.name for p in tmp_path.iterdir()} == {"surface.stl", "result.json"}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--as", "obj"], "-o OUT"),
        (["--file-units"], "-o OUT"),
        (["-o", "out", "--as", "shp"], "shp is none of json"),
        (["-o", "out", "--as", "obj", "--cell", "1"], "--cell is for --as tif"),
        (["-o", "out", "--cell", "0"], "not above 0"),
        (["-o", "out", "--frame", "scan"], "--frame level"),
    ],
)
def test_options_that_make_no_files_are_refused(metres, words, said, capsys, tmp_path):
    words = [tmp_path / w if w == "out" else w for w in words]
    cloud = metres.parent / "pile.las"
    try:
        code, text = ran(capsys, "volume", cloud, "--level", "98", *words)
    except SystemExit as end:
        code, text = end.code, capsys.readouterr().err
    assert code == 2 and said in text and not list(tmp_path.iterdir())


def test_too_fine_cells_and_contours_are_refused_and_nothing_is_written(metres, tmp_path, capsys):
    cloud = metres.parent / "pile.las"
    for kind, option in (("tif", "--cell"), ("contours", "--contour-interval")):
        words = ["--level", "98", "-o", tmp_path / "out", "--as", kind, option, "1e-4"]
        code, text = ran(capsys, "volume", cloud, *words)
        assert code == 2 and option in text and not (tmp_path / "out").exists()


def mound(path, head="x,y,z", tail="", unit=(1.0, 1.0, 1.0)):
    """A mound of 1 m on 10 m by 10 m as text."""
    rng = np.random.default_rng(0)
    xy = rng.uniform(0.0, 10.0, (200, 2))
    z = 100.0 + np.exp(-((xy - 5.0) ** 2).sum(axis=1) / 4.0) + rng.normal(0.0, 0.01, 200)
    rows = np.c_[np.add(xy, [EAST, 150_000.0]), z] / unit
    path.write_text("\n".join([head, *(",".join(map(repr, r)) + tail for r in rows.tolist())]))
    return path


#: An outline like an L, whose corners lie inside and outside of the site.
CORNERS = [(2, 3), (12, 1), (11, 4.5), (6, 5), (5.5, 8), (3, 12)]
POLYGON = [
    *("--set", "volume.outline=polygon", "--set"),
    f"volume.polygon_m={[c + o for p in CORNERS for c, o in zip(p, (EAST, 150e3), strict=True)]}",
]


@pytest.mark.parametrize(
    ("words", "faces"),
    [
        (["--level", "99", "--vertices", "0.3"], 1),
        (["--level", "99", "--vertices", "0.3", "--relevant", "all"], 1),
        (["--plane", "99", "0", "0"], 1),
        (["--level", "99", *POLYGON], 1),
        (["--plane", "99", "1e-5", "0", *POLYGON], 1),
        (["--base", "floor", "--levels", "99.5", "101", "0.1"], 1),
        (["SECOND"], 0),
        (["SECOND", "--footprint", "own", "--level", "98"], 0),
    ],
)
def test_every_kind_of_volume_has_files(words, faces, tmp_path, capsys):
    one, two = mound(tmp_path / "a.csv"), mound(tmp_path / "b.csv", tail="")
    words = [two if w == "SECOND" else w for w in words]
    code, facts = ran(
        capsys, "volume", one, *words, "-o", tmp_path / "out", "--as", "all", "--json"
    )
    assert code == 0, facts
    found, _ = landxml(tmp_path / "out" / "surface.xml")
    if faces:
        assert between(found["counted"], found["base"]) == pytest.approx(facts["net_m3"], rel=1e-9)
        assert prisms(*found["counted"])[1] == pytest.approx(facts["area_m2"], rel=1e-9)
    else:
        assert result(tmp_path / "out")["files"]["faces_m3"] == [None]


def test_a_name_of_any_characters_makes_files_that_can_be_read(tmp_path, capsys):
    cloud = mound(tmp_path / 'a&<\x01\n"é].csv', "x,y,z,word", ",tree")
    words = ["--level", "99", "-o", tmp_path / "out", "--as", "all", "--crs", "EPSG:32616"]
    assert ran(capsys, "volume", cloud, *words)[0] == 0
    _, root = landxml(tmp_path / "out" / "surface.xml")
    assert root.find(f"{LAND}Project").get("name") == 'a&<??"é]'
    assert result(tmp_path / "out")["files"]["columns_lost"] == ["word"]
    dxf(tmp_path / "out" / "surface.dxf")


def test_unlike_units_cannot_be_those_of_the_files(tmp_path, capsys):
    cloud = mound(tmp_path / "a.csv", unit=(FOOT, FOOT, 1.0))
    words = ["--level", "99", "--units", "us-ft,m", "-o", tmp_path / "out"]
    code, text = ran(capsys, "volume", cloud, *words, "--file-units")
    assert code == 2 and "one unit of length for all axes" in text
    code, _ = ran(capsys, "volume", cloud, *words)
    assert code == 0 and result(tmp_path / "out")["files"]["units"] == "metre"


def test_what_makes_no_surface_leaves_no_files(tmp_path, capsys):
    full = mound(tmp_path / "full.csv").read_text().splitlines()
    for name, rows in (("one", full[:2]), ("none", full[:1]), ("nan", ["x,y,z", "nan,nan,nan"])):
        (tmp_path / f"{name}.csv").write_text("\n".join(rows) + "\n")
        words = ["--level", "99", "-o", tmp_path / "out"]
        code, text = ran(capsys, "volume", tmp_path / f"{name}.csv", *words)
        assert code == 2 and len(text.splitlines()) == 1 and not (tmp_path / "out").exists()
    (tmp_path / "file").write_text("")
    code, text = ran(
        capsys, "volume", tmp_path / "full.csv", "--level", "99", "-o", tmp_path / "file"
    )
    assert code == 2 and "cannot be written" in text


def test_a_missing_package_is_named_before_anything_is_read(metres, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "rasterio", None)
    words = ["--level", "98", "-o", tmp_path / "out", "--as", "tif"]
    code, text = ran(capsys, "volume", metres.parent / "pile.las", *words)
    assert code == 2 and "pip install 'ladar_volume[geo]'" in text


#: Where the survey below was flown.
DATUM = Datum(49.1, 8.4, 150.0)


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    """A replayed survey of a slope with a hump, on disk."""
    p = Parameters.read(
        {
            "filter": {"nav_bin_s": 1.0},
            "volume": {"base": "level", "level_m": 0.0, "outline": "all"},
        }
    )
    e = VolumeEstimator(p)
    e.add_platform(platform(position=0.002, attitude=0.0))
    e.add(surface_update(lambda x, y: 3.0 + 0.02 * x, seed=0, half=8.0, perturb=0.004))
    estimate = e.estimate()
    folder = tmp_path_factory.mktemp("survey")
    more = {"where_more_data_helps": {"places": [], "sigma_m3": 0.0, "sigma_gaps_m3": 0.0}}
    facts = result_dict(estimate, p, Losses(), DATUM, {}, {"path": "flight", "sha256": "0"}) | more
    write_survey(folder / "result.mcap", estimate, e.epoch(), facts)
    return folder


def test_a_survey_is_written_in_its_own_frame(survey, tmp_path, capsys):
    code, text = ran(
        capsys, "export", survey, "-o", tmp_path / "out", "--as", "landxml,las,csv,geojson"
    )
    assert code == 0, text
    facts, (found, root) = result(tmp_path / "out"), landxml(tmp_path / "out" / "surface.xml")
    faces = between(found["counted"], found["base"])
    assert faces == pytest.approx(facts["files"]["faces_m3"][0], rel=1e-9)
    # V also has what a curved surface has over the chords of its triangles
    assert faces == pytest.approx(facts["volume_m3"] - facts["chord_m3"], rel=1e-6)
    system = pyproj.CRS.from_wkt(root.find(f"{LAND}CoordinateSystem").get("ogcWktCode"))
    assert system.is_engineering and "49.100000000 N, 8.400000000 E" in system.name
    las = laspy.read(tmp_path / "out" / "points.las")
    assert las.header.parse_crs().name == system.name and (np.array(las["sigma_z"]) > 0).all()
    outline = json.loads((tmp_path / "out" / "outline.geojson").read_text())
    (degrees,) = outline["features"][0]["geometry"]["coordinates"]
    # by another way: PROJ's own local frame, at the heights of the corners
    east_north = pyproj.Transformer.from_pipeline(
        f"+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart "
        f"+step +proj=topocentric +lat_0={DATUM.latitude_deg} +lon_0={DATUM.longitude_deg} "
        f"+h_0={DATUM.height_m}"
    )
    top = found["counted"][0]
    lon, lat = np.array(degrees).T
    ring = np.column_stack(east_north.transform(lon, lat, np.full(len(lon), 153.0))[:2])
    off = np.abs(ring[:, None] - top[None, :, :2]).max(axis=2).min(axis=1)
    assert off.max() < 1e-3 and signed_area(ring) > 0.0


def test_a_survey_in_utm_lies_where_it_was_flown_and_says_the_scale(survey, tmp_path, capsys):
    words = ["--as", "landxml,las,contours", "--crs", "EPSG:32632"]
    assert ran(capsys, "export", survey, "-o", tmp_path / "out", *words)[0] == 0
    facts, (found, _) = result(tmp_path / "out"), landxml(tmp_path / "out" / "surface.xml")
    scale = facts["files"]["scale"]
    at = pyproj.Proj("EPSG:32632")
    assert scale == pytest.approx(at.get_factors(8.4, 49.1).areal_scale ** 0.5, rel=1e-6)
    faces = between(found["counted"], found["base"])
    assert faces == pytest.approx(facts["files"]["faces_m3"][0], rel=1e-9)
    # on the map at the height of the site: by the scale, and by what the earth is smaller below
    lift = 1.0 - 150.0 / 6_371_000.0
    assert faces == pytest.approx(
        (facts["volume_m3"] - facts["chord_m3"]) * (scale * lift) ** 2, rel=3e-6
    )
    r = found["counted"][0]
    middle = np.array(at(8.4, 49.1))
    assert np.abs(r[:, :2].mean(axis=0) - middle).max() < 0.5
    assert np.abs(r[:, 2].mean() - 153.0) < 0.5
    assert laspy.read(tmp_path / "out" / "points.las").header.parse_crs().to_2d().to_epsg() == 32632
    assert math.isclose(facts["volume_m3"], result_of_mcap(survey)["volume_m3"])


def result_of_mcap(folder: Path):
    from ladar_volume.io.surveys import FILE, read_result

    return read_result(folder / FILE)


@pytest.mark.parametrize(
    ("crs", "said"),
    [
        ("EPSG:2263", "US survey foot"),
        ("EPSG:4326", "projected"),
        ("EPSG:3857", "as large here"),
        ("EPSG:31467", "from WGS 84 at the survey"),  # Gauss-Krüger on Potsdam
        ("EPSG:25832+7837", "without heights"),
        ("nonsense", "cannot be understood"),
    ],
)
def test_a_system_that_does_not_fit_a_survey_is_refused(survey, crs, said, tmp_path, capsys):
    code, text = ran(capsys, "export", survey, "-o", tmp_path / "out", "--crs", crs)
    assert code == 2 and said in text and not (tmp_path / "out").exists()


def test_a_survey_is_not_written_over_and_one_that_changed_is_refused(survey, tmp_path, capsys):
    code, text = ran(capsys, "export", survey, "-o", survey)
    assert code == 2 and "another folder" in text
    code, text = ran(capsys, "export", tmp_path, "-o", tmp_path / "out")
    assert code == 2 and "replay writes it" in text
    code, text = ran(capsys, "export", tmp_path / "none", "-o", tmp_path / "out")
    assert code == 2 and "no such file" in text
    (tmp_path / "result.mcap").write_bytes((survey / "result.mcap").read_bytes()[:5000])
    code, text = ran(capsys, "export", tmp_path, "-o", tmp_path / "out")
    assert code == 2 and len(text.splitlines()) == 1
