"""Prismoids: the printed example, closed forms, invariances, gradients against central differences,
clipping.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from plain_integrals import (
    barycentric,
    complex_gradient,
    positive_mean,
    positive_slopes,
    strip_integrals,
)
from scipy.spatial import ConvexHull

from ladar_volume.ground.polynomial import base_height, design_surface
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import Plane, Tin
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.volume.centroid import centroid, moment_kernel
from ladar_volume.volume.polygon import (
    areas_inside,
    check_polygon,
    clip,
    clipped_prismoids,
    clipped_weights,
    holds,
    is_convex,
    leftward,
    moments,
)
from ladar_volume.volume.prismoids import mean_above, positive_part, prismoid_kernel, prismoids


def level(z):
    return design_surface([float(z)])


def roof():
    vertices = np.array([(0, 0, 0), (4, 0, 1), (4, 3, 2), (0, 3, -1), (2, 1.5, 3)], float)
    triangles = np.array([(0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)], np.int32)
    return Tin(vertices, triangles, np.full((4, 3), -1, np.int32), np.ones(4, bool), np.arange(5))


def random_tin(n=40, seed=0, half=3.0):
    rng = np.random.default_rng(seed)
    corners = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    xy = np.r_[rng.uniform(-half, half, (n, 2)), corners]
    return build_tin(np.c_[xy, rng.uniform(-1, 2, len(xy))])


BASES = {
    "level": level(0.4),
    "plane": design_surface([0.3, 0.2, -0.1], (0.5, 0.25)),
    "quadric": design_surface([0.3, 0.2, -0.1, 0.05, -0.03, 0.02], (0.5, 0.25)),
}
STAR = np.array(
    [
        [2.5, 0.1],
        [0.6, 0.5],
        [0.2, 2.7],
        [-0.5, 0.4],
        [-2.6, -0.2],
        [-0.4, -0.6],
        [0.1, -2.4],
        [0.7, -0.5],
    ]
)


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
def test_roof(z, cut, fill):
    p = prismoids(roof(), level(z))
    assert p.cut_m3 == pytest.approx(cut, abs=1e-12) and p.fill_m3 == pytest.approx(fill, abs=1e-12)
    assert p.area_m2 == pytest.approx(12.0)


def test_two_levels_differ_by_the_slab():
    tin = random_tin()
    a, b = prismoids(tin, level(0.2)), prismoids(tin, level(0.9))
    assert a.net_m3 - b.net_m3 == pytest.approx(a.area_m2 * 0.7, rel=1e-12)


def test_cut_minus_fill_is_the_signed_volume_and_parts_add():
    tin = random_tin(seed=1)
    whole = prismoids(tin, BASES["plane"])
    h = tin.vertices[:, 2] - base_height(BASES["plane"], tin.vertices[:, :2])
    xy = tin.vertices[tin.triangles, :2]
    area = 0.5 * np.abs(np.linalg.det(xy[:, 1:] - xy[:, :1]))
    assert whole.net_m3 == pytest.approx(float(area @ h[tin.triangles].mean(axis=1)), rel=1e-12)
    part = np.random.default_rng(2).random(len(tin.triangles)) < 0.4
    one, two = prismoids(tin, BASES["plane"], part), prismoids(tin, BASES["plane"], ~part)
    for name in ("cut_m3", "fill_m3", "area_m2"):
        assert getattr(one, name) + getattr(two, name) == pytest.approx(
            getattr(whole, name), rel=1e-12
        )
    assert np.allclose(one.gradient_cut + two.gradient_cut, whole.gradient_cut, atol=1e-12)


def test_positive_part_against_subdivision():
    rng = np.random.default_rng(3)
    h = np.r_[
        rng.uniform(-1, 1, (50, 3)),
        [[0, 0, 0], [0, 1, 2], [0, -1, 2], [0, 0, 1], [0, -1, -1], [1, 1, -1e-14]],
    ]
    k = 200
    i, j = np.meshgrid(np.arange(k), np.arange(k), indexing="ij")
    up, down = (i + j) < k, (i + j) < k - 1
    a = np.r_[(i[up] + 1 / 3) / k, (i[down] + 2 / 3) / k]
    b = np.r_[(j[up] + 1 / 3) / k, (j[down] + 2 / 3) / k]
    weights = np.stack([1 - a - b, a, b])
    mean = np.maximum(h @ weights, 0).mean(axis=1)
    # the midpoint rule misses at most the cells that the zero line cuts
    assert positive_part(h)[0] == pytest.approx(mean, abs=3 / k**2)


@pytest.mark.parametrize("base", list(BASES))
@pytest.mark.parametrize("outline", ["whole", "star"])
def test_gradients_against_central_differences(base, outline):
    tin, plane = random_tin(seed=4), BASES[base]

    def run(vertices, surface=plane):
        t = dataclasses.replace(tin, vertices=vertices)
        return prismoids(t, surface) if outline == "whole" else clipped_prismoids(t, surface, STAR)

    p, h = run(tin.vertices), 1e-6
    for i in range(0, len(tin.vertices), 3):
        for axis in range(3):
            step = np.zeros_like(tin.vertices)
            step[i, axis] = h
            a, b = run(tin.vertices + step), run(tin.vertices - step)
            assert p.gradient_cut[i, axis] == pytest.approx(
                (a.cut_m3 - b.cut_m3) / (2 * h), abs=2e-7
            )
            assert p.gradient_fill[i, axis] == pytest.approx(
                (a.fill_m3 - b.fill_m3) / (2 * h), abs=2e-7
            )
    for k in range(len(plane.beta)):
        step = np.eye(len(plane.beta))[k] * h
        a, b = (
            run(tin.vertices, dataclasses.replace(plane, beta=plane.beta + s * step))
            for s in (1, -1)
        )
        assert p.base_cut[k] == pytest.approx((a.cut_m3 - b.cut_m3) / (2 * h), abs=2e-6)
        assert p.base_fill[k] == pytest.approx((a.fill_m3 - b.fill_m3) / (2 * h), abs=2e-6)


def test_means_are_divided_differences():
    h = np.random.default_rng(1).uniform(-1.5, 1.5, (200, 3))
    mean, slope = positive_part(h)
    assert mean == pytest.approx(positive_mean(h), abs=1e-12)
    assert slope == pytest.approx(positive_slopes(h), abs=1e-10)
    for t in range(len(h)):
        own = np.empty(3)
        assert mean_above(h[t], own) == mean[t] and np.array_equal(own, slope[t])
    for zeros in ([0.0, 0.0, 2.0], [0.0, 1.0, 3.0], [0.0, 0.0, 0.0]):  # corners on the base
        (up, down), gradients = positive_part(np.array([zeros, np.negative(zeros)]))
        assert (up, down) == pytest.approx((sum(zeros) / 3.0, 0.0), abs=1e-16)
        assert gradients == pytest.approx(np.outer([any(zeros), 0.0], np.full(3, 1 / 3)))


def test_volumes_and_gradients_by_complex_steps():
    tin, rng = random_tin(6, seed=6), np.random.default_rng(1)
    height, inside = tin.vertices[:, 2] - 0.4, rng.random(len(tin.triangles)) < 0.7
    chosen = tin.triangles[inside]

    def areas(xy):
        a, b, c = (xy[chosen[:, i]] for i in range(3))
        return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])

    def both(xy, height):
        above = positive_mean(height[chosen])
        return np.array([areas(xy) @ above, areas(xy) @ height[chosen].mean(axis=1)])

    xy = np.ascontiguousarray(tin.vertices[:, :2])
    cut, net = np.zeros((2, len(tin.vertices), 3))
    total = prismoid_kernel(tin.vertices, tin.triangles, inside, height, cut, net)
    up, whole = both(xy, height)
    assert total == pytest.approx([up, up - whole, areas(xy).sum()], rel=1e-11)
    by_xy = complex_gradient(lambda v: both(v, height), xy)
    by_height = complex_gradient(lambda h: both(xy, h), height)
    for k, found in enumerate((cut, net)):
        assert found == pytest.approx(np.c_[by_xy[..., k], by_height[:, k]], abs=1e-10)
    up, all_ = np.zeros((2, len(tin.vertices), 1))
    same = prismoid_kernel(tin.vertices, tin.triangles, inside, height, up, all_)
    assert np.array_equal(same, total) and np.array_equal(np.c_[up, all_], np.c_[cut, net][:, 2::3])


def test_the_centroid_by_quadrature():
    tin, rng = random_tin(8, seed=6), np.random.default_rng(1)
    inside = np.where(rng.random(len(tin.triangles)) < 0.7, 0.3, 0.0)
    low = rng.uniform(0.3, 0.5, len(tin.vertices))
    found = moment_kernel(tin.vertices, tin.triangles, inside, low)
    # midpoints of sides integrate the product of two linear functions exactly
    middle = np.array([[0.5, 0.5, 0.0], [0.0, 0.5, 0.5], [0.5, 0.0, 0.5]])
    moment, volume = np.zeros(3), 0.0
    for t in np.flatnonzero(inside):
        p = middle @ tin.vertices[tin.triangles[t]]
        h = p[:, 2] - middle @ low[tin.triangles[t]]
        if h.sum() > 0.0:
            p[:, 2] -= 0.5 * h
            moment, volume = moment + inside[t] * h @ p / 3.0, volume + inside[t] * h.mean()
    assert found == pytest.approx(moment / volume, rel=1e-12)


def test_net_gradient_survives_heights_of_exactly_zero():
    tin = build_tin(np.array([[0, 0, 1.0], [1, 0, 1], [1, 1, 1], [0, 1, 1], [2, 0, 1.5]]))
    for run in (
        prismoids,
        lambda t, b: clipped_prismoids(t, b, np.array([[-1.0, -1], [3, -1], [3, 3], [-1, 3]])),
    ):
        p = run(tin, level(1))
        assert p.fill_m3 == 0.0 and p.base_net[0] == pytest.approx(-p.area_m2, rel=1e-12)


def test_vertical_gradient_is_a_third_of_the_incident_footprint():
    tin = random_tin(seed=5)
    p = prismoids(tin, level(-50))
    assert p.gradient_net[:, 2].sum() == pytest.approx(36.0, rel=1e-12)
    one = 7
    incident = np.flatnonzero((tin.triangles == one).any(axis=1))
    mask = np.zeros(len(tin.triangles), bool)
    mask[incident] = True
    assert p.gradient_net[one, 2] == pytest.approx(
        prismoids(tin, level(-50), mask).area_m2 / 3, rel=1e-12
    )


def test_a_polygon_around_everything_is_the_whole():
    tin, square = random_tin(seed=6), np.array([[-9.0, -9], [9, -9], [9, 9], [-9, 9]])
    for base in BASES.values():
        a, b = prismoids(tin, base), clipped_prismoids(tin, base, square)
        assert (a.cut_m3, a.fill_m3, a.area_m2) == pytest.approx(
            (b.cut_m3, b.fill_m3, b.area_m2), rel=1e-12
        )
        assert np.allclose(a.base_net, b.base_net, rtol=1e-11)
        inner = ~np.isin(
            np.arange(len(tin.vertices)), tin.triangles[(tin.neighbours < 0).any(axis=1)]
        )
        # at the hull the footprint moves with the vertices in one case and not in the other
        assert np.allclose(a.gradient_net[inner], b.gradient_net[inner], atol=1e-11)


def test_polygons_add_and_orientation_does_not_matter():
    tin = random_tin(seed=7)
    whole = clipped_prismoids(tin, BASES["plane"], STAR)
    gate = [[3.0, 0.1]]
    # clockwise around the square, in through the gate, counter-clockwise around the star:
    # everything but the star, negative
    rest_ring = np.r_[[[3.0, 3.0]], gate, STAR, STAR[:1], gate, [[3.0, -3], [-3, -3], [-3, 3]]]
    corners = np.ascontiguousarray(tin.vertices[tin.triangles, :2])
    rest = clipped_weights(corners, np.ones((len(corners), 3)), rest_ring)[:, 0].sum()
    assert -rest + whole.area_m2 == pytest.approx(36.0, rel=1e-12)
    back = clipped_prismoids(tin, BASES["plane"], STAR[::-1])
    assert back.cut_m3 == pytest.approx(whole.cut_m3, rel=1e-12)
    assert areas_inside(tin, STAR).sum() == pytest.approx(whole.area_m2, rel=1e-12)
    left, right = STAR[[2, 3, 4, 5, 6]], STAR[[6, 7, 0, 1, 2]]
    sides = [clipped_prismoids(tin, BASES["plane"], s) for s in (left, right)]
    assert sides[0].cut_m3 + sides[1].cut_m3 == pytest.approx(whole.cut_m3, rel=1e-12)


def test_clipped_triangles_strip_by_strip():
    tin = random_tin(n=6, seed=8)
    corners, h = (
        np.ascontiguousarray(tin.vertices[tin.triangles, :2]),
        np.ascontiguousarray(tin.vertices[tin.triangles, 2]),
    )
    hexagon = np.stack([np.cos(np.arange(6) * np.pi / 3), np.sin(np.arange(6) * np.pi / 3)], axis=1)
    for ring, convex in ((STAR, False), (2.0 * hexagon, True), (9.0 * hexagon, True)):
        found = clipped_weights(corners, h, ring)
        for t, p in enumerate(corners):
            line = barycentric(p)
            for side, sign in enumerate((1.0, -1.0)):
                expected = strip_integrals([ring, p], line, sign * h[t] @ line)
                assert found[t, side] == pytest.approx(expected, abs=1e-12)
        assert is_convex(ring) == convex == (len(ConvexHull(ring).vertices) == len(ring))
    assert not is_convex(hexagon[::-1].copy())  # clockwise
    rng, sides = np.random.default_rng(4), ConvexHull(hexagon).equations
    within = []
    for points in rng.uniform(-0.9, 0.9, (100, 3, 2)):
        within.append((points @ sides[:, :2].T + sides[:, 2] <= 0.0).all())
        assert holds(hexagon, points) == within[-1]
        a, b, p = points @ (1.0, 1j)
        assert leftward(*points) == (((p - a) / (b - a)).imag >= 0.0)
    assert 0 < sum(within) < 100


def test_triangles_within_a_convex_polygon_are_taken_whole():
    tin = random_tin(seed=5)
    square = 3.5 * np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    notched = np.r_[
        square[:2], [[3.5, -0.1], [3.4, 0.0], [3.5, 0.1]], square[2:]
    ]  # not convex, and holds the same
    corners, h = (
        np.ascontiguousarray(tin.vertices[tin.triangles, :2]),
        np.ascontiguousarray(tin.vertices[tin.triangles, 2]),
    )
    assert is_convex(square) and not is_convex(notched)
    assert clipped_weights(corners, h, square) == pytest.approx(
        clipped_weights(corners, h, notched), abs=1e-13
    )


def test_a_clipped_ring_and_its_moments():
    ring, half = np.zeros((30, 2)), (0.1, 1.0, -0.3)
    n = clip(STAR, 8, *half, ring)
    sides = 0.1 + STAR @ (1.0, -0.3)
    crossed = np.count_nonzero((sides > 0) != (np.roll(sides, -1) > 0))
    assert n == np.count_nonzero(sides > 0) + crossed
    assert (0.1 + ring[:n] @ (1.0, -0.3) >= -1e-12).all()
    assert moments(ring, n) == pytest.approx(strip_integrals([STAR], np.eye(3), half), rel=1e-12)


@pytest.mark.parametrize(
    "polygon",
    [
        np.zeros((0, 2)),
        [[0, 0], [1, 1]],
        [[0, 0], [1, 1], [2, 2]],
        [[0, 0], [2, 2], [2, 0], [0, 2.5]],
        [[0, 0], [1, np.nan], [1, 1]],
        [0, 1, 2],
    ],
)
def test_bad_polygons(polygon):
    with pytest.raises(VolumeError) as caught:
        check_polygon(polygon)
    assert caught.value.reason == "volume_polygon"


def test_nothing_inside():
    tin = random_tin(seed=9)
    with pytest.raises(VolumeError):
        prismoids(tin, level(0), np.zeros(len(tin.triangles), bool))
    with pytest.raises(VolumeError):
        clipped_prismoids(tin, level(0), STAR + 100.0)
    assert clipped_prismoids(random_tin(), level(0), np.r_[STAR, STAR[:1]]).area_m2 > 0


def test_rigid_motion_and_scale():
    tin, plane = random_tin(seed=10), BASES["plane"]
    v = prismoids(tin, plane).net_m3
    c, s = math.cos(0.7), math.sin(0.7)
    R = np.array([[c, -s], [s, c]])
    turned = dataclasses.replace(
        tin, vertices=np.c_[tin.vertices[:, :2] @ R.T + [100, -50], tin.vertices[:, 2] + 7]
    )
    beta = np.r_[plane.beta[0] + 7, R @ plane.beta[1:]]
    base = Plane(R @ plane.origin_xy + [100, -50], beta, np.zeros((3, 3)), np.zeros(0, np.int64))
    assert prismoids(turned, base).net_m3 == pytest.approx(v, rel=1e-9)
    scaled = dataclasses.replace(tin, vertices=3 * tin.vertices)
    assert prismoids(
        scaled, Plane(3 * plane.origin_xy, plane.beta * [3, 1, 1], np.zeros((3, 3)), plane.support)
    ).net_m3 == pytest.approx(27 * v)


def test_centroid_of_a_pyramid_and_of_a_prism():
    v = np.array([[-1, -1, 5.0], [1, -1, 5], [1, 1, 5], [-1, 1, 5], [0.0, 0, 8]])
    tin = build_tin(v)
    inside = np.full(4, 1.0)
    assert centroid(tin, level(5), inside) == pytest.approx((0, 0, 5 + 3 / 4))
    flat = build_tin(v[:4] * [1, 1, 2])
    assert centroid(flat, level(4), np.full(2, 2.0)) == pytest.approx((0, 0, 7.0))
    assert centroid(flat, level(40), np.full(2, 2.0)) == pytest.approx((0, 0, 10.0))
