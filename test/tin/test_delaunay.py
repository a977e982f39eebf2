"""The Delaunay kernel: degenerate input first, then the textbook, then a peer."""

from __future__ import annotations

from fractions import Fraction
from itertools import permutations

import numpy as np
import pytest
from scipy.spatial import Delaunay

from ladar_volume.math.space_curve import radix_order
from ladar_volume.model.errors import SurfaceError
from ladar_volume.tin import predicates
from ladar_volume.tin import triangle_table as mesh_table
from ladar_volume.tin.delaunay import (
    GrowingTriangulation,
    check_hull_kernel,
    check_kernel,
    delaunay,
    find_fault,
    first_names,
    first_three,
    is_valid,
    original_order,
    triangulate,
)
from ladar_volume.tin.insertion_order import (
    BITS,
    by_rounds,
    hilbert_index,
    hilbert_order,
    insertion_order,
    insertion_rounds,
)
from ladar_volume.tin.predicates import COUNTS, incircle, orientation, workspace
from ladar_volume.tin.triangle_table import triangle_table


def as_set(triangles):
    return {tuple(sorted(t)) for t in np.asarray(triangles).tolist()}


#: Four vertices, numbered as the triangulation numbers them.
FOUR = tuple(np.arange(4, dtype=np.int32))


def exact_orientation(a, b, c):
    ax, ay, bx, by, cx, cy = (Fraction(float(v)) for p in (a, b, c) for v in p)
    d = (ax - cx) * (by - cy) - (ay - cy) * (bx - cx)
    return (d > 0) - (d < 0)


def exact_incircle(p):
    rows = [
        (
            Fraction(float(x)) - Fraction(float(p[3][0])),
            Fraction(float(y)) - Fraction(float(p[3][1])),
        )
        for x, y in p[:3]
    ]
    total = Fraction(0)
    for i in range(3):
        (ax, ay), (bx, by), (cx, cy) = rows[i], rows[(i + 1) % 3], rows[(i + 2) % 3]
        total += (ax * ax + ay * ay) * (bx * cy - cx * by)
    return (total > 0) - (total < 0)


def nearly_degenerate(n, rng):
    """Quadruples of points that are a few last bits away from collinear and co-circular."""
    base = rng.random((n, 1, 2))
    direction = rng.random((n, 1, 2)) - 0.5
    line = base + direction * rng.integers(-8, 8, (n, 4, 1)) * 0.1
    angle = rng.choice(np.arange(24), (n, 4)) * (np.pi / 12)
    circle = base + 0.3 * np.stack([np.cos(angle), np.sin(angle)], axis=2)
    grid = base * 0 + rng.integers(0, 3, (n, 4, 2)) * 0.1 + 1000.1
    return np.concatenate([line, circle, grid])


def test_predicates_have_the_sign_of_rational_arithmetic():
    w = workspace()
    for p in nearly_degenerate(300, np.random.default_rng(0)):
        got = orientation(*p[0], *p[1], *p[2], w)
        assert np.sign(got) == exact_orientation(p[0], p[1], p[2])
        assert np.sign(incircle(np.ascontiguousarray(p), *FOUR, w)) == exact_incircle(p)


def test_exact_branch_alone_agrees_with_rational_arithmetic():
    w = workspace()
    for p in np.random.default_rng(1).random((100, 4, 2)) * 10.0 ** np.random.default_rng(
        2
    ).integers(-6, 7, (100, 4, 1)):
        assert np.sign(
            predicates.incircle_exact(np.ascontiguousarray(p), *FOUR, w)
        ) == exact_incircle(p)
        assert np.sign(predicates.orientation_exact(*p[0], *p[1], *p[2], w)) == exact_orientation(
            p[0], p[1], p[2]
        )
    assert w[COUNTS, :2].tolist() == [100.0, 100.0]


def test_the_short_branch_answers_where_nothing_rounds_and_only_there():
    rng = np.random.default_rng(11)
    for p in rng.integers(-50, 50, (100, 4, 2)).astype(float):
        assert np.sign(predicates.incircle_short(p, *FOUR)) == exact_incircle(p)
    for p in rng.random((100, 4, 2)):
        assert np.isnan(predicates.incircle_short(p, *FOUR))
    assert (
        predicates.incircle_short(
            np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]) * 2.0**-30 + 2.0**20, *FOUR
        )
        == 0.0
    )


def test_corners_of_an_upright_rectangle_are_cocircular_in_any_order():
    corners = np.array([[0.1, 0.7], [0.3, 0.7], [0.3, 1.9], [0.1, 1.9]]) + 1e6 / 3.0
    w = workspace()
    for order in permutations(range(4)):
        p = corners[list(order)]
        assert incircle(p, *FOUR, w) == 0.0 == exact_incircle(p)
        a, b, c, d = FOUR
        opposite = ((a, b, c, d), (a, c, b, d), (a, d, b, c))
        assert sum(predicates.is_rectangle(p, *q) for q in opposite) == 1
        p[0, 1] += 1e-9
        assert not any(predicates.is_rectangle(p, *q) for q in opposite)


@pytest.mark.parametrize("n", [3, 4, 5, 6, 10, 50, 1000, 5000])
def test_general_position_gives_the_peers_triangles(n):
    xy = np.random.default_rng(n).random((n, 2)) * [100.0, 30.0] + [5e5, 4e6]
    triangles, neighbours = delaunay(xy)
    assert find_fault(xy, triangles, neighbours) == ""
    shifted = xy - xy.mean(axis=0)  # the peer loses bits at map coordinates
    ours, _ = delaunay(shifted)
    assert as_set(ours) == as_set(Delaunay(shifted).simplices)


@pytest.mark.parametrize("step,offset", [(1.0, 0.0), (0.1, 0.0), (0.1, 1000.3), (1 / 3, 5e5)])
def test_grid_is_valid_and_complete(step, offset):
    g = (
        np.stack(np.meshgrid(np.arange(31.0), np.arange(17.0)), axis=-1).reshape(-1, 2) * step
        + offset
    )
    xy = np.random.default_rng(4).permutation(g)
    triangles, neighbours = delaunay(xy)
    assert find_fault(xy, triangles, neighbours) == ""
    # at some offsets rounding bends the grid's sides; the hull then has slivers or lacks them,
    # Euler's formula holds anyway
    if offset == 0.0 and step == 1.0:
        assert len(triangles) == 2 * 30 * 16


def test_cocircular_points():
    a = np.arange(24) * (2 * np.pi / 24)
    xy = np.round(np.stack([np.cos(a), np.sin(a)], axis=1) * 65) / 65
    exact = np.array(
        [
            (5, 0),
            (4, 3),
            (3, 4),
            (0, 5),
            (-3, 4),
            (-4, 3),
            (-5, 0),
            (-4, -3),
            (-3, -4),
            (0, -5),
            (3, -4),
            (4, -3),
        ],
        float,
    )
    for points in (np.unique(xy, axis=0), exact, np.concatenate([exact, [[0.0, 0.0]]])):
        triangles, neighbours = delaunay(points)
        assert find_fault(points, triangles, neighbours) == ""
    assert len(delaunay(exact)[0]) == 10


def test_collinear_points_with_one_beside_them():
    xy = np.array([[0.1 * i, 0.1 * i] for i in range(60)] + [[1.0, 0.0]])
    triangles, neighbours = delaunay(xy)
    assert find_fault(xy, triangles, neighbours) == "" and len(triangles) == 59


def test_needles_and_clusters():
    rng = np.random.default_rng(5)
    flat = np.concatenate(
        [
            rng.random((300, 2)) * [1.0, 1e-13],
            rng.random((300, 2)) * [1e-9, 1.0],
            rng.random((100, 2)) * 1e6,
        ]
    )
    triangles, neighbours = delaunay(flat)
    assert find_fault(flat, triangles, neighbours) == ""
    corner = np.array(
        [[0.5 + i * 2.0**-53, 0.5 + j * 2.0**-53] for i in range(16) for j in range(16)]
        + [[12.0, 12.0], [24.0, 24.0]]
    )
    triangles, neighbours = delaunay(corner)
    assert find_fault(corner, triangles, neighbours) == ""


@pytest.mark.parametrize(
    "xy,reason",
    [
        (np.zeros((0, 2)), "surface_too_few_points"),
        (np.zeros((1, 2)), "surface_too_few_points"),
        (np.array([[0.0, 0], [1, 1]]), "surface_too_few_points"),
        (np.array([[0.0, 0], [1, 1], [2, 2], [3, 3]]), "surface_collinear"),
        (np.array([[0.0, 0], [1, np.nan], [2, 2]]), "surface_not_finite"),
        (np.array([[0.0, 0], [1, np.inf], [2, 2]]), "surface_not_finite"),
    ],
)
def test_refusals(xy, reason):
    with pytest.raises(SurfaceError) as caught:
        delaunay(xy)
    assert caught.value.reason == reason


def test_first_copy_is_kept_and_signed_zeros_are_one():
    xy = np.array([[0.0, 1], [2, 2], [-0.0, 1], [0, 1], [2, 2], [3, 0]])
    out = triangulate(xy)
    assert out.same.tolist() == [0, 1, 0, 0, 1, 5] and out.vertices.tolist() == [0, 1, 5]
    assert sorted(out.triangles[0].tolist()) == [0, 1, 5] and out.neighbours.tolist() == [
        [-1, -1, -1]
    ]
    with pytest.raises(SurfaceError) as caught:
        delaunay(xy)
    assert caught.value.reason == "surface_duplicates" and caught.value.value == 3


def test_many_copies_in_any_order():
    xy = np.random.default_rng(12).integers(0, 12, (900, 2)).astype(float)
    out = triangulate(xy)
    _, first, member = np.unique(xy, axis=0, return_index=True, return_inverse=True)
    assert np.array_equal(out.same, first[member.reshape(-1)])
    number = np.searchsorted(out.vertices, out.triangles).astype(np.int32)
    assert find_fault(xy[out.vertices], number, out.neighbours) == ""


@pytest.mark.parametrize("kind", ["grid", "shifted grid", "circle", "line and point"])
def test_predicates_that_reach_the_exact_stage_are_counted(kind):
    g = np.stack(np.meshgrid(np.arange(20.0), np.arange(20.0)), axis=-1).reshape(-1, 2)
    a = np.arange(360) * (np.pi / 180)
    t = np.arange(40.0)
    xy = {
        "grid": g,
        "shifted grid": g * 0.1 + [431000.3, 5411000.7],
        "circle": np.column_stack([np.cos(a), np.sin(a)]),
        "line and point": np.concatenate([np.column_stack([t * 0.1, t * 0.3]), [[1.0, -5.0]]]),
    }[kind]
    out = triangulate(xy)
    assert find_fault(xy, out.triangles, out.neighbours) == ""
    assert out.exact_orientations + out.exact_incircles > 0
    assert triangulate(np.random.default_rng(0).random((2000, 2))).exact_incircles == 0


def test_order_of_input_does_not_matter_in_general_position():
    xy = np.random.default_rng(6).random((400, 2))
    order = np.random.default_rng(7).permutation(400)
    a, b = delaunay(xy)[0], delaunay(xy[order])[0]
    assert as_set(a) == as_set(order[b])


@pytest.mark.parametrize("kind", ["lattice", "circle"])
def test_order_of_input_does_not_matter_where_points_share_circles(kind):
    x, y = np.meshgrid(np.arange(12.0), np.arange(9.0))
    turn = np.array([[5, 0], [4, 3], [3, 4], [0, 5], [-3, 4], [-5, 0], [-4, -3], [0, -5], [3, -4]])
    circles = np.concatenate([turn, turn + np.array([20, 0]), turn + np.array([10, 20])])
    xy = {"lattice": np.column_stack([x.ravel(), y.ravel()]), "circle": circles}[kind]
    first = as_set(delaunay(xy)[0])
    for seed in range(8):
        order = np.random.default_rng(seed).permutation(len(xy))
        assert as_set(order[delaunay(xy[order])[0]]) == first


def test_scaling_by_a_power_of_two_keeps_the_triangles():
    xy = np.random.default_rng(8).random((200, 2))
    assert (
        as_set(delaunay(xy)[0])
        == as_set(delaunay(xy * 2.0**20)[0])
        == as_set(delaunay(xy * 2.0**-20)[0])
    )


def test_is_valid_sees_faults():
    xy = np.array([[0.0, 0], [4, 0], [4.5, 3], [0, 3]])
    triangles, neighbours = delaunay(xy)
    assert is_valid(xy, triangles, neighbours)
    assert not is_valid(xy, triangles[:, ::-1], neighbours[:, ::-1])
    assert not is_valid(np.concatenate([xy, [[1.0, 1.0]]]), triangles, neighbours)
    assert not is_valid(xy[[1, 0, 2, 3]], triangles, neighbours)
    assert not is_valid(xy, triangles + 2, neighbours) and not is_valid(
        xy, triangles[:0], neighbours[:0]
    )
    broken = neighbours.copy()
    broken[broken >= 0] = -1
    assert not is_valid(xy, triangles, broken)
    wrong = (
        {(0, 1, 2), (0, 2, 3)}
        if as_set(triangles) != {(0, 1, 2), (0, 2, 3)}
        else {(0, 1, 3), (1, 2, 3)}
    )
    t = np.array(sorted(wrong), np.int32)
    shared = np.flatnonzero(~np.isin(t[0], t[1]))[0], np.flatnonzero(~np.isin(t[1], t[0]))[0]
    n = np.full((2, 3), -1, np.int32)
    n[0, shared[0]], n[1, shared[1]] = 1, 0
    assert find_fault(xy, t, n) == "a vertex lies inside a circumcircle"


@pytest.mark.parametrize("lattice", [True, False])
def test_insertion_in_the_order_given_is_sound(lattice):
    rng = np.random.default_rng(9)
    xy = rng.integers(0, 6, (40, 2)).astype(float) if lattice else rng.random((40, 2))
    w, n = workspace(), len(xy)
    k = next(k for k in range(2, n) if exact_orientation(xy[0], xy[1], xy[k]))
    xy[[2, k]] = xy[[k, 2]]

    def run():
        m, same = triangle_table(n), np.arange(n, dtype=np.int32)
        m[:] = 0
        mesh_table.first_triangle(xy, m, 0, 1, 2, w)
        size, hint = mesh_table.insert_kernel(xy, m, 4, 0, 3, same, w)
        return [
            size,
            hint,
            same,
            m[:size].copy(),
            *mesh_table.export(m[:size], np.arange(n, dtype=np.int32)),
        ]

    compiled = run()
    *_, triangles, neighbours = compiled
    used = np.unique(triangles)
    number = np.searchsorted(used, triangles).astype(np.int32)
    assert find_fault(xy[used], number, neighbours) == ""
    for check in (check_kernel, check_hull_kernel):
        assert check(xy[used], number, neighbours, w) == 0
    order = np.random.default_rng(1).permutation(n).astype(np.int32)
    second, third = first_three(xy, w)
    assert (xy[second] != xy[0]).any() and (xy[1:second] == xy[0]).all()
    assert exact_orientation(xy[0], xy[second], xy[third]) != 0
    same, names, back = compiled[2], order.copy(), np.empty(n, np.int32)
    np.minimum.at(names, same, order)
    assert np.array_equal(first_names(order, same), names)
    back[order] = order[same]
    assert np.array_equal(original_order(order, same, order), back)


def test_the_ordering_is_that_of_stable_sorts():
    xy = np.random.default_rng(13).random((300, 2))
    key = hilbert_index(np.repeat(xy, 2, axis=0))
    plain = np.argsort(key, kind="stable")
    assert np.array_equal(radix_order(key.view(np.uint64).copy(), 2 * BITS), plain)
    order = plain.astype(np.int32)
    assert np.array_equal(
        by_rounds(order),
        plain[np.argsort(-insertion_rounds(600)[plain].astype(int), kind="stable")],
    )
    assert len(hilbert_order(np.zeros((0, 2)))) == len(insertion_order(np.zeros((0, 2)))) == 0


def test_insertion_order_is_a_permutation_along_a_curve():
    xy = np.random.default_rng(10).random((3000, 2))
    order = insertion_order(xy)
    assert sorted(order.tolist()) == list(range(3000))
    assert insertion_rounds(3000).max() >= 3
    grid = np.stack(np.meshgrid(np.arange(16), np.arange(16)), axis=-1).reshape(-1, 2) * 4369.0
    walk = grid[hilbert_order(grid)]
    assert set(np.abs(np.diff(walk, axis=0)).sum(axis=1).tolist()) == {4369.0}


@pytest.mark.parametrize("kind", ["scattered", "lattice", "with copies", "one by one"])
def test_points_that_are_added_later_give_the_same_triangles(kind):
    rng = np.random.default_rng(11)
    xy = rng.uniform(-3.0, 3.0, (600, 2))
    if kind == "lattice":  # all on circles with others
        xy = np.stack(np.meshgrid(np.arange(25.0), np.arange(24.0)), axis=-1).reshape(-1, 2)
        xy = rng.permutation(xy)
    if kind == "with copies":
        xy[400:500] = xy[:100]
    cuts = [590 + k for k in range(10)] if kind == "one by one" else [40, 41, 300, 450]
    first, *more = np.split(xy, cuts)
    grown, n = GrowingTriangulation(first), len(first)
    for part in more:
        found = grown.triangulation()  # asked for in between, it does not disturb
        assert is_valid(xy[found.vertices], *compact(found))
        grown.add(part)
        n += len(part)
    found, whole = grown.triangulation(), triangulate(xy)
    assert n == len(xy) and np.array_equal(found.same, whole.same)
    assert as_set(found.triangles) == as_set(whole.triangles)
    assert is_valid(xy[found.vertices], *compact(found))


def compact(found):
    """Triangles numbered by the vertices in use, and neighbours."""
    return np.searchsorted(found.vertices, found.triangles), found.neighbours


def test_added_points_must_be_numbers():
    grown = GrowingTriangulation(np.eye(3)[:, :2])
    with pytest.raises(SurfaceError) as caught:
        grown.add(np.array([[0.0, np.nan]]))
    assert caught.value.reason == "surface_not_finite"
