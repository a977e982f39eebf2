"""Faces of DXF drawings: every kind of them, units, layers, what is refused, damaged drawings."""

from __future__ import annotations

import ezdxf
import numpy as np
import pytest
from closed_meshes import CUBE_T, CUBE_V
from ezdxf.render import MeshBuilder

from ladar_volume.cli.main import main
from ladar_volume.io.meshfiles.mesh_files import in_metres, read_mesh
from ladar_volume.io.pointfiles.crs import Reading
from ladar_volume.io.pointfiles.units import METRE
from ladar_volume.mesh.tetrahedra import closed_volume
from ladar_volume.model.errors import InputError

AT = np.array([500_000.125, 5_600_000.25, 300.0])
V = CUBE_V * 2.0 + AT
KINDS = ("3DFACE", "polyface", "MESH")


def drawing(path, kind="3DFACE", unit=6, layers=("0",), v=V, t=CUBE_T):
    """A mesh on each layer."""
    doc = ezdxf.new()
    doc.header["$INSUNITS"] = unit
    space = doc.modelspace()
    for layer in layers:
        if kind == "3DFACE":
            for face in t:
                space.add_3dface(list(map(tuple, v[face])), dxfattribs={"layer": layer})
            continue
        made = MeshBuilder()
        made.vertices, made.faces = list(map(tuple, v)), [tuple(map(int, face)) for face in t]
        (made.render_polyface if kind == "polyface" else made.render_mesh)(
            space, dxfattribs={"layer": layer}
        )
    doc.saveas(path)
    return path


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_faces_is_read_to_the_last_bit(kind, tmp_path):
    m = read_mesh(drawing(tmp_path / "a.dxf", kind))
    assert {tuple(r) for r in m.vertices.tolist()} == {tuple(r) for r in V.tolist()}
    assert len(m.triangles) == len(CUBE_T) and m.surface == "0"
    assert abs(closed_volume(m.vertices - AT, m.triangles).volume_m3) == pytest.approx(8.0)


def test_a_face_of_four_corners_is_two_triangles(tmp_path):
    square = np.array([[0, 1, 3, 2]])  # the floor of the cube
    m = read_mesh(drawing(tmp_path / "a.dxf", t=square))
    assert len(m.triangles) == 2 and len(m.vertices) == 4


@pytest.mark.parametrize(("unit", "metres"), [(2, 0.3048), (21, 1200 / 3937), (4, 1e-3), (0, 1.0)])
def test_lengths_are_those_of_the_header(unit, metres, tmp_path):
    path = drawing(tmp_path / "a.dxf", unit=unit, v=CUBE_V * 2.0)
    m = in_metres(read_mesh(path), Reading(None, None, None))
    assert m.vertices.max() == pytest.approx(2.0 * metres, rel=1e-12)
    assert [d.name for d in m.doubts] == (["mesh_units"] if unit == 0 else [])
    if unit == 0:
        assert not in_metres(read_mesh(path), Reading(None, METRE, METRE)).doubts


def test_an_unknown_unit_and_one_that_contradicts_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"INSUNITS is 13"):
        read_mesh(drawing(tmp_path / "a.dxf", unit=13))
    feet = read_mesh(drawing(tmp_path / "b.dxf", unit=2))
    with pytest.raises(InputError, match=r"(?i)foot|feet"):
        in_metres(feet, Reading(None, METRE, METRE))


def test_a_layer_is_chosen_by_its_name(tmp_path):
    path = drawing(tmp_path / "a.dxf", layers=("design", "ground"))
    with pytest.raises(InputError, match=r"2 layers: choose one of 'design', 'ground'"):
        read_mesh(path)
    with pytest.raises(InputError, match=r"no face on a layer 'x', but on 'design', 'ground'"):
        read_mesh(path, "x")
    assert read_mesh(path, "ground").surface == "ground"


def test_faces_in_blocks_do_not_count_and_are_named(tmp_path):
    doc = ezdxf.readfile(drawing(tmp_path / "a.dxf"))
    assert not read_mesh(tmp_path / "a.dxf").doubts
    doc.blocks.new("ramp").add_3dface([(0, 0, 0), (1, 0, 0), (0, 1, 0)])
    doc.blocks.new("arrow").add_line((0, 0), (1, 0))
    for name in ("ramp", "arrow"):
        doc.modelspace().add_blockref(name, (500_000, 5_600_000, 300))
    doc.saveas(tmp_path / "b.dxf")
    m = read_mesh(tmp_path / "b.dxf")
    assert len(m.triangles) == len(CUBE_T)
    assert [(d.name, d.value) for d in m.doubts] == [("mesh_blocks", 1)]


def test_what_holds_no_faces_is_refused_in_one_line(tmp_path, capsys):
    doc = ezdxf.new()
    doc.modelspace().add_lwpolyline([(0, 0), (9, 0), (9, 9)], close=True)
    doc.modelspace().add_polyline3d([(0, 0, 1), (9, 0, 1)])
    doc.saveas(tmp_path / "outline.dxf")
    (tmp_path / "text.dxf").write_text("no drawing")
    whole = drawing(tmp_path / "a.dxf").read_bytes()
    (tmp_path / "cut.dxf").write_bytes(whole[: len(whole) // 2])
    for name, words in (("outline", "--piles"), ("text", "no DXF"), ("cut", "no DXF that can")):
        assert main(["volume", str(tmp_path / f"{name}.dxf"), "--level", "1"]) == 2
        error = capsys.readouterr().err
        assert words in error and error.count("\n") == 1


def test_damaged_drawings_end_nothing(tmp_path):
    rng = np.random.default_rng(5)
    lines = drawing(tmp_path / "a.dxf", "polyface").read_text().split("\n")
    path, first = tmp_path / "b.dxf", lines.index("ENTITIES")
    words = ["nan", "inf", "1e400", "-5", "x", "", "MESH", "SEQEND"]
    for _ in range(40):
        bad = list(lines)
        at = int(rng.integers(first, len(bad)))
        bad[at] = str(rng.choice(words))
        path.write_text("\n".join(bad))
        try:
            assert np.isfinite(read_mesh(path).vertices).all()
        except InputError as error:
            assert error.reason.startswith(("mesh_file", "landxml_surface"))
