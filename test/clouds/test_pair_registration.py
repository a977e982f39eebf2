"""A difference of two clouds that is the same everywhere, or a plane, may be their registration."""

import numpy as np
import pytest

from ladar_volume.clouds.cloud_surface import cloud_surface
from ladar_volume.clouds.cloud_volume import between_clouds
from ladar_volume.clouds.pair_verdict import pair_ground, pair_verdict
from ladar_volume.clouds.sampling.pair_registration import (
    CellMeans,
    plane_through,
    unit_doubts,
)
from ladar_volume.clouds.volume_verdict import counted_areas
from ladar_volume.model.surface_parameters import SurfaceParameters

ALL, HALF, SIGMA = SurfaceParameters(ratio=1.0), 20.0, 0.012


def cloud(seed, change=lambda x, y: 0.0):
    """A heap on sloping ground, 40 m wide, and what changed there."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-HALF, HALF, (2, 12_000))
    z = 0.01 * x + np.maximum(0.0, 4.0 - 0.6 * np.hypot(x, y)) + change(x, y)
    return cloud_surface(np.c_[x, y, z + rng.normal(0.0, SIGMA, len(x))], ALL, SIGMA)


def doubts(*surfaces):
    """Volume, and what is said of it by name."""
    surfaces = list(surfaces)
    areas = [counted_areas(s, s.representation.tin.relevant) for s in surfaces]
    found = between_clouds(*surfaces, "b")
    volume, verdict = pair_verdict(found, surfaces, areas, pair_ground(surfaces))
    return volume, {doubt.name: doubt for doubt in verdict.doubts}


def dug(x, y):
    return np.where(np.hypot(x - 3.0, y) < 4.0, -0.8, 0.0)


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("change", [lambda x, y: 0.0, dug])
def test_two_surveys_in_one_system_are_no_doubt(seed, change):
    volume, found = doubts(cloud(seed, change), cloud(seed + 100))
    assert not {"offset", "tilt"} & set(found)
    true = -0.8 * np.pi * 16.0 if change is dug else 0.0
    assert abs(volume.net_m3 - true) < 4.0 * volume.sigma_m3


@pytest.mark.parametrize("lift_m", [0.05, -0.02, 0.3])
def test_a_lift_of_everything_is_a_layer_or_an_offset(lift_m):
    volume, found = doubts(cloud(3, lambda x, y: lift_m), cloud(4))
    assert found["offset"].value == pytest.approx(lift_m, abs=0.002) and "tilt" not in found
    assert volume.budget_m6.get("registration") is None


def test_a_thick_layer_over_all_of_it_is_a_change():
    _, found = doubts(cloud(5, lambda x, y: 0.8), cloud(6))
    assert not {"offset", "tilt"} & set(found)


@pytest.mark.parametrize("turn", [0.0, 0.7, 2.0])
@pytest.mark.parametrize("change", [lambda x, y: 0.0, dug])
def test_a_tilt_is_named_with_what_it_cuts_and_fills(turn, change):
    slope = 0.005

    def tilted(x, y):
        return slope * (x * np.cos(turn) + y * np.sin(turn)) + change(x, y)

    volume, found = doubts(cloud(7, tilted), cloud(8))
    assert found["tilt"].value == pytest.approx(slope, rel=0.05)
    if change is not dug:
        assert volume.cut_m3 > 20.0 and volume.fill_m3 > 20.0


def test_graded_ground_is_steeper_than_a_tilt():
    _, found = doubts(cloud(9, lambda x, y: 0.05 * x), cloud(10))
    assert "tilt" not in found


@pytest.mark.parametrize("sides", [(20, 20), (60, 7)])
def test_the_plane_through_cells_and_its_sigma(sides):
    """Against least squares of what was drawn, by trial."""
    cell = np.stack(np.meshgrid(*map(np.arange, sides)), axis=2).reshape(-1, 2)
    slopes, told = [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        mean = 0.3 + 2.0 * cell @ [0.004, -0.01] + rng.normal(0.0, 0.01, len(cell))
        mean[rng.random(len(cell)) < 0.15] += 3.0
        fit = plane_through(CellMeans(mean, np.full(len(cell), 4.0), cell, np.zeros(2), 2.0))
        assert np.count_nonzero(fit.on_it) > 0.75 * len(cell)
        slopes.append(fit.slope)
        told.append(fit.sigma)
    assert np.mean(slopes, axis=0) == pytest.approx([0.004, -0.01], abs=2e-4)
    # neighbours count as one, so that it is twice what independent cells would have
    assert 1.2 < np.mean(told) / np.std(slopes, axis=0).max() < 3.0


@pytest.mark.parametrize("step_m", [0.02, 0.1])
@pytest.mark.parametrize("beyond", [lambda x, y: x > 4.0, lambda x, y: x + y > 14.0])
def test_a_strip_whose_heights_are_off_is_named(step_m, beyond):
    # without the doubt an error of 70 to 260 sigmas was sound
    _, found = doubts(cloud(9), cloud(10, lambda x, y: step_m * beyond(x, y)))
    assert found["offset"].value == pytest.approx(-step_m, rel=0.1)
    assert "strip" in found["offset"].text


def test_what_is_heaped_up_is_no_strip():
    for heap in (
        lambda x, y: np.clip(2.0 - 0.5 * np.hypot(x - 9, y), 0.0, 1.5),  # a flat top
        lambda x, y: 0.4 * ((abs(x - 8) < 6) & (abs(y) < 7)),  # a thick layer
        lambda x, y: np.maximum(0.0, 0.8 - 0.09 * np.hypot(x - 9, y - 9)),
    ):
        _, found = doubts(cloud(11, heap), cloud(12))
        assert "offset" not in found


@pytest.mark.parametrize("times, unit", [(1.0 / 0.3048, "feet"), (1000.0, "millimetres")])
def test_clouds_in_two_units_are_named(times, unit):
    rng = np.random.default_rng(13)
    one, two = rng.uniform(0.0, [60.0, 40.0, 3.0], (2, 4000, 3))
    (doubt,) = unit_doubts(times * one, two)
    assert unit in doubt.text and "first" in doubt.text
    assert "second" in unit_doubts(two, times * one)[0].text
    assert unit_doubts(one, two) == [] and unit_doubts(one * [times, 1.0, 1.0], two) == []
