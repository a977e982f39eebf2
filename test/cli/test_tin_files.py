"""``tin -o`` in the formats of other programs, read back by those or by themselves."""

from __future__ import annotations

import json

import ezdxf
import numpy as np
import pytest
import rasterio
import trimesh

from ladar_volume.cli.main import main
from ladar_volume.io.meshfiles.mesh_files import read_mesh


@pytest.fixture(scope="module")
def cloud(tmp_path_factory):
    rng = np.random.default_rng(7)
    xy = rng.uniform(0.0, 20.0, (900, 2))
    z = 100.0 + 0.05 * xy[:, 0] + np.maximum(0.0, 2.0 - 0.4 * np.hypot(*(xy - 10.0).T))
    path = tmp_path_factory.mktemp("tin") / "site.xyz"
    np.savetxt(path, np.c_[xy + np.array([4e5, 5e6]), z + rng.normal(0.0, 0.01, len(z))], "%.4f")
    return path


def written(cloud, path, *words):
    assert main(["tin", str(cloud), "-o", str(path), "--crs", "EPSG:25832", *words]) == 0
    return path


def below(corner):
    """Volume, m³, between triangles (m, 3, 3) and height 0, and their area."""
    a, b = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    area = 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    return float(area @ corner[:, :, 2].mean(axis=1)), float(area.sum())


def of_mesh(vertices, faces):
    return np.asarray(vertices)[np.asarray(faces)]


def read_obj(path):
    mesh = trimesh.load(path, force="mesh", process=False)
    return of_mesh(mesh.vertices, mesh.faces)


def read_stl(path):
    x, y, z = map(float, path.read_bytes()[:80].decode().split()[3:6])
    mesh = trimesh.load(path, force="mesh", process=False)
    return of_mesh(mesh.vertices, mesh.faces) + np.array([x, y, z])


def read_glb(path):
    scene = trimesh.load(path, process=False)
    size = int.from_bytes(path.read_bytes()[12:16], "little")
    head = json.loads(path.read_bytes()[20 : 20 + size])
    (mesh,) = scene.geometry.values()
    x, up, south = mesh.vertices.T
    return of_mesh(np.c_[x, -south, up], mesh.faces) + head["asset"]["extras"]["origin_m"]


def read_dxf(path):
    faces = ezdxf.readfile(path).modelspace().query("3DFACE[layer=='surface']")
    return np.array([[f.dxf.vtx0, f.dxf.vtx1, f.dxf.vtx2] for f in faces])


def read_landxml(path):
    mesh = read_mesh(path)
    assert mesh.epsg == "25832"
    return of_mesh(mesh.vertices, mesh.triangles)


@pytest.mark.parametrize(
    ("ending", "read", "near"),
    [
        (".obj", read_obj, 1e-9),
        (".stl", read_stl, 1e-6),
        (".glb", read_glb, 1e-6),
        (".dxf", read_dxf, 1e-9),
        (".xml", read_landxml, 1e-9),
    ],
)
def test_a_surface_in_another_format_is_that_of_the_ply(ending, read, near, cloud, tmp_path):
    mesh = read_mesh(written(cloud, tmp_path / "tin.ply"))
    expected = below(of_mesh(mesh.vertices, mesh.triangles))
    found = read(written(cloud, tmp_path / f"tin{ending}"))
    assert len(found) == len(mesh.triangles)
    assert below(found) == pytest.approx(expected, rel=near)


def test_a_raster_has_heights_with_sigma_and_contours_lie_on_round_heights(cloud, tmp_path):
    with rasterio.open(written(cloud, tmp_path / "tin.tif")) as file:
        height, sigma = file.read()
        assert file.crs.to_epsg() == 25832
    assert 99.9 < np.nanmin(height) < np.nanmax(height) < 103.1
    assert 0.0 < np.nanmedian(sigma) < 0.02
    lines = json.loads(written(cloud, tmp_path / "tin.geojson").read_text())["features"]
    heights = {line["properties"]["height_m"] for line in lines}
    assert len(heights) > 3 and all(abs(10.0 * h - round(10.0 * h)) < 1e-9 for h in heights)


def test_a_name_of_a_cloud_that_xml_cannot_hold_is_no_name_of_a_surface(cloud, tmp_path):
    odd = tmp_path / "a \x07 <b> & c.xyz"
    odd.write_bytes(cloud.read_bytes())
    assert len(read_landxml(written(odd, tmp_path / "tin.xml"))) > 100
    assert len(read_dxf(written(odd, tmp_path / "tin.dxf"))) > 100


@pytest.mark.parametrize(
    ("name", "words", "said"),
    [
        ("a.off", [], "written as .ply, .xml"),
        ("a.xml", ["--all-triangles"], "--all-triangles is for a surface as .ply"),
        ("a.dxf", ["--frame", "scan"], "--frame scan is for a surface as .ply"),
    ],
)
def test_what_a_format_has_no_room_for_is_refused(name, words, said, cloud, tmp_path, capsys):
    assert main(["tin", str(cloud), "-o", str(tmp_path / name), *words]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert said in line and not (tmp_path / name).exists()
