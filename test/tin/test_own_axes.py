"""What is told with rasters stays when the same points are turned, mirrored or moved."""

from __future__ import annotations

import numpy as np
import pytest

from ladar_volume.clouds.cloud_cleaning import clean
from ladar_volume.clouds.cloud_noise import cloud_noise
from ladar_volume.math.own_axes import along_own_axes, raster_of
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64
from ladar_volume.tin.boundary import ears
from ladar_volume.tin.full_tin import build_tin, footprint_areas
from ladar_volume.tin.relevant import with_relevant
from ladar_volume.tin.sampled_area import sampled_area, spacings


def terrain(kind: str) -> F64:
    """Points (n, 3) m of a rolling surface with noise: at random, in rows, or along a strip."""
    rng = np.random.default_rng(5)
    xy = rng.uniform(-20.0, 20.0, (1500, 2))
    if kind == "rows":
        xy[:, 1] = np.round(xy[:, 1] / 2.0) * 2.0
    if kind == "strip":
        xy *= [1.0, 0.3]
    z = 0.5 * np.sin(0.2 * xy[:, 0]) + rng.normal(0.0, 0.02, len(xy))
    z[::200] += 4.0
    return np.column_stack([xy, z])


def turned(r: F64, degrees: float) -> F64:
    """About the vertical, and moved."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return r @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + [300.0, -70.0, 20.0]


@pytest.mark.parametrize("kind", ["random", "rows", "strip"])
@pytest.mark.parametrize("degrees", [0.0, 33.0, 90.0, 180.0, 301.0])
def test_turned_points_have_the_same_spacing_area_noise_and_strays(
    kind: str, degrees: float
) -> None:
    r = terrain(kind)
    other = turned(r, degrees)
    np.testing.assert_allclose(spacings(other[:, :2]), spacings(r[:, :2]), rtol=1e-6)
    one, two = sampled_area(build_tin(r)), sampled_area(build_tin(other))
    assert two.area_m2 == pytest.approx(one.area_m2, rel=1e-9)
    assert (two.holes, two.parts) == (one.holes, one.parts)
    assert cloud_noise(other).sigma_m == pytest.approx(cloud_noise(r).sigma_m, rel=1e-6)
    np.testing.assert_array_equal(clean(other).strays, clean(r).strays)


def test_the_long_direction_is_the_first_axis_and_a_square_lies_along_its_sides() -> None:
    rng = np.random.default_rng(2)
    strip = rng.uniform([-9.0, -1.0], [9.0, 1.0], (4000, 2))
    for degrees in (0.0, 25.0, 140.0):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        wide = np.ptp(along_own_axes(strip @ np.array([[c, s], [-s, c]])), axis=0)
        np.testing.assert_allclose(wide, [18.0, 2.0], rtol=0.1)
        square = rng.uniform(-3.0, 3.0, (20000, 2)) @ np.array([[c, s], [-s, c]])
        np.testing.assert_allclose(np.ptp(along_own_axes(square), axis=0), 6.0, rtol=0.05)


def test_a_raster_holds_all_places_and_a_lattice_in_the_middle_of_its_cells() -> None:
    x, y = np.meshgrid(np.arange(7) * 0.3, np.arange(4) * 0.3)
    xy = np.column_stack([x.ravel(), y.ravel()])
    low, count = raster_of(xy, 0.3)
    np.testing.assert_array_equal(count, [7, 4])
    np.testing.assert_allclose(low, [-0.15, -0.15], atol=1e-12)
    for cell in (0.17, 0.4, 1.0, 9.0):
        low, count = raster_of(xy, cell)
        place = np.floor((xy - low) / cell)
        assert (place >= 0).all()
        assert (place < count).all()


@pytest.mark.parametrize("degrees", [0.0, 33.0, 90.0, 301.0])
@pytest.mark.parametrize("far", [0.0, 4e5])
def test_a_lattice_s_own_lengths_as_limits(degrees: float, far: float) -> None:
    """Sides of 0.2 m, diagonals and circles of 0.2 √2: rounding does not tell which count."""
    x, y = np.meshgrid(np.arange(31) * 0.2, np.arange(21) * 0.2)
    r = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    tin = build_tin(turned(r, degrees) + np.array([far, 13.0 * far, 0.0]))
    area = 6.0 * 4.0
    for option in ("edge", "circumcircle"):
        marked = with_relevant(tin, option, 0.2 * np.sqrt(2.0), 0.2 * np.sqrt(2.0))
        assert footprint_areas(marked.vertices, marked.triangles)[marked.relevant].sum() == (
            pytest.approx(area, rel=1e-6)
        )
    assert not ears(tin, tin.relevant, 0.2 * np.sqrt(2.0)).any()
    with pytest.raises(SurfaceError, match="no relevant triangle"):
        with_relevant(tin, "edge", 0.2, np.inf)


def test_slivers_on_the_outline_alone_are_no_surface() -> None:
    """Points in rows, turned: rounding leaves triangles of no area between points of one row."""
    rng = np.random.default_rng(3)
    xy = np.column_stack([rng.uniform(0, 10, 3000), np.round(rng.uniform(0, 6, 3000) / 0.3) * 0.3])
    tin = build_tin(turned(np.column_stack([xy, np.zeros(3000)]), 33.0))
    with pytest.raises(SurfaceError, match="no relevant triangle"):
        with_relevant(tin, "edge", 0.2, np.inf)
