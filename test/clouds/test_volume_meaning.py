"""What results on clouds must be whatever the way they are computed: what cancels, what does not
depend on the order, what laws of growth say.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from ladar_volume.clouds import between_points as between
from ladar_volume.clouds.cloud_surface import cloud_surface
from ladar_volume.clouds.cloud_volume import (
    above_base,
    between_clouds,
    difference_of_footprints,
    ground_and_outline,
    solid_above,
    volume_difference,
)
from ladar_volume.clouds.pair_verdict import with_pair_gaps
from ladar_volume.clouds.sampling.pair_registration import UnchangedPart, with_offset
from ladar_volume.clouds.volume_verdict import counted_areas
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.volume.cutfill import cut_sequence

ALL = SurfaceParameters(ratio=1.0)


def heap(seed, sigma_m=0.01, lift_m=0.0):
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-6.0, 6.0, (500, 2))
    z = np.maximum(1.5 - 0.6 * np.hypot(*xy.T), 0.0) + rng.normal(0.0, sigma_m, 500) + lift_m
    return cloud_surface(np.column_stack([xy, z]), ALL, sigma_m)


def parameters(**volume):
    return Parameters.read({"volume": volume})


def test_a_difference_is_as_uncertain_as_both_its_parts_whichever_comes_first():
    given = parameters(base="level", level_m=0.2, outline="all")
    a, b = (above_base(heap(seed, s), given)[0] for seed, s in ((1, 0.01), (2, 0.03)))
    one, other = volume_difference(a, b), volume_difference(b, a)
    for name in ("sigma_m3", "sigma_cut_m3", "sigma_fill_m3"):
        assert getattr(one, name) == getattr(other, name)
        parts = getattr(a, name) ** 2 + getattr(b, name) ** 2
        assert getattr(one, name) ** 2 == pytest.approx(parts)
    assert one.net_m3 == pytest.approx(a.net_m3 - b.net_m3)


@pytest.mark.parametrize(
    "base",
    [
        {"base": "level", "level_m": 0.3},
        {"base": "plane", "plane": [0.3, 0.1, -0.05]},
    ],
)
def test_a_cloud_lifted_by_the_offset_has_the_volume_it_had(base):
    given = parameters(outline="all", **base)
    found, _, _ = difference_of_footprints(heap(3, lift_m=0.25), heap(3), given, True, 0.25)
    assert [found.net_m3, found.cut_m3, found.fill_m3] == pytest.approx([0.0] * 3, abs=1e-9)
    assert found.area_m2 > 100.0


def test_a_volume_above_its_own_ground_does_not_change_where_all_is_lifted_or_tilted():
    """So its gradient by the heights has no sum, and no moment: the base goes with its points."""
    given, surface = parameters(base="ground", outline="auto"), heap(4)
    tin = surface.representation.tin
    variance = surface.representation.covariance(surface.sigma_m).diagonal()
    base, inside = ground_and_outline(tin, variance, given)
    assert len(base.support)
    solid = solid_above(surface, base, inside, given, variance)
    assert solid.cut_m3 > 1.0
    by_net = solid.gradients[0][1][:, 0]
    motions = np.column_stack([np.ones(len(by_net)), tin.vertices[:, :2] - base.origin_xy])
    np.testing.assert_allclose(by_net @ motions, 0.0, atol=1e-9 * np.abs(by_net).sum())


class Thinned:
    """Blocks of a volume that a coarser surface changes, as laws of growth have them."""

    def __init__(self, ratio, step_m6, curve_m3, count=400):
        self.ratio, self.count = ratio, count
        self.one, self.all = step_m6 * (ratio**3 - 1.0), curve_m3 * (ratio**2 - 1.0)

    def __call__(self, part, kept):
        sign = np.where(np.arange(self.count) % 2, 1.0, -1.0)
        blocks = sign * math.sqrt(self.one / self.count) + self.all / self.count
        return blocks, 0.0, self.ratio


@pytest.mark.parametrize("ratio", [1.4, 2.0, 3.0])
@pytest.mark.parametrize(("step_m6", "curve_m3"), [(0.04, 0.0), (0.0, 0.7)])
def test_what_lies_between_points_is_the_same_however_coarse_the_surface_that_tells_it(
    ratio, step_m6, curve_m3, monkeypatch
):
    """Steps have a variance as the cube of the spacing, curvature a bias as its square; a coarser
    surface differs from the first by what it has more of these.
    """
    surface = heap(5)
    area = np.full(len(surface.representation.tin.triangles), 0.1)
    monkeypatch.setattr(between, "wide", lambda *given: 1.0)
    monkeypatch.setattr(between, "coarser", Thinned(ratio, step_m6, curve_m3))
    found = between.between_points(surface, area, surface.representation.tin.vertices[:, 2])
    # the variance of 400 blocks is itself known to 2 in 400
    assert found.random_m6 == pytest.approx(
        step_m6 * (1.0 + 2.0 / 400.0), rel=1e-9, abs=0.01 * curve_m3
    )
    assert found.drift_m3 == pytest.approx(curve_m3)


@pytest.mark.parametrize("heights", [(0.0, 0.0, 3.0), (3.0, 0.0, 3.0)])
def test_a_triangle_over_a_step_is_off_by_what_it_holds_of_it_or_by_what_it_lacks(heights):
    """The step may lie anywhere between the corners: at the high ones, or at the low ones."""
    tin = build_tin(np.column_stack([[0.0, 4.0, 0.0], [0.0, 0.0, 5.0], heights]))
    held = float(cut_sequence(tin, np.array([0.0])).cut_m3[0])
    all_m3 = 10.0 * 3.0
    expected = held if sum(heights) < 4.0 else all_m3 - held
    every = np.ones(1, np.bool_)
    found = between.bridged_deviation(tin, np.array([10.0]), tin.vertices[:, 2], every)
    assert found == pytest.approx(expected)
    seen = dataclasses.replace(between.BetweenPoints(0.04, 0.3, found), random_m6=0.16)
    assert seen.variance_m6 == pytest.approx(0.25)


@pytest.mark.parametrize("sigma_m", [0.001, 0.01])
def test_an_offset_is_in_the_variance_with_what_is_not_known_of_it(sigma_m):
    """The mean square of an offset that was told with an error."""
    given = parameters(base="level", level_m=0.2, outline="all")
    volume, offset_m = above_base(heap(6), given)[0], 0.05
    told = UnchangedPart(offset_m, sigma_m, 4.0 * sigma_m, 0.5, 0.3)
    found, doubts = with_offset(volume, told)
    drawn = np.random.default_rng(1).normal(offset_m, sigma_m, 400_000) * volume.area_m2
    assert found.budget_m6["registration"] == pytest.approx(np.mean(drawn**2), rel=0.005)
    more = found.sigma_m3**2 - volume.sigma_m3**2
    assert [d.name for d in doubts] == ["offset"]
    assert more == pytest.approx(found.budget_m6["registration"])


def holed(height, seed, sigma_m=0.01):
    """A cloud of which a round place on a slope was not seen."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-6.0, 6.0, (2500, 2))
    xy = xy[np.hypot(*(xy - [1.0, 0.0]).T) > 1.0]
    return cloud_surface(np.column_stack([xy, height(xy)]), ALL, sigma_m)


def test_what_gaps_held_is_cut_of_a_heap_and_fill_of_the_pit_that_it_leaves():
    def round_top(xy):
        return np.maximum(2.0 - 0.15 * (xy**2).sum(axis=1), 0.0)

    one, two = holed(round_top, 7), heap_of_nothing()
    heap_m3 = between_clouds(one, two, "flat")
    pit_m3 = between_clouds(two, one, "heap")
    areas = [counted_areas(s, s.representation.tin.relevant) for s in (one, two)]
    cut, _ = with_pair_gaps(heap_m3, [one, two], areas)
    fill, _ = with_pair_gaps(pit_m3, [two, one], areas[::-1])
    assert (fill.fill_m3, fill.cut_m3) == pytest.approx((cut.cut_m3, cut.fill_m3))
    # what is round bulges above the chords of a gap
    truth = math.pi * 2.0**2 / 0.3
    assert cut.cut_m3 > heap_m3.cut_m3 + 0.02 and cut.budget_m6["unseen"] > 0.0
    assert abs(cut.cut_m3 - truth) < 0.5 * abs(heap_m3.cut_m3 - truth)


def heap_of_nothing():
    """Flat ground, seen everywhere."""
    xy = np.random.default_rng(8).uniform(-6.0, 6.0, (2500, 2))
    return cloud_surface(np.column_stack([xy, np.zeros(2500)]), ALL, 0.01)
