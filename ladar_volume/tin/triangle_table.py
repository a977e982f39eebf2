"""The triangle table and its elementary moves: locate, split, flip.

One row of eight 32-bit words per triangle, so that a triangle is half a cache line: words 0 to 2
are the vertices, counter-clockwise; words 4 to 6 the neighbours opposite them, each as ``4 t + k``
- the neighbour t and the corner k of it that lies across; words 3 and 7 are free for the caller.
Outside the convex hull lie ghost triangles that share one vertex at infinity, :data:`GHOST`: every
triangle has three neighbours, a point outside the hull falls into a ghost triangle, and the hull is
the true convex hull. Seed 000 section 2.4.2 (insertion and exchange of diagonals, after Lawson
1977); ghost triangles after Shewchuk, lecture notes on Delaunay mesh generation.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from ladar_volume.math.kernels import kernel
from ladar_volume.math.large_arrays import large_zeros
from ladar_volume.model.records import F64, I32
from ladar_volume.tin.predicates import INCIRCLE_BOUND, incircle_exact, orientation

MeshTable: TypeAlias = npt.NDArray[np.int32]
#: The vertex at infinity, and "none" in the free words.
GHOST = -1
#: Where a point lies in its triangle: inside, outside the hull, on the edge opposite corner
#: ``where``, or on corner ``where - VERTEX``.
INSIDE, OUTSIDE, VERTEX = -1, -2, 4


@kernel
def orientation_of(xy: F64, a: int, b: int, c: int, w: F64) -> float:
    """Orientation of three points by index."""
    return orientation(xy[a, 0], xy[a, 1], xy[b, 0], xy[b, 1], xy[c, 0], xy[c, 1], w)


@kernel
def link_corners(m: MeshTable, h: int, g: int) -> None:
    """Make corners h and g, both as ``4 t + k``, face each other."""
    m[h >> 2, 4 + (h & 3)] = g
    m[g >> 2, 4 + (g & 3)] = h


@kernel
def write_vertices(m: MeshTable, t: int, a: int, b: int, c: int) -> None:
    """Write the vertices of triangle t."""
    m[t, 0] = a
    m[t, 1] = b
    m[t, 2] = c


@kernel
def is_ghost(m: MeshTable, t: int) -> bool:
    """Whether triangle t has the vertex at infinity."""
    return bool(m[t, 0] == GHOST or m[t, 1] == GHOST or m[t, 2] == GHOST)


@kernel
def first_triangle(xy: F64, m: MeshTable, a: int, b: int, c: int, w: F64) -> None:
    """Start a triangulation from three points that are not collinear: triangle 0 and its three
    ghosts, 1 to 3.
    """
    if orientation_of(xy, a, b, c, w) < 0.0:
        b, c = c, b
    write_vertices(m, 0, a, b, c)
    write_vertices(m, 1, GHOST, c, b)
    write_vertices(m, 2, GHOST, a, c)
    write_vertices(m, 3, GHOST, b, a)
    for k in range(3):
        link_corners(m, k, 4 * (k + 1))
        link_corners(m, 4 * (k + 1) + 2, 4 * ((k + 1) % 3 + 1) + 1)


@kernel
def next_corner(k: int) -> int:
    """The corner after k, counter-clockwise."""
    return k + 1 if k < 2 else 0


@kernel
def previous_corner(k: int) -> int:
    """The corner before k, counter-clockwise."""
    return k - 1 if k > 0 else 2


@kernel
def locate(xy: F64, m: MeshTable, start: int, p: int, w: F64) -> tuple[int, int]:
    """Triangle that holds point p, walking from the real triangle ``start``, and where in it p
    lies.
    """
    t, entry = start, -1
    while True:
        edge, zeros, leave = INSIDE, 0, -1
        for k in range(3):
            if k == entry:  # p lies strictly on this side of the edge that was crossed
                continue
            o = orientation_of(xy, m[t, next_corner(k)], m[t, previous_corner(k)], p, w)
            if o < 0.0:
                leave = k
                break
            if o == 0.0:
                zeros += 1
                edge = k if zeros == 1 else VERTEX + 3 - edge - k
        if leave < 0:
            return t, edge
        h = m[t, 4 + leave]
        t, entry = h >> 2, h & 3
        if m[t, entry] == GHOST:
            return t, OUTSIDE


@kernel
def split_triangle(m: MeshTable, t: int, p: int, t1: int, t2: int) -> None:
    """Replace triangle t by the three around p: t, t1, t2, counter-clockwise about p. p comes first
    in each.
    """
    a, b, c = m[t, 0], m[t, 1], m[t, 2]
    n1, n2 = m[t, 5], m[t, 6]
    write_vertices(m, t, p, b, c)
    write_vertices(m, t1, p, c, a)
    write_vertices(m, t2, p, a, b)
    link_corners(m, 4 * t1, n1)
    link_corners(m, 4 * t2, n2)
    link_corners(m, 4 * t + 1, 4 * t1 + 2)
    link_corners(m, 4 * t1 + 1, 4 * t2 + 2)
    link_corners(m, 4 * t2 + 1, 4 * t + 2)


@kernel
def split_edge(m: MeshTable, t: int, k: int, p: int, t1: int, t3: int) -> int:
    """Replace the two triangles at edge k of t by the four around p: t, t1, t3 and the neighbour,
    which is returned.
    """
    h = m[t, 4 + k]
    o, j = h >> 2, h & 3
    a, b, c, d = m[t, k], m[t, next_corner(k)], m[t, previous_corner(k)], m[o, j]
    nab, nca = m[t, 4 + previous_corner(k)], m[t, 4 + next_corner(k)]
    nbd, ndc = m[o, 4 + next_corner(j)], m[o, 4 + previous_corner(j)]
    write_vertices(m, t, p, a, b)
    write_vertices(m, t1, p, c, a)
    write_vertices(m, t3, p, d, c)
    write_vertices(m, o, p, b, d)
    link_corners(m, 4 * t, nab)
    link_corners(m, 4 * t1, nca)
    link_corners(m, 4 * t3, ndc)
    link_corners(m, 4 * o, nbd)
    link_corners(m, 4 * t + 1, 4 * o + 2)
    link_corners(m, 4 * o + 1, 4 * t3 + 2)
    link_corners(m, 4 * t3 + 1, 4 * t1 + 2)
    link_corners(m, 4 * t1 + 1, 4 * t + 2)
    return int(o)


@kernel
def flip(m: MeshTable, t: int) -> int:
    """Exchange the diagonal opposite corner 0 of t = (p, b, c) for the one from p: t = (p, b, d)
    and the neighbour (p, d, c), returned.
    """
    h = m[t, 4]
    o, j = h >> 2, h & 3
    p, c, d = m[t, 0], m[t, 2], m[o, j]
    nbd, ndc, ncp = m[o, 4 + next_corner(j)], m[o, 4 + previous_corner(j)], m[t, 5]
    m[t, 2] = d
    write_vertices(m, o, p, d, c)
    link_corners(m, 4 * t, nbd)
    link_corners(m, 4 * o, ndc)
    link_corners(m, 4 * o + 1, ncp)
    link_corners(m, 4 * t + 1, 4 * o + 2)
    return int(o)


@kernel
def vector_to_vertex(xy: F64, p: int, v: int) -> tuple[float, float, float]:
    """The way from point p to vertex v and its squared length; zeros where v is the vertex at
    infinity.
    """
    if v == GHOST:
        return 0.0, 0.0, 0.0
    x, y = xy[v, 0] - xy[p, 0], xy[v, 1] - xy[p, 1]
    return x, y, x * x + y * y


@kernel
def incircle_filter(
    b: tuple[float, float, float], c: tuple[float, float, float], d: tuple[float, float, float]
) -> float:
    """The incircle determinant of p, b, c and d by the spokes from p, or NaN where its sign is not
    certain.

    About p the spokes serve every test round the star, which makes a test half the work of one from
    scratch.
    """
    bd, db = b[0] * d[1], b[1] * d[0]
    dc, cd = d[0] * c[1], d[1] * c[0]
    cb, bc = c[0] * b[1], c[1] * b[0]
    det = c[2] * (bd - db) + b[2] * (dc - cd) + d[2] * (cb - bc)
    size = c[2] * (abs(bd) + abs(db)) + b[2] * (abs(dc) + abs(cd)) + d[2] * (abs(cb) + abs(bc))
    return det if abs(det) > INCIRCLE_BOUND * size else np.nan


@kernel
def hull_flip(xy: F64, p: int, b: int, c: int, d: int, w: F64) -> bool:
    """Whether the edge b-c between (p, b, c) and (d, c, b) has to go where b or c is at infinity:
    the circle is a half plane.
    """
    if b == GHOST:
        return orientation_of(xy, p, c, d, w) < 0.0
    return orientation_of(xy, d, b, p, w) < 0.0


@kernel
def precedes(xy: F64, a: int, b: int) -> bool:
    """Whether point a comes before point b by x, then by y."""
    return bool(xy[a, 0] < xy[b, 0] or (xy[a, 0] == xy[b, 0] and xy[a, 1] < xy[b, 1]))


@kernel
def tie_flip(xy: F64, p: int, b: int, c: int, d: int) -> bool:
    """Whether the edge b-c between (p, b, c) and (d, c, b) has to go where all four lie on one
    circle: the diagonal is that at the first of them (:func:`precedes`).

    This is the perturbation that lowers each point of the lifted paraboloid by an infinitesimal,
    that of the first points the largest (Edelsbrunner & Mücke 1990, "Simulation of simplicity"):
    the triangulation depends on the points alone, not on their order nor on those far away.
    """
    one = p if precedes(xy, p, d) else d
    other = b if precedes(xy, b, c) else c
    return bool(precedes(xy, one, other))


@kernel
def legalise(xy: F64, m: MeshTable, first: int, w: F64, ties: bool) -> int:
    """Go once round the new point, corner 0 of triangle ``first`` and of its whole star, and flip
    every edge of the star's rim that must go; returns a real triangle of the star. Words 3 and 7 of
    the rows stay. ties : whether edges on one circle go by :func:`tie_flip`, or stay.
    """
    t, real, p, b, c = first, -1, m[first, 0], m[first, 1], m[first, 2]
    to_b, to_c = vector_to_vertex(xy, p, b), vector_to_vertex(xy, p, c)
    while True:
        h = m[t, 4]
        d = m[h >> 2, h & 3]
        to_d = vector_to_vertex(xy, p, d)
        if d == GHOST:
            go = False
        elif b == GHOST or c == GHOST:
            go = hull_flip(xy, p, b, c, d, w)
        else:
            det = incircle_filter(to_b, to_c, to_d)
            if det != det:
                det = incircle_exact(xy, c, b, d, p, w)
            go = det > 0.0 or (ties and det == 0.0 and tie_flip(xy, p, b, c, d))
        if go:
            flip(m, t)
            c, to_c = d, to_d
            continue
        if b != GHOST and c != GHOST:
            real = t
        t = m[t, 5] >> 2
        if t == first:
            return int(real)
        b, to_b, c = c, to_c, m[t, 2]
        to_c = vector_to_vertex(xy, p, c)


@kernel
def insert_point(
    xy: F64, m: MeshTable, size: int, hint: int, p: int, w: F64, ties: bool
) -> tuple[int, int, int]:
    """Insert point p into the triangles m[:size], walking from the real triangle ``hint``; ties :
    see :func:`legalise`.

    Returns the new number of triangles (two more), a real triangle at p, and the vertex that lies
    at p already, which then stays alone, or -1.
    """
    t, where = locate(xy, m, hint, p, w)
    if where >= VERTEX:
        return size, t, m[t, where - VERTEX]
    if where < 0:
        split_triangle(m, t, p, size, size + 1)
    else:
        split_edge(m, t, where, p, size, size + 1)
    return size + 2, legalise(xy, m, t, w, ties), -1


@kernel
def insert_kernel(
    xy: F64, m: MeshTable, size: int, hint: int, first: int, same: I32, w: F64
) -> tuple[int, int]:
    """Insert points xy[first:] in their order; ``same[p]`` becomes the earlier vertex at p's
    position, or p.
    """
    for p in range(first, len(xy)):
        size, hint, copy = insert_point(xy, m, size, hint, p, w, True)
        same[p] = copy if copy >= 0 else p
    return size, hint


def triangle_table(vertices: int) -> MeshTable:
    """Room for the triangles and ghosts over so many vertices: (2 vertices + 2, 8)."""
    return large_zeros((2 * vertices + 2, 8), np.int32)


@kernel
def number_real(m: MeshTable) -> int:
    """Number the real triangles of a table in word 3, -1 for ghosts; returns how many there are."""
    count = 0
    for t in range(len(m)):
        if is_ghost(m, t):
            m[t, 3] = -1
        else:
            m[t, 3] = count
            count += 1
    return count


@kernel
def export_kernel(m: MeshTable, name: I32, triangles: I32, neighbours: I32) -> None:
    """Write the real triangles as :func:`number_real` numbered them, vertex v as ``name[v]``, with
    their neighbours, -1 at the hull.
    """
    for t in range(len(m)):
        i = m[t, 3]
        if i >= 0:
            for k in range(3):
                triangles[i, k] = name[m[t, k]]
                neighbours[i, k] = m[m[t, 4 + k] >> 2, 3]


def export(m: MeshTable, name: I32) -> tuple[I32, I32]:
    """Triangles and neighbours, both (k, 3), of a table in use; destroys word 3 of its rows."""
    count = int(number_real(m))
    triangles, neighbours = (large_zeros((count, 3), np.int32) for _ in range(2))
    export_kernel(m, name, triangles, neighbours)
    return triangles, neighbours
