"""Which corners of triangles are one vertex: those at one position or, along open edges, that
differ in their last digits; and not those of sheets that touch.

A file that lists each triangle with its own corners (STL) cannot say that two bodies touch along an
edge: that edge then has four triangles. Sorted by their angle about the edge they come in pairs
that have the body between them, and each pair is a sheet of its own. Two faces with the same
corners that look at one another have nothing between them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ladar_volume.ground.clusters import flatten_roots
from ladar_volume.math.kernels import kernel
from ladar_volume.math.union_find import root_of
from ladar_volume.mesh.topology import edge_table, vertices_of
from ladar_volume.model.records import F64, I32, I64


def weld(vertices: F64, triangles: I32, tolerance_m: float = 0.0) -> tuple[F64, I32, int]:
    """One vertex for all at one position, or joined by steps within the tolerance: vertices,
    triangles, and how many triangles collapsed and were dropped. The first vertex of each group
    stands for it; those in no triangle go.
    """
    v, t = np.asarray(vertices, dtype=np.float64), np.asarray(triangles, dtype=np.int64)
    _, first, group = np.unique(v + 0.0, axis=0, return_index=True, return_inverse=True)
    if tolerance_m > 0.0:
        near = cKDTree(v[first]).query_pairs(tolerance_m, output_type="ndarray")
        graph = coo_matrix(
            (np.ones(len(near), np.int8), (near[:, 0], near[:, 1])), shape=(len(first), len(first))
        )
        label = connected_components(graph, directed=False)[1]
        earliest = np.full(int(label.max()) + 1, len(v), np.int64)
        np.minimum.at(earliest, label, first)
        first = earliest[label]
    t = first[group.ravel()][t]
    good = (t[:, 0] != t[:, 1]) & (t[:, 1] != t[:, 2]) & (t[:, 2] != t[:, 0])
    used, index = np.unique(t[good], return_inverse=True)
    return v[used], index.reshape(-1, 3).astype(np.int32), int((~good).sum())


@dataclass(frozen=True)
class WeldedMesh:
    """triangles : (m, 3) with one name for each vertex that was joined · dropped : triangles that
    collapsed · joined : vertices that another one stands for · farthest_m : between two of them
    """

    triangles: I32
    dropped: int
    joined: int
    farthest_m: float


#: What vertices along open edges may be apart in a mesh that was written vertex by vertex, as parts
#: of its size: what double, single and few printed digits leave, tried in this order.
GAPS = (1e-8, 1e-7, 1e-6)


def open_edges(triangles: I32) -> I64:
    """Half edges (b,) ``3 t + k`` that no other triangle shares."""
    order, start, _ = edge_table(triangles)
    out: I64 = order[start[:-1][np.diff(start) == 1]]
    return out


def join_within(vertices: F64, triangles: I32, tolerance_m: float) -> WeldedMesh:
    """The vertices along open edges that lie within the tolerance of one another, by steps, become
    one; all others stay as they are. The first stands for each group.
    """
    half = open_edges(triangles)
    ends = np.unique(
        np.concatenate([triangles.ravel()[half], triangles[:, [1, 2, 0]].ravel()[half]])
    )
    _, first, place = np.unique(
        vertices[ends] + 0.0, axis=0, return_index=True, return_inverse=True
    )
    at = vertices[ends[first]]
    near = cKDTree(at).query_pairs(tolerance_m, output_type="ndarray")
    graph = coo_matrix(
        (np.ones(len(near), np.int8), (near[:, 0], near[:, 1])), shape=(len(at), len(at))
    )
    label = connected_components(graph, directed=False)[1][place.ravel()]
    earliest = np.full(int(label.max(initial=-1)) + 1, len(vertices), np.int64)
    np.minimum.at(earliest, label, ends)
    name = np.arange(len(vertices), dtype=np.int64)
    name[ends] = earliest[label]
    t = name[triangles]
    good = (t[:, 0] != t[:, 1]) & (t[:, 1] != t[:, 2]) & (t[:, 2] != t[:, 0])
    apart = np.linalg.norm(vertices[ends] - vertices[name[ends]], axis=1)
    return WeldedMesh(
        t[good].astype(np.int32),
        int(np.count_nonzero(~good)),
        int(np.count_nonzero(name[ends] != ends)),
        float(apart.max(initial=0.0)),
    )


def weld_open(vertices: F64, triangles: I32) -> WeldedMesh:
    """A mesh whose triangles were written with vertices of their own, or with coordinates that
    differ in the last digits, joined along its open edges.

    vertices : (n, 3) m · triangles : (m, 3) without a vertex twice. Of :data:`GAPS` that one is
    taken which leaves the fewest edges open without more triangles collapsing, the smallest where
    several do. Rounding of coordinates far from their origin widens them: 4 steps of a double.
    """
    if len(triangles) == 0 or len(open_edges(triangles)) == 0:
        return WeldedMesh(triangles, 0, 0, 0.0)
    used = vertices[vertices_of(triangles)]
    size = float(np.linalg.norm(np.ptp(used, axis=0)))
    least = 4.0 * float(np.spacing(np.abs(used).max()))
    best: WeldedMesh | None = None
    fewest = len(open_edges(triangles)) + 1
    for share in GAPS:
        found = join_within(vertices, triangles, max(share * size, least))
        left = len(open_edges(found.triangles))
        if left < fewest and (best is None or found.dropped <= best.dropped):
            best, fewest = found, left
        if fewest == 0:
            break
    return best or WeldedMesh(triangles, 0, 0, 0.0)


def distinct_triangles(triangles: I32) -> tuple[I32, int]:
    """Triangles (m, 3), in order, of which each set of corners is there once, and how many were
    copies; none of two that look at one another and whose edges have an even number of triangles
    without them, for these are the two sides of nothing. Where half of a mesh and more is there
    both ways, it was written with two sides, and one of them stays.
    """
    corners = np.sort(triangles, axis=1)
    order = np.lexsort((corners[:, 2], corners[:, 1], corners[:, 0]))
    new = np.ones(len(order), bool)
    new[1:] = (corners[order[1:]] != corners[order[:-1]]).any(axis=1)
    if new.all():
        return triangles, 0
    group = np.empty(len(order), np.int64)
    group[order] = np.cumsum(new) - 1
    count = np.bincount(group)
    up = (triangles[:, 0] < triangles[:, 1]).astype(np.int64)
    up += triangles[:, 1] < triangles[:, 2]
    up += triangles[:, 2] < triangles[:, 0]
    net = np.bincount(group, np.where(up == 2, 1, -1))
    both_ways = (count == 2) & (net == 0)
    gone = np.zeros(len(count), bool)
    if 4 * np.count_nonzero(both_ways) < len(triangles):
        sides, start, _ = edge_table(triangles)
        uses = np.empty(len(sides), np.int64)
        uses[sides] = np.repeat(np.diff(start), np.diff(start))
        even = (uses.reshape(-1, 3) % 2 == 0).all(axis=1)
        gone = both_ways & (np.bincount(group, ~even) == 0)
    keep = np.zeros(len(triangles), bool)
    # lexsort is stable: the first of each group is its first in the file
    keep[order[new]] = ~gone[group[order[new]]]
    return triangles[keep], int((count - 1)[~gone].sum())


def split_edges(vertices: F64, triangles: I32) -> tuple[F64, I32, I64]:
    """Vertices, triangles (m, 3) in which an edge with an even number of triangles, more than two,
    is parted into pairs where their orientation says which belong together; and the row (n,) that
    each vertex was. Nothing changes where there is no such edge.
    """
    same = np.arange(len(vertices), dtype=np.int64)
    order, start, _ = edge_table(triangles)
    uses = np.diff(start)
    if not (uses > 2).any():
        return vertices, triangles, same
    one, two = start[:-1][uses == 2], start[:-1][uses == 2] + 1
    pairs = [np.stack([order[one], order[two]], axis=1)]
    for e in np.flatnonzero(uses > 2):
        found = pair_half_edges(vertices, triangles, order[start[e] : start[e + 1]])
        if found is None:
            return vertices, triangles, same  # whoever needs a manifold refuses it
        pairs.append(found)
    parted, copies = part_fans(triangles, np.concatenate(pairs), len(vertices))
    source = np.concatenate([same, copies])
    return vertices[source], parted, source


def pair_half_edges(vertices: F64, triangles: I32, half: I64) -> I64 | None:
    """Half edges (k,) ``3 t + c`` of one edge in pairs (k / 2, 2) with the body between; None where
    as many do not run along the edge as against it.

    Folds of no width have triangles at one angle, which rounding puts in any order: pairs then nest
    as brackets do.
    """
    a, b = triangles.ravel()[half], triangles[:, [1, 2, 0]].ravel()[half]
    low, high = min(a[0], b[0]), max(a[0], b[0])
    along = a == low
    if 2 * np.count_nonzero(along) != len(half):
        return None
    axis = vertices[high] - vertices[low]
    d = vertices[triangles[:, [2, 0, 1]].ravel()[half]] - vertices[low]
    d -= np.outer(d @ axis, axis) / (axis @ axis)
    u = d[0] / max(float(np.linalg.norm(d[0])), 1e-300)
    w = np.cross(axis, u) / np.linalg.norm(axis)
    by_angle = np.lexsort((along, np.arctan2(d @ w, d @ u)))
    # the body lies counter-clockwise of a triangle that runs against the edge, up to one along it
    step = np.where(along[by_angle], -1, 1)
    by_angle = np.roll(by_angle, -int(np.argmin(np.cumsum(step)) + 1))
    out: list[tuple[int, int]] = []
    opened: list[int] = []
    for h in by_angle.tolist():
        if along[h]:
            out.append((int(half[opened.pop()]), int(half[h])))
        else:
            opened.append(h)
    return np.array(out, dtype=np.int64)


@kernel
def corner_fans(triangles: I32, one: I64, other: I64) -> I64:
    """The first corner (3m,) of the fan that each corner of triangles (m, 3) is in, which edges
    join: half edges ``one`` and ``other`` (e,) of two triangles each.
    """
    corner = triangles.ravel()
    root = np.arange(len(corner))
    for e in range(len(one)):
        i, t = one[e], other[e] // 3 * 3
        for a in (i, i // 3 * 3 + (i + 1) % 3):
            b = t
            while corner[b] != corner[a]:
                b += 1
            p, q = root_of(root, a), root_of(root, b)
            root[max(p, q)] = min(p, q)
    flatten_roots(root)
    return root


def part_fans(triangles: I32, pairs: I64, vertices: int) -> tuple[I32, I64]:
    """Triangles (m, 3) in which only the pairs (k, 2) of half edges hang together: each fan round a
    vertex has one of its own. The first fan of a vertex keeps it; the others get vertices after the
    last of ``vertices``, copies of those returned (c,).
    """
    root = np.asarray(corner_fans(triangles, pairs[:, 0], pairs[:, 1]))
    begins = root == np.arange(len(root))
    first, fan = np.flatnonzero(begins), (np.cumsum(begins) - 1)[root]
    vertex = triangles.ravel()[first].astype(np.int64)
    name = np.full(len(first), -1, np.int64)
    earliest = np.unique(vertex, return_index=True)[1]
    name[earliest] = vertex[earliest]
    more = np.flatnonzero(name < 0)
    name[more] = vertices + np.arange(len(more))
    return name[fan].reshape(-1, 3).astype(np.int32), vertex[more]
