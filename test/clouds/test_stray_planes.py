"""Strays beside planes of least sizes: the kernel against plain NumPy, point by point."""

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.clouds import cloud_cleaning as c
from ladar_volume.model.records import F64


def plain_plane(d: F64, weight: F64) -> F64:
    """Height and slopes of a plane of least weighted squares, with the kernel's ridge."""
    X = np.c_[np.ones(len(d)), d[:, :2]]
    N = X.T @ (weight[:, None] * X)
    N[[1, 2], [1, 2]] += 1e-6 * (N[1, 1] + N[2, 2]) + 1e-300
    out: F64 = np.linalg.solve(N, X.T @ (weight * d[:, 2]))
    return out


def plain_stray(d: F64, sigma: float, isolated: bool) -> bool:
    """Whether the origin is a stray beside points (m, 3)."""
    if not isolated and abs(plain_plane(d, np.ones(len(d)))[0]) <= c.AGREE * sigma:
        return False
    X = np.c_[np.ones(len(d)), d[:, :2]]
    beta = np.array([np.median(d[:, 2]), 0.0, 0.0])
    for _ in range(c.STEPS + 1):
        off = d[:, 2] - X @ beta
        level, spread = beta[0], max(1.4826 * float(np.median(np.abs(off))), sigma)
        beta = plain_plane(d, 1.0 / np.maximum(np.abs(off), 0.3 * spread))
    if np.count_nonzero(np.abs(off + level) <= c.AGREE * spread) >= c.OWN:
        return False
    if isolated:
        return bool(abs(level) > c.OFF_ISOLATED * spread)
    agree = np.count_nonzero(np.abs(off) <= c.AGREE * spread) >= c.MAJORITY * len(d)
    return bool(abs(level) > c.OFF * spread and agree)


def test_strays_beside_planes_are_those_of_plain_numpy() -> None:
    rng = np.random.default_rng(3)
    xy = rng.uniform(0.0, 10.0, (3000, 2))
    r = np.c_[xy, 0.3 * xy[:, 0] + np.maximum(0.0, xy[:, 1] - 5.0) + rng.normal(0, 0.01, 3000)]
    r[::37, 2] += rng.normal(0.0, 0.4, len(r[::37]))
    r[1::50, 2] += 0.07
    isolated = rng.random(3000) < 0.05
    limits = np.array([c.OFF_ISOLATED, c.OFF, c.AGREE, c.MAJORITY, c.OWN])
    cloud = c.Cloud(r, r * [1.0, 1.0, 0.0], isolated, 0.01, limits)
    good = ~isolated
    found, far = c.beside_planes(cloud, good, np.arange(3000), None)
    rows = np.flatnonzero(good)
    away, near = cKDTree(xy[rows]).query(xy, c.PLANE + 1)
    wanted = [
        plain_stray(r[rows[k][rows[k] != i]] - r[i], 0.01, bool(isolated[i]))
        for i, k in enumerate(near)
    ]
    assert 60 < np.count_nonzero(wanted) < 300
    np.testing.assert_array_equal(found, wanted)
    np.testing.assert_allclose(far, away[:, -1], rtol=1e-12)


def test_a_point_far_from_all_others_is_a_stray_at_any_height() -> None:
    """In the plane of the ground, too, where no plane tells it apart."""
    rng = np.random.default_rng(4)
    r = np.c_[rng.uniform(-2.0, 2.0, (600, 2)), rng.normal(0.0, 0.004, 600)]
    alone = c.clean(r)
    for far in ([0.8, 4.3e9, 0.002], [-5e6, 0.0, 0.0], [0.5, 0.5, -9999.0]):
        found = c.clean(np.vstack([r[:300], far, r[300:]]))
        assert 300 in found.strays
        assert found.isolated_count == alone.isolated_count + 1
        rest = found.kept[found.kept != 300]
        np.testing.assert_array_equal(np.where(rest > 300, rest - 1, rest), alone.kept)
