"""Bodies that touch along edges and faces, in a file that lists corners by position."""

from __future__ import annotations

import numpy as np
import pytest
from closed_meshes import CUBE_T, CUBE_V

from ladar_volume.io.meshfiles.mesh_files import read_mesh, write_mesh
from ladar_volume.math.se3 import exp_so3
from ladar_volume.mesh.tetrahedra import closed_volume
from ladar_volume.mesh.topology import edge_table
from ladar_volume.mesh.welding import distinct_triangles, pair_half_edges, split_edges, weld

TURN = exp_so3(np.array([0.4, 1.1, -0.7]))


def by_position(v, t):
    """One vertex for each position, as STL has it."""
    vertices, triangles, dropped = weld(v, t.astype(np.int32))
    assert dropped == 0
    return vertices, triangles


def cubes(*shifts):
    v = np.concatenate([CUBE_V + np.array(s) for s in shifts])
    return v, np.concatenate([CUBE_T + 8 * k for k in range(len(shifts))]).astype(np.int32)


@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize(
    "shifts,parts",
    [
        ([(0, 0, 0), (1, 1, 0)], 2),
        ([(0, 0, 0), (1, 1, 0), (0, 2, 0)], 3),
        ([(0, 0, 0), (1, 1, 0), (1, 0, 1), (0, 1, 1)], 4),
        ([(0, 0, 0), (1, 1, 1)], 2),
    ],
)
def test_cubes_that_touch_along_edges_are_bodies_of_their_own(shifts, parts, order):
    v, t = by_position(*cubes(*shifts))
    for r in (v, v @ TURN.T * 1e3 + np.array([5e5, 5.6e6, 300.0])):
        vertices, triangles, source = split_edges(r, t[::order])
        assert (np.diff(edge_table(triangles)[1]) == 2).all()
        assert (vertices == r[source]).all() and (source[triangles] == t[::order]).all()
        body = closed_volume(vertices, triangles)
        scale = 1.0 if r is v else 1e9
        if parts > 2 or shifts[1] != (1, 1, 1):
            assert len(body.volumes_m3) == parts
        assert body.volume_m3 / scale == pytest.approx(parts, rel=1e-9)


def test_a_sound_mesh_stays_as_it_is():
    t = CUBE_T.astype(np.int32)
    assert distinct_triangles(t)[0] is t
    vertices, triangles, source = split_edges(CUBE_V, t)
    assert vertices is CUBE_V and triangles is t and (source == np.arange(8)).all()


def test_an_inner_wall_is_left_to_whoever_needs_a_manifold():
    v, t = by_position(*cubes((0, 0, 0), (1, 0, 0)))
    # the wall between two cubes is there from both sides and has nothing between them
    joined, copies = distinct_triangles(t)
    assert copies == 0
    assert len(joined) == len(t) - 4
    assert closed_volume(v, joined).volume_m3 == pytest.approx(2.0)
    single = np.concatenate([joined, t[~np.isin(np.arange(len(t)), rows_of(t, joined))][:2]])
    assert split_edges(v, single)[1] is single


def rows_of(t, some):
    sets = {tuple(x) for x in some.tolist()}
    return [k for k, x in enumerate(t.tolist()) if tuple(x) in sets]


def test_a_mesh_with_two_sides_keeps_one(tmp_path):
    both = np.concatenate([CUBE_T, CUBE_T[:, ::-1]])
    write_mesh(tmp_path / "a.stl", CUBE_V, both)
    mesh = read_mesh(tmp_path / "a.stl")
    assert mesh.twice == 12 and mesh.doubts[0].name == "mesh_duplicate_faces"
    assert closed_volume(mesh.vertices, mesh.triangles).volume_m3 == pytest.approx(1.0)


def test_both_sides_of_nothing_do_not_count(tmp_path):
    v, t = cubes((0, 0, 0), (1, 0, 0))  # a face in common
    write_mesh(tmp_path / "a.stl", v, t)
    mesh = read_mesh(tmp_path / "a.stl")
    assert (mesh.dropped, mesh.twice, mesh.doubts) == (4, 0, ())
    assert closed_volume(mesh.vertices, mesh.triangles).volume_m3 == pytest.approx(2.0)


def test_two_cubes_with_an_edge_in_common_as_stl(tmp_path):
    v, t = cubes((0, 0, 0), (1, 1, 0))
    write_mesh(tmp_path / "a.stl", v, t)
    mesh = read_mesh(tmp_path / "a.stl")
    assert mesh.doubts == () and closed_volume(
        mesh.vertices, mesh.triangles
    ).volume_m3 == pytest.approx(2.0)


def test_four_triangles_at_one_angle_still_come_in_pairs():
    rng = np.random.default_rng(4)
    for _ in range(50):
        count = 2 * int(rng.integers(1, 5))
        angle = rng.choice([0.0, 1.0, 1.0, 2.5, 4.0], count)
        v = np.concatenate(
            [[[0, 0, 0], [0, 0, 1.0]], np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)]
        )
        way = rng.permutation(np.arange(count) % 2 == 0)
        t = np.array([[0, 1, 2 + k] if w else [1, 0, 2 + k] for k, w in enumerate(way)], np.int32)
        pairs = pair_half_edges(v @ TURN.T, t, 3 * np.arange(count))
        assert sorted(pairs.ravel().tolist()) == (3 * np.arange(count)).tolist()
        assert not way[pairs[:, 0] // 3].any() and way[pairs[:, 1] // 3].all()
        one = t.copy()
        one[0] = one[0][[1, 0, 2]]
        assert pair_half_edges(v, one, 3 * np.arange(count)) is None
