"""What a thin toe holds beyond the outline, against the exact tails of dunes."""

import math

import numpy as np
import pytest

import ladar_volume as lv
from ladar_volume.clouds.sampling.thin_toe import volume_beyond
from ladar_volume.tin.full_tin import build_tin


def cut_body(profile, cut, seed, noise, scale=1.0):
    """A body with heights profile(r), as a TIN, its triangles within the radius ``cut``, and the
    heights.
    """
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-1.0, 1.0, (2500, 2))
    z = profile(np.hypot(*xy.T)) + rng.normal(0.0, noise, len(xy))
    tin = build_tin(scale * np.column_stack([xy, z]))
    centre = tin.vertices[tin.triangles, :2].mean(axis=1)
    return tin, np.hypot(*centre.T) < cut * scale, tin.vertices[:, 2]


def dune(r):
    return 0.3 * np.exp(-((r / 0.25) ** 2))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("cut", [0.4, 0.5])
def test_the_tail_of_a_dune_is_told_from_inside(seed, cut):
    tail = dune(cut) * math.pi * 0.25**2
    assert 0.5 * tail < volume_beyond(*cut_body(dune, cut, seed, 0.002)) < 2.0 * tail


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_it_scales_with_the_volume(scale):
    one, other = (volume_beyond(*cut_body(dune, 0.5, 3, 0.002, s)) for s in (1.0, scale))
    assert other == pytest.approx(scale**3 * one, rel=1e-6)


def test_an_outline_beyond_a_sharp_toe_holds_nothing_more():
    for seed in range(4):
        assert (
            volume_beyond(*cut_body(lambda r: np.where(r < 0.5, 0.3, 0.0), 0.6, seed, 0.002)) == 0
        )


def test_a_hollow_counts_as_a_pile_does():
    tin, mask, height = cut_body(dune, 0.5, 1, 0.002)
    assert volume_beyond(tin, mask, -height) == pytest.approx(volume_beyond(tin, mask, height))


def of_file(profile, seed, noise):
    """``volume`` above the ground of a body of 9 m, with nothing set."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-1.0, 1.0, (2500, 2))
    z = profile(np.hypot(*xy.T)) + rng.normal(0.0, noise, len(xy))
    return lv.volume(9.0 * np.column_stack([xy, z]), base="ground")


@pytest.mark.parametrize("seed", range(3))
def test_the_line_of_a_dune_is_what_its_volume_lacks_and_that_of_a_cone_is_none(seed):
    found, true = of_file(dune, seed, 0.003), 9.0**3 * 0.3 * math.pi * 0.25**2
    line = math.sqrt(found.facts["budget_m6"]["toe"])
    assert 0.5 * line < true - found.net_m3 < 2.0 * line
    assert abs(true - found.net_m3) < 2.0 * found.sigma_m3 and line < 0.02 * true
    cone = of_file(lambda r: 0.4 * np.maximum(0.0, 1.0 - r / 0.5), seed, 0.003)
    assert "toe" not in cone.facts["budget_m6"]


@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize("half", [(1.1, 1.1), (8.0, 1.1), (6.0, 6.0)])
def test_boxes_on_a_grid_with_and_without_noise_have_a_volume(half, noise):
    g = np.arange(-10.0, 10.01, 0.5)
    x, y = (a.ravel() for a in np.meshgrid(g, g))
    z = np.where((np.abs(x) <= half[0]) & (np.abs(y) <= half[1]), 2.0, 0.0)
    z += np.random.default_rng(0).normal(0.0, 1.0, len(z)) * noise
    found = lv.volume(np.column_stack([x, y, z]), base="ground")
    assert math.sqrt(found.facts["budget_m6"].get("toe", 0.0)) < 0.05 * found.net_m3


def test_two_rows_of_a_body_show_no_profile():
    x, y = (a.ravel() for a in np.meshgrid(np.arange(100.0), np.arange(4.0)))
    z = np.where((y == 1.0) | (y == 2.0), 1.0 + 0.01 * np.sin(x), 0.0)
    tin = build_tin(np.column_stack([x, y, z]))
    assert volume_beyond(tin, (tin.vertices[tin.triangles, 2] > 0.5).all(axis=1), z) == 0.0
