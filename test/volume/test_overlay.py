"""Two surfaces: rational brute force, closed forms, invariances, gradients against differences,
degenerate overlays.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from fractions import Fraction
from functools import partial

import numba
import numpy as np
import pytest
from plain_integrals import barycentric, positive_mean, positive_slopes, strip_integrals

from ladar_volume.ground.polynomial import design_surface
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import Tin
from ladar_volume.tin.full_tin import build_tin, footprint_areas
from ladar_volume.tin.locate import CHUNKS, triangle_index
from ladar_volume.volume.overlay import (
    integrals,
    placed_corners,
    placed_neighbours,
    vertex_gradients,
    volumes_between,
)
from ladar_volume.volume.overlay_kernel import WAITING, overlay_kernel, walk
from ladar_volume.volume.prismoids import positive_part, prismoids
from ladar_volume.volume.triangle_clipping import (
    CORNERS,
    PAIR,
    ROWS,
    A,
    B,
    add_fan,
    add_piece,
    add_same_sign,
    clip_line,
    clip_pair,
    tip,
)


def random_tin(n=30, seed=0, half=3.0, bump=1.0):
    rng = np.random.default_rng(seed)
    corners = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    xy = np.r_[rng.uniform(-half, half, (n, 2)), corners]
    return build_tin(np.c_[xy, bump * rng.uniform(-1, 1, len(xy))])


def flat(z, half=3.0):
    return build_tin(
        np.array([[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]], float)
    )


def roof():
    vertices = np.array([(0, 0, 0), (4, 0, 1), (4, 3, 2), (0, 3, -1), (2, 1.5, 3)], float)
    triangles = np.array([(0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)], np.int32)
    return Tin(vertices, triangles, np.full((4, 3), -1, np.int32), np.ones(4, bool), np.arange(5))


#: A ring of seven corners, counter-clockwise.
STAR_RING = np.stack(
    [
        f(2 * np.pi * np.arange(7) / 7) * [1.0, 0.6, 0.9, 1.2, 0.8, 1.0, 0.7]
        for f in (np.cos, np.sin)
    ],
    axis=1,
)


def exact_clip(ring, f):
    """Sutherland-Hodgman in rational numbers."""
    out = []
    for i, p in enumerate(ring):
        q = ring[(i + 1) % len(ring)]
        u, v = f(p), f(q)
        if u >= 0:
            out.append(p)
        if u * v < 0:
            s = u / (u - v)
            out.append(tuple(a + s * (b - a) for a, b in zip(p, q, strict=True)))
    return out


def plane_through(p):
    """Coefficients of the plane through three rational points."""
    (x0, y0, z0), (x1, y1, z1), (x2, y2, z2) = p
    det = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
    gx = ((z1 - z0) * (y2 - y0) - (z2 - z0) * (y1 - y0)) / det
    gy = ((z2 - z0) * (x1 - x0) - (z1 - z0) * (x2 - x0)) / det
    return z0 - gx * x0 - gy * y0, gx, gy


def turn(a, b, p):
    """Twice the signed area of a, b, p."""
    return (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])


def signed(sign, plane, p):
    """The signed height of a plane at p."""
    return sign * (plane[0] + plane[1] * p[0] + plane[2] * p[1])


def exact(upper, lower):
    """Cut, fill and area by clipping every triangle with every other, without rounding."""
    rows = [
        [
            [tuple(Fraction(float(c)) for c in s.vertices[v]) for v in t]
            for t in s.triangles[s.relevant]
        ]
        for s in (upper, lower)
    ]
    total = [Fraction(0)] * 3
    for a in rows[0]:
        pa = plane_through(a)
        for b in rows[1]:
            ring = [p[:2] for p in a]
            for k in range(3):
                (x0, y0), (x1, y1) = b[k][:2], b[(k + 1) % 3][:2]
                leftward = partial(turn, (x0, y0), (x1, y1))
                ring = exact_clip(ring, leftward) if ring else ring
            pb = plane_through(b)
            d = [u - v for u, v in zip(pa, pb, strict=True)]
            for side, sign in ((0, 1), (1, -1)):
                part = exact_clip(ring, partial(signed, sign, d)) if ring else []
                for i in range(1, len(part) - 1):
                    p, q, r = part[0], part[i], part[i + 1]
                    area = turn(p, q, r) / 2
                    mean = sum(signed(sign, d, s) for s in (p, q, r)) / 3
                    total[side] += area * mean
                    total[2] += area
    return [float(t) for t in total]


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_random_surfaces_against_rational_clipping(seed):
    a, b = random_tin(12, seed), random_tin(9, seed + 50, half=2.5)
    a = dataclasses.replace(a, relevant=np.random.default_rng(seed).random(len(a.triangles)) < 0.8)
    r = volumes_between(a, b)
    assert (r.cut_m3, r.fill_m3, r.area_m2) == pytest.approx(exact(a, b), rel=1e-12, abs=1e-13)


@pytest.mark.parametrize(
    "z,cut,fill",
    [
        (0, 49 / 3, 1 / 3),
        (1, 20 / 3, 8 / 3),
        (2, 1, 9),
        (2.5, 0.125, 14.125),
        (5, 0, 44),
        (-2, 40, 0),
    ],
)
def test_the_roof_above_a_flat_surface(z, cut, fill):
    r = volumes_between(roof(), flat(z, half=7.0))
    assert (r.cut_m3, r.fill_m3, r.area_m2) == pytest.approx((cut, fill, 12.0), abs=1e-12)
    back = volumes_between(flat(z, half=7.0), roof())
    assert (back.cut_m3, back.fill_m3) == pytest.approx((fill, cut), abs=1e-12)


def test_a_flat_or_tilted_lower_surface_gives_the_prismoids():
    a = random_tin(seed=3)
    low = flat(0.0, half=4.0)
    low = dataclasses.replace(
        low,
        vertices=low.vertices
        + np.c_[np.zeros((4, 2)), 0.3 + 0.2 * low.vertices[:, 0] - 0.1 * low.vertices[:, 1]],
    )
    r, p = volumes_between(a, low), prismoids(a, design_surface([0.3, 0.2, -0.1]))
    assert (r.cut_m3, r.fill_m3, r.area_m2) == pytest.approx(
        (p.cut_m3, p.fill_m3, p.area_m2), rel=1e-12
    )
    assert r.gradient_cut[:, 2] == pytest.approx(p.gradient_cut[:, 2], abs=1e-12)
    assert r.lower_net[:, 2].sum() == pytest.approx(p.base_net[0], rel=1e-12)


def test_swapping_adding_and_shifting():
    a, b = random_tin(seed=4), random_tin(seed=5, half=2.0)
    r, back = volumes_between(a, b), volumes_between(b, a)
    assert (r.cut_m3, r.fill_m3, r.area_m2) == pytest.approx(
        (back.fill_m3, back.cut_m3, back.area_m2), rel=1e-12
    )
    assert r.gradient_cut == pytest.approx(
        back.lower_fill, abs=1e-12
    ) and r.lower_cut == pytest.approx(back.gradient_fill, abs=1e-12)
    part = np.random.default_rng(0).random(len(a.triangles)) < 0.4
    halves = [volumes_between(dataclasses.replace(a, relevant=m), b) for m in (part, ~part)]
    for name in ("cut_m3", "fill_m3", "area_m2"):
        assert sum(getattr(h, name) for h in halves) == pytest.approx(getattr(r, name), rel=1e-12)
    up = volumes_between(dataclasses.replace(a, vertices=a.vertices + np.array([0, 0, 0.25])), b)
    assert up.net_m3 - r.net_m3 == pytest.approx(
        0.25 * r.area_m2, rel=1e-12
    ) and r.area_m2 == pytest.approx(16.0, rel=1e-12)
    c = random_tin(seed=6, half=2.0)
    assert volumes_between(a, c).net_m3 + volumes_between(c, b).net_m3 == pytest.approx(
        r.net_m3, rel=1e-11
    )


def test_turning_shifting_and_scaling():
    a, b = random_tin(seed=7), random_tin(seed=8, half=2.0)
    r = volumes_between(a, b)
    c, s = math.cos(0.7), math.sin(0.7)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    moved = [dataclasses.replace(t, vertices=t.vertices @ R.T + [500.0, -300, 20]) for t in (a, b)]
    m = volumes_between(*moved)
    assert (m.cut_m3, m.fill_m3, m.area_m2) == pytest.approx(
        (r.cut_m3, r.fill_m3, r.area_m2), rel=1e-10
    )
    assert m.gradient_cut == pytest.approx(r.gradient_cut @ R.T, abs=1e-9)
    far = volumes_between(
        *(dataclasses.replace(t, vertices=t.vertices + np.array([5e5, 5e6, 0])) for t in (a, b))
    )
    assert far.net_m3 == pytest.approx(r.net_m3, abs=1e-6)
    scaled = volumes_between(*(dataclasses.replace(t, vertices=3.0 * t.vertices) for t in (a, b)))
    assert scaled.cut_m3 == pytest.approx(27 * r.cut_m3, rel=1e-12)


def test_gradients_against_central_differences():
    a, b = random_tin(14, seed=9, half=3.0), random_tin(12, seed=10, half=2.0)
    r, h = volumes_between(a, b), 1e-6
    for which, cut, fill in ((0, r.gradient_cut, r.gradient_fill), (1, r.lower_cut, r.lower_fill)):
        tin = (a, b)[which]
        hull = (
            set(tin.triangles[np.flatnonzero((tin.neighbours < 0).any(axis=1))].ravel().tolist())
            if which
            else set()
        )
        for i in range(0, len(tin.vertices), 2):
            for axis in range(3):
                if axis < 2 and i in hull:
                    continue  # the common footprint is held fixed
                step = np.zeros_like(tin.vertices)
                step[i, axis] = h
                up, down = (
                    volumes_between(
                        *[
                            dataclasses.replace(t, vertices=t.vertices + e * step)
                            if t is tin
                            else t
                            for t in (a, b)
                        ],
                        gradients=False,
                    )
                    for e in (1, -1)
                )
                assert cut[i, axis] == pytest.approx((up.cut_m3 - down.cut_m3) / (2 * h), abs=3e-7)
                assert fill[i, axis] == pytest.approx(
                    (up.fill_m3 - down.fill_m3) / (2 * h), abs=3e-7
                )


def test_the_same_surface_twice_and_a_lattice_on_a_lattice():
    a = random_tin(seed=11)
    r = volumes_between(a, a)
    assert (
        r.cut_m3 == pytest.approx(0, abs=1e-13)
        and r.fill_m3 == pytest.approx(0, abs=1e-13)
        and r.area_m2 == pytest.approx(36, rel=1e-12)
    )
    x, y = (g.ravel().astype(float) for g in np.meshgrid(np.arange(6), np.arange(6)))
    one, two = build_tin(np.c_[x, y, x * y]), build_tin(np.c_[y, x, x * y - 1.0])
    assert volumes_between(one, two).area_m2 == pytest.approx(25.0, rel=1e-14)
    level = volumes_between(flat(2.0), flat(2.0))
    assert level.cut_m3 == level.fill_m3 == 0.0 and level.net_m3 == 0.0
    assert level.gradient_net[:, 2].sum() == pytest.approx(36.0) and level.lower_net[
        :, 2
    ].sum() == pytest.approx(-36.0)


def test_touching_vertices_edges_and_empty_overlap():
    a = flat(1.0, 1.0)
    for shift in ([2.0, 0, 0], [2.0, 2.0, 0], [50.0, 0, 0]):
        with pytest.raises(VolumeError) as caught:
            volumes_between(a, dataclasses.replace(a, vertices=a.vertices + shift))
        assert caught.value.reason == "volume_no_common_footprint"
    none = dataclasses.replace(a, relevant=np.zeros(2, bool))
    for pair in ((a, none), (none, a)):
        with pytest.raises(VolumeError) as caught:
            volumes_between(*pair)
        assert caught.value.reason == "volume_no_triangle"
    corner = volumes_between(
        a, dataclasses.replace(a, vertices=a.vertices + np.array([1.0, 1.0, -0.5]))
    )
    assert (corner.area_m2, corner.net_m3) == pytest.approx((1.0, 0.5))


def test_walls_and_slivers():
    # a wall one micrometre wide and 2 m high, against a surface that crosses it
    xy = np.array([[-1, -1], [0, -1], [1e-6, -1], [1, -1], [-1, 1], [0, 1], [1e-6, 1], [1, 1.0]])
    wall = build_tin(np.c_[xy, np.where(xy[:, 0] > 0, 2.0, 0.0)])
    r = volumes_between(wall, random_tin(seed=12))
    shallow = random_tin(seed=12)
    expected = (
        volumes_between(build_tin(np.c_[xy[[0, 1, 4, 5]], np.zeros(4)]), shallow).net_m3
        + volumes_between(build_tin(np.c_[xy[[1, 3, 5, 7]], np.full(4, 2.0)]), shallow).net_m3
    )
    assert r.area_m2 == pytest.approx(4.0, rel=1e-12) and r.net_m3 == pytest.approx(
        expected - 2e-6, abs=1e-9
    )


def test_pieces_strip_by_strip():
    """Every pair of triangles, cut into strips; the kernel goes from neighbour to neighbour, which
    it does only where a chunk holds several triangles.
    """
    a, b = random_tin(24, seed=13), random_tin(2, seed=14)
    assert len(a.triangles) > 1.5 * CHUNKS
    one, two = triangle_index(a), triangle_index(b)
    high, low = (
        placed_corners(a.vertices, a.triangles, one.order),
        placed_corners(b.vertices, b.triangles, two.order),
    )
    assert np.array_equal(high, a.vertices[a.triangles[one.order]])
    assert np.array_equal(high[..., :2], one.corners)
    neighbours, place = placed_neighbours(b.neighbours, two.order), np.argsort(two.order)
    beyond = b.neighbours[two.order]
    assert np.array_equal(neighbours, np.where(beyond < 0, -1, place[beyond]))
    parts, back = np.zeros((len(high), 2, 4)), np.zeros((len(low), 2, 4))
    for (i, p), (j, q) in itertools.product(enumerate(high), enumerate(low)):
        if (p.min(axis=0) > q.max(axis=0))[:2].any() or (p.max(axis=0) < q.min(axis=0))[:2].any():
            continue
        on_a, on_b = barycentric(p[:, :2]), barycentric(q[:, :2])
        d = q[:, 2] @ on_b - p[:, 2] @ on_a  # sign −1: the subject is the lower one
        for side, sign in enumerate((1.0, -1.0)):
            found = strip_integrals(
                [p[:, :2], q[:, :2]],
                [[1.0, 0.0, 0.0], *on_a[1:], sign * d, *on_b[1:]],
                sign * d,
            )
            parts[i, side] += found[:4]
            back[j, side, :3] += found[[0, 4, 5]]
    args = (high, low, neighbours, two.boxes, -1.0, True)
    for compiled, direct, plain in zip(
        overlay_kernel(*args),
        integrals(high, b, low, two, -1.0, True),
        (parts, back),
        strict=True,
    ):
        assert np.array_equal(compiled, direct) and compiled == pytest.approx(plain, abs=1e-11)


def test_gradients_of_given_integrals():
    a, rng = random_tin(6, seed=13), np.random.default_rng(5)
    order = rng.permutation(len(a.triangles))[:-2]
    corners, parts = a.vertices[a.triangles[order]], rng.random((len(order), 2, 4))
    expected = np.zeros((2, len(a.vertices), 3))
    for t, p, part in zip(a.triangles[order], corners, parts, strict=True):
        slope = (p[:, 2] @ barycentric(p[:, :2]))[1:]
        for side, sign in enumerate((-1.0, 1.0)):
            share = part[side, 1:3]
            for v, w in zip(t, [part[side, 0] - share.sum(), *share], strict=True):
                expected[side, v] += sign * w * np.r_[-slope, 1.0]
    found = vertex_gradients(len(a.vertices), a.triangles, order, corners, parts, -1.0)
    assert found == pytest.approx(expected, rel=1e-11, abs=1e-13)


def test_a_walk_ends_where_the_point_is():
    b = random_tin(5, seed=14)
    corners, neighbours = b.vertices[b.triangles], b.neighbours.astype(np.int64)
    coordinates = np.stack([barycentric(p[:, :2]) for p in corners])
    ends = []
    for x, y in np.random.default_rng(3).uniform(-3.5, 3.5, (50, 2)):
        inside = np.flatnonzero((coordinates @ (1.0, x, y) >= 0.0).all(axis=1))
        ends.append(walk(corners, neighbours, 0, x, y))
        assert [ends[-1]] == (inside.tolist() or [-1])
    assert -1 in ends and len(set(ends)) > 6


def test_one_pair_strip_by_strip():
    a, b = random_tin(6, seed=13), random_tin(5, seed=14)
    common = 0
    for p, q in itertools.product(a.vertices[a.triangles], b.vertices[b.triangles[:4]]):
        p, q = p - p[0] * [1, 1, 0], q - p[0] * [1, 1, 0]
        w, out = np.full((ROWS, CORNERS), 7.0), np.ones((1, 2, 4))  # scratch as others left it
        w[A : A + 3, :3], w[B : B + 3, :3] = p.T, q.T
        (area,) = strip_integrals([p[:, :2], q[:, :2]], [[1.0, 0.0, 0.0]])
        s, n, cut = clip_pair(w)
        if n < 3:
            assert area == pytest.approx(0.0, abs=1e-12)
            continue
        common += 1
        assert add_piece(0, 1.0, w, s, n, out) == pytest.approx(area, rel=1e-11)
        on_a, on_b = barycentric(p[:, :2]), barycentric(q[:, :2])
        d = p[:, 2] @ on_a - q[:, 2] @ on_b
        for side, sign in enumerate((1.0, -1.0)):
            found = strip_integrals(
                [p[:, :2], q[:, :2]],
                [[1.0, 0.0, 0.0], *on_a[1:], sign * d, *on_b[1:]],
                sign * d,
            )
            assert w[PAIR + side, :6] == pytest.approx(found, rel=1e-9, abs=1e-11)
            assert out[0, side] - 1.0 == pytest.approx(found[:4], rel=1e-9, abs=1e-11)
        outside = (p[:, :2] @ on_b[:, 1:].T + on_b[:, 0] < -1e-12).any(axis=0)
        # an edge of b cuts something off where a corner of a, or of what is left, lies beyond it
        assert all(outside[k] for k in range(3) if (cut >> k) & 1)
    assert common > 10


def test_clipping_by_a_line():
    ring, half = STAR_RING, np.array([-0.02, -0.5, 1.0])  # left of the line through (0.1, 0.07)
    w = np.zeros((ROWS, CORNERS))
    w[:2, : len(ring)] = ring.T
    s, n, cut = clip_line(w, 0, len(ring), 1.0, 0.5, 0.1, 0.07)
    x, y = w[s : s + 2, :n]
    area = 0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1))
    assert cut and area == pytest.approx(strip_integrals([ring], [[1.0, 0, 0]], half)[0], rel=1e-12)
    assert (half[0] + half[1] * x + half[2] * y >= -1e-12).all()
    again = np.full((ROWS, CORNERS), 7.0)  # from the other pair of rows: the same ring
    again[2:4, : len(ring)] = ring.T
    assert clip_line(again, 2, len(ring), 1.0, 0.5, 0.1, 0.07) == (2 - s, n, cut)
    assert np.array_equal(again[2 - s : 4 - s, :n], w[s : s + 2, :n])
    assert clip_line(w, s, n, 1.0, 0.5, 0.1, 0.07 - 5.0) == (s, n, False)
    assert clip_line(w, s, n, 1.0, 0.5, 0.1, 0.07 + 5.0)[1:] == (0, True)


def test_tips_and_fans_by_divided_differences():
    d = np.array([[1.0, -0.3, -2.0]])
    assert tip(*d[0]) == pytest.approx([*positive_mean(d), *positive_slopes(d)[0]], rel=1e-13)
    w = np.zeros((ROWS, CORNERS))
    w[6:10, :3] = [[0.1, 0.5, 0.4], [0.3, 0.0, 0.6], [0.2, 0.7, 0.1], [0.5, 0.2, 0.0]]
    w[0, :3], w[1, :3] = [0.0, 1.4, 0.0], [0.0, 0.0, 1.0]  # area 0.7
    rng = np.random.default_rng(1)
    whole = [rng.integers(-2, 3, 3).astype(float) for _ in range(60)]
    for d in [*whole, *rng.uniform(-1, 1, (40, 3))]:
        w[5, :3], w[PAIR:] = d, 0.0
        add_fan(0.7, w, 1)
        fan = w[PAIR:].copy()
        assert fan[:, 3] == pytest.approx(
            [0.7 * positive_part(s * d[None])[0][0] for s in (1, -1)], abs=1e-15
        )
        if len(set(d)) == 3 and d.all():
            for side, sign in enumerate((1.0, -1.0)):
                weight = 0.7 * positive_slopes(sign * d[None])[0]
                rows = np.vstack([np.ones(3), w[6:8, :3], w[8:10, :3]])
                assert fan[side, [0, 1, 2, 4, 5]] == pytest.approx(rows @ weight, abs=1e-12)
        if (d >= 0).all() or (d <= 0).all():  # the same by the way for one sign
            w[PAIR:] = 0.0
            add_same_sign(w, 0, 3, 0 if (d >= 0).all() else 1)
            assert w[PAIR:] == pytest.approx(fan, abs=1e-15)


def test_the_walk_from_neighbour_to_neighbour_and_the_tree_agree():
    """Without neighbours every triangle is looked up in the tree: the same pieces, in another
    order.
    """
    rng = np.random.default_rng(7)
    for n, k in ((40, 900), (900, 40), (300, 300)):
        a, b = random_tin(n, seed=n), random_tin(k, seed=k + 1, half=2.5)
        holes = dataclasses.replace(b, relevant=rng.random(len(b.triangles)) < 0.9)
        for other in (b, holes):
            alone = dataclasses.replace(other, neighbours=np.full_like(other.neighbours, -1))
            one, two = volumes_between(a, other), volumes_between(a, alone)
            assert (one.cut_m3, one.fill_m3, one.area_m2) == pytest.approx(
                (two.cut_m3, two.fill_m3, two.area_m2), rel=1e-12
            )
            for name in ("gradient_cut", "gradient_fill", "lower_cut", "lower_fill"):
                assert getattr(one, name) == pytest.approx(getattr(two, name), abs=1e-12)


def test_wrong_neighbours_cost_time_but_no_volume():
    a, b = random_tin(200, seed=21), random_tin(150, seed=22)
    mixed = dataclasses.replace(b, neighbours=np.random.default_rng(5).permutation(b.neighbours))
    one, two = volumes_between(a, b), volumes_between(a, mixed)
    assert (one.cut_m3, one.fill_m3, one.area_m2) == pytest.approx(
        (two.cut_m3, two.fill_m3, two.area_m2), rel=1e-9
    )


def test_one_triangle_over_more_than_can_wait_at_once():
    """A pair of triangles above a lattice of 12,800: the tree's list is taken up again where the
    kept pieces were full.
    """
    x, y = (g.ravel() for g in np.meshgrid(np.linspace(-1, 1, 81), np.linspace(-1, 1, 81)))
    fine = build_tin(np.c_[x, y, 0.1 * x - 0.2 * y])
    r = volumes_between(flat(1.0), fine)
    assert (
        len(fine.triangles) > 2 * WAITING
        and r.area_m2 == pytest.approx(4.0, rel=1e-12)
        and r.net_m3 == pytest.approx(4.0, rel=1e-12)
    )
    thirds = np.bincount(
        fine.triangles.ravel(), np.repeat(footprint_areas(fine.vertices, fine.triangles) / 3.0, 3)
    )
    assert r.lower_net[:, 2] == pytest.approx(-thirds, abs=1e-15)
    back = volumes_between(fine, flat(1.0))
    assert back.gradient_net == pytest.approx(-r.lower_net, abs=1e-12)


def test_results_do_not_depend_on_the_number_of_threads():
    a, b = random_tin(3000, seed=31), random_tin(2500, seed=32)
    many, before = volumes_between(a, b), numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        one = volumes_between(a, b)
    finally:
        numba.set_num_threads(before)
    for field in dataclasses.fields(many):
        assert np.array_equal(getattr(many, field.name), getattr(one, field.name))
