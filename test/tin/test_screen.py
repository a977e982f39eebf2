"""TINscreen and TINfilter: closed forms first, then invariances, then input that must be
refused.
"""

import numpy as np
import pytest

from ladar_volume.model.errors import SurfaceError
from ladar_volume.tin.delaunay import delaunay
from ladar_volume.tin.median_screen import (
    edges,
    medians_kernel,
    medians_plain,
    neighbour_medians,
    tin_filter,
    tin_screen,
)


def level(n=400, seed=0, height=2.5):
    return np.column_stack([np.random.default_rng(seed).random((n, 2)) * 20.0, np.full(n, height)])


def hexagon(centre_height, heights):
    a = np.arange(6) * (np.pi / 3)
    return np.concatenate(
        [[[0.0, 0.0, centre_height]], np.column_stack([np.cos(a), np.sin(a), heights])]
    )


@pytest.mark.parametrize("spike", [5.0, -5.0])
def test_spikes_on_a_level_are_deleted_or_put_back_whichever_way_they_point(spike):
    points = level()
    spikes = np.array([7, 100, 350])
    points[spikes, 2] += spike
    screened, filtered = tin_screen(points, 0.1), tin_filter(points, 0.1)
    assert screened.outliers.tolist() == filtered.outliers.tolist() == spikes.tolist()
    assert screened.count == 3 and len(screened.points_map) == len(screened.index) == 397
    assert (
        np.array_equal(screened.points_map, points[screened.index])
        and (screened.points_map[:, 2] == 2.5).all()
    )
    assert (
        np.array_equal(filtered.index, np.arange(400)) and (filtered.points_map[:, 2] == 2.5).all()
    )
    assert np.array_equal(filtered.points_map[:, :2], points[:, :2])
    assert points[7, 2] == 2.5 + spike  # the input is left alone


def test_the_median_in_closed_form_odd_and_even():
    points = hexagon(50.0, [1.0, 2.0, 3.0, 10.0, 20.0, 30.0])
    assert neighbour_medians(points)[0] == 6.5
    # a rim vertex has the centre and its two neighbours on the rim
    assert neighbour_medians(points)[1] == 30.0 and neighbour_medians(points)[3] == 10.0
    assert tin_filter(points, 43.0).points_map[0, 2] == 6.5


def test_a_deviation_equal_to_the_tolerance_is_no_outlier():
    points = hexagon(1.5, [1.0] * 6)
    assert tin_screen(points, 0.5).count == 0
    assert tin_screen(points, np.nextafter(0.5, 0.0)).outliers.tolist() == [0]
    assert tin_screen(points, np.inf).count == 0


def test_a_sloping_plane_on_a_grid_is_kept_inside():
    x, y = np.meshgrid(np.arange(20.0), np.arange(15.0))
    points = np.column_stack([x.ravel(), y.ravel(), (2.0 * x - 3.0 * y).ravel()])
    inside = (points[:, 0] > 0) & (points[:, 0] < 19) & (points[:, 1] > 0) & (points[:, 1] < 14)
    # no neighbour on a unit grid is higher or lower by more than a step in each axis; the median of
    # the ring is the height up to half of it
    assert np.abs(neighbour_medians(points) - points[:, 2])[inside].max() <= 2.5
    points[137, 2] += 40.0
    assert tin_screen(points, 6.0).outliers.tolist() == [137]


def test_neighbours_of_a_spike_are_judged_by_the_heights_as_given():
    points = hexagon(9.0, [0.0] * 6)
    filtered = tin_filter(points, 0.5)
    assert filtered.outliers.tolist() == [0] and (filtered.points_map[:, 2] == 0.0).all()


@pytest.mark.parametrize("grid", [False, True])
def test_the_order_of_the_points_changes_nothing(grid):
    rng = np.random.default_rng(1)
    points = level(300, 2)
    if grid:  # every cell is co-circular: the diagonals are free to choose
        points[:, :2] = np.stack(np.meshgrid(np.arange(20.0), np.arange(15.0)), axis=-1).reshape(
            -1, 2
        )
    points[:, 2] = rng.normal(size=300)
    points = np.concatenate([points, points[:40] + np.array([0.0, 0.0, 1.0])])
    order = rng.permutation(len(points))
    one, two = tin_filter(points, 0.8), tin_filter(points[order], 0.8)
    assert 10 < one.count < 330
    assert np.array_equal(one.points_map[order], two.points_map) and np.array_equal(
        one.medians[order], two.medians
    )
    assert np.array_equal(one.outliers, np.sort(order[two.outliers]))


def test_rigid_motion_in_height_and_scale_by_a_power_of_two_change_nothing():
    points = level(200, 3)
    points[:, 2] = np.random.default_rng(4).normal(size=200)
    medians = neighbour_medians(points)
    assert np.array_equal(neighbour_medians(points * 4.0), medians * 4.0)
    np.testing.assert_allclose(
        neighbour_medians(points + np.array([0.0, 0.0, 100.0])), medians + 100.0, rtol=0, atol=1e-12
    )
    np.testing.assert_array_equal(neighbour_medians(points * [1.0, 1.0, -1.0]), -medians)


def test_points_over_one_footprint_are_all_compared_and_all_count_as_neighbours():
    points = hexagon(0.0, [0.0] * 6)
    points = np.concatenate(
        [points, [[0.0, 0.0, 7.0]], [[-0.0, 0.0, 0.25]], [points[1] + [0, 0, 4.0]]]
    )
    medians = neighbour_medians(points)
    assert medians[0] == medians[7] == medians[8] == 0.0  # six zeros and one 4
    # rim vertex 2: centre 0, 7, 0.25; rim 0, 4 and 0
    assert medians[2] == 0.125
    assert tin_screen(points, 1.0).outliers.tolist() == [7, 9]
    same = tin_filter(np.repeat(level(50, 5), 3, axis=0), 0.0)
    assert same.count == 0 and len(same.points_map) == 150


def test_a_triangle_is_enough():
    points = np.array([[0.0, 0, 0], [1, 0, 2], [0, 1, 4]])
    assert neighbour_medians(points).tolist() == [3.0, 2.0, 1.0]


def test_huge_heights_do_not_overflow():
    assert neighbour_medians(hexagon(0.0, [1.5e308] * 6))[0] == 1.5e308


@pytest.mark.parametrize(
    "points,reason",
    [
        (np.zeros((0, 3)), "surface_too_few_points"),
        (np.zeros((2, 3)), "surface_too_few_points"),
        (np.zeros((9, 3)), "surface_too_few_points"),
        (
            np.column_stack([np.arange(5.0), np.arange(5.0), np.random.default_rng(0).random(5)]),
            "surface_collinear",
        ),
        (np.array([[0, 0, 0], [1, 0, np.nan], [0, 1, 0.0]]), "surface_not_finite"),
        (np.array([[0, 0, 0], [1, np.inf, 1], [0, 1, 0.0]]), "surface_not_finite"),
        (np.zeros((4, 2)), "surface_shape"),
        (np.zeros(3), "surface_shape"),
    ],
)
def test_refusals(points, reason):
    for function in (tin_screen, tin_filter):
        with pytest.raises(SurfaceError) as caught:
            function(points, 0.1)
        assert caught.value.reason == reason


@pytest.mark.parametrize("tolerance", [-0.1, np.nan, -np.inf])
def test_a_tolerance_that_is_none_is_refused(tolerance):
    with pytest.raises(SurfaceError) as caught:
        tin_screen(level(), tolerance)
    assert caught.value.reason == "surface_tolerance"


def test_the_kernels_equal_their_plain_twins():
    rng = np.random.default_rng(6)
    for n in (3, 4, 10, 120):
        xy = np.unique(
            rng.integers(0, 12, (n, 2)).astype(float) if n > 10 else rng.random((n, 2)), axis=0
        )
        triangles, neighbours = delaunay(xy)
        footprint = np.concatenate([np.arange(len(xy)), rng.integers(0, len(xy), n)])
        points = np.column_stack([xy[footprint], rng.normal(size=len(footprint))])
        plain = medians_plain(points, triangles, footprint)
        order = np.argsort(footprint, kind="stable")
        first = np.searchsorted(footprint[order], np.arange(len(xy) + 1))
        start, links = edges(triangles, neighbours, len(xy))
        found = medians_kernel(start, links, first, points[order, 2])[footprint]
        assert np.array_equal(found, plain)
        assert np.array_equal(neighbour_medians(points), plain)
