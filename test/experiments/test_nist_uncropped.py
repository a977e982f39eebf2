"""The uncropped scan of the box: what is beyond the screens, and points where nothing is."""

import numpy as np
import pytest

from ladar_volume.experiments.nist.nist_scene import BOX_M, SCANNER_M, SCREEN_M, angles_of, rays_of
from ladar_volume.experiments.nist.nist_uncropped import BEHIND_M, cast_beyond, uncropped_scan


@pytest.fixture(scope="module")
def scan():
    return uncropped_scan(5, 0)


@pytest.mark.parametrize(
    "place, distance_to, beyond",
    [
        ((0.0, 1.0, 1.2), None, False),  # a screen above the box
        ((1.0, 0.0, 1.29), None, False),  # the other, below its upper edge
        ((-BEHIND_M, 0.5, 1.8), None, True),  # the wall, over the screen
        ((2.6, -0.3, 0.0), None, True),  # the floor beside a screen
        ((-0.4, 1.9, 0.5), (0.0, None, None), False),  # behind a screen, which hides it
        (tuple(BOX_M * (0.5, 0.5, 1.0)), None, False),
    ],
)
def test_rays_meet_what_is_first(place, distance_to, beyond):
    place = np.array(place)
    ray = rays_of(angles_of(place[None]))
    distance, behind = cast_beyond(ray, True)
    at = SCANNER_M + distance[0] * ray[0]
    assert bool(behind[0]) == beyond
    if distance_to is None:
        assert at == pytest.approx(place, abs=1e-9)
    else:
        assert at[0] == pytest.approx(distance_to[0], abs=1e-9)


def test_phantom_points_hang_behind_the_edges_of_the_screens(scan):
    mixed = scan.points[scan.phantom]
    assert 0 < len(mixed) < 0.02 * len(scan.points)
    free = (mixed[:, :2] > -BEHIND_M + 0.1).all(axis=1) & (mixed[:, 2] > 0.1)
    assert free.mean() > 0.5  # in the air between screens, walls and floor
    assert scan.points[~scan.phantom][:, 2].min() > -0.1


def test_footprints_crowd_below_screens_and_walls(scan):
    x, y = scan.points[:, 0], scan.points[:, 1]

    def density(x0, x1, y0, y1):
        return ((x > x0) & (x < x1) & (y > y0) & (y < y1)).sum() / ((x1 - x0) * (y1 - y0))

    top = density(0.2, BOX_M[0] - 0.2, 0.2, BOX_M[1] - 0.2)
    floor = density(BOX_M[0] + 0.2, SCREEN_M[0], 0.2, SCREEN_M[0])
    wall = density(BOX_M[0] - 0.05, BOX_M[0] + 0.05, 0.2, BOX_M[1] - 0.2)
    screen = density(BOX_M[0] + 0.2, SCREEN_M[0] - 0.1, -0.05, 0.05)
    assert top < floor < wall and floor < screen
