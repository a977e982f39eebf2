"""What a cut may have taken of a body: against closed forms, on bare points with ragged edges."""

import math

import numpy as np
import pytest

from ladar_volume.tin.full_tin import build_tin, vertex_mask
from ladar_volume.tin.sampled_area import sampled_without_isolated
from ladar_volume.volume.base import ZERO
from ladar_volume.volume.field_checks.cut_bodies import cut_sides, missing_at_most

NOISE_M = 0.012


def missing(height, cut_m, half=12.0, seed=1, body_m3=1e9):
    """What may be missing of a body of heights (x, y) beyond x = cut_m, from 15 points a m²."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-half, half, (int(15 * 4 * half * half), 2))
    xy = xy[xy[:, 0] < cut_m]
    z = height(*xy.T) + rng.normal(0.0, NOISE_M, len(xy))
    tin, _ = sampled_without_isolated(build_tin(np.column_stack([xy, z])))
    inside = tin.relevant & (tin.vertices[tin.triangles, 2].mean(axis=1) > 0.1)
    assert vertex_mask(tin, inside).any()
    return missing_at_most(tin, ZERO, inside, cut_sides(tin, ZERO, inside, 0.05), body_m3)


@pytest.mark.parametrize("slope", [0.3, 0.6])
def test_a_slope_that_goes_on_to_the_base_is_told_to_its_end(slope):
    end, at, half = 8.0, 4.0, 9.0

    def ramp(x, y):
        return np.where((np.abs(y) < half) & (x > -8.0), np.clip(slope * (end - x), 0.0, 6.0), 0.0)

    found = missing(ramp, at)
    assert found == pytest.approx(0.5 * slope * (end - at) ** 2 * 2.0 * half, rel=0.1)


@pytest.mark.parametrize("seed", range(4))
def test_no_less_than_a_cone_has_beyond_its_cut_and_no_bar_as_large_as_the_barn(seed):
    reach, high, at = 8.0, 4.0, 4.0
    cone = lambda x, y: np.maximum(high * (1.0 - np.hypot(x, y) / reach), 0.0)  # noqa: E731
    x, y = np.meshgrid(np.arange(at, reach, 0.01), np.arange(-reach, reach, 0.01))
    true = float(cone(x, y).sum()) * 1e-4
    assert true < missing(cone, at, seed=seed) < 3.0 * true


def test_where_it_rises_towards_the_cut_twice_what_was_seen_may_be_missing():
    cone = lambda x, y: np.maximum(4.0 - 0.5 * np.hypot(x, y), 0.0)  # noqa: E731
    seen = math.pi * 8.0**2 * 4.0 / 3.0 / 4.0
    assert missing(cone, -2.0, body_m3=seen) == 2.0 * seen


def test_a_body_of_centimetres_is_as_one_of_metres():
    """The same cone a hundredth as wide and high: what may be missing is a millionth."""
    rng = np.random.default_rng(3)
    xy = rng.uniform(-12.0, 12.0, (8000, 2))
    xy = xy[xy[:, 0] < 4.0]
    r = np.column_stack([xy, np.maximum(4.0 - 0.5 * np.hypot(*xy.T), 0.0)])

    def most(scale):
        tin, _ = sampled_without_isolated(build_tin(scale * r))
        inside = tin.relevant & (tin.vertices[tin.triangles, 2].mean(axis=1) > 0.1 * scale)
        sides = cut_sides(tin, ZERO, inside, 0.05 * scale)
        return missing_at_most(tin, ZERO, inside, sides, 1e9)

    assert most(0.01) == pytest.approx(1e-6 * most(1.0), rel=0.05)
