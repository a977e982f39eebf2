"""The adjoint of the adjustment in three directions, and the covariance of adjusted heights,
against differences and dense inverses.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from ladar_volume.tin.adjustment_adjoint import (
    entries,
    height_covariance,
    raw_gradients,
    selected_inverse,
    triangle_slopes,
)
from ladar_volume.tin.elevation_adjustment import adjust_rms, fit_of, raw_gradient
from ladar_volume.tin.full_tin import build_tin


def cloud(n=120, noise=0.05, seed=0):
    rng = np.random.default_rng(seed)
    xy = np.r_[[[0, 0], [10, 0], [10, 10], [0, 10]], rng.uniform(0, 10, (n - 4, 2))]
    return np.c_[xy, np.sin(xy[:, 0] / 2) + 0.1 * xy[:, 1] + noise * rng.normal(size=n)]


def grid(side=9):
    x, y = (a.ravel() for a in np.meshgrid(np.arange(side), np.arange(side)))
    return np.c_[x, y, 0.1 * x * y].astype(float)


def adjusted(points, chosen, sigma=None):
    """The adjusted surface over the chosen points, without a change of its triangles."""
    tin = build_tin(points[chosen])
    tin = dataclasses.replace(tin, source=np.asarray(chosen)[tin.source])
    return adjust_rms(tin, points, sigma)


def test_gradients_against_differences_in_all_directions():
    points, sigma = cloud(), np.random.default_rng(1).uniform(0.5, 2.0, 120)
    chosen = np.arange(30)
    a = adjusted(points, chosen, sigma)
    rng = np.random.default_rng(2)
    g = rng.normal(size=(30, 2, 3))
    G = raw_gradients(a.tin, a.fit, g, len(points))

    def value(p):
        tin = dataclasses.replace(a.tin, vertices=np.c_[p[a.tin.source, :2], a.tin.vertices[:, 2]])
        heights = adjust_rms(tin, p, sigma).tin.vertices
        return np.einsum("nkc,nc->k", g, heights)

    step = 1e-6
    inner = [
        i for i in range(4, 120, 5)
    ]  # the corners may not move: a point on the hull would leave it
    for i in inner:
        for c in range(3):
            up, down = points.copy(), points.copy()
            up[i, c] += step
            down[i, c] -= step
            assert G[i, :, c] == pytest.approx(
                (value(up) - value(down)) / (2 * step), rel=2e-4, abs=2e-5
            )
    assert G[:, :, 2] == pytest.approx(
        raw_gradient(a.tin, a.fit, g[:, :, 2], len(points)), abs=1e-12
    )


def test_a_common_shift_moves_the_result_as_the_vertices_do():
    points = cloud(seed=3)
    a = adjusted(points, np.arange(25))
    g = np.random.default_rng(4).normal(size=(25, 1, 3))
    G = raw_gradients(a.tin, a.fit, g, len(points))
    assert G.sum(axis=0)[0] == pytest.approx(g.sum(axis=0)[0], abs=1e-9)


def test_vertices_without_data_and_artificial_ones():
    points = cloud(seed=5)
    tin = build_tin(points[:40])
    far = np.flatnonzero(tin.vertices[:, 0] > 5.0)
    mask = ~np.isin(tin.triangles, far).any(axis=1)
    tin = dataclasses.replace(
        tin, relevant=mask, source=np.where(tin.source == far[0], -1, tin.source)
    )
    a = adjust_rms(tin, points)
    held = np.flatnonzero(~a.fit.adjusted)
    assert set(far) <= set(held)
    g = np.random.default_rng(6).normal(size=(40, 1, 3))
    G = raw_gradients(a.tin, a.fit, g, len(points))
    for v in held:
        if tin.source[v] >= 0:
            assert G[tin.source[v], 0] == pytest.approx(g[v, 0], abs=1e-12)
    C = height_covariance(a.tin, a.fit, np.full(40, 7.0)).toarray()
    assert np.diag(C)[held] == pytest.approx(np.full(len(held), 7.0)) and not np.any(
        C[held] - np.diag(np.diag(C))[held]
    )


@pytest.mark.parametrize(
    "points,chosen",
    [(cloud(seed=7), np.arange(30)), (grid(), np.arange(0, 81, 2)), (grid(5), np.arange(25))],
)
def test_covariances_of_edges_are_those_of_the_dense_inverse(points, chosen):
    sigma = np.random.default_rng(8).uniform(0.5, 2.0, len(points))
    a = adjusted(points, chosen, sigma)
    B = a.fit.B.toarray()
    dense = np.linalg.inv((B.T * a.fit.weight) @ B)
    C = height_covariance(a.tin, a.fit, np.zeros(len(chosen))).toarray()
    joined = np.eye(len(chosen), dtype=bool)
    for i, j, k in a.tin.triangles:
        joined[[i, j, k, j, k, i], [j, k, i, i, j, k]] = True
    assert C[joined] == pytest.approx(dense[joined], rel=1e-8, abs=1e-9) and not C[~joined].any()


def test_the_selected_inverse_is_that_of_a_dense_matrix():
    rng = np.random.default_rng(9)
    n = 12
    L = np.tril(rng.normal(size=(n, n)), -1)
    d = rng.uniform(1, 2, n)
    start = np.cumsum([0, *(n - 1 - j for j in range(n))]).astype(np.int64)
    row = np.concatenate([np.arange(j + 1, n) for j in range(n)]).astype(np.int64)
    value = np.concatenate([L[j + 1 :, j] for j in range(n)])
    off, own = selected_inverse(start, row, value, d)
    full = np.linalg.inv((L + np.eye(n)) @ np.diag(d) @ (L + np.eye(n)).T)
    assert own == pytest.approx(np.diag(full), rel=1e-6)
    i, j = np.tril_indices(n, -1)
    assert entries(start, row, off, j, i) == pytest.approx(full[i, j], rel=1e-5, abs=1e-9)
    assert entries(np.zeros(3, np.int64), row[:0], off[:0], np.array([0]), np.array([1])) == 0.0


def test_slopes_of_planes_and_slivers():
    tin = build_tin(np.array([[0, 0, 0], [4, 0, 2], [4, 3, 5], [0, 3, 3]], float))
    assert triangle_slopes(tin, tin.vertices[:, 2]) == pytest.approx(np.tile([0.5, 1.0], (2, 1)))
    flat = dataclasses.replace(
        tin, vertices=np.c_[tin.vertices[:, :1], np.zeros(4), tin.vertices[:, 2]]
    )
    assert not triangle_slopes(flat, flat.vertices[:, 2]).any()
    fit = fit_of(tin, tin.vertices)
    assert set(fit.triangle.tolist()) <= {0, 1}
