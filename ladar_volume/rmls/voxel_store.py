"""Raw points in voxels of edge r, capped by an order-independent rule: the lowest hashes stay.

Which points a voxel holds depends only on the set of points offered, never on their order or
batching, so streaming equals batch and memory follows the mapped area (seed 002 section 4.3 reduces
by rounding; a hash keeps a fair sample).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from ladar_volume.math.array_types import F32, F64, I16, I32, I64, U16, U64, Bool
from ladar_volume.math.hashing import mix_bits
from ladar_volume.math.kernels import kernel, leaf_kernel
from ladar_volume.rmls.viewing_geometry import KEPT

#: Bits and offset of one axis in a packed voxel key; 2**20 voxels to either side of the map's
#: origin.
BITS = 21
HALF = 1 << (BITS - 1)
Scalar = TypeVar("Scalar", bound=np.generic)


class VoxelArrays(NamedTuple):
    """What kernels read of a store: keys (used,) and hash table of the voxels, points in each, and
    by slot their order, what is kept of a point (see :class:`VoxelStore`) and its hash.
    """

    keys: I64
    table: I32
    counts: I32
    order: I32
    t_ns: I64
    ring: U16
    r: F64
    C: F32
    aux: I16
    hashes: U64
    cap: int


class CappedVoxels(NamedTuple):
    """What decides which points stay: the voxels, and the hashes of their points by slot; ``worst``
    is the slot of a voxel's highest hash, ``changed`` marks voxels that took a point in.
    """

    keys: I64
    table: I32
    counts: I32
    worst: I32
    hashes: U64
    changed: Bool
    cap: int


def pack_key(ijk: I64) -> I64:
    """Voxel indices (..., 3) → key (...,)."""
    s = ijk + HALF
    key: I64 = (s[..., 0] << (2 * BITS)) | (s[..., 1] << BITS) | s[..., 2]
    return key


def unpack_key(key: I64) -> I64:
    """Key (...,) → voxel indices (..., 3)."""
    mask = (1 << BITS) - 1
    return np.stack(
        [(key >> (2 * BITS)) - HALF, ((key >> BITS) & mask) - HALF, (key & mask) - HALF], axis=-1
    )


@leaf_kernel
def find_voxel(table: I32, keys: I64, key: int) -> Any:
    """Index of a voxel in the open-addressing table, −1 where it is not there."""
    mask = np.uint64(len(table) - 1)
    at = mix_bits(np.uint64(key)) & mask
    while table[at] >= 0:
        if keys[table[at]] == key:
            return table[at]
        at = (at + np.uint64(1)) & mask
    return -1


@leaf_kernel
def voxels_around(key: int, keys: I64, table: I32, reach: int, out: I64) -> Any:
    """Indices of the voxels up to ``reach`` away from that of the key, itself included, in order of
    their keys; returns how many.
    """
    mask = (1 << BITS) - 1
    i0, j0, k0 = key >> (2 * BITS), (key >> BITS) & mask, key & mask
    n = 0
    for di in range(-reach, reach + 1):
        for dj in range(-reach, reach + 1):
            for dk in range(-reach, reach + 1):
                w = find_voxel(
                    table, keys, ((i0 + di) << (2 * BITS)) | ((j0 + dj) << BITS) | (k0 + dk)
                )
                if w >= 0:
                    out[n] = w
                    n += 1
    return n


@kernel
def insert_key(table: I32, keys: I64, index: int) -> None:
    """Enter a voxel, by its index, that the table does not hold."""
    mask = np.uint64(len(table) - 1)
    at = mix_bits(np.uint64(keys[index])) & mask
    while table[at] >= 0:
        at = (at + np.uint64(1)) & mask
    table[at] = index


@kernel
def insert_keys(table: I32, keys: I64, used: int) -> None:
    """Fill the table anew with the first ``used`` keys."""
    table[:] = -1
    for i in range(used):
        insert_key(table, keys, i)


@kernel
def would_stay(
    t_ns: I64, ring: U16, r: F64, edge: float, held: CappedVoxels, key: I64, h: U64, stays: Bool
) -> None:
    """Voxel key and hash of each point, and whether it would stay were it alone. Voxels only fill
    up and their worst hash only falls: a point that would not stay now never will.
    """
    for i in range(len(t_ns)):
        ix = np.int64(np.floor(r[i, 0] / edge))
        iy = np.int64(np.floor(r[i, 1] / edge))
        iz = np.int64(np.floor(r[i, 2] / edge))
        key[i] = ((ix + HALF) << (2 * BITS)) | ((iy + HALF) << BITS) | (iz + HALF)
        # the position (to the micrometre) tells apart the two returns of one firing
        place = np.uint64(np.int64(r[i, 0] * 1e6)) ^ mix_bits(np.uint64(np.int64(r[i, 1] * 1e6)))
        h[i] = mix_bits(
            np.uint64(t_ns[i]) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(ring[i]) + place
        )
        v = find_voxel(held.table, held.keys, key[i])
        full = v >= 0 and held.counts[v] >= held.cap
        stays[i] = not full or h[i] < held.hashes[v * held.cap + held.worst[v]]


@kernel
def _insert(key: I64, h: U64, held: CappedVoxels, used: int, start: int, slot_of: I64) -> Any:
    """Offer points from ``start`` on; returns (next point, voxels used). Stops early where the
    voxel arrays are full.
    """
    keys, table, count, worst, hashes, changed, cap = held
    for i in range(start, len(key)):
        v = find_voxel(table, keys, key[i])
        if v < 0:
            if used == len(keys):
                return i, used
            v = used
            keys[v] = key[i]
            used += 1
            insert_key(table, keys, v)
        base = v * cap
        if count[v] < cap:
            k = count[v]
            count[v] += 1
            hashes[base + k] = h[i]
            if k == 0 or h[i] > hashes[base + worst[v]]:
                worst[v] = k
        elif h[i] < hashes[base + worst[v]]:
            k = worst[v]
            hashes[base + k] = h[i]
            w = 0
            for q in range(1, cap):
                if hashes[base + q] > hashes[base + w]:
                    w = q
            worst[v] = w
        else:
            continue
        changed[v] = True
        slot_of[i] = base + k
    return len(key), used


@kernel
def sort_voxels(voxels: I64, count: I32, hashes: U64, cap: int, order: I32) -> None:
    """Slots of each voxel by rising hash, to ``order[v * cap:v * cap + count[v]]``."""
    for v in voxels:
        first = v * cap
        for q in range(count[v]):
            slot = first + q
            m = slot
            while m > first and hashes[order[m - 1]] > hashes[slot]:
                order[m] = order[m - 1]
                m -= 1
            order[m] = slot


@dataclass(frozen=True)
class Candidates:
    """Points (n,) that may stay: key of their voxel, hash, and what is kept of each (see
    :class:`VoxelStore`).
    """

    key: I64
    hash: npt.NDArray[np.uint64]
    t_ns: I64
    ring: U16
    r: F64
    C: F32
    aux: I16

    def __len__(self) -> int:
        return len(self.key)


class VoxelStore:
    """Points by voxel. Slot ``v * cap + k`` holds the k-th point of voxel v; order within a voxel
    means nothing.

    keys : (used,) int64 · count : (used,) int32 · hashes, t_ns, ring, r, C, aux : per slot · order
    : slots of each voxel by hash · fresh : slots filled since :meth:`settle` · aux is the geometry
    as ``geometry`` keeps it
    """

    def __init__(self, edge_m: float, cap: int, voxels: int = 1024) -> None:
        self.edge_m, self.cap, self.used = edge_m, cap, 0
        self.keys: I64 = np.zeros(voxels, np.int64)
        self.count: I32 = np.zeros(voxels, np.int32)
        self.worst: I32 = np.zeros(voxels, np.int32)
        self.changed: npt.NDArray[np.bool_] = np.zeros(voxels, np.bool_)
        self.table: I32 = np.full(4 * voxels, -1, np.int32)
        slots = voxels * cap
        self.hashes: npt.NDArray[np.uint64] = np.zeros(slots, np.uint64)
        self.order: I32 = np.zeros(slots, np.int32)
        self.fresh: npt.NDArray[np.bool_] = np.zeros(slots, np.bool_)
        self.t_ns: I64 = np.zeros(slots, np.int64)
        self.ring: U16 = np.zeros(slots, np.uint16)
        self.r: F64 = np.zeros((slots, 3))
        self.C: F32 = np.zeros((slots, 6), np.float32)
        self.aux: I16 = np.zeros((slots, KEPT), np.int16)
        self.offered = 0

    @property
    def arrays(self) -> VoxelArrays:
        """What kernels read; a view of the present arrays, which a growing store replaces."""
        return VoxelArrays(
            self.keys,
            self.table,
            self.count,
            self.order,
            self.t_ns,
            self.ring,
            self.r,
            self.C,
            self.aux,
            self.hashes,
            self.cap,
        )

    @property
    def _capped_voxels(self) -> CappedVoxels:
        return CappedVoxels(
            self.keys, self.table, self.count, self.worst, self.hashes, self.changed, self.cap
        )

    @property
    def kept_count(self) -> int:
        """Points held."""
        return int(self.count[: self.used].sum())

    def offer(self, t_ns: I64, ring: U16, r: F64, C: F32) -> tuple[Candidates, I64]:
        """The points that may stay, and their rows among those offered. The caller fills their
        ``aux`` and hands them to :meth:`insert`, now or later.
        """
        key, h, stays = (
            np.empty(len(t_ns), np.int64),
            np.empty(len(t_ns), np.uint64),
            np.empty(len(t_ns), np.bool_),
        )
        would_stay(t_ns, ring, r, self.edge_m, self._capped_voxels, key, h, stays)
        self.offered += len(t_ns)
        rows = np.flatnonzero(stays)
        aux = np.zeros((len(rows), KEPT), np.int16)
        return Candidates(key[rows], h[rows], t_ns[rows], ring[rows], r[rows], C[rows], aux), rows

    def insert(self, points: Candidates) -> None:
        """Take points in, each where it is among the lowest hashes of its voxel."""
        slot_of, start = np.full(len(points), -1, np.int64), 0
        while True:
            start, self.used = _insert(
                points.key, points.hash, self._capped_voxels, self.used, start, slot_of
            )
            if start == len(points):
                break
            self._grow()
        rows = np.flatnonzero(slot_of >= 0)
        slots = slot_of[rows]
        for name in ("t_ns", "ring", "r", "C", "aux"):  # later rows win a slot
            getattr(self, name)[slots] = getattr(points, name)[rows]
        self.fresh[slots] = True

    def _grow(self) -> None:
        voxels = 2 * len(self.keys)
        for name in ("keys", "count", "worst", "changed"):
            setattr(self, name, resize_rows(getattr(self, name), voxels))
        for name in ("hashes", "order", "fresh", "t_ns", "ring", "r", "C", "aux"):
            setattr(self, name, resize_rows(getattr(self, name), voxels * self.cap))
        self.table = np.full(4 * voxels, -1, np.int32)
        insert_keys(self.table, self.keys, self.used)

    def points(self) -> Candidates:
        """All points held, one voxel after the other."""
        count = self.count[: self.used]
        rank = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
        slots = np.repeat(np.arange(self.used) * self.cap, count) + rank
        held = (getattr(self, name)[slots] for name in ("t_ns", "ring", "r", "C", "aux"))
        return Candidates(np.repeat(self.keys[: self.used], count), self.hashes[slots], *held)

    def changed_voxels(self) -> I64:
        """Voxel indices changed since :meth:`settle`; brings their ``order`` up to date."""
        changed = np.flatnonzero(self.changed[: self.used])
        sort_voxels(changed, self.count, self.hashes, self.cap, self.order)
        return changed

    def settle(self) -> None:
        """What has changed so far has been seen."""
        self.changed[:] = False
        self.fresh[:] = False


def resize_rows(old: npt.NDArray[Scalar], rows: int) -> npt.NDArray[Scalar]:
    """The same array with more rows, zeros."""
    new: npt.NDArray[Scalar] = np.zeros((rows, *old.shape[1:]), old.dtype)
    new[: len(old)] = old
    return new
