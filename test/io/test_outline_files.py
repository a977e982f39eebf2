"""Outlines of piles from the files of an office, in the system of the points."""

import json
import math

import numpy as np
import pytest

from ladar_volume.io.pointfiles.metres import MapCoordinates
from ladar_volume.io.pointfiles.units import WORDS
from ladar_volume.io.site.height_budget import read_height_errors
from ladar_volume.io.site.outline_files import read_outlines
from ladar_volume.model.errors import ConfigurationError, InputError

pyogrio = pytest.importorskip("pyogrio", reason="pyogrio is not installed")
shapely = pytest.importorskip("shapely", reason="shapely is not installed")
from pyproj import CRS, Transformer  # noqa: E402

UTM = CRS.from_epsg(25832)
#: A square of 10 m in UTM, and a triangle beside it.
SQUARE = np.array([[433000.0, 5100000.0], [433010, 5100000], [433010, 5100010], [433000, 5100010]])
TRIANGLE = np.array([[433020.0, 5100000.0], [433030, 5100000], [433025, 5100008]])
EXTENT = np.array([[432900.0, 5099900.0], [433100.0, 5100100.0]])


def at(crs=UTM, word="m"):
    unit = WORDS[word]
    return MapCoordinates(crs, across=unit, up=unit, factor=(unit.metres, unit.metres))


def closed(ring):
    return np.vstack([ring, ring[:1]]).tolist()


def geojson(path, rings, rows=None, crs=None):
    features = [
        {
            "type": "Feature",
            "properties": row,
            "geometry": {"type": "Polygon", "coordinates": [closed(np.asarray(ring))]},
        }
        for ring, row in zip(rings, rows or [{}] * len(rings), strict=True)
    ]
    head = {} if crs is None else {"crs": {"type": "name", "properties": {"name": crs}}}
    path.write_text(json.dumps({"type": "FeatureCollection", **head, "features": features}))
    return path


def degrees(ring):
    change = Transformer.from_crs(UTM, 4326, always_xy=True)
    return np.column_stack(change.transform(*np.asarray(ring).T))


def test_geojson_in_degrees_comes_to_the_projection_of_the_points(tmp_path):
    rows = [
        {"name": "North", "material": "gravel", "density": 1.7, "density_sigma": 0.05},
        {"NAME": "South", "density": "1,5"},
    ]
    file = geojson(tmp_path / "a.geojson", [degrees(SQUARE), degrees(TRIANGLE)], rows)
    found = read_outlines(file, at(), EXTENT)
    assert [p.name for p in found.piles] == ["North", "South"]
    assert found.piles[0].ring == pytest.approx(SQUARE, abs=1e-4)
    gravel, other = (p.material for p in found.piles)
    assert (gravel.name, gravel.density_t_m3, gravel.sigma_t_m3) == ("gravel", 1.7, 0.05)
    assert other.density_t_m3 == 1.5 and math.isnan(other.sigma_t_m3)
    assert found.doubts == ()


def written(path, driver, crs="EPSG:25832"):
    shapes = np.array([shapely.to_wkb(shapely.Polygon(r)) for r in (SQUARE, TRIANGLE)], object)
    names = np.array(["one", "two"], object)
    pyogrio.raw.write(
        path, shapes, [names], ["name"], geometry_type="Polygon", crs=crs, driver=driver
    )
    return path


@pytest.mark.parametrize(
    ("name", "driver"), [("a.shp", "ESRI Shapefile"), ("a.gpkg", "GPKG"), ("a.fgb", "FlatGeobuf")]
)
def test_files_of_gis_name_their_system(tmp_path, name, driver):
    file = written(tmp_path / name, driver)
    same = read_outlines(file, at(), EXTENT)
    assert sorted(p.name for p in same.piles) == ["one", "two"]
    by_name = {p.name: p.ring for p in same.piles}
    # a file may turn a ring round or begin it elsewhere
    assert sorted(map(tuple, by_name["one"].tolist())) == sorted(map(tuple, SQUARE.tolist()))
    other = CRS.from_epsg(25833)
    change = Transformer.from_crs(UTM, other, always_xy=True)
    moved = {p.name: p.ring for p in read_outlines(file, at(other), EXTENT).piles}["two"]
    want = np.column_stack(change.transform(*by_name["two"].T))
    assert moved == pytest.approx(want, abs=1e-6)


def test_a_kml_is_in_degrees(tmp_path):
    text = " ".join(f"{x:.9f},{y:.9f},0" for x, y in closed(degrees(SQUARE)))
    (tmp_path / "a.kml").write_text(
        '<?xml version="1.0"?><kml xmlns="http://www.opengis.net/kml/2.2"><Document><Placemark>'
        f"<name>Halde</name><Polygon><outerBoundaryIs><LinearRing><coordinates>{text}"
        "</coordinates></LinearRing></outerBoundaryIs></Polygon></Placemark></Document></kml>"
    )
    pile = read_outlines(tmp_path / "a.kml", at(), EXTENT).piles[0]
    assert pile.name == "Halde"
    assert pile.ring == pytest.approx(SQUARE, abs=1e-3)


def test_a_drawing_has_the_coordinates_of_the_points(tmp_path):
    ezdxf = pytest.importorskip("ezdxf", reason="ezdxf is not installed")
    drawing = ezdxf.new()
    space = drawing.modelspace()
    space.add_lwpolyline(SQUARE.tolist(), close=True, dxfattribs={"layer": "PILE_7"})
    space.add_line((0, 0), (1, 1))
    drawing.saveas(tmp_path / "a.dxf")
    found = read_outlines(tmp_path / "a.dxf", at(), EXTENT)
    assert [(p.name, len(p.ring)) for p in found.piles] == [("PILE_7", 4)]
    assert found.ignored == 1
    feet = read_outlines(tmp_path / "a.dxf", at(word="us-ft"), EXTENT).piles[0]
    assert feet.ring == pytest.approx(SQUARE * (1200.0 / 3937.0), rel=1e-12)


def test_text_holds_one_geometry_a_line(tmp_path):
    square, two = (
        shapely.Polygon(SQUARE),
        shapely.MultiPolygon([shapely.Polygon(SQUARE + 20.0), shapely.Polygon(TRIANGLE + 40.0)]),
    )
    (tmp_path / "a.wkt").write_text(f"# piles\n{square.wkt}\n\n{two.wkt}\nPOINT(1 2)\n")
    found = read_outlines(tmp_path / "a.wkt", at(None), EXTENT)
    assert [p.name for p in found.piles] == ["pile 1", "pile 2 (1)", "pile 2 (2)"]
    assert found.ignored == 1


def test_piles_of_one_name_are_numbered(tmp_path):
    file = geojson(
        tmp_path / "a.geojson",
        [degrees(SQUARE), degrees(TRIANGLE)],
        [{"name": "sand"}, {"name": "sand"}],
    )
    assert [p.name for p in read_outlines(file, at(), EXTENT).piles] == ["sand #1", "sand #2"]


def test_geojson_that_names_nothing_over_points_that_name_nothing(tmp_path):
    near = np.array([[0.0, 0.0], [10, 0], [10, 10], [0, 10]])
    file = geojson(tmp_path / "a.geojson", [near])
    found = read_outlines(file, at(None), np.array([[-5.0, -5.0], [20.0, 20.0]]))
    assert found.piles[0].ring == pytest.approx(near)
    with pytest.raises(InputError, match="name no CRS"):
        read_outlines(geojson(tmp_path / "b.geojson", [degrees(SQUARE)]), at(None), EXTENT)
    # numbers that cannot be degrees are those of the points
    utm = read_outlines(geojson(tmp_path / "c.geojson", [SQUARE]), at(), EXTENT)
    assert utm.piles[0].ring == pytest.approx(SQUARE)


def test_a_datum_that_is_known_badly_is_doubtful(tmp_path):
    file = geojson(tmp_path / "a.geojson", [[[8, 47], [8.1, 47], [8.1, 47.1]]], crs="EPSG:4267")
    found = read_outlines(file, at(), EXTENT)
    assert [d.name for d in found.doubts] == ["outline_datum"]


def test_the_way_between_datums_is_that_of_the_place(tmp_path):
    """The best way for all of NAD 27 is off by 20 m in Ohio, that for the East by 10 m."""
    ohio = CRS.from_epsg(26717)
    near = np.array([[500000.0, 4400000.0], [500010, 4400000], [500010, 4400010]])
    file = geojson(tmp_path / "a.geojson", [[[-81, 39.7], [-80.9, 39.7], [-80.9, 39.8]]])
    (doubt,) = read_outlines(file, at(ohio), np.array([near.min(axis=0), near.max(axis=0)])).doubts
    assert doubt.name == "outline_datum" and doubt.value == 10.0


HOLE = [closed(SQUARE), closed(SQUARE[::-1] * 0 + [[433004, 5100004]] + (SQUARE - SQUARE[0]) * 0.1)]
BOW = [[0, 0], [10, 10], [10, 0], [0, 7]]


@pytest.mark.parametrize(
    ("geometry", "words"),
    [
        ({"type": "Polygon", "coordinates": HOLE}, "a hole"),
        ({"type": "Polygon", "coordinates": [closed(np.array(BOW))]}, "cross"),
        ({"type": "Polygon", "coordinates": [[[0, 0], [1, 1], [2, 2], [0, 0]]]}, "no area"),
        ({"type": "Point", "coordinates": [1, 2]}, "holds no closed area"),
        ({"type": "LineString", "coordinates": [[0, 0], [1, 0], [1, 1]]}, "holds no closed area"),
        (None, "holds no closed area"),
    ],
)
def test_shapes_that_are_no_outlines_are_refused(tmp_path, geometry, words):
    feature = {"type": "Feature", "properties": {}, "geometry": geometry}
    text = json.dumps({"type": "FeatureCollection", "features": [feature]})
    (tmp_path / "a.geojson").write_text(text)
    with pytest.raises(InputError, match=words):
        read_outlines(tmp_path / "a.geojson", at(None), np.array([[-1.0, -1], [1, 1]]) * 1e7)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.geojson", "{", "no outlines can be read"),
        ("a.shp", "nothing", "no outlines can be read"),
        ("a.wkt", "POLYGON((0 0", "no WKT"),
        ("a.wkt", "\udcff", "no WKT"),
        ("a.wkt", "GEOMETRYCOLLECTION(" * 100_000, "more than 20 brackets"),
        ("a.wkt", "CURVEPOLYGON(CIRCULARSTRING(0 0,1 1,2 0,1 -1,0 0))", "no WKT"),
        (
            "a.wkt",
            "POLYGON((0 0, 1e200 0, 1e200 1e200, 0 0))",
            "a corner that is not below 1e\\+12",
        ),
        ("a.wkt", "POLYGON((0 0, nan 0, 1 1, 0 0))", "a corner that is not below"),
        ("a.wkt", "POLYGON((0 0, inf 0, inf 0, 1 1, 0 0))", "a corner that is not below"),
        ("a.xyz", "1 2 3", "no outlines can be read"),
        ("a.kml", "<?a?>" * 5_000 + "<!-- b -->x", "does not begin as a .kml"),
    ],
)
def test_files_that_are_none_are_one_line(tmp_path, name, text, words):
    (tmp_path / name).write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(InputError, match=words) as error:
        read_outlines(tmp_path / name, at(), EXTENT)
    assert "\n" not in str(error.value) and len(str(error.value)) < 300


@pytest.mark.parametrize("name", ["v.kml", "v.geojson", "v.dxf", "v.vrt"])
def test_a_file_that_leads_to_another_is_not_followed(tmp_path, name):
    """GDAL opens a virtual source by its content, whatever its ending says."""
    other = geojson(tmp_path / "other.geojson", [degrees(SQUARE)])
    layer = f'<OGRVRTLayer name="other"><SrcDataSource>{other}</SrcDataSource></OGRVRTLayer>'
    (tmp_path / name).write_text(f"<OGRVRTDataSource>{layer}</OGRVRTDataSource>")
    with pytest.raises(InputError, match="no outlines can be read"):
        read_outlines(tmp_path / name, at(), EXTENT)


def test_kml_may_have_a_prolog(tmp_path):
    ring = " ".join(f"{x},{y}" for x, y in closed(degrees(SQUARE)))
    area = f"<outerBoundaryIs><LinearRing><coordinates>{ring}</coordinates></LinearRing>"
    mark = f"<Placemark><Polygon>{area}</outerBoundaryIs></Polygon></Placemark>"
    start = (
        '\ufeff<?xml version="1.0"?>\n<!-- drawn -->\n<kml xmlns="http://www.opengis.net/kml/2.2">'
    )
    (tmp_path / "a.kml").write_text(f"{start}<Document>{mark}</Document></kml>", "utf-8")
    assert len(read_outlines(tmp_path / "a.kml", at(), EXTENT).piles) == 1


def test_a_density_that_is_no_number_names_its_pile(tmp_path):
    file = geojson(tmp_path / "a.geojson", [degrees(SQUARE)], [{"name": "A", "density": "heavy"}])
    with pytest.raises(ConfigurationError, match=r"A: a density .*heavy"):
        read_outlines(file, at(), EXTENT)
    file = geojson(tmp_path / "b.geojson", [degrees(SQUARE)], [{"name": "A", "density": -1}])
    with pytest.raises(ConfigurationError, match="A: a density of -1"):
        read_outlines(file, at(), EXTENT)


def test_errors_of_heights_from_a_file(tmp_path):
    file = tmp_path / "errors.yaml"
    file.write_text(
        "height_errors:\n  - {name: datum, sigma_m: 0.01}\n"
        "  - {name: trajectory, sigma_m: 0.02, correlation_m: 30}\n"
    )
    one, two = read_height_errors(file)
    assert (one.name, one.sigma_m, one.correlation_m) == ("datum", 0.01, math.inf)
    assert (two.name, two.sigma_m, two.correlation_m) == ("trajectory", 0.02, 30.0)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "height_errors: []",
        "height_errors: 3",
        "other: [{name: a, sigma_m: 1}]",
        "height_errors: [{name: a}]",
        "height_errors: [{name: a, sigma_m: much}]",
        "height_errors: [{name: a, sigma_m: -1}]",
        "height_errors: [{name: a, sigma_m: .nan}]",
        "height_errors: [{name: a, sigma_m: true}]",
        "height_errors: [{name: a, sigma_m: 1, correlation_m: 0}]",
        "height_errors: [{name: noise, sigma_m: 1}]",
        "height_errors: [{name: 'a b', sigma_m: 1}]",
        "height_errors: [{name: a, sigma_m: 1}, {name: a, sigma_m: 2}]",
        "height_errors: [3]",
    ],
)
def test_files_that_hold_no_errors_of_heights_are_refused(tmp_path, text):
    (tmp_path / "e.yaml").write_text(text)
    with pytest.raises(ConfigurationError) as error:
        read_height_errors(tmp_path / "e.yaml")
    assert "\n" not in str(error.value)
