"""Predicted against empirical variance over many surveys at once: islands out of each other's reach
are independent surveys.
"""

import numpy as np
import pytest

ISLANDS, PER_VOXEL, SIGMA = 1500, 16, 0.01
SLOPE = np.array([0.2, -0.1])


def surveys(scene, degree, seed):
    """Islands of 3 x 3 voxels every 4 m; noise isotropic, so the surface may tilt."""
    rng = np.random.default_rng(seed)
    side = int(np.ceil(np.sqrt(ISLANDS)))
    at = np.stack(np.divmod(np.arange(ISLANDS), side), axis=1) * 4.0
    # corners on voxel borders: equally many points in each voxel
    cell = np.stack(np.meshgrid(np.arange(3), np.arange(3)), -1).reshape(-1, 2) * 0.5
    xy = at[:, None, None] + cell[None, :, None] + rng.uniform(0, 0.5, (ISLANDS, 9, PER_VOXEL, 2))
    xy = xy.reshape(-1, 2)
    local = xy - np.repeat(at, 9 * PER_VOXEL, axis=0)
    r = np.column_stack([xy, 0.1 + local @ SLOPE]) + SIGMA * rng.normal(size=(len(xy), 3))
    _, update = scene.filtered(scene.mapped(r, variance=SIGMA**2), degree=degree, trials=15)
    return update, at


def heights(points, at, island):
    """Distance of filtered points from the true plane along its normal (n,) m."""
    local = points.r_map[:, :2] - at[island]
    return (points.r_map[:, 2] - 0.1 - local @ SLOPE) / np.sqrt(1 + SLOPE @ SLOPE)


def mean_variances(update, weights, patch_island):
    """Variance of each island's weighted sum, with cross blocks and without."""
    p = update.patches
    a = np.repeat(np.arange(len(p)), np.diff(p.cross_start))
    b = np.searchsorted(p.key, p.cross_key)
    assert np.array_equal(p.key[b], p.cross_key)
    assert np.array_equal(patch_island[a], patch_island[b])
    term = np.einsum("ni,nij,nj->n", weights[a], p.cross, weights[b])
    exact = np.bincount(patch_island[a], np.where(a == b, 1, 2) * term, ISLANDS)
    return exact, np.bincount(patch_island[a], np.where(a == b, term, 0), ISLANDS)


@pytest.mark.parametrize("degree", [1, 2])
def test_predicted_variance_is_the_empirical_one(scene, degree):
    update, at = surveys(scene, degree, seed=20 + degree)
    p, q = update.patches, update.points
    side = int(np.ceil(np.sqrt(ISLANDS)))
    patch_island = (np.round((p.centre[:, :2] - 0.75) / 4.0).astype(int) * [side, 1]).sum(axis=1)
    patch = np.searchsorted(p.key, q.patch)
    island = patch_island[patch]
    error = heights(q, at, island)

    # single points: some 50 000, of which those of one island are alike
    ratio = np.mean(error**2 / q.variance)
    spread = np.std(np.bincount(island, error**2 / q.variance) / np.bincount(island)) / np.sqrt(
        ISLANDS
    )
    assert spread < 0.03
    assert 0.9 < ratio < 1.1

    # the mean height of each survey: 1500 draws of a chi-square with one degree, so the ratio's sd
    # is 3.7 %
    n = np.bincount(island, minlength=ISLANDS)
    assert n.min() > 10
    rows = np.stack([np.ones(len(q)), *q.local.T], axis=1)
    if degree == 2:
        u, v = q.local.T
        rows = np.column_stack([rows, u * u, u * v, v * v])
    weights = np.zeros((len(p), rows.shape[1]))
    np.add.at(weights, patch, rows / n[island][:, None])
    exact, naive = mean_variances(update, weights, patch_island)
    mean = np.bincount(island, error, ISLANDS) / n
    assert 0.9 < np.mean(mean**2 / exact) < 1.1
    assert abs(mean.mean()) < 4 * np.sqrt(exact.mean() / ISLANDS)  # no bias
    # without the cross blocks the same surveys refute the prediction
    assert np.mean(mean**2 / naive) > 1.5


def test_printed_sigma_is_the_noise(scene):
    update, _ = surveys(scene, 2, seed=30)
    assert np.sqrt(np.mean(update.patches.sigma**2)) == pytest.approx(SIGMA, rel=0.03)
