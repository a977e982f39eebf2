"""A platform on a straight, turning path and mapped points below it."""

import numpy as np

from ladar_volume.model.records import MappedPoints, PlatformStates

SECOND = 1_000_000_000


def platform(seconds=10.0, step_ns=10_000_000, height=20.0):
    t = np.arange(0, int(seconds * SECOND) + 1, step_ns)
    s, n = t * 1e-9, len(t)
    half = 0.05 * np.sin(s)
    q = np.stack([np.sin(half), 0 * s, 0 * s, np.cos(half)], axis=1)
    omega = np.stack([0.1 * np.cos(s), 0 * s, 0 * s], axis=1)
    p = np.stack([0.5 * s, 0.1 * s, height + 0 * s], axis=1)
    return PlatformStates(
        t,
        p,
        q,
        np.tile([0.5, 0.1, 0.02], (n, 1)),
        omega,
        np.tile(np.eye(6) * 1e-4, (n, 1, 1)),
        np.zeros(n, np.int64),
    )


def mapped(r, variance=1e-4, seconds=10.0, seed=5):
    n = len(r)
    rng = np.random.default_rng(seed)
    t = np.sort(rng.integers(0, int(seconds * SECOND), n))
    C = np.zeros((n, 6), np.float32)
    C[:, [0, 3, 5]] = variance
    return MappedPoints(
        t,
        np.asarray(r, float),
        C,
        rng.integers(0, 16, n).astype(np.uint16),
        np.zeros(n, np.float32),
    )


def sheet(n, half=1.5, seed=1):
    """Horizontal points (n, 2) over a square."""
    return np.random.default_rng(seed).uniform(-half, half, (n, 2))
