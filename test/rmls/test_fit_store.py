"""What is kept of fits from update to update, against a dictionary of their inliers."""

from __future__ import annotations

import numpy as np

from ladar_volume.rmls.fit_store import WORD, FitStore, blank_fits
from ladar_volume.rmls.patch_fit import OK

CAP, VOXELS, NEVER = 40, 30, 7


def slots_of(store, v):
    """Inliers (k,) of a voxel's fit, ascending, from its entries."""
    out = []
    for entry in store.entries[store.first[v] : store.first[v] + store.held[v]]:
        out += [
            int(entry[0]) * CAP + k
            for k in range(CAP)
            if int(entry[1 + k // WORD]) >> (k % WORD) & 1
        ]
    return sorted(out)


def fits_of(kept, voxels):
    """Fits whose inliers, and mean time, are those of a dictionary by voxel."""
    count = np.array([len(kept[v]) for v in voxels], np.int64)
    members = np.concatenate([np.array(kept[v], np.int32) for v in voxels])
    found = blank_fits(np.array(voxels), np.cumsum(count) - count, members, OK)
    found.used[:], found.time[:] = count, [sum(kept[v]) for v in voxels]
    return found


def test_inliers_of_fits_stay_until_they_change():
    rng, store, kept = np.random.default_rng(5), FitStore(NEVER, CAP), {}
    fresh = np.zeros(VOXELS * CAP, bool)
    for number in range(25):
        store.grow(min(VOXELS, 10 + 2 * number))
        there = len(store.fits.voxels)
        voxels = np.sort(rng.choice(there, rng.integers(1, there), replace=False)).tolist()
        before = {v: kept.get(v) for v in voxels}
        for v in voxels:  # some stay, others have inliers in one voxel or in many
            if kept.get(v) is None or rng.random() < 0.6:
                few = rng.integers(1, 4) if rng.random() < 0.5 else rng.integers(60, 200)
                kept[v] = sorted(rng.choice(there * CAP, few, replace=False).tolist())
        changed, own = store.keep(fits_of(kept, voxels), fresh)
        assert changed.tolist() == [before[v] != kept[v] for v in voxels]
        assert own.tolist() == [sum(s // CAP == v for s in kept[v]) for v in voxels]
        for v in range(there):
            assert slots_of(store, v) == kept.get(v, [])
            assert store.fits.status[v] == (OK if v in kept else NEVER)
            assert store.fits.time[v] == sum(kept.get(v, []))


def test_a_fit_with_a_fresh_inlier_is_new_and_the_pool_does_not_grow_for_nothing():
    store, kept = FitStore(NEVER, CAP), {v: [v * CAP + 3, v * CAP + 35] for v in range(VOXELS)}
    store.grow(VOXELS)
    fresh = np.zeros(VOXELS * CAP, bool)
    store.keep(fits_of(kept, list(kept)), fresh)
    fresh[[5 * CAP + 35, 6 * CAP + 4]] = True  # one is an inlier, the other is not
    for _ in range(40):
        changed, _ = store.keep(fits_of(kept, list(kept)), fresh)
        assert np.flatnonzero(changed).tolist() == [5]
    assert len(store.entries) < 4 * VOXELS
