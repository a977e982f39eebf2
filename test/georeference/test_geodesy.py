"""The map frame: closed forms, invariances, hostile input."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ladar_volume.georeference.geodesy import LocalFrame, rotation_enu_ecef
from ladar_volume.model.errors import FixError
from ladar_volume.model.records import Datum

A, F = 6378137.0, 1 / 298.257223563


def _ecef(lat, lon, h):
    """Closed form of the ellipsoid (Hofmann-Wellenhof), independent of pyproj."""
    lat, lon = np.radians(lat), np.radians(lon)
    e2 = F * (2 - F)
    n = A / np.sqrt(1 - e2 * np.sin(lat) ** 2)
    return np.stack(
        [
            (n + h) * np.cos(lat) * np.cos(lon),
            (n + h) * np.cos(lat) * np.sin(lon),
            (n * (1 - e2) + h) * np.sin(lat),
        ],
        axis=-1,
    )


@pytest.mark.parametrize(
    "place",
    [
        (50.1, 14.4, 250.0),
        (-33.9, 18.4, 10.0),
        (0.0, 0.0, 0.0),
        (89.99, -120.0, 5.0),
        (10.0, 180.0, -20.0),
    ],
)
def test_equals_the_closed_form_and_inverts(place):
    rng = np.random.default_rng(1)
    frame = LocalFrame(Datum(*place))
    lat, lon, h = (
        place[0] + rng.uniform(-0.009, 0.009, 20),
        place[1] + rng.uniform(-0.01, 0.01, 20),
        place[2] + rng.uniform(-50, 50, 20),
    )
    r = frame.to_map(lat, lon, h)
    expected = (_ecef(lat, lon, h) - _ecef(*place)) @ rotation_enu_ecef(place[0], place[1]).T
    np.testing.assert_allclose(r, expected, atol=5e-9)
    back = frame.to_geodetic(r)
    np.testing.assert_allclose(frame.to_map(*back.T), r, atol=5e-9)
    assert np.abs(frame.to_map(*place)).max() < 1e-8


def test_axes_are_east_north_up_and_one_point_has_the_bits_of_many():
    frame = LocalFrame(Datum(50.0, 14.0, 100.0))
    assert frame.to_map(50.0, 14.001, 100.0)[0] > 70
    assert frame.to_map(50.001, 14.0, 100.0)[1] > 110
    np.testing.assert_allclose(frame.to_map(50.0, 14.0, 107.0), (0, 0, 7), atol=1e-8)
    lat, lon, h = np.full(7, 50.0) + np.arange(7) * 1e-5, np.full(7, 14.0), np.full(7, 100.0)
    many = frame.to_map(lat, lon, h)
    for i in range(7):
        assert np.array_equal(frame.to_map(float(lat[i]), 14.0, 100.0), many[i])


def test_convergence_is_the_tilt_of_the_local_vertical():
    frame = LocalFrame(Datum(50.0, 14.0, 0.0))
    np.testing.assert_allclose(frame.convergence(50.0, 14.0), np.eye(3), atol=1e-15)
    turn = frame.convergence(50.01, 14.0)
    assert math.isclose(math.acos(turn[2, 2]), math.radians(0.01), rel_tol=1e-7)
    assert turn[1, 2] > 0  # north of the datum the local vertical leans north
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-15)


@pytest.mark.parametrize("place", [(math.nan, 0.0, 0.0), (91.0, 0.0, 0.0), (0.0, math.inf, 0.0)])
def test_no_frame_at_no_place(place):
    with pytest.raises(FixError):
        LocalFrame(Datum(*place))
