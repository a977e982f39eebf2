"""Points put off while there is no time to refit all they touch, and whose turn it is.

Points wait by tile, blocks of 8 x 8 x 8 voxels: taking in a whole tile refits its rim's neighbours
once instead of once per voxel. What is taken in is a set of points like any other, so the surface
stays exactly the surface of some points; what waits only makes it that of fewer. Turns alternate:
to the tile that has waited longest, so that none waits for more than two rounds of the map, and to
the one that would exchange the most voxels' worth of points: new ground comes at once. An update
leaves no more than :data:`MOST_WAITING` points waiting, however long it takes then.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np

from ladar_volume.math.array_types import F64, I32, I64, U64, Bool
from ladar_volume.math.kernels import kernel
from ladar_volume.model.records import select
from ladar_volume.rmls.patch_fit import REACH
from ladar_volume.rmls.viewing_geometry import KEPT
from ladar_volume.rmls.voxel_store import (
    Candidates,
    VoxelStore,
    find_voxel,
    insert_key,
    insert_keys,
    pack_key,
    resize_rows,
    unpack_key,
    voxels_around,
)

#: Voxels along the side of a tile, as a power of two.
TILE_BITS = 3
#: Points that may wait after an update, 106 bytes each.
MOST_WAITING = 400_000
#: Room for points that is kept however few wait, and how many times as much as is needed is given
#: back.
ROOM, SPARE = 1 << 16, 4
#: The time of a point that does not wait.
NEVER = np.iinfo(np.int64).max


def tile_of(key: I64) -> I64:
    """Keys (n,) of the tiles that voxels lie in."""
    return pack_key(unpack_key(key) >> TILE_BITS)


@kernel
def tiles_within(start: I64, voxels: I64, keys: I64, table: I32, most: int, marked: Bool) -> Any:
    """How many of the tiles, in their order, may be taken in until ``most`` voxels are to be
    refitted; at least one.

    start : (k + 1,) first of each tile's voxels among ``voxels`` (n,) keys · marked : (used,) all
    False
    """
    near, n = np.empty((2 * REACH + 1) ** 3, np.int64), 0
    for k in range(len(start) - 1):
        for a in range(start[k], start[k + 1]):
            n += find_voxel(table, keys, voxels[a]) < 0
            for i in range(voxels_around(voxels[a], keys, table, REACH, near)):
                n += not marked[near[i]]
                marked[near[i]] = True
        if n > most:
            return max(k, 1)
    return len(start) - 1


class Queues(NamedTuple):
    """Lists of points by voxel. cap : most points of a voxel · table, keys : hash table and keys of
    the voxels · counts, head : (voxels,) points and first slot of each · after, hashes : (slots,)
    next slot and hash of each point · ends : voxels used, slots used, first free slot; -1 ends a
    list
    """

    cap: int
    table: I32
    keys: I64
    counts: I32
    head: I32
    after: I32
    hashes: U64
    ends: I64


@kernel
def enqueue(key: I64, h: U64, queues: Queues, start: int, slot_of: I64) -> Any:
    """Put points from ``start`` on into the lists of their voxels, of each the ``cap`` of lowest
    hash; returns the next point, before the end where the voxels' or the slots' arrays are full.
    """
    cap, table, keys, count = queues.cap, queues.table, queues.keys, queues.counts
    head, after, hashes, ends = queues.head, queues.after, queues.hashes, queues.ends
    for i in range(start, len(key)):
        v = find_voxel(table, keys, key[i])
        if v < 0:
            if ends[0] == len(keys):
                return i
            v = ends[0]
            keys[v], head[v] = key[i], -1
            ends[0] += 1
            insert_key(table, keys, v)
        if count[v] < cap:
            slot = ends[2]
            if slot >= 0:
                ends[2] = after[slot]
            elif ends[1] < len(after):
                slot = ends[1]
                ends[1] += 1
            else:
                return i
            after[slot], head[v] = head[v], slot
            count[v] += 1
        else:
            slot, other = head[v], after[head[v]]
            while other >= 0:
                slot, other = other if hashes[other] > hashes[slot] else slot, after[other]
            if h[i] >= hashes[slot]:
                continue
        hashes[slot] = h[i]
        slot_of[i] = slot
    return len(key)


@kernel
def dequeue(voxels: I64, count: I32, head: I32, after: I32, ends: I64, out: I64) -> None:
    """Slots of all points of these voxels, one voxel after the other, to ``out``; their lists are
    empty then and the slots free.
    """
    n = 0
    for v in voxels:
        slot = head[v]
        while slot >= 0:
            out[n] = slot
            n += 1
            following = after[slot]
            after[slot], ends[2] = ends[2], slot
            slot = following
        head[v], count[v] = -1, 0


@kernel
def count_points_in(voxels: I64, keys: I64, table: I32, count: I32, out: I64) -> None:
    """Points that each voxel of these keys (n,) holds."""
    for a in range(len(voxels)):
        v = find_voxel(table, keys, voxels[a])
        out[a] = count[v] if v >= 0 else 0


@kernel
def note_oldest(key: I64, t_ns: I64, keys: I64, table: I32, oldest: I64) -> None:
    """Lower ``oldest`` (used,) to the times of points in voxels that the table holds."""
    for i in range(len(key)):
        v = find_voxel(table, keys, key[i])
        oldest[v] = min(oldest[v], t_ns[i])


class WaitingPoints:
    """The points that wait, of each voxel no more than could stay, in lists by voxel. Order and
    batching of what is added mean nothing.
    """

    def __init__(self, cap: int) -> None:
        self._cap = cap
        self._clear()

    def _clear(self) -> None:
        self._keys: I64 = np.zeros(16, np.int64)
        self._count: I32 = np.zeros(16, np.int32)
        self._head: I32 = np.zeros(16, np.int32)
        self._oldest: I64 = np.full(16, NEVER)
        self._table: I32 = np.full(64, -1, np.int32)
        self._after: I32 = np.zeros(64, np.int32)
        self._ends: I64 = np.array([0, 0, -1])
        self._points = Candidates(
            np.zeros(64, np.int64),
            np.zeros(64, np.uint64),
            np.zeros(64, np.int64),
            np.zeros(64, np.uint16),
            np.zeros((64, 3)),
            np.zeros((64, 6), np.float32),
            np.zeros((64, KEPT), np.int16),
        )

    def __len__(self) -> int:
        return int(self._count.sum())

    @property
    def capacity(self) -> int:
        """Points that there is room for."""
        return len(self._after)

    def age_s(self, newest_ns: int) -> float:
        """How long the oldest point has waited, by the time of the data (s)."""
        return (newest_ns - min(int(self._oldest.min()), newest_ns)) * 1e-9

    def add(self, points: Candidates) -> None:
        """These wait too."""
        slot_of, start = np.full(len(points), -1, np.int64), 0
        while True:
            start = enqueue(
                points.key,
                points.hash,
                Queues(
                    self._cap,
                    self._table,
                    self._keys,
                    self._count,
                    self._head,
                    self._after,
                    self._points.hash,
                    self._ends,
                ),
                start,
                slot_of,
            )
            if start == len(points):
                break
            self._grow()
        rows = np.flatnonzero(slot_of >= 0)
        for field in fields(Candidates):  # later rows win a slot
            getattr(self._points, field.name)[slot_of[rows]] = getattr(points, field.name)[rows]
        note_oldest(points.key, points.t_ns, self._keys, self._table, self._oldest)

    def _grow(self) -> None:
        voxels, slots = len(self._keys), len(self._after)
        if self._ends[0] == voxels:
            self._keys = resize_rows(self._keys, 2 * voxels)
            self._count, self._head = (
                resize_rows(a, 2 * voxels) for a in (self._count, self._head)
            )
            self._oldest = np.concatenate([self._oldest, np.full(voxels, NEVER)])
            self._table = np.full(8 * voxels, -1, np.int32)
            insert_keys(self._table, self._keys, self._ends[0])
        if self._ends[1] == slots:
            self._after = resize_rows(self._after, 2 * slots)
            self._points = Candidates(
                *(
                    resize_rows(getattr(self._points, field.name), 2 * slots)
                    for field in fields(Candidates)
                )
            )

    def take(self, store: VoxelStore, most: int | None, newest_ns: int) -> Candidates:
        """Points whose turn it is: all of them, or as many tiles as refit about ``most`` voxels."""
        voxels = np.flatnonzero(self._count)
        voxels = voxels[np.argsort(self._keys[voxels])]
        if most is not None and len(voxels):
            voxels = voxels[self._turn(store, voxels, most, newest_ns)]
        points = self._release(voxels)
        if len(self._after) > max(ROOM, SPARE * len(self)):
            self._shrink()
        return points

    def _release(self, voxels: I64) -> Candidates:
        """The points of these voxels, one voxel after the other, which wait no longer."""
        slots = np.empty(int(self._count[voxels].sum()), np.int64)
        dequeue(voxels, self._count, self._head, self._after, self._ends, slots)
        self._oldest[voxels] = NEVER
        return select(self._points, slots)

    def _shrink(self) -> None:
        """Give back the room of those that wait no longer."""
        voxels = np.flatnonzero(self._count)
        oldest, points = self._oldest[voxels], self._release(voxels)
        self._clear()
        self.add(points)
        self._oldest[: len(voxels)] = oldest  # of all that came, those that did not stay among them

    def _turn(self, store: VoxelStore, voxels: I64, most: int, newest_ns: int) -> Bool:
        """Which of these voxels (n,), in order of their keys, lie in tiles whose turn it is."""
        key, new = self._keys[voxels], self._count[voxels]
        tiles, tile = np.unique(tile_of(key), return_inverse=True)
        oldest = np.full(len(tiles), newest_ns)
        np.minimum.at(oldest, tile, self._oldest[voxels])
        exchanged = np.bincount(tile, weights=new_point_shares(store, key, new))
        by_age, by_weight = (
            np.argsort(np.argsort(x, kind="stable"), kind="stable") for x in (oldest, -exchanged)
        )
        order = np.argsort(np.minimum(2 * by_age, 2 * by_weight + 1), kind="stable")
        rank = np.empty(len(order), np.int64)
        rank[order] = np.arange(len(order))
        by_turn = np.argsort(rank[tile], kind="stable")
        start = np.concatenate([[0], np.cumsum(np.bincount(tile)[order])])
        marked = np.zeros(max(store.used, 1), np.bool_)
        within = tiles_within(start, key[by_turn], store.keys, store.table, most, marked)
        left = new.sum() - np.cumsum(np.bincount(tile, weights=new)[order])
        chosen: Bool = rank[tile] < max(
            within,
            int(np.searchsorted(-left, -MOST_WAITING)) + 1 if new.sum() > MOST_WAITING else 0,
        )
        return chosen


def new_point_shares(store: VoxelStore, voxels: I64, new: I64 | I32) -> F64:
    """Which share of a voxel's points (n,) would be new ones, at most, if all ``new`` (n,) of its
    points were taken in.
    """
    held = np.zeros(len(voxels), np.int64)
    count_points_in(voxels, store.keys, store.table, store.count, held)
    out: F64 = new / np.minimum(held + new, store.cap)
    return out
