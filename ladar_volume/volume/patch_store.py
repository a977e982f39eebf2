"""The current filtered surface, kept from updates: patches and points by patch key, in canonical order.

What is stored depends only on the union of the updates, not on their history, so a streamed and a batch estimate are bit-identical.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from ladar_volume.model.losses import Losses
from ladar_volume.model.records import F64, I64, Bool, FilteredPoints, FilterUpdate, Patches, concatenate, select

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


def join_patches(parts: list[Patches]) -> Patches:
    """The rows of all parts, one after the other. A part without rows has no columns of its own to match."""
    parts = [part for part in parts if len(part)] or parts[:1]
    rows = (*ROWS, "cross_key", "cross", "nav_bin", "M_nav")
    changes = {name: np.concatenate([getattr(part, name) for part in parts]) for name in rows}
    for name in ("cross_start", "nav_start"):
        counts = np.concatenate([np.diff(getattr(part, name)) for part in parts])
        changes[name] = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    return Patches(**changes)


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
        """The last word on every patch counts: its update's rows stay, all earlier ones go."""
        if not self._pending:
            return
        patches = [update.patches for update in self._pending]
        points = [update.points for update in self._pending]
        words = [np.union1d(update.removed, update.patches.key) for update in self._pending]
        if self._patches is not None and self._points is not None:
            patches, points, words = [self._patches, *patches], [self._points, *points], [self._patches.key, *words]
        self._pending = []
        keys, turn = np.concatenate(words), _turns(words)
        order = np.lexsort((turn, keys))
        last = order[np.append(keys[order][1:] != keys[order][:-1], True)] if len(keys) else order
        keys, turn = keys[last], turn[last]

        def stays(parts: list[I64]) -> I64:
            key = np.concatenate(parts)
            out: I64 = np.flatnonzero(turn[np.searchsorted(keys, key)] == _turns(parts))
            return out

        rows = stays([part.key for part in patches])
        joined = join_patches(patches)
        self._patches = take_patches(joined, rows[np.argsort(joined.key[rows], kind="stable")])
        kept = select(concatenate(points), stays([part.patch for part in points]))
        r = kept.r_map
        self._points = select(kept, np.lexsort((r[:, 2], r[:, 1], r[:, 0], kept.patch)))

    def _usable(self, points: FilteredPoints, keys: I64) -> FilteredPoints:
        finite = points_finite(points)
        owned = np.isin(points.patch, keys)
        self.losses.add("point_nan", int(np.count_nonzero(~finite)))
        self.losses.add("point_without_patch", int(np.count_nonzero(finite & ~owned)))
        return select(points, finite & owned)


def _turns(parts: list[I64]) -> I64:
    """For every entry of the parts, one after the other, the number of its part."""
    return np.repeat(np.arange(len(parts)), [len(part) for part in parts])
