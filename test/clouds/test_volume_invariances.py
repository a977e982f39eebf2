"""What must not change a volume: the order of the points, where they are, how they are turned about
the vertical, the unit of length; and what must add up: levels, parts of the ground, two surfaces.
Random heights, so no symmetry of a scene helps.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ladar_volume as lv

FEW = settings(max_examples=4, deadline=None, derandomize=True)
#: Every triangle counts: the area that points sample is another test's.
WHOLE = {"relevant": "all", "clean": "off"}
SEEDS = st.integers(0, 2**32 - 1)


def cloud(seed, size=250, up=1.0):
    """Points (n, 3) of a rough sheet whose edge is convex."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-3.0, 3.0, (size, 2)) * (1.0, 0.7)
    return np.column_stack([xy, up + rng.normal(0.0, 0.3, size)])


def numbers(points, base, sigma=0.01, **options):
    """Net, cut, fill, area and sigma."""
    a = lv.volume(points, base, sigma=sigma, **{**WHOLE, **options})
    return np.array([a.net_m3, a.cut_m3, a.fill_m3, a.area_m2, a.sigma_m3])


@given(seed=SEEDS)
@FEW
def test_the_order_of_the_points(seed):
    points = cloud(seed)
    other = np.random.default_rng(seed).permutation(points)
    assert numbers(other, 0.9) == pytest.approx(numbers(points, 0.9), rel=1e-9)


@given(seed=SEEDS, angle=st.floats(-np.pi, np.pi), shift=st.tuples(*[st.floats(-2e3, 2e3)] * 3))
@FEW
def test_a_rigid_motion_that_keeps_the_vertical(seed, angle, shift):
    points, (c, s) = cloud(seed), (np.cos(angle), np.sin(angle))
    moved = points @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + shift
    here, there = numbers(points, 0.9), numbers(moved, 0.9 + shift[2])
    assert there[:4] == pytest.approx(here[:4], rel=1e-7, abs=1e-7)
    assert there[4] == pytest.approx(here[4], rel=0.02)  # what lies between points: bins by axes


@given(seed=SEEDS, scale=st.floats(0.2, 50.0))
@FEW
def test_the_unit_of_length(seed, scale):
    points = cloud(seed)
    there = numbers(points * scale, 0.9 * scale, 0.01 * scale)
    volumes = np.array([scale**3] * 3 + [scale**2, scale**3])
    assert there / volumes == pytest.approx(numbers(points, 0.9), rel=1e-7)


@given(seed=SEEDS, height=st.floats(-2.0, 3.0), step=st.floats(0.05, 2.0))
@FEW
def test_levels_add_up(seed, height, step):
    """Between two levels lies the area times their distance, however the surface runs."""
    low, high = numbers(cloud(seed), height), numbers(cloud(seed), height + step)
    assert low[3] == pytest.approx(high[3], rel=1e-12)
    assert low[0] - high[0] == pytest.approx(low[3] * step, rel=1e-9)
    assert low[0] == pytest.approx(low[1] - low[2], rel=1e-12)
    assert low[1] >= high[1] and low[2] <= high[2]


@given(seed=SEEDS, at=st.floats(-1.5, 1.5))
@FEW
def test_parts_of_the_ground_add_up(seed, at):
    points = cloud(seed, up=2.0)

    def within(x0, x1):
        ring = [x0, -1.5, x1, -1.5, x1, 1.5, x0, 1.5]
        sets = [f"volume.polygon_m={ring}", "volume.outline=polygon"]
        return numbers(points, 1.0, set=sets)[:4]

    whole = within(-2.0, 2.0)
    assert within(-2.0, at) + within(at, 2.0) == pytest.approx(whole, rel=1e-8)


@given(seed=SEEDS)
@FEW
def test_two_surfaces_are_each_others_opposite(seed):
    one, two = cloud(seed), cloud(seed + 1, up=1.5)
    there, back = numbers(one, two), numbers(two, one)
    assert there[[0, 1, 2, 3]] == pytest.approx(back[[0, 2, 1, 3]] * [-1, 1, 1, 1], rel=1e-8)
    assert there[4] == pytest.approx(back[4], rel=1e-6)
