"""Results do not depend on how the points are numbered, nor on copies of points; and a surface of
few of them says what it leaves out.
"""

import dataclasses

import numpy as np
import pytest

import ladar_volume as lv
from ladar_volume.change.excavation import Scan, region_of, select
from ladar_volume.change.sampling import halves, sampling_variance
from ladar_volume.math.random_halves import random_halves


def test_halves_are_of_places_and_not_of_numbers():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(501, 3))
    mixed = rng.permutation(501)

    def places(p):
        one, two = random_halves(p, np.random.default_rng(7))
        assert len(np.intersect1d(one, two)) == 0 and abs(len(one) - len(two)) == 1
        return [np.unique(p[rows], axis=0) for rows in (one, two)]

    for other in (points[mixed], np.concatenate([points, points[::-1]])):
        for a, b in zip(places(points), places(other), strict=True):
            assert np.array_equal(a, b)
    rounded = np.round(points, 1)  # many share a coordinate
    far = np.add(rounded, (458_000.0, 5_550_000.0, 210.0))
    for a, b in zip(places(rounded), places(far), strict=True):
        assert np.allclose(a, b - [458_000.0, 5_550_000.0, 210.0], atol=1e-6)


def test_halves_turn_and_move_with_the_points():
    rng = np.random.default_rng(3)
    ticks = np.linspace(0.0, 4.0, 20)
    x, y = np.meshgrid(ticks, ticks)
    rows = np.column_stack([x.ravel(), y.ravel(), rng.normal(0.0, 0.01, 400)])
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    for p in (rng.normal(size=(501, 3)), rows):
        for other in (p @ turn.T, 0.1 * p - 7.0, p @ turn.T + (458_000.0, 5_550_000.0, 210.0)):
            for a, b in zip(
                random_halves(p, np.random.default_rng(7)),
                random_halves(other, np.random.default_rng(7)),
                strict=True,
            ):
                assert len(np.setdiff1d(a, b)) <= 0.01 * len(a)


def test_what_the_choice_of_points_costs_turns_and_moves_with_them():
    a, b = pit(1, 0.0), pit(2, 1.0)
    angle = np.deg2rad(33.0)
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    tried = []
    for R, to in ((np.eye(3), np.zeros(3)), (turn, np.array([458_000.0, 5_550_000.0, 210.0]))):
        one, two = (Scan(s.points @ R.T + to, R @ s.scanner + to, s.noise) for s in (a, b))
        region = region_of(one.points)
        in_a, in_b = select(one, two, region)
        parts = one.part(in_a), two.part(in_b)
        # the outline is in both halves: the ring lies within each, and no split is lost
        found = [halves(*parts, region, seed, np.inf) for seed in (7, 8)]
        tried.append((region.margin_m, np.concatenate(found)))
    (margin, usual), (margin_turned, turned) = tried
    assert margin_turned == pytest.approx(margin, rel=1e-4)
    assert turned == pytest.approx(usual, rel=0.01)


def pit(seed, depth):
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-5.0, 5.0, (600, 2))
    z = -depth * np.maximum(0.0, 1.0 - np.hypot(*xy.T) / 3.0) + rng.normal(0.0, 0.01, 600)
    return Scan(np.column_stack([xy, z]), np.array([0.0, 0.0, 9.0]), 0.01)


def test_what_the_choice_of_points_costs_does_not_depend_on_their_order_or_copies():
    a, b = pit(1, 0.0), pit(2, 1.0)
    region = region_of(a.points)

    def cost(one, two):
        in_a, in_b = select(one, two, region)
        return sampling_variance(one.part(in_a), two.part(in_b), region, 9.4, 0.0)

    mixed = [dataclasses.replace(s, points=s.points[::-1].copy()) for s in (a, b)]
    twice = [dataclasses.replace(s, points=np.repeat(s.points, 2, axis=0)) for s in (a, b)]
    usual = cost(a, b)
    assert usual > 0.0
    assert np.isclose(cost(*mixed), usual, rtol=1e-6)
    assert np.isclose(cost(*twice), usual, rtol=0.2)


def test_a_surface_of_few_points_says_what_it_leaves_out_at_its_edge():
    rng = np.random.default_rng(5)
    xy = rng.uniform(-10.0, 10.0, (2000, 2))
    z = 5.0 + 0.3 * np.sin(xy[:, 0]) + rng.normal(0.0, 0.01, 2000)
    points = np.column_stack([xy, z])
    whole = lv.volume(points, base=0.0)
    few = lv.volume(points, base=0.0, vertices=0.1)
    lost = whole.net_m3 - few.net_m3
    edge = few.facts["budget_m6"]["outline"]
    assert few.sigma_m3 > lost > 3.0 * (few.sigma_m3**2 - edge) ** 0.5  # in sigma, and a doubt
    doubts = {r["name"]: r for r in few.facts["verdict"]["reasons"]}
    assert 0.7 * lost < doubts["outline_shrunk"]["value"] < 1.4 * lost
    near = lv.volume(points, base=5.0, vertices=0.5)
    names = [r["name"] for v in (whole, near) for r in v.facts["verdict"]["reasons"]]
    assert "outline_shrunk" not in names
