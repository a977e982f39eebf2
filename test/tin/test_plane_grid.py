"""Neighbours by a grid, and what is told of corners and extents, against plain NumPy."""

import numpy as np
import pytest

from ladar_volume.clouds.cloud_noise import nearest_in_plane
from ladar_volume.math.own_axes import extent_of
from ladar_volume.math.plane_grid import fullest, nearest_in_grid, plane_grid
from ladar_volume.model.errors import SurfaceError
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.tin.relevant import edge_lengths, mark_relevant, size_kernel
from ladar_volume.tin.sampled_area import fill_cells, greatest_at, lasting_sizes, least_at, look_up

RNG = np.random.default_rng(8)
EVEN = RNG.uniform(-3, 10, (600, 2))
CLOUDS = {
    "even": EVEN,
    "on a lattice": np.stack(np.meshgrid(*[np.arange(25.0)] * 2), -1).reshape(-1, 2),
    "at one place": np.ones((300, 2)),
    "two clumps far apart": np.r_[EVEN[:200], EVEN[200:] + 1e6],
    "uneven": EVEN * np.exp(RNG.normal(0, 4, (600, 1))),
    "on a line": np.c_[np.arange(100.0), np.zeros(100)],
    "just as many": EVEN[:19],
}


@pytest.mark.parametrize("name", CLOUDS)
def test_neighbours_by_a_grid_are_those_of_brute_force_by_distance_then_row(name: str) -> None:
    xy = CLOUDS[name]
    for places in (xy, xy[::-7] + 0.3, np.array([[1e9, 0.0], [0.0, -5.0]])):
        rows, square = np.empty((len(places), 19), np.int64), np.empty((len(places), 19))
        nearest_in_grid(plane_grid(xy), places, rows, square)
        d = places[:, None] - xy
        all_square = d[..., 0] * d[..., 0] + d[..., 1] * d[..., 1]
        wanted = np.argsort(all_square, axis=1, kind="stable")[:, :19]
        assert np.array_equal(rows, wanted)
        assert np.array_equal(square, np.take_along_axis(all_square, wanted, axis=1))
        far = nearest_in_plane(xy, places, 19)[1]
        np.testing.assert_allclose(far, np.sqrt(square), rtol=1e-13)


def test_the_fullest_cell_of_a_grid() -> None:
    grid = plane_grid(CLOUDS["two clumps far apart"])
    cell = np.floor((grid.xy - grid.low) / grid.cell).astype(int)
    assert fullest(grid) == np.unique(cell, axis=0, return_counts=True)[1].max() >= 200


def test_extents_corners_and_sizes() -> None:
    low, high = extent_of(EVEN)
    assert np.array_equal([low, high], [EVEN.min(axis=0), EVEN.max(axis=0)])
    tin = build_tin(np.c_[EVEN, EVEN[:, 0]])
    value = RNG.normal(size=len(EVEN))
    corner = value[tin.triangles]
    for t in range(len(corner)):
        assert least_at(value, tin.triangles, t) == corner[t].min()
        assert greatest_at(value, tin.triangles, t) == corner[t].max()
    mask = RNG.random(len(tin.triangles)) < 0.5
    area, longest = size_kernel(tin.vertices, tin.triangles, mask)
    a, b, c = np.moveaxis(tin.vertices[tin.triangles[mask], :2], 1, 0)
    u, v = b - a, c - a
    assert area == pytest.approx(0.5 * np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum())
    assert longest == pytest.approx(edge_lengths(tin, mask).max(axis=1).sum())
    with pytest.raises(SurfaceError, match="no relevant triangle is left"):
        mark_relevant(tin, np.zeros_like(mask), "nothing")


def test_cells_that_hold_a_place_are_filled() -> None:
    low, raster = extent_of(EVEN)[0], np.zeros((40, 40), bool)
    fill_cells(EVEN, low, 0.4, raster)
    at = np.floor((EVEN - low) / 0.4).astype(int) + 2
    wanted = np.zeros_like(raster)
    wanted[at[:, 0], at[:, 1]] = True
    assert np.array_equal(raster, wanted)
    every, some = np.empty(len(EVEN), np.bool_), np.array([7, 3, 200])
    look_up(EVEN, np.zeros(0, np.int64), low, 0.4, wanted[::-1].copy(), every)
    assert np.array_equal(every, wanted[::-1][at[:, 0], at[:, 1]]) and 0 < every.sum() < len(EVEN)
    few = np.empty(3, np.bool_)
    look_up(EVEN, some, low, 0.4, wanted[::-1].copy(), few)
    assert np.array_equal(few, every[some])


def test_the_size_that_lasts_is_the_least_that_is_filled_two_steps_on_as_well() -> None:
    sizes = [1.0, 2.0, 3.0, 4.0]
    wanted = {"0000": np.inf, "1010": 1.0, "1001": 1.0, "0101": 2.0, "0110": 2.0, "1101": 2.0}
    filled = np.array([[c == "1" for c in word] for word in wanted]).T.copy()
    assert lasting_sizes(filled, sizes).tolist() == list(wanted.values())
