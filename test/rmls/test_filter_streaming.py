"""The surface is a function of the set of points: not of their order, batching, updates or the
number of threads.
"""

import numba
import numpy as np

from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import select
from ladar_volume.rmls import deferral, refit_kernels
from ladar_volume.rmls.surface_filter import SurfaceFilter
from ladar_volume.rmls.voxel_store import VoxelStore, pack_key, unpack_key

PARAMETERS = Parameters.read({"filter": {"radius_m": 0.5, "cap_per_voxel": 12}})


def surface(update):
    """One update as {patch: bytes of everything} and {pair of patches, the lower key first: bytes
    of its block}.
    """
    out, pairs = {}, {}
    p, q = update.patches, update.points
    for j, key in enumerate(p.key):
        rows = [
            getattr(p, name)[j].tobytes()
            for name in ("centre", "normal", "tangent", "beta", "sigma", "used", "t_ns", "M_cal")
        ]
        nav, own = slice(p.nav_start[j], p.nav_start[j + 1]), q.patch == key
        rows += [p.nav_bin[nav].tobytes(), p.M_nav[nav].tobytes()]
        rows += [p.nav_residual[nav].tobytes(), p.beam_residual[j].tobytes()]
        rows += [p.own_residual[j].tobytes()]
        rows += [
            getattr(q, name)[own].tobytes()
            for name in ("r_map", "normal", "variance", "C_tangent", "t_ns", "local")
        ]
        out[int(key)] = tuple(rows)
        for k in range(p.cross_start[j], p.cross_start[j + 1]):
            pair = tuple(sorted((int(key), int(p.cross_key[k]))))
            assert pair not in pairs
            pairs[pair] = p.cross[k].tobytes()
    return out, pairs


def follow(world, update):
    """Apply one update the way a consumer does."""
    if update is None:
        return
    patches, pairs = world
    new, new_pairs = surface(update)
    for key in update.removed:
        assert int(key) in patches
        del patches[int(key)]
    for pair in [p for p in pairs if p[0] in new or p[1] in new or not set(p) <= set(patches)]:
        del pairs[pair]
    assert all(
        patches.get(key) != rows for key, rows in new.items()
    )  # nothing comes again that did not change
    patches.update(new)
    pairs.update(new_pairs)
    assert all(p[0] in patches and p[1] in patches for p in pairs)


def scene_points(scene, n=6000):
    rng = np.random.default_rng(3)
    r = np.column_stack([scene.sheet(n, half=4.0), 0.02 * rng.normal(size=n)])
    r[:, 2] += np.where(r[:, 0] > 1, 0.3 * (r[:, 0] - 1), 0)
    r[: n // 10, 2] += rng.uniform(0, 3, n // 10)
    return scene.mapped(r)


def run(scene, points, order, batches, updates, most=None):
    f = SurfaceFilter(PARAMETERS, deferring=most is not None)
    world = ({}, {})
    parts = np.array_split(order, batches)
    states = scene.platform()
    if not updates:
        f.add_platform(states)
    for i, part in enumerate(parts):
        if updates:
            f.add_platform(
                select(states, slice(i * len(states) // batches, (i + 1) * len(states) // batches))
            )
        f.add(select(points, part))
        if updates:
            follow(world, f.update(most))
    follow(world, f.finish())
    return f, world


def test_streaming_equals_batch_to_the_bit(scene):
    points = scene_points(scene)
    straight = np.arange(len(points))
    whole, expected = run(scene, points, straight, 1, False)
    assert len(expected[0]) > 200
    for order, batches, updates in (
        (straight, 13, True),
        (np.random.default_rng(4).permutation(straight), 7, False),
        (np.random.default_rng(5).permutation(straight), 9, True),
    ):
        f, world = run(scene, points, order, batches, updates)
        assert world == expected
        assert f.losses.as_dict() == whole.losses.as_dict()
        assert f.stats == whole.stats


def test_what_was_put_off_changes_nothing_in_the_end(scene):
    points = scene_points(scene)
    whole, expected = run(scene, points, np.arange(len(points)), 1, False)
    shuffled = np.random.default_rng(7).permutation(len(points))
    for order, batches, most in (
        (np.arange(len(points)), 11, 150),
        (shuffled, 6, 40),
        (shuffled, 3, 1),
    ):
        f, world = run(scene, points, order, batches, True, most)
        assert world == expected
        assert f.losses.as_dict() == whole.losses.as_dict()
        assert f.stats == whole.stats and f.deferred_s == 0.0


def test_a_hurried_surface_is_that_of_the_points_taken_in(scene):
    points = scene_points(scene)
    f, world = SurfaceFilter(PARAMETERS, deferring=True), ({}, {})
    f.add_platform(scene.platform())
    put_off = []
    for part in np.array_split(np.arange(len(points)), 8):
        f.add(select(points, part))
        follow(world, f.update(120))
        put_off.append(f.stats["points_deferred"])
        held = np.concatenate(
            [
                np.arange(v * f.store.cap, v * f.store.cap + n)
                for v, n in enumerate(f.store.count[: f.store.used])
            ]
        )
        there = {(int(t), *r) for t, r in zip(f.store.t_ns[held], f.store.r[held], strict=True)}
        taken = [j for j in range(part[-1] + 1) if (int(points.t_ns[j]), *points.r_map[j]) in there]
        alone = SurfaceFilter(PARAMETERS)
        alone.add_platform(scene.platform())
        alone.add(select(points, np.array(taken)))
        # the stamp tells how far the data goes, not the patches
        assert surface(alone.finish()) == world
    assert max(put_off) > 500 and f.refitted_count > 60
    follow(world, f.update())
    assert world == run(scene, points, np.arange(len(points)), 1, False)[1]


def test_no_more_than_so_many_wait(scene, monkeypatch):
    points, left = scene_points(scene), []
    for most in (200, deferral.MOST_WAITING):
        monkeypatch.setattr(deferral, "MOST_WAITING", most)
        f, world = SurfaceFilter(PARAMETERS, deferring=True), ({}, {})
        f.add_platform(scene.platform())
        for part in np.array_split(np.arange(len(points)), 8):
            f.add(select(points, part))
            follow(world, f.update(1))
            left.append(f.stats["points_deferred"])
        follow(world, f.update())
        assert world == run(scene, points, np.arange(len(points)), 1, False)[1]
    assert max(left[:8]) <= 200 < max(left[8:])


def test_no_tile_is_passed_over_for_ever(scene):
    """New points everywhere before every update: what waits is never older than a few turns of the
    map.
    """
    points = scene_points(scene, 12_000)
    f, oldest, tiles = SurfaceFilter(PARAMETERS, deferring=True), [], 27
    f.add_platform(scene.platform())
    order = np.argsort(points.t_ns, kind="stable")
    for part in np.array_split(order, 60):
        f.add(select(points, part))
        f.update(1)  # one tile at a time
        oldest.append(f.deferred_s)
    span = (points.t_ns.max() - points.t_ns.min()) * 1e-9
    assert 0.0 < max(oldest[tiles:]) < span * 2 * tiles / 60
    assert f.update() is not None and f.deferred_s == 0.0 and f.update(1) is None


def test_of_those_that_wait_a_voxel_holds_what_could_stay(scene, monkeypatch):
    points = scene_points(scene)
    monkeypatch.setattr(deferral, "ROOM", 500)
    offered = VoxelStore(0.5, 8).offer(points.t_ns, points.ring, points.r_map, points.C_ind)[0]
    waiting, store, full = deferral.WaitingPoints(8), VoxelStore(0.5, 8), VoxelStore(0.5, 8)
    full.insert(offered)
    for part in np.array_split(np.random.default_rng(2).permutation(len(offered)), 5):
        waiting.add(select(offered, part))
    assert len(waiting) == full.kept_count < 0.7 * len(offered)
    newest = int(points.t_ns.max())
    assert waiting.age_s(newest) == (newest - points.t_ns.min()) * 1e-9
    left, hashes = len(waiting), []
    while len(waiting):
        took = waiting.take(store, 1, newest)
        store.insert(took)
        hashes.append(took.hash)
        assert len(waiting) == left - len(took) < left
        left = len(waiting)
    assert len(hashes) > 3 and store.kept_count == full.kept_count and waiting.age_s(newest) == 0.0
    slots = np.concatenate(
        [np.arange(v * 8, v * 8 + n) for v, n in enumerate(full.count[: full.used])]
    )
    assert np.array_equal(np.sort(np.concatenate(hashes)), np.sort(full.hashes[slots]))
    assert len(waiting.take(store, None, newest)) == 0
    assert waiting.capacity <= 500  # the room of those that waited is given back
    waiting.add(select(offered, np.arange(20)))
    assert len(waiting.take(store, None, newest)) == len(waiting.take(store, None, newest)) + 20


def test_room_is_given_back_while_some_still_wait(scene, monkeypatch):
    points = scene_points(scene, 12_000)
    offered = VoxelStore(0.5, 8).offer(points.t_ns, points.ring, points.r_map, points.C_ind)[0]
    newest, found = int(points.t_ns.max()), []
    for room in (64, 1 << 16):
        monkeypatch.setattr(deferral, "ROOM", room)
        waiting, store, turns, sizes = deferral.WaitingPoints(8), VoxelStore(0.5, 8), [], []
        waiting.add(offered)
        while len(waiting):
            took = waiting.take(store, 1, newest)
            store.insert(took)
            turns.append((sorted(took.hash.tolist()), waiting.age_s(newest)))
            sizes.append(waiting.capacity)
            assert sizes[-1] <= max(room, 4 * len(waiting)) or len(waiting) == 0
        found.append((turns, sizes))
    assert found[0][0] == found[1][0] and len(set(found[0][1])) > 3 and len(set(found[1][1])) == 1


def test_voxels_near_others():
    rng = np.random.default_rng(1)
    store = VoxelStore(1.0, 2)
    r = rng.uniform(-6.0, 6.0, (700, 3))
    store.insert(
        store.offer(np.arange(700), np.zeros(700, np.uint16), r, np.zeros((700, 6), np.float32))[0]
    )
    ijk = unpack_key(store.keys[: store.used])
    for count in (0, 1, 9, store.used):
        chosen = rng.permutation(store.used)[:count]
        found = np.zeros(store.used, bool)
        refit_kernels.mark_around(chosen, store.keys, store.table, 2, found)
        assert np.array_equal(
            found, (np.abs(ijk[:, None] - ijk[None, chosen]).max(axis=2) <= 2).any(axis=1)
        )


def test_a_patch_that_loses_its_ground_is_removed(scene):
    # more points can turn a patch of the upper sheet into outliers of the lower one: consumers are
    # told
    rng = np.random.default_rng(6)
    low = np.column_stack(
        [scene.sheet(3000, seed=8), np.full(3000, 0.40) + 0.002 * rng.normal(size=3000)]
    )
    high = np.column_stack(
        [scene.sheet(160, seed=9), np.full(160, 0.62) + 0.002 * rng.normal(size=160)]
    )
    points = scene.mapped(np.concatenate([high, low]))
    f = SurfaceFilter(Parameters.read({"filter": {"radius_m": 0.5, "cap_per_voxel": 100}}))
    f.add_platform(scene.platform())
    world = ({}, {})
    f.add(select(points, slice(0, 160)))
    first = f.update()
    follow(world, first)
    f.add(select(points, slice(160, None)))
    second = f.finish()
    assert len(second.removed) > 0 and np.isin(second.removed, first.patches.key).all()
    follow(world, second)
    again = SurfaceFilter(Parameters.read({"filter": {"radius_m": 0.5, "cap_per_voxel": 100}}))
    again.add_platform(scene.platform())
    again.add(points)
    assert world == surface(again.finish())


def test_one_thread_equals_many(scene):
    points = scene_points(scene, 3000)
    order, threads = np.arange(len(points)), numba.get_num_threads()
    _, many = run(scene, points, order, 1, False)
    try:
        numba.set_num_threads(1)
        _, one = run(scene, points, order, 1, False)
    finally:
        numba.set_num_threads(threads)
    assert one == many and len(one[0]) > 50


def test_cap_keeps_the_same_points_in_any_order(scene):
    points = scene_points(scene)
    kept = []
    for seed in range(4):
        store = VoxelStore(0.5, 8, voxels=4)
        order = np.random.default_rng(seed).permutation(len(points))
        for part in np.array_split(order, 3 * seed + 1):
            p = select(points, part)
            store.insert(store.offer(p.t_ns, p.ring, p.r_map, p.C_ind)[0])
        held = (np.arange(store.used * 8) % 8) < np.repeat(store.count[: store.used], 8)
        kept.append(
            {
                row.tobytes()
                for row in np.column_stack(
                    [store.t_ns[: len(held)][held], store.r[: len(held)][held]]
                )
            }
        )
        assert (
            store.kept_count == len(kept[-1])
            and store.count.max() == 8
            and store.offered == len(points)
        )
    assert kept[0] == kept[1] == kept[2] == kept[3]


def test_cap_is_a_fair_sample_of_the_voxel():
    rng = np.random.default_rng(1)
    n = 40_000
    r = rng.uniform(0, 0.5, (n, 3)) + np.repeat(np.arange(10), n // 10)[:, None] * np.array(
        [0.5, 0, 0]
    )
    store = VoxelStore(0.5, 400)
    store.insert(
        store.offer(np.arange(n), np.zeros(n, np.uint16), r, np.zeros((n, 6), np.float32))[0]
    )
    mean = np.stack(
        [
            store.r[v * 400 : (v + 1) * 400].mean(axis=0) - 0.5 * unpack_key(store.keys[v])
            for v in range(10)
        ]
    )
    # sd of a mean of 400 uniforms over 0.5 m is 7.2 mm
    assert np.abs(mean - 0.25).max() < 4 * 0.5 / np.sqrt(12 * 400)
    times = np.stack([store.t_ns[v * 400 : (v + 1) * 400].mean() - v * 4000 for v in range(10)])
    assert np.abs(times - 2000).max() < 4 * 4000 / np.sqrt(12 * 400)


def test_keys_round_trip_and_sort_by_axis():
    ijk = np.array([[0, 0, 0], [-1, 5, 7], [1000, -1000, 3], [-(2**20), 2**20 - 1, 0]])
    key = pack_key(ijk)
    assert np.array_equal(unpack_key(key), ijk) and (key >= 0).all()
    assert (
        pack_key(np.array([1, 0, 0]))
        > pack_key(np.array([0, 5, 5]))
        > pack_key(np.array([0, 4, 9]))
    )
