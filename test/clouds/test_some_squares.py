"""Squares that stand for all triangles, against plain NumPy."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from ladar_volume.clouds import between_points as between
from ladar_volume.clouds.between_points import chosen_squares, row_step
from ladar_volume.clouds.cloud_surface import cloud_surface
from ladar_volume.math.equal_rows import rows_of
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.tin.full_tin import footprint_areas


def test_triangles_in_every_so_many_squares() -> None:
    rng = np.random.default_rng(6)
    first = rng.uniform(-3, 20, (900, 2))
    low = np.array([-3.1, -2.9])
    square = np.floor((first - low) / 1.7).astype(np.int64)
    wanted = (square @ [1, 3]) % 5 == 0
    assert np.array_equal(chosen_squares(first, low, 1.7, 5, 3), wanted)
    assert wanted.any() and not wanted.all()


@pytest.mark.parametrize("every", [2, 3, 5, 8, 50, 500, 900])
def test_chosen_squares_lie_evenly_over_any_outline(every: int) -> None:
    """With two squares on from row to row all of 500 lay on one diagonal of 333 by 333."""
    side = 333
    middle = np.indices((side, side)).reshape(2, -1).T + 0.5
    step = row_step(every)
    assert math.gcd(step, every) == 1 and 0 < step <= every
    chosen = middle[chosen_squares(middle, np.zeros(2), 1.0, every, step)]
    assert len(chosen) == pytest.approx(side**2 / every, rel=0.05)
    count, _, _ = np.histogram2d(*chosen.T, 4, ((0.0, side), (0.0, side)))
    assert count.min() > 0.6 * count.mean() and count.max() < 1.4 * count.mean()


def test_rows_of_all_are_the_values_themselves() -> None:
    values = np.arange(12.0).reshape(4, 3)
    assert rows_of(values, np.arange(4)) is values
    assert np.array_equal(rows_of(values, np.array([0, 2])), values[[0, 2]])
    assert rows_of(values[:, ::-1], np.arange(4)).flags.c_contiguous


@pytest.mark.parametrize("seed", range(4))
def test_a_coarser_surface_of_what_is_near_is_that_of_all(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0.0, 30.0, (9000, 2))
    z = np.where(np.hypot(*(xy - 15.0).T) < 6.0, 2.0, 0.0) + rng.normal(0.0, 0.01, len(xy))
    surface = cloud_surface(np.c_[xy, z], SurfaceParameters(ratio=1.0), 0.01)
    tin = surface.representation.tin
    middle = tin.vertices[tin.triangles, :2].mean(axis=1)
    own = np.hypot(*(middle - 15.0).T) < 7.0
    inside = np.where(own, footprint_areas(tin.vertices, tin.triangles), 0.0)
    found = between.between_points(surface, inside, tin.vertices[:, 2])
    calls: list[float] = []

    def everywhere(*asked: Any) -> Any:
        calls.append(float(near(*asked).mean()))
        return np.ones(len(tin.vertices), bool)

    near = between.near_triangles
    monkeypatch.setattr(between, "near_triangles", everywhere)
    whole = between.between_points(surface, inside, tin.vertices[:, 2])
    assert calls[0] < 0.8 and found.random_m6 > 0.0
    assert dataclasses.astuple(found) == pytest.approx(dataclasses.astuple(whole), rel=1e-9)


def test_chosen_squares_that_hold_hardly_fewer_than_enough_are_compared_once() -> None:
    counts = [between.ENOUGH // 5, between.ENOUGH // 2, int(0.95 * between.ENOUGH), 10**7]
    assert [len(between.shifts_for(count)) for count in counts] == [4, 2, 1, 1]
