"""Triangles of several tiles as one surface: each once, with what lies across its sides."""

from __future__ import annotations

import numpy as np

from ladar_volume.math.kernels import kernel
from ladar_volume.model.records import I32, I64


@kernel
def distinct_triangles(corners: I32, n: int) -> tuple[I64, I32]:
    """The rows (k,) of triangles (m, 3) over n vertices that are the first of their kind, and
    these with their lowest corner first. One triangle lies to the left of a side.
    """
    m, k = len(corners), 0
    rows, out = np.empty(m, np.int64), np.empty((m, 3), np.int32)
    head, after = np.full(n, -1, np.int32), np.empty(m, np.int32)
    for t in range(m):
        low = 0
        for c in range(1, 3):
            if corners[t, c] < corners[t, low]:
                low = c
        a, b = corners[t, low], corners[t, (low + 1) % 3]
        at = head[a]
        while at >= 0 and out[at, 1] != b:
            at = after[at]
        if at < 0:
            rows[k], out[k, 0], out[k, 1], out[k, 2] = t, a, b, corners[t, (low + 2) % 3]
            after[k], head[a] = head[a], k
            k += 1
    return rows[:k].copy(), out[:k].copy()


@kernel
def across_sides(triangles: I32, n: int) -> I32:
    """The triangle (m, 3) across the side opposite each corner, -1 where there is not exactly one;
    over n vertices.
    """
    m, sides = len(triangles), 0
    head, after = np.full(n, -1, np.int32), np.empty(3 * m, np.int32)
    high, first = np.empty(3 * m, np.int32), np.empty(3 * m, np.int32)
    second, count = np.empty(3 * m, np.int32), np.zeros(3 * m, np.int32)
    for t in range(m):
        for c in range(3):
            p, q = triangles[t, (c + 1) % 3], triangles[t, (c + 2) % 3]
            low = min(p, q)
            at = head[low]
            while at >= 0 and high[at] != max(p, q):
                at = after[at]
            if at < 0:
                at, after[sides], high[sides] = sides, head[low], max(p, q)
                head[low], first[at] = at, 3 * t + c
                sides += 1
            second[at] = 3 * t + c
            count[at] += 1
    out = np.full((m, 3), -1, np.int32)
    for s in range(sides):
        if count[s] == 2:
            i, j = first[s], second[s]
            out[i // 3, i % 3], out[j // 3, j % 3] = j // 3, i // 3
    return out
