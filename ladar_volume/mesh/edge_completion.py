"""Edges and corners completed: where a mesh cuts across an edge, vertices on the intersection of
the faces' own planes.

Filtered points lie on faces, hardly ever on edges, so a mesh through them cuts every edge off: a
cube of 5,800 points loses 0.3 % of its volume. The filter gives each point the normal of its face.
An edge of the mesh whose ends have different normals crosses a sharp edge; it gets a vertex on the
line where the planes of its ends meet, and a triangle with three different normals one more where
the three meet (Attene et al. 2005, "Sharpen & Bend"). Triangles are subdivided only, so a manifold
stays one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ladar_volume.mesh.linear_mesh import EDGE, Faces, LinearMesh, blocks, extend_mesh
from ladar_volume.mesh.topology import edge_table
from ladar_volume.model.body_parameters import SHARP_RAD
from ladar_volume.model.records import F64, I32, I64, Bool

#: A completed vertex lies at most this many lengths of the edge (of the triangle's longest) from
#: its middle, else it stays in the middle.
FARTHEST = 1.5
#: Eigenvalue of the normals' products from which on planes meet in a point that means anything (the
#: square of a sine, about).
DETERMINED = 0.05


@dataclass(frozen=True)
class PlaneIntersection:
    """at : (k, 3) m, where planes meet · by_corner : (k, c, 3, 3), derivative by the points of the
    planes · good : (k,) whether there
    """

    at: F64
    by_corner: F64
    good: Bool


def plane_intersection(points: F64, normals: F64) -> PlaneIntersection:
    """The point nearest to the middle of points (k, c, 3) that is on all planes through them with
    normals (k, c, 3); c is 2 or 3.
    """
    c = points.shape[1]
    middle = points.mean(axis=1)
    G = np.einsum("kai,kbi->kab", normals, normals)
    good = np.linalg.eigvalsh(G)[:, 0] > DETERMINED
    G[~good] = np.eye(c)
    inverse = np.linalg.inv(G)
    offset = np.einsum("kai,kai->ka", normals, points - middle[:, None])
    at = middle + np.einsum("kai,kab,kb->ki", normals, inverse, offset)
    reach = np.linalg.norm(points - np.roll(points, 1, axis=1), axis=2).max(axis=1)
    good &= np.linalg.norm(at - middle, axis=1) <= FARTHEST * reach
    NG = np.einsum("kai,kab->kib", normals, inverse)
    along = (np.eye(3) - np.einsum("kib,kbj->kij", NG, normals)) / c
    by_corner = along[:, None] + np.einsum("kib,kbj->kbij", NG, normals)
    at[~good], by_corner[~good] = middle[~good], np.eye(3) / c
    return PlaneIntersection(at, by_corner, good)


def crossing_edges(skin: LinearMesh, angle_rad: float) -> tuple[I64, F64, F64]:
    """Number (m, 3) of the edge from each corner to the next, −1 where its ends are of one face;
    its ends (e, 2) and normals (e, 2, 3).
    """
    t = skin.triangles
    order, start, _ = edge_table(t)
    first = order[start[:-1]]
    tri, k = first // 3, first % 3
    n = np.stack([skin.normals[tri, k], skin.normals[tri, (k + 1) % 3]], axis=1)
    crosses = np.einsum("ei,ei->e", n[:, 0], n[:, 1]) < np.cos(angle_rad)
    number = np.where(crosses, np.cumsum(crosses) - 1, -1)
    of_half = np.empty(3 * len(t), np.int64)
    of_half[order] = np.repeat(number, np.diff(start))
    ends = np.stack([t[tri, k], t[tri, (k + 1) % 3]], axis=1)
    return of_half.reshape(-1, 3), ends[crosses].astype(np.int64), n[crosses]


def sharpen(skin: LinearMesh, angle_rad: float = SHARP_RAD) -> tuple[LinearMesh, int]:
    """Complete the edges and corners between faces whose normals enclose more than ``angle_rad``;
    also how many vertices were added.

    Where the planes of two ends do not meet near them, the edge is halved and stays cut off.
    """
    number, ends, pairs = crossing_edges(skin, angle_rad)
    if len(ends) == 0:
        return skin, 0
    v, t, n = skin.vertices, skin.triangles, len(skin.vertices)
    edge = plane_intersection(v[ends], pairs)
    corners = np.flatnonzero((number >= 0).all(axis=1))
    inner = plane_intersection(v[t[corners]], skin.normals[corners])
    # planes that meet in no point: the middle of the three edges
    for c in np.flatnonzero(~inner.good):
        inner.at[c] = edge.at[number[corners[c]]].mean(axis=0)
    middle = n + number
    centre = np.full(len(t), -1, np.int64)
    centre[corners] = n + len(ends) + np.arange(len(corners))
    triangles, parent, corner = subdivide(t, middle, number >= 0, centre, v, edge.at, n)
    rows = np.concatenate(
        [np.repeat(np.arange(len(ends)), 2), len(ends) + np.repeat(np.arange(len(corners)), 3)]
    )
    columns = np.concatenate([ends.ravel(), t[corners].ravel()]).astype(np.int64)
    values = np.concatenate([edge.by_corner.reshape(-1, 3, 3), inner.by_corner.reshape(-1, 3, 3)])
    new = np.concatenate([edge.at, inner.at])
    by_vertices = blocks(rows, columns, values, (len(new), n))
    normals = skin.normals[parent[:, None], corner]
    made = extend_mesh(
        skin,
        new,
        EDGE,
        by_vertices,
        np.zeros((3 * len(new), 3)),
        Faces(triangles, normals, skin.face[parent]),
    )
    return made, len(new)


class _Parts:
    """Triangles as they are cut; the ``whole`` ones (w,) of t (m, 3) come first."""

    def __init__(self, t: I32, whole: I64) -> None:
        self.out = [t[whole].astype(np.int64)]
        self.parent = [whole]
        self.corner = [np.tile(np.arange(3), (len(whole), 1))]

    def add(self, rows: I64, corners: list[I64], normals: list[I64 | int]) -> None:
        """Parts with these corners (k,) each of the triangles ``rows`` (k,), and of which of their
        corners each has the normal.
        """
        self.out.append(np.stack(corners, axis=1))
        self.parent.append(rows)
        self.corner.append(
            np.stack([np.broadcast_to(np.asarray(k), rows.shape) for k in normals], axis=1)
        )


def subdivide(
    t: I32, middle: I64, crosses: Bool, centre: I64, v: F64, at: F64, n: int
) -> tuple[I32, I64, I64]:
    """Triangles (k, 3) cut at the vertices ``middle`` (m, 3) of their crossing edges and ``centre``
    (m,) of their corners, the triangle each comes from (k,), and of which of its corners each has
    the normal (k, 3).
    """
    count = crosses.sum(axis=1)
    parts = _Parts(t, np.flatnonzero(count == 0))
    add = parts.add
    position = np.concatenate([v, at])
    three = np.flatnonzero(count == 3)
    for k in range(3):
        j, before = (k + 1) % 3, (k + 2) % 3
        a, b, c = t[:, k].astype(np.int64), t[:, j].astype(np.int64), t[:, before].astype(np.int64)
        add(three, [a[three], middle[three, k], centre[three]], [k, k, k])
        add(three, [a[three], centre[three], middle[three, before]], [k, k, k])
        # one crossing edge, from corner k
        one = np.flatnonzero((count == 1) & crosses[:, k])
        add(one, [a[one], middle[one, k], c[one]], [k, k, before])
        add(one, [middle[one, k], b[one], c[one]], [j, j, before])
        # two: corner k is alone; what is left is cut along its shorter diagonal
        two = np.flatnonzero((count == 2) & ~crosses[:, j])
        p, q = middle[:, k], middle[:, before]
        add(two, [a[two], p[two], q[two]], [k, k, k])
        first = np.linalg.norm(position[p[two]] - position[c[two]], axis=1) <= np.linalg.norm(
            position[q[two]] - position[b[two]], axis=1
        )
        x, y = two[first], two[~first]
        add(x, [p[x], b[x], c[x]], [j, j, before])
        add(x, [p[x], c[x], q[x]], [j, before, before])
        add(y, [p[y], b[y], q[y]], [j, j, before])
        add(y, [q[y], b[y], c[y]], [before, j, before])
    return (
        np.concatenate(parts.out).astype(np.int32),
        np.concatenate(parts.parent),
        np.concatenate(parts.corner),
    )
