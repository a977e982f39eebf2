"""Rows and blocks of several updates as one: the compiled passes of ``patch_store``."""

from __future__ import annotations

from typing import Any, NamedTuple

from ladar_volume.math.array_types import F64, I32, I64
from ladar_volume.math.kernels import kernel, leaf_kernel


class PartBlocks(NamedTuple):
    """Blocks of one part. own : (m,) keys of its patches · start, other : its blocks in CSR form,
    by the key of the other patch
    """

    own: I64
    start: I64
    other: I64


@kernel
def copy_rows(part: I64 | I32, to: I64, width: int, out: I64 | I32) -> None:
    """Rows of a part, c numbers each, to those of out that ``to`` (n,) says, -1 for none; part and
    out are flat.
    """
    i, n = 0, len(to)
    while i < n:
        first, i = i, i + 1
        if to[first] >= 0:
            while i < n and to[i] == to[i - 1] + 1:  # what stays together is moved in one piece
                i += 1
            source, target = (
                part[first * width : i * width],
                out[to[first] * width : to[first] * width + (i - first) * width],
            )
            for k in range(len(source)):
                target[k] = source[k]


@kernel
def keeps_order(to: I64) -> Any:
    """Whether the rows that stay, those of ``to`` (n,) that are not -1, do so in their order."""
    last = -1
    for row in to:
        if row >= 0:
            if row < last:
                return False
            last = row
    return True


@kernel
def move_rows(part: I64 | I32, width: int, to: I64) -> None:
    """Rows of a flat array, c numbers each, in place to those that ``to`` (n,) says, -1 for none,
    which are in order: those that move to the right from the last, then those that move to the left
    from the first. So none is written over before it has moved.
    """
    for i in range(len(to) - 1, -1, -1):
        if to[i] > i:
            for k in range(width - 1, -1, -1):
                part[to[i] * width + k] = part[i * width + k]
    for i in range(len(to)):
        if 0 <= to[i] < i:
            for k in range(width):
                part[to[i] * width + k] = part[i * width + k]


@leaf_kernel
def place_from(keys: I64, key: int, hint: int) -> Any:
    """Number of ascending keys below a key. ``hint`` : that number for the key before it, which is
    often next to it.
    """
    low = hint if hint < len(keys) and keys[hint] <= key else 0
    high, step = low, 1
    while high < len(keys) and keys[high] < key:
        low, high, step = high, high + step, 2 * step
    high = min(high, len(keys))
    while low < high:
        middle = (low + high) // 2
        if keys[middle] < key:
            low = middle + 1
        else:
            high = middle
    return low


@leaf_kernel
def has_key(keys: I64, key: int, place: int) -> Any:
    """Whether ascending keys hold a key, given its :func:`place_from`."""
    return place < len(keys) and keys[place] == key


@kernel
def block_rows(
    part: PartBlocks, turn: int, said: I64, last: I64, keys: I64, row: I64, count: I64
) -> None:
    """Row among ``keys`` of each block of one part, -1 for one that no longer holds; ``count``
    (rows,) grows by those that do.

    said, last : patches ever named and the turns of the last word on them
    """
    own, start, other = part.own, part.start, part.other
    spoken, at = 0, 0
    for i in range(len(own)):
        spoken, at = place_from(said, own[i], spoken), place_from(keys, own[i], at)
        mine = last[spoken] if has_key(said, own[i], spoken) else -1
        here = at if has_key(keys, own[i], at) else -1
        hint, below = 0, 0
        for e in range(start[i], start[i + 1]):
            hint = place_from(said, other[e], hint)
            row[e] = -1
            if turn == max(mine, last[hint] if has_key(said, other[e], hint) else -1):
                row[e] = here  # also that of a block with a patch of a lower key that never came
                if other[e] < own[i]:
                    below = place_from(keys, other[e], below)
                    row[e] = below if has_key(keys, other[e], below) else here
                if row[e] >= 0:
                    count[row[e]] += 1


@kernel
def place_blocks(
    part: PartBlocks,
    row: I64,
    number: int,
    keys: I64,
    first: I64,
    filled: I64,
    key: I64,
    entry: I64,
) -> None:
    """Put each block of one part into its row, by the key of the row's other patch: that to
    ``key``, the block's number to ``entry``.

    number : of the part's first block among all parts · first, filled : (rows,) begin of each row
    and how many it holds so far
    """
    own, start, other = part.own, part.start, part.other
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


@leaf_kernel
def precedes(r: F64, i: int, j: int) -> Any:
    """Whether point i comes before point j: by x, y and z, then by number."""
    for c in range(3):
        if r[i, c] != r[j, c]:
            return r[i, c] < r[j, c]
    return i < j


@kernel
def sort_runs(patch: I64, r: F64, order: I64) -> None:
    """Put points ``order`` (k,), which lie together by patch, in order of their positions r (n, 3)
    within each patch.
    """
    first = 0
    while first < len(order):
        end = first + 1
        while end < len(order) and patch[order[end]] == patch[order[first]]:
            end += 1
        gap = 1
        while gap < (end - first) // 3:
            gap = 3 * gap + 1
        while gap > 0:  # Shell's method
            for k in range(first + gap, end):
                one, m = order[k], k
                while m >= first + gap and precedes(r, one, order[m - gap]):
                    order[m] = order[m - gap]
                    m -= gap
                order[m] = one
            gap //= 3
        first = end
