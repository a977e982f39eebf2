"""The compiled passes of an estimate beside plain ones."""

import dataclasses

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ladar_volume.model.records import Patches
from ladar_volume.tin.full_tin import any_corner, build_tin, footprint_areas, vertex_mask
from ladar_volume.tin.relevant import edge_lengths
from ladar_volume.uncertainty.patch_merge import keeps_order, move_rows, place_from, sort_runs
from ladar_volume.uncertainty.patch_table import LatestUpdate, block_entries, select_rows
from ladar_volume.volume.outline import components, fill_holes, vertices_within


@pytest.fixture(scope="module")
def tin():
    made = build_tin(np.random.default_rng(2).uniform(-5.0, 5.0, (800, 3)))
    relevant = np.ones(len(made.triangles), bool)
    relevant[::37] = False
    return dataclasses.replace(made, relevant=relevant)


def test_areas_and_edges_of_triangles(tin):
    a, b, c = (tin.vertices[tin.triangles[:, k], :2] for k in range(3))
    expected = 0.5 * (
        (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    )
    assert np.array_equal(footprint_areas(tin.vertices, tin.triangles), expected)
    assert np.array_equal(footprint_areas(tin.vertices[:, :2], tin.triangles), expected)
    mask = np.random.default_rng(6).random(len(tin.triangles)) < 0.01
    corners = np.isin(np.arange(len(tin.vertices)), tin.triangles[mask])
    assert np.array_equal(vertex_mask(tin, mask), corners)
    assert np.array_equal(any_corner(tin.triangles, corners), corners[tin.triangles].any(axis=1))
    lengths = np.column_stack([np.linalg.norm(v, axis=1) for v in (c - b, a - c, b - a)])
    assert edge_lengths(tin) == pytest.approx(lengths, rel=1e-14)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 1.0])
def test_components_are_those_of_the_graph_of_neighbours(tin, share):
    mask = np.random.default_rng(3).random(len(tin.triangles)) < share
    t, k = np.nonzero((tin.neighbours >= 0) & mask[:, None] & mask[tin.neighbours])
    m = len(mask)
    label = connected_components(
        coo_matrix((np.ones(len(t)), (t, tin.neighbours[t, k])), shape=(m, m)), directed=False
    )[1]
    found = components(tin, mask)
    assert (found[~mask] == -1).all()
    first = np.unique(found[mask], return_index=True)[1]
    assert (np.diff(first) > 0).all() and np.array_equal(
        np.unique(found[mask]), np.arange(len(first))
    )
    assert np.array_equal(label[mask][first][found[mask]], label[mask])
    assert len(np.unique(label[mask])) == len(first)


def test_vertices_within_a_distance(tin):
    mask = tin.vertices[tin.triangles, 0].max(axis=1) < -3.0
    inside = np.unique(tin.triangles[mask])
    away = np.linalg.norm(tin.vertices[:, None, :2] - tin.vertices[None, inside, :2], axis=2).min(
        axis=1
    )
    for distance in (0.0, 0.4, 2.0, 50.0):
        assert np.array_equal(vertices_within(tin, mask, distance), away <= distance)
    assert not vertices_within(tin, np.zeros(len(mask), bool), 1.0).any()


def test_vertices_within_a_distance_where_places_crowd_or_are_far_apart():
    rng = np.random.default_rng(7)
    cluster, lattice = (
        rng.normal(0.0, 3.0, (400, 2)),
        np.stack(np.meshgrid(np.arange(20.0), np.arange(15.0)), axis=-1).reshape(-1, 2),
    )
    narrow, apart = (
        np.column_stack([rng.uniform(0.0, 9.0, 200), rng.uniform(0.0, 1e-3, 200)]),
        np.r_[cluster, [[1e5, -2e4], [3e4, 7e4]]],
    )
    for xy in (cluster, lattice, narrow, apart, cluster[:3]):
        made = build_tin(np.c_[xy, np.zeros(len(xy))])
        for share in (0.0, 0.01, 0.2, 1.0):
            mask = rng.random(len(made.triangles)) < share
            some, places = vertex_mask(made, mask), made.vertices[:, :2]
            away = np.full(len(places), np.inf)
            if some.any():
                away = np.linalg.norm(places[:, None] - places[None, some], axis=2).min(axis=1)
            for distance in (0.0, 0.3, 1.0, 2.0, 5.0, 60.0, 1e6):
                assert np.array_equal(vertices_within(made, mask, distance), away <= distance)


def test_holes_are_filled_with_relevant_triangles_alone(tin):
    middle = tin.vertices[tin.triangles, :2].mean(axis=1)
    ring = (np.hypot(*middle.T) > 1.0) & (np.hypot(*middle.T) < 3.0)
    label = components(tin, ~ring)
    closed = {
        k
        for k in np.unique(label[~ring])
        if tin.relevant[label == k].all() and (tin.neighbours[label == k] >= 0).all()
    }
    assert np.array_equal(fill_holes(tin, ring), ring | np.isin(label, list(closed)))
    assert fill_holes(tin, np.ones(len(ring), bool)).all()


def update_of(rng, keys, named):
    """Patches of some keys, each with blocks with random others, itself first."""
    lists = [
        np.concatenate([[k], rng.permutation(named[named != k])[: rng.integers(0, 5)]])
        for k in keys
    ]
    n, count = len(keys), np.array([len(x) for x in lists])
    blocks = rng.random((int(count.sum()), 3, 3))
    zero = np.zeros((n, 3))
    return Patches(
        keys,
        zero,
        zero,
        zero,
        zero,
        np.zeros(n),
        np.zeros(n, np.int32),
        np.zeros(n, np.int64),
        np.concatenate([[0], np.cumsum(count)]),
        np.concatenate(lists),
        blocks,
        np.zeros((n, 3, 1)),
        np.zeros(n + 1, np.int64),
        np.zeros(0, np.int64),
        np.zeros((0, 5, 4)),
    )


def test_blocks_of_several_updates_one_by_one():
    rng = np.random.default_rng(4)
    named = np.arange(40, dtype=np.int64) * 3
    parts = [
        update_of(rng, np.sort(rng.permutation(named)[:count]), named) for count in (30, 8, 8, 1)
    ]
    turns = [0, 1, 1, 2]
    said = [(int(k), turn) for part, turn in zip(parts, turns, strict=True) for k in part.key] + [
        (int(named[5]), 2)
    ]
    newest = {key: max(t for k, t in said if k == key) for key, _ in said}
    keys = np.array(sorted(k for k in newest if k != named[5]), np.int64)
    expected = {}
    for part, turn in zip(parts, turns, strict=True):
        for i, own in enumerate(part.key.tolist()):
            for e in range(part.cross_start[i], part.cross_start[i + 1]):
                other = int(part.cross_key[e])
                if turn == max(newest[own], newest.get(other, -1)):
                    pair = (
                        (min(own, other), max(own, other))
                        if min(own, other) in keys
                        else (own, other)
                    )
                    expected.setdefault(pair, []).append(part.cross[e].tobytes())
    last = LatestUpdate.__new__(LatestUpdate)
    last.keys = np.append(np.array(sorted(newest), np.int64), np.iinfo(np.int64).max)
    last.turns = np.append([newest[k] for k in sorted(newest)], -1)
    own, starts, others = (
        [getattr(part, name) for part in parts] for name in ("key", "cross_start", "cross_key")
    )
    start, other, entry = block_entries(own, starts, others, turns, last, keys)
    blocks, got = select_rows([part.cross for part in parts], entry), {}
    for i, mine in enumerate(keys.tolist()):
        assert (np.diff(other[start[i] : start[i + 1]]) >= 0).all()
        for e in range(start[i], start[i + 1]):
            got.setdefault((mine, int(other[e])), []).append(blocks[e].tobytes())
    assert {k: sorted(v) for k, v in got.items()} == {
        k: sorted(v) for k, v in expected.items() if k[0] in keys
    }
    assert start[-1] == len(other) > 40


def test_points_in_order_within_their_patches():
    rng = np.random.default_rng(8)
    patch = np.sort(rng.integers(0, 30, 900))
    patch[:150] = 0  # one patch with many
    r = rng.integers(0, 4, (900, 3)).astype(np.float64)
    order = np.argsort(patch, kind="stable")
    sort_runs(patch, r, order)
    assert np.array_equal(order, np.lexsort((r[:, 2], r[:, 1], r[:, 0], patch)))


def test_places_of_keys_from_any_hint():
    keys = np.array([2, 3, 5, 8, 13, 21], np.int64)
    for hint in range(7):
        for key in range(25):
            assert place_from(keys, key, hint) == np.searchsorted(keys, key)


def test_rows_picked_from_parts():
    rng = np.random.default_rng(5)
    parts = [rng.random((n, 2, 3)) for n in (4, 0, 7)]
    rows = rng.permutation(11)[:8]
    assert np.array_equal(select_rows(list(parts), rows), np.concatenate(parts)[rows])
    assert np.array_equal(
        select_rows([part[:, 0, 0] for part in parts], rows), np.concatenate(parts)[rows, 0, 0]
    )


@pytest.mark.parametrize(
    ("shape", "kind"),
    [
        ((2, 3), np.float64),
        ((), np.int64),
        ((3,), np.int16),
        ((4, 4), np.int16),
        ((5,), np.float32),
    ],
)
@pytest.mark.parametrize("left", [0, 3, 60, 90])
def test_a_part_nobody_else_holds_is_changed_in_place(shape, kind, left):
    rng = np.random.default_rng(left)
    parts = [rng.integers(-9999, 9999, (n, *shape)).astype(kind) for n in (90, 30, 70)]
    stay, new = (
        np.sort(rng.permutation(90)[:left]),
        rng.permutation(100)[: rng.integers(1, 100)] + 90,
    )
    rows = np.insert(new, np.sort(rng.integers(0, len(new) + 1, left)), stay)
    whole, mine = np.concatenate(parts), [part.copy() for part in parts]
    to = np.full(90, -1)
    to[rows[rows < 90]] = np.flatnonzero(rows < 90)
    moved = np.concatenate([parts[0], np.zeros((110, *shape), kind)])
    assert keeps_order(to) and (left < 2 or not keeps_order(to[::-1]))
    move_rows(moved.reshape(-1), int(np.prod(shape)), to)
    assert np.array_equal(moved[to[to >= 0]], parts[0][stay])
    assert np.array_equal(select_rows(list(parts), rows), whole[rows])
    assert np.array_equal(parts[0], whole[:90])  # somebody else has a hold of it
    assert np.array_equal(select_rows(mine, rows), whole[rows]) and not mine
    backwards = rng.permutation(190)[:50]
    assert np.array_equal(select_rows([part.copy() for part in parts], backwards), whole[backwards])
