"""Open meshes become bodies: on the ground, over gaps, with their edges completed; or are refused
with what to do.
"""

import dataclasses
import itertools

import numpy as np
import pytest
from closed_meshes import CUBE_T, CUBE_V, sphere, torus
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from benchmarks.truth import box_faces, rotation, sample_polygons
from ladar_volume.ground.heights import height_above
from ladar_volume.ground.polynomial import design_surface
from ladar_volume.mesh import hole_filling
from ladar_volume.mesh.chord_curvature import bulge_volumes
from ladar_volume.mesh.closing import close
from ladar_volume.mesh.edge_completion import plane_intersection, sharpen
from ladar_volume.mesh.ground_clipping import clip_to_ground
from ladar_volume.mesh.linear_mesh import EDGE, GAP, GROUND, MEASURED, linear_mesh
from ladar_volume.mesh.local_mesh import mesh_cloud
from ladar_volume.mesh.rims import mean_descent, rims_of
from ladar_volume.mesh.tetrahedra import closed_volume, signed_tetrahedra, tetrahedra_gradient
from ladar_volume.mesh.topology import check_closed, edge_table, orient
from ladar_volume.mesh.welding import corner_fans
from ladar_volume.model.errors import SurfaceError

LEVEL = design_surface([0.0])


def shell(low, high, step, inward=False):
    """The four walls of an upright square tube: vertices and triangles, without top or bottom."""
    n, rows = 8, round((high - low) / step) + 1
    t = np.linspace(0, 4, 4 * n, endpoint=False)
    corner = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]], float)
    ring = corner[t.astype(int)] + (t % 1)[:, None] * (
        corner[t.astype(int) + 1] - corner[t.astype(int)]
    )
    v = np.concatenate(
        [np.column_stack([ring, np.full(len(ring), z)]) for z in np.linspace(low, high, rows)]
    )
    m, out = len(ring), []
    for r in range(rows - 1):
        for i in range(m):
            a, b, c, d = r * m + i, r * m + (i + 1) % m, (r + 1) * m + i, (r + 1) * m + (i + 1) % m
            out += [[a, b, d], [a, d, c]]
    return v, np.array(out)


def volume(skin):
    assert skin.triangles.shape[0] * 3 == orient(skin.vertices, skin.triangles).edges * 2
    return closed_volume(skin.vertices, skin.triangles)


def test_a_cube_without_bottom_stands_on_the_ground():
    for lift in (0.0, 0.1):
        body, made = close(linear_mesh(CUBE_V + np.array([0, 0, lift]), CUBE_T[2:]), 0.2, LEVEL)
        assert volume(body).volume_m3 == pytest.approx(1.0 + lift, rel=1e-14)
        assert orient(body.vertices, body.triangles).euler == 2
        assert [(c.name, c.overlaps) for c in made] == [("ground", 0)]
        assert made[0].closed_m3 == pytest.approx(lift) and made[0].doubt_m3 == pytest.approx(
            0.0, abs=1e-14
        )
        assert np.abs(body.vertices[body.kind == GROUND][:, 2]).max(initial=0.0) < 1e-15


def test_orientation_and_order_given_do_not_matter():
    rng = np.random.default_rng(0)
    v, t = sphere(400)
    t = t[v[t].max(axis=1)[:, 2] > -0.5]
    one, _ = close(linear_mesh(v, t, v), 1.0, design_surface([-0.6]))
    turned = np.where(rng.random(len(t))[:, None] < 0.5, t, t[:, ::-1])
    two, _ = close(linear_mesh(v, turned[rng.permutation(len(t))], -v), 1.0, design_surface([-0.6]))
    assert volume(two).volume_m3 == pytest.approx(volume(one).volume_m3, rel=1e-12)


@pytest.mark.parametrize("normals", [False, True])
def test_derivatives_by_points_and_ground_match_differences(normals):
    v, t = sphere(500)
    t = t[
        (v[t].max(axis=1)[:, 2] > -0.4)
        & (np.linalg.norm(v[t].mean(axis=1) - [1, 0, 0], axis=1) > 0.25)
    ]
    beta = np.array([-0.45, 0.05, -0.02])

    def made(points, plane):
        return close(linear_mesh(points, t, v if normals else None), 0.8, design_surface(plane))[0]

    def total(points, plane):
        return volume(made(points, plane)).volume_m3

    body = made(v, beta)
    gradient = volume(body).gradient.ravel()
    by_ground = np.array(
        [(total(v, beta + e) - total(v, beta - e)) / 2e-6 for e in 1e-6 * np.eye(3)]
    )
    assert gradient @ body.by_ground == pytest.approx(by_ground, abs=1e-7)
    by_points = gradient @ body.by_measured
    rng = np.random.default_rng(1)
    # with normals the direction in which a rim is drawn on is held fixed, as it is here by itself
    if not normals:
        for _ in range(5):
            d = 1e-6 * rng.normal(size=v.shape)
            assert by_points @ d.ravel() == pytest.approx(
                (total(v + d, beta) - total(v - d, beta)) / 2, rel=1e-6
            )
    # all together moved up: the same body
    assert by_points.reshape(-1, 3)[:, 2].sum() + (gradient @ body.by_ground)[0] == pytest.approx(
        0.0, abs=1e-12
    )


def test_a_rim_across_the_ground_is_cut_off_there():
    v, t = sphere(3000)
    body, _ = close(linear_mesh(v, t[v[t].max(axis=1)[:, 2] > -0.5]), 0.2, design_surface([-0.45]))
    exact, _ = close(linear_mesh(v, t[v[t].max(axis=1)[:, 2] > -0.4]), 0.2, design_surface([-0.45]))
    assert (
        height_above(body.vertices[np.unique(body.triangles)], design_surface([-0.45])).min()
        > -1e-12
    )
    cap = np.pi * 0.55**2 * (3 - 0.55) / 3
    assert volume(body).volume_m3 == pytest.approx(4 / 3 * np.pi - cap, rel=4e-3)
    assert volume(exact).volume_m3 == pytest.approx(volume(body).volume_m3, rel=3e-3)
    cut = clip_to_ground(linear_mesh(v, t), design_surface([-0.45]))
    assert len(orient(cut.vertices, cut.triangles).boundary) > 50


def test_a_tube_stands_on_a_ring():
    outer, t = shell(0.05, 1.0, 0.19)
    inner = outer * [0.5, 0.5, 1.0]
    m, n = 32, len(outer)
    top = n - m + np.arange(m)
    after = n - m + (np.arange(m) + 1) % m
    lid = np.concatenate(
        [np.stack([top, after, after + n], axis=1), np.stack([top, after + n, top + n], axis=1)]
    )
    mesh = np.concatenate([t, t[:, ::-1] + n, lid])
    body, made = close(linear_mesh(np.concatenate([outer, inner]), mesh), 0.3, LEVEL)
    assert volume(body).volume_m3 == pytest.approx(4.0 - 1.0, rel=1e-12)
    assert orient(body.vertices, body.triangles).euler == 0  # a ring
    assert (
        len(made) == 1
        and made[0].vertices == 64
        and made[0].closed_m3 == pytest.approx(0.15)
        and made[0].overlaps == 0
    )


def test_gaps_are_filled_and_say_what_hangs_on_them():
    v, t = sphere(3000)
    for size in (0.15, 0.3):
        open_t = t[np.linalg.norm(v[t].mean(axis=1) - [0, 1, 0], axis=1) > size]
        body, (gap,) = close(linear_mesh(v, open_t, v), 2.5 * size + 0.1, LEVEL)
        exact = closed_volume(v, t).volume_m3
        assert gap.kind == GAP and orient(body.vertices, body.triangles).euler == 2
        lost = (
            exact
            + bulge_volumes(linear_mesh(v, t, v)).sum()
            - volume(body).volume_m3
            - bulge_volumes(body).sum()
        )
        assert abs(lost) < 0.1 * gap.doubt_m3 + 1e-6, (
            "the patches close what the flat fill leaves out"
        )
        bare, (flat,) = close(linear_mesh(v, open_t), 2.5 * size + 0.1)
        assert not bulge_volumes(bare).any()
        assert 0.5 < flat.doubt_m3 / (exact - volume(bare).volume_m3) < 2.0


def test_a_long_gap_and_one_that_least_area_cannot_fill_get_a_middle():
    v, t = sphere(30000)
    body, (gap,) = close(linear_mesh(v, t[v[t].max(axis=1)[:, 2] < 0.5]), 3.0)
    assert gap.vertices > 200 and body.kind[-1] == GAP and np.isfinite(volume(body).volume_m3)
    h = 0.5
    assert volume(body).volume_m3 == pytest.approx(
        4 / 3 * np.pi - np.pi * h * h * (3 - h) / 3, rel=1e-2
    )
    # two opposite faces gone of a tetrahedron: the least area would be the faces that are there,
    # turned round
    four = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    both = np.array([[0, 2, 1], [0, 1, 3]])
    body, (gap,) = close(linear_mesh(four, both), 5.0)
    check_closed(orient(body.vertices, body.triangles))
    assert gap.vertices == 4


def test_rims_that_touch_in_a_vertex_are_taken_apart():
    # two cubes without bottom that share a vertex of their rims
    other = CUBE_V + np.array([1.0, 1.0, 0.0])
    index = np.arange(8) + 8
    index[0] = 3
    mesh = np.concatenate([CUBE_T[2:], index[CUBE_T[2:]]])
    skin = linear_mesh(np.concatenate([CUBE_V, other]), mesh)
    body, made = close(skin, 0.1, design_surface([-0.05]))
    assert len(made) == 2 and volume(body).volume_m3 == pytest.approx(2 * 1.05)
    assert orient(body.vertices, body.triangles).euler == 4
    assert body.measured_count == 16


@pytest.mark.parametrize(
    "ground, close_m, reason, words",
    [
        (None, 0.5, "closing_gap", "ground it stands on"),
        (design_surface([-0.3]), 0.2, "closing_height", "0.3 m above the ground"),
        (design_surface([0.3]), 0.2, "closing_height", "0.3 m below the ground"),
        (design_surface([0.0, 0, 0, 0.1, 0, 0]), 0.2, "closing_ground", "degree 0 or 1"),
    ],
)
def test_what_cannot_be_closed_is_refused(ground, close_m, reason, words):
    with pytest.raises(SurfaceError, match=words) as error:
        close(linear_mesh(CUBE_V, CUBE_T[2:]), close_m, ground)
    assert error.value.reason == reason


def test_a_ragged_hole_in_a_wall_is_a_gap():
    v, t = shell(0.0, 1.0, 0.25)
    top = np.array([[128 + i, 128 + (i + 1) % 32, len(v)] for i in range(32)])
    v = np.concatenate([v, [[0.0, 0.0, 1.0]]])
    hole = np.array([66, 67, 98, 99])  # a square of a wall
    t = t[~np.isin(t, hole).all(axis=1)]
    v[34, 1] -= 0.8  # the triangle below it folds outward
    skin = linear_mesh(v, np.concatenate([t, top]))
    down = np.sort(mean_descent(skin, rims_of(skin), np.array([0.0, 0.0, 1.0])))
    assert 0.15 < down[0] < 0.5 < down[1]
    body, made = close(skin, 0.6, design_surface([-0.1]))
    assert sorted(c.name for c in made) == ["gap", "ground"]
    assert volume(body).volume_m3 == pytest.approx(4.4, rel=0.05)


def test_a_scrap_of_folded_surface_beside_a_body_is_a_gap():
    tiny = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.03, 0.03, 0.04]])
    scrap = np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3]])
    v = np.concatenate([CUBE_V, np.add(tiny, (1.6, 0.5, 0.0))])
    skin = linear_mesh(v, np.concatenate([CUBE_T[2:], 8 + scrap]))
    turned = dataclasses.replace(skin, triangles=skin.triangles.copy())
    turned.triangles[-3:] = turned.triangles[-3:][:, [0, 2, 1]]
    body, made = close(turned, 0.3, LEVEL)
    assert sorted(c.name for c in made) == ["gap", "ground"]
    assert volume(body).volume_m3 == pytest.approx(1.0, abs=1e-3)


def test_a_pit_is_refused():
    v, t = shell(0.0, 1.0, 0.25)
    floor = v[:32] * [1, 1, 0] + [0, 0, 1.0]
    fan = np.array([[96 + i + 32, 96 + (i + 1) % 32 + 32, len(v)] for i in range(32)])
    cup = np.concatenate([v, floor.mean(axis=0)[None]])
    mesh = np.concatenate([t, fan])
    skin = linear_mesh(cup, mesh)
    assert volume(close(skin, 0.1, LEVEL)[0]).volume_m3 == pytest.approx(4.0)
    pit = type(skin)(
        skin.vertices,
        skin.triangles[:, [0, 2, 1]],
        skin.normals,
        skin.kind,
        skin.curved,
        skin.face,
        skin.by_measured,
        skin.by_ground,
    )
    with pytest.raises(SurfaceError) as error:
        close(pit, 0.1, LEVEL)
    assert error.value.reason == "closing_inside_out"


def test_a_closed_mesh_stays_as_it_is():
    v, t = torus()
    body, made = close(linear_mesh(v, t), 1.0, design_surface([-1.0]))
    assert made == [] and np.array_equal(np.sort(body.triangles, axis=1), np.sort(t, axis=1))


def chamfered(per_edge, rng):
    """Points inside the faces of a unit cube, hulled over the centre, with normals: a mesh that
    cuts off every edge.
    """
    from ladar_volume.change.spherical_tin import build_spherical

    g = (np.arange(per_edge) + 0.5) / per_edge - 0.5
    a, b = (x.ravel() for x in np.meshgrid(g, g))
    points, normals = [], []
    for axis in range(3):
        for side in (-0.5, 0.5):
            p = np.insert(
                np.stack([a, b], axis=1) + rng.uniform(-0.2, 0.2, (len(a), 2)) / per_edge,
                axis,
                side,
                axis=1,
            )
            points.append(p)
            normals.append(np.tile(np.sign(side) * np.eye(3)[axis], (len(a), 1)))
    p, n = np.concatenate(points), np.concatenate(normals)
    tin = build_spherical(p, np.zeros(3), gap_map=np.array([0.3, 0.2, 1.0])).tin
    body, _ = close(linear_mesh(tin.vertices, tin.triangles), 0.9)
    return p, n, tin, body


def test_edges_and_corners_of_a_cube_are_completed_exactly():
    rng = np.random.default_rng(2)
    p, n, tin, body = chamfered(8, rng)
    where = np.array([int(np.argmin(np.linalg.norm(p - v, axis=1))) for v in tin.vertices])
    skin = linear_mesh(body.vertices, body.triangles, n[where])
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turned = linear_mesh(body.vertices @ turn.T + 5.0, body.triangles, n[where] @ turn.T)
    before = closed_volume(skin.vertices, skin.triangles).volume_m3
    assert before < 0.99
    for one in (skin, turned):
        sharp, count = sharpen(one)
        assert orient(sharp.vertices, sharp.triangles).euler == 2 and count == np.count_nonzero(
            sharp.kind == EDGE
        )
        assert closed_volume(
            sharp.vertices, sharp.triangles, allow_crossings=True
        ).volume_m3 == pytest.approx(1.0, abs=1e-12)
        assert np.abs(bulge_volumes(sharp)).max() < 1e-12, "no curvature across edges"
    # a face moved outward by d takes its edges along: the volume grows by its whole area
    gradient = (
        tetrahedra_gradient(sharp.vertices, sharp.triangles, np.zeros(3)).ravel()
        @ sharp.by_measured
    )
    for axis in range(6):
        face = np.tile(
            np.where(
                (n[where] @ np.eye(3)[axis % 3] * (-1) ** axis > 0.5)[:, None],
                n[where] @ turn.T,
                0.0,
            ),
            1,
        )
        if face.any():
            assert gradient @ face.ravel() == pytest.approx(1.0, abs=1e-9)


def test_edges_of_a_meshed_block_are_completed():
    rng = np.random.default_rng(5)
    at, n = sample_polygons(box_faces(np.full(3, -0.5), np.full(3, 0.5)), 3000, rng)
    R = rotation(rng)
    mesh = mesh_cloud(at @ R.T, n @ R.T)
    skin = linear_mesh(mesh.vertices, mesh.triangles, mesh.normals)
    sharp, count = sharpen(skin)
    whole = orient(sharp.vertices, sharp.triangles)
    check_closed(whole)
    assert whole.euler == 2 and not whole.flipped.any() and count == len(sharp.vertices) - 3000
    assert volume(skin).volume_m3 < 0.998
    # thin triangles may fold over along an edge, by nothing that counts
    assert closed_volume(
        sharp.vertices, sharp.triangles, allow_crossings=True
    ).volume_m3 == pytest.approx(1.0, abs=1e-3)
    # every vertex that was made lies on an edge: two of its coordinates are half an edge
    assert np.sort(np.abs(sharp.vertices[3000:] @ R), axis=1)[:, 1:] == pytest.approx(0.5)


def test_completed_edges_end_on_the_rim_they_came_from():
    # a block without its bottom: one rim before, and one after that runs through the ends of four
    # edges
    at, n = sample_polygons(
        box_faces(np.full(3, -0.5), np.full(3, 0.5))[1:], 2500, np.random.default_rng(6)
    )
    mesh = mesh_cloud(at, n)
    sharp, count = sharpen(linear_mesh(mesh.vertices, mesh.triangles, mesh.normals))
    rim = orient(sharp.vertices, sharp.triangles).boundary
    assert len(mesh.rims) == 1 and count > 0
    ends = np.setdiff1d(rim, mesh.rims[0])
    assert len(rim) == len(mesh.rims[0]) + 4 and len(ends) == 4
    assert np.abs(sharp.vertices[ends][:, :2]) == pytest.approx(0.5)


def test_smooth_surfaces_and_unknown_normals_are_not_sharpened():
    v, t = sphere(300)
    for normals in (v, None):
        skin = linear_mesh(v, t, normals)
        same, count = sharpen(skin)
        assert count == 0 and same is skin


def test_planes_that_do_not_meet_nearby_stay_cut_off():
    points = np.array([[[0.0, 0, 0], [1.0, 0, 0]]])
    lean = np.array([[[0.0, 0, 1.0], [np.sin(0.05), 0, np.cos(0.05)]]])
    found = plane_intersection(points, lean)
    assert not found.good[0] and found.at[0] == pytest.approx([0.5, 0, 0])


def test_the_volume_over_chords_of_a_sphere_is_given_back():
    rng = np.random.default_rng(3)
    for make in (None, rng):
        v, t = sphere(2200, rng=make)
        skin = linear_mesh(v, t, v)
        truth = 4 / 3 * np.pi
        chords = signed_tetrahedra(skin.vertices, skin.triangles, np.zeros(3)).sum()
        assert chords / truth < 0.998
        assert (chords + bulge_volumes(skin).sum()) / truth == pytest.approx(
            1.0, abs=2e-5 if make is None else 2e-4
        )


def test_the_volume_over_chords_of_a_torus_is_given_back():
    v, t = torus(60, 30)
    angle = np.arctan2(v[:, 1], v[:, 0])
    ring = 2.0 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    skin = linear_mesh(v, t, (v - ring) / 0.6)
    truth = 2 * np.pi**2 * 2.0 * 0.36
    chords = signed_tetrahedra(skin.vertices, skin.triangles, np.zeros(3)).sum()
    assert chords / truth < 0.992 and (chords + bulge_volumes(skin).sum()) / truth == pytest.approx(
        1.0, abs=4e-4
    )


def test_fans_are_the_components_of_the_corners():
    touching = np.concatenate([CUBE_T, CUBE_T + 8]).astype(np.int32)
    touching[touching == 15] = 0  # two cubes that touch in a vertex
    for t, count in ((touching, 16), (touching[::2], None), (touching[[0, 5, 9]], None)):
        order, start, _ = edge_table(t)
        pair = start[:-1][np.diff(start) == 2]
        one, other = order[pair], order[pair + 1]
        joined = [
            (i, j)
            for a, b in zip(one // 3 * 3, other // 3 * 3, strict=True)
            for i in range(a, a + 3)
            for j in range(b, b + 3)
            if t.ravel()[i] == t.ravel()[j]
        ]
        graph = coo_matrix(
            (np.ones(len(joined)), np.array(joined, np.int64).reshape(-1, 2).T),
            shape=(t.size, t.size),
        )
        number, label = connected_components(graph, directed=False)
        root = corner_fans(t, one, other)
        assert np.array_equal(root, np.unique(label, return_index=True)[1][label]) and number == (
            count or number
        )


def test_the_least_area_of_all_triangulations():
    rng = np.random.default_rng(4)
    p = rng.normal(size=(8, 3))
    taken = np.zeros((8, 8), bool)
    taken[2, 6] = taken[6, 2] = True

    def ways(i, j):
        """All triangulations of the loop i..j."""
        if j - i < 2:
            return [[]]
        if taken[i, j]:
            return []
        return [
            [*a, *b, (i, k, j)] for k in range(i + 1, j) for a in ways(i, k) for b in ways(k, j)
        ]

    def cost(way):
        a, b, c = (p[[t[k] for t in way]] for k in range(3))
        area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
        return area.sum() + hole_filling.SHORTER * ((c - a) ** 2).sum()

    every = sorted(ways(0, 7), key=cost)
    split = np.full((8, 8), -1, np.int64)
    assert len(every) > 80
    assert hole_filling.least_area_kernel(p, taken, split) == pytest.approx(cost(every[0]))
    assert all(split[i, j] == k for i, k, j in every[0])


def test_ears_of_a_star_cover_it_once():
    angle = np.linspace(0, 2 * np.pi, 20, endpoint=False)
    star = (1.0 + 0.5 * (np.arange(20) % 2))[:, None] * np.stack(
        [np.cos(angle), np.sin(angle)], axis=1
    )
    out = np.empty((18, 3), np.int64)
    assert hole_filling.ears_kernel(star, np.arange(20), out) == 0
    x, y = star.T
    whole = 0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1))
    assert (areas(star, out) > 0).all() and areas(star, out).sum() == pytest.approx(whole)
    sides = {frozenset(s) for t in out.tolist() for s in itertools.combinations(t, 2)}
    assert {frozenset((i, (i + 1) % 20)) for i in range(20)} <= sides and len(sides) == 37


def areas(p, triangles):
    a, b, c = (p[triangles[:, k]] for k in range(3))
    return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


def test_ears_cover_a_polygon_with_holes_once():
    square = np.array([[0, 0], [4, 0], [4, 4], [0, 4.0]])
    hole = np.array([[1, 1], [1, 2], [2, 2], [2, 1.0]])
    p = np.concatenate([square, hole, hole + 1.5])
    triangles, forced = hole_filling.ears(p, np.arange(4), [np.arange(4, 8), np.arange(8, 12)])
    part = areas(p, triangles)
    assert (
        forced == 0
        and (part >= 0).all()
        and part.sum() == pytest.approx(14.0)
        and len(triangles) == 12 + 2 * 2 - 2
    )
    crossing = np.array([[0, 0], [2, 2], [2, 0], [0, 2.0]])
    triangles, forced = hole_filling.ears(crossing, np.arange(4), [])
    assert areas(crossing, triangles).sum() == pytest.approx(
        hole_filling.loop_area(crossing), abs=1e-12
    )


def test_least_area_of_a_bent_square_is_the_shorter_diagonal():
    p = np.array([[0, 0, 0], [1, 0, 0.3], [1, 1, 0], [0, 1, 0.3]])
    free = np.zeros((4, 4), bool)
    assert len(hole_filling.least_area(p, free)) == 2
    free[0, 2] = free[2, 0] = True
    assert {tuple(sorted(t)) for t in hole_filling.least_area(p, free).tolist()} == {
        (0, 1, 3),
        (1, 2, 3),
    }
    free[1, 3] = free[3, 1] = True
    assert len(hole_filling.least_area(p, free)) == 0


def test_kinds_tell_what_was_measured():
    body, _ = close(linear_mesh(CUBE_V + np.array([0, 0, 0.1]), CUBE_T[2:]), 0.2, LEVEL)
    assert np.bincount(body.kind, minlength=4).tolist() == [8, 0, 0, 4]
    assert (
        np.count_nonzero(body.face == MEASURED) == 10
        and np.count_nonzero(body.face == GROUND) == 10
    )
