"""The folded-normal correction: closed forms of one triangle, Monte Carlo on flat ground, and what
it must leave alone.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy import sparse, special

from ladar_volume.ground.polynomial import design_surface
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import Plane
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.tin.median_screen import edges
from ladar_volume.volume.folded_normal import (
    NODES,
    PACKED,
    add_far,
    add_mean,
    add_means,
    by_line,
    by_quadrature,
    folded,
    folded_kernel,
    least_deviation,
    means_at,
    normal,
)
from ladar_volume.volume.near_base import (
    csr,
    edge_sums,
    fold,
    near_base,
    near_levels,
    node_covariances,
    packed_kernel,
    second_order,
    trace_kernel,
)
from ladar_volume.volume.neighbourhood import Smooth, adjoint_kernel, smooth_kernel, smoother
from ladar_volume.volume.prismoids import positive_part, prismoids

LEVEL = design_surface([0.0])
PHI0 = 1 / math.sqrt(2 * math.pi)


def packed(C):
    return np.array([C[i, j] for i, j in PACKED])[None]


def ground(truth, n=400, seed=0):
    xy = np.random.default_rng(seed).uniform(0, 10, (n, 2))
    return build_tin(np.c_[xy, truth(xy[:, 0], xy[:, 1])])


def fine(mu, C, k=400):
    """g, slopes and curvatures by a fine midpoint rule, whose own error is some 1e-5."""
    i, j = np.meshgrid(np.arange(k), np.arange(k), indexing="ij")
    up, down = (i + j) < k, (i + j) < k - 1
    p = np.r_[(i[up] + 1 / 3) / k, (i[down] + 2 / 3) / k]
    q = np.r_[(j[up] + 1 / 3) / k, (j[down] + 2 / 3) / k]
    w = np.stack([1 - p - q, p, q])
    m, s = mu @ w, np.sqrt(np.einsum("ik,ij,jk->k", w, C, w))
    share, density = special.ndtr(m / s), PHI0 * np.exp(-0.5 * (m / s) ** 2)
    curve = np.einsum("ik,jk,k->ij", w, w, density / s) / len(m)
    return np.r_[
        (m * share + s * density).mean(), (w * share).mean(axis=1), [curve[i, j] for i, j in PACKED]
    ]


def test_nodes_integrate_degree_five():
    p, q, w = NODES.T
    for a in range(6):
        for b in range(6 - a):
            exact = 2 * math.factorial(a) * math.factorial(b) / math.factorial(a + b + 2)
            assert (w * p**a * q**b).sum() == pytest.approx(exact, rel=1e-13)


def test_one_sigma_for_all_nodes_at_the_level():
    s = 0.03
    out = folded(np.zeros((1, 3)), packed(np.full((3, 3), s * s)))[0]
    assert out[0] == pytest.approx(PHI0 * s, rel=1e-12) and out[1:4] == pytest.approx(
        np.full(3, 1 / 6), rel=1e-12
    )
    assert out[4:] == pytest.approx(
        [PHI0 / s * (1 / 6 if i == j else 1 / 12) for i, j in PACKED], rel=1e-12
    )
    # independent nodes: the interpolated height has half the variance on average
    assert folded(np.zeros((1, 3)), packed(np.eye(3) * s * s))[0, 0] == pytest.approx(
        0.28 * s, rel=0.02
    )


@pytest.mark.parametrize("seed", range(6))
def test_means_slopes_and_curvatures_against_a_fine_rule(seed):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(3, 3)) * 0.05
    C, mu = A @ A.T + 0.02**2 * np.eye(3), rng.normal(0, (0.02, 0.1, 0.5)[seed % 3], 3)
    expected = fine(mu, C)
    found = folded(mu[None], packed(C))[0]
    assert found[0] == pytest.approx(expected[0], abs=2e-5) and found[1:4] == pytest.approx(
        expected[1:4], abs=2e-4
    )
    assert found[4:] == pytest.approx(expected[4:], abs=2e-3 * expected[4:].max() + 1e-9)


def test_far_triangles_and_no_noise():
    mu = np.array([[1.0, 2, 3], [-1, -2, -3], [0.5, 0.4, -9]])
    C = np.repeat(packed(np.eye(3) * 0.01**2), 3, axis=0)
    mean, slope = positive_part(mu)
    out = folded(mu, C)
    assert (
        np.array_equal(out[:2, 0], mean[:2])
        and np.array_equal(out[:2, 1:4], slope[:2])
        and not out[:2, 4:].any()
    )
    still = folded(np.array([[0.0, 0, 0], [1, -1, 0.5]]), np.zeros((2, 6)))
    assert still[:, 0] == pytest.approx(
        positive_part(np.array([[0.0, 0, 0], [1, -1, 0.5]]))[0], abs=1e-15
    )


def test_tall_triangles_meet_the_rule_for_lines():
    mu = np.array([[1.0, -0.7, -0.2]])
    for s in (0.01, 0.001):
        C = packed(np.diag([1.0, 2.0, 0.5]) * s * s)
        # half the variance times the density of heights at the level
        bias = folded(mu, C)[0, 0] - positive_part(mu)[0][0]
        line = np.zeros(10)
        by_line(mu[0], C[0], line)
        assert bias == pytest.approx(line[0], rel=0.02)
    cubes = np.zeros(10)
    by_line(mu[0], packed(np.ones((3, 3)))[0], cubes)
    h = 1e-4  # the curvature at zero is the derivative of the slopes by a shift of all heights
    shift = (positive_part(mu + h)[1] - positive_part(mu - h)[1])[0] / (2 * h)
    H = np.zeros((3, 3))
    for k, (i, j) in enumerate(PACKED):
        H[i, j] = H[j, i] = cubes[4 + k]
    assert H.sum(axis=1) == pytest.approx(shift, rel=1e-6) and cubes[0] == pytest.approx(
        0.5 * H.sum(), rel=1e-12
    )


def test_flat_ground_at_the_level():
    sigma, tin = 0.03, ground(lambda x, y: 0 * x)
    rng, rows = np.random.default_rng(1), []
    for _ in range(40):
        noisy = dataclasses.replace(
            tin, vertices=tin.vertices + np.c_[np.zeros((400, 2)), sigma * rng.normal(size=400)]
        )
        p, c = prismoids(noisy, LEVEL), near_base(noisy, LEVEL, np.full(400, sigma**2))
        rows.append(
            [
                p.cut_m3,
                p.cut_m3 - c.correction_m3,
                p.fill_m3 - c.correction_m3,
                p.net_m3,
                c.variance_cut_m6,
                c.variance_net_m6,
            ]
        )
        assert c.near.mean() > 0.99 and c.near_area_m2 <= p.area_m2 * (1 + 1e-12)
    r = np.array(rows)
    raw, cut, fill, net = r[:, :4].mean(axis=0)
    assert raw == pytest.approx(0.28 * sigma * p.area_m2, rel=0.05)
    # both true volumes are zero: a sixth of the bias at most is left, by the noise of the estimated
    # heights
    assert (
        abs(cut) < 0.17 * raw
        and abs(fill) < 0.17 * raw
        and cut - fill == pytest.approx(net, abs=1e-12)
    )
    spread = 4 / math.sqrt(2 * 40)
    assert r[:, 3].std() == pytest.approx(math.sqrt(r[:, 5].mean()), rel=spread)
    assert r[:, 1].std() == pytest.approx(math.sqrt(r[:, 4].mean()), rel=spread)


def test_ground_above_the_level_and_a_slope_through_it():
    sigma = 0.03
    for truth in (lambda x, y: 0 * x + 0.02, lambda x, y: 0.02 * (x - 5)):
        tin = ground(truth, seed=2)
        true, rng, rows = prismoids(tin, LEVEL).cut_m3, np.random.default_rng(3), []
        for _ in range(40):
            noisy = dataclasses.replace(
                tin, vertices=tin.vertices + np.c_[np.zeros((400, 2)), sigma * rng.normal(size=400)]
            )
            p, c = prismoids(noisy, LEVEL), near_base(noisy, LEVEL, np.full(400, sigma**2))
            rows.append([p.cut_m3, p.cut_m3 - c.correction_m3, c.variance_cut_m6])
        r = np.array(rows)
        assert abs(r[:, 1].mean() - true) < 0.25 * abs(r[:, 0].mean() - true)
        assert r[:, 1].std() == pytest.approx(math.sqrt(r[:, 2].mean()), rel=4 / math.sqrt(2 * 40))


def test_surfaces_away_from_the_base_are_left_alone():
    tin = ground(lambda x, y: 1.0 + 0.1 * np.sin(x))
    c, p = near_base(tin, LEVEL, np.full(400, 0.03**2)), prismoids(tin, LEVEL)
    assert c.correction_m3 == 0.0 and not c.near.any() and c.near_area_m2 == 0.0
    assert c.gradient_cut == pytest.approx(p.gradient_cut[:, 2], abs=1e-12)
    assert c.variance_cut_m6 == pytest.approx(
        0.03**2 * (p.gradient_cut[:, 2] ** 2).sum(), rel=1e-12
    )
    assert c.variance_cut_m6 == pytest.approx(
        c.variance_net_m6, rel=1e-12
    ) and c.variance_fill_m6 == pytest.approx(0.0, abs=1e-18)
    still = near_base(ground(lambda x, y: 0 * x), LEVEL, np.zeros(400))
    assert still.correction_m3 == 0.0 and still.variance_cut_m6 == 0.0


def test_scale_and_sparse_covariances():
    tin, rng = ground(lambda x, y: 0.01 * np.sin(x), seed=4), np.random.default_rng(5)
    variance = rng.uniform(0.01, 0.05, 400) ** 2
    a, b = (
        near_base(tin, LEVEL, variance),
        near_base(tin, LEVEL, sparse.diags_array(variance).tocsr()),
    )
    near, diagonal = tin.triangles[a.near], sparse.diags_array(variance)
    alone = fold(
        tin, tin.vertices[:, 2], variance, near, node_covariances(diagonal, near), 4, variance
    )
    assert (alone.correction_m3, alone.near_area_m2) == (
        pytest.approx(a.correction_m3, rel=1e-12),
        a.near_area_m2,
    )
    assert a.correction_m3 == b.correction_m3 and a.variance_cut_m6 == pytest.approx(
        b.variance_cut_m6, rel=1e-12
    )
    big = near_base(dataclasses.replace(tin, vertices=3 * tin.vertices), LEVEL, 9 * variance)
    assert big.correction_m3 == pytest.approx(27 * a.correction_m3, rel=1e-9)
    turned = dataclasses.replace(tin, vertices=tin.vertices * [-1, -1, 1] + np.array([1e4, 2e4, 0]))
    assert near_base(turned, LEVEL, variance).correction_m3 == pytest.approx(
        a.correction_m3, rel=1e-6
    )
    part = rng.random(len(tin.triangles)) < 0.5
    halves = [near_base(tin, LEVEL, variance, m).near_area_m2 for m in (part, ~part)]
    assert sum(halves) == pytest.approx(a.near_area_m2, rel=1e-12)


def test_all_levels_at_once_are_the_levels_one_by_one():
    tin, rng = ground(lambda x, y: 0.03 * x, seed=9), np.random.default_rng(10)
    tin = dataclasses.replace(
        tin, vertices=tin.vertices + np.c_[np.zeros((400, 2)), 0.03 * rng.normal(size=400)]
    )
    C, levels = (
        sparse.diags_array(rng.uniform(0.5, 2, 400) * 0.03**2).tocsr(),
        np.array([0.2, -5.0, 0.1, 0.1, 0.35, 9.0]),
    )
    slope = Plane(np.zeros(2), np.array([0.0, 0.01, 0.0]), np.zeros((3, 3)), np.zeros(0, np.int64))
    mask = rng.random(len(tin.triangles)) < 0.7
    for base, chosen in ((None, None), (slope, mask)):
        one_by_one = []
        for z in levels:
            beta = np.array([z, 0.0, 0.0]) if base is None else base.beta + np.array([z, 0.0, 0.0])
            one_by_one.append(
                near_base(tin, dataclasses.replace(slope, beta=beta), C, chosen).correction_m3
            )
        found = near_levels(tin, levels, C, base, chosen)
        assert (
            found == pytest.approx(one_by_one, rel=1e-9)
            and found[1] == found[5] == 0.0
            and (found[[0, 2, 3, 4]] > 0).all()
        )
    assert (near_levels(tin, levels, 0.0 * C) == 0.0).all()


def test_curvature_term_is_the_trace():
    tin, rng = ground(lambda x, y: 0 * x, 12, seed=6), np.random.default_rng(7)
    A = rng.normal(size=(12, 12))
    C, curvature = A @ A.T, rng.random((len(tin.triangles), 6))
    H = np.zeros((12, 12))
    for t, row in zip(tin.triangles, curvature, strict=True):
        for (i, j), v in zip(PACKED, row, strict=True):
            H[t[i], t[j]] += v
            H[t[j], t[i]] += v * (i != j)
    start, link = edges(tin.triangles, tin.neighbours, 12)
    assert second_order(
        curvature, tin.triangles, start, link, sparse.csr_array(C)
    ) == pytest.approx(0.5 * np.trace(H @ C @ H @ C), rel=1e-12)
    alone = sparse.csr_array(np.diag(np.diag(C)))
    found = second_order(curvature, tin.triangles, start, link, alone)
    assert found == pytest.approx(
        0.5 * np.trace(H @ alone.toarray() @ H @ alone.toarray()), rel=1e-12
    )
    args = (
        start,
        link,
        *edge_sums(curvature, tin.triangles, start, link),
        *csr(sparse.csr_array(C)),
    )
    assert trace_kernel.py_func(*args) == pytest.approx(trace_kernel(*args), rel=1e-12)
    assert all(
        np.array_equal(*pair)
        for pair in zip(
            edge_sums.py_func(curvature, tin.triangles, start, link), args[2:4], strict=True
        )
    )
    assert np.array_equal(
        packed_kernel.py_func(*args[4:], tin.triangles),
        node_covariances(sparse.csr_array(C), tin.triangles),
    )
    assert node_covariances(sparse.csr_array(C), tin.triangles[:1])[0] == pytest.approx(
        [C[tin.triangles[0, i], tin.triangles[0, j]] for i, j in PACKED]
    )


def test_planes_are_kept_and_steps_are_not_crossed():
    tin = ground(lambda x, y: 0.001 * x, seed=8)
    h, variance = tin.vertices[:, 2], np.full(400, 0.02**2)
    S = smoother(tin, h, variance, np.ones(400, bool), 4)
    assert S @ h == pytest.approx(h, abs=1e-12) and S @ np.ones(400) == pytest.approx(
        np.ones(400), rel=1e-9
    )
    step = np.where(tin.vertices[:, 0] > 5, 1.0, 0.0)
    assert smoother(tin, step, variance, np.ones(400, bool), 4) @ step == pytest.approx(
        step, abs=1e-9
    )
    none = smoother(tin, h, variance, np.zeros(400, bool), 4)
    assert (none - sparse.eye_array(400)).nnz == 0


@pytest.mark.parametrize("variance", [np.ones(3), np.full(400, -1.0), np.full(400, np.nan)])
def test_refusals(variance):
    tin = ground(lambda x, y: 0 * x)
    with pytest.raises(VolumeError) as caught:
        near_base(tin, LEVEL, variance)
    assert caught.value.reason == "volume_variance"
    with pytest.raises(VolumeError) as caught:
        near_base(tin, LEVEL, np.ones(400), np.zeros(len(tin.triangles), bool))
    assert caught.value.reason == "volume_no_triangle"


def test_compiled_kernels_equal_their_plain_twins():
    rng = np.random.default_rng(9)
    mu, C = rng.normal(0, 0.05, (8, 3)), np.repeat(packed(np.eye(3) * 0.03**2), 8, axis=0)
    mu[0], mu[1] = [9, -9, 1], [5, 5, 5]
    plain = np.c_[positive_part(mu)[0], positive_part(mu)[1]]
    for slopes, columns in ((True, 10), (False, 1)):
        found, twin = (
            folded_kernel(mu, C, plain, slopes, NODES),
            folded_kernel.py_func(mu, C, plain, True, NODES),
        )
        assert found[:, :columns] == pytest.approx(twin[:, :columns], rel=1e-13, abs=1e-16)
    assert all(
        least_deviation(c) == least_deviation.py_func(c) == pytest.approx(0.03 / math.sqrt(3))
        for c in C
    )
    rooms = [
        np.vstack([np.full((1, 63), 0.2), np.full((1, 63), 0.3), np.full((4, 63), 0.5)])
        for _ in range(2)
    ]
    for room, run in zip(rooms, (means_at, means_at.py_func), strict=True):
        run(mu[2], C[2], 63, room)
    assert rooms[0] == pytest.approx(rooms[1], rel=1e-13) and len(set(rooms[0][3:, 0])) == 3
    quadrature = (mu[3], C[3], 0.03, 3, True, NODES, rooms[0])
    means = ((add_means, (63, rooms[1])), (add_mean, (63, rooms[1])))
    for run, args in (
        (by_quadrature, quadrature),
        *means,
        (add_far, (mu[1], 0.2, 0.3, 0.5)),
        (by_line, (mu[0], C[0])),
    ):
        a, b = np.zeros(10), np.zeros(10)
        run(*args, a)
        run.py_func(*args, b)
        assert a == pytest.approx(b, rel=1e-13) and a.any()


def test_the_tabulated_normal_distribution():
    for t in (*np.linspace(-8.1, 8.1, 3001), -1e150, 1e150, 0.0):
        density, below = normal(t)
        assert density == pytest.approx(
            math.exp(-0.5 * t * t) / math.sqrt(2 * math.pi) if abs(t) < 1e3 else 0.0, abs=1e-13
        )
        assert below == pytest.approx(0.5 * math.erfc(-t / math.sqrt(2)), abs=1e-13) and (
            density,
            below,
        ) == pytest.approx(normal.py_func(t), abs=1e-15)
    assert [normal(t) for t in (-9.0, 8.0, np.inf, np.nan)] == [
        (0.0, 0.0),
        (0.0, 1.0),
        (0.0, 1.0),
        (0.0, 0.0),
    ]


@pytest.mark.parametrize(
    "truth", [lambda x, y: 0 * x, lambda x, y: np.where(x > 5, 1.0, 0.0), lambda x, y: 0.2 * x * y]
)
def test_compiled_neighbourhoods_equal_their_plain_twins(truth):
    tin = ground(truth)
    rng = np.random.default_rng(3)
    variance = rng.uniform(0.5, 2.0, 400) * 0.03**2
    h = tin.vertices[:, 2] + np.sqrt(variance) * rng.normal(size=400)
    wanted, g = rng.random(400) < 0.7, rng.normal(size=400)
    for rings in (0, 1, 4):
        S = smoother(tin, h, variance, wanted, rings)
        smooth = Smooth(tin, h, variance, wanted, rings)
        assert smooth.heights == pytest.approx(
            S @ h, abs=1e-9
        ) and smooth.variance == pytest.approx((S * S) @ variance, rel=1e-7)
        assert smooth.adjoint(g) == pytest.approx(S.T @ g, abs=1e-8)
        if rings > 0:
            rows, links = smooth._rows[:20], (smooth.start, smooth.link, smooth._xy)
            plain = smooth_kernel.py_func(*links, h, variance, variance, rows, rings)
            compiled = smooth_kernel(*links, h, variance, variance, rows, rings)
            assert all(
                a == pytest.approx(b, rel=1e-10, abs=1e-15)
                for a, b in zip(plain, compiled, strict=True)
            )
            args = (*links, rows, *compiled[:2], g[rows])
            assert adjoint_kernel.py_func(*args) == pytest.approx(
                adjoint_kernel(*args), rel=1e-10, abs=1e-15
            )
    # heights that share noise: what a plane has of it is the sum of its covariances
    summed = Smooth(tin, h, variance, wanted, 4, 2.0 * variance)
    grown = summed._ring[np.argsort(summed._rows)] > 0
    assert summed.variance[wanted][grown] == pytest.approx(
        2.0 * smooth.variance[wanted][grown], rel=1e-12
    )
    line = dataclasses.replace(tin, vertices=np.c_[tin.vertices[:, 0], 0 * h, h])
    assert np.isfinite(Smooth(line, h, variance, wanted, 4).heights).all()
