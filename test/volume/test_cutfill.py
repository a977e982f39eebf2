"""Sequences over levels against one level at a time, closed forms, flat and touching triangles,
large datums.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from plain_integrals import positive_mean, sequence_plain

from ladar_volume.ground.polynomial import design_surface
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import Tin
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.volume.cutfill import (
    add_piece,
    count_below,
    cut_sequence,
    sequence_gradient,
    sequence_kernel,
    triangle_heights,
)
from ladar_volume.volume.overlay import volumes_between
from ladar_volume.volume.prismoids import prismoids

ROOF = {
    0: (49 / 3, 1 / 3),
    1: (20 / 3, 8 / 3),
    2: (1, 9),
    2.5: (0.125, 14.125),
    3: (0, 20),
    5: (0, 44),
    -1: (28, 0),
    -2: (40, 0),
}


def roof():
    vertices = np.array([(0, 0, 0), (4, 0, 1), (4, 3, 2), (0, 3, -1), (2, 1.5, 3)], float)
    triangles = np.array([(0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)], np.int32)
    return Tin(vertices, triangles, np.full((4, 3), -1, np.int32), np.ones(4, bool), np.arange(5))


def random_tin(n=150, seed=0, steps=False):
    rng = np.random.default_rng(seed)
    z = rng.integers(-2, 3, n).astype(float) if steps else rng.normal(0, 1, n)
    return build_tin(np.c_[rng.uniform(0, 10, (n, 2)), z])


def test_the_roof_in_one_pass():
    s = cut_sequence(roof(), np.array(list(ROOF), float))
    assert np.c_[s.cut_m3, s.fill_m3] == pytest.approx(np.array(list(ROOF.values())), abs=1e-12)
    assert s.area_m2 == 12.0 and (s.cut_m3[4:6] == 0).all() and (s.fill_m3[6:] == 0).all()
    level = prismoids(roof(), design_surface([1.0]))
    assert (level.cut_m3, level.fill_m3) == pytest.approx(ROOF[1], abs=1e-12)
    lower = build_tin(np.array([[-1, -1, 1], [9, -1, 1], [9, 9, 1], [-1, 9, 1.0]]))
    p = volumes_between(roof(), lower)
    assert (p.cut_m3, p.fill_m3) == pytest.approx(ROOF[1], abs=1e-12)
    one = np.array([True, False, False, False])
    assert volumes_between(
        dataclasses.replace(roof(), relevant=one), lower
    ).net_m3 == pytest.approx(prismoids(roof(), design_surface([1.0]), one).net_m3, abs=1e-12)


@pytest.mark.parametrize("steps", [False, True])
@pytest.mark.parametrize("count", [1, 2, 3, 37, 256])
def test_sequences_equal_one_level_at_a_time(steps, count):
    tin = random_tin(seed=count, steps=steps)
    levels = np.linspace(-2.5, 2.5, count) if count > 1 else np.array([0.25])
    h, area, _ = triangle_heights(tin, None, None)
    plain = sequence_plain(h, area, levels)
    s = cut_sequence(tin, levels)
    assert np.c_[s.cut_m3, s.above_m2] == pytest.approx(plain, abs=1e-11)
    assert s.fill_m3 == pytest.approx(sequence_plain(-h, area, -levels)[:, 0], abs=1e-11)
    p = prismoids(tin, design_surface([levels[0]]))
    assert (s.cut_m3[0], s.fill_m3[0]) == pytest.approx((p.cut_m3, p.fill_m3), abs=1e-11)


def test_small_cuts_keep_their_digits():
    # a spike over a wide plain and near-flat triangles: the last cubic millimetres are a difference
    # of nothing
    tin = random_tin(seed=1)
    v = tin.vertices.copy()
    v[:, 2] = 1e-9 * v[:, 2]
    v[7, 2] = 2.0
    spike = dataclasses.replace(tin, vertices=v)
    levels = np.r_[np.linspace(-1e-8, 1e-8, 50), np.linspace(1e-3, 1.999999, 400)]
    s = cut_sequence(spike, levels)
    h, area, _ = triangle_heights(spike, None, None)
    assert s.cut_m3 == pytest.approx(sequence_plain(h, area, levels)[:, 0], rel=1e-9, abs=1e-22)


def test_slope_of_the_sequence_is_the_area_above_and_levels_differ_by_slabs():
    tin = random_tin(seed=2)
    z, h = np.linspace(-1.5, 1.5, 21), 1e-5
    s, up, down = (cut_sequence(tin, z + d) for d in (0, h, -h))
    assert -(up.cut_m3 - down.cut_m3) / (2 * h) == pytest.approx(s.above_m2, abs=1e-6)
    assert (up.fill_m3 - down.fill_m3) / (2 * h) == pytest.approx(s.below_m2, abs=1e-6)
    assert s.above_m2 + s.below_m2 == pytest.approx(np.full(21, s.area_m2), rel=1e-12)
    assert s.net_m3[:-1] - s.net_m3[1:] == pytest.approx(s.area_m2 * np.diff(z), rel=1e-9)


def test_order_repetition_datum_and_parts():
    tin = random_tin(seed=3)
    z = np.array([0.5, -1.0, 0.5, 2.0, 0.0])
    s, ordered = cut_sequence(tin, z), cut_sequence(tin, np.unique(z))
    assert s.cut_m3 == pytest.approx(ordered.cut_m3[[2, 0, 2, 3, 1]], rel=1e-13) and np.array_equal(
        s.level_m, z
    )
    high = cut_sequence(
        dataclasses.replace(tin, vertices=tin.vertices + np.array([4e5, 5e6, 1000.0])), z + 1000.0
    )
    assert high.cut_m3 == pytest.approx(s.cut_m3, abs=1e-6)
    part = np.random.default_rng(0).random(len(tin.triangles)) < 0.3
    one, two = cut_sequence(tin, z, mask=part), cut_sequence(tin, z, mask=~part)
    assert one.cut_m3 + two.cut_m3 == pytest.approx(s.cut_m3, abs=1e-11)
    marked = cut_sequence(dataclasses.replace(tin, relevant=part), z)
    assert np.array_equal(marked.fill_m3, one.fill_m3)
    plane = design_surface([0.2, 0.1, -0.05])
    assert cut_sequence(tin, np.array([0.0, 0.3]), plane).cut_m3[0] == pytest.approx(
        prismoids(tin, plane).cut_m3, rel=1e-12
    )


def test_a_surface_flat_at_the_level():
    flat = build_tin(np.array([[0, 0, 1], [2, 0, 1], [2, 2, 1], [0, 2, 1.0]]))
    s = cut_sequence(flat, np.array([0.5, 1.0, 1.5]))
    assert s.cut_m3 == pytest.approx([2, 0, 0], abs=1e-15) and s.fill_m3 == pytest.approx(
        [0, 0, 2], abs=1e-15
    )
    assert s.cut_m3[1] == s.fill_m3[1] == s.above_m2[1] == s.below_m2[1] == 0.0


def test_gradient_of_a_weighted_sequence():
    tin, z = random_tin(40, seed=4), np.array([-0.4, 0.1, 0.6])
    w, h = np.array([1.0, -2.0, 0.7]), 1e-6
    g = sequence_gradient(tin, z, w)
    for i in range(0, 40, 7):
        step = np.zeros_like(tin.vertices)
        step[i, 2] = h
        up, down = (
            w @ cut_sequence(dataclasses.replace(tin, vertices=tin.vertices + e * step), z).cut_m3
            for e in (1, -1)
        )
        assert g[i] == pytest.approx((up - down) / (2 * h), abs=1e-6)


@pytest.mark.parametrize("levels", [[], [np.nan], [0.0, np.inf], [[0.0]]])
def test_bad_levels(levels):
    with pytest.raises(VolumeError) as caught:
        cut_sequence(roof(), levels)
    assert caught.value.reason == "volume_levels"


def test_no_triangles():
    with pytest.raises(VolumeError) as caught:
        cut_sequence(roof(), np.zeros(1), mask=np.zeros(4, bool))
    assert caught.value.reason == "volume_no_triangle"


def test_a_sequence_by_divided_differences():
    h, area, _ = triangle_heights(random_tin(20, seed=5), None, None)
    levels, step = np.linspace(-1, 1, 11) + 0.003, 1e-30
    found = sequence_kernel(h, area, levels)
    above = [area @ positive_mean(h - z - 1j * step) for z in levels]
    assert found[:, 0] == pytest.approx(np.real(above), rel=1e-11)
    assert found[:, 1] == pytest.approx(-np.imag(above) / step, rel=1e-10)  # how fast it shrinks
    for z in (-5.0, levels[4], 0.2, 9.0):
        assert count_below(levels, z) == np.searchsorted(levels, z)


def test_levels_of_a_piece_add_up_along_their_branch():
    centre, level = np.linspace(0, 1, 32), np.linspace(-0.5, 1.5, 16)
    for low, high in ((3, 13), (0, 16), (5, 5), (7, 8)):
        tree = np.zeros((32, 4))
        add_piece(tree, centre, low, high, 0.2, 1.0, -2.0, 0.5)
        for leaf, z in enumerate(level):
            branch = [(16 + leaf) >> k for k in range(5)]
            found = sum(np.polyval(tree[node, ::-1], z - centre[node]) for node in branch)
            x = z - 0.2
            expected = 1.0 - 2.0 * x + 0.5 * x**3 if low <= leaf < high else 0.0
            assert found == pytest.approx(expected, abs=1e-12)
