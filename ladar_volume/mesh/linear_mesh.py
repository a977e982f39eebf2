"""A mesh whose every vertex, measured or made, is known as a linear function of the measured points
and of the ground.

Edges completed where faces meet, rims brought down to the ground and gaps closed
(:mod:`~ladar_volume.mesh.edge_completion`, :mod:`~ladar_volume.mesh.closing`) make new vertices out
of measured ones. Each carries its derivatives, so that the gradient of a volume goes back to what
was measured (UNCERTAINTY step 1) and no made vertex is taken for an observation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import bmat, csr_matrix, identity

from ladar_volume.mesh.topology import orient
from ladar_volume.model.records import F64, I32, I64, Bool

#: What a vertex is: a measured point, on an edge or corner where faces meet, in a closed gap, on
#: the ground.
MEASURED, EDGE, GAP, GROUND = range(4)
#: Names of these, and of what a triangle is.
KINDS = ("measured", "edge", "gap", "ground")


@dataclass(frozen=True)
class LinearMesh:
    """A mesh and where it comes from.

    vertices : (n, 3) m, the k measured ones first · triangles : (m, 3), counter-clockwise from
    outside · normals : (m, 3, 3) outward unit normals of the surface at the corners of each
    triangle, NaN where not known; at an edge the triangles of its two sides differ · kind : (n,) of
    each vertex · curved : (n,) whether the surface there is curved, so that chords leave some of it
    out · face : (m,) int8, MEASURED or what closed it (GAP, GROUND) · by_measured : (3n, 3k)
    sparse, derivative of the vertices by the measured ones · by_ground : (3n, 3), by the height of
    the ground at its origin and its two slopes
    """

    vertices: F64
    triangles: I32
    normals: F64
    kind: I32
    curved: Bool
    face: I32
    by_measured: csr_matrix
    by_ground: F64

    @property
    def measured_count(self) -> int:
        """Number of measured points, k."""
        return int(self.by_measured.shape[1]) // 3


def vertex_normals(vertices: F64, triangles: I32) -> F64:
    """Unit normals (n, 3) of the vertices, by area of their triangles; zero where a vertex has
    none.
    """
    p = vertices[triangles]
    area = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    total = np.stack(
        [np.bincount(triangles.ravel(), np.repeat(area[:, k], 3), len(vertices)) for k in range(3)],
        axis=1,
    )
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.asarray(total / np.where(length > 0.0, length, 1.0))


def orient_outward(vertices: F64, triangles: I32) -> I32:
    """Triangles (m, 3) of a mesh, open or closed, each part turned so that it encloses a positive
    volume.

    The rims of an open part are spanned from their middle. Cavities of closed parts are turned
    outward too; the volume sees to them. Raises :class:`SurfaceError` as
    :func:`~ladar_volume.mesh.topology.orient`.
    """
    mesh = orient(vertices, triangles)
    rim = mesh.part[np.isin(mesh.triangles, mesh.boundary).any(axis=1)]
    t = mesh.triangles
    for part in range(int(mesh.part.max()) + 1):
        rows = np.flatnonzero(mesh.part == part)
        on = (
            np.intersect1d(mesh.triangles[rows], mesh.boundary)
            if part in rim
            else mesh.triangles[rows].ravel()
        )
        a, b, c = (vertices[t[rows, k]] - vertices[on].mean(axis=0) for k in range(3))
        if float(np.einsum("ni,ni->", a, np.cross(b, c))) < 0.0:
            t[rows] = t[rows][:, [0, 2, 1]]
    return t


def linear_mesh(
    vertices: F64, triangles: I32, normals: F64 | None = None, curved: Bool | None = None
) -> LinearMesh:
    """A mesh of measured vertices (n, 3), turned outward, and its normals (n, 3), of either sign,
    where known.

    curved : (n,), by default wherever normals are known. A plane fitted to a curved surface lies as
    much within it as outside: its chords have nothing to give back. Raises :class:`SurfaceError` as
    :func:`~ladar_volume.mesh.topology.orient`.
    """
    v = np.asarray(vertices, dtype=np.float64)
    t = orient_outward(v, triangles)
    corner = np.full((len(t), 3, 3), np.nan)
    if normals is not None:
        sign = np.einsum("ni,ni->n", normals, vertex_normals(v, t))
        corner = (np.where(sign < 0.0, -1.0, 1.0)[:, None] * normals)[t]
    kind, face = np.full(len(v), MEASURED, np.int32), np.full(len(t), MEASURED, np.int32)
    bends = (
        np.full(len(v), normals is not None) if curved is None else np.asarray(curved, dtype=bool)
    )
    return LinearMesh(
        v,
        t,
        corner,
        kind,
        bends,
        face,
        identity(3 * len(v), format="csr"),
        np.zeros((3 * len(v), 3)),
    )


def blocks(rows: I64, columns: I64, values: F64, shape: tuple[int, int]) -> csr_matrix:
    """Sparse (3 r, 3 c) of blocks (b, 3, 3) at block rows and columns (b,)."""
    i = (3 * rows[:, None, None] + np.arange(3)[None, :, None]).repeat(3, axis=2)
    j = (3 * columns[:, None, None] + np.arange(3)[None, None, :]).repeat(3, axis=1)
    return csr_matrix((values.ravel(), (i.ravel(), j.ravel())), shape=(3 * shape[0], 3 * shape[1]))


class Faces(NamedTuple):
    """triangles : (m, 3) · normals : (m, 3, 3) at their corners · face : (m,) what each is, all as
    in :class:`LinearMesh`
    """

    triangles: I32
    normals: F64
    face: I32


def extend_mesh(
    skin: LinearMesh,
    new: F64,
    kind: int | I32,
    by_vertices: csr_matrix,
    by_ground: F64,
    faces: Faces,
    curved: Bool | None = None,
) -> LinearMesh:
    """The skin with new vertices (a, 3) of one kind, or (a,) kinds, and other faces.

    by_vertices : (3a, 3n), derivative of the new vertices by the old ones · by_ground : (3a, 3), by
    the ground at fixed old vertices · curved : (a,), by default not.
    """
    direct = by_ground + by_vertices @ skin.by_ground
    kinds = np.concatenate([skin.kind, np.broadcast_to(np.int32(kind), len(new))])
    by_measured = csr_matrix(bmat([[skin.by_measured], [by_vertices @ skin.by_measured]]))
    by_all = np.concatenate([skin.by_ground, direct])
    bends = np.concatenate([skin.curved, np.zeros(len(new), bool) if curved is None else curved])
    return LinearMesh(
        np.concatenate([skin.vertices, new]),
        faces.triangles,
        faces.normals,
        kinds,
        bends,
        faces.face,
        by_measured,
        by_all,
    )
