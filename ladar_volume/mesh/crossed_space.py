"""How much space a mesh that crosses itself counts wrongly.

The signed volume of a closed mesh counts a place as often as the surface winds about it; a body is
where that is once or more. Triangles that cross no other one fall into patches, on which the
winding is the same all over, so one point of each patch tells; those that cross are cut into four
and each part is asked. What winds once or more outside of a part of the surface bounds space that
counts again; these parts, by clusters that hang together and about a pole of their own, make the
volume that counts wrongly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ladar_volume.math.kernels import kernel
from ladar_volume.mesh.intersections import crossings
from ladar_volume.mesh.topology import edge_table
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I32, I64, Bool
from ladar_volume.model.verdict import Doubt

#: Share of a body that may count wrongly: up to here its volume is doubtful, above refused.
REFUSED = 1e-2
#: Share that is small beside whatever else is in a volume: named, without a doubt.
SMALL = 1e-3
#: Most pairs that are looked for, and most solid angles that are summed: beyond, every so many of
#: the crossing triangles stand for the others, and small patches are left out.
MOST, WORK = 100_000, 2_000_000_000


@dataclass(frozen=True)
class Crossing:
    """pairs : (k, 2) triangles that cross · volume_m3 : that counts wrongly, about, 0 or more"""

    pairs: I64
    volume_m3: float


@kernel
def winding_kernel(vertices: F64, triangles: I32, points: F64, own: I64) -> F64:
    """Winding number (k,) of a mesh, without the triangles ``own`` (k,), about points (k, 3): solid
    angles over 4 pi (Van Oosterom & Strackee 1983).
    """
    out = np.zeros(len(points))
    for i in range(len(points)):
        total, x, y, z = 0.0, points[i, 0], points[i, 1], points[i, 2]
        for t in range(len(triangles)):
            if t == own[i]:
                continue
            u, v, w = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            ax, ay, az = vertices[u, 0] - x, vertices[u, 1] - y, vertices[u, 2] - z
            bx, by, bz = vertices[v, 0] - x, vertices[v, 1] - y, vertices[v, 2] - z
            cx, cy, cz = vertices[w, 0] - x, vertices[w, 1] - y, vertices[w, 2] - z
            la = np.sqrt(ax * ax + ay * ay + az * az)
            lb = np.sqrt(bx * bx + by * by + bz * bz)
            lc = np.sqrt(cx * cx + cy * cy + cz * cz)
            up = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
            ab, bc = ax * bx + ay * by + az * bz, bx * cx + by * cy + bz * cz
            low = la * lb * lc + ab * lc + bc * la + (cx * ax + cy * ay + cz * az) * lb
            total += np.arctan2(up, low)
        out[i] = total / (2.0 * np.pi)
    return out


def patches(triangles: I32, cut: Bool) -> I64:
    """The patch (m,) of each triangle, joined by edges to others; those in ``cut`` (m,) stay
    alone.
    """
    order, start, _ = edge_table(triangles)
    pair = start[:-1][np.diff(start) == 2]
    i, j = order[pair] // 3, order[pair + 1] // 3
    free = ~(cut[i] | cut[j])
    return connected_groups(i[free], j[free], len(triangles))


def connected_groups(i: I64, j: I64, many: int) -> I64:
    """Number (many,) of the group of each of things that pairs i, j (k,) join."""
    graph = coo_array((np.ones(len(i), np.int8), (i, j)), shape=(many, many))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def quarter_triangles(corners: F64) -> F64:
    """Triangles (k, 3, 3) cut into four each at the middles of their sides: (k, 4, 3, 3)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    rows = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
    return np.stack([np.stack(r, axis=1) for r in rows], axis=1)


def representative_triangles(corners: F64, patch: I64) -> I64:
    """The largest triangle of each patch (m,), these by their size downwards; corners (m, 3, 3)."""
    sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(sides, axis=1)
    order = np.lexsort((-area, patch))
    out = order[np.unique(patch[order], return_index=True)[1]]
    return out[np.argsort(-area[out], kind="stable")].astype(np.int64)


def miscounted_volume(vertices: F64, triangles: I32, pairs: I64) -> float:
    """Volume, m³, that a closed mesh with the crossing pairs (k, 2) counts more or less than once,
    about. triangles : (m, 3), outward.
    """
    if len(pairs) == 0:
        return 0.0
    corners = vertices[triangles]
    cut = np.zeros(len(triangles), bool)
    cut[pairs] = True
    patch = patches(triangles, cut)
    room = max(WORK // (2 * len(triangles)), 100)
    stands = representative_triangles(corners, patch)
    stands = stands[~cut[stands]][:room]
    crossing = np.flatnonzero(cut)
    step = -(-4 * len(crossing) // room)
    crossing = crossing[::step]
    parts = quarter_triangles(corners[crossing]).reshape(-1, 3, 3)
    probes = np.concatenate([corners[stands].mean(axis=1), parts.mean(axis=1)])
    own = np.concatenate([stands, np.repeat(crossing, 4)])
    outside = np.rint(winding_kernel(vertices, triangles, probes, own) - 0.5)
    inner = np.zeros(int(patch.max()) + 1, bool)
    inner[patch[stands]] = outside[: len(stands)] != 0
    rows = np.flatnonzero(inner[patch] & ~cut)
    late = outside[len(stands) :] != 0
    pieces = np.concatenate([corners[rows], parts[late]])
    owner = np.concatenate([rows, np.repeat(crossing, 4)[late]])
    weight = np.concatenate([np.ones(len(rows)), np.full(int(late.sum()), float(step))])
    member = cut & (step > 1)  # those that were not asked hang together with their neighbours
    member[owner] = True
    cluster = clusters(triangles, pairs, member)[owner]
    return float(np.abs(cluster_volumes(pieces, cluster, weight)).sum())


def clusters(triangles: I32, pairs: I64, member: Bool) -> I64:
    """The cluster (m,) of each triangle: what edges or crossing pairs (k, 2) join among the
    members (m,).
    """
    order, start, _ = edge_table(triangles)
    pair = start[:-1][np.diff(start) == 2]
    i = np.concatenate([order[pair] // 3, pairs[:, 0]])
    j = np.concatenate([order[pair + 1] // 3, pairs[:, 1]])
    both = member[i] & member[j]
    return connected_groups(i[both], j[both], len(triangles))


def cluster_volumes(pieces: F64, cluster: I64, weight: F64) -> F64:
    """Volumes, m³, of pieces of a surface (k, 3, 3), each ``weight`` (k,) times, by clusters (k,),
    each about its own middle.
    """
    if len(pieces) == 0:
        return np.zeros(0)
    total = np.maximum(np.bincount(cluster, weight), 1e-300)
    centre = pieces.mean(axis=1) * weight[:, None]
    middle = np.stack([np.bincount(cluster, centre[:, k]) / total for k in range(3)], axis=1)
    p = pieces - middle[cluster][:, None]
    return np.bincount(
        cluster, weight * np.einsum("ki,ki->k", p[:, 0], np.cross(p[:, 1], p[:, 2])) / 6.0
    ).astype(np.float64)


def crossing_of(vertices: F64, triangles: I32) -> Crossing:
    """Which triangles (m, 3), outward, cross, and how much that counts."""
    pairs = crossings(vertices, triangles, min(MOST, 100 * len(triangles)))
    return Crossing(pairs, miscounted_volume(vertices, triangles, pairs))


def check_crossing(found: Crossing, volume_m3: float) -> None:
    """Raises :class:`SurfaceError` (mesh_self_intersecting; value: the pairs) where more than
    :data:`REFUSED` of a volume counts wrongly.
    """
    if found.volume_m3 > REFUSED * abs(volume_m3):
        many = f"{len(found.pairs):,}" + (" or more" if len(found.pairs) == MOST else "")
        raise SurfaceError(
            f"{many} pairs of triangles cross, first {found.pairs[0].tolist()}: the mesh counts "
            f"about {found.volume_m3:.3g} m³ of {abs(volume_m3):.4g} m³ twice or not at all; "
            "repair it, or join the bodies (--allow-crossings lets such space count twice)",
            reason="mesh_self_intersecting",
            value=found.pairs,
        )


def crossing_doubts(found: Crossing, volume_m3: float) -> tuple[Doubt, ...]:
    """The doubt about a volume of which more than :data:`SMALL` counts wrongly."""
    wrong, share = found.volume_m3, found.volume_m3 / max(abs(volume_m3), 1e-300)
    if share <= SMALL:
        return ()
    text = (
        f"{len(found.pairs):,} pairs of triangles cross: about {wrong:.2g} m³ "
        f"({100 * share:.2g} %) count twice or not at all; mend the mesh, or scan more densely "
        "where faces meet"
    )
    return (Doubt("mesh_crossings", text, wrong),)
