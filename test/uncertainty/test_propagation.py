"""The propagation against dense matrices, built the slow way from raw points that patches share."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from random_surfaces import BEAMS, COLUMNS, random_surface
from volume_surfaces import by_position_and_attitude

from ladar_volume.georeference.error_budget import calibration_columns
from ladar_volume.model.errors import VolumeError
from ladar_volume.uncertainty.propagation import (
    calibration_groups,
    calibration_sensitivity,
    calibration_variance,
    design_rows,
    independent_covariance,
    navigation_sensitivity,
    patch_loads,
    surface_geometry,
    tangential_variance,
)


def dense_map(points, patches, row):
    """How all point coordinates (3 n) follow from all patch parameters (m p)."""
    p = patches.beta.shape[1]
    B = np.zeros((3 * len(points), len(patches) * p))
    X = design_rows(points.local, p)
    for i in range(len(points)):
        B[3 * i : 3 * i + 3, row[i] * p : (row[i] + 1) * p] = np.outer(patches.normal[row[i]], X[i])
    return B


def movements(points, patches, row):
    """How all point coordinates (3 n) move with the parameters of all patches and their places
    along tangent and binormal, m (p + 2).
    """
    p, m = patches.beta.shape[1], len(patches)
    B = dense_map(points, patches, row).reshape(-1, m, p)
    places = np.zeros((3 * len(points), m, 2))
    for i in range(len(points)):
        places[3 * i : 3 * i + 3, row[i], 0] = patches.tangent[row[i]]
        places[3 * i : 3 * i + 3, row[i], 1] = np.cross(
            patches.normal[row[i]], patches.tangent[row[i]]
        )
    return np.concatenate([B, places], axis=2).reshape(len(B), -1)


@pytest.mark.parametrize("p", [3, 6])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_every_part_equals_the_dense_oracle(p, seed):
    points, patches, dense, row = random_surface(p, seed=seed)
    gradient = np.random.default_rng(seed + 10).standard_normal((len(points), 2, 3))
    B = dense_map(points, patches, row)
    g = gradient.transpose(1, 0, 2).reshape(2, -1)
    geometry = surface_geometry(points, patches)
    assert (geometry.right >= 0).all()
    q = patch_loads(gradient, patches, geometry)
    assert independent_covariance(q, patches, geometry) == pytest.approx(
        g @ B @ dense @ B.T @ g.T, rel=1e-10
    )
    M, moved = patches.M_cal.reshape(-1, COLUMNS), movements(points, patches, row)
    assert calibration_sensitivity(q[:, :, 0], patches) == pytest.approx(
        g[0] @ moved @ M, rel=1e-10, abs=1e-12
    )
    J, bins = navigation_sensitivity(np.ascontiguousarray(q[:, :, 0]), patches)
    owner = np.repeat(np.arange(len(patches)), np.diff(patches.nav_start))
    M_nav = by_position_and_attitude(patches)
    for b, value in zip(bins, J, strict=True):
        M = np.zeros((len(patches), p + 2, 6))
        for entry in np.flatnonzero(patches.nav_bin == b):
            M[owner[entry]] += M_nav[entry]
        assert value == pytest.approx(g[0] @ moved @ M.reshape(-1, 6), rel=1e-9, abs=1e-12)
    t = points.C_tangent.astype(float)[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
    assert tangential_variance(gradient[:, 0], points) == pytest.approx(
        sum(g @ C @ g for g, C in zip(gradient[:, 0], t, strict=True)), rel=1e-10
    )


def test_cross_blocks_matter_and_missing_neighbours_are_counted():
    points, patches, _, _ = random_surface()
    gradient = np.abs(np.random.default_rng(3).standard_normal((len(points), 1, 3)))
    geometry = surface_geometry(points, patches)
    q = patch_loads(gradient, patches, geometry)
    unknown = patches.cross_key.copy()
    unknown[1] = 5000
    right = surface_geometry(points, dataclasses.replace(patches, cross_key=unknown)).right
    assert np.count_nonzero(right < 0) == 1
    alone = dataclasses.replace(
        geometry,
        right=np.where(geometry.block_rows == geometry.right, geometry.right, np.int32(-1)),
    )
    assert independent_covariance(q, patches, alone)[0, 0] != pytest.approx(
        independent_covariance(q, patches, geometry)[0, 0], rel=0.05
    )


def test_calibration_lines_add_up():
    rng = np.random.default_rng(4)
    J, variances = rng.standard_normal(COLUMNS), rng.uniform(0.1, 1, COLUMNS)
    groups = calibration_groups(COLUMNS)
    assert sorted(np.concatenate(list(groups.values())).tolist()) == list(range(COLUMNS))
    names = calibration_columns(BEAMS)
    assert [names[i] for i in groups["boresight"]] == ["boresight_x", "boresight_y", "boresight_z"]
    assert len(groups["beam_range"]) == len(groups["beam_vertical"]) == BEAMS
    lines = calibration_variance(J, np.diag(variances))
    assert sum(lines.values()) == pytest.approx(float(J @ np.diag(variances) @ J), rel=1e-12)
    A = rng.standard_normal((COLUMNS, COLUMNS))
    assert calibration_variance(J, A @ A.T) == {
        "calibration": pytest.approx(float(J @ A @ A.T @ J))
    }
    for sign in (1.0, -1.0):  # of two groups
        block = np.diag(variances)
        block[0, -1] = block[-1, 0] = sign * 0.05
        assert list(calibration_variance(J, block)) == ["calibration"]
    block = np.diag(variances)
    block[1, 2] = block[2, 1] = 0.05  # within one group: still a line per group
    assert set(calibration_variance(J, block)) == set(groups)


def test_refusals():
    with pytest.raises(VolumeError):
        calibration_variance(np.ones(COLUMNS), np.eye(COLUMNS - 2))
    with pytest.raises(VolumeError):
        calibration_groups(12)
    points, patches, _, _ = random_surface()
    with pytest.raises(VolumeError, match="not 4"):
        surface_geometry(points, dataclasses.replace(patches, beta=np.zeros((len(patches), 4))))


def test_sensitivities_of_another_shape_are_refused():
    points, patches, _, _ = random_surface()
    for name in ("M_cal", "M_nav"):
        short = dataclasses.replace(patches, **{name: getattr(patches, name)[:, :-2]})
        with pytest.raises(VolumeError) as refused:
            surface_geometry(points, short)
        assert refused.value.reason == "volume_patches" and "not 5" in str(refused.value)
