"""What this program writes it reads again as the same surface: system, units, breaklines; systems
that options add stay in LAS; tables of other programs.
"""

import json
from pathlib import Path

import laspy
import numpy as np
import pyproj
import pytest

from ladar_volume.cli.main import main
from ladar_volume.io.meshfiles.mesh_files import read_mesh
from ladar_volume.io.pointfiles.cloud_files import read_cloud
from ladar_volume.model.errors import CloudError, InputError

EAST, NORTH = 500_000.0, 150_000.0
FOOT = 1200.0 / 3937.0


def las(path, kind=(6, "1.4"), crs=None, unit=1.0, n=400):
    rng = np.random.default_rng(2)
    xy = rng.uniform(-9.0, 9.0, (n, 2))
    z = np.maximum(0.0, 3.0 - 0.5 * np.hypot(*xy.T)) + rng.normal(0.0, 0.01, n)
    header = laspy.LasHeader(point_format=kind[0], version=kind[1])
    header.scales, header.offsets = [0.0001] * 3, [EAST / unit, NORTH / unit, 0.0]
    if crs:
        header.add_crs(pyproj.CRS.from_user_input(crs))
    out = laspy.LasData(header)
    out.x, out.y, out.z = (np.c_[xy, z] + [EAST, NORTH, 100.0]).T / unit
    out.gps_time, out.classification = np.arange(n) * 0.1, np.full(n, 2)
    out.write(path)
    return path


def facts_of(capsys, *words):
    code = main([*map(str, words), "--json"])
    shown = capsys.readouterr()
    assert code == 0, shown.err
    return json.loads(shown.out)


@pytest.mark.parametrize("feet", [False, True])
def test_surfaces_come_back_with_their_system_and_volume(feet, tmp_path, capsys):
    crs, unit = ("EPSG:6576+6360", FOOT) if feet else ("EPSG:32616", 1.0)
    cloud = las(tmp_path / "a.laz", crs=crs, unit=unit)
    words = ["--level", "99", "-o", tmp_path / "out", "--as", "ply,landxml,stl,las"]
    more = ["--file-units"] if feet else []
    first = facts_of(capsys, "volume", cloud, *words, *more)
    known = first["surfaces"][0]["coordinates"]
    for name, part in (("surface.ply", 1e-12), ("surface.xml", 1e-12), ("surface.stl", 1e-6)):
        choice = ["--surface", "counted"] if name.endswith("xml") else []
        again = facts_of(capsys, "volume", tmp_path / "out" / name, "--level", "99", *choice)
        assert again["net_m3"] == pytest.approx(first["net_m3"], rel=part)
        at = again["surfaces"][0]["coordinates"]
        assert at["units_read"] == known["units_read"]
        if name != "surface.stl":
            assert pyproj.CRS(at["wkt"]).equals(pyproj.CRS(known["wkt"])), name
    again = facts_of(capsys, "volume", tmp_path / "out" / "points.las", "--level", "99")
    assert again["net_m3"] == pytest.approx(first["net_m3"], rel=1e-6)
    assert again["surfaces"][0]["sigma_from"] == "column 'sigma_z'"
    assert again["sigma_m3"] == pytest.approx(first["sigma_m3"], rel=1e-6)


@pytest.mark.parametrize("kind", [(1, "1.2"), (3, "1.2"), (6, "1.4")])
def test_a_system_from_the_options_is_written_to_las(kind, tmp_path, capsys):
    cloud = las(tmp_path / "a.las", kind)
    words = ["-o", tmp_path / "b.laz", "--radius", "1.5", "--crs", "EPSG:32616+5703"]
    facts_of(capsys, "filter", cloud, *words)
    out = laspy.read(tmp_path / "b.laz")
    crs = out.header.parse_crs()
    assert [part.to_epsg() for part in crs.sub_crs_list] == [32616, 5703]
    assert out.header.point_format.id == kind[0] and str(out.header.version) == "1.4"
    assert (np.array(out.gps_time) == np.array(laspy.read(cloud).gps_time)[out["index"]]).all()
    assert read_cloud(tmp_path / "b.laz").coordinates.file_coordinates.heights == "NAVD88 height"


def test_heights_that_the_options_name_are_added_to_the_system_of_the_header(tmp_path, capsys):
    cloud = las(tmp_path / "a.laz", (1, "1.2"), "EPSG:32616")
    words = ["-o", tmp_path / "b.laz", "--radius", "1.5", "--crs", "EPSG:32616+5703"]
    facts_of(capsys, "filter", cloud, *words)
    crs = laspy.read(tmp_path / "b.laz").header.parse_crs()
    assert [part.to_epsg() for part in crs.sub_crs_list] == [32616, 5703]


LAND = """<?xml version="1.0"?>
<LandXML xmlns="http://www.landxml.org/schema/LandXML-1.2" version="1.2">
<Units><Metric linearUnit="meter"/></Units>{system}
<Surfaces><Surface name="a"><SourceData><Breaklines><Breakline brkType="standard"><PntList3D>
{lines}</PntList3D></Breakline></Breaklines></SourceData>
<Definition surfType="TIN"><Pnts>
<P id="1">150000 500000 10</P><P id="2">150000 500010 10</P><P id="3">150010 500010 12</P>
<P id="4">150010 500000 12</P></Pnts><Faces><F>1 2 3</F><F>1 3 4</F></Faces></Definition></Surface>
</Surfaces></LandXML>
"""


def land(path, lines="150000 500000 10 150010 500010 12", system=""):
    path.write_text(LAND.format(lines=lines, system=system))
    return path


def test_breaklines_are_read_compared_with_the_faces_and_written(tmp_path, capsys):
    system = '<CoordinateSystem epsgCode="32616"/>'
    path = land(tmp_path / "a.xml", system=system)
    words = ["--level", "0", "--sigma", "0", "-o", tmp_path / "out", "--as", "landxml"]
    facts = facts_of(capsys, "volume", path, *words)
    assert facts["net_m3"] == pytest.approx(1100.0, rel=1e-12)
    assert facts["surfaces"][0]["mesh"]["breaklines"] == 1
    assert facts["surfaces"][0]["coordinates"]["code"] == "EPSG:32616"
    assert not facts["verdict"]["reasons"]
    again = read_mesh(tmp_path / "out" / "surface.xml", "counted")
    assert (again.breaklines[0] == [[500000, 150000, 10], [500010, 150010, 12]]).all()
    off = land(tmp_path / "b.xml", "150000 500000 10 150005 500005 11.5 150010 500010 12")
    facts = facts_of(capsys, "volume", off, "--level", "0", "--sigma", "0")
    (reason,) = facts["verdict"]["reasons"]
    assert reason["name"] == "mesh_breaklines" and reason["value"] == pytest.approx(0.5)


@pytest.mark.parametrize("lines", ["1 2", "1 2 x", "1 2 nan"])
def test_breaklines_that_make_no_points_are_refused(lines, tmp_path):
    with pytest.raises(InputError):
        read_mesh(land(tmp_path / "a.xml", lines))


def test_a_system_that_nobody_knows_is_a_doubt(tmp_path, capsys):
    path = land(tmp_path / "a.xml", system='<CoordinateSystem epsgCode="999999"/>')
    facts = facts_of(capsys, "volume", path, "--level", "0", "--sigma", "0")
    assert [r["name"] for r in facts["verdict"]["reasons"]] == ["mesh_crs"]


def test_a_design_in_another_system_than_the_cloud_is_refused(tmp_path, capsys):
    path = land(tmp_path / "a.xml", system='<CoordinateSystem epsgCode="32617"/>')
    cloud = las(tmp_path / "b.laz", crs="EPSG:32616")
    assert main(["volume", str(cloud), str(path)]) == 2
    assert "unlike systems" in capsys.readouterr().err


POINTS = np.array([EAST, NORTH, 100.0]) + np.random.default_rng(3).uniform(0.0, 20.0, (60, 3))


@pytest.mark.parametrize(
    ("name", "head", "order", "separator", "comma"),
    [
        ("a.csv", "Easting,Northing,Elevation", "xyz", ",", "."),
        ("a.csv", "Point,Northing,Easting,Elevation", "nyxz", ",", "."),
        ("a.csv", "EAST,NORTH,RL", "xyz", ",", "."),
        ("a.csv", "X Coordinate,Y Coordinate,Z Coordinate", "xyz", ",", "."),
        ("a.csv", "Rechtswert;Hochwert;Höhe", "xyz", ";", ","),
        ("a.csv", "Nr;Este;Norte;Cota", "nxyz", ";", ","),
        ("a.txt", "E\tN\tReduced Level", "xyz", "\t", ","),
        ("a.txt", "Easting (m)\tNorthing (m)\tElevation (m)", "xyz", "\t", "."),
        ("a.txt", "No. Northing Easting Height", "nyxz", " ", "."),
    ],
)
def test_tables_of_other_programs(name, head, order, separator, comma, tmp_path):
    places = {"x": 0, "y": 1, "z": 2}
    rows = [
        separator.join(f"{k + 1}" if a == "n" else f"{p[places[a]]:.4f}" for a in order)
        for k, p in enumerate(POINTS)
    ]
    rows = [row.replace(".", comma) for row in rows]
    (tmp_path / name).write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    assert np.abs(read_cloud(tmp_path / name).r - POINTS).max() < 6e-5


@pytest.mark.parametrize(("more", "first"), [("", 1), ("", 101), (",GRD", 1)])
def test_a_first_column_that_counts_is_no_coordinate(more, first, tmp_path):
    rows = [f"{k + first},{y:.3f},{x:.3f},{z:.3f}{more}" for k, (x, y, z) in enumerate(POINTS)]
    path = Path(tmp_path / "a.csv")
    path.write_text("\n".join(rows) + "\n")
    with pytest.raises(CloudError, match="counts the rows"):
        read_cloud(path)
    path.write_text("\n".join(row.partition(",")[2].replace(",GRD", "") for row in rows) + "\n")
    assert len(read_cloud(path)) == len(POINTS)
