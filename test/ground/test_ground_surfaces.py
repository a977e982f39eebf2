"""Several ground surfaces, curved ground under clutter, roofs larger than the ground, and heights
above all of them.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from ladar_volume.ground.ground_presets import PRESETS
from ladar_volume.ground.ground_sampling import best_candidate, sample_polynomials
from ladar_volume.ground.polynomial import base_height, design_surface
from ladar_volume.ground.robust_ground import bottom_layer, fit_ground
from ladar_volume.ground.surfaces import (
    further_grounds,
    heights_above,
    is_same_surface,
    surface_sigma,
)
from ladar_volume.model.errors import GroundError
from ladar_volume.model.parameters import GroundParameters, Parameters
from ladar_volume.tin.scan_frame import frame_along
from test.scenes.several_grounds import find_grounds

CUBIC = design_surface([2.0, 0.03, -0.05, 0.004, -0.002, 0.003, 4e-4, -3e-4, 2e-4, 5e-4])


def scattered(n=4000, half=12.0, noise=0.01, seed=0, height=lambda x, y: 0.02 * x):
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-half, half, (n, 2))
    return np.c_[xy, height(*xy.T) + noise * rng.standard_normal(n)]


def terraces(seed=0, noise=0.01):
    """Four levels, half a metre apart, 6 m wide along x; points of each level in order."""
    return scattered(noise=noise, seed=seed, height=lambda x, y: 0.5 * np.floor(x / 6.0))


def variance(points, sigma=0.01):
    return np.full(len(points), sigma**2)


def grounds(points, **kwargs):
    return find_grounds(points, variance(points), GroundParameters(**{"surfaces": 10} | kwargs))


@pytest.mark.parametrize("clutter", [0.0, 0.3, 0.6])
def test_a_cubic_ground_is_found_under_clutter(clutter):
    points = scattered()
    points[:, 2] += base_height(CUBIC, points[:, :2]) - 0.02 * points[:, 0]
    count = int(clutter * len(points))
    points[:count, 2] += np.random.default_rng(1).uniform(0, 4, count)
    found = fit_ground(points, variance(points), GroundParameters(degree=3))
    clean = points[count:, :2]
    error = base_height(found, clean) - base_height(CUBIC, clean)
    assert np.sqrt(np.mean(error**2)) < 0.002 and len(found.support) > 0.99 * len(clean)


@pytest.mark.parametrize(
    "share,weight,wins",
    [(0.6, 0.0, 3.0), (0.6, 4.0, 0.0), (0.78, 4.0, 0.0), (0.6, 1.0, 0.0), (0.7, 1.0, 3.0)],
)
def test_a_roof_wins_only_with_more_than_one_plus_weight_times_the_ground(share, weight, wins):
    points = scattered(noise=0.02)
    points[: int(share * 4000), 2] += 3.0
    points[-40:, 2] -= np.linspace(0.2, 10, 40)  # multiple reflections from below
    found = fit_ground(points, variance(points), GroundParameters(below_weight=weight))
    assert found.beta == pytest.approx([wins, 0.02, 0.0], abs=0.005)


@pytest.mark.parametrize(
    "share,threshold", [(0.3, 0.0), (0.5, 0.0), (0.7, 0.0), (0.8, 0.0), (0.9, 0.0), (0.9, 0.05)]
)
def test_ground_under_vegetation(share, threshold):
    points = scattered(noise=0.02, n=5000)
    count = int(share * 5000)
    points[:count, 2] += np.random.default_rng(2).uniform(0, 1, count)
    found = fit_ground(points, variance(points), GroundParameters(threshold_m=threshold))
    # plants within the threshold lift the ground, by a fifth of the search threshold of 0.1 m at
    # most
    assert -0.002 < found.beta[0] < 0.025 and found.beta[1:] == pytest.approx([0.02, 0.0], abs=2e-3)


@pytest.mark.parametrize("sd", [0.15, 0.5])
def test_rough_ground_is_taken_whole(sd):
    points = scattered(noise=sd)
    found = fit_ground(points, variance(points), GroundParameters())
    assert len(found.support) > 0.99 * len(points) and found.rms_m == pytest.approx(sd, rel=0.03)
    assert not bottom_layer(points, found, sd / 2)


def test_terraces_each_once_and_nothing_else():
    points = terraces()
    found = grounds(points)
    level = 0.5 * np.floor(points[:, 0] / 6.0)
    assert sorted(round(float(g.beta[0]), 2) for g in found) == [-1.0, -0.5, 0.0, 0.5]
    every = np.concatenate([g.support for g in found])
    assert len(np.unique(every)) == len(every) > 0.99 * len(points)
    for g in found:
        assert np.ptp(level[g.support]) == 0.0 and g.rms_m == pytest.approx(0.01, rel=0.1)
        deviation = g.beta - [level[g.support[0]], 0.0, 0.0]
        assert deviation @ np.linalg.solve(g.C_beta, deviation) < 20.0  # chi square of 3: 2e-4
    assert found[0].beta[0] == pytest.approx(-1.0, abs=0.005)  # the lowest first


def test_one_surface_is_the_first_of_several_and_their_number_is_bounded():
    points = terraces()
    alone = fit_ground(points, variance(points), GroundParameters())
    for k in (1, 2, 3):
        found = grounds(points, surfaces=k)
        assert (
            len(found) == k
            and found[0].beta.tobytes() == alone.beta.tobytes()
            and np.array_equal(found[0].support, alone.support)
        )
    assert further_grounds(points, variance(points), alone, GroundParameters()) == ()


def test_clutter_small_patches_and_repetitions_are_no_further_surfaces():
    flat = scattered()
    assert len(grounds(flat)) == 1
    cloud = flat.copy()
    cloud[:1500, 2] += np.random.default_rng(3).uniform(0.2, 6, 1500)
    assert len(grounds(cloud, min_support=0.05)) == 1
    step = flat.copy()
    step[:200, 2] += 1.0
    assert len(grounds(step, min_support=0.04)) == 2 and len(grounds(step, min_support=0.06)) == 1
    main = grounds(flat)[0]
    again = dataclasses.replace(main, beta=main.beta + np.array([0.02, 0, 0]))
    assert is_same_surface(again, main, flat) and not is_same_surface(
        dataclasses.replace(main, beta=main.beta + np.array([0.05, 0, 0])), main, flat
    )


def test_the_order_of_the_surfaces_does_not_hang_on_where_the_scene_is():
    points = terraces()
    moved = grounds(points + np.array([1000.0, -3000.0, 250.0]))
    for a, b in zip(grounds(points), moved, strict=True):
        assert base_height(b, points[:, :2] + np.array([1000.0, -3000.0])) - 250.0 == pytest.approx(
            base_height(a, points[:, :2]), abs=1e-8
        )


def test_a_tilted_up_direction_by_a_frame():
    up = np.array([0.6, -0.2, 0.5])
    frame = frame_along(-up)
    upright = scattered()
    turned = frame.points_to_map(upright)
    with pytest.raises(GroundError) as caught:
        fit_ground(turned, variance(turned), GroundParameters())
    assert caught.value.reason in ("ground_tilt", "ground_no_consensus")
    found = fit_ground(frame.points(turned), variance(turned), GroundParameters())
    assert found.beta == pytest.approx(
        fit_ground(upright, variance(upright), GroundParameters()).beta, abs=1e-9
    )


def test_heights_above_terraces_and_the_face_of_a_step():
    points = terraces(noise=0.0)
    found = grounds(points)
    probe = np.array(
        [
            [-9.0, 0, 0.0],
            [-3.0, 0, 0.0],
            [3.0, 0, -0.2],
            [9.0, 0, 0.5],
            [0.0, 0, -0.25],
            [0.02, 0, 0.4],
            [-0.02, 0, -0.9],
        ]
    )
    height, sigma = heights_above(probe, found, points, 0.3)
    assert height == pytest.approx([1.0, 0.5, -0.2, 0.0, 0.0, 0.4, -0.4], abs=1e-9)
    assert (sigma >= 0).all() and sigma.max() < 1e-3
    one, _ = heights_above(probe, found[:1], points, 0.3)
    assert one == pytest.approx(probe[:, 2] - base_height(found[0], probe[:, :2]))
    level, sigma = heights_above(probe, [design_surface([1.0])], points, 0.3)
    assert level == pytest.approx(probe[:, 2] - 1.0) and (sigma == 0).all()


def test_the_sigma_of_a_surface():
    found = grounds(scattered())[0]
    xy = np.array([[0.0, 0.0], [500.0, 0.0]])
    near, far = surface_sigma(found, xy)
    assert near == pytest.approx(math.sqrt(found.rms_m**2 + 1e-4 / 4000), rel=0.01) and far > near


def test_published_settings_take_the_largest_plane():
    points = scattered(noise=0.01)
    points[:2600, 2] += 2.0
    for name, preset in PRESETS.items():
        p = Parameters.read({"ground": preset}).ground
        assert p.trials == 1000 and p.threshold_m == 0.05, name
    # a sample of k points is clean with probability share**k: the published k serves clouds without
    # large bodies
    p = dataclasses.replace(Parameters.read({"ground": PRESETS["box"]}).ground, sample_size=4)
    assert fit_ground(points, variance(points), p).beta[0] == pytest.approx(2.0, abs=0.01)
    flat = scattered(noise=0.01)
    flat[:400, 2] += 1.0
    for preset in PRESETS.values():
        assert fit_ground(flat, variance(flat), Parameters.read({"ground": preset}).ground).beta[
            0
        ] == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("degree,size", [(0, 5), (1, 3), (1, 8), (2, 0), (3, 0), (3, 25)])
def test_samples_of_an_exact_surface_give_it_back(degree, size):
    count = (1, 3, 6, 10)[degree]
    beta = CUBIC.beta[:count]
    surface = design_surface(beta)
    points = scattered(200, noise=0.0)
    points[:, 2] = base_height(surface, points[:, :2])
    p = GroundParameters(degree=degree, sample_size=size, trials=50, max_tilt_rad=math.radians(60))
    found = sample_polynomials(points, np.zeros(2), p)
    assert len(found) > 25
    assert np.median(np.abs(found - beta) / np.abs(beta), axis=0) == pytest.approx(
        np.zeros(count), abs=1e-6
    )


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_no_ground_says_what_to_do(degree):
    cloud = np.random.default_rng(0).uniform(-20, 20, (3000, 3))
    with pytest.raises(GroundError) as caught:
        fit_ground(cloud, variance(cloud), GroundParameters(degree=degree, trials=200))
    assert caught.value.reason == "ground_no_consensus" and "ground.threshold_m" in str(
        caught.value
    )
    assert 0 < caught.value.value < 0.02
    wall = cloud * [0.0, 1.0, 1.0]
    with pytest.raises(GroundError) as caught:
        best_candidate(wall, np.zeros(2), 0.1, GroundParameters(trials=200))
    assert caught.value.reason == "ground_tilt"
