"""The current filtered surface, kept from updates: patches and points by patch key, in canonical
order.

What is stored depends only on the union of the updates, not on their history, so a streamed and a
batch estimate are bit-identical. Covariances and sensitivities are held in few bits (see
``packing``).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ladar_volume.model.losses import Losses
from ladar_volume.model.records import (
    F64,
    I64,
    Bool,
    FilteredPoints,
    FilterUpdate,
    HeldPatches,
    select,
)
from ladar_volume.uncertainty.packing import block_kernel, prepare_patches
from ladar_volume.uncertainty.patch_merge import (
    PartBlocks,
    block_rows,
    copy_rows,
    keeps_order,
    move_rows,
    place_blocks,
    sort_runs,
)

#: Patches that wait to be merged, of whole updates, from which on they are, whether or not somebody
#: looks: 7 kB and more of each wait.
PENDING = 4000
ROWS = ("key", "centre", "normal", "tangent", "beta", "sigma", "used", "t_ns", "M_cal")
HELD = ("factor", "nav_unit", "M_beam", "beam_unit", "beam_residual", "own_residual")


def ragged_index(start: I64, rows: I64) -> I64:
    """Indices of the entries of chosen CSR rows, in the order of ``rows``. start : (m + 1,)."""
    count = start[rows + 1] - start[rows]
    first = np.repeat(start[rows] - np.concatenate([[0], np.cumsum(count)[:-1]]), count)
    out: I64 = first + np.arange(int(count.sum()), dtype=np.int64)
    return out


def select_rows(parts: list[Any], rows: I64) -> Any:
    """Rows of arrays, each at most once, as if these were one after the other. A part without rows
    has no columns of its own to match. The list is used up. The first part becomes the result, with
    its rows moved in place, where they stay in order and nobody else has a hold of it: a large
    surface is not copied for the few patches of an update.
    """
    parts[:] = [part for part in parts if len(part)] or parts[:1]
    if len(parts) == 1:
        return parts[0][rows]
    to = np.full(sum(len(part) for part in parts), -1, np.int64)
    to[rows] = np.arange(len(rows))
    parts.reverse()
    out = parts.pop()
    count, shape = len(out), out.shape[1:]
    in_place = out.flags.c_contiguous and keeps_order(to[:count])
    if in_place:
        try:
            out.resize(
                (max(count, len(rows)) + 1, *shape)
            )  # refused where others refer to it, as it is larger than before
        except ValueError:
            in_place = False
    if in_place:
        move_rows(*hash_words(out), to[:count])
    else:
        parts.append(out)
        out = np.empty((len(rows), *shape), out.dtype)
    first = count if in_place else 0
    while parts:
        part = np.ascontiguousarray(parts.pop(), out.dtype)
        copy_rows(hash_words(part)[0], to[first : first + len(part)], *hash_words(out)[::-1])
        first += len(part)
    out.resize((len(rows), *shape), refcheck=False)
    return out


def hash_words(array: npt.NDArray[np.generic]) -> tuple[Any, int]:
    """The numbers of an array one after the other, up to eight bytes at a time as its rows allow
    it, and how many make a row.
    """
    size = math.prod(array.shape[1:]) * array.itemsize
    word = math.gcd(size, 8)
    return array.reshape(-1).view(f"i{word}"), size // word


def points_finite(points: FilteredPoints) -> Bool:
    """Points (n,) whose every number is finite."""
    numbers: tuple[F64, ...] = (points.r_map, points.normal, points.local)
    out: Bool = np.isfinite(points.variance) & np.isfinite(points.C_tangent).all(axis=1)
    for array in numbers:
        out = out & np.isfinite(array).all(axis=1)
    return out


def usable_points(points: FilteredPoints, keys: I64, losses: Losses) -> FilteredPoints:
    """Finite points on patches with keys (m,); the others are counted as losses."""
    finite = points_finite(points)
    owned = np.isin(points.patch, keys)
    losses.add("point_nan", int(np.count_nonzero(~finite)))
    losses.add("point_without_patch", int(np.count_nonzero(finite & ~owned)))
    return select(points, finite & owned)


class HeldUpdate(NamedTuple):
    """An update that waits to be merged: as :class:`FilterUpdate`, its patches as they are held."""

    removed: I64
    points: FilteredPoints
    patches: HeldPatches
    complete: bool


class PatchStore:
    """Patches sorted by key and points sorted by patch, then position.

    Updates are only collected as they come and merged in one go when somebody looks, or when they
    are many: an update in thirty messages costs one merge.
    """

    def __init__(self) -> None:
        self._patches: HeldPatches | None = None
        self._points: FilteredPoints | None = None
        self._pending: list[HeldUpdate] = []
        self.losses = Losses()

    @property
    def patches(self) -> HeldPatches | None:
        """All patches as they stand."""
        self._merge()
        return self._patches

    @property
    def points(self) -> FilteredPoints | None:
        """All points as they stand."""
        self._merge()
        return self._points

    def hold(self, points: FilteredPoints, patches: HeldPatches) -> None:
        """Take a whole surface, by key, in place of what there is."""
        self._pending, self._points, self._patches = [], points, patches

    def replace(self, update: FilterUpdate) -> None:
        """Forget what the update removes or replaces, then add its patches and points."""
        points = usable_points(update.points, update.patches.key, self.losses)
        held = prepare_patches(update.patches)
        self._pending.append(HeldUpdate(update.removed, points, held, update.complete))
        if update.complete and sum(len(pending.patches) for pending in self._pending) > PENDING:
            self._merge()

    def _merge(self) -> None:
        """The last word on every patch counts: its update's rows stay, all earlier ones go. A cross
        block is as new as the newer of its two patches.
        """
        if not self._pending:
            return
        updates, turn, turns = self._pending, 1, []
        for update in updates:
            turns.append(turn)
            turn += update.complete
        if self._patches is not None and self._points is not None:
            updates, turns = (
                [HeldUpdate(np.zeros(0, np.int64), self._points, self._patches, True), *updates],
                [0, *turns],
            )
        words = [np.union1d(update.removed, update.patches.key) for update in updates]
        last = LatestUpdate(words, turns)
        points, patches = (
            Parts([update.points for update in updates]),
            Parts([update.patches for update in updates]),
        )
        self._pending, self._points, self._patches = (
            [],
            None,
            None,
        )  # old and new are held together only array by array
        del updates
        self._points = merged_points(points, turns, last)
        self._patches = merged_patches(patches, turns, last)


class LatestUpdate:
    """Which update was the last to say anything of a patch. keys, turns : of the patches ever
    named, ascending, then one that is none.
    """

    def __init__(self, words: list[I64], turns: list[int]) -> None:
        """words : keys of the patches that each update names · turns : number of each, rising;
        parts of one have the same.
        """
        keys, turn = np.concatenate(words), np.repeat(turns, [len(word) for word in words])
        order = np.lexsort((turn, keys))
        last = order[np.append(keys[order][1:] != keys[order][:-1], True)] if len(keys) else order
        self.keys, self.turns = (
            np.append(keys[last], np.iinfo(np.int64).max),
            np.append(turn[last], -1),
        )

    def turn(self, key: I64) -> I64:
        """Number (n,) of the last update for keys (n,), -1 where there was none."""
        at = np.searchsorted(self.keys, key)
        return np.where(self.keys[at] == key, self.turns[at], -1)


class Parts:
    """Several records' arrays by name. What was taken is held here no longer."""

    def __init__(self, records: Sequence[Any]) -> None:
        self.rows = [len(record) for record in records]
        self._held = [dict(vars(record)) for record in records]

    def see(self, name: str) -> list[Any]:
        """An array of each."""
        return [held[name] for held in self._held]

    def take(self, name: str) -> list[Any]:
        """The same for the last time."""
        return [held.pop(name) for held in self._held]


def merged_points(parts: Parts, turns: list[int], last: LatestUpdate) -> FilteredPoints:
    """The points that hold, by patch, then position."""
    patch, r = np.concatenate(parts.see("patch")), np.concatenate(parts.see("r_map"))
    chosen = np.flatnonzero(last.turn(patch) == np.repeat(turns, parts.rows))
    order = chosen[np.argsort(patch[chosen], kind="stable")]
    sort_runs(patch, r, order)
    del patch, r
    return FilteredPoints(
        **{
            field.name: select_rows(parts.take(field.name), order)
            for field in dataclasses.fields(FilteredPoints)
        }
    )


def merged_patches(parts: Parts, turns: list[int], last: LatestUpdate) -> HeldPatches:
    """The patches that hold, by key, with their blocks by the lower key of their pair and then the
    other, and their bins.
    """
    key = np.concatenate(parts.see("key"))
    rows = np.flatnonzero(last.turn(key) == np.repeat(turns, parts.rows))
    rows = rows[np.argsort(key[rows], kind="stable")]
    keys, own, starts, others = (
        key[rows],
        parts.see("key"),
        parts.take("cross_start"),
        parts.take("cross_key"),
    )
    made: dict[str, Any] = {name: select_rows(parts.take(name), rows) for name in (*ROWS, *HELD)}
    made["cross_start"], made["cross_key"], entry = block_entries(
        own, starts, others, turns, last, keys
    )
    blocks, cross = [], parts.take("cross")[::-1]
    for mine, start, other in zip(own, starts, others, strict=True):
        new = cross.pop()
        blocks.append(
            new
            if new.dtype == np.int8
            else block_kernel(mine, start, other, new, keys, made["factor"])
        )
    del new
    made["cross"] = select_rows(blocks, entry)
    starts = parts.take("nav_start")
    bins = np.concatenate(
        [[0], np.cumsum(np.concatenate([np.diff(start) for start in starts]))]
    ).astype(np.int64)
    made["nav_start"] = np.concatenate([[0], np.cumsum((bins[1:] - bins[:-1])[rows])]).astype(
        np.int64
    )
    entry = ragged_index(bins, rows)
    for name in ("nav_bin", "M_nav", "nav_residual"):
        made[name] = select_rows(parts.take(name), entry)
    return HeldPatches(**made)


def block_entries(
    own: list[I64],
    start: list[I64],
    other: list[I64],
    turns: list[int],
    last: LatestUpdate,
    keys: I64,
) -> tuple[I64, I64, I64]:
    """The cross blocks that hold, by the lower key of their pair and then the other, for patches of
    keys (m,): start (m + 1,), the other key of each and its number among the blocks of all parts.
    own, start, other : of each part, the keys of its patches and their blocks in CSR form.
    """
    rows = [np.empty(len(keys_there), np.int64) for keys_there in other]
    count = np.zeros(len(keys), np.int64)
    for mine, first, theirs, turn, row in zip(own, start, other, turns, rows, strict=True):
        part = PartBlocks(mine, first, theirs)
        block_rows(part, turn, last.keys, last.turns, keys, row, count)
    begin = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    key, entry, filled, number = (
        np.empty(begin[-1], np.int64),
        np.empty(begin[-1], np.int64),
        np.zeros(len(keys), np.int64),
        0,
    )
    for mine, first, theirs, row in zip(own, start, other, rows, strict=True):
        part = PartBlocks(mine, first, theirs)
        place_blocks(part, row, number, keys, begin, filled, key, entry)
        number += len(row)
    return begin, key, entry
