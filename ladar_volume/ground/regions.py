"""Regions that choose points: a polygon over the horizontal plane, a box in any orientation."""

from __future__ import annotations

import numpy as np

from ladar_volume.model.errors import ObjectError
from ladar_volume.model.records import F64, Bool


def in_polygon(points: F64, polygon: F64) -> Bool:
    """Points (n, 2 or more) with x, y inside a closed polygon (k, 2) m, convex or not (even-odd
    rule).

    Raises :class:`ObjectError` for fewer than three corners, corners that are not finite, or no
    area.
    """
    corner = np.asarray(polygon, dtype=np.float64)
    if (
        corner.ndim != 2
        or corner.shape[1:] != (2,)
        or len(corner) < 3
        or not np.isfinite(corner).all()
    ):
        raise ObjectError(
            f"a polygon needs at least three finite corners x, y; got an array {corner.shape}",
            reason="object_polygon",
            value=corner,
        )
    d, following = corner - corner[0], np.roll(corner, -1, axis=0)
    if (d[:-1, 0] * d[1:, 1] == d[:-1, 1] * d[1:, 0]).all():
        raise ObjectError(
            "the polygon has no area: give corners that are not on one line",
            reason="object_polygon",
            value=corner,
        )
    x, y = points[:, 0], points[:, 1]
    inside = np.zeros(len(points), dtype=np.bool_)
    for (ax, ay), (bx, by) in zip(corner, following, strict=True):
        across = (ay > y) != (by > y)
        inside[across] ^= x[across] < ax + (y[across] - ay) / (by - ay) * (bx - ax)
    return inside


def in_box(points: F64, low_m: F64, high_m: F64, R_box_map: F64 | None = None) -> Bool:
    """Points (n, 3) between the corners ``low_m`` and ``high_m`` (3,) of a box, its faces included.

    R_box_map : (3, 3) rotation of an oriented box, whose corners are then given in the turned frame
    ``r_box = R_box_map r_map``. Raises :class:`ObjectError` for corners that span no box and a
    matrix that is no rotation.
    """
    low, high = np.asarray(low_m, dtype=np.float64), np.asarray(high_m, dtype=np.float64)
    if low.shape != (3,) or high.shape != (3,) or not (low < high).all():
        raise ObjectError(
            f"a box needs low < high on all three axes; got {low} and {high}",
            reason="object_box",
            value=(low, high),
        )
    R = np.eye(3) if R_box_map is None else np.asarray(R_box_map, dtype=np.float64)
    if R.shape != (3, 3) or not np.allclose(R @ R.T, np.eye(3), atol=1e-6):
        raise ObjectError(
            "the box's orientation is no rotation matrix", reason="object_box", value=R
        )
    turned = points @ R.T
    return np.asarray(((turned >= low) & (turned <= high)).all(axis=1), dtype=np.bool_)
