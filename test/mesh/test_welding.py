"""Vertices that differ in their last digits are one; what lies apart stays apart."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from closed_meshes import CUBE_T, CUBE_V, sphere

from ladar_volume.io.meshfiles.mesh_files import read_mesh, write_mesh
from ladar_volume.math.se3 import exp_so3
from ladar_volume.mesh.tetrahedra import closed_volume
from ladar_volume.mesh.welding import open_edges, weld_open

PART = Path(__file__).parents[1] / "data" / "featuretype.STL"
UTM = np.array([500_000.1, 5_600_000.2, 300.3])


def soup(v, t, rng, error):
    """Every triangle with vertices of its own, which miss one another by ``error``."""
    own = v[t].reshape(-1, 3)
    return own + error * rng.uniform(-1, 1, own.shape), np.arange(len(own), dtype=np.int32).reshape(
        -1, 3
    )


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3, 1e6])
@pytest.mark.parametrize("error", [0.0, 1e-15, 1e-9, 3e-8, 2e-7])
def test_a_soup_closes_at_every_size(size, error):
    v, t = sphere(300)
    for at in (0.0, UTM):
        r, own = soup(size * v, t, np.random.default_rng(1), error * size)
        r = r + at
        found = weld_open(r, own)
        assert len(open_edges(found.triangles)) == 0 and found.dropped == 0
        assert found.farthest_m <= 8 * error * size + 1e-8
        assert closed_volume(r, found.triangles).volume_m3 == pytest.approx(
            closed_volume(size * v, t).volume_m3, rel=1e-5
        )


def test_what_is_really_open_stays_open():
    v = CUBE_V.copy()
    t = CUBE_T[:-1].astype(np.int32)  # a triangle is missing
    found = weld_open(v, t)
    assert (found.triangles == t).all() and found.joined == 0
    # two plates a tenth of a millimetre apart are two plates
    plates = np.concatenate([v[:4], v[:4] + np.array([0, 0, 1e-4])])
    faces = np.array([[0, 1, 2], [1, 3, 2], [4, 5, 6], [5, 7, 6]], np.int32)
    assert weld_open(plates, faces).joined == 0


def test_closed_bodies_that_touch_are_not_joined():
    v = np.concatenate([CUBE_V, CUBE_V + np.array([1, 1, 0])])  # an edge in common
    t = np.concatenate([CUBE_T, CUBE_T + 8]).astype(np.int32)
    assert weld_open(v, t).joined == 0
    assert closed_volume(v, weld_open(v, t).triangles).volume_m3 == pytest.approx(2.0)


def ascii_stl(path, v, t, scale, digits):
    rows = ["solid part"]
    for p in v[t] * scale:
        rows += ["facet normal 0 0 0", "outer loop"]
        rows += ["vertex " + " ".join(f"{x:.{digits}e}" for x in q) for q in p]
        rows += ["endloop", "endfacet"]
    path.write_text("\n".join([*rows, "endsolid part"]) + "\n")
    return path


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3, 1e6])
def test_an_exported_part_has_no_open_edge(tmp_path, scale):
    part = read_mesh(PART)
    assert part.joined > 0 and part.joined_m < 1e-12 and part.doubts == ()
    assert len(open_edges(part.triangles)) == 0
    raw = np.frombuffer(
        PART.read_bytes()[84:], [("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "u2")]
    )
    v = raw["v"].astype(np.float64).reshape(-1, 3)
    t = np.arange(len(v)).reshape(-1, 3)
    paths = [ascii_stl(tmp_path / f"a{digits}.stl", v, t, scale, digits) for digits in (6, 8)]
    write_mesh(tmp_path / "b.stl", v * scale, t)
    turned = exp_so3(np.array([0.3, -1.0, 0.2]))
    write_mesh(tmp_path / "c.ply", v @ turned.T * scale + UTM, t)
    for path in [*paths, tmp_path / "b.stl", tmp_path / "c.ply"]:
        mesh = read_mesh(path)
        assert len(open_edges(mesh.triangles)) == 0, path
        volume = closed_volume(mesh.vertices, mesh.triangles).volume_m3
        # far from its origin a part of 5 mm has few digits left
        far = 1e-2 if scale < 1 and path.suffix == ".ply" else 1e-5
        assert volume == pytest.approx(11.6277334 * scale**3, rel=far), path


def test_rounding_that_spoils_a_mesh_is_a_doubt(tmp_path):
    v, t = sphere(300)
    write_mesh(tmp_path / "near.stl", 5 * v, t)
    write_mesh(tmp_path / "far.stl", 5 * v + UTM, t)
    assert read_mesh(tmp_path / "near.stl").doubts == ()
    (doubt,) = read_mesh(tmp_path / "far.stl").doubts
    assert doubt.name == "mesh_rounded" and doubt.value == 0.5 and "0.5 m" in doubt.text


def test_faces_that_are_there_twice_count_once(tmp_path):
    t = np.concatenate([CUBE_T, CUBE_T[3:5], CUBE_T[7:8, [1, 0, 2]], [[1, 1, 2]]])
    write_mesh(tmp_path / "a.obj", CUBE_V, t)
    mesh = read_mesh(tmp_path / "a.obj")
    assert (mesh.twice, mesh.dropped) == (3, 1)
    assert [d.name for d in mesh.doubts] == ["mesh_duplicate_faces"]
    assert closed_volume(mesh.vertices, mesh.triangles).volume_m3 == pytest.approx(1.0)
