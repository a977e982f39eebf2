"""What the folded-normal correction leaves: closed form at zero, scatter of chosen vertices, and
coverage of cut and of fill between two clouds.
"""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import special

from benchmarks.cut_fill_coverage import errors
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.tin.median_screen import edges
from ladar_volume.volume.near_base import scatter
from ladar_volume.volume.neighbourhood import Smooth
from ladar_volume.volume.remaining_fold import LEFT, plane_misfits, remaining_fold


def positive_mean(mu, s):
    return mu * special.ndtr(mu / s) + s * np.exp(-0.5 * (mu / s) ** 2) / math.sqrt(2 * math.pi)


def field(n, seed, truth=0.0, noise=0.03):
    rng = np.random.default_rng(seed)
    tin = build_tin(np.c_[rng.uniform(0, 10, (n, 2)), np.zeros(n)])
    return tin, truth + noise * rng.normal(size=n), np.full(n, noise**2)


def test_what_is_left_at_zero_and_over_an_even_spread():
    s, spread = 0.1, 0.01
    for mu, left in ((0.0, LEFT), (8.0, 0.0)):
        g = [positive_mean(mu, math.hypot(s, k * spread)) for k in (1.0, math.sqrt(2.0))]
        b = [positive_mean(mu, k * spread) for k in (1.0, math.sqrt(2.0))]
        taken = 2 * g[0] - 2 * b[0] - g[1] + b[1]
        found = (positive_mean(mu, s) - max(mu, 0.0) - taken) / spread
        assert found == pytest.approx(left, abs=1e-3)
    m = np.linspace(-12, 12, 240001)
    even = 2 * positive_mean(m, 1.0) - positive_mean(m, math.sqrt(2.0)) - np.maximum(m, 0.0)
    assert even.sum() * (m[1] - m[0]) == pytest.approx(0.0, abs=1e-6)
    # the bump's mean at a true height of zero
    bump = np.exp(-0.5 * m**2) * np.exp(-0.5 * m**2) / math.sqrt(2 * math.pi)
    assert math.sqrt(2.0) * bump.sum() * (m[1] - m[0]) == pytest.approx(1.0, abs=1e-9)


def test_all_is_taken_at_zero_and_nothing_far_from_it():
    area = np.full(10000, 100.0)
    found, uncertain = [], []
    for seed in range(10):
        tin, h, variance = field(2000, seed)
        smooth = Smooth(tin, h, variance, np.ones(2000, bool), 4)
        own = area[: len(tin.triangles)] / len(tin.triangles)
        part = remaining_fold(smooth, tin.triangles, own, 4)
        s = np.sqrt(smooth.variance[np.unique(tin.triangles)]).mean()
        found.append(part.fold_m3 / (LEFT * s * 100.0))
        uncertain.append(part.sigma_m3 / (LEFT * s * 100.0))
    assert np.mean(found) == pytest.approx(1.0, abs=0.2) and 0.1 < np.mean(uncertain) < 0.8
    tin, h, variance = field(2000, 3, truth=0.2)
    smooth = Smooth(tin, h, variance, np.ones(2000, bool), 4)
    far = remaining_fold(smooth, tin.triangles, own[:1].repeat(len(tin.triangles)), 4)
    assert far.fold_m3 < 1e-6 and far.sigma_m3 < 0.1


@pytest.mark.parametrize("square", [0.0, 0.5, 0.75, 0.9, 1.5])
def test_what_the_spread_of_heights_leaves_in_closed_form(square):
    """Every height at one ratio to its sigma; half of the places without a whole neighbourhood."""
    n, area, s = 6099, 0.3, 0.2
    triangles = np.arange(n).reshape(-1, 3)
    places = 1 + 3 * 4 * 5  # of four rings
    bump = LEFT * math.sqrt(2.0) * area * s * math.exp(-0.5 * square) * len(triangles)
    for half in (False, True):
        rings = np.where(np.arange(n) < n // 6 * 3, 4, 3 if half else 4)
        smooth = SimpleNamespace(
            variance=np.full(n, s**2),
            heights=np.full(n, math.sqrt(square) * s),
            rings=rings.copy,
        )
        found = remaining_fold(smooth, triangles, np.full(len(triangles), area), 4)
        share = np.mean(rings == 4)
        mean = (share * places + (1.0 - share) * (1 + 3 * 3 * 4)) * 1.0
        error = math.sqrt(4.0 / math.sqrt(27.0) * 1.5 / (n / mean))
        taken = bump * share * (1.0 - min(2.0 * square - 1.0, 1.0))
        if square >= 0.25:
            assert found.fold_m3 == pytest.approx(taken, abs=1e-9)
        else:  # no more than half as much again
            assert found.fold_m3 == pytest.approx(1.5 * bump * share)
        doubt = min(max(2.0 * square - 1.0, 0.0) + error, 1.0) * bump * share
        assert found.sigma_m3 == pytest.approx(math.hypot(doubt, 0.5 * bump * (1.0 - share)))


def test_misfits_are_those_of_least_squares():
    tin, h, variance = field(300, 4)
    variance = variance * np.random.default_rng(5).uniform(0.5, 2.0, 300)
    start, link = edges(tin.triangles, tin.neighbours, 300)
    xy, rows = np.ascontiguousarray(tin.vertices[:, :2]), np.arange(0, 300, 7)
    found = plane_misfits(start, link, xy, h, variance, rows)
    for row, misfit in zip(rows, found, strict=True):
        one = {row, *link[start[row] : start[row + 1]]}
        own = sorted(one.union(*(link[start[v] : start[v + 1]] for v in one)))
        A = np.c_[np.ones(len(own)), xy[own] - xy[row]] / np.sqrt(variance[own])[:, None]
        left = np.linalg.lstsq(A, h[own] / np.sqrt(variance[own]), rcond=None)[1]
        assert misfit == pytest.approx(float(left[0]) / (len(own) - 3), rel=1e-9)


def test_scatter_is_told_and_bounded():
    tin, h, variance = field(3000, 6)
    assert scatter(tin, h, variance, tin.triangles) == pytest.approx(1.0, abs=0.06)
    assert scatter(tin, h, variance / 2.0, tin.triangles) == pytest.approx(2.0, rel=0.06)
    assert scatter(tin, h, variance * 4.0, tin.triangles) == 1.0
    assert scatter(tin, 100.0 * h, variance, tin.triangles) == 4.0


@pytest.mark.parametrize(
    ("change", "slope", "ratio"),
    [("unchanged", 0.2, 1.0), ("unchanged", 0.0, 1 / 3), ("pile and pit", 0.2, 1.0)],
)
def test_intervals_of_cut_and_of_fill_hold(change, slope, ratio):
    z = errors(change, slope, ratio, draws=30, points=1000, seed=7)
    held = (np.abs(z) < 1.96).mean(axis=0)
    # 27 of 30 and more; without the remaining fold none of unchanged ground's held
    assert (held >= 0.86).all() and (np.abs(z.mean(axis=0)) < 0.8).all()
