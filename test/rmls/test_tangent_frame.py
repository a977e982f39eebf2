"""Frames and fits of one patch against other formulations: vectors, spheres, matrices."""

from __future__ import annotations

import numpy as np
import pytest

from ladar_volume.rmls import patch_twin
from ladar_volume.rmls import tangent_frame as kernels
from ladar_volume.rmls.patch_sensitivity import residual

RNG = np.random.default_rng(11)


def frame_of(seed):
    """Centre, normal and tangent, and the rotation (3, 3) from the map to (u, v, w)."""
    rng = np.random.default_rng(seed)
    Q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    Q *= np.linalg.det(Q)
    return kernels.Frame(rng.uniform(-5, 5, 3), Q[2].copy(), Q[0].copy()), Q


@pytest.mark.parametrize(
    ("normal", "along"),
    [
        ([0.0, 0.0, 1.0], 0),
        ([0.3, -0.5, 0.8], 0),
        ([0.89, 0.1, np.sqrt(1.0 - 0.89**2 - 0.01)], 0),
        ([0.91, 0.1, -np.sqrt(1.0 - 0.91**2 - 0.01)], 1),
        ([-1.0, 0.0, 0.0], 1),
    ],
)
def test_a_tangent_is_the_map_axis_laid_on_the_plane(normal, along):
    normal, tangent, side = np.array(normal), np.empty(3), np.empty(3)
    normal /= np.linalg.norm(normal)
    kernels.tangent_of(normal, tangent)
    laid = np.eye(3)[along] - normal * normal[along]
    assert tangent == pytest.approx(laid / np.linalg.norm(laid), abs=1e-15)
    kernels.second_tangent(normal, tangent, side)
    assert np.linalg.det([tangent, side, normal]) == pytest.approx(1.0)


def test_points_in_a_frame():
    frame, Q = frame_of(1)
    r, uvw, found = RNG.uniform(-6, 6, (200, 3)), np.empty((3, 200)), np.empty(200, np.int64)
    n = kernels.frame_coordinates(r, 200, *frame, 7.0, uvw, found)
    local = (r - frame.centre) @ Q.T
    near = np.flatnonzero(np.linalg.norm(local, axis=1) <= 7.0)
    assert 20 < n < 180 and list(found[:n]) == list(near)
    assert uvw[:, :n].T == pytest.approx(local[near] / [7.0, 7.0, 1.0])
    for degree, p in ((1, 3), (2, 6)):
        X, x = patch_twin.design(r, *frame, degree)[0], np.empty(6)
        for i in range(5):
            kernels.polynomial_row(r, i, frame.centre, frame.tangent, Q[1], p, x)
            assert x[:p] == pytest.approx(X[i])


@pytest.mark.parametrize("radius", [2.0, -3.0])
def test_the_arc_over_a_quadric_is_a_sphere(radius):
    a, (u, v) = 0.5 / radius, RNG.uniform(-1.2, 1.2, (2, 40))
    for x, y in zip(u, v, strict=True):
        rise, gu, gv = kernels.arc_height(x, y, a, 0.0, a)
        height = radius - np.sign(radius) * np.sqrt(radius**2 - x * x - y * y)
        assert a * (x * x + y * y) + rise == pytest.approx(height, abs=1e-13)
        assert (gu, gv) == pytest.approx(np.array([x, y]) / (radius - height))


@pytest.mark.parametrize("size", [1e-4, 0.3, 3.0])  # flat, curved, steeper than the limit
def test_slopes_of_the_arc_are_its_differences(size):
    a, b, c = 0.4, -0.3, 0.25

    def height(x, y):
        return a * x * x + b * x * y + c * y * y + kernels.arc_height(x, y, a, b, c)[0]

    for u, v in RNG.uniform(0.5, 1.0, (20, 2)) * size:
        h = 1e-4 * size
        by_u, by_v = height(u + h, v) - height(u - h, v), height(u, v + h) - height(u, v - h)
        assert kernels.arc_height(u, v, a, b, c)[1:] == pytest.approx(
            (by_u / (2.0 * h), by_v / (2.0 * h)), rel=1e-5
        )
        X = np.array([[1.0, u, v, u * u, u * v, v * v]])
        twin = patch_twin.arc(X, np.array([0.0, 0.0, 0.0, a, b, c]))[0][0]
        assert kernels.arc_height(u, v, a, b, c)[0] == pytest.approx(twin, rel=1e-4, abs=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_a_frame_is_laid_on_a_plane_below_its_origin(seed):
    frame, Q = frame_of(seed)
    beta, origin, side = np.array([0.2, -0.7, 0.4]), RNG.uniform(-5, 5, 3), Q[1]
    spanned = [frame.tangent + beta[1] * Q[2], side + beta[2] * Q[2]]  # two vectors in the plane
    upward = np.cross(*spanned) / np.linalg.norm(np.cross(*spanned))
    through = frame.centre + beta[0] * Q[2]
    moved = kernels.Frame(*(x.copy() for x in frame))
    kernels.move_to_surface(*moved, beta)
    assert moved.centre == pytest.approx(through) and moved.normal == pytest.approx(upward)
    assert np.array_equal(moved.tangent, frame.tangent)
    kernels.lay_on_plane(origin, beta, frame)
    assert frame.normal == pytest.approx(upward)
    assert frame.centre == pytest.approx(origin - upward * ((origin - through) @ upward))


def some_points(n=60):
    """Points in a frame with unit ball, some of them inside, and weights."""
    uvw, weight = RNG.uniform(-1, 1, (3, n)), RNG.uniform(0.5, 2.0, n)
    near = kernels.Near(uvw, np.arange(n), RNG.random(n) < 0.7)
    columns = [np.ones(n), uvw[0], uvw[1], uvw[0] ** 2, uvw[0] * uvw[1], uvw[1] ** 2]
    return near, weight, np.stack(columns, axis=1)


def test_normal_equations_are_those_of_the_rows_inside():
    near, weight, X = some_points()
    W, n = np.where(near.inside, weight, 0.0), len(weight)
    for p in (3, 6):
        A, b, own = np.zeros((6, 6)), np.zeros(6), X[:, :p]
        if p == 6:
            kernels.normal_quadric(near, near.uvw[2], n, weight, A, b)
        else:
            kernels.normal_plane(near, n, weight, A, b)
        assert np.tril(A[:p, :p]) == pytest.approx(np.tril(own.T @ (W[:, None] * own)))
        assert b[:p] == pytest.approx(own.T @ (W * near.uvw[2]))


def test_distances_are_across_the_surface_within_a_ball_about_the_foot():
    near, _, X = some_points(300)
    b, ball, sigma = np.array([0.1, -0.5, 0.3, 0.0, 0.0, 0.0]), 2.0, 0.2
    off = kernels.Residuals(near.uvw[2].copy(), np.empty(300))
    kernels.distances(near.uvw, off, 300, 3, b, ball, sigma)
    assert off.off == pytest.approx(np.abs(near.uvw[2] - X[:, :3] @ b[:3]))  # along the normal
    kernels.distances(near.uvw, off, 300, 6, b, ball, sigma)
    # of a plane w = b0 + (b1 u + b2 v) / ball in metres: the foot by linear algebra
    points, normal = near.uvw.T * [ball, ball, 1.0], np.array([-b[1] / ball, -b[2] / ball, 1.0])
    away = (points @ normal - b[0]) / (normal @ normal)
    foot = points - away[:, None] * normal
    inside = np.linalg.norm(foot, axis=1) <= ball - sigma
    assert 50 < inside.sum() < 290 and np.isinf(off.off[~inside]).all()
    assert off.off[inside] == pytest.approx(np.abs(away[inside]) * np.linalg.norm(normal))


def test_what_is_within_a_threshold_and_whether_that_is_new():
    off, inside = np.array([0.1, 0.5, 0.3, np.inf]), np.zeros(4, bool)
    assert kernels.classify(off, 4, 0.3, inside) == (2, True)
    assert list(inside) == [True, False, True, False]
    assert kernels.classify(off, 4, 0.4, inside) == (2, False)
    assert kernels.classify(off, 4, 0.2, inside) == (1, True)
    assert kernels.weighted_square(off, 3, inside, np.array([3.0, 5.0, 7.0, 9.0])) == pytest.approx(
        0.03
    )


def test_a_return_on_the_patch_has_no_residual():
    frame, Q = frame_of(3)
    beta = np.array([0.02, 0.1, -0.2, 0.15, -0.1, 0.2])
    u, v = RNG.uniform(-0.8, 0.8, (2, 30))
    for p, above in ((3, 0.0), (6, 0.0), (6, 0.07)):
        X = np.stack([np.ones(30), u, v, u * u, u * v, v * v], axis=1)[:, :p]
        w = X @ beta[:p] + (patch_twin.arc(X, beta)[0] if p == 6 else 0.0) + above
        r = frame.centre + np.stack([u, v, w], axis=1) @ Q
        axes = np.array([frame.centre, frame.normal, frame.tangent, Q[1]])
        for i in range(30):
            assert residual(r, i, axes, p, X[i], beta) == pytest.approx(above, abs=1e-9)
