"""Floors, tops and offsets: exact steps, noise, printed sums, and the two methods on a body that is
known.
"""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest

from ladar_volume.model.errors import VolumeError
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.tin.scan_frame import frame_along
from ladar_volume.volume import floors as levels
from ladar_volume.volume import published_methods
from ladar_volume.volume.cutfill import cut_sequence
from ladar_volume.volume.floors import (
    event_gradient,
    floors,
    offset_sums,
    parabola_minimum,
    reach,
    sequence_offset,
    spikes,
    surface_offset,
)
from ladar_volume.volume.overlay import volumes_between
from ladar_volume.volume.published_methods import (
    front_level,
    level_pairs,
    method_one,
    method_two,
    zero_fill_level,
)

#: Table 5.6: levels (cm) and cut volumes (cm³) with and without the box.
TABLE = np.array(
    [
        (-30, 70, 53),
        (-30.2, 80, 58),
        (-30.4, 87, 65),
        (-30.6, 94, 73),
        (-30.8, 105, 80),
        (-31, 114, 89),
        (-31.2, 124, 97),
        (-31.4, 138, 107),
        (-31.6, 148, 116),
        (-31.8, 159, 126),
        (-32, 172, 139),
        (-32.2, 187, 151),
        (-32.4, 200, 165),
        (-32.6, 214, 175),
        (-32.8, 231, 189),
        (-33, 246, 205),
        (-78.2, 84954, 81639),
        (-78.4, 85906, 82549),
        (-78.6, 86872, 83466),
        (-78.8, 87845, 84380),
        (-79, 88825, 85300),
        (-79.2, 89808, 86230),
        (-79.4, 90818, 87162),
        (-79.6, 91813, 88096),
        (-79.8, 92823, 89043),
        (-80, 93844, 89983),
    ]
)


def box(floor=0.1234, top=1.0571, noise=0.0, n=41, seed=0, shift=0.0, wall=1e-3):
    """A block of 2 by 2 on a floor of 4 by 4, its walls ``wall`` wide, on a grid that has them as
    edges.
    """
    rng = np.random.default_rng(seed)
    ticks = np.unique(
        np.r_[
            np.linspace(0, 1, n // 4),
            np.linspace(1 + wall, 3 - wall, n // 2),
            np.linspace(3, 4, n // 4),
        ]
    )
    x, y = (a.ravel() for a in np.meshgrid(ticks, ticks))
    on = (np.abs(x - 2) < 1 - wall / 2) & (np.abs(y - 2) < 1 - wall / 2)
    return build_tin(
        np.c_[x, y, np.where(on, top, floor) + shift + noise * rng.normal(size=len(x))]
    )


@pytest.mark.parametrize("step", [0.005, 0.01, 0.03])
def test_floor_and_top_between_the_levels(step):
    f = floors(box(), step)
    assert len(f.events) == 2 and f.floor is f.events[0] and f.top is f.events[1]
    # the walls' own area leans on the spikes by less than their share
    assert f.floor.level_m == pytest.approx(
        0.1234, abs=0.002 * step
    ) and f.top.level_m == pytest.approx(1.0571, abs=0.002 * step)
    assert f.floor.area_m2 == pytest.approx(12.0, rel=0.01) and f.top.area_m2 == pytest.approx(
        4.0, rel=0.01
    )
    assert (
        np.array_equal(f.second_m3, np.diff(f.first_m3)) and len(f.first_m3) == len(f.level_m) - 1
    )
    shifted = floors(box(shift=0.0037), step)
    assert shifted.top.level_m - f.top.level_m == pytest.approx(0.0037, abs=0.002 * step)


def test_noise_widens_the_spike_and_leaves_its_middle():
    tin = box(noise=0.01, n=81)
    f = floors(tin, 0.002)
    z = tin.vertices[:, 2]
    for event, true, near in ((f.floor, 0.1234, z < 0.5), (f.top, 1.0571, z > 0.5)):
        assert event.level_m == pytest.approx(true, abs=5 * 0.01 / math.sqrt(near.sum()))
        # heights between the vertices vary less than at them
        assert 0.5 * 0.01 < event.width_m < 0.01


def test_gradient_of_a_floor_is_its_share_of_the_area():
    tin = box(noise=0.004, n=21)
    f = floors(tin, 0.005)
    g = event_gradient(tin, f, f.floor)
    assert g.sum() == pytest.approx(1.0, abs=0.02)  # the spike moves with its heights
    h = 1e-5
    for i in np.flatnonzero(tin.vertices[:, 2] < 0.5)[::40]:
        step = np.zeros_like(tin.vertices)
        step[i, 2] = h
        levels = []
        for e in (1, -1):
            cut = cut_sequence(
                dataclasses.replace(tin, vertices=tin.vertices + e * step), f.level_m
            ).cut_m3
            area = (
                np.diff(cut, 2)[f.floor.first - 1 : f.floor.last] / 0.005
                - np.median(f.second_m3) / 0.005
            )
            z = f.level_m[f.floor.first : f.floor.last + 1]
            levels.append((area * (z - f.floor.level_m)).sum() / f.floor.area_m2)
        assert g[i] == pytest.approx((levels[0] - levels[1]) / (2 * h), abs=1e-5)


def test_one_event_slopes_and_bad_levels():
    flat = floors(
        build_tin(np.array([[0, 0, 1.013], [2, 0, 1.013], [2, 2, 1.013], [0, 2, 1.013]])), 0.01
    )
    assert (
        flat.floor is flat.top
        and flat.floor.level_m == pytest.approx(1.013, abs=1e-12)
        and flat.floor.width_m == pytest.approx(0, abs=0.005)
    )
    for step in (0.0, -1.0, np.nan, 1e-12):
        with pytest.raises(VolumeError) as caught:
            floors(box(), step)
        assert caught.value.reason == "volume_levels"
    for level, cut in (
        ([0, 1, 2], [3, 2, 1]),
        ([0, 1, 2, 4, 5], np.zeros(5)),
        ([5, 4, 3, 2, 1], np.zeros(5)),
        (np.arange(6.0), np.full(6, np.nan)),
    ):
        with pytest.raises(VolumeError) as caught:
            spikes(np.array(level, float), np.array(cut, float))
        assert caught.value.reason == "volume_levels"
    assert spikes(np.arange(8.0), np.zeros(8)) == ()
    assert reach(np.array([0, 1, 5, 9, 4, 0, 0.0]), np.ones(7, bool), 3) == (0, 5)


def test_the_printed_sums_have_their_minimum_at_0_64():
    # printed are square roots of sums of squares
    assert parabola_minimum(
        np.array([0.4, 0.6, 0.8, 1.0]), np.array([9652.648, 3336.779, 6552.811, 13630.473]) ** 2
    ) == pytest.approx(0.644, abs=5e-4)


@pytest.mark.parametrize("foot", [-700.0, 0.0, 1000.0])
def test_how_many_levels_are_too_many_whatever_the_height_above_the_sea(foot, monkeypatch):
    monkeypatch.setattr(levels, "MAX_LEVELS", 100)
    body = box(floor=foot, top=foot + 8.0)
    assert len(floors(body, 8.0 / 93.0).level_m) > 0  # three more at both ends
    with pytest.raises(VolumeError) as caught:
        floors(body, 8.0 / 95.0)
    assert caught.value.reason == "volume_levels"


def test_sums_that_bend_down_have_no_minimum_between_those_tried():
    for sums in ([1.0, 2.0, 2.5], [2.5, 2.0, 1.0], [2.0, 2.0, 2.0]):
        assert parabola_minimum(np.array([-0.1, 0.0, 0.1]), np.array(sums)) == 0.0


def test_the_printed_rows_are_offset_by_0_6_cm():
    level, a, b = TABLE[:16].T
    sums = offset_sums(level, a, b, np.array([0.4, 0.6, 0.8, 1.0]))
    # printed numbers, paired by hand: a(z + 0.6) − b(z) for z from −31.0, where all four offsets
    # stay inside
    by_hand = [(a[i - 3] - b[i]) ** 2 for i in range(5, 16)]
    assert np.argmin(sums) == 1 and sums[1] == pytest.approx(sum(by_hand), rel=1e-9)
    # a(z + d) = b(z): level -74.4 with the box goes with -75.0 without
    found = sequence_offset(level, a, b, 0.9)
    assert found.offset_m == pytest.approx(0.6, abs=0.05) and found.sigma_m < 0.05
    # far behind, where volumes are large, the printed rows differ by more
    level, a, b = TABLE[16:].T
    assert np.argmin(offset_sums(level, a, b, np.array([0.4, 0.6, 0.8, 1.0]))) == 2


def test_offset_of_shifted_surfaces():
    rng = np.random.default_rng(3)
    a = build_tin(np.c_[rng.uniform(0, 5, (300, 2)), rng.normal(0, 0.3, 300)])
    b = dataclasses.replace(a, vertices=a.vertices - [0, 0, 0.0064])
    z = np.linspace(-0.5, 0.4, 200)
    exact = surface_offset(a, b, z)
    assert (
        exact.offset_m == pytest.approx(0.0064, abs=1e-10)
        and exact.sigma_m < 1e-9
        and exact.levels == 200
    )
    wide = np.linspace(-0.6, 0.5, 400)
    found = sequence_offset(wide, cut_sequence(a, wide).cut_m3, cut_sequence(b, wide).cut_m3, 0.05)
    assert found.offset_m == pytest.approx(0.0064, abs=1e-6)
    back = sequence_offset(
        wide[::-1], cut_sequence(b, wide[::-1]).cut_m3, cut_sequence(a, wide[::-1]).cut_m3, 0.05
    )
    assert back.offset_m == pytest.approx(-0.0064, abs=1e-6)
    with pytest.raises(VolumeError):
        surface_offset(a, b, z + 100.0)
    for arguments in (
        (wide, wide[:5], wide, 0.05),
        (np.zeros(5), np.zeros(5), np.zeros(5), 0.05),
        (wide, wide, wide, 9.0),
        (wide, wide, wide, -1.0),
    ):
        with pytest.raises(VolumeError):
            sequence_offset(*arguments)
    with pytest.raises(VolumeError):
        offset_sums(wide, wide, wide, np.array([-5.0, 5.0]))


def test_both_methods_and_the_overlay_find_a_known_body_in_any_frame():
    body = box(floor=0.0, top=0.9)
    bare = dataclasses.replace(body, vertices=body.vertices * [1, 1, 0])
    true = volumes_between(body, bare).net_m3
    assert true == pytest.approx(0.9 * 4.0, rel=2e-3)
    rng = np.random.default_rng(0)
    tilt = frame_along(np.array([0.2, 0.1, -1.0]))
    for turn in (lambda r: r, tilt.points):
        one, two = (dataclasses.replace(t, vertices=turn(t.vertices)) for t in (body, bare))
        high = max(one.vertices[:, 2].max(), two.vertices[:, 2].max()) + rng.uniform(0, 1, 3)
        first, second = method_one(one, two, high), method_two(one, two)
        # signed areas: the body's shadow, where the surface folds over itself, counts with its sign
        assert second.volume_m3 == pytest.approx(np.full(1, true), rel=1e-9)
        assert first.volume_m3 == pytest.approx(np.full(3, true), rel=1e-9)
        assert first.slope_m2 == pytest.approx(0.0, abs=1e-9) and first.areas_m2[
            0
        ] == pytest.approx(first.areas_m2[1], rel=1e-9)
        assert np.isnan(second.slope_m2)


def test_offset_slope_and_front_of_the_methods():
    body = box(floor=0.0, top=0.9, shift=0.006)
    bare = dataclasses.replace(
        box(floor=0.0, top=0.0), vertices=box(floor=0.0, top=0.0).vertices * [1, 1, 1]
    )
    aligned = method_two(body, bare, offset_m=0.006)
    assert aligned.volume_m3[0] == pytest.approx(
        3.6, rel=2e-3
    ) and aligned.level_without_m == pytest.approx(aligned.level_with_m - 0.006)
    assert method_two(body, bare).volume_m3[0] - aligned.volume_m3[0] == pytest.approx(
        16 * 0.006, rel=1e-9
    )
    # footprints that differ make a linear trend: Method 2 over the level, seed 000 section 5.4
    wide = dataclasses.replace(body, vertices=body.vertices * [1.01, 1, 1])
    trend = method_two(wide, bare, np.array([-1.0, -2.0, -3.0]))
    assert trend.slope_m2 == pytest.approx(-0.01 * 16.0, rel=1e-9)
    front = front_level(body, bare, 0.01, 0.006)
    assert 0.89 < front < 0.93 and zero_fill_level(body, bare, 0.006) == pytest.approx(0.006)
    assert method_one(body, bare, np.array([front]), 0.006).volume_m3[0] == pytest.approx(
        3.6, rel=5e-3
    )
    with pytest.raises(VolumeError) as caught:
        method_two(body, bare, np.array([0.5]))
    assert caught.value.reason == "volume_fill"
    with pytest.raises(VolumeError) as caught:
        level_pairs(body, bare, np.zeros(1), 0.0, "net")
    assert caught.value.reason == "volume_part"
    with pytest.raises(VolumeError) as caught:
        front_level(bare, bare, 0.01)
    assert caught.value.reason == "volume_no_body"
    with pytest.raises(VolumeError) as caught:
        front_level(body, bare, 0.0)
    assert caught.value.reason == "volume_levels"
    none = dataclasses.replace(bare, relevant=np.zeros(len(bare.triangles), bool))
    with pytest.raises(VolumeError) as caught:
        method_two(body, none)
    assert caught.value.reason == "volume_no_triangle"


def test_a_million_levels_are_too_many_and_one_fewer_is_not(monkeypatch):
    body, bare = box(floor=0.0, top=1.0), box(floor=0.0, top=0.0)
    high = float(body.vertices[:, 2].max() - zero_fill_level(body, bare))
    with pytest.raises(VolumeError) as caught:
        front_level(body, bare, high / 1e6)
    assert caught.value.reason == "volume_levels" and caught.value.value == high / 1e6
    counts = []

    def some(tin, level):
        counts.append(len(level))
        cut = np.where(level < 0.5, float(tin is body), 0.0)
        return SimpleNamespace(cut_m3=cut)

    monkeypatch.setattr(published_methods, "cut_sequence", some)
    step = high / 999_999.5
    # the last level at which the two differ is just below a half: one step above it
    assert front_level(body, bare, step) == pytest.approx(0.5 + step / 2.0, abs=0.6 * step)
    assert counts == [1_000_001] * 2
