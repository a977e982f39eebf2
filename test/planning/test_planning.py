"""Planned surveys: the scene against marching, the path, closed forms of single sources,
comparisons.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from ladar_volume.math.se3 import matrix_from_quaternion
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.planning.planned_path import Lanes
from ladar_volume.planning.planned_scene import Pile
from ladar_volume.planning.prediction import Plan, Scanner, cast_rays, predict, with_budget
from ladar_volume.planning.sensor_choice import (
    compare,
    height_steps,
    highest,
    over_heights,
    with_sensors,
)

QUIET = {
    "range_noise_m": 1e-4,
    "azimuth_noise_deg": 0.0,
    "vertical_noise_deg": 0.0,
    "beam_divergence_deg": 0.0,
    "beam_range_sigma_m": 0.0,
    "beam_vertical_sigma_deg": 0.0,
    "range_bias_sigma_m": 0.0,
    "position_sigma_m": [0.0, 0.0, 0.0],
    "attitude_sigma_deg": [0.0, 0.0, 0.0],
    "boresight_sigma_deg": [0.0, 0.0, 0.0],
    "lever_laser_sigma_m": [0.0, 0.0, 0.0],
    "lever_antenna_sigma_m": [0.0, 0.0, 0.0],
    "clock_sigma_s": 0.0,
    "position_bias_fraction": 1.0,
    "position_white_fraction": 0.0,
}
SMALL = Pile(8.0, 6.0, 2.0, 0.2, 0.0)


def parameters(budget, **volume):
    return Parameters.read(
        {
            "calibration": {"boresight_pitch_deg": 90.0},
            "filter": {"radius_m": 0.5, "cap_per_voxel": 8},
            "volume": {"ground_ring_m": 3.0, **volume},
            "budget": {**QUIET, **budget},
        }
    )


def plan(budget, pile=SMALL, height=20.0, **volume):
    return Plan(
        pile,
        Lanes(height, 2, 6.0, 30.0).states(),
        Scanner(rate_hz=60_000.0),
        parameters(budget, **volume),
    )


def surface(pile, x, y):
    rho = np.hypot(2 * x / pile.length_m, 2 * y / pile.width_m)
    return pile.height_m * np.clip((1 - rho) / (1 - pile.top), 0, 1)


@pytest.mark.parametrize("pile", [SMALL, Pile(5.0, 5.0, 3.0), Pile(6.0, 5.0, -2.0, 0.6)])
def test_rays_against_marching(pile):
    rng = np.random.default_rng(1)
    n, step = 400, 1e-3
    origin = np.stack(
        [rng.uniform(-12, 12, n), rng.uniform(-12, 12, n), rng.uniform(4, 9, n)], axis=1
    )
    at = np.stack([rng.uniform(-5, 5, n), rng.uniform(-5, 5, n), np.zeros(n)], axis=1)
    ray = (at - origin) / np.linalg.norm(at - origin, axis=1)[:, None]
    ray[:20, 2] = np.abs(ray[:20, 2])  # upwards: nothing is hit
    found = pile.ranges(origin, ray)
    assert np.isinf(found[:20]).all() and np.isfinite(found[20:]).all()
    t = np.arange(0.0, 40.0, step)
    for o, d, r in zip(origin[20:], ray[20:], found[20:], strict=True):
        p = o + t[:, None] * d
        assert r == pytest.approx(
            t[np.argmax(p[:, 2] <= surface(pile, p[:, 0], p[:, 1]))], abs=1.5 * step
        )


def test_volume_of_the_scene_and_its_roughness():
    assert Pile.cone(100.0, math.radians(35.0)).volume_m3 == pytest.approx(100.0, rel=1e-14)
    x = (np.arange(2000) + 0.5) / 2000 * 8.0 - 4.0
    gx, gy = np.meshgrid(x, x)
    assert surface(SMALL, gx, gy).mean() * 64.0 == pytest.approx(SMALL.volume_m3, rel=1e-5)
    rough = dataclasses.replace(SMALL, rough_m=0.02, rough_length_m=1.5)
    xy = np.random.default_rng(0).uniform(-200, 200, (20_000, 2))
    z = np.stack([rough.roughness(xy, seed) for seed in range(8)])
    beside = np.stack([rough.roughness(xy + np.array([1.5, 0.0]), seed) for seed in range(8)])
    assert z.std() == pytest.approx(0.02, rel=0.02) and (
        z * beside
    ).mean() / z.var() == pytest.approx(math.exp(-1.0), abs=0.06)
    assert not SMALL.roughness(xy, 1).any()


def test_lanes():
    s = Lanes(20.0, 3, 8.0, 30.0, 5.0, 4.0, True, 10.0).states()
    assert len(np.unique(s.segment)) == 6 and (np.diff(s.t_ns) > 0).all()
    R = matrix_from_quaternion(s.q_map_body)
    inside = s.segment[1:] == s.segment[:-1]
    motion = (np.diff(s.p_map_body, axis=0) / (np.diff(s.t_ns) * 1e-9)[:, None])[inside]
    forward = np.einsum("nij,nj->ni", R, s.v_body)[:-1][inside]
    assert motion == pytest.approx(forward, abs=1e-6)
    for axis in (0, 1):
        assert np.ptp(s.p_map_body[:, axis]) == pytest.approx(30.0)
    gaps = np.diff(s.t_ns)[~inside] * 1e-9
    assert gaps == pytest.approx(4.0)
    assert with_budget(s, Parameters()).C_nav[:, 2, 2] == pytest.approx(0.021**2)


def test_returns_lie_on_the_scene():
    points, distance = cast_rays(plan({}), 20_000, np.random.default_rng(0))
    z = surface(SMALL, points.r_map[:, 0], points.r_map[:, 1])
    assert (
        len(points) > 1000
        and (distance > 10.0).all()
        and np.abs(points.r_map[:, 2] - z).max() < 1e-3
    )
    assert (points.C_ind[:, 5] <= 1.1e-8).all() and (
        points.C_ind[:, [0, 3, 5]].sum(axis=1) == pytest.approx(1e-8, rel=1e-3)
    )


def test_a_common_height_error_has_a_closed_form_above_a_level_and_vanishes_above_own_ground():
    up = {"position_sigma_m": [0.0, 0.0, 0.05]}
    flat = dataclasses.replace(
        SMALL, height_m=0.8
    )  # at a steep toe the patches' slopes are not those of the triangles
    level = predict(plan(up, flat, base="level", level_m=0.0)).volume
    assert level.budget_m6["position"] == pytest.approx((0.05 * level.area_m2) ** 2, rel=0.02)
    assert (
        level.sigma_m3 == pytest.approx(0.05 * level.area_m2, rel=0.02)
        and level.largest_source == "position"
    )
    own = predict(plan(up, flat)).volume
    assert own.budget_m6["position"] < 1e-5 * level.budget_m6["position"] and own.base_same_survey


def test_roughness_of_the_ground_is_the_planned_one():
    rough = dataclasses.replace(SMALL, rough_m=0.02, rough_length_m=1.0)
    first, other = (
        predict(dataclasses.replace(plan({}, rough), seed=seed)).volume.budget_m6["base_surface"]
        for seed in (1, 2)
    )
    assert math.sqrt(other) == pytest.approx(math.sqrt(first), rel=0.1)
    twice = predict(plan({}, dataclasses.replace(rough, rough_m=0.04))).volume
    assert math.sqrt(twice.budget_m6["base_surface"]) == pytest.approx(
        2.0 * math.sqrt(first), rel=0.1
    )
    assert twice.largest_source == "base_surface" and sum(
        twice.budget_m6.values()
    ) == pytest.approx(twice.sigma_m3**2, rel=1e-9)


def test_a_pit_and_the_same_twice():
    p = plan({"range_noise_m": 0.01}, Pile(8.0, 7.0, -1.5, 0.7, 0.0))
    first, again = predict(p), predict(p)
    assert first.volume.volume_m3 == pytest.approx(first.true_m3, rel=0.03) and first.true_m3 < 0
    assert first.volume.budget_m6 == again.volume.budget_m6
    assert first.duration_s == pytest.approx(2 * 30.0 / 5.0) and first.returns_per_m2 > 50


def test_halving_a_source_is_propagating_half_of_it():
    budget = {
        "position_sigma_m": [0.02, 0.02, 0.03],
        "attitude_sigma_deg": [0.02, 0.02, 0.05],
        "position_bias_fraction": 0.0,
        "boresight_sigma_deg": [0.0, 0.0, 0.0],
    }
    whole = predict(plan(budget)).volume
    half = predict(plan({**budget, "attitude_sigma_deg": [0.01, 0.01, 0.025]})).volume
    # its second order, a line of its own, falls with the fourth power
    square = (
        whole.sigma_if_halved_m3["attitude"] ** 2
        - 15.0 / 16.0 * whole.budget_m6["attitude_second_order"]
    )
    assert half.sigma_m3 == pytest.approx(math.sqrt(square), rel=1e-9)
    assert set(whole.sigma_if_halved_m3) == set(whole.budget_m6) and max(
        whole.sigma_if_halved_m3.values()
    ) <= whole.sigma_m3 * (1 + 1e-12)


def test_sensors_compared():
    base = plan(
        {"attitude_sigma_deg": [0.1, 0.1, 0.1]}, base="level", level_m=0.0, ground_ring_m=0.5
    )
    found = {c.name: c.prediction for c in compare(base)}
    assert len(found) == 6 and all(found.values())
    for scanner in ("vlp16", "line"):
        sigma = [
            found[f"{scanner} + {imu}"].volume.sigma_m3 for imu in ("survey", "tactical", "mems")
        ]
        assert sigma == sorted(sigma)
    assert with_sensors(base.parameters).budget == base.parameters.budget
    with pytest.raises(VolumeError) as caught:
        with_sensors(base.parameters, imu="best")
    assert caught.value.reason == "plan_sensor" and "tactical" in str(caught.value)


def test_heights():
    base = plan(
        {"azimuth_noise_deg": 0.2, "vertical_noise_deg": 0.2},
        base="level",
        level_m=0.0,
        ground_ring_m=0.5,
    )
    rows = list(over_heights(base, lambda h: Lanes(h, 2, 6.0, 30.0).states(), (15.0, 30.0, 300.0)))
    assert rows[0].prediction.volume.sigma_m3 < rows[1].prediction.volume.sigma_m3
    assert rows[2].prediction is None and "no pulse" in rows[2].reason
    h = np.array([10.0, 20.0, 40.0])
    assert highest(h, np.array([0.01, 0.02, 0.06]), 0.04) == pytest.approx(30.0)
    assert (
        highest(h, np.array([0.01, 0.02, np.nan]), 0.04) == 20.0
        and highest(h, np.array([0.01, 0.02, 0.03]), 0.04) == 40.0
    )
    assert math.isnan(highest(h, np.full(3, np.nan), 0.04))
    steps = height_steps(base)
    assert steps[0] == pytest.approx(6.0) and steps[-1] == pytest.approx(90.0)
    with pytest.raises(VolumeError):
        height_steps(dataclasses.replace(base, pile=Pile(300.0, 300.0, 90.0)))


def test_refusals():
    for bad in (
        (0.0, 1.0, 1.0),
        (1.0, 1.0, 0.0),
        (1.0, math.nan, 1.0),
        (1.0, 1.0, 1.0, 1.0),
        (1.0, 1.0, 1.0, 0.0, -0.1),
    ):
        with pytest.raises(VolumeError):
            Pile(*bad)
    with pytest.raises(VolumeError):
        Pile.cone(-1.0, 0.5)
    for bad in ({"lanes": 0}, {"speed_mps": 0.0}, {"spacing_m": -1.0}, {"turn_s": math.inf}):
        with pytest.raises(VolumeError):
            Lanes(20.0, **bad)
    far = dataclasses.replace(
        plan({}),
        path=dataclasses.replace(
            Lanes(20.0).states(), p_map_body=Lanes(20.0).states().p_map_body + 500.0
        ),
    )
    with pytest.raises(VolumeError) as caught:
        predict(far)
    assert caught.value.reason == "plan_no_returns"
    alone = Lanes(20.0).states()
    with pytest.raises(VolumeError) as caught:
        predict(
            dataclasses.replace(
                plan({}), path=dataclasses.replace(alone, segment=np.arange(len(alone)))
            )
        )
    assert caught.value.reason == "plan_path"
