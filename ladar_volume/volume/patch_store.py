"""The current filtered surface, kept from updates: patches and points by patch key, in canonical order.

What is stored depends only on the union of the updates, not on their history, so a streamed and a batch estimate are bit-identical.
"""

from __future__ import annotations

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


def join_patches(a: Patches, b: Patches) -> Patches:
    """The rows of both."""
    changes = {name: np.concatenate([getattr(a, name), getattr(b, name)]) for name in (*ROWS, "cross_key", "cross", "nav_bin", "M_nav")}
    return Patches(
        **changes,
        cross_start=np.concatenate([a.cross_start, a.cross_start[-1] + b.cross_start[1:]]),
        nav_start=np.concatenate([a.nav_start, a.nav_start[-1] + b.nav_start[1:]]),
    )


def points_finite(points: FilteredPoints) -> Bool:
    """Points (n,) whose every number is finite."""
    numbers: tuple[F64, ...] = (points.r_map, points.normal, points.local)
    out: Bool = np.isfinite(points.variance) & np.isfinite(points.C_tangent).all(axis=1)
    for array in numbers:
        out = out & np.isfinite(array).all(axis=1)
    return out


class PatchStore:
    """Patches sorted by key and points sorted by patch, then position."""

    def __init__(self) -> None:
        self.patches: Patches | None = None
        self.points: FilteredPoints | None = None
        self.losses = Losses()

    def replace(self, update: FilterUpdate) -> None:
        """Forget what the update removes or replaces, then add its patches and points."""
        gone = np.union1d(update.removed, update.patches.key)
        order = np.argsort(update.patches.key, kind="stable")
        new = take_patches(update.patches, order)
        points = self._usable(update.points, new.key)
        if self.patches is not None and self.points is not None:
            kept = take_patches(self.patches, np.flatnonzero(~np.isin(self.patches.key, gone)))
            new = join_patches(kept, new)
            new = take_patches(new, np.argsort(new.key, kind="stable"))
            points = concatenate([select(self.points, ~np.isin(self.points.patch, gone)), points])
        r = points.r_map
        self.points = select(points, np.lexsort((r[:, 2], r[:, 1], r[:, 0], points.patch)))
        self.patches = new

    def _usable(self, points: FilteredPoints, keys: I64) -> FilteredPoints:
        finite = points_finite(points)
        owned = np.isin(points.patch, keys)
        self.losses.add("point_nan", int(np.count_nonzero(~finite)))
        self.losses.add("point_without_patch", int(np.count_nonzero(finite & ~owned)))
        return select(points, finite & owned)
