"""The fits of all voxels, kept from update to update: what new points did not reach need not be fitted, sent nor stored again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ladar_volume.filtering.fit import OK
from ladar_volume.model.kernels import kernel
from ladar_volume.model.records import F64, I32, I64, Bool

#: Numbers of one fit.
COLUMNS = ("status", "used", "sigma", "time", "centre", "normal", "tangent", "beta", "inverse")


@dataclass
class Fits:
    """Fits by row; the slots of row a's inliers are ``members[start[a] : start[a] + used[a]]``, in canonical order.

    voxels : (m,) index of each row's voxel · status : see ``fit`` · sigma : (m,) m · time : (m,) mean time, ns · centre, normal, tangent :
    (m, 3) · beta : (m, 6) · inverse : (m, 6, 6) of the normal matrix
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


def blank(voxels: I64, start: I64, members: I32, status: int = OK) -> Fits:
    """Rows (m,) to be filled."""
    m = len(voxels)
    return Fits(
        voxels, start, members, np.zeros(m, np.int64), np.full(m, status, np.int64), np.zeros(m), np.zeros(m, np.int64), np.zeros((m, 3)),
        np.zeros((m, 3)), np.zeros((m, 3)), np.zeros((m, 6)), np.zeros((m, 6, 6)),
    )  # fmt: skip


@kernel
def same_members(
    voxels: Any, start: Any, used: Any, members: Any, old_start: Any, old_used: Any, old_members: Any, fresh: Any, cap: Any, same: Any,
    own: Any,
) -> None:  # fmt: skip
    """Whether the inliers of each row are those kept for its voxel, none of them ``fresh``; ``own`` : how many lie in the voxel itself."""
    for a in range(len(voxels)):
        v = voxels[a]
        same[a], own[a] = used[a] == old_used[v], 0
        for i in range(used[a]):
            slot = members[start[a] + i]
            own[a] += slot // cap == v
            same[a] = same[a] and not fresh[slot] and slot == old_members[old_start[v] + i]


@kernel
def move_members(rows: Any, start: Any, used: Any, members: Any, to: Any, new: Any) -> None:
    """Copy the inliers of chosen rows to ``new``, from ``to[k]`` on for the k-th."""
    for k in range(len(rows)):
        for i in range(used[rows[k]]):
            new[to[k] + i] = members[start[rows[k]] + i]


class FitStore:
    """One row per voxel of a store, by voxel index. The inliers' slots lie in one pool: a fit that needs more room than it had moves to
    its end, and the pool is made anew when that is reached."""

    def __init__(self, never: int) -> None:
        """never : status of voxels that have not been fitted yet."""
        self._never = never
        self._room: I64 = np.zeros(0, np.int64)
        self._end = 0
        self.fits = blank(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, np.int32))

    def grow(self, voxels: int) -> None:
        """Make rows for new voxels."""
        more = voxels - len(self.fits.voxels)
        if more > 0:
            new = blank(np.arange(voxels - more, voxels), np.zeros(more, np.int64), np.zeros(0, np.int32), self._never)
            for name in ("voxels", "start", *COLUMNS):
                setattr(self.fits, name, np.concatenate([getattr(self.fits, name), getattr(new, name)]))
            self._room = np.concatenate([self._room, np.zeros(more, np.int64)])

    def keep(self, found: Fits, fresh: Bool, cap: int) -> tuple[Bool, I64]:
        """Take over fits; returns which of them are new (m,), by any number or any inlier, and how many inliers (m,) lie in the voxel.

        fresh : slots filled since the last update.
        """
        kept, v = self.fits, found.voxels
        same, own = np.zeros(len(v), np.bool_), np.zeros(len(v), np.int64)
        same_members(v, found.start, found.used, found.members, kept.start, kept.used, kept.members, fresh, cap, same, own)
        for name in COLUMNS:
            equal = getattr(found, name) == getattr(kept, name)[v]
            same &= equal.reshape(len(v), -1).all(axis=1)
        same |= (found.status != OK) & (kept.status[v] != OK)
        rows = np.flatnonzero(~same)
        self._place(v[rows], found.used[rows])
        for name in COLUMNS:
            getattr(kept, name)[v[rows]] = getattr(found, name)[rows]
        move_members(rows, found.start, found.used, found.members, kept.start[v[rows]], kept.members)
        return ~same, own

    def _place(self, voxels: I64, wanted: I64) -> None:
        """Room for so many inliers of each of these voxels, whose present ones are no longer needed."""
        kept, room = self.fits, wanted + wanted // 4
        kept.used[voxels] = 0
        tight = wanted > self._room[voxels]
        if self._end + int(room[tight].sum()) > len(kept.members):
            start = np.concatenate([[0], np.cumsum(kept.used)])
            members = np.empty((int(start[-1]) + int(room.sum())) * 3 // 2, np.int32)
            move_members(kept.voxels, kept.start, kept.used, kept.members, start, members)
            kept.start, self._room, self._end, kept.members = start[:-1].copy(), kept.used.copy(), int(start[-1]), members
            tight = wanted > self._room[voxels]
        ends = self._end + np.cumsum(room[tight])
        kept.start[voxels[tight]], self._room[voxels[tight]] = ends - room[tight], room[tight]
        self._end = int(ends[-1]) if len(ends) else self._end
