"""Ground surfaces: closed forms, robustness, covariance, refusals."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from ladar_volume.ground import heights
from ladar_volume.ground.ground_adjoint import (
    add_ground_gradient,
    ground_gradient,
    ground_residuals,
)
from ladar_volume.ground.ground_sampling import score_kernel
from ladar_volume.ground.polynomial import (
    base_gradient,
    base_height,
    design,
    design_gradient,
    design_surface,
    exponents,
    inverse_root,
    solve,
)
from ladar_volume.ground.robust_ground import fit_ground, robust_sigma
from ladar_volume.model.errors import GroundError
from ladar_volume.model.parameters import GroundParameters
from ladar_volume.model.records import Plane
from ladar_volume.simulation.scenes import Ground

COEFFICIENTS = {0: [2.0], 1: [2.0, 0.03, -0.05], 2: [2.0, 0.03, -0.05, 0.001, -0.002, 0.0005]}
COEFFICIENTS[3] = [*COEFFICIENTS[2], 2e-4, -1e-4, 1e-4, -2e-4]


def ground(n=400, degree=1, noise=0.0, seed=0, half=20.0):
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-half, half, (n, 2))
    return np.c_[
        xy, base_height(design_surface(COEFFICIENTS[degree]), xy) + noise * rng.standard_normal(n)
    ]


def fitted(points, origin, degree):
    return solve(design(points[:, :2], origin, degree), points[:, 2], degree)[0]


def fit(points, degree=1, **kwargs):
    return fit_ground(
        points,
        np.full(len(points), 1e-4),
        GroundParameters(degree=degree, trials=300 if degree < 3 else 1000, **kwargs),
    )


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_exact_ground_is_recovered(degree):
    points = ground(degree=degree)
    plane = fit(points, degree)
    xy = np.random.default_rng(1).uniform(-30, 30, (50, 2))
    assert base_height(plane, xy) == pytest.approx(
        base_height(design_surface(COEFFICIENTS[degree]), xy), abs=1e-10
    )
    assert len(plane.support) == 400 and plane.rms_m < 1e-12


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_a_pile_and_outliers_do_not_move_it(degree):
    points = ground(1500, degree, noise=0.01)
    r = np.hypot(points[:, 0], points[:, 1])
    points[:, 2] += np.maximum(0.0, 5.0 * (1 - r / 14.0))
    points[::50, 2] -= 7.0
    plane = fit(points, degree)
    clean = np.flatnonzero((r > 14.0) & (np.arange(1500) % 50 != 0))
    assert len(np.intersect1d(plane.support, clean)) > 0.97 * len(clean)
    sigma = np.sqrt(
        np.diag(
            design(points[:, :2], plane.origin_xy, degree)
            @ plane.C_beta
            @ design(points[:, :2], plane.origin_xy, degree).T
        )
    )
    error = base_height(plane, points[:, :2]) - base_height(
        design_surface(COEFFICIENTS[degree]), points[:, :2]
    )
    assert np.sqrt(np.mean(error**2)) < 3 * np.sqrt(np.mean(sigma**2))


def test_a_flat_top_larger_than_the_ground_does_not_win():
    points = ground(1000, noise=0.005)
    top = np.hypot(points[:, 0], points[:, 1]) < 16.5
    assert top.mean() > 0.52
    points[top, 2] += 2.0
    assert abs(base_height(fit(points), np.zeros((1, 2)))[0] - 2.0) < 0.01


def test_design_rows_are_the_powers():
    xy, origin = np.random.default_rng(2).uniform(-3.0, 3.0, (20, 2)), np.array([0.5, -1.0])
    for degree in range(4):
        dx, dy = (xy - origin).T
        rows = np.column_stack([dx**a * dy**b for a, b in exponents(degree)])
        assert design(xy, origin, degree) == pytest.approx(rows, rel=1e-13, abs=1e-13)


def test_scores_of_candidates_by_their_plain_twin():
    rng = np.random.default_rng(3)
    points = rng.normal(size=(300, 3)) * 0.2
    X, beta = design(points[:, :2], np.zeros(2), 2), rng.normal(size=(40, 6)) * 0.1
    within, below = score_kernel(
        np.ascontiguousarray(X.T), np.ascontiguousarray(points[:, 2]), beta, 0.1
    )
    r = points[:, 2] - beta @ X.T
    assert np.array_equal(within, (np.abs(r) <= 0.1).sum(axis=1)) and np.array_equal(
        below, (r < -0.1).sum(axis=1)
    )
    assert 0 < within.max() < 300 and 0 < below.max()


def test_covariance_is_that_of_the_sampled_coefficients():
    fits = []
    xy = ground(300, seed=9)
    for seed in range(400):
        p = xy.copy()
        p[:, 2] += 0.01 * np.random.default_rng(seed).standard_normal(300)
        origin = np.zeros(2)
        X = design(p[:, :2], origin, 1)
        beta, N = solve(X, p[:, 2], 1)
        fits.append(beta)
    C = 1e-4 * N @ X.T @ X @ N
    assert np.allclose(C, 1e-4 * N, rtol=1e-10)
    ratio = np.linalg.solve(C, np.cov(np.array(fits).T))
    # 400 samples: the standard error of a variance is 7 %
    assert np.linalg.eigvals(ratio).real == pytest.approx(np.ones(3), abs=0.28)


def test_threshold_loses_next_to_nothing_of_gaussian_noise():
    plane = fit(ground(5000, noise=0.02))
    assert len(plane.support) > 0.995 * 5000
    assert plane.rms_m == pytest.approx(0.02, rel=0.03)


def test_same_input_same_bits_and_shift_equivariance():
    points = ground(300, noise=0.01)
    a, b = fit(points), fit(points)
    assert a.beta.tobytes() == b.beta.tobytes() and np.array_equal(a.support, b.support)
    moved = fit(points + np.array([1000.0, -2000.0, 300.0]))
    xy = points[:, :2]
    assert base_height(moved, xy + np.array([1000.0, -2000.0])) - 300.0 == pytest.approx(
        base_height(a, xy), abs=1e-8
    )


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_gradients_of_the_surface_and_of_the_design(degree):
    plane = design_surface(COEFFICIENTS[degree], (3.0, -2.0))
    xy, h = np.random.default_rng(2).uniform(-5, 5, (20, 2)), 1e-5
    for axis in range(2):
        step = np.eye(2)[axis] * h
        numeric = (base_height(plane, xy + step) - base_height(plane, xy - step)) / (2 * h)
        assert base_gradient(plane, xy)[:, axis] == pytest.approx(numeric, abs=1e-9)
        numeric = (
            design(xy + step, plane.origin_xy, degree) - design(xy - step, plane.origin_xy, degree)
        ) / (2 * h)
        assert np.allclose(
            design_gradient(xy, plane.origin_xy, degree)[:, axis], numeric, atol=1e-8
        )


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_adjoint_equals_central_differences(degree):
    points = ground(30, degree, noise=0.2)
    by_beta = np.random.default_rng(3).standard_normal((len(COEFFICIENTS[degree]), 2))
    origin = np.array([1.0, 2.0])
    beta = fitted(points, origin, degree)
    plane = Plane(origin, beta, np.zeros((len(beta), len(beta))), np.arange(30))
    got = ground_gradient(points, plane, by_beta)
    h = 1e-5
    for i in (0, 7, 29):
        for axis in range(3):
            up, down = points.copy(), points.copy()
            up[i, axis] += h
            down[i, axis] -= h
            numeric = (
                (fitted(up, origin, degree) - fitted(down, origin, degree)) @ by_beta / (2 * h)
            )
            assert got[i, :, axis] == pytest.approx(numeric, rel=1e-6, abs=1e-8)


@pytest.mark.parametrize(
    "points,degree,reason",
    [
        (np.zeros((0, 3)), 1, "ground_too_few_points"),
        (np.zeros((2, 3)), 1, "ground_too_few_points"),
        (np.arange(30.0).reshape(10, 3) * [1, 1, 0], 1, "ground_tilt"),
        (np.zeros((10, 3)), 1, "ground_tilt"),
        (np.r_[ground(10), [[0, 0, np.nan]]], 1, "ground_not_finite"),
    ],
)
def test_refusals(points, degree, reason):
    with pytest.raises(GroundError) as caught:
        fit(points, degree)
    assert caught.value.reason == reason


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"degree": 0},
        {"degree": 2},
        {"threshold_m": 0.1},
        {"below_weight": 0.0, "threshold_m": 0.2},
    ],
)
def test_points_that_fill_space_show_no_ground(seed, options):
    rng = np.random.default_rng(seed)
    ball = rng.standard_normal((4000, 3))
    for points in (
        ball,
        3.0 * ball,
        rng.uniform(-1, 1, (4000, 3)),
        ball * [8.0, 1.0, 1.0],
        np.r_[ball, ball + np.array([7.0, 0, 0])],
    ):
        with pytest.raises(GroundError) as caught:
            fit(points, **options)
        assert caught.value.reason in ("ground_no_surface", "ground_no_consensus", "ground_tilt")


def test_what_a_surface_may_be_like():
    narrow = ground(2000, noise=0.03, half=0.15)
    assert fit(narrow).rms_m == pytest.approx(0.03, rel=0.1)
    slope = ground(2000, noise=0.01) * [1, 0.1, 1]
    slope[:, 2] = 0.3 * slope[:, 0]
    assert (
        fit(slope, 0).rms_m > slope[:, 1].std()
    )  # a level does not follow it, but it is a surface
    stairs = ground(3000, noise=0.005)
    stairs[:, 2] = (
        0.17 * np.floor(stairs[:, 0] / 8.0)
        + stairs[:, 2]
        - base_height(design_surface(COEFFICIENTS[1]), stairs[:, :2])
    )
    assert fit(stairs, 0, threshold_m=0.02).rms_m < 0.01


def test_a_conic_does_not_define_a_quadric():
    a = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    for degree in (2, 3):
        with pytest.raises(GroundError) as caught:
            fitted(np.c_[np.cos(a), np.sin(a), np.zeros(40)], np.zeros(2), degree)
        assert caught.value.reason == "ground_degenerate"


@pytest.mark.parametrize("narrow", [1.0, 1e-1, 1e-3])
def test_roots_of_well_and_badly_fixed_surfaces(narrow):
    rng = np.random.default_rng(3)
    xy = rng.normal(size=(300, 2)) @ [
        [1.0, 1.0],
        [-narrow, narrow],
    ]  # from a disc to a strip a thousandth as wide
    for degree in (0, 1, 2):
        X = design(xy, np.zeros(2), degree)
        root, S = np.linalg.inv(np.linalg.qr(X, mode="r")), inverse_root(X, degree)
        assert S @ S.T == pytest.approx(
            root @ root.T, rel=1e-9, abs=1e-9 * np.abs(root @ root.T).max()
        )


def test_gravity_prior():
    points = ground(200, noise=0.001)
    wall = np.c_[np.full(600, 5.0), np.random.default_rng(4).uniform(0, 20, (600, 2))]
    wall[:, 0] += 1e-3 * np.random.default_rng(5).standard_normal(600)
    plane = fit(np.r_[points, wall])
    assert np.allclose(plane.beta[1:], COEFFICIENTS[1][1:], atol=1e-3)
    steep = points.copy()
    steep[:, 2] = points[:, 0]
    assert fit(steep, max_tilt_rad=math.radians(50)).beta[1] == pytest.approx(1.0)
    with pytest.raises(GroundError) as caught:
        fit(steep)
    assert caught.value.reason == "ground_tilt"


def test_fixed_threshold_and_bad_coefficients():
    points = ground(200, noise=0.0)
    points[:20, 2] += 0.05
    assert len(fit(points, threshold_m=0.02).support) == 180
    assert robust_sigma(np.zeros(0)) == 0.0
    with pytest.raises(GroundError):
        design_surface([1.0, 2.0])
    assert dataclasses.replace(design_surface([1.0])).support.size == 0


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_gradients_in_place_are_whole_array_sums(degree):
    points = np.concatenate([ground(40, degree, noise=0.2), np.full((3, 3), 9.0)])
    rng, origin, support = (
        np.random.default_rng(4),
        np.array([1.0, 2.0]),
        np.sort(np.random.default_rng(5).choice(40, 30, replace=False)),
    )
    X = design(points[support, :2], origin, degree)
    beta, N = solve(X, points[support, 2], degree)
    plane, by_beta = (
        Plane(origin, beta, np.zeros((len(beta), len(beta))), support),
        rng.standard_normal((len(beta), 4)),
    )
    xy, residual, weight = ground_residuals(points, plane, by_beta[:, 0])
    assert xy.tobytes() == points[support, :2].tobytes()
    assert residual == pytest.approx(points[support, 2] - X @ beta, abs=1e-12)
    assert weight == pytest.approx(X @ (N @ by_beta[:, 0]), rel=1e-9, abs=1e-12)
    D, slope = design_gradient(xy, origin, degree), base_gradient(plane, xy)
    vertical = X @ N @ by_beta
    across = residual[:, None, None] * (D @ N @ by_beta) - slope[:, :, None] * vertical[:, None]
    place, out = rng.permutation(len(points)), rng.standard_normal((len(points), 4, 3))
    place[support[3]] = -1  # a corner of the surface that is no point
    twin = out.copy()
    kept = np.arange(30) != 3
    np.add.at(
        twin,
        place[support[kept]],
        np.concatenate([across, vertical[:, None]], axis=1).swapaxes(1, 2)[kept],
    )
    add_ground_gradient(out, place, points, plane, by_beta)
    assert out == pytest.approx(twin, rel=1e-9, abs=1e-11)


@pytest.mark.parametrize("seed", [2, 5])
def test_crests_and_hollows_of_undulating_ground_are_ground(seed):
    # more points lie near the plane than far from it, so that their median says too little
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-16.0, 16.0, (20_000, 2))
    xy = xy[np.hypot(*xy.T) > 8.0]
    undulation = Ground(0.0, (0.0, 0.0), 0.035, 2.0, seed)(*xy.T)
    kept = rng.random(len(xy)) < np.where(np.abs(undulation) < 0.03, 1.0, 0.4)
    points = np.c_[xy, undulation + rng.normal(0.0, 0.003, len(xy))][kept]
    plane = fit_ground(points, np.full(len(points), 9e-6), GroundParameters(), 0.075)
    assert len(plane.support) > 0.999 * len(points)


def test_plants_on_the_ground_do_not_raise_its_threshold():
    rng = np.random.default_rng(3)
    xy = rng.uniform(-16.0, 16.0, (8000, 2))
    plants = rng.random(len(xy)) < 0.1
    z = rng.normal(0.0, 0.01, len(xy)) + np.where(plants, rng.uniform(0.1, 0.6, len(xy)), 0.0)
    plane = fit_ground(np.c_[xy, z], np.full(len(xy), 1e-4), GroundParameters(), 0.075)
    assert not plants[plane.support].any()
    assert abs(plane.beta[0]) < 0.001


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("seed", range(3))
def test_sums_part_by_part_are_those_of_all_rows(degree, seed):
    rng = np.random.default_rng(seed)
    n = int(2.5 * heights.PART)
    points, origin = rng.normal(0.0, 5.0, (n, 3)), np.array([0.5, -1.0])
    inside, weight = rng.random(n) < 0.6, rng.uniform(0.1, 2.0, n)
    X, z = design(points[inside, :2], origin, degree), points[inside, 2]
    square, right = heights.design_sums(points, inside, origin, degree, weight)
    np.testing.assert_allclose(square, X.T @ (weight[inside, None] * X), rtol=1e-11, atol=1e-7)
    np.testing.assert_allclose(right, X.T @ (weight[inside] * z), rtol=1e-11, atol=1e-7)
    values = rng.normal(size=(n, 2))
    every = design(points[:, :2], origin, degree)
    found = heights.design_products(points, origin, degree, values)
    np.testing.assert_allclose(found, every.T @ values, rtol=1e-11, atol=1e-7)
    beta, N = heights.solve_points(points, inside, origin, degree)
    np.testing.assert_allclose(beta, np.linalg.lstsq(X, z, rcond=None)[0], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(N, np.linalg.inv(X.T @ X), rtol=1e-7, atol=1e-14)
    above = heights.heights_above(points, origin, beta)
    np.testing.assert_allclose(above[inside], z - X @ beta, rtol=1e-9, atol=1e-9)
