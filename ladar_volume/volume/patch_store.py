"""The current filtered surface, kept from updates: patches and points by patch key, in canonical order.

What is stored depends only on the union of the updates, not on their history, so a streamed and a batch estimate are bit-identical.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence, Sized
from typing import Any

import numpy as np

from ladar_volume.model.losses import Losses
from ladar_volume.model.records import F64, I64, Bool, FilteredPoints, FilterUpdate, Patches, concatenate, select
from ladar_volume.volume.patch_merge import block_rows, copy_rows, place_blocks, sort_runs

ROWS = ("key", "centre", "normal", "tangent", "beta", "sigma", "used", "t_ns", "M_cal")


def ragged_index(start: I64, rows: I64) -> I64:
    """Indices of the entries of chosen CSR rows, in the order of ``rows``. start : (m + 1,)."""
    count = start[rows + 1] - start[rows]
    first = np.repeat(start[rows] - np.concatenate([[0], np.cumsum(count)[:-1]]), count)
    out: I64 = first + np.arange(int(count.sum()), dtype=np.int64)
    return out


def take_patches(patches: Patches, rows: I64) -> Patches:
    """The chosen rows (k,) of patches, ragged parts included, in that order."""
    cross, nav = ragged_index(patches.cross_start, rows), ragged_index(patches.nav_start, rows)
    changes = {name: getattr(patches, name)[rows] for name in ROWS}
    return Patches(
        **changes,
        cross_start=np.concatenate([[0], np.cumsum(np.diff(patches.cross_start)[rows])]).astype(np.int64),
        cross_key=patches.cross_key[cross],
        cross=patches.cross[cross],
        nav_start=np.concatenate([[0], np.cumsum(np.diff(patches.nav_start)[rows])]).astype(np.int64),
        nav_bin=patches.nav_bin[nav],
        M_nav=patches.M_nav[nav],
    )


def picked(parts: list[Any], rows: I64) -> Any:
    """Rows of arrays, each at most once, as if these were one after the other. A part without rows has no columns of its own to match."""
    parts = [part for part in parts if len(part)] or parts[:1]
    if len(parts) == 1:
        return parts[0][rows]
    out, to = np.empty((len(rows), *parts[0].shape[1:]), parts[0].dtype), np.full(sum(len(part) for part in parts), -1, np.int64)
    to[rows] = np.arange(len(rows))
    width, first = math.prod(parts[0].shape[1:]), 0
    for part in parts:
        copy_rows(np.ascontiguousarray(part, out.dtype).reshape(-1), to[first : first + len(part)], width, out.reshape(-1))
        first += len(part)
    return out


def points_finite(points: FilteredPoints) -> Bool:
    """Points (n,) whose every number is finite."""
    numbers: tuple[F64, ...] = (points.r_map, points.normal, points.local)
    out: Bool = np.isfinite(points.variance) & np.isfinite(points.C_tangent).all(axis=1)
    for array in numbers:
        out = out & np.isfinite(array).all(axis=1)
    return out


class PatchStore:
    """Patches sorted by key and points sorted by patch, then position.

    Updates are only collected as they come and merged in one go when somebody looks: an update in thirty messages costs one merge.
    """

    def __init__(self) -> None:
        self._patches: Patches | None = None
        self._points: FilteredPoints | None = None
        self._pending: list[FilterUpdate] = []
        self.losses = Losses()

    @property
    def patches(self) -> Patches | None:
        """All patches as they stand."""
        self._merge()
        return self._patches

    @property
    def points(self) -> FilteredPoints | None:
        """All points as they stand."""
        self._merge()
        return self._points

    def replace(self, update: FilterUpdate) -> None:
        """Forget what the update removes or replaces, then add its patches and points."""
        self._pending.append(dataclasses.replace(update, points=self._usable(update.points, update.patches.key)))

    def _merge(self) -> None:
        """The last word on every patch counts: its update's rows stay, all earlier ones go. A cross block is as new as the newer of its two
        patches."""
        if not self._pending:
            return
        updates, turn, turns = self._pending, 1, []
        for update in updates:
            turns.append(turn)
            turn += update.complete
        if self._patches is not None and self._points is not None:
            updates, turns = [FilterUpdate(0, np.zeros(0, np.int64), self._points, self._patches), *updates], [0, *turns]
        self._pending = []
        last = LastWord(updates, turns)
        parts = [update.patches for update in updates]
        key = np.concatenate([part.key for part in parts])
        rows = np.flatnonzero(last.turn(key) == _spread(turns, parts))
        rows = rows[np.argsort(key[rows], kind="stable")]
        self._patches = Patches(**merged_rows(parts, rows), **merged_blocks(parts, turns, last, key[rows]), **merged_bins(parts, rows))
        points = concatenate([update.points for update in updates])
        chosen = np.flatnonzero(last.turn(points.patch) == _spread(turns, [update.points for update in updates]))
        order = chosen[np.argsort(points.patch[chosen], kind="stable")]
        sort_runs(points.patch, points.r_map, order)
        self._points = select(points, order)

    def _usable(self, points: FilteredPoints, keys: I64) -> FilteredPoints:
        finite = points_finite(points)
        owned = np.isin(points.patch, keys)
        self.losses.add("point_nan", int(np.count_nonzero(~finite)))
        self.losses.add("point_without_patch", int(np.count_nonzero(finite & ~owned)))
        return select(points, finite & owned)


class LastWord:
    """Which update was the last to say anything of a patch. keys, turns : of the patches ever named, ascending, then one that is none."""

    def __init__(self, updates: list[FilterUpdate], turns: list[int]) -> None:
        """turns : number of each of these updates, rising; parts of one have the same."""
        words = [np.union1d(update.removed, update.patches.key) for update in updates]
        keys, turn = np.concatenate(words), _spread(turns, words)
        order = np.lexsort((turn, keys))
        last = order[np.append(keys[order][1:] != keys[order][:-1], True)] if len(keys) else order
        self.keys, self.turns = np.append(keys[last], np.iinfo(np.int64).max), np.append(turn[last], -1)

    def turn(self, key: I64) -> I64:
        """Number (n,) of the last update for keys (n,), -1 where there was none."""
        at = np.searchsorted(self.keys, key)
        return np.where(self.keys[at] == key, self.turns[at], -1)


def merged_rows(parts: list[Patches], rows: I64) -> dict[str, Any]:
    """The row-wise arrays of patches ``rows`` (k,), counted over all parts."""
    return {name: picked([getattr(part, name) for part in parts], rows) for name in ROWS}


def merged_bins(parts: list[Patches], rows: I64) -> dict[str, Any]:
    """The navigation bins of patches ``rows`` (k,), counted over all parts."""
    start = np.concatenate([[0], np.cumsum(np.concatenate([np.diff(part.nav_start) for part in parts]))]).astype(np.int64)
    entries = ragged_index(start, rows)
    return {
        "nav_start": np.concatenate([[0], np.cumsum((start[1:] - start[:-1])[rows])]).astype(np.int64),
        "nav_bin": picked([part.nav_bin for part in parts], entries), "M_nav": picked([part.M_nav for part in parts], entries),
    }  # fmt: skip


def merged_blocks(parts: list[Patches], turns: list[int], last: LastWord, keys: I64) -> dict[str, Any]:
    """The cross blocks that hold, by the lower key of their pair and then the other, for patches of keys (m,)."""
    rows = [np.empty(len(part.cross_key), np.int64) for part in parts]
    count = np.zeros(len(keys), np.int64)
    for part, turn, row in zip(parts, turns, rows, strict=True):
        block_rows(part.key, part.cross_start, part.cross_key, turn, last.keys, last.turns, keys, row, count)
    start = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    key, entry, filled, number = np.empty(start[-1], np.int64), np.empty(start[-1], np.int64), np.zeros(len(keys), np.int64), 0
    for part, row in zip(parts, rows, strict=True):
        place_blocks(part.key, part.cross_start, part.cross_key, row, number, keys, start, filled, key, entry)
        number += len(row)
    return {"cross_start": start, "cross_key": key, "cross": picked([part.cross for part in parts], entry)}


def _spread(turns: list[int], parts: Sequence[Sized]) -> I64:
    """The number of its part for every row of the parts, one after the other."""
    return np.repeat(np.asarray(turns, np.int64), [len(part) for part in parts])
