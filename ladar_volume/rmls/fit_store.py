"""The fits of all voxels, kept from update to update: what new points did not reach need not be
fitted, sent nor stored again.

Which points are a fit's inliers is kept as one entry per voxel they lie in: its index and a bit for
each of its slots. That is a tenth of their slots.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ladar_volume.math.array_types import F32, F64, I32, I64, U32, Bool
from ladar_volume.math.kernels import kernel
from ladar_volume.rmls.patch_fit import OK
from ladar_volume.rmls.thinning_weights import weigh_inliers
from ladar_volume.rmls.voxel_store import VoxelArrays, VoxelStore

#: Bits of one word of an entry.
WORD = 32
#: Numbers of one fit.
COLUMNS = ("status", "used", "sigma", "time", "centre", "normal", "tangent", "beta", "inverse")


class Fits(NamedTuple):
    """Fits by row; the slots of row a's inliers, where they are listed, are ``members[start[a] :
    start[a] + used[a]]``, in canonical order, and their weights in the fit ``weights`` beside them.

    voxels : (m,) index of each row's voxel · status : see ``fit`` · sigma : (m,) m · time : (m,)
    mean time, ns · centre, normal, tangent : (m, 3) · beta : (m, 6) · inverse : (m, 6, 6) of the
    weighted normal matrix
    """

    voxels: I64
    start: I64
    members: I32
    used: I64
    status: I64
    sigma: F64
    time: I64
    centre: F64
    normal: F64
    tangent: F64
    beta: F64
    inverse: F64
    weights: F32


def blank_fits(voxels: I64, start: I64, members: I32, status: int = OK) -> Fits:
    """Rows (m,) to be filled."""
    m = len(voxels)
    return Fits(
        voxels,
        start,
        members,
        np.zeros(m, np.int64),
        np.full(m, status, np.int64),
        np.zeros(m),
        np.zeros(m, np.int64),
        np.zeros((m, 3)),
        np.zeros((m, 3)),
        np.zeros((m, 3)),
        np.zeros((m, 6)),
        np.zeros((m, 6, 6)),
        np.zeros(0, np.float32),
    )


@kernel
def count_entries(start: I64, used: I64, members: I32, cap: int, out: I64) -> None:
    """Voxels that the inliers of each row lie in."""
    for a in range(len(start)):
        last, out[a] = -1, 0
        for i in range(start[a], start[a] + used[a]):
            v = members[i] // cap
            out[a] += v != last
            last = v


@kernel
def encode_inliers(
    fits: Fits, fresh: Bool, cap: int, first: I64, entries: U32, new: Bool, own: I64
) -> None:
    """The inliers of each row as ``entries`` (e, 1 + words) of zeros, from ``first[a]`` on; whether
    one of them is ``fresh``, and how many lie in the voxel itself.
    """
    members = fits.members
    for a in range(len(fits.voxels)):
        last, e = -1, first[a] - 1
        new[a], own[a] = False, 0
        for i in range(fits.start[a], fits.start[a] + fits.used[a]):
            v = members[i] // cap
            k = members[i] - v * cap
            if v != last:
                last, e = v, e + 1
                entries[e, 0] = v
            entries[e, 1 + k // WORD] |= np.uint32(1 << (k % WORD))
            new[a] |= fresh[members[i]]
            own[a] += v == fits.voxels[a]


@kernel
def decode_inliers(
    voxels: I64, first: I64, held: I64, entries: U32, store: VoxelArrays, start: I64, members: I32
) -> None:
    """The slots of these voxels' inliers, in canonical order, to ``members`` from ``start[v]``
    on.
    """
    cap, order = store.cap, store.order
    for v in voxels:
        n = start[v]
        for e in range(first[v], first[v] + held[v]):
            w = np.int64(entries[e, 0]) * cap
            for q in range(store.counts[entries[e, 0]]):
                k = order[w + q] - w
                if (entries[e, 1 + k // WORD] >> np.uint32(k % WORD)) & np.uint32(1):
                    members[n] = order[w + q]
                    n += 1


@kernel
def same_entries(
    voxels: I64,
    first: I64,
    held: I64,
    entries: U32,
    old_first: I64,
    old_held: I64,
    old_entries: U32,
    same: Bool,
) -> None:
    """Whether the entries of each row are those kept for its voxel."""
    for a in range(len(voxels)):
        v = voxels[a]
        same[a] = held[a] == old_held[v]
        if same[a]:
            for e in range(held[a]):
                for k in range(entries.shape[1]):
                    same[a] &= entries[first[a] + e, k] == old_entries[old_first[v] + e, k]


@kernel
def move_entries(rows: I64, first: I64, held: I64, entries: U32, to: I64, new: U32) -> None:
    """Copy the entries of chosen rows to ``new``, from ``to[k]`` on for the k-th."""
    for k in range(len(rows)):
        for e in range(held[rows[k]]):
            new[to[k] + e] = entries[first[rows[k]] + e]


class FitStore:
    """One row per voxel of a store, by voxel index. The entries lie in one pool: a fit that needs
    more room than it had moves to its end, and the pool is made anew when that is reached.
    """

    def __init__(self, never: int, cap: int) -> None:
        """never : status of voxels that have not been fitted yet · cap : slots of a voxel."""
        self._never, self._cap = never, cap
        self.first: I64 = np.zeros(0, np.int64)
        self.held: I64 = np.zeros(0, np.int64)
        self.entries: U32 = np.zeros((0, 1 + -(-cap // WORD)), np.uint32)
        self._room: I64 = np.zeros(0, np.int64)
        self._end = 0
        self.fits = blank_fits(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, np.int32))

    def grow(self, voxels: int) -> None:
        """Make rows for new voxels."""
        more = voxels - len(self.fits.voxels)
        if more > 0:
            new = blank_fits(
                np.arange(voxels - more, voxels),
                np.zeros(more, np.int64),
                np.zeros(0, np.int32),
                self._never,
            )
            joined = {
                name: np.concatenate([getattr(self.fits, name), getattr(new, name)])
                for name in ("voxels", "start", *COLUMNS)
            }
            self.fits = self.fits._replace(**joined)
            self.first, self.held, self._room = (
                np.concatenate([a, np.zeros(more, np.int64)])
                for a in (self.first, self.held, self._room)
            )

    def with_inliers(self, voxels: I64, store: VoxelStore) -> Fits:
        """The fits of all voxels, with the inliers of these ones and their weights listed."""
        start, used = np.zeros(len(self.fits.voxels), np.int64), self.fits.used[voxels]
        start[voxels] = np.cumsum(used) - used
        members = np.empty(int(used.sum()), np.int32)
        decode_inliers(voxels, self.first, self.held, self.entries, store.arrays, start, members)
        fits = self.fits._replace(start=start, members=members)
        weights = np.empty(len(members), np.float32)
        weigh_inliers(voxels, start, fits.used, members, fits.normal, store.arrays, weights)
        return fits._replace(weights=weights)

    def keep(self, found: Fits, fresh: Bool) -> tuple[Bool, I64]:
        """Take over fits; returns which of them are new (m,), by any number or any inlier, and how
        many inliers (m,) lie in the voxel.

        fresh : slots filled since the last update.
        """
        kept, v, m = self.fits, found.voxels, len(found.voxels)
        held, new, own, same = (
            np.zeros(m, np.int64),
            np.zeros(m, np.bool_),
            np.zeros(m, np.int64),
            np.zeros(m, np.bool_),
        )
        count_entries(found.start[:m], found.used, found.members, self._cap, held)
        first, entries = (
            np.cumsum(held) - held,
            np.zeros((int(held.sum()), self.entries.shape[1]), np.uint32),
        )
        encode_inliers(found, fresh, self._cap, first, entries, new, own)
        same_entries(v, first, held, entries, self.first, self.held, self.entries, same)
        same &= ~new
        for name in COLUMNS:
            equal = getattr(found, name) == getattr(kept, name)[v]
            same &= equal.reshape(len(v), -1).all(axis=1)
        same |= (found.status != OK) & (kept.status[v] != OK)
        rows = np.flatnonzero(~same)
        self._place(v[rows], held[rows])
        for name in COLUMNS:
            getattr(kept, name)[v[rows]] = getattr(found, name)[rows]
        move_entries(rows, first, held, entries, self.first[v[rows]], self.entries)
        return ~same, own

    def _place(self, voxels: I64, wanted: I64) -> None:
        """Room for so many entries of each of these voxels, whose present ones are no longer
        needed.
        """
        room = wanted + wanted // 4
        self.held[voxels] = 0
        tight = wanted > self._room[voxels]
        if self._end + int(room[tight].sum()) > len(self.entries):
            first = np.concatenate([[0], np.cumsum(self.held)])
            entries = np.empty(
                ((int(first[-1]) + int(room.sum())) * 5 // 4, self.entries.shape[1]), np.uint32
            )
            move_entries(self.fits.voxels, self.first, self.held, self.entries, first, entries)
            self.first, self._room, self._end, self.entries = (
                first[:-1].copy(),
                self.held.copy(),
                int(first[-1]),
                entries,
            )
            tight = wanted > self._room[voxels]
        ends = self._end + np.cumsum(room[tight])
        self.first[voxels[tight]], self._room[voxels[tight]] = ends - room[tight], room[tight]
        self._end = int(ends[-1]) if len(ends) else self._end
        self.held[voxels] = wanted
