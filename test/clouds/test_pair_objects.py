"""What stands on one of two clouds alone is no change: it is taken out, or named."""

import json
import math
import tracemalloc

import numpy as np
import pytest

from ladar_volume.cli.main import main
from ladar_volume.clouds.sampling.cloud_objects import PointsAtHand, ThinTin, standing_in
from ladar_volume.clouds.sampling.object_search import (
    Located,
    objects_of_points,
    sampled_tin,
)
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.volume.field_checks.standing_objects import objects_of

RADIUS, HIGH = 6.0, 3.6
GROWN_M3 = math.pi * RADIUS**2 * HIGH / 6.0


def cone(xy, high=HIGH):
    return high * np.clip(1.0 - np.hypot(*xy.T) / RADIUS, 0.0, None)


def flat(xy):
    return np.zeros(len(xy))


def grown(xy):
    return cone(xy, HIGH)


def before(xy):
    return cone(xy, 0.5 * HIGH)


def cloud(seed, top, *things, half=16.0, density=15.0):
    """Points (n, 3) on a square; things change heights in place."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-half, half, (rng.poisson(density * (2.0 * half) ** 2), 2))
    z = top(xy)
    for thing in things:
        thing(xy, z, rng)
    return np.c_[xy, z + rng.normal(0.0, 0.012, len(xy))]


def truck(x, y, wide=2.5, long=6.0, high=2.6):
    """Something with upright faces at a place."""

    def put(xy, z, rng):
        z[(np.abs(xy[:, 0] - x) < wide / 2) & (np.abs(xy[:, 1] - y) < long / 2)] += high

    return put


def tree(x, y, radius=2.0):
    """A crown with gaps."""

    def put(xy, z, rng):
        crown = (np.hypot(xy[:, 0] - x, xy[:, 1] - y) < radius) & (rng.random(len(xy)) < 0.6)
        z[crown] += rng.uniform(3.0, 6.0, int(crown.sum()))

    return put


def compared(tmp_path, capsys, new, old, *options, verb="volume"):
    np.save(tmp_path / "new.npy", new)
    np.save(tmp_path / "old.npy", old)
    files = [str(tmp_path / "new.npy"), str(tmp_path / "old.npy")]
    if verb == "epochs":
        files = [*files[::-1], "--no-figure", "-o", str(tmp_path / "out")]
    assert main([verb, *files, "--json", *options]) == 0
    return json.loads(capsys.readouterr().out)


def names(facts):
    return {reason["name"] for reason in facts["verdict"]["reasons"]}


def holds(facts, true_m3):
    found = facts.get("net_m3", facts.get("volume_m3"))
    return abs(found - true_m3) < 3.0 * facts["sigma_m3"] and facts["sigma_m3"] < 2.0


THINGS = {
    "a truck came": (cloud(1, grown, truck(11, 9)), cloud(2, before)),
    "a truck left": (cloud(1, grown), cloud(2, before, truck(11, 9))),
    "a truck moved": (cloud(1, grown, truck(11, 9)), cloud(2, before, truck(-11, -9))),
    "a tree grew leaves": (cloud(1, grown, tree(-11, 9)), cloud(2, before)),
    "a digger on the pile": (cloud(1, grown, truck(3, 0, 2.0, 3.0, 2.0)), cloud(2, before)),
}


@pytest.mark.parametrize("verb", ["volume", "epochs"])
@pytest.mark.parametrize("which", THINGS)
def test_what_stands_on_one_cloud_alone_is_taken_out_and_named(tmp_path, capsys, which, verb):
    facts = compared(tmp_path, capsys, *THINGS[which], verb=verb)
    assert holds(facts, GROWN_M3) and "object" in names(facts) and facts["objects"]


def test_what_stands_on_both_stays(tmp_path, capsys):
    new, old = cloud(1, grown, truck(11, 9)), cloud(2, before, truck(11, 9))
    facts = compared(tmp_path, capsys, new, old)
    assert facts["objects"] == [] and holds(facts, GROWN_M3)


COUNT = ("--set", "volume.objects=count")


def test_things_are_counted_on_request(tmp_path, capsys):
    new, old = THINGS["a truck came"]
    for options in (("--clean", "off"), COUNT):
        facts = compared(tmp_path, capsys, new, old, *options)
        assert facts["net_m3"] > GROWN_M3 + 30.0 and facts["objects"] == []


@pytest.mark.parametrize("verb", ["volume", "epochs"])
def test_a_thing_that_is_all_that_changed_is_counted_and_named(tmp_path, capsys, verb):
    facts = compared(tmp_path, capsys, cloud(1, flat, truck(5, 4)), cloud(2, flat), verb=verb)
    assert facts["objects"] == [] and "object" in names(facts)
    assert facts.get("net_m3", facts.get("volume_m3")) == pytest.approx(39.0, rel=0.05)
    assert "--clean off" in facts["verdict"]["reasons"][0]["text"]


def test_a_pit_with_upright_walls_stands_on_nothing_and_its_walls_are_in_sigma(tmp_path, capsys):
    def pit(xy):
        return np.where((np.abs(xy) < (4.0, 3.0)).all(axis=1), -2.0, 0.0)

    for seed in range(3):
        facts = compared(tmp_path, capsys, cloud(2 * seed + 1, pit), cloud(2 * seed + 2, flat))
        assert facts["objects"] == [] and holds(facts, -96.0)
        assert facts["budget_m6"]["between_points"] > 0.0
    facts = compared(tmp_path, capsys, cloud(1, pit, truck(11, 9)), cloud(2, flat))
    assert len(facts["objects"]) == 1 and holds(facts, -96.0)


def test_no_thing_no_word(tmp_path, capsys):
    facts = compared(tmp_path, capsys, cloud(1, grown), cloud(2, before))
    assert facts["verdict"]["status"] == "sound" and facts["objects"] == []
    assert holds(facts, GROWN_M3) and facts["sigma_m3"] < 0.3


def wood(seed):
    """Half the returns of a rough wood on a steep slope, from leaves at any height below 9 m."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-60.0, 60.0, (9000, 2))
    crowns = np.random.default_rng(5).uniform(-60.0, 60.0, (60, 2))
    near = (np.hypot(*(xy[:, None] - crowns).transpose(2, 0, 1)) < 3.0).any(axis=1)
    z = 0.5 * xy[:, 0] + rng.normal(0.0, 0.1, len(xy))
    return np.c_[
        xy, z + np.where(near & (rng.random(len(xy)) < 0.5), rng.uniform(4, 9, len(xy)), 0)
    ]


def test_a_wood_met_at_other_leaves_is_no_thing_of_one_cloud(tmp_path, capsys):
    facts = compared(tmp_path, capsys, wood(0), wood(1))
    # some crowns of few leaves stay; they all were 3,800 m³, were the surfaces alone asked
    assert sum(one["volume_m3"] for one in facts["objects"]) < 500.0
    assert abs(facts["net_m3"]) < 3.0 * facts["sigma_m3"]
    # a crown at the edge is no body that was cut
    assert facts["sigma_m3"] < 1500.0


def test_a_thing_is_as_large_as_what_its_removal_changes(tmp_path, capsys):
    for high in (1.6, 2.6):
        new = cloud(1, grown, truck(11, 9, high=high))
        (thing,) = compared(tmp_path, capsys, new, cloud(2, before))["objects"]
        assert thing["volume_m3"] == pytest.approx(15.0 * high, rel=0.06)
        assert thing["size_m"] == pytest.approx(6.0, abs=0.4)
        assert thing["high_m"] == pytest.approx(high, abs=0.15)


def test_a_thing_of_one_place_has_a_width():
    x, y = np.meshgrid(np.arange(9.0), np.arange(9.0))
    r = np.c_[x.ravel(), y.ravel(), np.zeros(81)]
    r[40, 2] = 6.0
    top, every = r[:, 2] > 0.0, np.ones(81, bool)
    (one,) = objects_of(build_tin(r), top, top, every, np.zeros(1, np.int64))
    assert one.size_m == pytest.approx(1.0, rel=0.3)
    assert one.volume_m3 == pytest.approx(6.0, rel=0.5) and one.high_m == 6.0


def test_a_dense_thing_is_measured_in_bounded_memory():
    rng = np.random.default_rng(8)
    roof = rng.uniform([0.0, 0.0, 0.0], [2.5, 4.0, 0.0], (60_000, 3))
    roof[:, 2] = 2.6
    ground = cloud(9, flat, half=6.0)
    ground = ground[~((ground[:, :2] > -0.1) & (ground[:, :2] < (2.6, 4.1))).all(axis=1)]
    points = np.concatenate([roof, ground])
    at_hand = PointsAtHand(points, np.arange(len(points)), standing_in)
    thin = sampled_tin(at_hand.thinned(0.5))
    on_roof = thin.vertices[:, 2] > 1.0
    coarse = ThinTin(thin, on_roof, np.ones(len(thin.vertices), bool))
    tracemalloc.start()
    top = np.flatnonzero(points[:, 2] > 1.0)
    (one,) = objects_of_points(at_hand, Located(top, points[top]), coarse, 0.26)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # with two thirds of the ring of triangles beside it, some 13 m by 0.3 m
    assert 26.0 < one.volume_m3 < 36.0 and one.inside
    assert one.high_m == pytest.approx(2.6, abs=0.1) and one.size_m == pytest.approx(4.0, abs=0.01)
    assert peak < 200e6  # pairs of points nearer than a metre would be 8 GB
