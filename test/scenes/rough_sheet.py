"""A platform that stands still over a rough, stepped sheet."""

from __future__ import annotations

import numpy as np

from ladar_volume.model.records import MappedPoints, PlatformStates


def still(t_ns):
    """States of a platform that stands 20 m above the origin."""
    n, zero = len(t_ns), np.zeros((len(t_ns), 3))
    p, q = np.tile([0.0, 0.0, 20.0], (n, 1)), np.tile([0.0, 0.0, 0.0, 1.0], (n, 1))
    return PlatformStates(
        t_ns, p, q, zero, zero, np.tile(np.eye(6) * 1e-4, (n, 1, 1)), np.zeros(n, np.int64)
    )


def rough(n, seed):
    """Returns (n,) of a rough, stepped sheet in ten seconds."""
    rng = np.random.default_rng(seed)
    r = np.column_stack([rng.uniform(-3.0, 3.0, (n, 2)), 0.02 * rng.normal(size=n)])
    r[:, 2] += np.where(r[:, 0] > 1.0, 0.4, 0.0)
    r[: n // 10, 2] += rng.uniform(0.0, 2.0, n // 10)
    C = np.tile(np.array([1e-4, 0, 0, 1e-4, 0, 1e-4], np.float32), (n, 1))
    t_ns = np.sort(rng.integers(0, 10_000_000_000, n))
    return MappedPoints(
        t_ns, r, C, rng.integers(0, 16, n).astype(np.uint16), np.zeros(n, np.float32)
    )
