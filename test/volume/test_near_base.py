"""The folded-normal correction: closed forms of one triangle, Monte Carlo on flat ground, and what
it must leave alone.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from plain_integrals import smoother
from scipy import sparse, special

from ladar_volume.ground.polynomial import design_surface
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import Plane
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.tin.median_screen import edges
from ladar_volume.volume.folded_normal import (
    NODES,
    PACKED,
    add_far_mean,
    add_mean,
    add_means,
    by_line,
    by_quadrature,
    folded_kernel,
    folded_means,
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
from ladar_volume.volume.neighbourhood import Smooth
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
    out = folded_means(np.zeros((1, 3)), packed(np.full((3, 3), s * s)))[0]
    assert out[0] == pytest.approx(PHI0 * s, rel=1e-12) and out[1:4] == pytest.approx(
        np.full(3, 1 / 6), rel=1e-12
    )
    assert out[4:] == pytest.approx(
        [PHI0 / s * (1 / 6 if i == j else 1 / 12) for i, j in PACKED], rel=1e-12
    )
    # independent nodes: the interpolated height has half the variance on average
    assert folded_means(np.zeros((1, 3)), packed(np.eye(3) * s * s))[0, 0] == pytest.approx(
        0.28 * s, rel=0.02
    )


@pytest.mark.parametrize("seed", range(6))
def test_means_slopes_and_curvatures_against_a_fine_rule(seed):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(3, 3)) * 0.05
    C, mu = A @ A.T + 0.02**2 * np.eye(3), rng.normal(0, (0.02, 0.1, 0.5)[seed % 3], 3)
    expected = fine(mu, C)
    found = folded_means(mu[None], packed(C))[0]
    assert found[0] == pytest.approx(expected[0], abs=2e-5) and found[1:4] == pytest.approx(
        expected[1:4], abs=2e-4
    )
    assert found[4:] == pytest.approx(expected[4:], abs=2e-3 * expected[4:].max() + 1e-9)


def test_far_triangles_and_no_noise():
    mu = np.array([[1.0, 2, 3], [-1, -2, -3], [0.5, 0.4, -9]])
    C = np.repeat(packed(np.eye(3) * 0.01**2), 3, axis=0)
    mean, slope = positive_part(mu)
    out = folded_means(mu, C)
    assert (
        np.array_equal(out[:2, 0], mean[:2])
        and np.array_equal(out[:2, 1:4], slope[:2])
        and not out[:2, 4:].any()
    )
    still = folded_means(np.array([[0.0, 0, 0], [1, -1, 0.5]]), np.zeros((2, 6)))
    assert still[:, 0] == pytest.approx(
        positive_part(np.array([[0.0, 0, 0], [1, -1, 0.5]]))[0], abs=1e-15
    )


def test_tall_triangles_meet_the_rule_for_lines():
    mu = np.array([[1.0, -0.7, -0.2]])
    for s in (0.01, 0.001):
        C = packed(np.diag([1.0, 2.0, 0.5]) * s * s)
        # half the variance times the density of heights at the level
        bias = folded_means(mu, C)[0, 0] - positive_part(mu)[0][0]
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
        near_base(tin, LEVEL, sparse.csr_array(sparse.diags(variance))),
    )
    near, diagonal = tin.triangles[a.near], sparse.csr_array(sparse.diags(variance))
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
        sparse.csr_array(sparse.diags(rng.uniform(0.5, 2, 400) * 0.03**2)),
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
    edge, own = edge_sums(curvature, tin.triangles, start, link)
    row = np.repeat(np.arange(12), np.diff(start))
    assert edge == pytest.approx(H[row, link]) and own == pytest.approx(np.diag(H))
    parts = trace_kernel(start, link, edge, own, *csr(sparse.csr_array(C)))
    assert parts.sum() == pytest.approx(np.trace(H @ C @ H @ C), rel=1e-12)
    i, j = tin.triangles[:, PACKED[:, 0]], tin.triangles[:, PACKED[:, 1]]
    assert packed_kernel(*csr(sparse.csr_array(C)), tin.triangles) == pytest.approx(C[i, j])
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
    assert (none - sparse.csr_array(np.eye(400))).nnz == 0


@pytest.mark.parametrize("variance", [np.ones(3), np.full(400, -1.0), np.full(400, np.nan)])
def test_refusals(variance):
    tin = ground(lambda x, y: 0 * x)
    with pytest.raises(VolumeError) as caught:
        near_base(tin, LEVEL, variance)
    assert caught.value.reason == "volume_variance"
    with pytest.raises(VolumeError) as caught:
        near_base(tin, LEVEL, np.ones(400), np.zeros(len(tin.triangles), bool))
    assert caught.value.reason == "volume_no_triangle"


def expected_at(mu, C, p, q, weight):
    """Row 0: mean; rows 1 to 3: slopes; rows 4 to 9: curvatures, (10,), summed over places."""
    w = np.stack([1 - p - q, p, q])
    m, s = mu @ w, np.sqrt(np.einsum("ik,ij,jk->k", w, C, w))
    share, density = special.ndtr(m / s), PHI0 * np.exp(-0.5 * (m / s) ** 2)
    curve = np.einsum("ik,jk,k->ij", w, w, weight * density / s)
    return np.r_[
        weight @ (m * share + s * density), w @ (weight * share), [curve[i, j] for i, j in PACKED]
    ]


def test_means_at_places_and_their_sums():
    rng = np.random.default_rng(9)
    A = 0.03 * rng.normal(size=(3, 3))
    C, mu = A @ A.T + 1e-4 * np.eye(3), rng.normal(0, 0.05, 3)
    p, q = rng.dirichlet(np.ones(3), 63).T[1:]
    weight = rng.uniform(0.5, 2.0, 63)
    work, out, alone = np.zeros((6, 70)), np.zeros(10), np.zeros(10)
    work[0, :63], work[1, :63], work[2, :63] = p, q, weight
    means_at(mu, packed(C)[0], 63, work)
    add_means(63, work, out)
    add_mean(63, work, alone)
    expected = expected_at(mu, C, p, q, weight)
    assert out == pytest.approx(expected, rel=1e-11)
    assert alone == pytest.approx(np.r_[expected[0], np.zeros(9)], rel=1e-11)


def test_far_places_count_as_they_are():
    mu = np.array([0.9, 0.4, -0.2])
    for p, q, above in ((0.2, 0.3, 1.0), (0.05, 0.9, 0.0)):
        out, w = np.zeros(10), np.array([1 - p - q, p, q])
        add_far_mean(mu, p, q, 0.5, out)
        assert out == pytest.approx(0.5 * above * np.r_[mu @ w, w, np.zeros(6)], rel=1e-14)


@pytest.mark.parametrize("parts", [1, 2, 5])
def test_parts_of_a_triangle_together_are_the_triangle(parts):
    """The rule is exact for what varies little over a part; the places of all parts are those of a
    triangle's tiling.
    """
    rng = np.random.default_rng(parts)
    A = 0.01 * rng.normal(size=(3, 3))
    C, mu = A @ A.T + 0.05**2 * np.eye(3), rng.normal(0, 0.02, 3)
    work, out = np.zeros((6, 7 * parts**2)), np.zeros(10)
    by_quadrature(mu, packed(C)[0], 0.05, parts, True, NODES, work, out)
    corners = [np.array([[0, 0], [1, 0], [0, 1.0]]), np.array([[1, 1], [0, 1], [1, 0.0]])]
    places = [
        ((1 - NODES[:, :1] - NODES[:, 1:2]) * c[0] + NODES[:, :1] * c[1] + NODES[:, 1:2] * c[2])
        + (i, j)
        for i in range(parts)
        for j in range(parts - i)
        for c in corners[: 2 if i + j < parts - 1 else 1]
    ]
    p, q = np.concatenate(places).T / parts
    weight = np.tile(NODES[:, 2], len(places)) / parts**2
    assert out == pytest.approx(expected_at(mu, C, p, q, weight), rel=1e-10)
    assert out[0] == pytest.approx(fine(mu, C)[0], rel=1e-3)


def test_a_steep_triangle_feels_the_noise_along_its_zero_line():
    """Against a fine rule where the height runs over 160 standard deviations."""
    rng = np.random.default_rng(4)
    for mu in ([0.9, -0.9, 0.1], [-0.7, 0.4, 0.9], [0.5, 0.8, -0.3]):
        A = 0.005 * rng.normal(size=(3, 3))
        C, mu = A @ A.T + 0.01**2 * np.eye(3), np.array(mu)
        found = np.zeros(10)
        by_line(mu, packed(C)[0], found)
        plain, expected = positive_part(mu[None]), fine(mu, C, 1200)
        assert found[0] == pytest.approx(expected[0] - plain[0][0], rel=0.01)
        assert found[4:] == pytest.approx(expected[4:], rel=0.02, abs=0.01 * expected[4:].max())
        assert (found[1:4] == 0.0).all()


def test_the_least_deviation_is_at_a_corner_a_midpoint_or_the_centre():
    rng, which = np.random.default_rng(2), set()
    places = np.array(
        [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [0, 1, 1], [1, 0, 1], [1, 1, 1]], float
    )
    places /= places.sum(axis=1, keepdims=True)
    for _ in range(100):
        A = 0.03 * rng.normal(size=(3, 3))
        deviation = np.sqrt(np.einsum("ki,ij,kj->k", places, A @ A.T, places))
        which.add(int(deviation.argmin()))
        assert least_deviation(packed(A @ A.T)[0]) == pytest.approx(deviation.min(), abs=1e-9)
    assert which == set(range(7))


def test_means_without_slopes_are_the_same_means():
    rng = np.random.default_rng(9)
    mu, C = rng.normal(0, 0.05, (8, 3)), np.repeat(packed(np.eye(3) * 0.03**2), 8, axis=0)
    mu[0], mu[1], mu[2] = [9, -9, 1], [5, 5, 5], [-5, -5, -4]
    plain = np.c_[positive_part(mu)[0], positive_part(mu)[1]]
    both, alone = (folded_kernel(mu, C, plain, slopes, NODES) for slopes in (True, False))
    assert alone[:, 0] == pytest.approx(both[:, 0], rel=1e-13)
    # tall, and all above the base, of which one corner is within reach: no zero line crosses it
    tall, noise = np.array([0.02, 1.5, 2.0]), np.eye(3) * 0.01**2
    found, expected = folded_means(tall[None], packed(noise))[0], fine(tall, noise, 1500)
    assert found[:4] == pytest.approx(expected[:4], rel=1e-6) and (found[4:] < 0.01).all()
    assert both[1:3, 0] == pytest.approx([5.0, 0.0]) and both[1:3, 1:4] == pytest.approx(
        np.outer([1, 0], np.full(3, 1 / 3))
    )
    for t in range(3, 8):
        assert both[t, 0] == pytest.approx(fine(mu[t], np.eye(3) * 0.03**2)[0], rel=1e-3)


def test_the_tabulated_normal_distribution():
    for t in (*np.linspace(-8.1, 8.1, 3001), -1e150, 1e150, 0.0):
        density, below = normal(t)
        assert density == pytest.approx(
            math.exp(-0.5 * t * t) / math.sqrt(2 * math.pi) if abs(t) < 1e3 else 0.0, abs=1e-13
        )
        assert below == pytest.approx(0.5 * math.erfc(-t / math.sqrt(2)), abs=1e-13)
    assert [normal(t) for t in (-9.0, 8.0, np.inf, np.nan)] == [
        (0.0, 0.0),
        (0.0, 1.0),
        (0.0, 1.0),
        (0.0, 0.0),
    ]


@pytest.mark.parametrize("rings", [1, 2, 4])
def test_level_ground_is_smoothed_by_as_many_rings_as_asked_for(rings):
    rng = np.random.default_rng(9)
    tin = build_tin(np.c_[rng.uniform(0, 10, (300, 2)), np.zeros(300)])
    wanted = rng.random(300) < 0.6
    h = np.full(300, 0.4)
    found = Smooth(tin, h, np.full(300, 0.01), wanted, rings)
    assert np.array_equal(found.rings(), np.where(wanted, rings, 0))
    assert found.heights == pytest.approx(h)
    spread = found.variance[wanted]
    assert spread.max() < 0.01 and (found.variance[~wanted] == 0.01).all()


@pytest.mark.parametrize(
    "truth", [lambda x, y: 0 * x, lambda x, y: np.where(x > 5, 1.0, 0.0), lambda x, y: 0.2 * x * y]
)
def test_neighbourhoods_are_those_of_sparse_matrices(truth):
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
    # heights that share noise: what a plane has of it is the sum of its covariances
    sums = rng.uniform(1.0, 3.0, 400) * variance
    summed = Smooth(tin, h, variance, wanted, 4, sums)
    grown = summed.rings() > 0
    assert summed.variance == pytest.approx(np.where(grown, (S * S) @ sums, variance), rel=1e-7)
    line = dataclasses.replace(tin, vertices=np.c_[tin.vertices[:, 0], 0 * h, h])
    assert np.isfinite(Smooth(line, h, variance, wanted, 4).heights).all()


@pytest.mark.parametrize("scale", [2.0**-12, 2.0**12])
def test_folded_means_know_no_unit(scale):
    rng = np.random.default_rng(13)
    m = 3000
    A = rng.normal(size=(m, 3, 3)) * rng.uniform(0.3, 1.0, (m, 1, 1))
    C = np.array([[a[i, j] for i, j in PACKED] for a in A @ A.transpose(0, 2, 1)])
    mu = rng.normal(0.0, 1.0, (m, 1)) + rng.normal(size=(m, 3)) * 10.0 ** rng.uniform(-2, 1, (m, 1))
    one, two = folded_means(mu, C), folded_means(scale * mu, scale**2 * C)
    powers = np.r_[1.0, np.zeros(3), -np.ones(6)]
    np.testing.assert_allclose(two / scale**powers, one, rtol=1e-12, atol=1e-12)
