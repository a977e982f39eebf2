"""The rims of an open mesh: its boundary as loops, with no vertex twice in one, and which of them
look down to the ground.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ladar_volume.mesh.linear_mesh import Faces, LinearMesh, blocks, extend_mesh
from ladar_volume.mesh.topology import edge_table, orient
from ladar_volume.mesh.welding import part_fans
from ladar_volume.model.records import F64, I64

#: A rim looks down where the surface leaves the mesh across it with at least this mean slope (its
#: sine); across a gap the mean is 0.
LEAVES = 0.15


@dataclass(frozen=True)
class Rim:
    """vertices : (k,) int64, in the order in which a closing surface passes them, counter-clockwise
    from outside · size_m : twice the largest distance of a vertex from their middle · middle : (3,)
    m
    """

    vertices: I64
    size_m: float
    middle: F64


def place_text(p: F64) -> str:
    """A place in words."""
    return f"({p[0]:.6g}, {p[1]:.6g}, {p[2]:.6g})"


def split_fans(skin: LinearMesh) -> LinearMesh:
    """One vertex per fan of triangles: where parts touch in one vertex only, each gets its own
    copy. No rim then passes a vertex twice.
    """
    t, n = skin.triangles, len(skin.vertices)
    order, start, _ = edge_table(t)
    pair = start[:-1][np.diff(start) == 2]
    new, old = part_fans(t, np.stack([order[pair], order[pair + 1]], axis=1), n)
    if len(old) == 0:
        return skin
    copy = blocks(
        np.arange(len(old)),
        old,
        np.tile(np.eye(3), (len(old), 1, 1)),
        (len(old), n),
    )
    return extend_mesh(
        skin,
        skin.vertices[old],
        skin.kind[old],
        copy,
        np.zeros((3 * len(old), 3)),
        Faces(new, skin.normals, skin.face),
        skin.curved[old],
    )


def rims_of(skin: LinearMesh) -> list[Rim]:
    """The rims of a mesh without common vertices (:func:`split_fans`), by their first vertex.

    Raises :class:`SurfaceError` as :func:`~ladar_volume.mesh.topology.orient`.
    """
    edges = orient(skin.vertices, skin.triangles).boundary
    before = {int(b): int(a) for a, b in edges}
    left, out = set(before), []
    for first in sorted(before):
        if first not in left:
            continue
        loop = [first]
        while before[loop[-1]] != first:
            loop.append(before[loop[-1]])
        left -= set(loop)
        p = skin.vertices[loop]
        middle = p.mean(axis=0)
        out.append(
            Rim(
                np.array(loop, np.int64),
                2.0 * float(np.linalg.norm(p - middle, axis=1).max()),
                middle,
            )
        )
    return out


def mean_descent(skin: LinearMesh, rims: list[Rim], up: F64) -> F64:
    """Mean (r,) of −up · (direction in which the surface leaves the mesh) along each rim: 1 down a
    wall, 0 across a gap.
    """
    t, n = skin.triangles.astype(np.int64), len(skin.vertices)
    on = np.zeros(n, bool)
    for rim in rims:
        on[rim.vertices] = True
    along_rim = on[t] & on[t[:, [1, 2, 0]]]
    half = (t * n + t[:, [1, 2, 0]])[along_rim]
    order = np.argsort(half)
    half, opposite = half[order], t[:, [2, 0, 1]][along_rim][order]
    out = np.zeros(len(rims))
    for number, rim in enumerate(rims):
        a, b = np.roll(rim.vertices, -1), rim.vertices
        c = opposite[np.searchsorted(half, a * n + b)]
        along = skin.vertices[b] - skin.vertices[a]
        length = np.linalg.norm(along, axis=1)
        unit = along / np.where(length > 0.0, length, 1.0)[:, None]
        leave = skin.vertices[a] - skin.vertices[c]
        leave -= np.einsum("ki,ki->k", leave, unit)[:, None] * unit
        size = np.linalg.norm(leave, axis=1)
        down = -(leave @ up) / np.where(size > 0.0, size, 1.0)
        out[number] = float((down * length).sum() / max(float(length.sum()), 1e-300))
    return out
