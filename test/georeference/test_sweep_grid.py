"""The grid of a sweep: its rings between returns, and its normals, of planes in closed form."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ladar_volume.georeference import sweep_turns
from ladar_volume.georeference.sweep_turns import (
    CELL_RAD,
    CELLS,
    COMMON,
    STEP,
    Sweep,
    grid_normals,
    ring_profile,
    shift_about_axis,
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


def only_ranges(log_range, seen):
    points = np.zeros((*seen.shape, 3))
    return Sweep(0.0, points, points, log_range * seen, seen, seen > 2.0)


@pytest.mark.parametrize("cells", [0, 1, 40, CELLS // 2 - 1, CELLS - 40, CELLS - 1])
def test_what_is_seen_further_round_is_seen_by_a_scanner_turned_back(cells):
    rng = np.random.default_rng(2)
    log_range, seen = rng.normal(1.0, 0.3, (4, CELLS)), (rng.random((4, CELLS)) < 0.8) * 1.0
    old = only_ranges(log_range, seen)
    new = only_ranges(np.roll(log_range, cells, axis=1), np.roll(seen, cells, axis=1))
    found = shift_about_axis(old, new)
    expected = cells if cells < CELLS / 2 else cells - CELLS
    assert found == pytest.approx(-expected * CELL_RAD)


def test_sweeps_that_have_little_in_common_tell_no_turn():
    rng = np.random.default_rng(3)
    log_range, half = rng.normal(size=(2, CELLS)), np.zeros((2, CELLS))
    for share, told in ((0.98 * COMMON, False), (1.02 * COMMON, True)):
        half[:] = 0.0
        half[:, : round(share * CELLS)] = 1.0
        old, new = only_ranges(log_range, half), only_ranges(log_range, half)
        assert (shift_about_axis(old, new) is not None) == told


def test_arotation_vector_is_that_of_the_matrix():
    rng = np.random.default_rng(4)
    turns = rng.normal(size=(200, 3))
    turns *= (rng.uniform(0.0, 3.1, 200) / np.linalg.norm(turns, axis=1))[:, None]
    for turn in (*turns, np.zeros(3), np.array([1e-9, 0.0, -2e-9])):
        R = Rotation.from_rotvec(turn).as_matrix()
        np.testing.assert_allclose(sweep_turns.rotation_vector(R), turn, rtol=1e-7, atol=1e-15)


def test_a_step_towards_planes_turns_and_shifts_what_lies_off_them():
    """Points on three walls, seen again by a scanner that turned and moved a little."""
    rng = np.random.default_rng(5)
    rings = 16
    e = np.linspace(-0.6, 0.6, rings)[:, None]
    beam = np.stack(
        [np.cos(e) * np.cos(CENTRES), np.cos(e) * np.sin(CENTRES), np.sin(e) + 0.0 * CENTRES],
        axis=2,
    )
    points = beam / np.max(np.abs(beam) / [3.0, 2.5, 1.2], axis=2)[:, :, None]  # in a box
    seen = np.ones((rings, CELLS))
    normals, flat = grid_normals(points, seen)
    old = Sweep(0.0, points, normals, np.zeros_like(seen), seen, flat)
    turn, shift = rng.normal(0.0, 2e-3, 3), rng.normal(0.0, 5e-3, 3)
    R = Rotation.from_rotvec(turn)
    rows, cells = np.nonzero(flat)
    moved = R.inv().apply(points[rows, cells] - shift)
    kept, step = sweep_turns.plane_step(moved, rows, old, np.eye(3), np.zeros(3))
    np.testing.assert_allclose(step, [*turn, *shift], atol=3e-4)
    rest = np.abs(((moved - points[rows, cells]) * normals[rows, cells]).sum(axis=1))
    assert kept >= 0.9 * np.count_nonzero(rest < sweep_turns.IN_PLANE_M)
    few = np.arange(sweep_turns.PAIRS)
    for count, told in ((len(few) - 1, False), (len(few), True)):
        some = points[rows, cells][few[:count]]
        found = sweep_turns.plane_step(some, rows[:count], old, np.eye(3), np.zeros(3))
        assert (found is not None) == told
