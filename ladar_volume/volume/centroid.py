"""Where a body is."""

from __future__ import annotations

import numpy as np

from ladar_volume.ground.polynomial import base_height
from ladar_volume.model.records import F64, Plane, Tin


def centroid(tin: Tin, base: Plane, inside_m2: F64) -> tuple[float, float, float]:
    """Centroid (x, y, z) m of the material above the base, map frame.

    inside_m2 : (m,) area of each triangle inside the outline. Triangles whose mean height is not above the base do not count;
    exact where the outline is made of whole triangles that lie above the base. Without any, the mean of the triangles.
    """
    rows = np.flatnonzero(inside_m2 > 0)
    corner = tin.vertices[tin.triangles[rows]]
    low = base_height(base, tin.vertices[:, :2])[tin.triangles[rows]]
    h = corner[..., 2] - low
    keep = h.mean(axis=1) > 0
    if not keep.any():
        x, y, z = corner.mean(axis=(0, 1))
        return float(x), float(y), float(z)
    corner, low, h, area = corner[keep], low[keep], h[keep], inside_m2[rows][keep]
    total = float(area @ h.mean(axis=1))
    middle = np.concatenate([corner[..., :2], 0.5 * (corner[..., 2] + low)[..., None]], axis=2)
    # the integral of a product of two linear functions over a triangle: A / 12 (Σ a_i b_i + Σ a_i Σ b_i)
    moment = area @ ((middle * h[..., None]).sum(axis=1) + middle.sum(axis=1) * h.sum(axis=1)[:, None]) / 12.0
    x, y, z = moment / total
    return float(x), float(y), float(z)
