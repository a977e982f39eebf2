"""Mesh files: every format there and back, what others write, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from closed_meshes import CUBE_T, CUBE_V

from ladar_volume.io.meshfiles.mesh_files import read_mesh, write_mesh
from ladar_volume.io.meshfiles.polygons import triangulate_faces
from ladar_volume.mesh.tetrahedra import closed_volume
from ladar_volume.model.errors import InputError, OutputError

V, T = CUBE_V, CUBE_T.astype(np.int32)
QUADS = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]


@pytest.mark.parametrize("ending", ["ply", "obj", "off"])
def test_there_and_back_to_the_last_bit(tmp_path, ending):
    v = V * np.pi + np.array([500_000.1, 5_600_000.2, 300.3])
    write_mesh(tmp_path / f"m.{ending}", v, T, ["two\nlines"])
    m = read_mesh(tmp_path / f"m.{ending}")
    assert (m.vertices == v).all() and (m.triangles == T).all() and m.dropped == 0


def test_stl_is_welded(tmp_path):
    write_mesh(tmp_path / "m.stl", V, T)
    m = read_mesh(tmp_path / "m.stl")
    assert len(m.vertices) == 8 and closed_volume(
        m.vertices, m.triangles
    ).volume_m3 == pytest.approx(1.0)
    text = "solid cube\n" + "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"  vertex {x} {y} {z}\n" for x, y, z in V[t])
        + "endloop\nendfacet\n"
        for t in T
    )
    (tmp_path / "a.STL").write_text(
        text
        + (
            "facet normal 0 0 0\nouter loop\nvertex 1 1 1\nvertex 1 1 1\nvertex 0 0 "
            "0\nendloop\nendfacet\nendsolid\n"
        )
    )
    a = read_mesh(tmp_path / "a.STL")
    assert (
        len(a.vertices) == 8
        and a.dropped == 1
        and closed_volume(a.vertices, a.triangles).volume_m3 == pytest.approx(1.0)
    )


def ply(fmt, faces, more=""):
    head = (
        f"ply\nformat {fmt} 1.0\ncomment c\nelement vertex 8\nproperty float x\nproperty "
        "float y\nproperty float z\nproperty uchar red\n"
    )
    return (
        head
        + f"element face {len(faces)}\n{more}property list uchar int vertex_index\nend_header\n"
    ).encode()


@pytest.mark.parametrize("order", ["<", ">", ""])
@pytest.mark.parametrize("mixed", [False, True])
def test_ply_of_quads_and_of_mixed_faces(tmp_path, order, mixed):
    faces = [*QUADS[:5], [1, 3, 5], [3, 7, 5]] if mixed else QUADS
    fmt = {"<": "binary_little_endian", ">": "binary_big_endian", "": "ascii"}[order]
    if order:
        rows = np.zeros(8, [("p", order + "f4", 3), ("red", "u1")])
        rows["p"] = V
        body = rows.tobytes() + b"".join(
            np.uint8(len(f)).tobytes() + np.array(f, order + "i4").tobytes() for f in faces
        )
    else:
        body = (
            "".join(f"{x} {y} {z} 9\n" for x, y, z in V).encode()
            + "".join(f"{len(f)} {' '.join(map(str, f))}\n" for f in faces).encode()
        )
    (tmp_path / "m.ply").write_bytes(ply(fmt, faces) + body)
    m = read_mesh(tmp_path / "m.ply")
    assert len(m.triangles) == 12 and closed_volume(
        m.vertices, m.triangles
    ).volume_m3 == pytest.approx(1.0)


def test_what_others_write(tmp_path):
    obj = "# cube\nmtllib a.mtl\n" + "".join(f"v {x} {y} {z} 1.0\nvn 0 0 1\n" for x, y, z in V)
    (tmp_path / "q.obj").write_text(
        obj
        + "".join("f " + " ".join(f"{i + 1}//{i + 1}" for i in q) + "\n" for q in QUADS[:3])
        + "".join("f " + " ".join(str(i - 8) for i in q) + " # relative\n" for q in QUADS[3:])
    )
    off = "COFF 8 6 0\n# colours follow\n" + "".join(f"{x} {y} {z} 255 0 0\n\n" for x, y, z in V)
    (tmp_path / "q.off").write_text(
        off + "".join(f"4 {' '.join(map(str, q))} 0.5 0.5 0.5\n" for q in QUADS)
    )
    for name in ("q.obj", "q.off"):
        m = read_mesh(tmp_path / name)
        assert closed_volume(m.vertices, m.triangles).volume_m3 == pytest.approx(1.0)


def test_open3d_reads_what_is_written(tmp_path):
    o3d = pytest.importorskip("open3d")
    for ending in ("ply", "obj", "off", "stl"):
        write_mesh(tmp_path / f"m.{ending}", V, T)
        mesh = o3d.io.read_triangle_mesh(str(tmp_path / f"m.{ending}"))
        assert len(mesh.triangles) == 12
        assert o3d.io.write_triangle_mesh(
            str(tmp_path / f"o.{ending}"), mesh.compute_triangle_normals()
        )
        back = read_mesh(tmp_path / f"o.{ending}")
        assert len(back.triangles) == 12 and np.abs(back.vertices).max() == 1.0


def reason(path):
    with pytest.raises(InputError) as caught:
        read_mesh(path)
    assert path.name in str(caught.value)
    return caught.value.reason


def test_refused_files(tmp_path):
    assert reason(tmp_path / "none.ply") == "input_missing"
    (tmp_path / "a.xyz").write_text("")
    assert reason(tmp_path / "a.xyz") == "input_format"
    (tmp_path / "dir.ply").mkdir()
    assert reason(tmp_path / "dir.ply") == "input_unreadable"
    good = {}
    for ending in ("ply", "obj", "stl", "off"):
        write_mesh(tmp_path / f"g.{ending}", V, T)
        good[ending] = (tmp_path / f"g.{ending}").read_bytes()
    cases = {
        "e.ply": (b"", "mesh_file_header"),
        "e.off": (b"", "mesh_file_header"),
        "e.obj": (b"", "mesh_file_empty"),
        "e.stl": (b"", "mesh_file_short"),
        "s.ply": (good["ply"][:-5], "mesh_file_short"),
        "s.stl": (good["stl"][:-5], "mesh_file_short"),
        "s.off": (good["off"][:-20], "mesh_file_short"),
        "n.obj": (b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "mesh_file_values"),
        "i.obj": (b"v 0 0 0\nf 1 2 3\n", "mesh_file_index"),
        "z.obj": (b"v 0 0 0\nf 0 1 1\n", "mesh_file_index"),
        "w.obj": (b"v 0 0\n", "mesh_file_values"),
        "t.obj": (b"v a b c\n", "mesh_file_values"),
        "d.obj": (b"v 0 0 0\nf 1 1\n", "mesh_file_values"),
        "h.off": (b"OFF\n-1 2 0\n", "mesh_file_header"),
        "huge.off": (b"OFF\n99999999999 2 0\n", "mesh_file_short"),
        "c.ply": (
            b"ply\nformat ascii 1.0\nelement vertex 1\n"
            b"property float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n",
            "mesh_file_fields",
        ),
        "f.ply": (b"ply\nformat other 1.0\nend_header\n", "mesh_file_header"),
        "b.ply": (ply("ascii", QUADS) + b"x " * 32, "mesh_file_values"),
        "l.ply": (ply("ascii", QUADS) + b"1 " * 32 + b"-3 0 0 0", "mesh_file_short"),
        "huge.ply": (
            good["ply"].replace(b"element face 12", b"element face 1200000000"),
            "mesh_file_short",
        ),
        "0.stl": (bytes(84), "mesh_file_empty"),
        "x.stl": (b"solid\nfacet\nvertex 0 0 0\nendsolid", "mesh_file_short"),
    }
    for name, (data, expected) in cases.items():
        (tmp_path / name).write_bytes(data)
        assert reason(tmp_path / name) == expected, name


@pytest.mark.parametrize("seed", range(40))
def test_damaged_files_raise_typed_errors_or_read(tmp_path, seed):
    rng = np.random.default_rng(seed)
    for ending in ("ply", "obj", "stl", "off"):
        path = tmp_path / f"m.{ending}"
        write_mesh(path, V, T)
        data = bytearray(path.read_bytes())
        for i in rng.integers(0, len(data), 3):
            data[i] = int(rng.integers(0, 256))
        path.write_bytes(bytes(data[: rng.integers(1, len(data) + 1)] if seed % 2 else data))
        try:
            m = read_mesh(path)
        except InputError:
            continue
        assert (
            np.isfinite(m.vertices).all()
            and 0 <= m.triangles.min()
            and m.triangles.max() < len(m.vertices)
        )


def test_polygons_and_output_errors(tmp_path):
    quad, doubts = triangulate_faces(V, np.array([[0, 1, 3, 2]]))
    assert quad.tolist() == [[0, 1, 3], [0, 3, 2]] and doubts == ()
    with pytest.raises(InputError, match="no face"):
        triangulate_faces(V, [])
    with pytest.raises(OutputError):
        write_mesh(tmp_path / "m.xyz", V, T)
    with pytest.raises(OutputError):
        write_mesh(tmp_path / "no" / "m.ply", V, T)


def area_xy(v, t):
    p = v[t]
    u, w = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    return 0.5 * (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0])


def test_faces_with_corners_that_point_inward():
    outline = np.array([(0, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3.0)])
    v = np.c_[outline, 0.5 + 0.1 * outline.sum(axis=1)]
    for start in range(6):
        for way in (1, -1):
            face = np.roll(np.arange(6), start)[::way]
            triangles, doubts = triangulate_faces(v, [face, [0, 1, 2]])
            signed = way * area_xy(v, triangles[:4])
            # no triangle lies over another, whichever corner comes first
            assert doubts == () and (signed > 0).all() and signed.sum() == pytest.approx(5.0)
            assert triangles[4].tolist() == [0, 1, 2]


def test_faces_in_no_plane_are_a_doubt():
    flat = np.array([[x, y, 0.01 * x] for y in range(4) for x in range(4)], float)
    quads = np.array([[a, a + 1, a + 5, a + 4] for a in (0, 1, 2, 4, 5, 6, 8, 9, 10)])
    assert triangulate_faces(flat, quads)[1] == ()
    saddle = flat + np.outer(0.2 * flat[:, 0] * flat[:, 1], [0, 0, 1])
    (doubt,) = triangulate_faces(saddle, quads)[1]
    p = saddle[quads]
    either = np.abs(np.linalg.det(p[:, 1:] - p[:, :1])).sum() / 6  # what the two diagonals enclose
    assert doubt.name == "mesh_bent_faces" and either < doubt.value < 4 * either
    assert "9 faces" in doubt.text
