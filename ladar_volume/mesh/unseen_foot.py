"""How a body's unseen foot goes on: a plane wall leans as the part above the rim does, by a fit to
it; a curved surface may be off the tangent along which it is drawn on to the ground, since it bends
on as it does above the rim.

A surface with the curvature 1 / R along the way down leaves its tangent, after a length s, by ``R -
sqrt(R² - s²)``. Over the height h that is ``R h - (h sqrt(R² - h²) + R² asin(h / R)) / 2``, about
``h³ / 6 R``, for each metre of the rim that the body does not hold, or lacks.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from ladar_volume.mesh.linear_mesh import MEASURED, LinearMesh, blocks
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
#: Normals that agree better, as a cosine, are of one plane wall; points asked for its lean, and
#: fewest that tell it.
ONE_WALL, ASKED, FEWEST = 0.94, 300, 12


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


class _Wall(NamedTuple):
    """What tells how walls lean. rows : (w,) vertices that are measured and on one plane · normal :
    (n, 3) of all vertices · tree : of the places of ``rows``
    """

    rows: I64
    normal: F64
    tree: cKDTree


def wall_directions(
    skin: LinearMesh, rim: I64, along: F64, steep: Bool, reach_m: F64, drawn_m: F64
) -> tuple[F64, csr_matrix]:
    """Directions (k, 3) down plane walls at rim vertices (k,), and their derivative (3k, 3n) by the
    vertices.

    along : (k, 3) by the normals of the filter, kept where not ``steep`` (k,), where the surface is
    curved, and where the wall within ``reach_m`` (k,) is seen over less than ``drawn_m`` (k,),
    which is to be drawn. Elsewhere a plane through the wall's vertices tells it: so that what the
    noise does to its slope goes with all else it does to them.
    """
    n, out = len(skin.vertices), along.copy()
    normal, one_face = mean_normals(skin)
    known = np.ones(n, bool)
    known[skin.triangles[np.isnan(skin.normals[..., 0])]] = False
    plane = one_face & known & ~skin.curved & (skin.kind == MEASURED)
    plane &= np.bincount(skin.triangles.ravel(), minlength=n) > 0
    rows = np.flatnonzero(plane).astype(np.int64)
    found: list[tuple[I64, I64, F64]] = []
    if len(rows) >= FEWEST:
        wall = _Wall(rows, normal, cKDTree(skin.vertices[rows]))
        able = np.flatnonzero(steep & known[rim] & ~skin.curved[rim])
        for i, faces in zip(able, _normals_at(skin, rim[able]), strict=True):
            one = _lean(skin, wall, rim[i], faces, out[i], float(reach_m[i]), float(drawn_m[i]))
            if one is not None:
                out[i], columns, values = one
                found.append((np.full(len(columns), i), columns, values))
    if not found:
        return out, csr_matrix((3 * len(rim), 3 * n))
    at, columns, values = (np.concatenate(part) for part in zip(*found, strict=True))
    return out, blocks(at, columns, values, (len(rim), n))


def _normals_at(skin: LinearMesh, vertices: I64) -> Iterator[F64]:
    """Normals (f, 3) of the one or two faces that meet at each vertex."""
    order = np.argsort(skin.triangles.ravel(), kind="stable")
    start = np.searchsorted(skin.triangles.ravel()[order], np.arange(len(skin.vertices) + 1))
    corner = skin.normals.reshape(-1, 3)
    for v in vertices:
        all_of = corner[order[start[v] : start[v + 1]]]
        same = all_of @ all_of[0] > ONE_WALL
        parts = [all_of[same], all_of[~same]]
        mean = np.stack([part.mean(axis=0) for part in parts if len(part)])
        yield mean / np.linalg.norm(mean, axis=1, keepdims=True)


def _lean(
    skin: LinearMesh, wall: _Wall, vertex: int, faces: F64, along: F64, reach_m: float, drawn: float
) -> tuple[F64, I64, F64] | None:
    """Direction (3,) down the planes through the walls at a vertex with normals (f, 3); columns
    (b,) and values (b, 3, 3) of its derivative. None where too little of a wall is seen.
    """
    p = skin.vertices[vertex]
    asked = min(ASKED, len(wall.rows))
    away, near = wall.tree.query(p, asked, distance_upper_bound=reach_m)
    rows = wall.rows[np.asarray(near)[np.isfinite(away)]]
    turn = np.linalg.pinv(faces)
    out, columns, values = along.copy(), [], []
    for face, normal in enumerate(faces):
        own = rows[wall.normal[rows] @ normal > ONE_WALL]
        d = skin.vertices[own] - p
        down, aside = d @ along, d @ np.cross(normal, along)
        if len(own) < FEWEST or np.ptp(down) < drawn:
            return None
        weight = np.linalg.pinv(np.stack([np.ones(len(own)), down, aside], axis=1))[1]
        out += turn[:, face] * float(weight @ (d @ normal))
        columns.append(own)
        values.append(weight[:, None, None] * np.outer(turn[:, face], normal))
    return out, np.concatenate(columns), np.concatenate(values)


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


def sides_of(p: F64) -> tuple[F64, float]:
    """Length (k,) m of a rim (k, 3) that belongs to each vertex, and its median side."""
    side = np.linalg.norm(p - np.roll(p, 1, axis=0), axis=1)
    return 0.5 * (side + np.roll(side, -1)), float(np.median(side))


def extrapolation_reach(skin: LinearMesh, rim: I64, drawn_m: F64) -> F64:
    """How far (k,) m about the vertices of one rim (k,) the surface tells how it goes on over
    ``drawn_m`` (k,).
    """
    step = sides_of(skin.vertices[rim])[1]
    return np.maximum(HEIGHTS * drawn_m, SIDES * step)


def unseen_bend(skin: LinearMesh, rim: I64, along: F64, drawn_m: F64) -> float:
    """Volume, m³, between the tangents of one rim (k,) drawn on over ``drawn_m`` (k,) and the
    surface bent on :data:`STRONGER` than above it, by tangents that turn within a side of the rim;
    positive where the tangents enclose more.
    """
    length, step = sides_of(skin.vertices[rim])
    bend = curvature_down(skin, rim, along, extrapolation_reach(skin, rim, drawn_m))
    area = STRONGER * between_tangent_and_circle(bend, drawn_m)
    area += 0.5 * np.clip(bend * step, -1.0, 1.0) * drawn_m**2
    return float((length * area).sum())
