"""Rows of numbers that are equal, found by hashing."""

from __future__ import annotations

import math

import numpy as np

from ladar_volume.math.array_types import F64, I32, I64
from ladar_volume.math.kernels import kernel

#: Least number of slots in the table per row.
ROOM = 2
#: Values that are looked up one by one.
TABLE = 64
#: Odd numbers that spread the bits (Steele, Lea & Flood 2014, "Fast splittable pseudorandom number
#: generators").
GOLDEN, SPREAD = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9)


@kernel
def first_kernel(values: F64, bits: int, known: int) -> I64:
    """See :func:`first_equal`; the table has ``2**bits`` slots."""
    n, d = values.shape
    out, table = np.arange(n), np.full(1 << bits, -1, np.int32)
    row, number = np.empty(1), np.uint64(0)
    whole = row.view(np.uint64)
    for i in range(n):
        key, whole_row = number, True
        for c in range(d):
            row[0] = values[i, c] + 0.0  # -0 is 0
            whole_row = whole_row and row[0] == row[0]
            key = (key ^ whole[0]) * GOLDEN
            key = (key ^ (key >> np.uint64(29))) * SPREAD
        if not whole_row:
            continue
        slot = np.int64(key >> np.uint64(64 - bits))
        while table[slot] >= 0:
            other, same = table[slot], True
            for c in range(d):
                same = same and values[other, c] == values[i, c]
            if same:
                out[i] = other
                break
            slot = (slot + 1) & ((1 << bits) - 1)
        if table[slot] < 0 and i < known:
            table[slot] = i
    return out


def first_equal(values: F64, known: int | None = None) -> I64:
    """For each row (n,) of values (n, d) the first row that is equal to it; a row with NaN equals
    none but itself. known : only the first so many rows are compared with; None for all.
    """
    values = np.ascontiguousarray(values, dtype=np.float64)
    known = len(values) if known is None else known
    return np.asarray(first_kernel(values, max(1, int(ROOM * known).bit_length()), known))


def distinct_rows(values: F64) -> I64:
    """Rows (k,), ascending, of values (n, d): the first of those that are equal."""
    return np.flatnonzero(first_equal(values) == np.arange(len(values)))


def distinct_cells(cell: I64) -> tuple[I64, I64]:
    """Of rows of whole numbers (n, d): the first row of each distinct one (k,), in lexicographic
    order, and the number (n,) of each in it. Numbers of one word are sorted far faster than rows.
    """
    if not len(cell):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    low, high = cell.min(axis=0).tolist(), cell.max(axis=0).tolist()
    size = tuple(b - a + 1 for a, b in zip(low, high, strict=True))
    if math.prod(size) < 1 << 63:
        name = np.ravel_multi_index(tuple((cell.astype(np.int64) - low).T), size)
        _, first, number = np.unique(name, return_index=True, return_inverse=True)
    else:
        _, first, number = np.unique(cell, axis=0, return_index=True, return_inverse=True)
    return first, number.reshape(-1)


def rows_of(values: F64, rows: I32 | I64) -> F64:
    """Those rows (k,), ascending and each once, of values (n, d), one after the other in memory:
    the values themselves where these are all, not a copy.
    """
    return np.ascontiguousarray(values if len(rows) == len(values) else values[rows])


@kernel
def few_kernel(values: F64, found: F64) -> int:
    """Put the finite ones of ``values`` (n,) into ``found`` (k,), each once, as they come; how many
    there are, k + 1 where they are more.
    """
    count, last = 0, np.nan
    for value in values:
        if value == last or not np.isfinite(value):
            continue
        last, known = value, False
        for k in range(count):
            known = known or found[k] == value
        if not known:
            if count == len(found):
                return count + 1
            found[count] = value
            count += 1
    return count


def few_values(values: F64) -> list[float]:
    """The finite ones of ``values`` (n,), each once, ascending: a pass over them where they are as
    few as a table holds, and sorted where they are not.
    """
    found = np.empty(TABLE)
    count = int(few_kernel(values, found))
    if count > TABLE:
        found = np.unique(values[np.isfinite(values)])
        count = len(found)
    return sorted(found[:count].tolist())
