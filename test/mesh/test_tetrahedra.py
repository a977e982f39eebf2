"""Signed tetrahedra: closed forms, poles, orientation, cavities, gradient, Monte Carlo of the
variance, and meshes that are refused.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from closed_meshes import CUBE_T, CUBE_V, grid_mesh, moebius, sphere, torus

from ladar_volume.math.se3 import exp_so3
from ladar_volume.mesh.tetrahedra import (
    ClosedVolume,
    closed_variance,
    closed_volume,
    signed_tetrahedra,
    tetrahedra_gradient,
    winding_kernel,
)
from ladar_volume.mesh.topology import (
    OrientedMesh,
    counting_sort,
    edge_table,
    orient,
    spread_kernel,
    watertight,
)
from ladar_volume.mesh.welding import weld
from ladar_volume.model.errors import SurfaceError, VolumeError


def test_a_mesh_without_boundary_is_watertight_whichever_way_its_triangles_run():
    assert watertight(CUBE_T) and not watertight(CUBE_T[:-1]) and not watertight(CUBE_T[:0])
    assert watertight(np.concatenate([CUBE_T, CUBE_T[:, [0, 2, 1]]])) and not watertight(
        CUBE_T[:, [0, 2, 1]][:5]
    )


def test_the_cube_about_any_pole():
    for pole in (None, np.zeros(3), np.array([-4.0, 7, 100])):
        b = closed_volume(CUBE_V, CUBE_T, pole)
        assert b.volume_m3 == pytest.approx(1.0, rel=1e-12) and b.area_m2 == pytest.approx(6.0)
        assert b.pole_spread_m3 < 1e-12 and not b.flipped.any() and b.mesh.euler == 2


def test_pole_independence_at_map_coordinates():
    v, t = torus()
    b, far = closed_volume(v, t), closed_volume(v + np.array([5e5, 5.6e6, 300]), t)
    assert (
        far.volume_m3 == pytest.approx(b.volume_m3, rel=1e-7)
        and far.pole_spread_m3 < 1e-9 * far.volume_m3
    )
    assert far.gradient == pytest.approx(b.gradient, abs=1e-7)


def test_torus_and_sphere_against_their_formulas():
    v, t = torus(240, 160)
    b = closed_volume(v, t)
    assert b.mesh.euler == 0 and b.volume_m3 == pytest.approx(2 * np.pi**2 * 2.0 * 0.6**2, rel=6e-4)
    share = []
    for rng in (None, *(np.random.default_rng(k) for k in range(5))):
        v, t = sphere(2200, rng=rng)
        b = closed_volume(v, t)
        assert b.mesh.euler == 2 and 3 * len(t) == 2 * b.mesh.edges
        share.append(b.volume_m3 / (4 / 3 * np.pi) - 1)
    # what the chords of a mesh through 2,200 exact points cost alone: less where they are evenly
    # spread
    assert share[0] == pytest.approx(-0.0026, abs=0.0001) and np.mean(share[1:]) == pytest.approx(
        -0.0055, abs=0.0003
    )


def test_scaling_turning_and_joining():
    v, t = torus()
    base = closed_volume(v, t).volume_m3
    R = exp_so3(np.array([1.0, 2, 3]))
    assert closed_volume(3 * v @ R.T + 7, t).volume_m3 == pytest.approx(27 * base, rel=1e-12)
    assert closed_volume(v * [1, 1, -1], t).volume_m3 == pytest.approx(
        base, rel=1e-12
    )  # mirrored: turned outward again
    two = closed_volume(np.concatenate([v, v + 10]), np.concatenate([t, t + len(v)]))
    assert two.volumes_m3 == pytest.approx([base, base]) and two.mesh.euler == 0


@pytest.mark.parametrize("seed", range(3))
def test_inconsistent_orientation_is_propagated_and_flagged(seed):
    v, t = torus()
    rng = np.random.default_rng(seed)
    turn = rng.random(len(t)) < 0.4
    bad = t.copy()
    bad[turn] = t[turn][:, ::-1]
    right, found = closed_volume(v, t), closed_volume(v, bad)
    assert found.volume_m3 == pytest.approx(right.volume_m3, rel=1e-12)
    assert (found.flipped == (turn ^ right.flipped)).all()
    assert closed_volume(v, t[rng.permutation(len(t))]).volume_m3 == pytest.approx(
        right.volume_m3, rel=1e-12
    )


def test_cavities_count_negative_whatever_their_orientation_and_islands_within_positive():
    parts = [(1.0, 1), (0.6, -1), (0.2, 1)]
    for signs in ((1, 1, 1), (1, -1, 1), (-1, -1, -1)):
        v = np.concatenate([(CUBE_V - 0.5) * s for s, _ in parts])
        t = np.concatenate(
            [(CUBE_T if o > 0 else CUBE_T[:, ::-1]) + 8 * k for k, o in enumerate(signs)]
        )
        b = closed_volume(v, t)
        assert b.volumes_m3 == pytest.approx([1.0, -0.216, 0.008]) and b.volume_m3 == pytest.approx(
            0.792
        )


def test_bodies_that_touch_are_two_bodies():
    v = np.concatenate([CUBE_V, 0.5 * CUBE_V + [1, 0, 0]])
    assert closed_volume(v, np.concatenate([CUBE_T, CUBE_T + 8])).volumes_m3 == pytest.approx(
        [1.0, 0.125]
    )


def test_gradient_against_differences_and_its_sums():
    v, t = torus(12, 8)
    b = closed_volume(v, t)
    for i, k in ((0, 0), (17, 1), (50, 2)):
        step = np.zeros_like(v)
        step[i, k] = 1e-5
        assert (
            closed_volume(v + step, t).volume_m3 - closed_volume(v - step, t).volume_m3
        ) / 2e-5 == pytest.approx(b.gradient[i, k], rel=1e-7)
    assert b.gradient.sum(axis=0) == pytest.approx(0, abs=1e-12)  # a shift changes nothing
    assert np.cross(v, b.gradient).sum(axis=0) == pytest.approx(0, abs=1e-12)  # nor does a turn
    assert (v * b.gradient).sum() == pytest.approx(3 * b.volume_m3)  # a scale thrice


@pytest.mark.parametrize("sigma", [0.01, 0.15])
def test_variance_by_monte_carlo_and_no_bias(sigma):
    v, t = torus(12, 8)
    b = closed_volume(v, t)
    rng = np.random.default_rng(1)
    C = rng.standard_normal((len(v), 3, 3)) * sigma / 1.7
    C = C @ np.swapaxes(C, 1, 2)
    L = np.linalg.cholesky(C + 1e-12 * np.eye(3))
    draws = [
        signed_tetrahedra(
            v + np.einsum("nij,nj->ni", L, rng.standard_normal(v.shape)),
            b.mesh.triangles,
            np.zeros(3),
        ).sum()
        for _ in range(3000)
    ]
    predicted = closed_variance(v, b, C)
    assert np.std(draws) / predicted.sigma_m3 == pytest.approx(1.0, abs=0.04)
    assert abs(np.mean(draws) - b.volume_m3) < 4 * predicted.sigma_m3 / np.sqrt(3000)
    if sigma > 0.1:  # there the first order alone is too small
        assert predicted.second_m6 > 0.05 * predicted.first_m6
    assert closed_variance(v, b, sigma).sigma_m3 == pytest.approx(
        closed_variance(v, b, np.full(len(v), sigma)).sigma_m3
    )


@pytest.mark.parametrize("given", [CUBE_T[:-1], CUBE_T[:3], np.r_[CUBE_T, [[0, 6, 1]]]])
def test_second_order_of_meshes_that_are_no_manifold(given):
    """Open edges and such of three triangles, as published meshes have them: the volume is linear
    in each vertex, so that its mixed differences of any step are its second derivatives.
    """
    t, pole = np.asarray(given, np.int32), np.array([0.3, -0.2, 0.4])
    n = len(t)
    used = OrientedMesh(t, np.zeros(n, bool), np.zeros(n, np.int32), 0, 0, 0)
    body = ClosedVolume(
        0.0, np.zeros(1), np.zeros_like(CUBE_V), 0.0, pole, 0.0, used, np.zeros(n, bool)
    )
    sigma, total = np.linspace(0.1, 0.8, len(CUBE_V)), 0.0
    for i in range(3 * len(CUBE_V)):
        for j in range(3 * (i // 3)):
            mixed = 0.0
            for a in (0, 1):
                for b in (0, 1):
                    v = CUBE_V.astype(float).copy()
                    v.flat[i] += a
                    v.flat[j] += b
                    mixed += (-1.0) ** (a + b) * signed_tetrahedra(v, t, pole).sum()
            total += mixed**2 * sigma[i // 3] ** 2 * sigma[j // 3] ** 2
    assert closed_variance(CUBE_V, body, sigma).second_m6 == pytest.approx(total, rel=1e-12)


def test_even_noise_on_a_sphere_has_its_closed_form():
    """n points share the area S evenly: sigma_V = sigma S sqrt(sum of squared shares), about sigma
    S / sqrt(n).
    """
    v, t = sphere(2200)
    b = closed_volume(v, t)
    first = closed_variance(v, b, 0.01).first_m6
    assert np.sqrt(first) == pytest.approx(0.01 * 4 * np.pi / np.sqrt(2200), rel=0.03)


def test_windings_and_orientations():
    v, t = torus(8, 6)
    points = np.array([[2.0, 0, 0.1], [0, 0, 0], [9, 9, 9]])
    out = winding_kernel(v, t.astype(np.int32), points, np.array([-1, 3, -1]))
    # solid angle by the angles between the planes through the point (Girard), signed
    for k, leave in enumerate((-1, 3, -1)):
        total = 0.0
        for i in np.flatnonzero(np.arange(len(t)) != leave):
            r = v[t[i]] - points[k]
            n = np.cross(r, np.roll(r, -1, axis=0))
            n /= np.linalg.norm(n, axis=1, keepdims=True)
            between = np.pi - np.arccos(np.clip((n * np.roll(n, 1, axis=0)).sum(axis=1), -1, 1))
            total += np.sign(np.linalg.det(r)) * (between.sum() - np.pi)
        assert out[k] == pytest.approx(total / (4.0 * np.pi), abs=1e-7)
    out = winding_kernel(v, t.astype(np.int32), points, np.full(3, -1))
    assert np.abs(out) == pytest.approx([1, 0, 0], abs=1e-9)
    neighbour = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]], np.int32)
    rng, found = np.random.default_rng(2), []
    for _ in range(40):
        same = rng.random((4, 4)) < 0.7
        agrees = np.take_along_axis(np.tril(same) | np.tril(same, -1).T, neighbour, axis=1)
        part, turned = np.full(4, -1, np.int32), np.zeros(4, bool)
        found.append(spread_kernel(neighbour, agrees, part, turned))
        ways = [  # of all ways to turn three of them, those with which all edges agree
            x
            for x in itertools.product([False], *3 * [(False, True)])
            if all(x[o] == (x[t] == agrees[t, k]) for (t, k), o in np.ndenumerate(neighbour))
        ]
        assert (found[-1] < 0) == (len(ways) == 1)
        if ways:
            assert tuple(turned.tolist()) == ways[0] and (part == 0).all()
    assert 3 < sum(at < 0 for at in found) < 37
    apart = np.concatenate([neighbour + 4 * k for k in range(3)])  # three bodies that share nothing
    part, turned = np.full(12, -1, np.int32), np.zeros(12, bool)
    assert spread_kernel(apart, np.ones((12, 3), bool), part, turned) == -1
    assert np.array_equal(part, np.repeat([0, 1, 2], 4)) and not turned.any()


def reason(v, t):
    with pytest.raises((SurfaceError, VolumeError)) as caught:
        closed_volume(v, t)
    return caught.value.reason


def test_refused_meshes():
    assert reason(CUBE_V, CUBE_T[:-1]) == "mesh_open"
    assert reason(CUBE_V, np.concatenate([CUBE_T, CUBE_T[:1]])) == "mesh_non_manifold"
    assert reason(*moebius()) == "mesh_non_orientable"
    assert reason(*torus(twist=1)) == "mesh_non_orientable"
    assert reason(CUBE_V, np.zeros((0, 3), int)) == "mesh_empty"
    assert reason(CUBE_V, CUBE_T + 1) == "mesh_index" and reason(CUBE_V, CUBE_T - 1) == "mesh_index"
    assert reason(CUBE_V, np.where(CUBE_T == 7, 6, CUBE_T)) == "mesh_degenerate"
    assert reason(CUBE_V * np.nan, CUBE_T) == "mesh_not_finite"
    assert (
        reason(CUBE_V[:, :2], CUBE_T) == "mesh_shape"
        and reason(CUBE_V, CUBE_T * 1.0) == "mesh_shape"
    )
    with pytest.raises(VolumeError):
        closed_volume(CUBE_V, CUBE_T, np.array([0, np.inf, 0]))
    with pytest.raises(VolumeError):
        closed_variance(CUBE_V, closed_volume(CUBE_V, CUBE_T), np.ones(3))


def test_a_flat_mesh_encloses_nothing():
    R, far = exp_so3(np.array([0.4, -0.7, 0.2])), np.array([5e5, 5.6e6, 300.0])
    flat, thin = CUBE_V * [1, 1, 0], CUBE_V * [1, 1, 1e-6]
    for v in (flat, flat @ R.T, flat @ R.T + far, np.zeros((8, 3)), CUBE_V * [1, 0, 0]):
        assert reason(v, CUBE_T) == "mesh_flat"
    assert closed_volume(thin @ R.T, CUBE_T).volume_m3 == pytest.approx(1e-6, rel=1e-9)
    assert closed_volume(thin @ R.T + far, CUBE_T).volume_m3 == pytest.approx(1e-6, rel=2e-3)
    # beside a body it does no harm
    both = closed_volume(np.concatenate([CUBE_V, flat + 3.0]), np.concatenate([CUBE_T, CUBE_T + 8]))
    assert both.volumes_m3 == pytest.approx([1.0, 0.0], abs=1e-12)


def test_welding_closes_a_soup_of_triangles():
    v, t = torus()
    soup, index = v[t].reshape(-1, 3), np.arange(3 * len(t)).reshape(-1, 3)
    assert reason(soup, index) == "mesh_open"
    w, u, dropped = weld(soup, index)
    assert len(w) == len(v) and dropped == 0
    assert closed_volume(w, u).volume_m3 == pytest.approx(closed_volume(v, t).volume_m3, rel=1e-12)
    rough = soup + np.random.default_rng(3).uniform(-1e-6, 1e-6, soup.shape)
    w, u, _ = weld(rough, index, 1e-3)
    assert closed_volume(w, u).volume_m3 == pytest.approx(closed_volume(v, t).volume_m3, rel=1e-4)


def test_edges_and_tetrahedra_are_their_twins():
    rng = np.random.default_rng(9)
    t, v, pole = (
        rng.integers(0, 30, (200, 3)).astype(np.int32),
        rng.standard_normal((30, 3)),
        rng.standard_normal(3),
    )
    order, start, key = edge_table(t)
    a, b = t.astype(np.int64), np.roll(t, -1, axis=1).astype(np.int64)
    assert np.array_equal(
        key, (np.minimum(a, b) << 32 | np.maximum(a, b)).ravel()
    ) and np.array_equal(order, np.argsort(key, kind="stable"))
    assert np.array_equal(start, [*np.unique(key[order], return_index=True)[1], len(order)])
    assert [len(part) for part in edge_table(t[:0])] == [0, 2, 0]
    value = rng.integers(0, 7, 50)
    assert np.array_equal(counting_sort(value, np.arange(50), 7), np.argsort(value, kind="stable"))
    corner = v[t] - pole
    volumes = np.einsum("ni,ni->n", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6.0
    assert signed_tetrahedra(v, t, pole) == pytest.approx(volumes, abs=1e-14)


def test_open_meshes_have_an_oriented_boundary():
    v, t = grid_mesh(9, 6, lambda i, j: [i, np.cos(j), np.sin(j)])
    m = orient(v, t[(t.max(axis=1) - t.min(axis=1)) < 13])  # the tube without its seam
    assert len(m.boundary) == 12 and m.euler == 0
    assert sorted(m.boundary[:, 0]) == sorted(m.boundary[:, 1])
    order, start, _ = edge_table(m.triangles)
    assert len(order) == 3 * len(m.triangles) and len(start) - 1 == m.edges
    assert tetrahedra_gradient(v, m.triangles, np.zeros(3)).shape == v.shape
    alone = [np.full(1, -1, np.int32), np.zeros(1, bool)]
    assert (
        spread_kernel(np.full((1, 3), -1, np.int32), np.zeros((1, 3), bool), *alone) == -1
        and alone[0][0] == 0
    )
