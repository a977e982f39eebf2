"""Taking vertices out of a triangulation, and the walks round a vertex that this and the search for
the nearest vertex need.

The hole that a vertex leaves is closed ear by ear: an ear is three consecutive vertices of the rim
whose circle holds no other vertex of the rim, so every triangle is final (Devillers 2002, "On
deletion in Delaunay triangulations", without its queue: rims are short). The vertex at infinity is
a vertex of the rim like any other; its circles are half planes.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.model.kernels import kernel
from ladar_volume.model.records import F64, I32, I64
from ladar_volume.surface.mesh import (
    GHOST,
    VERTEX,
    MeshTable,
    insert_point,
    link,
    locate,
    put,
    turn,
)
from ladar_volume.surface.predicates import incircle


@kernel
def around(m: MeshTable, t: int, k: int) -> tuple[int, int]:
    """The next triangle counter-clockwise about corner k of t, and which of its corners that vertex
    is.
    """
    h = m[t, 4 + (k + 1) % 3]
    return h >> 2, ((h & 3) + 1) % 3


@kernel
def real_beside(m: MeshTable, t: int) -> int:
    """Triangle t where it is real, else the real one at its hull edge."""
    for k in range(3):
        if m[t, k] == GHOST:
            return int(m[t, 4 + k] >> 2)
    return t


@kernel
def nearest(xy: F64, m: MeshTable, t: int, x: float, y: float) -> tuple[int, float]:
    """The vertex nearest to a position and the squared distance, going downhill from triangle t: in
    a Delaunay triangulation every vertex but the nearest has a neighbour that is nearer.
    """
    least, at, corner = np.inf, t, 0
    for k in range(3):
        v = m[t, k]
        if v != GHOST:
            d = (xy[v, 0] - x) ** 2 + (xy[v, 1] - y) ** 2
            if d < least:
                least, corner = d, k
    better = True
    while better:
        better, s, k = False, at, corner
        while True:
            v = m[s, (k + 1) % 3]
            if v != GHOST:
                d = (xy[v, 0] - x) ** 2 + (xy[v, 1] - y) ** 2
                if d < least:
                    least, at, corner, better = d, s, (k + 1) % 3, True
                    break
            s, k = around(m, s, k)
            if s == at:
                break
    return int(m[at, corner]), least


@kernel
def conflict(xy: F64, a: int, b: int, c: int, q: int, w: F64) -> bool:
    """Whether vertex q lies inside the circle of triangle a, b, c; at infinity: beyond its hull
    edge, or on it between the ends.
    """
    if q == GHOST:
        return False
    if a != GHOST and b != GHOST and c != GHOST:
        return incircle(xy, a, b, c, q, w) > 0.0
    if b == GHOST:
        a, b, c = b, c, a
    elif c == GHOST:
        a, b, c = c, a, b
    side = turn(xy, b, c, q, w)
    if side != 0.0:
        return side > 0.0
    # collinear: between in the coordinate in which the edge is not degenerate
    d = 0 if xy[b, 0] != xy[c, 0] else 1
    return bool(min(xy[b, d], xy[c, d]) < xy[q, d] < max(xy[b, d], xy[c, d]))


@kernel
def is_ear(xy: F64, rim: I64, n: int, i: int, w: F64) -> bool:
    """Whether rim vertices i - 1, i, i + 1 of n form a triangle of the triangulation that is to
    fill the hole.
    """
    h, j = (i + n - 1) % n, (i + 1) % n
    a, b, c = rim[h], rim[i], rim[j]
    if a != GHOST and b != GHOST and c != GHOST and turn(xy, a, b, c, w) <= 0.0:
        return False
    for k in range(n):
        if k != h and k != i and k != j and conflict(xy, a, b, c, rim[k], w):
            return False
    return True


@kernel
def flat_without(xy: F64, rim: I64, vertices: int, w: F64) -> bool:
    """Whether nothing but one line is left of so many vertices when the one with this rim goes."""
    a, b, real = GHOST, GHOST, 0
    for v in rim:
        if v == GHOST:
            continue
        real += 1
        if a == GHOST:
            a = v
        elif b == GHOST:
            b = v
        elif turn(xy, a, b, v, w) != 0.0:
            return False
    return bool(real == vertices - 1)


@kernel
def move_row(m: MeshTable, source: int, target: int) -> None:
    """Move triangle ``source`` to row ``target``."""
    if source != target:
        m[target] = m[source]
        for k in range(3):
            link(m, 4 * target + k, m[source, 4 + k])


@kernel
def fill(xy: F64, m: MeshTable, rim: I64, outer: I64, rows: I64, w: F64) -> int:
    """Close the hole with this rim; ``outer[i]`` is the corner that faces the edge from rim vertex
    i on. Returns the last triangle.
    """
    n, i, used = len(rim), 0, 0
    while n > 3:
        if not is_ear(xy, rim, n, i, w):
            i = (i + 1) % n
            continue
        h, j, t = (i + n - 1) % n, (i + 1) % n, rows[used]
        put(m, t, rim[h], rim[i], rim[j])
        link(m, 4 * t + 2, outer[h])
        link(m, 4 * t, outer[i])
        outer[h] = 4 * t + 1
        rim[i : n - 1] = rim[i + 1 : n].copy()
        outer[i : n - 1] = outer[i + 1 : n].copy()
        n, used = n - 1, used + 1
        # the ear before this one has a new corner
        i = (i + n - 1) % n
    t = rows[used]
    put(m, t, rim[0], rim[1], rim[2])
    for k in range(3):
        link(m, 4 * t + (k + 2) % 3, outer[k])
    return int(t)


@kernel
def remove_vertex(xy: F64, m: MeshTable, size: int, t: int, k: int, w: F64) -> tuple[int, int]:
    """Remove corner k of triangle t from the triangles m[:size]: returns their new number (two
    fewer) and a real triangle near by.

    Where nothing but a line would be left the table stays as it is and the number returned is -1.
    """
    degree, s, c = 1, *around(m, t, k)
    while s != t:
        s, c = around(m, s, c)
        degree += 1
    rim, outer, rows = (
        np.empty(degree, np.int64),
        np.empty(degree, np.int64),
        np.empty(degree, np.int64),
    )
    s, c = t, k
    for i in range(degree):
        rim[i], outer[i], rows[i] = m[s, (c + 1) % 3], m[s, 4 + c], s
        s, c = around(m, s, c)
    if flat_without(xy, rim, size // 2 + 1, w):
        return -1, t
    rows.sort()
    last = fill(xy, m, rim, outer, rows, w)
    hint = real_beside(m, last)
    for i in (degree - 1, degree - 2):
        size -= 1
        move_row(m, size, rows[i])
        if hint == size:
            hint = rows[i]
    return size, hint


@kernel
def remove_kernel(
    xy: F64, m: MeshTable, size: int, hint: int, gone: I64, w: F64
) -> tuple[int, int, int]:
    """Remove the vertices ``gone`` one after the other; returns the number of triangles, a real
    one, and how many could be removed.
    """
    for i in range(len(gone)):
        t, where = locate(xy, m, hint, gone[i], w)
        less, hint = remove_vertex(xy, m, size, t, where - VERTEX, w)
        if less < 0:
            return size, real_beside(m, hint), i
        size = less
    return size, hint, len(gone)


@kernel
def insert_within(
    xy: F64,
    m: MeshTable,
    size: int,
    hint: int,
    start: int,
    order: I32,
    square: float,
    same: I64,
    w: F64,
) -> tuple[int, int]:
    """Insert the points ``start + order[i]`` one after the other; one whose squared distance to the
    nearest vertex is no more than ``square`` stays out, and ``same[order[i]]`` is that vertex.
    Returns the number of triangles and a real one.
    """
    for i in range(len(order)):
        p = start + order[i]
        t, where = locate(xy, m, hint, p, w)
        v, d = nearest(xy, m, t, xy[p, 0], xy[p, 1])
        hint = real_beside(m, t)
        same[order[i]] = v
        if d > square and where < VERTEX:
            size, hint, _ = insert_point(xy, m, size, hint, p, w)
            same[order[i]] = p
    return size, hint
