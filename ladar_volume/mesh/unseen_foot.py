"""How far a body's unseen foot may be off the tangent along which it is drawn on to the ground: the
surface bends on as it does above the rim.

A surface with the curvature 1 / R along the way down leaves its tangent, after a length s, by ``R -
sqrt(R² - s²)``. Over the height h that is ``R h - (h sqrt(R² - h²) + R² asin(h / R)) / 2``, about
``h³ / 6 R``, for each metre of the rim that the body does not hold, or lacks.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.mesh.linear_mesh import LinearMesh
from ladar_volume.model.records import F64, I64, Bool

#: Curvature is told within this many heights that are to be drawn, at least so many sides of the
#: rim.
HEIGHTS, SIDES = 2.0, 6.0
#: How strongly a surface goes on to bend is not known: an egg bends twice as much at its end.
STRONGER = 2.0
#: Normals that agree less, as a cosine, are of another face.
ONE_FACE = 0.5
#: Length of the mean of the unit normals at a vertex from which on they are of one face.
AGREE = 0.95


def mean_normals(skin: LinearMesh) -> tuple[F64, Bool]:
    """Unit normals (n, 3) of the vertices, the mean of those at their corners, of the triangles
    where none are known; and which (n,) vertices lie on one face, where these agree.
    """
    p, at = skin.vertices[skin.triangles], skin.triangles.ravel()
    area = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    size = np.linalg.norm(area, axis=1, keepdims=True)
    flat = (area / np.where(size > 0.0, size, 1.0))[:, None]
    corner = np.where(np.isnan(skin.normals), flat, skin.normals).reshape(-1, 3)
    many = len(skin.vertices)
    total = np.stack([np.bincount(at, corner[:, k], many) for k in range(3)], axis=1)
    length = np.linalg.norm(total, axis=1)
    one_face = length > AGREE * np.maximum(np.bincount(at, minlength=many), 1)
    return total / np.where(length > 0.0, length, 1.0)[:, None], one_face


def curvature_down(skin: LinearMesh, vertices: I64, along: F64, reach_m: F64) -> F64:
    """Curvature (k,) 1/m of the surface above rim vertices (k,) along unit directions (k, 3) down
    it, told within ``reach_m`` (k,): positive where it bends inward. 0 where nothing tells.
    """
    normal, one_face = mean_normals(skin)
    used = np.unique(skin.triangles)
    used = used[one_face[used]]
    out = np.zeros(len(vertices))
    if len(used) == 0:
        return out
    near = cKDTree(skin.vertices[used]).query_ball_point(skin.vertices[vertices], reach_m)
    for i in np.flatnonzero(one_face[vertices]):
        v, t = vertices[i], along[i]
        rows = used[np.asarray(near[i], np.int64)]
        s = (skin.vertices[rows] - skin.vertices[v]) @ t
        good = (s < 0.0) & (normal[rows] @ normal[v] > ONE_FACE)
        square = float(s[good] @ s[good])
        if square > 0.0:
            out[i] = float(((normal[rows[good]] - normal[v]) @ t) @ s[good]) / square
    return out


def between_tangent_and_circle(bend: F64, height_m: F64) -> F64:
    """Area (k,) m² between tangents of a height (k,) m and circles of a curvature (k,) 1/m, with
    its sign; a circle that has turned level goes no further.
    """
    x = np.minimum(np.abs(bend) * height_m, 1.0)
    # in radii; the series where the difference of nearly equal numbers has no digits left
    exact = x - 0.5 * (x * np.sqrt(1.0 - x * x) + np.arcsin(x))
    share = np.where(x < 1e-3, x**3 / 6.0, exact)
    return np.asarray(np.sign(bend) * share / np.where(x > 0.0, bend, 1.0) ** 2)


def unseen_bend(skin: LinearMesh, rim: I64, along: F64, drawn_m: F64) -> float:
    """Volume, m³, between the tangents of one rim (k,) drawn on over ``drawn_m`` (k,) and the
    surface bent on :data:`STRONGER` than above it, by tangents that turn within a side of the rim;
    positive where the tangents enclose more.
    """
    p = skin.vertices[rim]
    side = np.linalg.norm(p - np.roll(p, 1, axis=0), axis=1)
    length, step = 0.5 * (side + np.roll(side, -1)), float(np.median(side))
    bend = curvature_down(skin, rim, along, np.maximum(HEIGHTS * drawn_m, SIDES * step))
    area = STRONGER * between_tangent_and_circle(bend, drawn_m)
    area += 0.5 * np.clip(bend * step, -1.0, 1.0) * drawn_m**2
    return float((length * area).sum())
