"""Rows and blocks of several updates as one: the compiled passes of ``patch_store``."""

from __future__ import annotations

from typing import Any

import numpy as np

from ladar_volume.model.kernels import kernel


@kernel
def copy_rows(part: Any, rows: Any, first: Any, out: Any) -> None:
    """Rows (k,) of a part (n, c) whose first row has the number ``first``, to out (k, c); those of other parts stay."""
    for k in range(len(rows)):
        i = rows[k] - first
        if 0 <= i < len(part):
            for c in range(part.shape[1]):
                out[k, c] = part[i, c]


@kernel
def place_of(keys: Any, key: Any, hint: Any) -> Any:
    """Place of a key among ascending ones, -1 where it is not there. ``hint`` : that of the key before it, which is often next to it."""
    if hint + 1 < len(keys) and keys[hint + 1] == key:
        return hint + 1
    i = np.searchsorted(keys, key)
    return i if i < len(keys) and keys[i] == key else -1


@kernel
def block_rows(own: Any, start: Any, other: Any, turn: Any, said: Any, last: Any, keys: Any, row: Any, count: Any) -> None:
    """Row among ``keys`` of each block of one part, -1 for one that no longer holds; ``count`` (rows,) grows by those that do.

    own : (m,) keys of the part's patches · start, other : its blocks in CSR form · said, last : patches ever named and the turns of the
    last word on them
    """
    for i in range(len(own)):
        mine, hint = last[place_of(said, own[i], -1)], -1
        for e in range(start[i], start[i + 1]):
            hint = place_of(said, other[e], hint)
            row[e] = -1
            if turn == max(mine, last[hint] if hint >= 0 else -1):
                k = place_of(keys, min(own[i], other[e]), -1)
                row[e] = k if k >= 0 else place_of(keys, own[i], -1)  # a block with a patch that never came stays where it was
                if row[e] >= 0:
                    count[row[e]] += 1


@kernel
def place_blocks(
    own: Any, start: Any, other: Any, row: Any, number: Any, keys: Any, first: Any, filled: Any, key: Any, entry: Any
) -> None:
    """Put each block of one part into its row, by the key of the row's other patch: that to ``key``, the block's number to ``entry``.

    number : of the part's first block among all parts · first, filled : (rows,) begin of each row and how many it holds so far
    """
    for i in range(len(own)):
        for e in range(start[i], start[i + 1]):
            k = row[e]
            if k < 0:
                continue
            high = other[e] if keys[k] == own[i] else own[i]
            m = first[k] + filled[k]
            filled[k] += 1
            while m > first[k] and key[m - 1] > high:
                key[m], entry[m] = key[m - 1], entry[m - 1]
                m -= 1
            key[m], entry[m] = high, number + e
