"""Places over triangles that nobody saw: all of their area, in a bounded number."""

from itertools import pairwise

import numpy as np
import pytest

from ladar_volume.tin.full_tin import build_tin, footprint_areas
from ladar_volume.tin.sampled_area import spacings
from ladar_volume.volume.field_checks.gaps import CELLS, find_gaps, places_of


def fan(reach):
    """Triangles (t, 3, 3) from the points of one side of a square to one place far away."""
    y = np.linspace(0.0, 4.0, 41)
    return np.array([[[0, a, 0], [0, b, 0], [reach, 2.0, 1.0]] for a, b in pairwise(y)])


@pytest.mark.parametrize("reach", [3.0, 100.0, 1e4, 4e9])
def test_slivers_are_covered_as_triangles_are(reach):
    share = np.linspace(0.2, 1.0, 40)
    xy, area, height = places_of(fan(reach), share)
    assert len(xy) <= 16 * CELLS
    assert area.sum() == pytest.approx(0.5 * 0.1 * reach * share.sum(), rel=1e-9)
    # the middle of every triangle lies at a third of its way
    assert area @ xy[:, 0] / area.sum() == pytest.approx(reach / 3.0, rel=1e-9)
    assert area @ height / area.sum() == pytest.approx(1.0 / 3.0, rel=1e-9)


def scattered(lost, share=1.0, lone=0):
    """A TIN of points 8 cm apart, ``share`` of them in the western half, none where ``lost`` but
    some lone ones; what find_gaps says of it.
    """
    rng = np.random.default_rng(3)
    xy = rng.uniform(-8.0, 8.0, (40_000, 2))
    xy = xy[~lost(*xy.T) & ((xy[:, 0] > 0.0) | (rng.random(len(xy)) < share))]
    some = rng.uniform(2.0, 5.0, (lone, 2))
    tin = build_tin(np.column_stack([np.r_[xy, some], np.zeros(len(xy) + lone)]))
    area = footprint_areas(tin.vertices, tin.triangles)
    return find_gaps(tin, area, spacings(tin.vertices[:, :2]))


def nowhere(x, _):
    return np.zeros(len(x), bool)


def square(x, y):
    return (np.abs(x - 3.5) < 1.5) & (np.abs(y - 3.5) < 1.5)


@pytest.mark.parametrize("share", [1.0, 0.1, 0.04])
def test_a_half_with_fewer_points_is_no_gap(share):
    found = scattered(nowhere, share)
    assert found.area_m2 < 0.02 * 16.0**2
    assert not len(found.areas) or found.areas[0] < 0.005 * 16.0**2


@pytest.mark.parametrize("lone", [0, 3])
def test_a_hole_is_a_gap_beside_a_half_with_fewer_points_too(lone):
    for share in (1.0, 0.1):
        assert scattered(square, share, lone).areas[0] == pytest.approx(9.0, rel=0.25)
