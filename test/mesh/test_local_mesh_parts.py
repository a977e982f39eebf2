"""The parts of the mesher: stars, unfolding, signs, rims, the published method and its repairs."""

import itertools

import numpy as np
import pytest
from scipy.spatial import Delaunay

from benchmarks.truth import box_faces, rotation, sample_polygons
from ladar_volume.mesh.local_frames import (
    consistent_normals,
    neighbours,
    neighbours_within,
    tangent_coordinates,
)
from ladar_volume.mesh.local_growth import FAN, add_to_fans, drop_fans, sector_is_free
from ladar_volume.mesh.local_holes import rims
from ladar_volume.mesh.local_mesh import mesh_cloud
from ladar_volume.mesh.local_published import published_triangles, repair_triangles
from ladar_volume.mesh.local_star import DEGREE, star
from ladar_volume.model.body_parameters import LocalMeshParameters


def volume(mesh):
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return float(np.einsum("ni,ni->", a, np.cross(b, c)) / 6)


def plain_star(x, y):
    """Pairs of points that form with the origin a triangle, counter-clockwise, whose circle holds
    no other point: all tried.
    """
    found = set()
    for a, b in itertools.permutations(range(len(x)), 2):
        if x[a] * y[b] - y[a] * x[b] <= 0:
            continue
        # centre of the circle through the origin and both points
        u, v = np.linalg.solve(
            2 * np.array([[x[a], y[a]], [x[b], y[b]]]),
            [x[a] ** 2 + y[a] ** 2, x[b] ** 2 + y[b] ** 2],
        )
        if all(
            (x[k] - u) ** 2 + (y[k] - v) ** 2 > u * u + v * v
            for k in range(len(x))
            if k not in (a, b)
        ):
            found.add((a, b))
    return found


@pytest.mark.parametrize("seed", range(12))
def test_a_star_is_that_of_all_triangles_tried(seed):
    rng = np.random.default_rng(seed)
    count = 2 + 2 * seed
    x, y = rng.normal(size=(2, count)) + (0.0 if seed % 2 else 1.5)
    row = np.full(DEGREE, -1, np.int32)
    size, full = star(x, y, count, row)
    pairs = list(itertools.pairwise(row[:size].tolist())) + (
        [(int(row[size - 1]), int(row[0]))] if full else []
    )
    assert set(pairs) == plain_star(x, y) and len(set(pairs)) == len(pairs)


def test_a_star_of_points_in_line_has_no_triangle():
    row = np.full(DEGREE, -1, np.int32)
    for x in ([1.0, 2.0, 3.0], [-1.0, 2.0, 1.0]):
        size, full = star(np.array(x), np.array(x), 3, row)
        assert size < 2 and not full


def test_unfolding_keeps_lengths_over_an_edge():
    rng = np.random.default_rng(0)
    for angle in (40.0, 90.0, 130.0, -70.0):  # between the normals; the last is a concave edge
        t = np.radians(angle)
        for _ in range(5):
            d, h, s = rng.uniform(0.1, 1.0, 3)
            side = np.sign(t)
            # the first face lies in z = 0 left of the edge, the second goes on from it, bent down
            # by the angle
            points = np.array([(-d, 0.0, 0.0), (h * np.cos(t), s, -h * np.sin(t))])
            normals = np.array([(0.0, 0.0, 1.0), (np.sin(t), 0.0, np.cos(t))])
            R = rotation(rng)
            x, y, same = tangent_coordinates(points @ R.T, normals @ R.T, 0, 1, 0.0)
            assert same and np.hypot(x, y) == pytest.approx(np.hypot(d + h, s)) and side != 0


def test_unfolding_over_a_smooth_part_keeps_the_distance_and_tells_sheets_apart():
    t = np.radians(20.0)
    points = np.array(
        [(0.0, 0.0, 1.0), (np.sin(t), 0.0, np.cos(t)), (0.3, 0.0, 0.7), (0.1, 0.0, 0.5)]
    )
    normals = np.array(
        [(0.0, 0.0, 1.0), (np.sin(t), 0.0, np.cos(t)), (0.0, 0.0, -1.0), (0.0, 0.0, 1.0)]
    )
    x, y, same = tangent_coordinates(points, normals, 0, 1, 0.0)
    assert same and np.hypot(x, y) == pytest.approx(2 * np.sin(t / 2))
    assert not tangent_coordinates(points, normals, 0, 2, 0.0)[2]  # faces the other way
    assert not tangent_coordinates(points, normals, 0, 3, 0.0)[2]  # lies below


def test_signs_agree_and_point_outward_on_a_body_with_a_hole():
    rng = np.random.default_rng(1)
    u, v = rng.uniform(0, 2 * np.pi, (2, 3000))
    n = np.stack([np.cos(v) * np.cos(u), np.cos(v) * np.sin(u), np.sin(v)], axis=1)
    points = np.stack([np.cos(u), np.sin(u), 0 * u], axis=1) + 0.4 * n
    mixed = n * rng.choice([-1.0, 1.0], (3000, 1))
    assert np.allclose(consistent_normals(points, mixed, neighbours(points, 16)[1]), n)


def test_points_within_a_radius():
    points = np.random.default_rng(2).uniform(size=(60, 3))
    start, near = neighbours_within(points, 0.3)
    for i in range(60):
        assert (
            near[start[i] : start[i + 1]].tolist()
            == np.flatnonzero(np.linalg.norm(points - points[i], axis=1) <= 0.3).tolist()
        )


def wheel(spokes):
    """A hub and points round it, with the normals up and empty fans."""
    t = 2 * np.pi * np.arange(spokes) / spokes
    points = np.concatenate([[[0.0, 0, 0]], np.stack([np.cos(t), np.sin(t), 0 * t], axis=1)])
    return (
        points,
        np.tile([0.0, 0, 1.0], (spokes + 1, 1)),
        np.zeros((spokes + 1, FAN, 3), np.int32),
        np.zeros(spokes + 1, np.int32),
    )


def test_a_triangle_that_overlaps_does_not_fit():
    points, normals, fan, size = wheel(8)
    add_to_fans(fan, size, 0, 1, 3, 3)
    assert sector_is_free(points, normals, fan, size, 0, 3, 5, 0.1) and sector_is_free(
        points, normals, fan, size, 0, 8, 1, 0.1
    )
    assert not sector_is_free(points, normals, fan, size, 0, 2, 4, 0.1)  # begins inside
    assert not sector_is_free(points, normals, fan, size, 0, 8, 2, 0.1)  # ends inside
    assert not sector_is_free(points, normals, fan, size, 0, 8, 3, 0.1)  # holds it
    assert not sector_is_free(points, normals, fan, size, 0, 1, 2, 0.1)  # the same side
    assert not sector_is_free(points, normals, fan, size, 0, 5, 3, 0.1)  # faces down


def test_of_two_fans_the_larger_stays():
    _, _, fan, size = wheel(8)
    for a, b in ((1, 2), (2, 3), (5, 6)):
        add_to_fans(fan, size, 0, a, b, 3)
    assert drop_fans(fan, size) == 1 and size.tolist() == [2, 1, 2, 1, 0, 0, 0, 0, 0]


def test_rims_know_a_hole_from_the_outside():
    # a ring of triangles between a square hole and a square outside
    inner = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)], float)
    points = np.c_[np.concatenate([inner, 3 * inner]), np.zeros(8)]
    fan, size = np.zeros((8, FAN, 3), np.int32), np.zeros(8, np.int32)
    for i in range(4):
        j = (i + 1) % 4
        add_to_fans(fan, size, i, 4 + i, 4 + j, 3)
        add_to_fans(fan, size, i, 4 + j, j, 3)
    rim, start, excess = rims(points, np.tile([0.0, 0, 1.0], (8, 1)), fan, size, 0.1)
    by_first = {
        int(rim[a]): (rim[a:b].tolist(), e)
        for a, b, e in zip(start[:-1], start[1:], excess, strict=True)
    }
    assert by_first[0][0] == [0, 1, 2, 3] and by_first[0][1] == pytest.approx(0.0)
    assert by_first[4][0] == [4, 7, 6, 5] and by_first[4][1] == pytest.approx(4.0)


def test_the_published_method_in_the_plane_adds_to_the_plane_triangulation_what_overlaps():
    points = np.c_[np.random.default_rng(3).uniform(size=(60, 2)), np.zeros(60)]
    found = published_triangles(points, 2.0, 2.0)
    plane, all_of = Delaunay(points[:, :2]), set(map(tuple, np.sort(found, axis=1).tolist()))
    true = set(map(tuple, np.sort(plane.simplices, axis=1).tolist()))
    assert true < all_of
    # final points have left: what overlaps joins points that no triangles surround, those of the
    # hull
    assert {v for t in all_of - true for v in t} <= set(plane.convex_hull.ravel().tolist())
    short = published_triangles(points, 2.0, 0.2)
    side = np.linalg.norm(points[short] - points[np.roll(short, 1, axis=1)], axis=2)
    assert 0 < len(short) < len(found) and side.max() <= 0.201


def test_the_five_repairs_on_meshes_made_by_hand():
    # a closed tetrahedron with a second roof over one of its edges
    body = np.array([(0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)], np.int32)
    false = np.concatenate([body, [[0, 1, 4]]]).astype(np.int32)
    assert len(repair_triangles(false, "none")) == 5
    assert (
        len(repair_triangles(false, "remove")) == 3
    )  # both triangles of the full edge have four neighbours, the roof two
    assert len(repair_triangles(false, "false")) == 4
    empty = body[:3]
    for repair in ("empty", "both"):
        closed = repair_triangles(empty, repair)
        assert len(closed) == 4 and set(closed[3].tolist()) == {0, 2, 3}
    assert len(repair_triangles(empty, "false")) == 3


def test_the_published_repairs_change_a_block_as_in_the_thesis():
    # Table 9.3: overlapping triangles make the block too large; those found by the check go
    at, n = sample_polygons(
        box_faces(np.full(3, -0.5), np.full(3, 0.5)), 3000, np.random.default_rng(4)
    )
    size = {}
    for repair in ("none", "empty", "false", "both", "remove"):
        mesh = mesh_cloud(at, n, LocalMeshParameters(0.2, method="published", repair=repair))
        size[repair] = len(mesh.triangles), volume(mesh), len(mesh.over_full)
    assert (
        size["empty"][0] > size["none"][0] > size["both"][0] > size["false"][0] > size["remove"][0]
    )
    assert size["none"][1] > 1.03 > size["false"][1] and size["none"][2] > 20 * max(
        size["false"][2], 1
    )
