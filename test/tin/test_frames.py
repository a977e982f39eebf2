"""Frames along a scan direction: rotations, degenerate directions, and a direction found from
points alone.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from ladar_volume.model.errors import SurfaceError
from ladar_volume.tin.full_tin import build_tin, footprint_areas
from ladar_volume.tin.scan_frame import frame_along, mean_direction, mesh_cost, search_direction

SCANNER = np.array([3.6, 3.3, 2.2])


def corner_scan(n=40, seed=0):
    """Returns from two walls and a floor on a regular angular grid, seen by a scanner in front of
    the corner.
    """
    rng = np.random.default_rng(seed)
    az, el = np.meshgrid(
        np.linspace(3.25, 4.6, 2 * n) + 1e-3 * rng.random(),
        np.linspace(-1.0, -0.05, n) + 1e-3 * rng.random(),
    )
    u = np.stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)], axis=-1).reshape(
        -1, 3
    )
    with np.errstate(divide="ignore"):
        t = np.min(np.where(u < 0, -SCANNER / u, np.inf), axis=1)
    points = SCANNER + t[:, None] * u
    return points[(points[:, 0] < 2) & (points[:, 1] < 2) & (points[:, 2] < 1.7)]


@pytest.mark.parametrize(
    "d", [[1, 2, -3], [0, 0, -1], [0, 0, 1], [-1, 0, 0], [1e-9, 0, -5], [0, -2, 1e-3]]
)
def test_frames_are_rotations_that_look_back(d):
    f = frame_along(np.array(d, float), np.array([10.0, 20, 30]))
    R = f.R_frame_map
    assert R @ R.T == pytest.approx(np.eye(3), abs=1e-14) and np.linalg.det(R) == pytest.approx(1.0)
    assert R @ np.array(d) / np.linalg.norm(d) == pytest.approx([0, 0, -1], abs=1e-14) and R[
        0, 2
    ] == pytest.approx(0.0, abs=1e-8)
    points = np.random.default_rng(0).normal(size=(20, 3))
    assert f.points_to_map(f.points(points)) == pytest.approx(points, abs=1e-13)
    assert f.points(np.array([[10.0, 20, 30]])) == pytest.approx(np.zeros((1, 3)), abs=1e-14)
    g = np.random.default_rng(1).normal(size=(5, 3))
    assert (f.gradients_to_map(g) * points[:5]).sum() == pytest.approx(
        (g * (points[:5] @ R.T)).sum(), rel=1e-12
    )
    C = np.array([np.diag([1.0, 2, 3])])
    assert np.trace(f.covariances(C)[0]) == pytest.approx(6.0) and f.covariances(C)[
        0, 2, 2
    ] == pytest.approx(R[2] @ C[0] @ R[2])


def test_straight_down_is_the_map():
    assert frame_along(np.array([0.0, 0, -1])).R_frame_map == pytest.approx(np.eye(3), abs=0)


def test_a_wall_gets_a_footprint():
    y, z = (a.ravel() for a in np.meshgrid(np.linspace(0, 2, 9), np.linspace(0, 1, 5)))
    wall = np.c_[np.zeros(45), y, z]
    f = frame_along(np.array([-1.0, 0, 0]))
    tin = build_tin(f.points(wall))
    assert footprint_areas(tin.vertices, tin.triangles).sum() == pytest.approx(
        2.0
    ) and tin.vertices[:, 2] == pytest.approx(np.zeros(45), abs=1e-15)
    assert f.tin_to_map(tin).vertices == pytest.approx(wall, abs=1e-15)


def test_mean_direction_and_the_one_found_without_the_scanner():
    points = corner_scan()
    mean = mean_direction(points, SCANNER)
    turned, R = (
        points @ frame_along(np.array([1.0, 2, 3])).R_frame_map.T,
        frame_along(np.array([1.0, 2, 3])).R_frame_map,
    )
    assert mean_direction(turned, R @ SCANNER) == pytest.approx(R @ mean, abs=1e-12)
    found = search_direction(points)
    assert np.linalg.norm(found) == pytest.approx(1.0) and mesh_cost(points, found) <= mesh_cost(
        points, mean
    )
    # nothing hides anything here: many directions see floor and walls from the front, and one of
    # them is found
    assert (found < 0.0).all() and math.degrees(math.acos(min(1.0, found @ mean))) < 20.0
    assert mesh_cost(points, mean) < mesh_cost(points, np.array([0.0, 0, -1]))


@pytest.mark.parametrize("d", [[0, 0, 0], [np.nan, 0, 1], [np.inf, 0, 0], [1, 0], 3.0])
def test_no_direction(d):
    with pytest.raises(SurfaceError) as caught:
        frame_along(np.array(d, float))
    assert caught.value.reason == "surface_direction"


def test_bad_clouds():
    around = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1.0]])
    for points, reason in (
        (around, "surface_direction"),
        (np.zeros((1, 3)), "surface_direction"),
        (np.zeros((0, 3)), "surface_too_few_points"),
        (np.zeros((3, 2)), "surface_shape"),
        (np.full((1, 3), np.nan), "surface_not_finite"),
    ):
        with pytest.raises(SurfaceError) as caught:
            mean_direction(points, np.zeros(3))
        assert caught.value.reason == reason
    with pytest.raises(SurfaceError) as caught:
        search_direction(around[:3])
    assert caught.value.reason == "surface_too_few_points"
    assert mesh_cost(np.c_[np.arange(5.0), np.zeros((5, 2))], np.array([0, 0, -1.0])) == math.inf
