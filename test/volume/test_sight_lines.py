"""A shadow is told from where its rim was seen from, and what lies in it is below the line."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mapped_sheet import mapped, platform

from ladar_volume.model.parameters import Parameters
from ladar_volume.rmls.surface_filter import SurfaceFilter
from ladar_volume.volume.field_checks.gap_kriging import (
    ObservedPoints,
)
from ladar_volume.volume.field_checks.sight_lines import patch_views, shadow_heights, sight_slopes
from ladar_volume.volume.field_checks.unseen_surface import (
    unseen_surface,
)

LASER = np.array([-8.0, 0.0, 6.0])
TOP, SLOPE, FAR = 2.0, 0.8, 4.0


def bank(x):
    """A flat top that ends at x = 0, falls, and meets the ground before its shadow ends."""
    return np.clip(TOP - SLOPE * x, 0.0, TOP)


def rim(seed=1, count=800):
    """Points on either side of the shadow, with unit vectors to the laser."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform([-3.0, -6.0], [7.0, 6.0], (count, 2))
    xy = xy[(xy[:, 0] < 0.0) | (xy[:, 0] > FAR)]
    r = np.column_stack([xy, bank(xy[:, 0])])
    view = LASER - r
    return r, view / np.linalg.norm(view, axis=1)[:, None]


def places(count=12):
    step = (np.arange(count) + 0.5) / count
    x, y = np.meshgrid(FAR * step, 4.0 * step - 2.0)
    return np.column_stack([x.ravel(), y.ravel()]), np.full(count**2, 4.0 * FAR / count**2)


def test_views_of_patches_point_to_where_they_were_seen_from():
    rng = np.random.default_rng(3)
    xy = rng.uniform([12.0, -8.0], [16.0, -4.0], (20_000, 2))
    z = 0.3 * xy[:, 0] - 0.2 * xy[:, 1] + 0.01 * rng.standard_normal(len(xy))
    f = SurfaceFilter(Parameters.read({"filter": {"radius_m": 0.5}}))
    way = platform()
    f.add_platform(way)
    f.add(mapped(np.column_stack([xy, z])))
    patches = f.finish().patches
    view = patch_views(patches)
    true = way.p_map_body.mean(axis=0) - patches.centre
    true /= np.linalg.norm(true, axis=1)[:, None]
    inner = np.abs(patches.centre[:, :2] - [14.0, -6.0]).max(axis=1) < 1.5
    assert np.count_nonzero(inner) > 30
    np.testing.assert_allclose(view[inner], true[inner], atol=0.02)


def test_a_surface_in_shadow_lies_below_the_line_past_the_edge():
    r, view = rim()
    xy, _ = places()
    high = shadow_heights(r, view, xy, 0.4)
    # the line from the edge to the ground, which falls by 2 m over 4 m
    inner = (xy[:, 0] > 0.4) & (xy[:, 0] < 3.6) & (np.abs(xy[:, 1]) < 1.7)
    assert np.isfinite(high[inner]).mean() > 0.95
    known = inner & np.isfinite(high)
    line = TOP * (1.0 - xy[known, 0] / FAR)
    assert np.abs(high[known] - line).max() < 0.35
    assert (high[known] > bank(xy[known, 0]) - 0.1).all()


def test_what_is_seen_from_above_or_from_two_sides_is_in_no_shadow():
    r, view = rim()
    xy, _ = places()
    above = np.tile([0.2, 0.0, 0.98], (len(r), 1))
    both = view * [0.0, 0.0, 1.0]
    below = np.tile([-0.8, 0.0, -0.6], (len(r), 1))
    for views in (above, both, below, np.zeros_like(view)):
        assert not np.isfinite(shadow_heights(r, views, xy, 0.4)).any()
    # nor is a hole in the ground itself, as of a puddle, though the line there is as low
    flat = r * [1.0, 1.0, 0.0]
    assert not np.isfinite(shadow_heights(flat, view, xy, 0.4)).any()
    assert not np.isfinite(shadow_heights(r[:0], view[:0], xy, 0.4)).any()


def test_slopes_of_views():
    view = np.array([[3.0, 4.0, 5.0], [0.0, 0.0, 1.0], [0.1, 0.0, 0.1], [0.8, 0.0, -0.6]])
    view[0] /= np.linalg.norm(view[0])
    direction, slope = sight_slopes(view)
    np.testing.assert_allclose(direction[0], [0.6, 0.8])
    assert slope[0] == pytest.approx(1.0)
    assert (slope[1:] == math.inf).all()  # upright, of no one line, and from below


def test_the_volume_in_a_shadow_is_anywhere_between_the_line_and_the_steepest_slope():
    r, view = rim()
    xy, weight = places()
    variance, apart = np.full(len(r), 1e-6), np.full(len(xy), 0.3)
    true_m3 = float(weight @ bank(xy[:, 0]))
    chord = TOP * (1.0 - xy[:, 0] / FAR)
    dark = unseen_surface(ObservedPoints.of(r, variance, 0.35, view), xy, weight, apart, chord)
    smooth = unseen_surface(ObservedPoints.of(r, variance, 0.35), xy, weight, apart, chord)
    # between 45 degrees from the edge, 2 m³ a metre, and the line, 4 m³ a metre, over four metres
    assert dark.volume_m3 == pytest.approx(4.0 * 3.0, rel=0.08)
    assert dark.variance_m6**0.5 == pytest.approx(4.0 * 2.0 / math.sqrt(12.0), rel=0.35)
    assert abs(dark.volume_m3 - true_m3) < 2.0 * dark.variance_m6**0.5
    # without views the surface is bridged too high, by no more than its sigma allows
    assert smooth.volume_m3 - true_m3 > 2.0 and dark.volume_m3 < smooth.volume_m3
    assert smooth.volume_m3 - true_m3 < 2.0 * smooth.variance_m6**0.5
