"""The Delaunay kernel: incremental insertion with Lawson flips and exact predicates, compiled.

Outside the convex hull lie ghost triangles that share one vertex at infinity (index n): every triangle has three neighbours, a
point outside the hull falls into a ghost triangle, and the hull is the true convex hull. Point location walks from the last
triangle. Seed 000 section 2 (insertion and flips); ghost triangles after Shewchuk, lecture notes on Delaunay mesh generation.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.kernels import kernel
from ladar_volume.model.records import F64, I32, I64, Bool
from ladar_volume.surface.ordering import insertion_order
from ladar_volume.surface.predicates import incircle, orientation, workspace

INSIDE, OUTSIDE = -1, -2
#: Words of the codes of :func:`check_kernel`.
FAULTS = (
    "",
    "a neighbour does not point back",
    "a triangle is not counter-clockwise",
    "a vertex lies inside a circumcircle",
    "the hull is not convex",
)


@kernel
def turn(xy: F64, a: int, b: int, c: int, w: F64) -> float:
    """Orientation of three points by index."""
    return orientation(xy[a, 0], xy[a, 1], xy[b, 0], xy[b, 1], xy[c, 0], xy[c, 1], w)


@kernel
def relink(nb: I64, t: int, old: int, new: int) -> None:
    """Triangle ``t`` now borders ``new`` where it bordered ``old``."""
    for k in range(3):
        if nb[t, k] == old:
            nb[t, k] = new


@kernel
def put(tri: I64, nb: I64, t: int, v: tuple[int, int, int], n: tuple[int, int, int]) -> None:
    """Write one triangle's vertices and neighbours."""
    tri[t, 0], tri[t, 1], tri[t, 2] = v
    nb[t, 0], nb[t, 1], nb[t, 2] = n


@kernel
def locate(xy: F64, tri: I64, nb: I64, start: int, p: int, ghost: int, w: F64) -> tuple[int, int]:
    """Triangle that holds point p, and INSIDE, OUTSIDE (a ghost triangle) or the index of the edge it lies on."""
    t, before = start, -1
    while True:
        edge, moved = INSIDE, False
        for k in range(3):
            if nb[t, k] == before:
                continue
            o = turn(xy, tri[t, (k + 1) % 3], tri[t, (k + 2) % 3], p, w)
            if o < 0.0:
                before, t, moved = t, nb[t, k], True
                break
            if o == 0.0:
                edge = k
        if not moved:
            return t, edge
        if tri[t, 0] == ghost or tri[t, 1] == ghost or tri[t, 2] == ghost:
            return t, OUTSIDE


@kernel
def split_triangle(tri: I64, nb: I64, t: int, p: int, size: int) -> None:
    """Replace triangle t by the three around p: t, size, size + 1. p comes first in each."""
    a, b, c = tri[t, 0], tri[t, 1], tri[t, 2]
    n0, n1, n2 = nb[t, 0], nb[t, 1], nb[t, 2]
    t1, t2 = size, size + 1
    put(tri, nb, t, (p, b, c), (n0, t1, t2))
    put(tri, nb, t1, (p, c, a), (n1, t2, t))
    put(tri, nb, t2, (p, a, b), (n2, t, t1))
    relink(nb, n1, t, t1)
    relink(nb, n2, t, t2)


@kernel
def split_edge(tri: I64, nb: I64, t: int, k: int, p: int, size: int) -> int:
    """Replace the two triangles at edge k of t by the four around p: t, the neighbour, size, size + 1. Returns the neighbour."""
    o = int(nb[t, k])
    j = 0
    while nb[o, j] != t:
        j += 1
    a, b, c, d = tri[t, k], tri[t, (k + 1) % 3], tri[t, (k + 2) % 3], tri[o, j]
    nab, nca = nb[t, (k + 2) % 3], nb[t, (k + 1) % 3]
    nbd, ndc = nb[o, (j + 1) % 3], nb[o, (j + 2) % 3]
    t1, t3 = size, size + 1
    put(tri, nb, t, (p, a, b), (nab, o, t1))
    put(tri, nb, t1, (p, c, a), (nca, t, t3))
    put(tri, nb, o, (p, b, d), (nbd, t3, t))
    put(tri, nb, t3, (p, d, c), (ndc, t1, o))
    relink(nb, nca, t, t1)
    relink(nb, ndc, o, t3)
    return o


@kernel
def must_flip(xy: F64, p: int, b: int, c: int, d: int, ghost: int, w: F64) -> bool:
    """Whether the edge b-c between triangles (p, b, c) and (d, c, b) has to go; at a ghost the circle is a half plane."""
    if d == ghost:
        return False
    if b == ghost:
        return turn(xy, p, c, d, w) < 0.0
    if c == ghost:
        return turn(xy, d, b, p, w) < 0.0
    return incircle(xy, p, b, c, d, w) > 0.0


@kernel
def legalise(xy: F64, tri: I64, nb: I64, stack: I64, top: int, ghost: int, w: F64) -> int:
    """Flip outward from the triangles on the stack (new point first in each); returns a real triangle at that point."""
    real = -1
    while top > 0:
        top -= 1
        t = stack[top]
        p, b, c, o = tri[t, 0], tri[t, 1], tri[t, 2], nb[t, 0]
        j = 0
        while nb[o, j] != t:
            j += 1
        d = tri[o, j]
        if must_flip(xy, p, b, c, d, ghost, w):
            nbd, ndc, npb, ncp = nb[o, (j + 1) % 3], nb[o, (j + 2) % 3], nb[t, 2], nb[t, 1]
            put(tri, nb, t, (p, b, d), (nbd, o, npb))
            put(tri, nb, o, (p, d, c), (ndc, ncp, t))
            relink(nb, nbd, o, t)
            relink(nb, ncp, t, o)
            stack[top] = t
            stack[top + 1] = o
            top += 2
        elif b != ghost and c != ghost:
            real = t
    return real


@kernel
def triangulate_kernel(xy: F64, order: I64, tri: I64, nb: I64, w: F64) -> int:
    """Insert points xy (n, 2) in ``order``, whose first three are not collinear; fills tri, nb (2 n, 3) and returns their count."""
    n = len(order)
    ghost = n
    a, b, c = order[0], order[1], order[2]
    if turn(xy, a, b, c, w) < 0.0:
        b, c = c, b
    put(tri, nb, 0, (a, b, c), (1, 2, 3))
    put(tri, nb, 1, (ghost, c, b), (0, 3, 2))
    put(tri, nb, 2, (ghost, a, c), (0, 1, 3))
    put(tri, nb, 3, (ghost, b, a), (0, 2, 1))
    size, hint = 4, 0
    stack = np.empty(n + 16, np.int64)
    for i in range(3, n):
        p = order[i]
        t, where = locate(xy, tri, nb, hint, p, ghost, w)
        stack[0], stack[1], stack[2], top = t, size, size + 1, 3
        if where == INSIDE or where == OUTSIDE:
            split_triangle(tri, nb, t, p, size)
        else:
            stack[3], top = split_edge(tri, nb, t, where, p, size), 4
        size += 2
        hint = legalise(xy, tri, nb, stack, top, ghost, w)
    return size


@kernel
def check_kernel(xy: F64, tri: I64, nb: I64, w: F64) -> int:
    """0 where the triangulation is Delaunay with a convex hull, else a code that :data:`FAULTS` puts in words."""
    for t in range(len(tri)):
        if turn(xy, tri[t, 0], tri[t, 1], tri[t, 2], w) <= 0.0:
            return 2
        for k in range(3):
            o = nb[t, k]
            if o < 0:
                continue
            j = -1
            for m in range(3):
                if nb[o, m] == t:
                    j = m
            if j < 0 or tri[o, (j + 1) % 3] != tri[t, (k + 2) % 3] or tri[o, (j + 2) % 3] != tri[t, (k + 1) % 3]:
                return 1
            if incircle(xy, tri[t, 0], tri[t, 1], tri[t, 2], tri[o, j], w) > 0.0:
                return 3
    after = np.full(len(xy), -1, np.int64)
    for t in range(len(tri)):
        for k in range(3):
            if nb[t, k] < 0:
                after[tri[t, (k + 1) % 3]] = tri[t, (k + 2) % 3]
    for a in range(len(xy)):
        if after[a] >= 0 and (after[after[a]] < 0 or turn(xy, a, after[a], after[after[a]], w) < 0.0):
            return 4
    return 0


def fault(xy: F64, triangles: I32, neighbours: I32) -> str:
    """What is wrong with a triangulation of points xy (n, 2), in words; empty where it is a valid Delaunay triangulation.

    Checks that neighbours are mutual, triangles counter-clockwise, circumcircles empty, every vertex used, Euler's formula, and
    the hull convex.
    """
    code = int(check_kernel(np.ascontiguousarray(xy), triangles.astype(np.int64), neighbours.astype(np.int64), workspace()))
    if code:
        return FAULTS[code]
    if not np.array_equal(np.unique(triangles), np.arange(len(xy))):
        return "a vertex is in no triangle"
    hull = int(np.count_nonzero(neighbours < 0))
    return "" if len(triangles) == 2 * len(xy) - 2 - hull else "Euler's formula does not hold"


def is_valid(xy: F64, triangles: I32, neighbours: I32) -> bool:
    """Whether (triangles, neighbours), both (m, 3), is a Delaunay triangulation of all points xy (n, 2)."""
    return not fault(xy, triangles, neighbours)


def first_copies(xy: F64) -> I64:
    """Indices (k,), ascending, of the first point at every distinct position of xy (n, 2)."""
    if len(xy) == 0:
        return np.zeros(0, np.int64)
    order = np.lexsort((np.arange(len(xy)), xy[:, 1], xy[:, 0]))
    s = xy[order]
    new: Bool = np.concatenate([[True], np.any(s[1:] != s[:-1], axis=1)])
    return np.sort(order[new]).astype(np.int64)


def delaunay(xy: F64) -> tuple[I32, I32]:
    """Delaunay triangulation of distinct points xy (n, 2): triangles (m, 3) counter-clockwise and neighbours (m, 3), -1 at the hull.

    ``neighbours[t, k]`` lies across the edge opposite ``triangles[t, k]``. Raises :class:`SurfaceError` for fewer than three points, or
    when all are collinear. Where four or more points are co-circular the choice of diagonals follows the (deterministic) insertion order.
    """
    xy = np.ascontiguousarray(xy, dtype=np.float64) + 0.0  # -0.0 and 0.0 are one position
    n = len(xy)
    if n < 3:
        raise SurfaceError(f"a triangulation needs three points, there are {n}", reason="surface_too_few_points", value=n)
    if not np.isfinite(xy).all():
        raise SurfaceError("a point with a coordinate that is not finite", reason="surface_not_finite")
    w = workspace()
    order = insertion_order(xy)
    third = next((k for k in range(2, n) if turn(xy, order[0], order[1], order[k], w) != 0.0), 0)
    if third == 0:
        raise SurfaceError(f"all {n} points are collinear", reason="surface_collinear", value=n)
    order[2], order[3 : third + 1] = order[third], order[2:third].copy()
    tri, nb = np.empty((2 * n + 2, 3), np.int64), np.empty((2 * n + 2, 3), np.int64)
    size = int(triangulate_kernel(xy, order, tri, nb, w))
    tri, nb = tri[:size], nb[:size]
    real = (tri != n).all(axis=1)
    number = np.where(real, np.cumsum(real) - 1, -1).astype(np.int32)
    return tri[real].astype(np.int32), number[nb[real]]
