"""A mesh cut off at the ground: what lies below it goes, and triangles across it end on it."""

from __future__ import annotations

import numpy as np

from ladar_volume.ground.heights import height_above
from ladar_volume.ground.polynomial import design
from ladar_volume.mesh.linear_mesh import GROUND, Faces, LinearMesh, blocks, extend_mesh
from ladar_volume.mesh.topology import edge_table
from ladar_volume.model.records import F64, I64, Plane


def steepness(ground: Plane) -> F64:
    """Derivative (3,) of the height above a level or plane by the position."""
    slope = ground.beta[1:3] if len(ground.beta) > 1 else np.zeros(2)
    return np.array([-slope[0], -slope[1], 1.0])


def clip_to_ground(skin: LinearMesh, ground: Plane) -> LinearMesh:
    """The part of a mesh above a level or plane, with vertices of kind GROUND where its edges
    pierce it.
    """
    v, t, n = skin.vertices, skin.triangles, len(skin.vertices)
    h = height_above(v, ground)
    order, start, _ = edge_table(t)
    first = order[start[:-1]]
    a, b = t.ravel()[first].astype(np.int64), t[:, [1, 2, 0]].ravel()[first].astype(np.int64)
    cut = (h[a] >= 0.0) != (h[b] >= 0.0)
    of_half = np.empty(3 * len(t), np.int64)
    of_half[order] = np.repeat(np.where(cut, n + np.cumsum(cut) - 1, -1), np.diff(start))
    middle = of_half.reshape(-1, 3)
    a, b = a[cut], b[cut]
    s = (h[a] / (h[a] - h[b]))[:, None]
    along, w = v[b] - v[a], steepness(ground)
    q = v[a] + s * along
    rate = along @ w
    project = np.eye(3) - along[:, :, None] * w / rate[:, None, None]
    rows = np.repeat(np.arange(len(q)), 2)
    columns = np.stack([a, b], axis=1).ravel()
    share = np.stack([1.0 - s, s], axis=1)[..., None] * project[:, None]
    by_vertices = blocks(rows, columns, share.reshape(-1, 3, 3), (len(q), n))
    by_ground = (
        along[:, :, None] * design(q[:, :2], ground.origin_xy, 1)[:, None, :] / rate[:, None, None]
    )
    triangles, parent, corner = cut_triangles(t, middle, h)
    normals = skin.normals[parent[:, None], corner]
    return extend_mesh(
        skin,
        q,
        GROUND,
        by_vertices,
        by_ground.reshape(-1, 3),
        Faces(triangles, normals, skin.face[parent]),
    )


def cut_triangles(t: np.ndarray, middle: I64, h: F64) -> tuple[np.ndarray, I64, I64]:
    """Triangles (k, 3) above the ground, the one each comes from (k,), and of which of its corners
    each has the normal (k, 3).
    """
    up = h[t] >= 0.0
    count = up.sum(axis=1)
    whole = np.flatnonzero(count == 3)
    out, parent, corner = (
        [t[whole].astype(np.int64)],
        [whole],
        [np.tile(np.arange(3), (len(whole), 1))],
    )
    for k in range(3):
        j, l = (k + 1) % 3, (k + 2) % 3
        one = np.flatnonzero((count == 1) & up[:, k])
        two = np.flatnonzero((count == 2) & ~up[:, k])
        a, b, c = t[:, k].astype(np.int64), t[:, j].astype(np.int64), t[:, l].astype(np.int64)
        p, q = middle[:, k], middle[:, l]
        for rows, corners, normals in (
            (one, (a, p, q), (k, k, k)),
            (two, (p, b, c), (j, j, l)),
            (two, (p, c, q), (j, l, l)),
        ):
            out.append(np.stack([x[rows] for x in corners], axis=1))
            parent.append(rows)
            corner.append(np.tile(np.array(normals), (len(rows), 1)))
    return np.concatenate(out).astype(np.int32), np.concatenate(parent), np.concatenate(corner)
