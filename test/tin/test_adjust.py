"""Elevation adjustment: the direct solve, the published iteration, the least sizes, and what all of
them may not touch.
"""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest
from scipy import sparse

from ladar_volume.model.errors import SurfaceError
from ladar_volume.tin import elevation_adjustment
from ladar_volume.tin.asd_adjustment import adjust_asd, adjust_asd_exact
from ladar_volume.tin.elevation_adjustment import (
    Normal,
    adjust_rms,
    adjust_rms_by_iteration,
    fit_of,
    measures,
    raw_gradient,
    sweep,
    sweep_plain,
)
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.tin.locate import barycentric, height_at, locate, triangle_index


def cloud(n=400, noise=0.02, seed=0):
    rng = np.random.default_rng(seed)
    xy = np.r_[[[0, 0], [10, 0], [10, 10], [0, 10]], rng.uniform(0, 10, (n - 4, 2))]
    return np.c_[xy, np.sin(xy[:, 0] / 2) + 0.1 * xy[:, 1] + noise * rng.normal(size=n)]


def partial(points, vertices=60):
    return build_tin(points[:vertices])


def dense_solution(tin, points, sigma=None):
    fit = fit_of(tin, points, sigma)
    w = np.sqrt(fit.weight)
    return np.linalg.lstsq(fit.B.toarray() * w[:, None], fit.z * w, rcond=None)[0]


def test_direct_equals_dense_least_squares_and_the_iteration_agrees():
    points = cloud()
    tin = partial(points)
    direct = adjust_rms(tin, points)
    assert direct.tin.vertices[:, 2] == pytest.approx(dense_solution(tin, points), abs=1e-9)
    swept = adjust_rms_by_iteration(tin, points, 2000, 1e-13)
    assert swept.converged and swept.tin.vertices[:, 2] == pytest.approx(
        direct.tin.vertices[:, 2], abs=1e-9
    )
    assert direct.rms_m < direct.rms_before_m and direct.rms_m == pytest.approx(
        swept.rms_m, rel=1e-10
    )
    r = points[:, 2] - height_at(direct.tin, points[:, :2])
    assert (direct.rms_m, direct.asd_m) == pytest.approx(
        (math.sqrt((r**2).mean()), np.abs(r).mean()), rel=1e-12
    )
    # triangulation, footprint and data are untouched
    assert direct.tin.triangles is tin.triangles and np.array_equal(
        direct.tin.vertices[:, :2], tin.vertices[:, :2]
    )
    assert np.array_equal(points, cloud())


def test_the_two_stopping_rules():
    points = cloud(seed=1)
    tin = partial(points)
    few = adjust_rms_by_iteration(tin, points, 3, 1e-13)
    assert few.iterations == 3 and not few.converged
    loose = adjust_rms_by_iteration(tin, points, 1000, 1e-3)
    assert loose.converged and loose.iterations < 1000
    rms = [adjust_rms_by_iteration(tin, points, k, 0.0).rms_m for k in range(6)]
    assert rms[0] == adjust_rms(tin, points).rms_before_m
    assert (
        all(b <= a for a, b in itertools.pairwise(rms)) and rms[-1] >= adjust_rms(tin, points).rms_m
    )
    assert loose.rms_m == pytest.approx(adjust_rms(tin, points).rms_m, rel=1e-3)


def test_sigmas_weight_the_points():
    points = cloud(seed=2, noise=0.2)
    tin, sigma = partial(points), np.random.default_rng(0).uniform(0.01, 0.3, 400)
    assert adjust_rms(tin, points, sigma).tin.vertices[:, 2] == pytest.approx(
        dense_solution(tin, points, sigma), abs=1e-8
    )
    same = adjust_rms(tin, points, np.full(400, 0.7)).tin.vertices
    assert same == pytest.approx(adjust_rms(tin, points).tin.vertices, abs=1e-10)


def test_mean_and_median_where_every_point_sits_at_a_vertex():
    corners = np.array([[0, 0, 0.0], [4, 0, 1], [0, 4, 2], [4, 4, 3]])
    tin = build_tin(corners)
    offsets = np.array([0.0, 0.1, 0.2, 3.0, -0.05])
    points = np.concatenate([corners + np.array([0, 0, d]) for d in offsets])
    assert adjust_rms(tin, points).tin.vertices[:, 2] - corners[:, 2] == pytest.approx(
        np.full(4, offsets.mean()), abs=1e-11
    )
    assert adjust_asd(tin, points).tin.vertices[:, 2] - corners[:, 2] == pytest.approx(
        np.full(4, 0.1), abs=1e-7
    )
    assert adjust_asd_exact(tin, points).tin.vertices[:, 2] - corners[:, 2] == pytest.approx(
        np.full(4, 0.1), abs=1e-9
    )


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_least_sizes_agree_with_the_linear_program(seed):
    points = cloud(seed=seed)
    points[100:110, 2] += 5.0  # outliers hardly move it
    tin = partial(points)
    fast, exact = adjust_asd(tin, points), adjust_asd_exact(tin, points)
    assert fast.converged and exact.asd_m <= fast.asd_m * (1 + 1e-12)
    assert fast.asd_m == pytest.approx(exact.asd_m, rel=1e-8)
    assert (
        exact.asd_m < adjust_rms(tin, points).asd_m and exact.rms_m > adjust_rms(tin, points).rms_m
    )
    # at an optimum of the program as many residuals vanish as there are heights
    assert (np.abs(exact.fit.residuals(exact.tin.vertices[:, 2])) < 1e-9).sum() >= len(tin.vertices)


def test_least_sizes_with_sigmas():
    points = cloud(200, seed=6, noise=0.1)
    tin, sigma = partial(points, 30), np.random.default_rng(1).uniform(0.05, 0.5, 200)
    fast, exact = adjust_asd(tin, points, sigma), adjust_asd_exact(tin, points, sigma)
    total = [np.sum(np.abs(a.fit.residuals(a.tin.vertices[:, 2])) / sigma) for a in (fast, exact)]
    assert total[1] <= total[0] * (1 + 1e-12) and total[0] == pytest.approx(total[1], rel=1e-8)


@pytest.mark.parametrize(
    "method",
    [
        adjust_rms,
        lambda t, p: adjust_rms_by_iteration(t, p, 3000, 1e-13),
        adjust_asd,
        adjust_asd_exact,
    ],
)
def test_a_plane_is_found_from_wrong_heights_and_kept(method):
    points = cloud(seed=7)
    points[:, 2] = 1.0 + 0.3 * points[:, 0] - 0.2 * points[:, 1]
    tin = partial(points)
    wrong = dataclasses.replace(
        tin, vertices=tin.vertices + [0, 0, 1] * np.random.default_rng(0).normal(size=(60, 1))
    )
    assert method(wrong, points).tin.vertices[:, 2] == pytest.approx(tin.vertices[:, 2], abs=1e-5)
    again = method(tin, points)
    assert again.tin.vertices == pytest.approx(tin.vertices, abs=1e-12) and again.rms_m < 1e-12


def test_turning_and_shifting_the_scene_changes_nothing():
    points = cloud(seed=8)
    tin = partial(points)
    c, s = math.cos(0.5), math.sin(0.5)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    move = np.array([3000.0, -2000, 150])
    moved = dataclasses.replace(tin, vertices=tin.vertices @ R.T + move)
    a, b = adjust_rms(tin, points), adjust_rms(moved, points @ R.T + move)
    assert b.tin.vertices[:, 2] - 150 == pytest.approx(a.tin.vertices[:, 2], abs=1e-8)
    a, b = adjust_asd(tin, points), adjust_asd(moved, points @ R.T + move)
    assert b.asd_m == pytest.approx(a.asd_m, rel=1e-6)


def test_vertices_without_data_keep_their_heights():
    points = cloud(seed=9)
    tin = partial(points)
    keep = (tin.vertices[tin.triangles, 0] < 6).all(axis=1)
    marked = dataclasses.replace(tin, relevant=keep)
    untouched = ~np.isin(np.arange(len(tin.vertices)), tin.triangles[keep])
    assert untouched.any()
    for method in (
        adjust_rms,
        lambda t, p: adjust_rms_by_iteration(t, p, 50),
        adjust_asd,
        adjust_asd_exact,
    ):
        new = method(marked, points).tin.vertices[:, 2]
        assert np.array_equal(new[untouched], tin.vertices[untouched, 2]) and not np.array_equal(
            new[~untouched], tin.vertices[~untouched, 2]
        )


def test_heights_the_points_leave_open_stay_near_the_old_ones():
    # one triangle, one point: infinitely many planes; the smallest change is taken
    tin = build_tin(np.array([[0, 0, 0.0], [3, 0, 0], [0, 3, 0]]))
    new = adjust_rms(tin, np.array([[1.0, 1, 6.0]])).tin.vertices[:, 2]
    assert new == pytest.approx([6, 6, 6], abs=1e-9)


def test_adjoint_against_differences_and_dense_algebra():
    points = cloud(seed=10)
    tin, sigma = partial(points), np.random.default_rng(2).uniform(0.01, 0.1, 400)
    g = np.random.default_rng(3).normal(size=(60, 2))
    fit = fit_of(tin, points, sigma)
    s = raw_gradient(tin, fit, g, len(points))
    B, W = fit.B.toarray(), np.diag(fit.weight)
    assert s[fit.point] == pytest.approx(W @ B @ np.linalg.solve(B.T @ W @ B, g), abs=1e-9)
    assert raw_gradient(tin, fit, g[:, 0], len(points)) == pytest.approx(s[:, 0], abs=1e-12)
    for j in range(0, 400, 57):
        h = np.zeros((400, 3))
        h[j, 2] = 1e-3
        up, down = (adjust_rms(tin, points + e * h, sigma).tin.vertices[:, 2] for e in (1, -1))
        assert g.T @ (up - down) / 2e-3 == pytest.approx(s[j], abs=1e-7)
    # heights shift with the data: the sensitivities of one height add up to one
    assert raw_gradient(tin, fit, np.eye(60), len(points)).sum(axis=0) == pytest.approx(
        np.ones(60), abs=1e-9
    )


def test_adjoint_of_vertices_that_were_not_adjusted():
    points = cloud(seed=11)
    tin = dataclasses.replace(
        partial(points),
        relevant=(partial(points).vertices[partial(points).triangles, 0] < 6).all(axis=1),
    )
    fit = fit_of(tin, points)
    held = np.flatnonzero(~fit.adjusted)[0]
    g = np.zeros(60)
    g[held] = 2.5
    s = raw_gradient(tin, fit, g, 400)
    assert s[tin.source[held]] == 2.5 and np.count_nonzero(s) == 1


def test_variance_through_the_adjustment():
    points, sigma = cloud(120, noise=0.0, seed=12), 0.05
    tin, g = partial(points, 20), np.random.default_rng(5).normal(size=20)
    fit = fit_of(tin, points)
    predicted = sigma**2 * (raw_gradient(tin, fit, g, 120) ** 2).sum()
    H = np.linalg.pinv(fit.B.toarray())
    assert predicted == pytest.approx(sigma**2 * ((H.T @ g) ** 2).sum(), rel=1e-9)
    rng = np.random.default_rng(6)
    values = [g @ (H @ (sigma * rng.normal(size=120))) for _ in range(4000)]
    assert np.var(values) == pytest.approx(predicted, rel=5 * math.sqrt(2 / 4000))


def test_conjugate_gradients_reach_the_digits_of_the_factors(monkeypatch):
    points = cloud(seed=13)
    tin = partial(points)
    direct = adjust_rms(tin, points).tin.vertices
    monkeypatch.setattr(elevation_adjustment, "MAX_DIRECT", 0)
    assert adjust_rms(tin, points).tin.vertices == pytest.approx(direct, abs=1e-11)
    assert Normal(fit_of(tin, points).B, np.ones(400)).factor is None


def test_a_sweep_is_its_dense_formulation():
    points = cloud(120, seed=14)
    tin = partial(points, 20)
    fit = fit_of(tin, points, np.random.default_rng(0).uniform(0.1, 1, 120))
    columns = sparse.csc_array(fit.B)
    results = []
    for run in (sweep,):
        heights, residual = tin.vertices[:, 2].copy(), fit.residuals(tin.vertices[:, 2])
        moved = run(
            columns.indptr.astype(np.int64),
            columns.indices.astype(np.int64),
            columns.data,
            fit.weight,
            residual,
            heights,
        )
        results.append((moved, heights, residual))
    heights, residual = tin.vertices[:, 2].copy(), fit.residuals(tin.vertices[:, 2])
    plain = sweep_plain(fit.B.toarray(), fit.weight, residual, heights)
    assert results[0][0] == pytest.approx(plain, rel=1e-12) and results[0][1] == pytest.approx(
        heights, abs=1e-13
    )
    assert measures(results[0][2]) == pytest.approx(measures(residual), rel=1e-12)


@pytest.mark.parametrize(
    "points,sigma,reason",
    [
        (np.zeros((4, 2)), None, "surface_shape"),
        (np.array([[1, 1, np.nan]]), None, "surface_not_finite"),
        (np.array([[100.0, 1, 1]]), None, "surface_no_point"),
        (np.zeros((0, 3)), None, "surface_no_point"),
        (np.array([[1.0, 1, 1]]), np.array([0.0]), "surface_sigma"),
        (np.array([[1.0, 1, 1]]), np.array([np.nan]), "surface_sigma"),
        (np.array([[1.0, 1, 1]]), np.ones(2), "surface_sigma"),
    ],
)
def test_refusals(points, sigma, reason):
    tin = partial(cloud())
    with pytest.raises(SurfaceError) as caught:
        adjust_rms(tin, points, sigma)
    assert caught.value.reason == reason


def test_bad_stopping_rules():
    points = cloud()
    for arguments in ((-1, 1e-3), (10, -1.0), (10, np.nan)):
        with pytest.raises(SurfaceError) as caught:
            adjust_rms_by_iteration(partial(points), points, *arguments)
        assert caught.value.reason == "surface_tolerance"


@pytest.mark.parametrize("ratio", [1.0, 0.3])
def test_points_that_are_vertices_lie_where_a_search_finds_them(ratio):
    rng = np.random.default_rng(8)
    points = np.c_[rng.integers(0, 40, (600, 2)), rng.normal(size=600)].astype(float)
    chosen = np.sort(rng.choice(600, int(ratio * 600), replace=False))
    tin = build_tin(points[chosen])
    tin = dataclasses.replace(tin, source=chosen[tin.source])
    tin = dataclasses.replace(tin, relevant=tin.vertices[tin.triangles, 0].min(axis=1) > 5.0)
    fit = fit_of(tin, points)
    where = locate(triangle_index(tin, tin.relevant), points[:, :2])
    assert np.array_equal(fit.point, np.flatnonzero(where >= 0))
    assert np.array_equal(fit.triangle, where[fit.point])
    rows = np.zeros((len(fit.point), len(tin.vertices)))
    weights = barycentric(tin, fit.triangle, points[fit.point, :2])
    np.put_along_axis(rows, tin.triangles[fit.triangle].astype(np.int64), weights, axis=1)
    assert np.array_equal(fit.B.toarray(), rows)
