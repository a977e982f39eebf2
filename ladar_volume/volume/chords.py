"""What chords do to the volume under a TIN: its triangles lie above a hollow and below a crest (UNCERTAINTY step 6).

A surface that is quadratic over a triangle of footprint A lies below it by ``A / 24 Σ e · (p_j − p_i)`` m³, summed over the sides e
from i to j, with p the slopes of the surface at the corners. The same holds on average where the surface has a kink, as at the toe of a
pile, and the vertices lie at random beside it: for every triangle the mean over all places of the kink is exact. The slopes come from the
normals that the filter gives its points, not from the mesh.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.ground.polynomial import base_height
from ladar_volume.model.records import F64, Plane, Tin

#: Least vertical component of a normal that says what its surroundings do to a height: steeper walls are not looked at.
LEAST_UP = 0.3


def chord_volumes(tin: Tin, normal: F64, inside_m2: F64) -> F64:
    """Volume (m,) m³ by which each triangle lies above the surface, negative where below, over its area inside_m2 (m,) m² that counts.

    normal : (n, 3) of the surface at the vertices, of either sign. A triangle with a corner on a wall steeper than 70° counts as flat.
    """
    out, xy = np.zeros(len(tin.triangles)), tin.vertices[:, :2]
    gentle = np.abs(normal[:, 2]) >= LEAST_UP
    rows = np.flatnonzero((inside_m2 > 0.0) & gentle[tin.triangles].all(axis=1))
    slope = -normal[:, :2] / np.where(gentle, normal[:, 2], 1.0)[:, None]
    t = tin.triangles[rows]
    for a, b in ((0, 1), (1, 2), (2, 0)):
        i, j = t[:, a], t[:, b]
        out[rows] += ((xy[j] - xy[i]) * (slope[j] - slope[i])).sum(axis=1)
    out *= inside_m2 / 24.0
    return out


def cut_and_fill_chords(tin: Tin, normal: F64, base: Plane, inside_m2: F64) -> tuple[float, float]:
    """The sums, m³, of :func:`chord_volumes` over the triangles that lie above a base, with their middle, and over those below."""
    volume = chord_volumes(tin, normal, inside_m2)
    height = tin.vertices[:, 2] - base_height(base, tin.vertices[:, :2])
    above = height[tin.triangles].sum(axis=1) > 0.0
    return float(volume[above].sum()), float(volume[~above].sum())
