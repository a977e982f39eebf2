"""Triangles of several tiles as one surface: each once."""

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
