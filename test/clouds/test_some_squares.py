"""Squares that stand for all triangles, against plain NumPy."""

import numpy as np

from ladar_volume.clouds.between_points import chosen_squares, extent_at
from ladar_volume.math.equal_rows import rows_of


def test_triangles_in_every_so_many_squares() -> None:
    rng = np.random.default_rng(6)
    xy, triangles = rng.uniform(-3, 20, (400, 2)), rng.integers(0, 400, (900, 3), np.int32)
    low, high = extent_at(xy, triangles)
    first = xy[triangles[:, 0]]
    assert np.array_equal([low, high], [first.min(axis=0), first.max(axis=0)])
    square = np.floor((first - low) / 1.7).astype(np.int64)
    wanted = (square @ [1, 2]) % 5 == 0
    assert np.array_equal(chosen_squares(xy, triangles, low, 1.7, 5), wanted)
    assert wanted.any() and not wanted.all()


def test_rows_of_all_are_the_values_themselves() -> None:
    values = np.arange(12.0).reshape(4, 3)
    assert rows_of(values, np.arange(4)) is values
    assert np.array_equal(rows_of(values, np.array([0, 2])), values[[0, 2]])
    assert rows_of(values[:, ::-1], np.arange(4)).flags.c_contiguous
