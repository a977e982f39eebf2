"""Heights between vertices: closed forms of their variance, and sampling."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.tin.locate import interpolate_heights
from ladar_volume.tin.represent import represent

TRIANGLE = np.array([(0.0, 0.0, 1.0), (6.0, 0.0, 4.0), (0.0, 3.0, -2.0)])


def test_variance_at_centroid_edge_and_vertex():
    tin, C = build_tin(TRIANGLE), sparse.csr_array(0.04 * np.eye(3))
    found = interpolate_heights(tin, np.array([(2.0, 1.0), (3.0, 0.0), (0.0, 3.0), (9.0, 9.0)]), C)
    assert found.height_m[:3] == pytest.approx([1.0, 2.5, -2.0])
    assert found.sigma_m[:3] ** 2 == pytest.approx([0.04 / 3, 0.04 / 2, 0.04])
    assert np.isnan(found.height_m[3]) and np.isnan(found.sigma_m[3]) and found.triangle[3] == -1


def test_the_published_factor_is_the_mean_over_a_triangle():
    # Zhu et al. (2005), equation 4 of seed 004: half of the variance of the nodes
    rng = np.random.default_rng(4)
    a, b = rng.random((2, 20_000))
    flip = a + b > 1.0
    a, b = np.where(flip, 1.0 - a, a), np.where(flip, 1.0 - b, b)
    xy = np.c_[6.0 * a, 3.0 * b]
    C = sparse.csr_array(np.eye(3))
    found = interpolate_heights(build_tin(TRIANGLE), xy, C)
    assert np.nanmean(found.sigma_m**2) == pytest.approx(0.5, abs=0.005)


def test_adjusted_heights_against_sampling():
    rng = np.random.default_rng(5)
    xy = rng.uniform(0.0, 10.0, (400, 2))
    places, sigma = rng.uniform(2.0, 8.0, (20, 2)), 0.05
    options = SurfaceParameters(ratio=0.1, criterion="residual")

    def surface(z):
        return represent(np.c_[xy, z], options, np.full(len(xy), sigma))

    flat = 0.1 * xy[:, 0] + 0.02 * (xy[:, 1] - 5.0) ** 2
    made = surface(flat)
    printed = interpolate_heights(made.tin, places, made.covariance(np.full(len(xy), sigma)))
    # the same vertices, other noise: through the adjustment's own derivative
    fit_rows = np.zeros((len(made.tin.vertices), len(places), 3))
    corner = made.tin.triangles[printed.triangle]
    weight = np.array(
        [
            np.linalg.solve(np.c_[made.tin.vertices[c, :2], np.ones(3)].T, [*p, 1.0])
            for c, p in zip(corner, places, strict=True)
        ]
    )
    for k in range(len(places)):
        fit_rows[corner[k], k, 2] = weight[k]
    raw = made.by_points(fit_rows, len(xy))[..., 2]
    drawn = sigma * rng.normal(size=(4000, len(xy))) @ raw
    assert printed.sigma_m == pytest.approx(drawn.std(axis=0), rel=0.06)


def test_without_noise_there_is_no_sigma():
    found = interpolate_heights(build_tin(TRIANGLE), np.array([(1.0, 1.0)]))
    assert found.height_m[0] == pytest.approx(0.5) and np.isnan(found.sigma_m[0])
