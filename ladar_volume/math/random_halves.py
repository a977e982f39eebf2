"""Random halves of a cloud that depend on how its points lie to each other: neither on how they are
numbered, nor on where the cloud lies or how it is turned.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ladar_volume.math.equal_rows import distinct_cells

#: Points nearer to each other than this share of the cloud's extent are copies; distances that
#: differ by less than this share of it are alike.
SAME, ALIKE = 1e-6, 1e-9


def random_order(
    points: npt.NDArray[np.float64], rng: np.random.Generator
) -> npt.NDArray[np.int64]:
    """Rows of points (n, 3) in a random order, one of copies.

    The order is drawn by the rank of the distance from a point that moves and turns with the
    others: their mean, each with the square of its distance from their centroid. Where distances
    are alike, as in a symmetric cloud, coordinates decide.
    """
    if not len(points):
        return np.zeros(0, np.int64)
    low, extent = points.min(axis=0), max(float(np.ptp(points, axis=0).max()), 1e-290)
    # rounded: a cloud that was moved keeps its order where coordinates are the same
    place = np.rint((points - low) / (SAME * extent)).astype(np.int64)
    rows, _ = distinct_cells(place)
    at = (points[rows] - low) / extent
    at -= at.mean(axis=0)
    weight = np.einsum("nk,nk->n", at, at)
    if weight.sum() > 0.0:
        at -= weight @ at / weight.sum()
    away = np.rint(np.sqrt(np.einsum("nk,nk->n", at, at)) / ALIKE)
    ranked = rows[np.argsort(away, kind="stable")]
    return np.asarray(ranked[rng.permutation(len(rows))], np.int64)


def random_halves(
    points: npt.NDArray[np.float64], rng: np.random.Generator
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Ascending rows of two random halves of points (n, 3). Of copies one is in a half: else the
    other would show what that half leaves out.
    """
    mixed = random_order(points, rng)
    return np.sort(mixed[::2]), np.sort(mixed[1::2])
