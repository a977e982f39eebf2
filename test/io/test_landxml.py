"""LandXML: axes, units, invisible faces, surfaces by name, and files that are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ladar_volume.io.meshfiles.mesh_files import read_mesh
from ladar_volume.model.errors import InputError

CROP = Path(__file__).parents[1] / "data" / "road_crop.xml"
METRES = '<Metric areaUnit="squareMeter" linearUnit="meter" elevationUnit="meter"/>'
#: Northing, easting, height of a square of 4 m east by 3 m north, and its middle.
POINTS = [(0, 0, 1), (0, 4, 2), (3, 4, 3), (3, 0, 0), (1.5, 2, 5)]
FACES = ["a b e", "b c e", "c d e", "d a e"]


def definition(points=POINTS, faces=FACES, kind="TIN", hidden=()):
    rows = "".join(
        f'<P id="{key}">{" ".join(map(repr, p))}</P>'
        for key, p in zip("abcde", points, strict=True)
    )
    rows2 = "".join(
        f"<F{' i=' + chr(34) + '1' + chr(34) if k in hidden else ''}>{f}</F>"
        for k, f in enumerate(faces)
    )
    return f'<Definition surfType="{kind}"><Pnts>{rows}</Pnts><Faces>{rows2}</Faces></Definition>'


def land(path, surfaces, units=METRES, head='<?xml version="1.0"?>'):
    inside = "".join(f'<Surface name="{name}">{text}</Surface>' for name, text in surfaces)
    said = f"<Units>{units}</Units>" if units is not None else ""
    path.write_text(
        f'{head}<LandXML xmlns="http://www.landxml.org/schema/LandXML-1.2" version="1.2">{said}'
        f"<CoordinateSystem epsgCode='3067'/><Surfaces>{inside}</Surfaces></LandXML>"
    )
    return path


def refused(path, reason, words, surface=None):
    with pytest.raises(InputError, match=words) as error:
        read_mesh(path, surface)
    assert error.value.reason == reason and str(path) in str(error.value)


def test_the_first_number_is_north(tmp_path):
    mesh = read_mesh(land(tmp_path / "a.xml", [("one", definition())]))
    assert mesh.vertices.tolist() == [[p[1], p[0], p[2]] for p in POINTS]
    assert mesh.triangles.tolist() == [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]
    assert (mesh.surface, mesh.unit, mesh.epsg, mesh.doubts) == ("one", "meter", "3067", ())


def test_invisible_faces_do_not_count(tmp_path):
    path = land(tmp_path / "a.xml", [("one", definition(hidden=(1, 3)))])
    mesh = read_mesh(path)
    assert mesh.triangles.tolist() == [[0, 1, 4], [2, 3, 4]] and mesh.invisible == 2
    hidden = land(tmp_path / "b.xml", [("one", definition(hidden=range(4)))])
    refused(hidden, "mesh_file_empty", "no visible face")


@pytest.mark.parametrize(
    "system,unit,high,factor",
    [
        ("Metric", "millimeter", None, 1e-3),
        ("Metric", "centimeter", "centimeter", 1e-2),
        ("Metric", "kilometer", "kilometer", 1e3),
        ("Imperial", "foot", "feet", 0.3048),
        ("Imperial", "USSurveyFoot", "feet", 1200 / 3937),
        ("Imperial", "USSurveyFoot", None, 1200 / 3937),
        ("Imperial", "inch", None, 0.0254),
    ],
)
def test_lengths_are_metres_whatever_the_file_counts_in(tmp_path, system, unit, high, factor):
    more = f' elevationUnit="{high}"' if high else ""
    units = f'<{system} linearUnit="{unit}"{more}/>'
    mesh = read_mesh(land(tmp_path / "a.xml", [("one", definition())], units))
    expected = np.array([[p[1], p[0], p[2]] for p in POINTS]) * factor
    assert mesh.vertices == pytest.approx(expected, rel=1e-15) and mesh.unit == unit


def test_units_are_not_guessed(tmp_path):
    both = '<Metric linearUnit="millimeter" elevationUnit="meter"/>'
    strange = '<Metric linearUnit="furlong"/>'
    one = [("one", definition())]
    refused(land(tmp_path / "a.xml", one, both), "landxml_units", "'millimeter' and heights in")
    refused(land(tmp_path / "b.xml", one, strange), "landxml_units", "'furlong'")
    silent = read_mesh(land(tmp_path / "c.xml", one, None))
    assert [d.name for d in silent.doubts] == ["mesh_units"] and silent.unit == ""


def test_several_surfaces_are_chosen_by_name(tmp_path):
    higher = definition([(n, e, z + 10) for n, e, z in POINTS])
    path = land(tmp_path / "a.landxml", [("low", definition()), ("high", higher)])
    refused(path, "landxml_surface", "2 surfaces: choose one of 'low', 'high'")
    refused(path, "landxml_surface", "no surface named 'x' among 'low', 'high'", "x")
    assert read_mesh(path, "high").vertices[:, 2].min() == 10.0
    assert read_mesh(path, "low").vertices[:, 2].min() == 0.0


@pytest.mark.parametrize(
    "change,reason,words",
    [
        (lambda s: s.replace("LandXML", "gpx"), "mesh_file_header", "its root is <gpx>"),
        (lambda s: s[:300], "mesh_file_header", "no well-formed XML"),
        (lambda s: s.replace(">a b e<", ">a b z<"), "mesh_file_index", "'z'"),
        (lambda s: s.replace(">0 0 1<", ">0 0<"), "mesh_file_values", "northing, easting"),
        (lambda s: s.replace(">0 0 1<", ">0 0 x<"), "mesh_file_values", "no number"),
        (lambda s: s.replace(">0 0 1<", ">0 0 nan<"), "mesh_file_values", "not finite"),
        (lambda s: s.replace('id="b"', 'id="a"'), "mesh_file_values", "'a' is there twice"),
        (lambda s: s.replace('"TIN"', '"grid"'), "mesh_file_fields", "is a grid"),
        (lambda s: s.replace("Surface ", "Alignment "), "mesh_file_header", "no well-formed"),
    ],
)
def test_what_makes_no_sense_is_refused(tmp_path, change, reason, words):
    path = land(tmp_path / "a.xml", [("one", definition())])
    path.write_text(change(path.read_text()))
    refused(path, reason, words)


def test_an_encoding_that_nobody_knows_is_refused(tmp_path):
    head = '<?xml version="1.0" encoding="UTF-99999"?>'
    path = land(tmp_path / "a.xml", [("one", definition())], head=head)
    refused(path, "mesh_file_header", "unknown encoding")


def test_entities_are_not_expanded(tmp_path):
    laughs = (
        '<?xml version="1.0"?><!DOCTYPE l [<!ENTITY a "1 1 1 ">'
        '<!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">]>'
    )
    path = land(tmp_path / "a.xml", [("one", definition())], head=laughs)
    refused(path, "mesh_file_header", "document type")


def test_the_sample_has_the_areas_of_its_triangles():
    for name, faces, area in (("Highest", 744, 1754.50285), ("Lowest", 562, 1758.71852)):
        mesh = read_mesh(CROP, name)
        p = mesh.vertices[mesh.triangles]
        u, v = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
        up = 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
        # faces are counter-clockwise from above once east is x and north is y
        assert len(p) == faces and (up > 0).all() and up.sum() == pytest.approx(area, abs=1e-3)


def test_elements_within_elements_have_an_end(tmp_path):
    """Each costs a look at all around it: 200,000 took minutes."""
    (tmp_path / "a.xml").write_text("<LandXML>" + "<a>" * 200_000)
    with pytest.raises(InputError, match="more than 100 levels"):
        read_mesh(tmp_path / "a.xml")
