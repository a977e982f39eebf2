"""Patches fitted to shared raw points, with the dense covariance of all their parameters."""

from __future__ import annotations

import numpy as np
from volume_surfaces import normal_frame

from ladar_volume.model.records import FilteredPoints, Patches
from ladar_volume.uncertainty.propagation import (
    design_rows,
)

BEAMS = 4


COLUMNS = 11 + 2 * BEAMS


def random_surface(p=3, m=9, n=40, seed=0):
    """Patches fitted to shared raw points: returns records and the dense covariance (m p, m p) of
    all their parameters.
    """
    rng = np.random.default_rng(seed)
    raw = 30
    noise = rng.uniform(0.5, 2.0, raw)
    operators = []
    for _ in range(m):
        member = np.flatnonzero(rng.random(raw) < 0.6)
        X = design_rows(rng.uniform(-1, 1, (len(member), 2)), p)
        A = np.zeros((p, raw))
        A[:, member] = np.linalg.pinv(X)
        operators.append(A)
    key = np.sort(rng.choice(1000, m, replace=False)).astype(np.int64)
    stacked = np.concatenate(operators)
    dense = (stacked * noise) @ stacked.T
    start, cross_key, cross = [0], [], []
    for a in range(m):
        for b in range(a, m):
            cross_key.append(key[b])
            cross.append((operators[a] * noise) @ operators[b].T)
        start.append(len(cross))
    normal = rng.standard_normal((m, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    nav_count = rng.integers(1, 4, m)
    nav_bin = np.concatenate([np.sort(rng.choice(6, c, replace=False)) for c in nav_count]).astype(
        np.int64
    )
    patches = Patches(
        key,
        rng.standard_normal((m, 3)),
        normal,
        normal_frame(normal)[0],
        np.zeros((m, p)),
        np.ones(m),
        np.full(m, 9, np.int32),
        np.zeros(m, np.int64),
        np.array(start),
        np.array(cross_key),
        np.array(cross),
        rng.standard_normal((m, p + 2, COLUMNS)).astype(np.float32),
        np.concatenate([[0], np.cumsum(nav_count)]),
        nav_bin,
        rng.standard_normal((len(nav_bin), p + 2, 4)).astype(np.float32),
    )
    row = np.sort(rng.integers(0, m, n))
    T = rng.standard_normal((n, 3, 3))
    C = (T @ np.swapaxes(T, 1, 2)).astype(np.float32)
    points = FilteredPoints(
        rng.standard_normal((n, 3)),
        normal[row],
        np.ones(n),
        C[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]],
        np.zeros(n, np.int64),
        key[row],
        rng.uniform(-1, 1, (n, 2)),
    )
    return points, patches, dense, row
