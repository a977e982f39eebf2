"""Points over one footprint, the map and its bins."""

from __future__ import annotations

import numpy as np
import pytest

from ladar_volume.model.errors import SurfaceError
from ladar_volume.tin.duplicates import first_within
from ladar_volume.tin.window import (
    MOST,
    central_points,
    default_bins,
    grid,
    inside,
    map_window,
)


def first_within_plain(xy, tolerance):
    """One after the other, against all that are kept."""
    kept, out = [], np.empty(len(xy), int)
    for i, p in enumerate(xy):
        near = [k for k in kept if ((xy[k] - p) ** 2).sum() <= tolerance**2]
        out[i] = near[0] if near else i
        if not near:
            kept.append(i)
    return out


@pytest.mark.parametrize("tolerance", [0.0, 1e-9, 0.05, 0.3, 5.0])
def test_the_first_kept_point_within_the_tolerance(tolerance):
    rng = np.random.default_rng(0)
    xy = np.concatenate([rng.random((150, 2)), rng.integers(-3, 3, (150, 2)) * 0.1])
    xy = rng.permutation(np.concatenate([xy, xy[:40], -xy[:5] * 0.0]))
    assert np.array_equal(first_within(xy, tolerance), first_within_plain(xy, tolerance))
    assert len(first_within(xy[:0], tolerance)) == 0 and first_within(
        xy[:1], tolerance
    ).tolist() == [0]


@pytest.mark.parametrize("tolerance", [-1.0, np.nan, np.inf, 1e-30])
def test_tolerances_that_are_refused(tolerance):
    with pytest.raises(SurfaceError) as caught:
        first_within(np.array([[0.0, 0.0], [1e3, 1.0]]), tolerance)
    assert caught.value.reason == "surface_tolerance"


def test_the_map_is_the_bounding_box_or_what_is_asked():
    xy = np.array([[1.0, 5.0], [3.0, 2.0]])
    assert map_window(xy) == (1.0, 2.0, 3.0, 5.0) and map_window(xy, (0, 0, 2, 9)) == (
        0.0,
        0.0,
        2.0,
        9.0,
    )
    assert inside(xy, (1.0, 2.0, 3.0, 5.0)).all() and inside(xy, (0.0, 0.0, 2.0, 9.0)).tolist() == [
        True,
        False,
    ]
    for window in ((0.0, 0.0, 0.0, 1.0), (1.0, 0.0, 0.0, 1.0), (0.0, 0.0, np.inf, 1.0)):
        with pytest.raises(SurfaceError):
            map_window(xy, window)


def test_bins_are_as_square_as_can_be():
    assert (
        grid((0.0, 0.0, 10.0, 5.0), 10) == (10, 5)
        and grid((0.0, 0.0, 10.0, 0.1), 4) == (4, 1)
        and grid((0.0, 0.0, 1.0, 3.0), 2) == (2, 6)
    )
    for vertices in (1, 2, 10, 5000, 333_333):
        nx, ny = grid((0.0, 0.0, 7.0, 3.0), default_bins((0.0, 0.0, 7.0, 3.0), vertices))
        assert nx * ny <= max(1, vertices) and (vertices < 100 or 0.07 < nx * ny / vertices < 0.12)
    for height in (1e12, 1e-12):
        assert default_bins((0.0, 0.0, 1.0, height), 100) == (1 if height > 1.0 else 100)
    assert grid((0.0, 0.0, 1.0, 1e300), 1) == (1, MOST)
    for window, bins in (
        ((0.0, 0.0, 1.0, 1e12), 5),
        ((0.0, 0.0, 1.0, 1.0), 10**5),
        ((0.0, 0.0, 1.0, 1.0), 0),
    ):
        with pytest.raises(SurfaceError):
            grid(window, bins)


def test_central_points_against_sorting_by_distance():
    rng = np.random.default_rng(2)
    xy, open_ = rng.random((400, 2)) * [6.0, 3.0], rng.random(400) < 0.7
    window = (0.0, 0.0, 6.0, 3.0)
    got = central_points(xy, open_, window, 8)
    expected = []
    for a in range(8):
        for b in range(4):
            low = np.array([a, b]) * 0.75
            member = np.flatnonzero(open_ & (xy >= low).all(axis=1) & (xy < low + 0.75).all(axis=1))
            if len(member):
                expected.append(member[np.argmin(((xy[member] - low - 0.375) ** 2).sum(axis=1))])
    assert got.tolist() == expected
    assert central_points(
        np.array([[6.0, 3.0], [0.0, 0.0]]), np.ones(2, bool), window, 8
    ).tolist() == [1, 0]
