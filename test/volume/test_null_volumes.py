"""Outlines laid on ground where nothing stands give zero as closely as the ground's field says."""

import dataclasses

import numpy as np
import pytest

from ladar_volume.ground.polynomial import design_surface
from ladar_volume.tin.full_tin import build_tin, footprint_areas
from ladar_volume.uncertainty.ground_field import Roughness
from ladar_volume.volume.field_checks.null_volumes import (
    FEWEST,
    null_volume_doubts,
    null_volumes,
    outlines_on_ground,
)

#: Edge of the ground and half of the outline in its middle, m.
HALF, OWN = 12.0, 3.0


def level_ground(height):
    """A TIN of points 0.4 m apart with heights (n,) of xy (n, 2), its base, the area of each
    triangle of the square in the middle, and the variance of the heights.
    """
    g = np.arange(-HALF, HALF + 0.1, 0.4)
    xy = np.stack(np.meshgrid(g, g), axis=-1).reshape(-1, 2)
    xy += 0.05 * np.random.default_rng(3).normal(size=xy.shape)
    tin = build_tin(np.column_stack([xy, height(xy)]))
    middle = tin.vertices[tin.triangles, :2].mean(axis=1)
    inside = (np.abs(middle) < OWN).all(axis=1)
    area = np.where(inside, footprint_areas(tin.vertices, tin.triangles), 0.0)
    far = (np.abs(tin.vertices[:, :2]) > OWN + 0.5).any(axis=1)
    base = dataclasses.replace(design_surface([0.0, 0.0, 0.0]), support=np.flatnonzero(far))
    return tin, base, area, np.full(len(tin.vertices), 1e-8)


def white(xy):
    return 0.01 * np.random.default_rng(5).normal(size=len(xy))


WHITE = Roughness(1e-4, 0.2, 0.4, 1.0)


def test_outlines_lie_side_by_side_on_the_ground_and_off_the_body():
    tin, base, area, _ = level_ground(white)
    xy = tin.vertices[base.support, :2]
    found, size = outlines_on_ground(tin, area, xy, 0.8)
    assert len(found) >= 6 and size == 1.0
    total = np.sum(found, axis=0)
    assert total.max() == 1  # none lies on two
    for under in found:
        assert np.count_nonzero(under) >= FEWEST
        wide = np.ptp(xy[under], axis=0)
        assert (wide > 2.0 * OWN - 1.0).all() and (wide < 2.0 * OWN + 1.2).all()


def test_null_volumes_of_rough_ground_spread_as_predicted():
    found = null_volumes(*level_ground(white), WHITE)
    assert 0.2 < found.factor < 2.0 and found.scale == 1.0
    assert null_volume_doubts(found, 36.0, 0.1) == []


def test_the_mean_of_each_is_that_of_a_fit_without_it():
    tin, base, area, variance = level_ground(lambda xy: white(xy) + 0.03 * np.sin(0.5 * xy[:, 0]))
    found = null_volumes(tin, base, area, variance, WHITE)
    xyz = tin.vertices[base.support]
    under, _ = outlines_on_ground(tin, area, xyz[:, :2], 2.0 * WHITE.spacing_m)
    for height, one in zip(found.height_m, under, strict=True):
        A = np.column_stack([np.ones(len(xyz)), xyz[:, :2]])
        fit = np.linalg.lstsq(A[~one], xyz[~one, 2], rcond=None)[0]
        assert height == pytest.approx(np.mean(xyz[one, 2] - A[one] @ fit), abs=1e-9)


def test_waves_that_the_field_does_not_know_are_told():
    waves = level_ground(lambda xy: white(xy) + 0.02 * np.sin(0.7 * xy[:, 0]) * (xy[:, 1] > 0))
    found = null_volumes(*waves, WHITE)
    assert found.scale == found.factor > 4.0
    (doubt,) = null_volume_doubts(found, 36.0, 0.1)
    assert doubt.name == "null_volumes" and "survey the empty site" in doubt.text


def test_ground_without_room_tells_nothing():
    tin, base, area, variance = level_ground(white)
    x = tin.vertices[base.support, 0]
    one = dataclasses.replace(base, support=base.support[x > HALF - 0.5])
    found = null_volumes(tin, one, area, variance, WHITE)
    assert not len(found.height_m) and found.scale == 1.0 and found.p_value == 1.0
