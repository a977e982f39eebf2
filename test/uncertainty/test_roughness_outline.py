"""Roughness of the ground as a field, and the outline of a body."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import astuple

import numpy as np
import pytest
from scipy.optimize import nnls

from ladar_volume.ground.polynomial import (
    COEFFICIENTS,
    design,
    design_surface,
)
from ladar_volume.model.errors import VolumeError
from ladar_volume.tin.full_tin import build_tin, vertex_mask
from ladar_volume.uncertainty.ground_field import (
    GroundField,
    Roughness,
    field_bounds,
    mean_spacing,
    spread_kernel,
    squares_grid,
)
from ladar_volume.uncertainty.roughness import (
    basis,
    estimate_roughness,
    fields_kernel,
    fit_field,
    fit_reduction,
    lag_edges,
    lag_middles,
    packed_product,
    pair_sums,
)
from ladar_volume.volume.outline import (
    boundary_loop,
    components,
    fill_holes,
    labelled_bodies,
    reached_vertices,
    surroundings,
    vertices_within,
    widen_body,
)


def largest_body(tin, level_m, rise_m):
    """The triangles of the largest body above a level."""
    label, kept = labelled_bodies(tin, design_surface([level_m]), rise_m)
    return label == kept[0]


def grid(n=30, step=1.0):
    return (
        np.stack(np.meshgrid(np.arange(n), np.arange(n), indexing="ij"), axis=-1).reshape(-1, 2)
        * step
    )


def at_points(xy, weight, rough):
    """A field that is felt at points alone."""
    return GroundField(np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros(0), xy, weight, rough)


def over_cells(xy, weight, rough, side=1.0):
    """A field that is felt over squares around xy, two triangles each."""
    corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) * side
    triangles = (
        np.arange(4 * len(xy))
        .reshape(-1, 4)[:, [[0, 1, 2], [0, 2, 3]]]
        .reshape(-1, 3)
        .astype(np.int32)
    )
    vertices = (xy[:, None] + corners).reshape(-1, 2)
    return GroundField(
        vertices, triangles, np.repeat(0.5 * weight, 2), np.zeros((0, 2)), np.zeros(0), rough
    )


@pytest.mark.parametrize("length", [0.6, 2.0, 8.0, 100.0])
def test_field_variance_equals_the_dense_sum(length):
    xy = grid(25) + np.random.default_rng(0).uniform(-0.3, 0.3, (625, 2))
    weight = 1.0 + 0.05 * xy[:, 0] - 0.02 * xy[:, 1]
    d = np.linalg.norm(xy[:, None] - xy[None], axis=2)
    dense = 0.04 * float(weight @ np.exp(-d / length) @ weight)
    assert at_points(xy, weight, Roughness(0.04, length, 1.0)).variance_m6 == pytest.approx(
        dense, rel=0.05
    )


def test_the_sum_on_a_grid_is_that_of_all_pairs_of_cells():
    rng = np.random.default_rng(3)
    xy, weight, point = (
        rng.uniform(0, 1, (300, 2)) * [9.0, 4.0],
        rng.standard_normal(300),
        rng.random(300) < 0.5,
    )
    rough = Roughness(0.02, 0.7, 0.5, 0.4)
    cell = np.floor((xy - xy.min(axis=0)) / 0.5)
    rho = rough.correlation(0.5 * np.linalg.norm(cell[:, None] - cell[None], axis=2))
    same = (cell[:, None] == cell[None]).all(axis=2)
    rho[same] = rough.correlation(np.array(0.5214 * 0.5))
    rho[np.arange(300), np.arange(300)] = np.where(point, 1.0, rho.diagonal())
    speck = over_cells(xy[~point], weight[~point], rough, 1e-9)
    field = dataclasses.replace(speck, xy=xy[point], weight=weight[point])
    assert field.variance_m6 == pytest.approx(0.02 * weight @ rho @ weight, rel=1e-9)
    low, high = field_bounds(field.vertices, field.triangles, field.area, field.xy)
    assert low == pytest.approx(xy.min(axis=0), abs=2e-9) and high == pytest.approx(
        xy.max(axis=0), abs=2e-9
    )
    edges = [low[c] + 0.5 * np.arange(n + 1) for c, n in enumerate((19, 9))]
    assert squares_grid(xy, weight, low, 0.5, (19, 9)) == pytest.approx(
        np.histogram2d(*xy.T, edges, weights=weight)[0], abs=1e-12
    )
    assert at_points(xy[:1], weight[:1], rough).variance_m6 == pytest.approx(0.02 * weight[0] ** 2)
    assert at_points(xy[:0], weight[:0], rough).variance_m6 == 0.0


def test_a_large_triangle_feels_the_mean_of_the_field():
    vertices = np.array(
        [
            [-3.0, -1.25, 0.3],
            [3.0, -1.25, 0.1],
            [3.0, 1.25, 0.0],
            [-3.0, 1.25, 0.2],
            [90.0, 90.0, 0.0],
        ]
    )
    triangles = np.array([[0, 1, 2], [0, 2, 3], [2, 3, 4]], np.int32)
    for share, length in ((1.0, 0.7), (0.0, 0.7), (0.5, 3.0)):
        rough = Roughness(9e-6, length, 0.1, share)
        found = GroundField(
            vertices, triangles, np.array([7.5, 7.5, 0.0]), np.zeros((0, 2)), np.zeros(0), rough
        )
        x, y = (side * (np.arange(n) + 0.5) / n for side, n in ((6.0, 60), (2.5, 25)))
        # over a rectangle, the number of pairs by distance along x and along y is that of two
        # triangles' convolutions
        exact = sum(
            float(
                (
                    (len(x) - np.abs(i))
                    * (len(y) - abs(j))
                    * rough.correlation(0.1 * np.hypot(i, j))
                ).sum()
            )
            for i in [np.arange(1 - len(x), len(x))]
            for j in range(1 - len(y), len(y))
        )
        assert found.variance_m6 == pytest.approx(9e-6 * exact * 15.0**2 / 1500**2, rel=0.02)


def test_triangles_are_spread_over_their_squares():
    rng = np.random.default_rng(6)
    vertices, triangles = (
        rng.uniform(0.0, 6.0, (12, 2)),
        rng.integers(0, 12, (9, 3)).astype(np.int32),
    )
    triangles[0] = [3, 3, 3]  # of no size
    area = rng.standard_normal(9)
    area[1] = 0.0
    found = np.zeros((12, 12))
    spread_kernel(vertices, triangles, area, np.zeros(2), 0.5, found)
    assert found.sum() == pytest.approx(area.sum(), rel=1e-12)
    # halving keeps the centroid of all parts where that of the whole is
    middle = np.stack(np.meshgrid(*2 * [0.25 + 0.5 * np.arange(12)], indexing="ij"), axis=-1)
    assert np.einsum("ij,ijc->c", found, middle) == pytest.approx(
        area @ vertices[triangles].mean(axis=1), abs=0.25 * np.abs(area).sum()
    )
    # what lies in a square is, as the squares get small, the share of the triangle in it
    fine = np.zeros((120, 120))
    spread_kernel(vertices, triangles[2:3], np.ones(1), np.zeros(2), 0.05, fine)
    exact = np.zeros((120, 120))
    a, b = rng.uniform(size=(2, 1_000_000))
    u, v = np.where(a + b > 1, 1 - a, a), np.where(a + b > 1, 1 - b, b)
    p, q, r = vertices[triangles[2]]
    at = np.floor((p + u[:, None] * (q - p) + v[:, None] * (r - p)) / 0.05).astype(int)
    np.add.at(exact, tuple(at.T), 1.0 / len(at))
    assert fine.reshape(12, 10, 12, 10).sum(axis=(1, 3)) == pytest.approx(
        exact.reshape(12, 10, 12, 10).sum(axis=(1, 3)), abs=5e-3
    )


def spread_twin(corners, share, side, cells):
    """A triangle (3, 2) halved across its longest edge, part by part: shares by square."""
    edges = [math.dist(corners[k - 2], corners[k - 1]) for k in range(3)]
    if max(edges) <= side:
        at = tuple(int(c) for c in np.mean(corners, axis=0) // side)
        cells[at] = cells.get(at, 0.0) + share
        return
    tip = int(np.argmax(edges))  # opposite the longest
    a, b, middle = corners[tip - 2], corners[tip - 1], (corners[tip - 2] + corners[tip - 1]) / 2
    for one in (a, b):
        spread_twin([corners[tip], one, middle], share / 2, side, cells)


def test_triangles_are_halved_across_their_longest_edge():
    rng = np.random.default_rng(12)
    for k in range(12):
        r = rng.uniform(0.0, 6.0, (3, 2)) * [1.0, 0.1 if k % 3 else 1.0]  # fat and narrow ones
        grid_, cells = np.zeros((12, 12)), {}
        spread_kernel(r, np.array([[0, 1, 2]], np.int32), np.ones(1), np.zeros(2), 0.5, grid_)
        spread_twin(list(r), 1.0, 0.5, cells)
        assert {(int(i), int(j)): grid_[i, j] for i, j in zip(*np.nonzero(grid_), strict=True)} == (
            pytest.approx(cells, rel=1e-12)
        )


def test_a_constant_deviation_cancels_between_inside_and_outside():
    xy = grid(30)
    inside = np.hypot(*(xy - 14.5).T) < 6
    weight = np.where(inside, 1.0, -inside.sum() / (~inside).sum())
    rough = Roughness(1.0, 1e6, 1.0)
    assert (
        over_cells(xy, weight, rough).variance_m6
        < 1e-3 * over_cells(xy, inside.astype(float), rough).variance_m6
    )
    assert over_cells(xy, weight, Roughness(0.0, 1.0, 1.0)).variance_m6 == 0.0
    area = inside.sum()
    small = over_cells(xy[inside], np.ones(area), Roughness(1.0, 0.5, 1.0)).variance_m6
    # a field much finer than the body: A 2 pi L^2
    assert small == pytest.approx(area * 2 * math.pi * 0.5**2, rel=0.25)


@pytest.mark.parametrize("length", [1.5, 3.0])
def test_roughness_of_a_simulated_field(length):
    xy = grid(40)
    d = np.linalg.norm(xy[:, None] - xy[None], axis=2)
    root = np.linalg.cholesky(np.exp(-d / length) + 1e-9 * np.eye(len(xy)))
    rng = np.random.default_rng(1)
    found = []
    for _ in range(4):
        e = 0.05 * root @ rng.standard_normal(len(xy)) + 0.01 * rng.standard_normal(len(xy))
        found.append(estimate_roughness(xy, e - e.mean(), np.full(len(xy), 1e-4), 1))
    assert np.mean([f.variance_m2 for f in found]) == pytest.approx(0.0025, rel=0.15)
    assert np.mean([f.length_m for f in found]) == pytest.approx(length, rel=0.3)


def test_a_field_is_found_whatever_its_noise_is_believed_to_be():
    xy = grid(36, 0.5)
    d = np.linalg.norm(xy[:, None] - xy[None], axis=2)
    root = np.linalg.cholesky(np.exp(-0.5 * (d / 1.2) ** 2) + 1e-8 * np.eye(len(xy)))
    rng, weight = np.random.default_rng(8), np.where(np.hypot(*(xy - 8.75).T) < 3.0, 1.0, -0.1)
    found = []
    for _ in range(12):
        e = 0.01 * root @ rng.standard_normal(len(xy)) + 0.03 * rng.standard_normal(len(xy))
        rough = [
            estimate_roughness(xy, e - e.mean(), np.full(len(xy), share * 9e-4), 1)
            for share in (0.5, 1.0, 2.0)
        ]
        found.append([over_cells(xy, weight, one, 0.5).variance_m6 for one in rough])
    exact = 1e-4 * float(weight @ np.exp(-0.5 * (d / 1.2) ** 2) @ weight)
    assert np.sqrt(np.mean(found, axis=0) / exact) == pytest.approx(1.0, abs=0.2)


def test_noise_alone_is_no_roughness():
    e = 0.01 * np.random.default_rng(2).standard_normal(1600)
    found = estimate_roughness(grid(40), e, np.full(1600, 1.2e-4), 3)
    assert found.variance_m2 == 0.0
    assert estimate_roughness(grid(2), np.zeros(4), np.zeros(4), 6).variance_m2 == 0.0
    assert mean_spacing(grid(40, 0.3)) == pytest.approx(0.3, rel=0.05)


def test_what_scatters_beyond_its_noise_is_roughness_shorter_than_the_spacing():
    rng = np.random.default_rng(17)
    for n, parameters in ((40, 1), (30, 6)):
        e = 0.02 * rng.standard_normal(n * n)
        found = estimate_roughness(grid(n), e, np.full(n * n, 1e-4), parameters)
        assert found.variance_m2 == pytest.approx(4e-4 - 1e-4, rel=0.15)
        assert found.length_m < 1.0


def test_an_exact_ground_has_no_roughness():
    xy = grid()
    with np.errstate(all="raise"):
        found = estimate_roughness(xy, np.zeros(len(xy)), np.zeros(len(xy)), 3)
    assert found.variance_m2 == 0.0


def test_no_roughness_has_the_shortest_length_whatever_it_was_told_from():
    xy, noise = grid(20, 0.4), 0.01 * np.random.default_rng(2).standard_normal(400)
    none = estimate_roughness(xy, np.zeros(400), np.zeros(400), 3)
    assert none == estimate_roughness(xy, noise, np.full(400, 1.2e-4), 3)
    few = estimate_roughness(xy[:3], noise[:3], np.full(3, 1e-4), 3)
    assert few == Roughness(0.0, mean_spacing(xy[:3]) / 2, mean_spacing(xy[:3]))
    shortest = fit_field(np.zeros(1), np.zeros(1), np.ones(1), none.spacing_m / 2, 80.0)[1]
    assert none.length_m == pytest.approx(shortest, rel=1e-12)


def test_a_ground_in_other_units_has_the_same_roughness():
    xy, rng = grid(18, 0.5), np.random.default_rng(21)
    root = np.linalg.cholesky(
        np.exp(-np.linalg.norm(xy[:, None] - xy[None], axis=2) / 1.3) + 1e-9 * np.eye(len(xy))
    )
    e = 0.02 * root @ rng.standard_normal(len(xy)) + 0.01 * rng.standard_normal(len(xy))
    one = estimate_roughness(xy, e, np.full(len(xy), 1e-4), 3)
    assert one.variance_m2 > 1e-4
    # heights in millimetres, plan in feet: whole factors but for rounding of the lengths tried
    other = estimate_roughness(xy / 0.3048, 1e3 * e, np.full(len(xy), 1e2), 3)
    assert other.variance_m2 == pytest.approx(1e6 * one.variance_m2, rel=1e-6)
    assert (other.length_m, other.spacing_m) == pytest.approx(
        (one.length_m / 0.3048, one.spacing_m / 0.3048), rel=1e-6
    )
    assert other.gaussian == pytest.approx(one.gaussian, abs=1e-6)


def test_a_lag_lies_in_the_middle_of_its_pairs():
    edges = lag_edges(grid(30, 0.5), 0.5)
    assert edges[0] == 0.5 and edges[-1] == pytest.approx(0.25 * 29 * math.sqrt(2.0))
    lag = lag_middles(edges)
    assert lag[0] == 0.0 and lag[1] - 0.0 == pytest.approx(edges[0] - lag[1])
    assert lag[2:] / edges[:-1] == pytest.approx(edges[1:] / lag[2:])


def test_how_smooth_a_field_is():
    lag = np.geomspace(0.3, 40, 25)
    for share in (0.0, 0.3, 1.0):
        found = fit_field(
            lag, 3.0 * Roughness(1.0, 2.0, 0.1, share).correlation(lag), np.ones(25), 0.1, 80.0
        )
        assert found[1:3] == pytest.approx((2.0, share), rel=5e-3, abs=0.02) and found[
            0
        ] == pytest.approx(3.0, rel=0.01)
    xy = grid(30)
    weight = np.where(np.hypot(*(xy - 14.5).T) < 5, 1.0, -0.05)  # a body of a few lengths
    for share in (0.0, 1.0):
        rough = Roughness(0.01, 1.7, 1.0, share)
        d = np.linalg.norm(xy[:, None] - xy[None], axis=2)
        assert over_cells(xy, weight, rough).variance_m6 == pytest.approx(
            0.01 * weight @ rough.correlation(d) @ weight, rel=0.1
        )


@pytest.mark.parametrize("parameters", [1, 3, 6])
def test_what_is_shared_is_no_roughness(parameters):
    xy, rng = grid(20), np.random.default_rng(5)
    n = len(xy)
    strips = np.floor(
        xy[:, 0] / 4
    )  # each strip has a height error of its own, and all tilt together
    C = 4e-4 * (strips[:, None] == strips) + 1e-6 * np.outer(xy[:, 1], xy[:, 1])
    root = np.linalg.cholesky(C + 1e-12 * np.eye(n))
    X = design(xy - 9.5, np.zeros(2), COEFFICIENTS.index(parameters))
    P = np.eye(n) - X @ np.linalg.pinv(X)
    Q = basis(xy, parameters)
    W, trace = fit_reduction(C @ Q, Q)
    assert C - W @ Q.T - Q @ W.T == pytest.approx(P @ C @ P, abs=1e-12)
    assert trace == pytest.approx(np.trace(C) - np.trace(P @ C @ P))
    d = np.linalg.norm(xy[:, None] - xy[None], axis=2)
    field = np.linalg.cholesky(0.0009 * np.exp(-d / 1.5) + 1e-12 * np.eye(n))
    found = []
    for _ in range(40):
        e = P @ (
            root @ rng.standard_normal(n)
            + field @ rng.standard_normal(n)
            + 0.01 * rng.standard_normal(n)
        )
        known = (None, lambda some: (np.arange(len(some)), np.triu(C[np.ix_(some, some)])))
        found.append(
            [
                estimate_roughness(xy, e, np.full(n, 1e-4), parameters, shared).variance_m2
                for shared in known
            ]
        )
    double, once = np.mean(found, axis=0)
    assert double > 1.1 * once
    assert once == pytest.approx(0.0009, rel=0.1)


def test_pairs_by_distance():
    rng = np.random.default_rng(6)
    xy, e, A, Q = (
        rng.uniform(0, 5, (40, 2)),
        rng.standard_normal(40),
        rng.standard_normal((40, 40)),
        rng.standard_normal((40, 3)),
    )
    C, edges = A @ A.T, np.array([0.0, 0.5, 1.0, 3.0])
    products, counts, partners, CQ, packed = pair_sums(xy, e, np.triu(C), Q, edges)
    assert CQ == pytest.approx(C @ Q)
    one, two = np.triu_indices(40)
    assert not packed[one == two].any() and len(packed) == len(one)
    (i, j), d = np.triu_indices(40, 1), packed[one < two]
    assert d == pytest.approx(np.linalg.norm(xy[i] - xy[j], axis=1))
    k = np.digitize(d, edges) - 1
    assert counts == pytest.approx(np.bincount(k, minlength=4)[:3])
    assert products == pytest.approx(np.bincount(k, e[i] * e[j] - C[i, j], 4)[:3])
    W = rng.standard_normal((40, 3))
    T = W @ Q.T + Q @ W.T
    assert np.tensordot(partners, W) == pytest.approx(np.bincount(k, T[i, j], 4)[:3])
    R = np.eye(40)
    R[i, j] = R[j, i] = np.exp(-d)
    assert packed_product(np.exp(-packed), Q) == pytest.approx(R @ Q)


def test_the_order_of_what_is_shared_does_not_matter():
    xy, rng = grid(20), np.random.default_rng(15)
    e, C = rng.standard_normal(400), 0.1 * np.exp(-np.abs(xy[:, :1] - xy[:, 0]) / 3.0)
    found = []
    for order in (np.arange(400), rng.permutation(400)):
        found.append(
            estimate_roughness(
                xy,
                e,
                np.full(400, 0.01),
                3,
                lambda some, order=order: (order, np.triu(C[np.ix_(order, order)])),
            )
        )
    assert astuple(found[0]) == pytest.approx(astuple(found[1]), rel=1e-9)


def fields_twin(lag, value, weight, length):
    """Each non-negative least-squares problem by SciPy."""
    out = []
    for one in length:
        x, root = lag / one, np.sqrt(weight)
        A = np.stack([np.exp(-x), np.exp(-0.5 * x * x)], axis=1)
        part, rest = nnls(A * root[:, None], value * root)
        out.append([*part, float((value**2 * weight).sum()) - rest**2])
    return np.array(out)


def test_fields_of_given_lengths():
    rng, lag, length = (
        np.random.default_rng(16),
        np.append(0.0, np.geomspace(0.3, 40, 25)),
        np.geomspace(0.1, 80.0, 12),
    )
    for scale in (1.0, -1.0):
        for shape in (np.exp(-lag / 3.0), np.exp(-0.5 * (lag / 3.0) ** 2), np.cos(lag)):
            value, weight = scale * shape + 0.1 * rng.standard_normal(26), rng.uniform(0.5, 2.0, 26)
            found = fields_kernel(lag, value, weight, length)
            assert found == pytest.approx(
                fields_twin(lag, value, weight, length), rel=1e-7, abs=1e-7
            )


def test_lengths_at_their_limits():
    lag, even = np.geomspace(0.3, 40, 25), np.ones(25)
    assert fit_field(lag, np.ones(25), even, 0.1, 80.0)[1] == pytest.approx(80.0, rel=1e-3)
    assert fit_field(lag, np.zeros(25), even, 0.1, 80.0) == (0.0, pytest.approx(0.1), 0.0, 0.0)
    assert fit_field(lag, np.zeros(25), even, 0.1, 0.05)[1] == 0.1
    rng, known = (
        np.random.default_rng(7),
        np.append(1e6, even),
    )  # the variance is given: a correlation
    found = [
        fit_field(
            np.append(0.0, lag),
            np.append(1.0, np.exp(-lag / 3.0) + rng.normal(0, 0.05, 25)),
            known,
            0.1,
            80.0,
        )[1]
        for _ in range(200)
    ]
    assert np.mean(found) == pytest.approx(3.0, rel=0.05) and np.std(found) < 0.6


def stepped(n=21):
    xy = grid(n)
    z = np.where(np.abs(xy - 10).max(axis=1) <= 3, 1.0, 0.0)
    return build_tin(np.c_[xy, z])


def test_body_margin_and_surroundings():
    tin = stepped()
    body = largest_body(tin, 0.0, 0.5)
    area = 0.5 * body.sum()
    assert area == 36.0
    assert 0.5 * widen_body(tin, body, 0.0).sum() == pytest.approx(64.0, abs=4)
    wide = widen_body(tin, body, 2.0)
    loop = boundary_loop(tin, wide)
    x, y = loop.T
    assert 0.5 * abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) == pytest.approx(0.5 * wide.sum())
    ring = surroundings(tin, wide, 1.5)
    far = np.abs(tin.vertices[ring, :2] - 10).max(axis=1)
    assert far.min() >= 5.0 and far.max() <= 8.0
    assert len(surroundings(tin, wide, 0.0)) > len(ring)
    with pytest.raises(VolumeError):
        largest_body(tin, 5.0, 0.5)


@pytest.mark.parametrize("distance", [0.02, 0.3, 2.0])
def test_vertices_within_a_distance_of_some(distance):
    rng = np.random.default_rng(7)
    tin = build_tin(np.c_[rng.uniform(0, 10, (500, 2)), np.zeros(500)])
    for share in (0.0, 0.01, 0.3):
        mask = rng.random(len(tin.triangles)) < share
        some = vertex_mask(tin, mask)
        apart = np.linalg.norm(tin.vertices[:, None, :2] - tin.vertices[None, some, :2], axis=2)
        expected = (apart <= distance).any(axis=1)
        assert np.array_equal(vertices_within(tin, mask, distance), expected)
        found = reached_vertices(tin.triangles, tin.neighbours, tin.vertices, some, distance)
        assert not (found & ~expected).any() and found.sum() >= 0.9 * expected.sum()


def test_the_larger_of_two_bodies_is_chosen_by_volume():
    xy = grid(21)
    z = np.where(np.abs(xy - 5).max(axis=1) <= 3, 0.3, 0.0) + np.where(
        np.abs(xy - 15).max(axis=1) <= 2, 5.0, 0.0
    )
    tin = build_tin(np.c_[xy, z])
    body = largest_body(tin, 0.0, 0.2)
    assert tin.vertices[tin.triangles[body], :2].min() >= 13
    both = largest_body(tin, -1.0, 0.2)
    assert both.all()


def test_enclosed_holes_are_filled_but_shadows_are_not():
    tin = stepped()
    middle = tin.vertices[tin.triangles, :2].mean(axis=1) - 10
    distance = np.abs(middle).max(axis=1)
    donut = (distance < 6) & (distance > 2)
    assert np.array_equal(fill_holes(tin, donut), distance < 6)
    shadow = dataclasses.replace(tin, relevant=distance > 1)
    assert np.array_equal(fill_holes(shadow, donut), donut)
    assert fill_holes(tin, np.ones(len(donut), bool)).all()
    label = components(tin, donut | (distance < 1))
    assert len(np.unique(label[label >= 0])) == 2
