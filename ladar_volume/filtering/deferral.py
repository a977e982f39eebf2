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
from ladar_volume.filtering.store import AUX, Candidates, VoxelStore, find_voxel, pack_key, unpack_key, voxels_around
from ladar_volume.model.kernels import kernel
from ladar_volume.model.records import F64, I64, concatenate, select

#: Voxels along the side of a tile, as a power of two.
TILE_BITS = 3
#: Points that may wait, beside twice as many as could stay when last looked at, before those that cannot stay are looked for.
ROOM = 1 << 16


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


class Deferred:
    """The points that wait. Order and batching of what is added mean nothing."""

    def __init__(self) -> None:
        self._parts: list[Candidates] = []
        self._left = 0

    def __len__(self) -> int:
        return sum(len(part) for part in self._parts)

    def age_s(self, newest_ns: int) -> float:
        """How long the oldest point has waited, by the time of the data (s)."""
        return max((newest_ns - int(part.t_ns.min()) for part in self._parts if len(part)), default=0) * 1e-9

    def add(self, points: Candidates) -> None:
        """These wait too."""
        if len(points):
            self._parts.append(points)

    def take(self, store: VoxelStore, most: int | None, newest_ns: int) -> Candidates:
        """Points whose turn it is: all of them, or as many tiles as refit about ``most`` voxels."""
        points = concatenate(self._parts) if self._parts else nothing()
        if most is None or len(points) == 0:
            self._parts = []
            return points
        if len(points) > 2 * self._left + ROOM:
            points = lowest(points, store.cap)
            self._left = len(points)
        chosen = np.isin(tile_of(points.key), self._next_tiles(store, points, most, newest_ns))
        self._parts = [select(points, ~chosen)] if not chosen.all() else []
        return select(points, chosen)

    def _next_tiles(self, store: VoxelStore, points: Candidates, most: int, newest_ns: int) -> I64:
        voxels, which, new = np.unique(points.key, return_inverse=True, return_counts=True)
        tiles, tile = np.unique(tile_of(voxels), return_inverse=True)
        oldest = np.full(len(tiles), newest_ns)
        np.minimum.at(oldest, tile[which], points.t_ns)
        exchanged = np.bincount(tile, weights=shares(store, voxels, new))
        by_age, by_weight = (np.argsort(np.argsort(x, kind="stable"), kind="stable") for x in (oldest, -exchanged))
        order = np.argsort(np.minimum(2 * by_age, 2 * by_weight + 1), kind="stable")
        rank = np.empty(len(order), np.int64)
        rank[order] = np.arange(len(order))
        by_turn = np.argsort(rank[tile], kind="stable")
        start = np.concatenate([[0], np.cumsum(np.bincount(tile)[order])])
        marked = np.zeros(max(store.used, 1), np.bool_)
        return tiles[order[: tiles_within(start, voxels[by_turn], store.keys, store.table, most, marked)]]


def shares(store: VoxelStore, voxels: I64, new: I64) -> F64:
    """Which share of a voxel's points (n,) would be new ones, at most, if all ``new`` (n,) of its points were taken in."""
    held = np.zeros(len(voxels), np.int64)
    held_in(voxels, store.keys, store.table, store.count, held)
    coming = np.minimum(new, store.cap)
    out: F64 = coming / np.minimum(held + coming, store.cap)
    return out


def lowest(points: Candidates, cap: int) -> Candidates:
    """Without those that other points of their voxel leave no room for."""
    order = np.lexsort((points.hash, points.key))
    key = points.key[order]
    rank = np.arange(len(key)) - np.searchsorted(key, key)
    return select(points, np.sort(order[rank < cap]))


def nothing() -> Candidates:
    """No points."""
    return Candidates(
        np.zeros(0, np.int64), np.zeros(0, np.uint64), np.zeros(0, np.int64), np.zeros(0, np.uint16), np.zeros((0, 3)),
        np.zeros((0, 6), np.float32), np.zeros((0, AUX), np.float32),
    )  # fmt: skip
