"""What chords do to the volume under a TIN: its triangles lie above a hollow and below a crest
(UNCERTAINTY step 6).

A surface that is quadratic over a triangle of footprint A lies below it by ``A / 24 Σ e · (p_j −
p_i)`` m³, summed over the sides e from i to j, with p the slopes of the surface at the corners. The
same holds on average where the surface has a kink, as at the toe of a pile, and the vertices lie at
random beside it: for every triangle the mean over all places of the kink is exact. The slopes come
from the normals that the filter gives its points, not from the mesh.
"""

from __future__ import annotations

import math

import numpy as np

from ladar_volume.ground.heights import height_above
from ladar_volume.math.kernels import kernel
from ladar_volume.math.large_arrays import large_zeros
from ladar_volume.model.records import F64, I32, Plane, Tin

#: Least vertical component of a normal that says what its surroundings do to a height: steeper
#: walls are not looked at.
LEAST_UP = 0.3
#: Triangles that are summed at a time.
AT_ONCE = 1 << 20


@kernel
def chord_kernel(vertices: F64, normal: F64, triangles: I32, inside_m2: F64, out: F64) -> None:
    """:func:`chord_volumes` of triangles (m, 3) of vertices (n, 3), to out (m,)."""
    slope = np.empty((3, 2))
    for t in range(len(triangles)):
        if inside_m2[t] > 0.0:
            for k in range(3):
                n = normal[triangles[t, k]]
                up = n[2] if abs(n[2]) >= LEAST_UP else math.nan
                slope[k, 0], slope[k, 1] = -n[0] / up, -n[1] / up
            total = 0.0
            for k in range(3):
                j = (k + 1) % 3
                a, b = vertices[triangles[t, k]], vertices[triangles[t, j]]
                total += (b[0] - a[0]) * (slope[j, 0] - slope[k, 0]) + (b[1] - a[1]) * (
                    slope[j, 1] - slope[k, 1]
                )
            if not math.isnan(total):
                out[t] = inside_m2[t] / 24.0 * total


def chord_volumes(tin: Tin, normal: F64, inside_m2: F64) -> F64:
    """Volume (m,) m³ by which each triangle lies above the surface, negative where below, over its
    area inside_m2 (m,) m² that counts.

    normal : (n, 3) of the surface at the vertices, of either sign. A triangle with a corner on a
    wall steeper than 70° counts as flat.
    """
    normal, inside_m2 = np.ascontiguousarray(normal), np.ascontiguousarray(inside_m2)
    out: F64 = large_zeros((len(tin.triangles),))
    chord_kernel(np.ascontiguousarray(tin.vertices), normal, tin.triangles, inside_m2, out)
    return out


def cut_and_fill_chords(tin: Tin, normal: F64, base: Plane, inside_m2: F64) -> tuple[float, float]:
    """The sums, m³, of :func:`chord_volumes` over the triangles that lie above a base, with their
    middle, and over those below.
    """
    volume, cut = chord_volumes(tin, normal, inside_m2), 0.0
    height = height_above(tin.vertices, base)
    for first in range(0, len(volume), AT_ONCE):
        t = tin.triangles[first : first + AT_ONCE]
        above = height[t[:, 0]] + height[t[:, 1]] + height[t[:, 2]] > 0.0
        cut += float(volume[first : first + AT_ONCE] @ above)
    return cut, float(volume.sum()) - cut
