"""Mesh files at the verbs: their faces are the surface, in every format; parts, repairs, words."""

from __future__ import annotations

import json
from argparse import Namespace
from pathlib import Path

import numpy as np
import pytest
from closed_meshes import CUBE_T, CUBE_V, sphere

from ladar_volume.cli.diff_input import load
from ladar_volume.cli.main import main
from ladar_volume.io.endings import ENDINGS
from ladar_volume.io.meshfiles.mesh_files import read_mesh, write_mesh
from ladar_volume.io.pointfiles.cloud_files import write_cloud

DATA = Path(__file__).parents[1] / "data"
CROP, PART = DATA / "road_crop.xml", DATA / "featuretype.STL"
L_V = np.array([[x, y, 1.0 + 0.25 * x] for y in (0, 2, 4) for x in (0, 2, 4)], float)
L_T = np.array([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [3, 4, 7], [3, 7, 6]], np.int32)


@pytest.fixture
def run(capsys):
    def call(*words, code=0):
        assert main([*map(str, words), "--json"]) == code
        return json.loads(capsys.readouterr().out)

    return call


@pytest.fixture
def refused(capsys):
    def call(*words):
        assert main([*map(str, words)]) == 2
        (line,) = capsys.readouterr().err.strip().splitlines()
        return line

    return call


#: What no reading option says.
READ = Namespace(crs=None, units=None, classes=None)


def above(vertices, triangles, level):
    """Net volume above a level: every triangle's footprint times its mean height."""
    p = vertices[triangles]
    u, v = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    area = 0.5 * np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    return float((area * (p[:, :, 2].mean(axis=1) - level)).sum())


def clipped(ring, a, b):
    """The part of a ring to the left of the line from a to b."""
    out = []
    side = [(b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) for p in ring]
    for k, p in enumerate(ring):
        q, s, t = ring[k - 1], side[k], side[k - 1]
        if s * t < 0:
            out.append(q + (p - q) * t / (t - s))
        if s >= 0:
            out.append(p)
    return out


def plane(p):
    return np.linalg.solve(np.column_stack([p[:, :2], np.ones(3)]), p[:, 2])


def net_between(one, two):
    """Net volume and area between two meshes over their common footprint: a plain overlay."""
    origin = one.vertices.min(axis=0) * [1, 1, 0]
    a, b = (m.vertices[m.triangles] - origin for m in (one, two))
    net = area = 0.0
    low, high = b[:, :, :2].min(axis=1), b[:, :, :2].max(axis=1)
    for p in a:
        near = (low < p[:, :2].max(axis=0)).all(axis=1) & (high > p[:, :2].min(axis=0)).all(axis=1)
        up = plane(p)
        for q in b[near]:
            ring = list(p[:, :2])
            for k in range(3):
                ring = clipped(ring, q[k, :2], q[(k + 1) % 3, :2])
                if len(ring) < 3:
                    break
            if len(ring) < 3:
                continue
            slope = up - plane(q)
            r = np.array(ring)
            for k in range(1, len(r) - 1):
                u, v = r[k] - r[0], r[k + 1] - r[0]
                piece = 0.5 * (u[0] * v[1] - u[1] * v[0])
                middle = (r[0] + r[k] + r[k + 1]) / 3
                net, area = net + piece * float(slope @ [*middle, 1.0]), area + piece
    return net, area


@pytest.mark.parametrize("ending", ENDINGS)
def test_faces_are_the_surface_in_every_format(ending, tmp_path, run):
    write_mesh(tmp_path / f"l{ending}", L_V, L_T)
    facts = run("volume", tmp_path / f"l{ending}", "--level", 1)
    # three squares of 4 m², 0.25 and 0.75 m above the level on the mean
    assert facts["net_m3"] == pytest.approx(5.0, rel=1e-6) and facts["area_m2"] == pytest.approx(12)
    assert facts["sigma_m3"] is None and "no noise" in facts["surfaces"][0]["sigma_from"]
    mesh = facts["surfaces"][0]["mesh"]
    assert (mesh["faces"], mesh["parts"], mesh["overlap_m2"]) == (6, 1, 0.0)
    assert [r["name"] for r in facts["verdict"]["reasons"]] == ["no_sigma"]
    exact = run("volume", tmp_path / f"l{ending}", "--level", 1, "--sigma", 0)
    assert (exact["sigma_m3"], exact["verdict"]["status"]) == (0.0, "sound")
    hull = run("volume", tmp_path / f"l{ending}", "--level", 1, "--no-faces")
    wide = 14.0 if ending == ".stl" else 16.0  # a vertex in no face is a point
    assert hull["area_m2"] == pytest.approx(wide) and hull["surfaces"][0]["mesh"] is None


@pytest.mark.parametrize(("words", "said"), [([], "metre (assumed)"), (["--units", "mm"], "→ m")])
def test_the_unit_of_a_mesh_that_names_none_is_said(words, said, tmp_path, capsys):
    write_mesh(tmp_path / "l.stl", L_V, L_T)
    main(["volume", str(tmp_path / "l.stl"), "--level", "0", *words])
    (line,) = [one for one in capsys.readouterr().out.splitlines() if "units:" in one]
    assert said in line


def test_a_landxml_surface_above_a_level(run, refused):
    for name in ("Highest", "Lowest"):
        mesh = read_mesh(CROP, name)
        facts = run("volume", CROP, "--surface", name, "--level", 14)
        expected = above(mesh.vertices, mesh.triangles, 14.0)
        assert facts["net_m3"] == pytest.approx(expected, abs=1e-6) and facts["fill_m3"] == 0.0
        said = facts["surfaces"][0]["mesh"]
        assert (said["surface"], said["unit"], said["epsg"]) == (name, "meter", "3875")
        levels = run("volume", CROP, "--surface", name, "--levels", 14, 18, 0.5, "--base", "floor")
        assert levels["sequences"][0]["cut_m3"][0] == pytest.approx(expected, abs=1e-6)
    assert "'Highest', 'Lowest'" in refused("volume", CROP, "--level", 14)


def test_two_meshes_over_their_common_footprint(run):
    high, low = read_mesh(CROP, "Highest"), read_mesh(CROP, "Lowest")
    net, area = net_between(high, low)
    words = ("volume", CROP, CROP, "--surface", "Highest", "--surface-b", "Lowest")
    facts = run(*words)
    assert facts["net_m3"] == pytest.approx(net, rel=1e-7)
    assert facts["area_m2"] == pytest.approx(area, rel=1e-9) and facts["base"].startswith(
        "surface of Lowest"
    )
    back = run("volume", CROP, CROP, "--surface", "Lowest", "--surface-b", "Highest")
    assert back["net_m3"] == pytest.approx(-net, rel=1e-7)
    noisy = run(*words, "--sigma", 0.02)
    assert 0.0 < noisy["sigma_m3"] < 0.02 * area and noisy["net_m3"] == pytest.approx(net, rel=1e-7)


def test_a_mesh_and_a_cloud(tmp_path, run):
    rng = np.random.default_rng(3)
    xy = rng.uniform(-1, 5, (4000, 2))
    write_cloud(tmp_path / "flat.ply", np.c_[xy, 0.5 + 0.01 * rng.normal(size=4000)])
    write_mesh(tmp_path / "l.ply", L_V, L_T)
    facts = run("volume", tmp_path / "l.ply", tmp_path / "flat.ply")
    assert facts["area_m2"] == pytest.approx(12.0) and facts["sigma_m3"] is None
    assert facts["net_m3"] == pytest.approx(5.0 + 12 * 0.5, abs=0.02)
    known = run("volume", tmp_path / "l.ply", tmp_path / "flat.ply", "--sigma", 0.01)
    assert known["sigma_m3"] > 0.0


def test_the_tin_of_a_mesh_is_the_mesh(tmp_path, run):
    out = tmp_path / "tin.ply"
    facts = run("tin", CROP, "--surface", "Lowest", "-o", out)
    assert facts["output"]["faces"] == 562 and facts["mesh"]["surface"] == "Lowest"
    one, two = read_mesh(CROP, "Lowest"), read_mesh(out)
    assert above(two.vertices, two.triangles, 14) == pytest.approx(
        above(one.vertices, one.triangles, 14), rel=1e-12
    )
    # every triangle written, the irrelevant ones marked: they come back as they were
    edge = run("tin", CROP, "--surface", "Lowest", "-o", out, "--max-edge", 6, "--all-triangles")
    assert edge["output"]["faces"] == 562 and edge["relevant_triangles"] < 562
    assert len(read_mesh(out).triangles) == edge["relevant_triangles"]
    thin = run("tin", CROP, "--surface", "Lowest", "-o", out, "--vertices", 0.5, "--strict", code=3)
    (reason,) = thin["verdict"]["reasons"]
    assert reason["name"] == "mesh_thinned" and thin["vertices"] < 200


def test_options_of_points_are_not_for_faces(tmp_path, refused):
    write_mesh(tmp_path / "l.ply", L_V, L_T)
    for words in (
        ["--window", 0, 0, 1, 1],
        ["--screen", 0.1],
        ["--exchange", "rms"],
        ["--bins", 4],
    ):
        line = refused("volume", tmp_path / "l.ply", "--level", 0, *words)
        assert "is a mesh" in line and words[0] in line and "--no-faces" in line
    write_cloud(tmp_path / "c.csv", L_V)
    assert "point cloud" in refused("volume", tmp_path / "c.csv", "--level", 0, "--surface", "x")


def test_what_is_no_surface_is_refused(tmp_path, refused):
    assert "ladar_volume body" in refused("volume", PART, "--level", 0)
    write_mesh(tmp_path / "two.ply", np.r_[L_V, L_V + np.array([0.5, 0, 1])], np.r_[L_T, L_T + 9])
    assert "lie under a second face" in refused("volume", tmp_path / "two.ply", "--level", 0)


def test_double_faces_are_named(tmp_path, run):
    write_mesh(tmp_path / "l.obj", L_V, np.r_[L_T, L_T[2:4, ::-1]])
    facts = run("volume", tmp_path / "l.obj", "--level", 1, "--strict", code=3)
    assert facts["net_m3"] == pytest.approx(5.0) and facts["verdict"]["status"] == "doubtful"
    assert facts["verdict"]["reasons"][0]["name"] == "mesh_duplicate_faces"


def test_the_volume_of_a_part(tmp_path, run, refused):
    facts = run("body", PART, "-o", tmp_path / "part.stl")
    assert facts["volume_m3"] == pytest.approx(11.6277334, abs=1e-7) and facts["watertight"]
    assert facts["bodies"][0]["closures"] == [] and facts["input"]["joined_vertices"] > 100
    again = run("body", tmp_path / "part.stl", "-o", tmp_path / "again.ply")
    assert again["volume_m3"] == pytest.approx(11.6277334, abs=1e-6)
    part = read_mesh(PART)
    write_mesh(tmp_path / "open.ply", part.vertices, part.triangles[1:])
    line = refused("body", tmp_path / "open.ply", "-o", tmp_path / "x.ply")
    assert "a gap 0.0" in line and "0.000 m" not in line


def test_a_body_reads_what_it_wrote(tmp_path, run):
    rng = np.random.default_rng(5)
    v, t = sphere(800)
    r = v * (1 + 0.02 * rng.normal(size=(len(v), 1)))  # rough: neighbours fold over one another
    two = np.r_[r, 0.2 * r + [1.005, 0, 0]]
    write_mesh(tmp_path / "a.ply", two, np.r_[t, t + len(v)])
    words = ("--allow-crossings",)
    first = run("body", tmp_path / "a.ply", "-o", tmp_path / "b.ply", *words)
    assert first["bodies"][0]["crossing_pairs"] > 0
    assert first["bodies"][0]["crossing_m3"] < 0.01 * first["volume_m3"]
    second = run("body", tmp_path / "b.ply", "-o", tmp_path / "c.ply")
    assert second["volume_m3"] == pytest.approx(first["volume_m3"], rel=1e-12)
    assert second["bodies"][0]["crossing_pairs"] == first["bodies"][0]["crossing_pairs"]
    assert second["verdict"]["reasons"][0]["name"] == "mesh_crossings"


def test_bodies_that_share_space_are_refused_with_how_much(tmp_path, refused, run):
    v, t = np.r_[CUBE_V, CUBE_V + np.array([0.5, 0.4, 0.3])], np.r_[CUBE_T, CUBE_T + 8]
    write_mesh(tmp_path / "a.ply", v, t)
    line = refused("body", tmp_path / "a.ply", "-o", tmp_path / "b.ply")
    assert "twice or not at all" in line and "--allow-crossings" in line
    facts = run("body", tmp_path / "a.ply", "-o", tmp_path / "b.ply", "--allow-crossings")
    assert facts["volume_m3"] == pytest.approx(2.0) and facts["verdict"]["status"] == "doubtful"


def test_what_can_be_repaired_in_a_body_is_named(tmp_path, run):
    write_mesh(tmp_path / "double.off", CUBE_V, np.r_[CUBE_T, CUBE_T[:1]])
    facts = run("body", tmp_path / "double.off", "-o", tmp_path / "o.ply", "--strict", code=3)
    assert facts["volume_m3"] == pytest.approx(1.0) and facts["input"]["duplicate_faces"] == 1
    write_mesh(tmp_path / "cut.off", CUBE_V, np.where(CUBE_T == 7, 6, CUBE_T))
    cut = run("body", tmp_path / "cut.off", "-o", tmp_path / "o.ply")
    assert cut["input"]["dropped_faces"] == 2 and cut["watertight"] and cut["volume_m3"] < 1.0
    write_mesh(tmp_path / "big.ply", 2 * CUBE_V, CUBE_T)
    facts = run("diff", tmp_path / "big.ply", tmp_path / "double.off", "--strict", code=3)
    assert facts["volume_m3"] == pytest.approx(7.0)
    assert facts["verdict"]["reasons"][0]["name"] == "mesh_duplicate_faces"


def test_diff_chooses_its_surfaces(tmp_path, run, refused):
    assert "'Highest', 'Lowest'" in refused("diff", CROP, CROP, "--pole", "0,0,0")


def test_faces_that_diff_does_not_use_are_a_doubt(tmp_path):
    write_mesh(tmp_path / "l.ply", L_V, L_T)
    (doubt,) = load(tmp_path / "l.ply", None, READ).verdict.doubts
    assert (doubt.name, doubt.value) == (
        "mesh_faces_unused",
        6,
    ) and "ladar_volume volume" in doubt.text
    write_mesh(tmp_path / "cube.ply", CUBE_V, CUBE_T)
    assert load(tmp_path / "cube.ply", None, READ).verdict.sound
