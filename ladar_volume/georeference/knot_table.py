"""A growing table of knots in time: columns of one length, appended at the end, forgotten at the
front.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ladar_volume.model.records import F64, I64


class Knots:
    """Times ``t_ns`` (n,) int64, an integer ``tag`` (n,) and float columns of given row shapes.

    Appending is amortised O(1). When more than ``2 limit`` knots are held, all but the newest
    ``limit`` are forgotten; where there is no room for one more, those older than ``keep_ns``
    before it are, if they are half of all.
    """

    def __init__(self, limit: int, keep_ns: int, **shapes: tuple[int, ...]) -> None:
        self._limit, self._keep_ns = limit, keep_ns
        self._size = 0
        self._capacity = 64
        self._columns: dict[str, np.ndarray[Any, Any]] = {
            name: np.zeros((self._capacity, *shape)) for name, shape in shapes.items()
        }
        self._columns["t_ns"] = np.zeros(self._capacity, np.int64)
        self._columns["tag"] = np.zeros(self._capacity, np.int64)

    def __len__(self) -> int:
        return self._size

    @property
    def t_ns(self) -> I64:
        """Times (n,), ns, strictly increasing."""
        return self._columns["t_ns"][: self._size]

    @property
    def tag(self) -> I64:
        """The integer column (n,), writable."""
        return self._columns["tag"][: self._size]

    def __getitem__(self, name: str) -> F64:
        """A float column (n, ...), writable."""
        return self._columns[name][: self._size]

    def append(self, t_ns: int, tag: int, **values: Any) -> int:
        """Add one knot; returns how many old ones were forgotten for it."""
        forgotten = self._make_room(t_ns)
        self._columns["t_ns"][self._size] = t_ns
        self._columns["tag"][self._size] = tag
        for name, value in values.items():
            self._columns[name][self._size] = value
        self._size += 1
        return forgotten

    def _make_room(self, t_ns: int) -> int:
        drop = self._size - self._limit if self._size >= 2 * self._limit else 0
        if self._size == self._capacity:
            old = int(np.searchsorted(self.t_ns, t_ns - self._keep_ns))
            drop = max(drop, old if 2 * old >= self._size else 0)
        if drop:
            for column in self._columns.values():
                column[: self._size - drop] = column[drop : self._size].copy()
            self._size -= drop
            return drop
        if self._size == self._capacity:
            self._capacity *= 2
            for name, column in self._columns.items():
                self._columns[name] = np.concatenate([column, np.zeros_like(column)])
        return 0
