"""Points put off while there is no time to refit all they touch, and whose turn it is.

Points wait by tile, blocks of 8 x 8 x 8 voxels: taking in a whole tile refits its rim's neighbours once instead of once per voxel. What is
taken in is a set of points like any other, so the surface stays exactly the surface of some points; what waits only makes it that of fewer.
Turns alternate: to the tile that has waited longest, so that none waits for more than two rounds of the map, and to the one that would
exchange the most voxels' worth of points: new ground comes at once.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ladar_volume.filtering.fit import REACH
from ladar_volume.filtering.store import Candidates, VoxelStore, find_voxel, pack_key, unpack_key, voxels_around
from ladar_volume.model.kernels import kernel
from ladar_volume.model.records import F64, I32, I64, Bool

#: Voxels along the side of a tile, as a power of two.
TILE_BITS = 3
#: The time of a point that does not wait.
NEVER = np.iinfo(np.int64).max


def tile_of(key: I64) -> I64:
    """Keys (n,) of the tiles that voxels lie in."""
    return pack_key(unpack_key(key) >> TILE_BITS)


@kernel
def tiles_within(start: Any, voxels: Any, keys: Any, table: Any, most: Any, marked: Any) -> Any:
    """How many of the tiles, in their order, may be taken in until ``most`` voxels are to be refitted; at least one.

    start : (k + 1,) first of each tile's voxels among ``voxels`` (n,) keys · marked : (used,) all False
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


@kernel
def held_in(voxels: Any, keys: Any, table: Any, count: Any, out: Any) -> None:
    """Points that each voxel of these keys (n,) holds."""
    for a in range(len(voxels)):
        v = find_voxel(table, keys, voxels[a])
        out[a] = count[v] if v >= 0 else 0


@kernel
def note_oldest(key: Any, t_ns: Any, keys: Any, table: Any, oldest: Any) -> None:
    """Lower ``oldest`` (used,) to the times of points in voxels that the table holds."""
    for i in range(len(key)):
        v = find_voxel(table, keys, key[i])
        oldest[v] = min(oldest[v], t_ns[i])


class Deferred:
    """The points that wait, of each voxel no more than could stay. Order and batching of what is added mean nothing."""

    def __init__(self, edge_m: float, cap: int) -> None:
        self._waiting = VoxelStore(edge_m, cap, 16)
        self._oldest: I64 = np.zeros(0, np.int64)

    def __len__(self) -> int:
        return self._waiting.kept

    def age_s(self, newest_ns: int) -> float:
        """How long the oldest point has waited, by the time of the data (s)."""
        return (newest_ns - min(int(self._oldest.min(initial=NEVER)), newest_ns)) * 1e-9

    def add(self, points: Candidates) -> None:
        """These wait too."""
        w = self._waiting
        w.insert(points)
        self._oldest = np.concatenate([self._oldest, np.full(w.used - len(self._oldest), NEVER)])
        note_oldest(points.key, points.t_ns, w.keys, w.table, self._oldest)

    def take(self, store: VoxelStore, most: int | None, newest_ns: int) -> Candidates:
        """Points whose turn it is: all of them, or as many tiles as refit about ``most`` voxels."""
        w = self._waiting
        voxels = np.flatnonzero(w.count[: w.used])
        voxels = voxels[np.argsort(w.keys[voxels])]
        if most is not None and len(voxels):
            voxels = voxels[self._turn(store, voxels, most, newest_ns)]
        count = w.count[voxels]
        slots = np.repeat(voxels * w.cap - np.cumsum(count) + count, count) + np.arange(int(count.sum()))
        points = Candidates(
            np.repeat(w.keys[voxels], count), w.hashes[slots], w.t_ns[slots], w.ring[slots], w.r[slots], w.C[slots], w.aux[slots]
        )  # fmt: skip
        w.count[voxels], self._oldest[voxels] = 0, NEVER
        return points

    def _turn(self, store: VoxelStore, voxels: I64, most: int, newest_ns: int) -> Bool:
        """Which of these voxels (n,), in order of their keys, lie in tiles whose turn it is."""
        key, new = self._waiting.keys[voxels], self._waiting.count[voxels]
        tiles, tile = np.unique(tile_of(key), return_inverse=True)
        oldest = np.full(len(tiles), newest_ns)
        np.minimum.at(oldest, tile, self._oldest[voxels])
        exchanged = np.bincount(tile, weights=shares(store, key, new))
        by_age, by_weight = (np.argsort(np.argsort(x, kind="stable"), kind="stable") for x in (oldest, -exchanged))
        order = np.argsort(np.minimum(2 * by_age, 2 * by_weight + 1), kind="stable")
        rank = np.empty(len(order), np.int64)
        rank[order] = np.arange(len(order))
        by_turn = np.argsort(rank[tile], kind="stable")
        start = np.concatenate([[0], np.cumsum(np.bincount(tile)[order])])
        marked = np.zeros(max(store.used, 1), np.bool_)
        chosen: Bool = rank[tile] < tiles_within(start, key[by_turn], store.keys, store.table, most, marked)
        return chosen


def shares(store: VoxelStore, voxels: I64, new: I64 | I32) -> F64:
    """Which share of a voxel's points (n,) would be new ones, at most, if all ``new`` (n,) of its points were taken in."""
    held = np.zeros(len(voxels), np.int64)
    held_in(voxels, store.keys, store.table, store.count, held)
    out: F64 = new / np.minimum(held + new, store.cap)
    return out
