"""The ring measures how two scans lie on each other; isolated returns; the cost of sampling."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ladar_volume.change.excavation import Region, Scan, beam_noise, excavate
from ladar_volume.change.isolated_returns import isolated_returns
from ladar_volume.change.ring_budget import checked_excavation
from ladar_volume.change.ring_fit import fit_ring, inverse_motion, ring_model
from ladar_volume.math.se3 import exp_so3
from ladar_volume.model.errors import VolumeError
from ladar_volume.registration.transform import Transform

EYE, SIGMA, HALF = np.array([0.3, 0.2, 4.0]), 0.003, 3.0
UP = np.array([0.0, 0.0, 1.0])
#: Half sides of a pit at its top and bottom, and its depth.
PIT = (1.5, 0.9, 1.0)
TRUTH = PIT[2] / 3.0 * 4.0 * (PIT[0] ** 2 + PIT[0] * PIT[1] + PIT[1] ** 2)
REGION = Region(np.array([[-2.2, -2.2], [2.2, -2.2], [2.2, 2.2], [-2.2, 2.2]]), 0.6, 0.25)


def surface(rng, pit, n=2500):
    """Points of rolling ground, with the pit or without, noise along the beam."""
    x, y = rng.uniform(-HALF, HALF, (2, n))
    z = 0.05 * x + 0.1 * np.sin(1.1 * x + 0.4 * y)
    if pit:
        top, low, depth = PIT
        z -= depth * np.clip((top - np.maximum(np.abs(x), np.abs(y))) / (top - low), 0.0, 1.0)
    r = np.column_stack([x, y, z])
    u = (r - EYE) / np.linalg.norm(r - EYE, axis=1)[:, None]
    return r + SIGMA * rng.standard_normal((n, 1)) * u


def scan(r, transform=None):
    return Scan(r, EYE, beam_noise(r, EYE, SIGMA), transform)


def moved(r, rng, shift=0.03, turn=0.006):
    return r @ exp_so3(rng.normal(0.0, turn, 3)).T + rng.normal(0.0, shift, 3)


@pytest.mark.parametrize("seed", range(4))
def test_the_effect_of_a_rigid_motion_is_on_the_ring(seed):
    rng = np.random.default_rng(seed)
    a, b = surface(rng, False), surface(rng, True)
    off = moved(b, rng)
    before = excavate(scan(a), scan(b), REGION)
    found = excavate(scan(a), scan(off), REGION)
    fit = fit_ring(found.between, off[found.in_b])
    effect = found.removed_m3 - before.removed_m3
    assert abs(fit.effect_m3 - effect) < 4.0 * fit.effect_sigma_m3 and fit.changed_share < 0.05
    back = fit.home.apply(off)
    again = excavate(scan(a), scan(back), REGION)
    home = fit_ring(again.between, back[again.in_b])
    # B's triangles meet other lines now: the noise of the gaps is drawn anew
    assert abs(home.effect_m3) < 3.0 * fit.effect_sigma_m3


def test_exact_motion_and_its_way_home():
    rng = np.random.default_rng(9)
    a, b = surface(rng, False), surface(rng, False)
    found = excavate(scan(a), scan(b), REGION)
    model = ring_model(found.between, b[found.in_b])
    x = np.array([0.01, 0.002, -0.003, 0.004, 0.001, -0.002])
    turn, shift = np.split(model.basis @ x, 2)
    there = (b - model.pivot) @ exp_so3(turn).T + shift + model.pivot
    assert inverse_motion(model, x, np.zeros((6, 6))).apply(there) == pytest.approx(b, abs=1e-12)


def test_a_ring_of_few_lines_is_refused():
    rng = np.random.default_rng(1)
    a, b = scan(surface(rng, False)), scan(surface(rng, True))
    found = excavate(a, b, REGION)
    names = ("gap_m", "ring_direction", "ring_b", "ring_slide")
    d = replace(found.between, **{name: getattr(found.between, name)[:8] for name in names})
    with pytest.raises(VolumeError) as caught:
        fit_ring(d, b.points[found.in_b])
    assert caught.value.reason == "ring_short"


@pytest.mark.parametrize("seed", range(3))
def test_misregistration_is_in_sigma_and_verdict_or_taken_out(seed):
    rng = np.random.default_rng(20 + seed)
    a, b = scan(surface(rng, False)), surface(rng, True)
    off = scan(moved(b, rng) + UP * 0.03)
    as_is = checked_excavation(a, off, REGION)
    assert [r.name for r in as_is.verdict.doubts] == ["registration"]
    assert abs(as_is.excavation.removed_m3 - TRUTH) < 3.0 * as_is.excavation.sigma_m3
    home = checked_excavation(a, off, REGION, "rigid")
    assert home.verdict.sound and home.excavation.sigma_m3 < 0.2 * as_is.excavation.sigma_m3
    assert abs(home.excavation.removed_m3 - TRUTH) < 3.0 * home.excavation.sigma_m3
    assert sum(home.excavation.budget_m6.values()) == pytest.approx(home.excavation.sigma_m3**2)
    good = checked_excavation(a, scan(b), REGION)
    assert (
        good.verdict.sound
        and abs(good.excavation.removed_m3 - TRUTH) < 3.0 * good.excavation.sigma_m3
    )


def test_a_stated_registration_that_holds_stands_alone():
    rng = np.random.default_rng(31)
    a, b = scan(surface(rng, False)), surface(rng, True)
    C = np.zeros((7, 7))
    C[5, 5] = 0.01**2
    T = Transform(np.eye(3), np.zeros(3), np.zeros(3), 1.0, C)
    good = checked_excavation(a, scan(b, T), REGION).excavation.budget_m6
    assert good["ring"] == 0.0 and good["registration_b"] > 0.0
    bad = checked_excavation(a, scan(b + UP * 0.08, T), REGION)
    assert (
        bad.excavation.budget_m6["ring"] > 10.0 * good["registration_b"] and not bad.verdict.sound
    )


def test_a_ring_on_changed_ground_is_said():
    rng = np.random.default_rng(41)
    a, b = surface(rng, False), surface(rng, True)
    b[:, 2] += 0.4 * np.clip(1.0 - np.hypot(b[:, 0] - 2.2, b[:, 1]), 0.0, None)
    found = checked_excavation(scan(a), scan(b), REGION)
    assert "ring_changed" in [r.name for r in found.verdict.doubts]
    assert abs(found.fit.offset_m) < 4.0 * found.fit.offset_sigma_m + 0.002


@pytest.mark.parametrize("share", [0.0, 0.005, 0.02, 0.05])
def test_returns_that_stand_alone_are_found_and_others_kept(share):
    rng = np.random.default_rng(51)
    r = surface(rng, True)
    bad = np.zeros(len(r), bool)
    bad[rng.choice(len(r), int(share * len(r)), replace=False)] = True
    r[bad] = EYE + (r[bad] - EYE) * rng.uniform(0.2, 0.9, (int(bad.sum()), 1))
    alone = isolated_returns(r, EYE)
    assert (alone & ~bad).mean() < 0.002 and (alone & bad).sum() >= 0.95 * bad.sum()
    assert not isolated_returns(r[:20], EYE).any()
