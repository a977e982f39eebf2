"""A box of 2 × 1.5 × 1.2 m on level ground, as mapped points of a survey from a still platform."""

import numpy as np

from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import MappedPoints, PlatformStates

HEIGHT, NOISE = 1.2, 0.003


def parameters():
    """What the box is measured with."""
    return Parameters.read({"filter": {"radius_m": 0.15}, "volume": {"kind": "bodies"}})


def survey_of_a_box(seed=3):
    """Roof, walls down to the ground and ground, three seconds of returns."""
    rng = np.random.default_rng(seed)
    half = np.array([1.0, 0.75])
    parts = [np.c_[rng.uniform(-half, half, (4000, 2)), np.full(4000, HEIGHT)]]
    for axis in (0, 1):
        for side in (-1.0, 1.0):
            wall = np.zeros((2500, 3))
            wall[:, axis] = side * half[axis]
            wall[:, 1 - axis] = rng.uniform(-half[1 - axis], half[1 - axis], 2500)
            wall[:, 2] = rng.uniform(0.0, HEIGHT, 2500)
            parts.append(wall)
    xy = rng.uniform(-2.5, 2.5, (20000, 2))
    xy = xy[(np.abs(xy) > half).any(axis=1)]
    parts.append(np.c_[xy, np.zeros(len(xy))])
    r = np.concatenate(parts)
    r += NOISE * rng.normal(size=r.shape)
    n = len(r)
    C = np.tile(np.array([1, 0, 0, 1, 0, 1], np.float32) * np.float32(NOISE**2), (n, 1))
    t = np.sort(rng.integers(0, 3 * 10**9, n))
    ring = rng.integers(0, 16, n).astype(np.uint16)
    return MappedPoints(t, rng.permutation(r), C, ring, np.zeros(n, np.float32))


def states():
    """The platform, 10 m above the box, for four seconds."""
    t = np.arange(0, 4 * 10**9, 10**8, dtype=np.int64)
    n, zero = len(t), np.zeros((len(t), 3))
    C = np.tile(np.diag([1e-4] * 3 + [1e-6] * 3), (n, 1, 1))
    q = np.tile([0.0, 0.0, 0.0, 1.0], (n, 1))
    at = np.tile([0.0, 0.0, 10.0], (n, 1))
    return PlatformStates(t, at, q, zero, zero, C, np.zeros(n, np.int64))
