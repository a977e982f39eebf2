"""Merging many updates at once is the same as replacing patch by patch."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from rough_sheet import rough, still
from volume_surfaces import cone, surface_update, take_patches

from ladar_volume.io.message_tables import update_parts
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import FilterUpdate, select
from ladar_volume.rmls.surface_filter import SurfaceFilter
from ladar_volume.uncertainty import patch_table
from ladar_volume.uncertainty.packing import unpack_patches
from ladar_volume.uncertainty.patch_table import PatchStore


def random_updates(rng, n):
    """Updates that set, replace and remove patches of one surface; a patch's version shows in its
    sigma and its points' time.
    """
    whole = surface_update(cone, spacing=1.0, half=4.0)
    out = []
    for version in range(n):
        m = len(whole.patches)
        rows = np.flatnonzero(rng.random(m) < 0.3)
        rng.shuffle(rows)
        patches = take_patches(whole.patches, rows)
        patches = dataclasses.replace(patches, sigma=np.full(len(rows), float(version)))
        points = select(whole.points, np.isin(whole.points.patch, patches.key))
        points = dataclasses.replace(points, t_ns=np.full(len(points), version, np.int64))
        removed = whole.patches.key[rng.random(m) < 0.1]
        out.append(FilterUpdate(version, removed, points, patches))
    return out


def twin(updates):
    """Key -> version, the plain way."""
    held = {}
    for update in updates:
        for key in update.removed.tolist():
            held.pop(key, None)
        for key, version in zip(
            update.patches.key.tolist(), update.patches.sigma.tolist(), strict=True
        ):
            held[key] = version
    return held


@pytest.mark.parametrize(
    ("look_every", "pending"), [(1, 10**6), (3, 10**6), (100, 10**6), (100, 40)]
)
def test_merge(look_every, pending, monkeypatch):
    monkeypatch.setattr(patch_table, "PENDING", pending)
    updates = random_updates(np.random.default_rng(5), 9)
    store = PatchStore()
    for number, update in enumerate(updates):
        store.replace(update)
        if number % look_every == 0:
            assert store.patches is not None
    held = twin(updates)
    assert store.patches is not None and store.points is not None
    assert store.patches.key.tolist() == sorted(held) and 0 < len(held)
    assert store.patches.sigma.tolist() == [held[key] for key in sorted(held)]
    assert (np.diff(store.points.patch) >= 0).all()
    assert store.points.t_ns.tolist() == [held[key] for key in store.points.patch.tolist()]
    last = updates[-1].patches
    row, mine = int(np.flatnonzero(store.patches.key == last.key[0])[0]), store.patches
    found = unpack_patches(mine, row, row + 1)
    assert found.cross == pytest.approx(
        last.cross[: last.cross_start[1]], rel=1e-6
    )  # own blocks alone
    sent = last.M_nav[: last.nav_start[1]]
    assert found.M_nav == pytest.approx(sent, abs=2**-16 * float(np.abs(sent).max()))
    assert np.isnan(found.nav_residual).all() and np.isnan(found.beam_residual).all()  # not sent
    assert found.own_residual.tolist() == [0.0]


def test_residuals_stay_with_their_patches():
    whole = surface_update(cone, spacing=1.0, half=4.0)
    p, m = whole.patches, len(whole.patches)
    own = {
        "nav_residual": np.arange(len(p.nav_bin), dtype=np.float32),
        "beam_residual": np.arange(16 * m, dtype=np.float32).reshape(m, 16),
        "own_residual": np.arange(m, dtype=np.float32),
    }
    whole = dataclasses.replace(whole, patches=dataclasses.replace(p, **own))
    store = PatchStore()
    store.replace(whole)
    for part in update_parts(whole, 17):
        store.replace(part)
    store.replace(
        FilterUpdate(1, p.key[3:5], select(whole.points, np.zeros(0, np.int64)), part_of(p))
    )
    left = np.delete(np.arange(m), [3, 4])
    assert store.patches.nav_residual.tolist() == own["nav_residual"][left].tolist()
    assert (store.patches.beam_residual == own["beam_residual"][left]).all()
    assert (store.patches.own_residual == own["own_residual"][left]).all()


def part_of(patches):
    """None of the patches."""
    return take_patches(patches, np.zeros(0, np.int64))


def test_nothing_yet():
    store = PatchStore()
    assert store.patches is None and store.points is None


def flown(points, order, batches, parts_of, look_every):
    """What a store holds after the points came in batches, every update in parts of so many
    patches.
    """
    f, store = (
        SurfaceFilter(
            Parameters.read({"filter": {"radius_m": 0.5, "cap_per_voxel": 8, "trials": 10}})
        ),
        PatchStore(),
    )
    f.add_platform(still(np.array([0, 5_000_000_000, 10_000_000_000])))
    sent = 0
    for number, batch in enumerate(np.array_split(order, batches)):
        f.add(select(points, batch))
        update = f.finish() if number == batches - 1 else f.update()
        for part in [] if update is None else update_parts(update, parts_of):
            store.replace(part)
            sent += len(part.patches)
        if number % look_every == 0:
            assert store.patches is not None
    return store, sent


def test_a_streamed_surface_is_held_as_the_whole_one_to_the_bit():
    points = rough(4000, 3)
    straight = np.arange(len(points))
    whole, _ = flown(points, straight, 1, 10_000, 1)
    pairs = np.repeat(whole.patches.key, np.diff(whole.patches.cross_start))
    assert len(pairs) > 5 * len(whole.patches) > 500 and (whole.patches.cross_key >= pairs).all()
    for order, batches, parts_of, look_every in (
        (straight, 12, 30, 1),
        (straight, 12, 1000, 4),
        (np.random.default_rng(1).permutation(straight), 7, 50, 100),
    ):
        store, _ = flown(points, order, batches, parts_of, look_every)
        for record, expected in ((store.patches, whole.patches), (store.points, whole.points)):
            for field in dataclasses.fields(record):
                assert (
                    getattr(record, field.name).tobytes() == getattr(expected, field.name).tobytes()
                ), field.name


def test_a_change_in_one_place_is_no_news_elsewhere():
    points = rough(4000, 3)
    west = np.flatnonzero(points.r_map[:, 0] < 2.5)
    east = np.flatnonzero(points.r_map[:, 0] >= 2.5)
    f = SurfaceFilter(Parameters.read({"filter": {"radius_m": 0.5, "cap_per_voxel": 100}}))
    f.add_platform(still(np.array([0, 10_000_000_000])))
    f.add(select(points, west))
    first = f.update().patches
    f.add(select(points, east))
    second = f.update().patches
    assert (
        len(second) < len(first) / 3 and second.centre[:, 0].min() > 0.9
    )  # a patch looks two voxels far
    lower = np.repeat(second.key, np.diff(second.cross_start)) > second.cross_key
    assert (
        lower.any()
        and np.isin(second.cross_key[lower], first.key).all()
        and not np.isin(second.cross_key[lower], second.key).any()
    )
    f.add(
        select(points, east[:3])
    )  # the same returns again: the cap takes them, and the patches there change
    assert f.update() is not None and f.update() is None
