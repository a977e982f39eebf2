"""What the chords of a mesh leave out on a curved surface, from the normals at its vertices
(UNCERTAINTY step 6).

The surface over a triangle is the quadratic patch that has the triangle's corners and, along each
side, the normals at its ends: it bulges by ``m = e · (n_j / n_j·N − n_i / n_i·N) / 8`` in the
middle of a side e from i to j, with N the triangle's own normal, and its volume over the triangle
is ``A (m_1 + m_2 + m_3) / 3``. On a sphere m is the sagitta ``e² / 8 R``. Sides whose normals are
of two faces bulge not at all, nor do those that end on a plane.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.mesh.linear_mesh import LinearMesh
from ladar_volume.model.body_parameters import SHARP_RAD
from ladar_volume.model.records import F64

#: A normal leans at most this far, as a cosine, away from the triangle's own: beyond, the patch
#: would stand on edge.
LEAST_COSINE = 0.5


def bulge_volumes(skin: LinearMesh, angle_rad: float = SHARP_RAD) -> F64:
    """Volume (m,) m³ between each triangle and its curved patch, positive outward; 0 where normals
    are not known.
    """
    if not skin.curved.any():
        return np.zeros(len(skin.triangles))
    p = skin.vertices[skin.triangles]
    area = 0.5 * np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    size = np.linalg.norm(area, axis=1)
    N = area / np.where(size > 0.0, size, 1.0)[:, None]
    lean = np.einsum("mki,mi->mk", skin.normals, N)
    upright = lean >= LEAST_COSINE
    slope = skin.normals / np.where(upright, lean, 1.0)[..., None]
    curved = skin.curved[skin.triangles]
    out = np.zeros(len(p))
    for k in range(3):
        j = (k + 1) % 3
        one_face = np.einsum("mi,mi->m", skin.normals[:, k], skin.normals[:, j]) >= np.cos(
            angle_rad
        )
        good = one_face & upright[:, k] & upright[:, j] & curved[:, k] & curved[:, j]
        middle = np.einsum("mi,mi->m", p[:, j] - p[:, k], slope[:, j] - slope[:, k]) / 8.0
        out += np.where(good, size * middle / 3.0, 0.0)
    return out
