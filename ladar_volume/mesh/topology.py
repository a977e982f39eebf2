"""What a triangle mesh is: its edges, boundary, parts and orientation (seed 002 section 7.1: every
edge has one or two triangles).

Orientation is propagated over shared edges and triangles that disagree with most of their part are
turned; only a mesh that cannot be oriented at all (a Moebius strip) or whose edges have three
triangles is refused.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ladar_volume.math.kernels import kernel
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I32, I64, Bool


@dataclass(frozen=True)
class OrientedMesh:
    """A mesh with consistent orientation within each part.

    triangles : (m, 3) int32 · flipped : (m,) bool, triangles that were turned · part : (m,) int32,
    parts joined by edges, numbered by their first triangle · boundary : (b, 2) directed edges with
    one triangle · edges : number of edges · vertices : number of vertices in use
    """

    triangles: I32
    flipped: Bool
    part: I32
    boundary: I32
    edges: int
    vertices: int

    @property
    def euler(self) -> int:
        """V − E + F: 2 for each closed body without handles, 0 for a torus."""
        return self.vertices - self.edges + len(self.triangles)


def check_mesh(vertices: F64, triangles: npt.ArrayLike) -> tuple[F64, I32]:
    """Vertices (n, 3) float64 and triangles (m, 3) int32.

    Raises :class:`SurfaceError`: mesh_shape, mesh_empty, mesh_not_finite, mesh_index (out of
    range), mesh_degenerate (a triangle that has a vertex twice; weld drops these).
    """
    v, t = np.asarray(vertices, dtype=np.float64), np.asarray(triangles)
    if (
        v.ndim != 2
        or v.shape[1:] != (3,)
        or t.ndim != 2
        or t.shape[1:] != (3,)
        or (len(t) and t.dtype.kind not in "iu")
    ):
        raise SurfaceError(
            f"a mesh has vertices (n, 3) and triangles (m, 3) of indices, not {v.shape}, {t.shape}",
            reason="mesh_shape",
        )
    if len(t) == 0:
        raise SurfaceError("the mesh has no triangle", reason="mesh_empty")
    if int(t.min()) < 0 or int(t.max()) >= len(v):
        raise SurfaceError(
            f"a triangle names vertex {int(t.max())} of {len(v)}",
            reason="mesh_index",
            value=int(t.max()),
        )
    if not (
        np.isfinite(v).all() or np.isfinite(v[t]).all()
    ):  # vertices in no triangle may be what they like
        raise SurfaceError(
            "a vertex with a coordinate that is not finite", reason="mesh_not_finite"
        )
    twice = (t[:, 0] == t[:, 1]) | (t[:, 1] == t[:, 2]) | (t[:, 2] == t[:, 0])
    if twice.any():
        raise SurfaceError(
            f"{int(twice.sum())} triangles have a vertex twice; weld the mesh first",
            reason="mesh_degenerate",
            value=np.flatnonzero(twice),
        )
    return v, t.astype(np.int32)


def vertices_of(triangles: I32) -> I64:
    """The vertices (k,) of triangles (m, 3), ascending."""
    return np.flatnonzero(np.bincount(triangles.ravel()))


def edge_table(triangles: I32) -> tuple[I64, I64, I64]:
    """Edges sorted by their ends: order (3m,) of the half edges ``3 t + k`` (from corner k to the
    next), start (e + 1,) of each edge in it, and both ends as one number (3m,).
    """
    a, b = triangles.astype(np.int64).ravel(), triangles[:, [1, 2, 0]].astype(np.int64).ravel()
    low, high = np.minimum(a, b), np.maximum(a, b)
    key, many = low << 32 | high, int(high.max(initial=-1)) + 1
    order = counting_sort(low, counting_sort(high, np.arange(len(key)), many), many)
    new = np.flatnonzero(np.diff(key[order])) + 1
    return order, np.concatenate([[0], new, [len(order)]]).astype(np.int64), key


@kernel
def counting_sort(value: I64, order: I64, many: int) -> I64:
    """An order (n,) sorted by values (n,) below ``many``; equal ones stay as they are."""
    place, out = np.zeros(many + 1, np.int64), np.empty(len(order), np.int64)
    for v in value:
        place[v + 1] += 1
    place = np.cumsum(place)
    for i in order:
        out[place[value[i]]] = i
        place[value[i]] += 1
    return out


def watertight(triangles: I32) -> bool:
    """Whether triangles (m, 3) have no boundary: every edge is run through as often one way as the
    other.
    """
    order, start, _ = edge_table(triangles)
    way = np.where(triangles < triangles[:, [1, 2, 0]], 1, -1).ravel()[order]
    return len(triangles) > 0 and not np.add.reduceat(way, start[:-1]).any()


@kernel
def spread_kernel(neighbour: I32, agrees: Bool, part: I32, turned: Bool) -> int:
    """Number the parts and mark triangles to turn so that each agrees with the first of its part;
    -1, or a triangle that cannot agree.
    """
    stack, parts = np.empty(len(part), np.int64), 0
    for first in range(len(part)):
        if part[first] >= 0:
            continue
        part[first], stack[0], top = parts, first, 1
        while top > 0:
            top -= 1
            t = stack[top]
            for k in range(3):
                o = neighbour[t, k]
                if o < 0:
                    continue
                turn = turned[t] == agrees[t, k]
                if part[o] < 0:
                    part[o], turned[o], stack[top] = parts, turn, o
                    top += 1
                elif turned[o] != turn:
                    return int(t)
        parts += 1
    return -1


def orient(vertices: F64, triangles: npt.ArrayLike) -> OrientedMesh:
    """Parts and consistent orientation of a mesh, open or closed; in each part the fewer triangles
    are turned.

    Raises :class:`SurfaceError` as :func:`check_mesh`, mesh_non_manifold (edges with more than two
    triangles; value: the edges (k, 2)) and mesh_non_orientable.
    """
    _, t = check_mesh(vertices, triangles)
    order, start, key = edge_table(t)
    uses = np.diff(start)
    _check_manifold(key[order[start[:-1][uses > 2]]])
    pair = start[:-1][uses == 2]
    i, j = order[pair], order[pair + 1]
    neighbour, agrees = np.full(3 * len(t), -1, np.int32), np.zeros(3 * len(t), bool)
    neighbour[i], neighbour[j] = j // 3, i // 3
    # two triangles agree where they run along their edge in opposite directions
    agrees[i] = agrees[j] = t.ravel()[i] != t.ravel()[j]
    part, turned = np.full(len(t), -1, np.int32), np.zeros(len(t), bool)
    fault = int(spread_kernel(neighbour.reshape(-1, 3), agrees.reshape(-1, 3), part, turned))
    if fault >= 0:
        raise SurfaceError(
            (
                "the mesh is not orientable (a Moebius strip or a Klein bottle), seen at "
                f"triangle {fault}"
            ),
            reason="mesh_non_orientable",
            value=fault,
        )
    size, many = np.bincount(part), np.bincount(part, turned)
    turned ^= (2 * many > size)[part]
    out = t.copy()
    out[turned] = t[turned][:, [0, 2, 1]]
    alone = order[start[:-1][uses == 1]]
    edge = np.stack([t.ravel()[alone], t[:, [1, 2, 0]].ravel()[alone]], axis=1)
    back = turned[alone // 3]
    edge[back] = edge[back][:, ::-1]
    return OrientedMesh(out, turned, part, edge.astype(np.int32), len(uses), len(vertices_of(t)))


def _check_manifold(bad: I64) -> None:
    """Refuses edges, by key, of more than two triangles."""
    if len(bad):
        raise SurfaceError(
            f"{len(bad)} edges have more than two triangles: remove double or inner faces, or "
            "repair the mesh",
            reason="mesh_non_manifold",
            value=np.stack([bad >> 32, bad & 0xFFFFFFFF], axis=1),
        )


def check_closed(mesh: OrientedMesh) -> None:
    """Raises :class:`SurfaceError` (mesh_open; value: the open edges) where the mesh has a
    boundary.
    """
    if len(mesh.boundary):
        raise SurfaceError(
            f"the mesh is open along {len(mesh.boundary)} edges: it has no volume until "
            "it is closed (or welded, where its vertices are "
            "double)",
            reason="mesh_open",
            value=mesh.boundary,
        )
