"""The returns of a survey that closed bodies are made of, in any order: at most so many to a cell,
those with the lowest hashes.

What is kept depends only on the set of returns, never on their order or batching: a stream gives
the same bodies as a recording, and memory follows the surface (as in ``rmls.voxel_store``).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ladar_volume.math.hashing import splitmix64
from ladar_volume.model.records import F64, I64

#: Most returns of a cell, whose edge is the live filter's radius.
MOST_IN_CELL = 256
#: Returns that wait for the cells to be looked at, and their share of what is held, at least.
WAITING, SHARE = 200_000, 0.25
U64 = npt.NDArray[np.uint64]


def place_hash(r: F64) -> U64:
    """A hash (n,) of places (n, 3)."""
    bits = (np.ascontiguousarray(r, np.float64) + 0.0).view(np.uint64)  # -0.0 is 0.0
    out = np.zeros(len(r), np.uint64)
    for axis in range(3):
        out = splitmix64(out * np.uint64(0x9E3779B97F4A7C15) + bits[:, axis])
    return out


def lowest(r: F64, edge_m: float, most: int) -> F64:
    """The points (n, 3) m that are among the ``most`` lowest hashes of their cell, sorted by place;
    copies count as often as they come.
    """
    cell: I64 = np.floor(r / edge_m).astype(np.int64)
    order = np.lexsort((r[:, 2], r[:, 1], r[:, 0], place_hash(r), *cell.T))
    cell = cell[order]
    begins = np.ones(len(r), bool)
    begins[1:] = (cell[1:] != cell[:-1]).any(axis=1)
    first = np.flatnonzero(begins)
    rank = np.arange(len(r)) - np.repeat(first, np.diff(np.append(first, len(r))))
    kept = r[order[rank < most]]
    out: F64 = kept[np.lexsort(kept.T)]
    return out


class ReturnStore:
    """Returns in the map frame. Feed :meth:`add`; :meth:`returns` depends on their union alone."""

    def __init__(self, edge_m: float, most: int = MOST_IN_CELL) -> None:
        """edge_m : of a cell · most : returns of one"""
        self._edge_m, self._most = edge_m, most
        self._held: F64 = np.zeros((0, 3))
        self._waiting: list[F64] = []
        self._count = 0

    def add(self, r: F64) -> None:
        """Returns (n, 3) m."""
        self._waiting.append(np.array(r, np.float64))
        self._count += len(r)
        if self._count > max(WAITING, SHARE * len(self._held)):
            self.returns()

    def returns(self) -> F64:
        """What is kept (k, 3), sorted by place."""
        if self._waiting:
            self._held = lowest(
                np.concatenate([self._held, *self._waiting]), self._edge_m, self._most
            )
            self._waiting, self._count = [], 0
        return self._held

    def copy(self) -> ReturnStore:
        """What another thread may read while returns are added here."""
        other = ReturnStore(self._edge_m, self._most)
        other._held, other._waiting, other._count = self._held, list(self._waiting), self._count
        return other
