"""Handles that noise makes at the ends of concave edges, and faces that one bad connection turns
inside out.
"""

import numpy as np
import pytest

from benchmarks.bodies import CASES, cloud
from ladar_volume.clouds.filter_cloud import filter_cloud
from ladar_volume.mesh.local_frames import flip_to_agree
from ladar_volume.mesh.local_growth import FAN, add_to_fans, list_triangles
from ladar_volume.mesh.local_holes import (
    clear_vertices,
    fill_holes,
    open_handles,
    rim_lengths,
    rims,
    rims_at_vertices,
)
from ladar_volume.mesh.local_mesh import UNUSED, mesh_cloud
from ladar_volume.mesh.topology import orient
from ladar_volume.model.parameters import FilterParameters

SLACK = 0.05
#: Twelve vertices round a hole of 2 x 2 m, counter-clockwise, and the ends of a level and an
#: upright strip across it.
HOLE = np.array(
    [
        (1, -0.3),
        (1, 0.3),
        (1, 1),
        (0.3, 1),
        (-0.3, 1),
        (-1, 1),
        (-1, 0.3),
        (-1, -0.3),
        (-1, -1),
        (-0.3, -1),
        (0.3, -1),
        (1, -1),
    ]
)
LEVEL, UPRIGHT = (7, 0, 1, 6), (9, 10, 3, 4)


def sheet(*across):
    """Two rings of triangles in a plane round a hole, and quads across it that know nothing of each
    other: points, normals, fans.
    """
    points = np.c_[np.concatenate([HOLE, 2 * HOLE, 3 * HOLE]), np.zeros(36)]
    fan, size = np.zeros((36, FAN, 3), np.int32), np.zeros(36, np.int32)
    for ring in (0, 12):
        for i in range(12):
            a, b, c, d = ring + i, ring + 12 + i, ring + 12 + (i + 1) % 12, ring + (i + 1) % 12
            add_to_fans(fan, size, a, b, c, 3)
            add_to_fans(fan, size, a, c, d, 3)
    for a, b, c, d in across:
        add_to_fans(fan, size, a, b, c, 3)
        add_to_fans(fan, size, a, c, d, 3)
    return points, np.tile([0.0, 0, 1], (36, 1)), fan, size


def triangles(fan, size):
    out = np.empty((int(size.sum()) // 3, 4), np.int32)
    list_triangles(fan, size, out)
    return out[:, :3]


def test_the_rim_of_two_strips_that_cross_misses_four_half_turns():
    points, n, fan, size = sheet(LEVEL, UPRIGHT)
    whole = orient(points, triangles(fan, size))
    assert whole.euler == -2
    _, start, excess = rims(points, n, fan, size, SLACK)
    assert sorted(np.diff(start)) == [12, 12] and np.sort(excess) == pytest.approx([-4.0, 4.0])
    # what bounds one strip is a hole on either side of it
    one = rims(*sheet(LEVEL), SLACK)
    assert np.sort(one[2]) == pytest.approx([0.0, 0.0, 4.0], abs=1e-9)


def test_lengths_of_rims_and_which_of_them_pass_a_vertex():
    points, n, fan, size = sheet()
    rim, start, _ = rims(points, n, fan, size, SLACK)
    order = np.argsort(rim_lengths(points, rim, start))
    assert rim_lengths(points, rim, start)[order] == pytest.approx([8.0, 24.0])
    marked = np.zeros(36, bool)
    marked[30] = True
    assert rims_at_vertices(rim, start, marked)[order].tolist() == [False, True]
    assert (
        rim_lengths(points, rim[:0], start[:1]).shape
        == (0,)
        == rims_at_vertices(rim[:0], start[:1], marked).shape
    )


def test_crossing_strips_are_taken_away_and_their_gap_is_closed_as_one_hole():
    points, n, fan, size = sheet(LEVEL, UPRIGHT)
    opened = np.zeros(36, bool)
    assert open_handles(points, n, fan, size, SLACK, opened) == 24 + 4
    assert not size[:12].any() and np.array_equal(opened, np.arange(36) < 24)
    # longer than the largest hole, but opened
    assert fill_holes(points, n, fan, size, SLACK, 0.1, opened) == (1, 10)
    whole = orient(points, triangles(fan, size))
    assert whole.euler == 1 and not whole.flipped.any()
    a, b, c = (points[triangles(fan, size)[:, k]] for k in range(3))
    assert 0.5 * np.cross(b - a, c - a)[:, 2] @ np.ones(len(a)) == pytest.approx(36.0)


def test_what_is_a_hole_is_not_opened_and_is_closed_by_its_length():
    points, n, fan, size = sheet()
    before, opened = size.copy(), np.zeros(36, bool)
    assert open_handles(points, n, fan, size, SLACK, opened) == 0
    assert np.array_equal(size, before) and not opened.any()
    assert fill_holes(points, n, fan, size, SLACK, 7.9 / np.pi, np.zeros(36, bool)) == (0, 0)
    assert fill_holes(points, n, fan, size, SLACK, 8.1 / np.pi, np.zeros(36, bool)) == (1, 10)


def test_clearing_takes_the_triangles_of_vertices():
    _, _, fan, size = sheet(LEVEL)
    before, touched, cleared = triangles(fan, size), np.zeros(36, bool), [1, 0, 14]
    gone = clear_vertices(fan, size, np.array(cleared, np.int32), touched)
    hit = np.isin(before, cleared).any(axis=1)
    left = triangles(fan, size)
    assert gone == hit.sum() and {frozenset(t) for t in left.tolist()} == {
        frozenset(t) for t in before[~hit].tolist()
    }
    assert touched.tolist() == np.isin(np.arange(36), before[hit]).tolist()
    assert np.array_equal(size, np.bincount(left.ravel(), minlength=36))


def test_a_body_s_own_handle_is_none_of_noise():
    # two strips of a torus that cross, one round its hole and one round its tube: its curvature is
    # that of its handle
    i, j = np.divmod(np.arange(36 * 24), 24)
    a, b = 2 * np.pi * i / 36, 2 * np.pi * j / 24
    points = np.stack(
        [(2 + 0.8 * np.cos(b)) * np.cos(a), (2 + 0.8 * np.cos(b)) * np.sin(a), 0.8 * np.sin(b)],
        axis=1,
    )
    kept = np.minimum(i, 36 - i) < 3
    kept |= np.abs(j - 6) < 3
    mesh = mesh_cloud(points[kept])
    whole = orient(mesh.vertices, mesh.triangles)
    assert whole.euler == -1 and len(mesh.rims) == 1 and np.all(mesh.status != UNUSED)


def test_faces_turn_where_most_of_their_connections_say_so():
    # a tree would hear the strongest connection of face 3 only
    a, b, vote = (
        np.array([0, 1, 0, 0, 1, 2]),
        np.array([1, 2, 2, 3, 3, 3]),
        np.array([9.0, 9, 9, 5, -3, -3]),
    )
    assert flip_to_agree(np.ones(4), a, b, vote).tolist() == [1, 1, 1, -1]
    assert flip_to_agree(np.array([-1.0, -1, -1, 1]), a, b, vote).tolist() == [-1, -1, -1, 1]
    assert flip_to_agree(np.ones(3), a[:0], b[:0], vote[:0]).tolist() == [1, 1, 1]


def test_no_face_is_left_with_more_against_it_and_the_sum_only_grows():
    rng = np.random.default_rng(1)
    a, b = np.triu_indices(30, 1)
    vote, start = rng.normal(size=len(a)), rng.choice([-1.0, 1.0], 30)
    out = flip_to_agree(start, a, b, vote)
    share = vote * out[a] * out[b]
    assert (np.bincount(a, share, 30) + np.bincount(b, share, 30)).min() >= 0.0
    assert share.sum() > vote @ (start[a] * start[b]) and np.array_equal(
        flip_to_agree(out, a, b, vote), out
    )


@pytest.mark.parametrize(("name", "seed"), [("L-block", 2), ("two boxes that touch", 7)])
def test_bodies_with_concave_edges_have_no_handle(name, seed):
    f = filter_cloud(cloud(CASES[name], seed), FilterParameters(), auto=True)
    mesh = mesh_cloud(f.r, f.normal)
    whole = orient(mesh.vertices, mesh.triangles)
    assert whole.euler + len(mesh.rims) == 2 * (int(whole.part.max()) + 1)
    # a face turned inside out would take a tenth of the volume or more
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] - mesh.vertices.mean(axis=0) for k in range(3))
    assert np.einsum("ni,ni->", a, np.cross(b, c)) / 6 == pytest.approx(
        CASES[name].volume_m3, rel=0.03
    )
