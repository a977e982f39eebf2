"""The cells of the map of more data, and what each of them holds, in closed form."""

import math

import numpy as np
import pytest
from scipy.spatial import cKDTree

from ladar_volume.tin.full_tin import build_tin
from ladar_volume.volume.more_data import (
    CELLS,
    GAP,
    MoreData,
    beyond_chord,
    cell_gaps,
    cell_means,
    gap_sigmas,
    longest_edges,
    map_cells,
    middles,
    sum_by_label,
)


def test_cells_are_squares_over_what_counts_and_each_point_is_in_its_own():
    rng = np.random.default_rng(1)
    xy = rng.uniform([100.0, 50.0], [140.0, 60.0], (3000, 2))
    counts = rng.random(3000) < 0.7
    label, middle, side = map_cells(xy, counts)
    low, high = xy[counts].min(axis=0), xy[counts].max(axis=0)
    assert side == pytest.approx(math.sqrt(np.prod(high - low)) / CELLS)
    assert (np.abs(xy - middle[label]) <= 0.5 * side * (1.0 + 1e-9)).all()
    corner = (middle - 0.5 * side - low) / side
    np.testing.assert_allclose(corner, np.rint(corner), atol=1e-6)
    assert len(np.unique(np.rint(corner), axis=0)) == len(middle) == len(np.unique(label))


def test_cells_of_a_line_are_its_length_over_the_square_of_their_number():
    xy = np.column_stack([np.linspace(0.0, 90.0, 200), np.zeros(200)])
    label, middle, side = map_cells(xy, np.ones(200, bool))
    assert side == pytest.approx(90.0 / CELLS**2)
    assert (np.abs(xy - middle[label]) <= 0.5 * side * (1.0 + 1e-9)).all()


def test_sums_and_means_by_cell():
    cell, value = np.array([2, 0, 2, 2]), np.array([1.0, 5.0, 2.0, 6.0])
    assert cell_means(cell, value, 4).tolist() == [5.0, 0.0, 3.0, 0.0]
    rows = np.column_stack([value, -2.0 * value])
    assert sum_by_label(cell, rows, 3).tolist() == [[5.0, -10.0], [0.0, 0.0], [9.0, -18.0]]


def test_what_is_not_seen_errs_as_one_in_a_cell_and_has_the_variance_that_is_known_of_all():
    cell, sigma = np.array([0, 0, 2]), np.array([1.0, 2.0, 4.0])
    assert cell_gaps(cell, sigma, 3, 0.0).tolist() == [3.0, 0.0, 4.0]
    scaled = cell_gaps(cell, sigma, 3, 100.0)
    assert scaled.tolist() == pytest.approx([6.0, 0.0, 8.0])
    assert not cell_gaps(cell, 0.0 * sigma, 3, 100.0).any()


def test_edges_and_middles_of_triangles():
    tin = build_tin(np.array([[0.0, 0.0, 1.0], [3.0, 0.0, 4.0], [0.0, 4.0, 7.0]]))
    assert longest_edges(tin, np.array([0])) == pytest.approx([5.0])
    np.testing.assert_allclose(middles(tin, np.array([0])), [[1.0, 4.0 / 3.0, 4.0]])


def test_a_parabola_is_off_its_chords_by_its_bend_and_noise_is_taken_off():
    g = np.arange(-10.0, 11.0)
    xy = np.stack([a.ravel() for a in np.meshgrid(g, g)], axis=1)
    r = np.column_stack([xy, 0.3 * xy[:, 0] ** 2 + 2.0 * xy[:, 1]])
    variance, tree = np.full(len(r), 0.01), cKDTree(xy)
    every = np.arange(len(r))
    found = beyond_chord(r, variance, tree, every, np.array([2.0, 0.0]))
    assert len(found) == 21 * 17  # those two from either edge have a chord
    # 0.3 * 2² below the chord; the noise of one point and of the mean of two
    np.testing.assert_allclose(found, 1.2**2 - 0.01 * 1.5)
    along = beyond_chord(r, variance, tree, every, np.array([0.0, 2.0]))
    np.testing.assert_allclose(along, -0.01 * 1.5, atol=1e-9)
    # neighbours within a fifth of the step count, on a chord that is not halved by the middle
    apart = np.array([[0.0, 0.0, 5.0], [1.15, 0.0, 0.0], [-1.0, 0.0, 2.15], [9.0, 9.0, 0.0]])
    one = beyond_chord(apart, np.zeros(4), cKDTree(apart[:, :2]), every[:1], np.array([1.0, 0.0]))
    np.testing.assert_allclose(one, [(5.0 - 1.15) ** 2])
    far = apart + [[0.0], [0.1], [0.0], [0.0]] * np.array([1.0, 0.0, 0.0])
    none = beyond_chord(far, np.zeros(4), cKDTree(far[:, :2]), every[:1], np.array([1.0, 0.0]))
    assert len(none) == 0


def test_triangles_far_longer_than_usual_span_a_gap_of_the_relief_at_their_length():
    g = np.arange(0.0, 30.0)
    xy = np.stack([a.ravel() for a in np.meshgrid(g, g)], axis=1)
    kept = ~((np.abs(xy - 15.0) < 3.5).all(axis=1))
    xy = xy[kept]
    tin = build_tin(np.column_stack([xy, 0.02 * xy[:, 0] ** 2]))
    rows = np.arange(len(tin.triangles))
    found = gap_sigmas(tin, np.ones(len(rows), bool), rows, np.zeros(len(xy)))
    longest = longest_edges(tin, rows)
    usual = float(np.median(longest))
    np.testing.assert_array_equal(found > 0.0, longest > GAP * usual)
    wide = found > 0.0
    assert wide.any()
    r = tin.vertices[tin.triangles[wide]]
    (a, b), (c, d) = (r[:, 1] - r[:, 0])[:, :2].T, (r[:, 2] - r[:, 0])[:, :2].T
    area = 0.5 * np.abs(a * d - b * c)
    # a parabola along x alone: half way along a chord of length l it is 0.02 (l / 2)² off, in the
    # root mean square of both directions
    expected = area * 0.02 * (longest[wide] / 2.0) ** 2 / math.sqrt(2.0)
    np.testing.assert_allclose(found[wide], expected, rtol=0.35)


def test_the_places_to_fly_are_those_of_the_largest_fall_of_sigma():
    falls = np.array([[0.5, 0.0, 0.0, 0.0], [0.0, 1.0, 2.0, 0.0], [0.0, 0.0, 0.0, 0.0]])
    found = MoreData(np.arange(9.0).reshape(3, 3), np.array([0.1, 0.2, 0.3]), falls, 3.0, 4.0, 1.0)
    total = 25.0
    expected = [5.0 - math.sqrt(total - f) for f in (0.5, 3.0, 0.0)]
    np.testing.assert_allclose(found.gain_m3, expected)
    best = found.best_cells()
    assert [c["x_m"] for c in best] == [3.0, 0.0] and best[0]["gain_m3"] == expected[1]
    assert best[0]["why"] == "attitude" and best[0]["sigma_height_m"] == 0.2
    assert len(found.best_cells(1)) == 1
