"""Greedy insertion (seed 000 section 2.4.1), compiled: always the point the current surface misses
most, one at a time.

Every triangle keeps the list of its points that are not vertices (word 3 of its row in the triangle
table is the first, ``after`` the next of each), its worst one, and its place in a heap over all
triangles (word 7). An insertion changes the triangles round the new vertex and no others; only
their points are dealt out anew, and only their scores computed again. The cost grows as n log n.
"""

from __future__ import annotations

from typing import NamedTuple

from ladar_volume.math.kernels import inlined, kernel
from ladar_volume.model.records import F64, I32, Bool
from ladar_volume.tin.triangle_table import (
    GHOST,
    MeshTable,
    insert_point,
    is_ghost,
    legalise,
    locate,
    orientation_of,
    split_edge,
    split_triangle,
)


class Cloud(NamedTuple):
    """The points, in an order along which neighbours are near, and the lists of the triangles.

    xy : (n, 2) m · z : (n,) m · scale : (n,) factor of the size of the residual, 1 or 1 / sigma ·
    rank : (n,) ties go to the smaller · open : (n,) whether the point may become a vertex · after :
    (n,) next point in the list of its triangle, -1 at the end
    """

    xy: F64
    z: F64
    scale: F64
    rank: I32
    open: Bool
    after: I32


class Heap(NamedTuple):
    """Triangles by score. score : score of each place, -1 where the triangle has no point left to
    insert · triangle : triangle at each place · worst : worst point of each triangle, -1 for none.
    """

    score: F64
    triangle: I32
    worst: I32


class InsertedPoints(NamedTuple):
    """What a run inserts, at most as many as there is room for: point (k,), score (k,)."""

    point: I32
    score: F64


@kernel
def height(c: Cloud, m: MeshTable, t: int, q: int) -> float:
    """Height of triangle t at point q of its list; the weights are clipped, so that rounding in a
    needle cannot throw it.
    """
    xy, i, j, k = c.xy, m[t, 0], m[t, 1], m[t, 2]
    x, y = xy[q, 0], xy[q, 1]
    ax, ay, bx, by, cx, cy = (
        xy[i, 0] - x,
        xy[i, 1] - y,
        xy[j, 0] - x,
        xy[j, 1] - y,
        xy[k, 0] - x,
        xy[k, 1] - y,
    )
    wa, wb, wc = (
        max(bx * cy - by * cx, 0.0),
        max(cx * ay - cy * ax, 0.0),
        max(ax * by - ay * bx, 0.0),
    )
    total = wa + wb + wc
    if total > 0.0:
        return float((wa * c.z[i] + wb * c.z[j] + wc * c.z[k]) / total)
    return float(c.z[i])


@kernel
def area(c: Cloud, m: MeshTable, t: int) -> float:
    """Horizontal area of triangle t."""
    i, j, k = m[t, 0], m[t, 1], m[t, 2]
    x, y = c.xy[i, 0], c.xy[i, 1]
    return float(
        max(0.5 * ((c.xy[j, 0] - x) * (c.xy[k, 1] - y) - (c.xy[j, 1] - y) * (c.xy[k, 0] - x)), 0.0)
    )


@kernel
def score(c: Cloud, m: MeshTable, t: int, by_area: bool, tolerance: float) -> tuple[float, int]:
    """Score of triangle t and its worst point: the open point with the largest scaled residual
    above the tolerance; -1, -1 for none.
    """
    if is_ghost(m, t):
        return -1.0, -1
    best, worst = -1.0, -1
    q = m[t, 3]
    while q >= 0:
        if c.open[q]:
            value = abs(c.z[q] - height(c, m, t, q)) * c.scale[q]
            if value > tolerance and (
                value > best or (value == best and c.rank[q] < c.rank[worst])
            ):
                best, worst = value, q
        q = c.after[q]
    return (best * area(c, m, t), worst) if by_area and worst >= 0 else (best, worst)


@kernel
def has_priority(c: Cloud, h: Heap, s: float, t: int, r: float, u: int) -> bool:
    """Whether triangle t with score s goes before triangle u with score r."""
    if s != r:
        return s > r
    return bool(h.worst[t] >= 0 and (h.worst[u] < 0 or c.rank[h.worst[t]] < c.rank[h.worst[u]]))


@kernel
def sift_heap(c: Cloud, h: Heap, m: MeshTable, size: int, at: int, s: float, t: int) -> None:
    """Bring triangle t, now with score s, from place ``at`` to where it belongs in the heap of so
    many places.
    """
    while at > 0 and has_priority(c, h, s, t, h.score[(at - 1) >> 1], h.triangle[(at - 1) >> 1]):
        up = (at - 1) >> 1
        h.score[at], h.triangle[at] = h.score[up], h.triangle[up]
        m[h.triangle[at], 7] = at
        at = up
    while True:
        down = 2 * at + 1
        if down + 1 < size and has_priority(
            c, h, h.score[down + 1], h.triangle[down + 1], h.score[down], h.triangle[down]
        ):
            down += 1
        if down >= size or not has_priority(c, h, h.score[down], h.triangle[down], s, t):
            break
        h.score[at], h.triangle[at] = h.score[down], h.triangle[down]
        m[h.triangle[at], 7] = at
        at = down
    h.score[at], h.triangle[at] = s, t
    m[t, 7] = at


@kernel
def prepend_list(c: Cloud, m: MeshTable, t: int, pool: int) -> int:
    """Put the list of triangle t in front of the list ``pool``; t's own becomes empty."""
    q = m[t, 3]
    m[t, 3] = -1
    while q >= 0:
        following = c.after[q]
        c.after[q] = pool
        pool, q = q, following
    return pool


@kernel
def distribute_points(c: Cloud, m: MeshTable, first: int, pool: int, w: F64) -> None:
    """Give every point of the list ``pool`` to the triangle of the star round corner 0 of ``first``
    that holds it.
    """
    p, t = m[first, 0], first
    while m[t, 1] == GHOST or m[t, 2] == GHOST:
        t = m[t, 5] >> 2
    while pool >= 0:
        q, pool = pool, c.after[pool]
        if q == p:
            continue
        # round p by the shorter way; q is in the star, so a ghost next door means that q lies on
        # the hull here
        while c.xy[q, 0] != c.xy[p, 0] or c.xy[q, 1] != c.xy[p, 1]:
            if orientation_of(c.xy, p, m[t, 1], q, w) < 0.0:
                beside = m[t, 6] >> 2
            elif orientation_of(c.xy, p, m[t, 2], q, w) >= 0.0:
                beside = m[t, 5] >> 2
            else:
                break
            if m[beside, 1] == GHOST or m[beside, 2] == GHOST:
                break
            t = beside
        c.after[q] = m[t, 3]
        m[t, 3] = q


@inlined
def insert_worst(c: Cloud, m: MeshTable, size: int, t: int, p: int, w: F64) -> int:
    """Make point p of triangle t's list a vertex and deal out the points of all triangles that
    change; returns a triangle of p's star.
    """
    t, where = locate(c.xy, m, t, p, w)
    m[size, 3] = m[size + 1, 3] = -1
    if where < 0:
        split_triangle(m, t, p, size, size + 1)
    else:
        split_edge(m, t, where, p, size, size + 1)
    # a diagonal that the residuals were taken with stays where another is Delaunay too
    legalise(c.xy, m, t, w, False)
    # every row that changed is in the star now, and still has its old list
    pool, at = prepend_list(c, m, t, -1), m[t, 5] >> 2
    while at != t:
        pool, at = prepend_list(c, m, at, pool), m[at, 5] >> 2
    distribute_points(c, m, t, pool, w)
    return t


@kernel
def start_kernel(
    c: Cloud, m: MeshTable, size: int, hint: int, initial: I32, w: F64
) -> tuple[int, int]:
    """Insert the ``initial`` points in their order, then hand every open or other point that is no
    vertex to its triangle.

    Returns the number of triangles and of vertices inserted.
    """
    inserted = 0
    for i in range(len(initial)):
        size, hint, copy = insert_point(c.xy, m, size, hint, initial[i], w, False)
        c.open[initial[i]] = False
        if copy < 0:
            c.after[initial[i]] = -2
            inserted += 1
    for t in range(size):
        m[t, 3] = -1
    for q in range(len(c.rank)):
        if c.after[q] != -2:
            hint, _ = locate(c.xy, m, hint, q, w)
            c.after[q] = m[hint, 3]
            m[hint, 3] = q
    return size, inserted


@kernel
def heap_kernel(
    c: Cloud, h: Heap, m: MeshTable, size: int, by_area: bool, tolerance: float
) -> None:
    """Score all triangles and build the heap."""
    for t in range(size):
        value, h.worst[t] = score(c, m, t, by_area, tolerance)
        sift_heap(c, h, m, t + 1, t, value, t)


@kernel
def greedy_kernel(
    c: Cloud,
    h: Heap,
    m: MeshTable,
    size: int,
    by_area: bool,
    tolerance: float,
    w: F64,
    inserted: InsertedPoints,
) -> tuple[int, int]:
    """Insert the worst point again and again, until ``inserted`` is full or none is above the
    tolerance.

    Returns the number of triangles and
    of points inserted.
    """
    taken, scores, count = inserted.point, inserted.score, 0
    while count < len(taken) and h.worst[h.triangle[0]] >= 0:
        t = h.triangle[0]
        p = h.worst[t]
        taken[count], scores[count] = p, h.score[0]
        c.open[p] = False
        first = insert_worst(c, m, size, t, p, w)
        for new in range(size, size + 2):
            h.worst[new] = -1
            h.score[new], h.triangle[new], m[new, 7] = -1.0, new, new
        size, count, t = size + 2, count + 1, first
        while True:
            value, h.worst[t] = score(c, m, t, by_area, tolerance)
            sift_heap(c, h, m, size, m[t, 7], value, t)
            t = m[t, 5] >> 2
            if t == first:
                break
    return size, count


@kernel
def fit_kernel(c: Cloud, m: MeshTable, triangle: I32, residual: F64) -> None:
    """Triangle (row of the table) and residual of every point: from the lists, and zero at the
    vertices.

    A vertex is given a triangle without artificial corners (vertices from len(triangle) on) where
    it has one.
    """
    n = len(triangle)
    triangle[:] = -1
    for t in range(len(m)):
        data = m[t, 0] < n and m[t, 1] < n and m[t, 2] < n
        if not is_ghost(m, t):
            for k in range(3):
                v = m[t, k]
                if v < n and (data or triangle[v] < 0):
                    triangle[v], residual[v] = t, 0.0
        q = m[t, 3]
        while q >= 0:
            triangle[q], residual[q] = t, c.z[q] - height(c, m, t, q)
            q = c.after[q]
