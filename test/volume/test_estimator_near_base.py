"""The folded-normal correction in the volume stage: what is left of the bias by simulation, signs,
and the noise vertices share.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from volume_surfaces import platform, surface_update

from ladar_volume.io.results import volume_dict
from ladar_volume.model.parameters import Parameters
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.uncertainty.propagation import design_rows, surface_geometry
from ladar_volume.uncertainty.vertex_noise import (
    MOST_RINGS,
    corner_covariances,
    height_pairs,
    height_sums,
    rings_for,
    vertex_rows,
)
from ladar_volume.volume.estimator import VolumeEstimator
from ladar_volume.volume.folded_normal import PACKED
from ladar_volume.volume.volume_loads import whole_triangles

SIDE = 1.0


def flat(x, y):
    return 0.0 * x


def noisy_update(rng, height=flat, per_patch=2, noise=0.06):
    """An update whose patches err as their covariance says."""
    update = surface_update(
        height, half=6.0, spacing=SIDE / per_patch, per_patch=per_patch, noise=noise
    )
    root = np.linalg.cholesky(update.patches.cross)
    beta = np.einsum("mab,mb->ma", root, rng.standard_normal((len(root), 3)))
    row = np.searchsorted(update.patches.key, update.points.patch)
    along = (design_rows(update.points.local, 3) * beta[row]).sum(axis=1)
    moved = update.points.r_map + along[:, None] * update.points.normal
    return dataclasses.replace(update, points=dataclasses.replace(update.points, r_map=moved))


def estimated(update, level=0.0, **volume):
    p = Parameters.read(
        {
            "filter": {"nav_bin_s": 1.0},
            "volume": {"base": "level", "level_m": level, "outline": "all", **volume},
        }
    )
    e = VolumeEstimator(p)
    e.add_platform(platform())
    e.add(update)
    return e.estimate().volume


@pytest.mark.parametrize("per_patch,ratio,left", [(1, 1.0, 0.25), (2, 1.0, 0.3), (2, 0.5, 0.35)])
def test_flat_ground_at_the_level_is_neither_cut_nor_fill(per_patch, ratio, left):
    rng, rows = np.random.default_rng(3), []
    for _ in range(12):
        v = estimated(noisy_update(rng, per_patch=per_patch), vertex_ratio=ratio)
        rows.append([v.cut_m3 + v.folded_m3, v.cut_m3, v.fill_m3, v.volume_m3])
        assert (
            v.cut_m3 - v.fill_m3 == pytest.approx(v.volume_m3, abs=1e-12)
            and 0.9 < v.near_area_m2 / v.area_m2 <= 1.0
        )
    raw, cut, fill, net = np.mean(rows, axis=0)
    sigma = 0.02  # of a patch' level
    if per_patch == 1:  # every vertex errs alone
        assert raw == pytest.approx(0.28 * sigma * v.area_m2, rel=0.05)
    assert abs(cut) < left * raw and abs(fill) < left * raw and abs(net) < 0.2 * raw


def test_sign_conventions():
    rng = np.random.default_rng(4)
    update = noisy_update(rng, lambda x, y: 0.05 * x)
    up = estimated(update, 0.01)
    turned = update.points.r_map * [1.0, 1.0, -1.0]
    normal = update.points.normal * [-1.0, -1.0, 1.0]
    down = estimated(
        dataclasses.replace(
            update, points=dataclasses.replace(update.points, r_map=turned, normal=normal)
        ),
        -0.01,
    )
    assert up.folded_m3 == pytest.approx(down.folded_m3, rel=1e-9) and up.folded_m3 > 0
    assert (up.cut_m3, up.fill_m3) == pytest.approx((down.fill_m3, down.cut_m3), rel=1e-9)
    facts = volume_dict(up)
    assert (
        facts["correction"]["name"] == "folded normal" and facts["correction"]["m3"] == up.folded_m3
    )
    assert facts["correction"]["cut_raw_m3"] == up.cut_m3 + up.folded_m3
    assert facts["correction"]["fill_raw_m3"] - facts["fill_m3"] == pytest.approx(
        facts["correction"]["m3"], rel=1e-12
    )


def test_far_from_the_base_nothing_is_corrected():
    v = estimated(noisy_update(np.random.default_rng(5)), level=-1.0)
    assert (
        v.folded_m3 == v.near_area_m2 == v.fill_m3 == 0.0
        and volume_dict(v)["correction"]["name"] is None
    )


def test_triangles_that_the_outline_cuts_are_left_alone():
    square = [-2.2, -2.2, 2.2, -2.2, 2.2, 2.2, -2.2, 2.2]
    v = estimated(noisy_update(np.random.default_rng(6)), outline="polygon", polygon_m=square)
    assert v.area_m2 == pytest.approx(4.4**2) and 0.5 * v.area_m2 < v.near_area_m2 < v.area_m2
    tin = build_tin(np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]))
    assert whole_triangles(tin, np.array([0.5, 0.4])).tolist() == [True, False]


def test_covariances_of_vertices_against_dense_ones():
    update = surface_update(lambda x, y: 0.1 * x * y, half=2.0, spacing=0.5)
    patches, points, m = update.patches, update.points, len(update.patches)
    rng = np.random.default_rng(7)
    # every patch shares noise with the next one
    A = rng.normal(size=(3 * m, 3 * m)) * 0.01
    dense = np.zeros((m, 3, m, 3))
    full = (A @ A.T).reshape(m, 3, m, 3)
    for a in range(m):
        for b in (a - 1, a, a + 1):
            if 0 <= b < m:
                dense[a, :, b] = full[a, :, b]
    start = np.concatenate([[0], np.cumsum([2] * (m - 1) + [1])])
    other = np.concatenate([[a, a + 1] for a in range(m)])[:-1]
    own = np.repeat(np.arange(m), np.diff(start))
    patches = dataclasses.replace(
        patches, cross_start=start, cross_key=patches.key[other], cross=dense[own, :, other]
    )
    tin, geometry = build_tin(points.r_map), surface_geometry(points, patches)
    X, row = vertex_rows(tin, points, patches, geometry)
    n = len(tin.vertices)
    by_patch = np.zeros((n, m, 3))
    by_patch[np.arange(n), row] = X
    C = by_patch.reshape(n, -1) @ dense.reshape(3 * m, 3 * m) @ by_patch.reshape(n, -1).T
    chosen = tin.triangles[::2]
    found = height_pairs(tin, patches, geometry, X, row, np.diag(C), chosen).toarray()
    joined = np.eye(n, dtype=bool)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        joined[chosen[:, i], chosen[:, j]] = joined[chosen[:, j], chosen[:, i]] = True
    assert found == pytest.approx(np.where(joined, C, 0.0), rel=1e-12, abs=1e-16)
    corners = corner_covariances(patches, geometry, X, row, np.diag(C), chosen)
    assert corners == pytest.approx(
        np.stack([C[chosen[:, i], chosen[:, j]] for i, j in PACKED], axis=1), rel=1e-12, abs=1e-16
    )
    some = np.arange(0, n, 3)
    sums, alike = height_sums(patches, geometry, X, row, some, np.diag(C))
    assert (
        sums[some] == pytest.approx(np.maximum(C.sum(axis=1), 0.0)[some], rel=1e-9) and alike >= 1.0
    )
    assert sums[1] == pytest.approx(alike * C[1, 1])
    assert (rings_for(1.0), rings_for(4.0), rings_for(1e9)) == (4, 6, MOST_RINGS)
