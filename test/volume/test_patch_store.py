"""Merging many updates at once is the same as replacing patch by patch."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from volume_surfaces import cone, surface_update

from ladar_volume.model.records import FilterUpdate, select
from ladar_volume.volume.patch_store import PatchStore, take_patches


def random_updates(rng, n):
    """Updates that set, replace and remove patches of one surface; a patch's version shows in its sigma and its points' time."""
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
        for key, version in zip(update.patches.key.tolist(), update.patches.sigma.tolist(), strict=True):
            held[key] = version
    return held


@pytest.mark.parametrize("look_every", [1, 3, 100])
def test_merge(look_every):
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
    assert mine.cross[mine.cross_start[row] : mine.cross_start[row + 1]].tobytes() == last.cross[: last.cross_start[1]].tobytes()
    assert mine.M_nav[mine.nav_start[row] : mine.nav_start[row + 1]].tobytes() == last.M_nav[: last.nav_start[1]].tobytes()


def test_nothing_yet():
    store = PatchStore()
    assert store.patches is None and store.points is None
