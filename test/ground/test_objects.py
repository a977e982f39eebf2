"""Clusters, regions and picked points: objects above and pits below the ground."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ladar_volume.ground.clusters import (
    clusters,
    component_labels,
    flatten_roots,
    join_cells,
)
from ladar_volume.ground.objects import find_objects, objects_at_places, objects_in_regions
from ladar_volume.ground.polynomial import design_surface
from ladar_volume.ground.regions import in_box, in_polygon
from ladar_volume.math.union_find import root_of
from ladar_volume.model.body_parameters import ObjectParameters
from ladar_volume.model.errors import ObjectError
from ladar_volume.model.parameters import GroundParameters
from test.scenes.several_grounds import find_grounds

LEVEL = [design_surface([0.0])]
P = ObjectParameters(distance_m=0.25, min_points=20)


def block(x, y, w, d, h, spacing=0.1, z=0.0):
    """Top and side points of a box with its low corner at x, y, z."""
    a, b, c = (np.arange(0, s + 1e-9, spacing) for s in (w, d, h))
    top = np.stack(np.meshgrid(a, b, [h], indexing="ij"), -1).reshape(-1, 3)
    sides = [
        np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        for axes in (([0, w], b, c), (a, [0, d], c))
    ]
    return np.concatenate([top, *sides]) + np.array([x, y, z])


def floor(half=5.0, spacing=0.2):
    axis = np.arange(-half, half, spacing)
    return np.stack(
        [a.ravel() for a in (*np.meshgrid(axis, axis), np.zeros((len(axis), len(axis))))], 1
    )


def scene():
    return np.concatenate(
        [
            floor(),
            block(-3, -3, 1, 1, 1),
            block(1, 1, 2, 1, 0.5),
            block(-3, 2, 0.5, 0.5, 0.5),
            block(3, -3, 1, 1, -1),
        ]
    )


def same_partition(a, b):
    return len(np.unique(a)) == len(np.unique(b)) == len(np.unique(np.stack([a, b]), axis=1).T)


@pytest.mark.parametrize(
    "n,distance", [(500, 0.08), (2000, 0.06), (800, 0.3), (1, 0.1), (300, 5.0)]
)
def test_components_equal_those_of_all_pairs(n, distance):
    p = np.random.default_rng(n).uniform(-1, 1, (n, 3)) * [1, 0.5, 0.5]
    pair = cKDTree(p).query_pairs(distance, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pair)), pair.T), shape=(n, n))
    assert same_partition(
        component_labels(p, distance), connected_components(graph, directed=False)[1]
    )


def test_joined_cells_are_components_of_their_points():
    p = np.random.default_rng(0).uniform(0, 1, (60, 3))
    start, left, right = (
        np.arange(0, 61, 3),
        np.repeat(np.arange(20), 20),
        np.tile(np.arange(20), 20),
    )
    parent = np.arange(20)
    join_cells(p, start, left, right, 0.01, parent)
    apart = ((p[:, None] - p) ** 2).sum(axis=2).reshape(20, 3, 20, 3).min(axis=(1, 3))
    count, label = connected_components(coo_matrix(apart <= 0.01), directed=False)
    roots = [root_of(parent.copy(), i) for i in range(20)]
    assert same_partition(np.array(roots), label) and 1 < count < 20
    flatten_roots(parent)
    assert np.array_equal(parent, roots)


def test_labels_by_size_then_position_whatever_the_order():
    p = scene()
    order = np.random.default_rng(0).permutation(len(p))
    first, second = find_objects(p, LEVEL, P), find_objects(p[order], LEVEL, P)
    assert np.array_equal(first.label[order], second.label)
    assert [r.points for r in first.records] == sorted(
        (r.points for r in first.records), reverse=True
    )
    twins = np.concatenate([floor(), block(2, 0, 1, 1, 1), block(-3, 0, 1, 1, 1)])
    assert find_objects(twins, LEVEL, P).records[0].low_m[0] == pytest.approx(-3)


def test_objects_are_found_with_their_extent():
    found = find_objects(scene(), LEVEL, P)
    # 441 + ... points: the wide low block, the cube, the small one; the pit is not asked for
    low = np.array([r.low_m[:2] for r in found.records])
    assert np.allclose(
        low[low[:, 0].argsort(kind="stable")], [[-3, -3], [-3, 2], [1, 1]], atol=1e-9
    )
    wide = next(r for r in found.records if r.low_m[0] > 0)
    assert (
        wide.high_m == pytest.approx([3, 2, 0.5])
        and wide.footprint_m2 == pytest.approx(2.0)
        and wide.height_m == pytest.approx(0.5)
    )
    assert wide.centroid_m[:2] == pytest.approx([2.0, 1.5]) and not wide.pit
    q = np.roll(wide.footprint_m, -1, axis=0)
    assert 0.5 * (
        wide.footprint_m[:, 0] * q[:, 1] - q[:, 0] * wide.footprint_m[:, 1]
    ).sum() == pytest.approx(2.0)
    for k, record in enumerate(found.records):
        assert found.mask(k).sum() == record.points
    assert (found.label[found.height_m <= 0.15] == -1).all()


def test_pits_are_listed_after_the_objects():
    found = find_objects(scene(), LEVEL, dataclasses.replace(P, pits=True))
    assert [r.pit for r in found.records] == [False, False, False, True]
    pit = found.records[-1]
    assert pit.height_m == pytest.approx(-1.0) and pit.low_m[2] == pytest.approx(-1.0)


def test_small_low_and_distant_things():
    p = scene()
    assert len(find_objects(p, LEVEL, dataclasses.replace(P, min_points=150)).records) == 2
    assert len(find_objects(p, LEVEL, dataclasses.replace(P, min_height_m=0.6)).records) == 1
    assert len(find_objects(p, LEVEL, dataclasses.replace(P, distance_m=4.1)).records) == 1
    assert find_objects(floor(), LEVEL, P).records == ()


def test_the_threshold_follows_the_noise_of_the_ground():
    rng = np.random.default_rng(1)
    p = scene()
    p[:, 2] += 0.05 * rng.standard_normal(len(p))
    grounds = find_grounds(p, np.full(len(p), 0.0025), GroundParameters())
    found = find_objects(p, grounds, dataclasses.replace(P, min_height_m=0.0, min_points=5))
    assert [r.points > 100 for r in found.records][:2] == [True, True] and len(found.records) <= 4
    assert (
        len(
            find_objects(
                p, grounds, dataclasses.replace(P, min_height_m=0.0, sigmas=0.7, min_points=5)
            ).records
        )
        > 4
    )


def test_objects_on_two_terraces():
    low, high = floor() - np.array([5, 0, 0]), floor() + np.array([5, 0, 2.0])
    face = np.stack(
        [np.zeros(400), *np.random.default_rng(2).uniform([-5, 0.2], [5, 1.9], (400, 2)).T], 1
    )
    p = np.concatenate([low, high, face, block(-4, 0, 1, 1, 1), block(4, 0, 1, 1, 1, z=2.0)])
    grounds = find_grounds(
        p, np.full(len(p), 1e-6), GroundParameters(surfaces=2, threshold_m=0.02, min_support=0.1)
    )
    found = find_objects(p, grounds, P)
    assert [r.points for r in found.records] == [found.records[0].points] * 2
    assert [r.height_m for r in found.records] == pytest.approx([1.0, 1.0])
    alone = find_objects(p, grounds[:1], P)
    assert alone.records[0].points > 2500  # the upper terrace stands on the lower


def test_a_block_that_reaches_the_height_of_another_terrace_stands_on_its_own():
    low, high = floor() - np.array([5, 0, 0]), floor() + np.array([5, 0, 0.5])
    p = np.concatenate([low, high, block(-4, 0, 1, 1, 1)])
    grounds = find_grounds(
        p, np.full(len(p), 1e-6), GroundParameters(surfaces=2, threshold_m=0.02, min_support=0.1)
    )
    found = find_objects(p, grounds, P)
    assert len(grounds) == 2 and len(found.records) == 1
    assert found.records[0].height_m == pytest.approx(1.0) and found.records[0].low_m[
        2
    ] == pytest.approx(0.2)


def test_touching_bodies_by_saddle_by_picks_and_by_polygons():
    xy = floor(6.0, 0.1)[:, :2]
    left, right = (np.maximum(0.0, 2.0 - np.hypot(xy[:, 0] - x, xy[:, 1])) for x in (-1.5, 1.6))
    p = np.c_[xy, np.maximum(left, right)]
    truth = np.where(xy[:, 0] < 0.05, 0, 1)
    assert len(find_objects(p, LEVEL, P).records) == 1
    results = [
        find_objects(p, LEVEL, dataclasses.replace(P, split_m=0.5)),
        objects_at_places(p, LEVEL, [np.array([-1.5, 0, 2.0]), np.array([[1.6, 0, 2.0]])], P),
        objects_in_regions(
            p,
            LEVEL,
            [
                in_polygon(p, [(-6, -6), (0.05, -6), (0.05, 6), (-6, 6)]),
                in_box(p, [0, -6, -1], [6, 6, 3]),
            ],
            P,
        ),
    ]
    for found in results:
        assert len(found.records) == 2
        both = found.label >= 0
        own = truth if found.records[0].centroid_m[0] < 0 else 1 - truth
        assert (found.label[both] == own[both]).mean() > 0.98
    # a shallow saddle is no border
    assert len(find_objects(p, LEVEL, dataclasses.replace(P, split_m=1.9)).records) == 1


def test_two_blocks_that_share_a_face_by_picks():
    p = np.concatenate([floor(), block(-1, 0, 1, 1, 1), block(0, 0, 1.5, 1, 1)])
    assert len(find_objects(p, LEVEL, dataclasses.replace(P, split_m=0.2)).records) == 1
    picks = [
        np.array([[-0.5, 0.5, 1.0], [-0.25, 0.5, 0.5]]),
        np.array([[0.5, 0.5, 1.0], [0.25, 0.5, 0.5], [1.4, 0.5, 1]]),
    ]
    found = objects_at_places(p, LEVEL, picks, P)
    assert [r.footprint_m2 for r in found.records] == pytest.approx([1.0, 1.5], abs=0.11)


def test_picks_take_the_pieces_of_one_body():
    p = scene()
    found = objects_at_places(
        p, LEVEL, [np.array([[-2.5, -2.5, 1.0], [-2.8, 2.2, 0.5]]), np.array([1.5, 1.5, 0.6])], P
    )
    assert len(found.records) == 2 and found.records[0].low_m[:2] == pytest.approx([-3, -3])
    assert found.records[0].high_m == pytest.approx([-2, 2.5, 1.0])


def test_regions():
    p = np.random.default_rng(3).uniform(-2, 2, (2000, 3))
    notch = [(-1, -1), (1, -1), (1, 1), (0, 0), (-1, 1)]
    x, y = p[:, 0], p[:, 1]
    assert np.array_equal(in_polygon(p, notch), (np.abs(x) < 1) & (y > -1) & (y < np.abs(x)))
    assert np.array_equal(in_polygon(p, notch[::-1]), in_polygon(p, notch))
    turn = np.array([[0.8, 0.6, 0], [-0.6, 0.8, 0], [0, 0, 1.0]])
    assert np.array_equal(
        in_box(p, [-1, -0.5, 0], [1, 0.5, 1], turn), in_box(p @ turn.T, [-1, -0.5, 0], [1, 0.5, 1])
    )
    assert in_box(p, [-2, -2, -2], [2, 2, 2]).all()


def test_a_row_of_points_has_a_footprint_without_area():
    p = np.c_[np.linspace(0, 3, 40), np.zeros(40), np.ones(40)]
    record = find_objects(p, LEVEL, P).records[0]
    assert record.footprint_m2 == 0.0 and record.footprint_m.tolist() == [[0, 0], [3, 0]]


@pytest.mark.parametrize(
    "call,reason",
    [
        (lambda p: find_objects(np.zeros((0, 3)), LEVEL), "object_points"),
        (lambda p: find_objects(np.r_[p, [[0, 0, np.nan]]], LEVEL), "object_points"),
        (lambda p: find_objects(p, []), "object_no_ground"),
        (lambda p: find_objects(p, LEVEL, ObjectParameters(distance_m=1e-7)), "object_distance"),
        (lambda p: ObjectParameters(distance_m=0.0), "object_parameters"),
        (lambda p: ObjectParameters(split_m=-1.0), "object_parameters"),
        (lambda p: in_polygon(p, []), "object_polygon"),
        (lambda p: in_polygon(p, [(0, 0), (1, 1)]), "object_polygon"),
        (lambda p: in_polygon(p, [(0, 0), (1, 1), (2, 2)]), "object_polygon"),
        (lambda p: in_polygon(p, [(0, 0), (1, 1), (2, np.inf)]), "object_polygon"),
        (lambda p: in_box(p, [0, 0, 0], [1, 0, 1]), "object_box"),
        (lambda p: in_box(p, [0, 0, 0], [1, 1, 1], 2 * np.eye(3)), "object_box"),
        (
            lambda p: objects_in_regions(p, LEVEL, [in_polygon(p, [(4, 4), (5, 4), (5, 5)])], P),
            "object_empty",
        ),
        (lambda p: objects_at_places(p, LEVEL, [], P), "object_pick"),
        (lambda p: objects_at_places(p, LEVEL, [np.zeros((0, 3))], P), "object_pick"),
        (lambda p: objects_at_places(p, LEVEL, [np.array([0.0, -4.0, 0.0])], P), "object_pick"),
        (
            lambda p: objects_at_places(p, LEVEL, [np.array([-2.5, -2.5, 1.0])] * 2, P),
            "object_pick",
        ),
        (lambda p: objects_at_places(floor(), LEVEL, [np.zeros(3)], P), "object_empty"),
    ],
)
def test_refusals(call, reason):
    with pytest.raises(ObjectError) as caught:
        call(scene())
    assert caught.value.reason == reason


def test_no_chosen_point_no_cluster():
    assert (clusters(np.zeros((3, 3)), 0.1, 1, np.zeros(3, bool)) == -1).all()
