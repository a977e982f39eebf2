"""Random halves of a cloud that depend on where its points are, not on how they are numbered."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

#: Points nearer to each other than this share of the cloud's extent are copies.
SAME = 1e-6


def random_order(
    points: npt.NDArray[np.float64], rng: np.random.Generator
) -> npt.NDArray[np.int64]:
    """Rows of points (n, 3) in a random order, one of copies."""
    if not len(points):
        return np.zeros(0, np.int64)
    low = points.min(axis=0)
    step = max(SAME * float(np.ptp(points, axis=0).max()), 1e-300)
    # rounded: a cloud that was moved keeps its order where coordinates are the same
    place = np.rint((points - low) / step).astype(np.int64)
    _, rows = np.unique(place, axis=0, return_index=True)
    return np.asarray(rows[rng.permutation(len(rows))], np.int64)


def random_halves(
    points: npt.NDArray[np.float64], rng: np.random.Generator
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Ascending rows of two random halves of points (n, 3). Of copies one is in a half: else the
    other would show what that half leaves out.
    """
    mixed = random_order(points, rng)
    return np.sort(mixed[::2]), np.sort(mixed[1::2])
