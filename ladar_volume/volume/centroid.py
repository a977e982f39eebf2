"""Where a body is."""

from __future__ import annotations

import numpy as np

from ladar_volume.ground.polynomial import base_height
from ladar_volume.math.kernels import kernel
from ladar_volume.model.records import F64, I32, Plane, Tin


def centroid(tin: Tin, base: Plane, inside_m2: F64) -> tuple[float, float, float]:
    """Centroid (x, y, z) m of the material above the base, map frame.

    inside_m2 : (m,) area of each triangle inside the outline. Triangles whose mean height is not
    above the base do not count; exact where the outline is made of whole triangles that lie above
    the base. Without any, the mean of the triangles.
    """
    low = base_height(base, tin.vertices[:, :2])
    x, y, z = moment_kernel(tin.vertices, tin.triangles, inside_m2, low)
    return float(x), float(y), float(z)


def plan_centre(tin: Tin, triangles: I32, weight: F64) -> tuple[float, float]:
    """Mean x and y, m, of triangles (k, 3) of the TIN by their weights (k,); NaN where these sum to
    nothing.
    """
    middle = tin.vertices[triangles, :2].mean(axis=1)
    x, y = weight @ middle / weight.sum()
    return float(x), float(y)


@kernel
def moment_kernel(vertices: F64, triangles: I32, inside_m2: F64, low: F64) -> F64:
    """See :func:`centroid`; low : (n,) height of the base under each vertex."""
    moment, total, mean, count = np.zeros(3), 0.0, np.zeros(3), 0
    corner, h = np.empty((3, 3)), np.empty(3)
    for t in range(len(triangles)):
        if not inside_m2[t] > 0.0:
            continue
        count += 1
        for i in range(3):
            corner[i], h[i] = (
                vertices[triangles[t, i]],
                vertices[triangles[t, i], 2] - low[triangles[t, i]],
            )
            mean += corner[i] / 3.0
            corner[i, 2] -= 0.5 * h[i]  # of what stands on the base there the middle
        whole = h[0] + h[1] + h[2]
        if whole > 0.0:
            total += inside_m2[t] * whole / 3.0
            for c in range(
                3
                # the integral of a product of two linear functions: A / 12 (Σ a_i b_i + Σ a_i Σ
                # b_i)
            ):
                a = corner[:, c]
                moment[c] += (
                    inside_m2[t]
                    / 12.0
                    * (a[0] * h[0] + a[1] * h[1] + a[2] * h[2] + (a[0] + a[1] + a[2]) * whole)
                )
    return moment / total if total > 0.0 else mean / count
