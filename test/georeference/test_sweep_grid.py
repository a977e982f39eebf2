"""The grid of a sweep: its rings between returns, and its normals, of planes in closed form."""

import math

import numpy as np
import pytest

from ladar_volume.georeference.sweep_turns import (
    CELL_RAD,
    CELLS,
    STEP,
    grid_normals,
    ring_profile,
)

CENTRES = (np.arange(CELLS) + 0.5) * CELL_RAD - math.pi


def on_plane(elevations, normal, offset):
    """Grid (rings, CELLS, 3) of beams that meet a plane; seen where they do, in front."""
    e, a = np.asarray(elevations)[:, None], CENTRES[None]
    beam = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e) + 0.0 * a], axis=2)
    along = beam @ normal
    seen = along > 0.2
    return beam * (offset / np.where(seen, along, 1.0))[:, :, None] * seen[:, :, None], 1.0 * seen


@pytest.mark.parametrize("rings", [2, 3, 6])
def test_normals_of_a_plane_are_its_own_but_for_the_outer_rings(rings):
    normal = np.array([0.8, 0.36, -0.48])
    points, seen = on_plane(np.linspace(-0.2, 0.2, rings), normal, 4.0)
    normals, flat = grid_normals(points, seen)
    assert not flat[[0, -1]].any() and flat.shape == (rings, CELLS)
    sides = seen * np.roll(seen, 2, axis=1) * np.roll(seen, -2, axis=1) > 0.0
    expected = np.zeros_like(flat)
    expected[1:-1] = sides[1:-1] & (seen[2:] * seen[:-2] > 0.0)
    np.testing.assert_array_equal(flat, expected)
    assert flat.any() == (rings > 2)
    found = normals[flat]
    np.testing.assert_allclose(np.abs(found @ normal), 1.0, atol=1e-9)


@pytest.mark.parametrize(("off_m", "held"), [(0.085, True), (0.095, False)])
def test_a_point_off_the_plane_of_its_neighbours_is_not_flat(off_m, held):
    """By more than 5 cm and a hundredth of its distance, here 4 m and a little."""
    points, seen = on_plane([-0.1, 0.0, 0.1], np.array([1.0, 0.0, 0.0]), 4.0)
    at = int(np.argmin(np.abs(CENTRES)))
    points[1, at, 0] -= off_m
    assert grid_normals(points, seen)[1][1, at] == held


def test_a_sliver_of_a_plane_has_no_normal():
    """Seen along its surface: neighbours beside and above lie nearly in line."""
    points, seen = on_plane([-0.1, 0.0, 0.1], np.array([1.0, 0.0, 0.0]), 4.0)
    across = np.roll(points, -2, axis=1)[1] - np.roll(points, 2, axis=1)[1]
    for share, held in ((0.05, False), (0.3, True)):
        tilted = points.copy()
        up = across + share * np.array([0.0, 0.0, 1.0]) * np.linalg.norm(across, axis=1)[:, None]
        tilted[0], tilted[2] = points[1] - up, points[1] + up
        at = int(np.argmin(np.abs(CENTRES)))
        assert grid_normals(tilted, seen)[1][1, at] == held


def ring(azimuth, length):
    return np.column_stack([length * np.cos(azimuth), length * np.sin(azimuth), 0.0 * azimuth])


def test_a_ring_is_read_along_the_chords_of_its_returns_all_around():
    rng = np.random.default_rng(1)
    azimuth = np.sort(rng.uniform(-math.pi, math.pi, 4 * CELLS))
    length = 5.0 + np.sin(2.0 * azimuth)
    points, seen = ring_profile(azimuth, ring(azimuth, length))
    there = seen > 0.0
    assert there.mean() > 0.95
    # as far along as the cell lies between the two, and on their chord
    a = np.concatenate([azimuth - 2.0 * math.pi, azimuth, azimuth + 2.0 * math.pi])
    r = np.tile(ring(azimuth, length), (3, 1))
    for k in range(3):
        expected = np.interp(CENTRES, a, r[:, k])
        np.testing.assert_allclose(points[there, k], expected[there], atol=1e-9)
    assert not points[~there].any()


def test_a_gap_and_a_step_between_returns_are_not_bridged():
    azimuth = CENTRES.copy()
    whole = ring_profile(azimuth, ring(azimuth, np.full(CELLS, 5.0)))[1]
    assert whole.all()
    middle = CELLS // 2
    for cells, seen in ((2, True), (4, False)):  # gaps of three cells and of five
        kept = np.ones(CELLS, bool)
        kept[middle : middle + cells] = False
        found = ring_profile(azimuth[kept], ring(azimuth[kept], np.full(kept.sum(), 5.0)))[1]
        assert found[middle : middle + cells].all() == seen
    off = azimuth + 0.5 * CELL_RAD
    for times, seen in ((0.99 * STEP, True), (1.01 * STEP, False)):
        length = np.where(np.arange(CELLS) < middle, 5.0, 5.0 * times)
        found = ring_profile(off, ring(off, length))[1]
        assert (found[middle] > 0.0) == seen and found[middle + 3] > 0.0
