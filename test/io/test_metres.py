"""Metres of a map against metres on the ground, by the geocentric coordinates of its corners."""

import numpy as np
import pytest

from ladar_volume.io.pointfiles.metres import (
    MapCoordinates,
    metres_of_steps,
    round_specks,
    stretch,
)

pyproj = pytest.importorskip("pyproj")


def geocentric(lon, lat, z):
    change = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    return np.stack(change.transform(lon, lat, z), axis=-1)


@pytest.mark.parametrize(("east", "height"), [(500_000.0, 0.0), (790_000.0, 0.0), (5e5, 3000.0)])
def test_a_volume_on_the_ground_is_that_on_the_map_by_the_factor(east, height):
    """East of the middle of a zone the map is longer than the ground, on a height shorter."""
    utm, side, north = pyproj.CRS("EPSG:32632"), 100.0, 5_200_000.0
    x, y = (side * np.array(c) for c in ([0.0, 1.0, 1.0, 0.0], [0.0, 0.0, 1.0, 1.0]))
    back = pyproj.Transformer.from_crs(utm, "EPSG:4326", always_xy=True)
    a, b, c, d = geocentric(*back.transform(east + x, north + y), np.full(4, height))
    on_ground = 0.5 * float(np.linalg.norm(np.cross(c - a, d - b)))
    points = np.column_stack([east + x, north + y, np.full(4, height)])
    scale, ground = stretch(points, utm)
    # heights above an ellipsoid, as if above a sphere
    assert ground == pytest.approx(on_ground / side**2, abs=1e-5)
    assert scale == pytest.approx(
        float(np.sqrt(side**2 / on_ground)) * (1 + height / 6.371e6), abs=1e-5
    )


@pytest.mark.parametrize("latitude", [0.0, 48.0, -70.0])
def test_a_step_of_a_degree_is_as_long_as_on_the_ground(latitude):
    degrees = MapCoordinates(across=None, factor=(float("nan"), 0.3048))
    found = metres_of_steps((1e-4, 1e-4, 2.0), degrees, latitude)
    a, east, north = geocentric(
        np.array([10.0, 10.0001, 10.0]), latitude + np.array([0.0, 0.0, 1e-4]), np.zeros(3)
    )
    expected = [np.linalg.norm(east - a), np.linalg.norm(north - a), 0.6096]
    np.testing.assert_allclose(found, expected, rtol=0.01)  # of an ellipsoid as of a sphere


def test_coordinates_whose_squares_no_double_holds_are_zero():
    r = np.array([[1.0, -0.0, 1e-99], [5e-324, -1e-101, -2.0]])
    round_specks(r)
    assert r.tolist() == [[1.0, 0.0, 1e-99], [0.0, 0.0, -2.0]] and np.signbit(r[0, 1])
