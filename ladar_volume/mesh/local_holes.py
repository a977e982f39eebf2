"""Gaps of a growing surface: their rims, which of them are holes, and the cheapest triangulation of
a hole.

A rim is followed with the gap on its left. Whether the gap is a hole in the surface or all that
lies outside of it shows in the angles of the gap along the rim: a flat polygon of k corners has k -
2 half turns inside and k + 2 outside. A hole is closed by the triangulation of least area (Barequet
and Sharir 1995), weighted by how far triangles turn away from the normals at their corners.

Where two strips of triangles cross, as they can at the end of a concave edge, they make a handle
without the curvature of one, and their common rim misses four half turns for each (Gauss and
Bonnet); a handle of the body itself misses none. No triangulation closes such a rim: all triangles
round it go, and what then gapes is a hole like others.
"""

from __future__ import annotations

import math

import numpy as np

from ladar_volume.math.kernels import inlined, kernel
from ladar_volume.mesh.local_frames import tangent_coordinates
from ladar_volume.mesh.local_growth import (
    FAN,
    add_to_fans,
    remove_from_fans,
    row_to_left,
    row_to_right,
)
from ladar_volume.model.records import F64, I32, I64, Bool

#: Longest rim that is closed; the work grows with its cube.
LONGEST = 200
#: By how many half turns a rim's angles differ from those of a hole at most; nearer to the next
#: multiple of four it is of another kind.
OF_A_HOLE = 2.0


@kernel
def next_on_rim(
    points: F64, normals: F64, fan: I32, size: I32, slack: float, y: int, x: int
) -> tuple[int, float]:
    """Row of x's fan whose last neighbour follows x on the rim that comes from y, and the angle of
    the gap at x.
    """
    yx, yy, _ = tangent_coordinates(points, normals, x, y, slack)
    best, least = -1, np.inf
    for s in range(size[x]):
        z = fan[x, s, 1]
        if row_to_left(fan, size, x, z) >= 0:
            continue
        zx, zy, _ = tangent_coordinates(points, normals, x, z, slack)
        angle = math.atan2(zx * yy - zy * yx, zx * yx + zy * yy)
        angle = angle if angle > 0.0 else angle + 2.0 * math.pi
        if angle < least:
            best, least = s, angle
    return best, least


@kernel
def trace_rims(
    points: F64, normals: F64, fan: I32, size: I32, slack: float, rim: I32, start: I64, excess: F64
) -> int:
    """All rims one after the other: vertices in ``rim``, the first of each in ``start``, and by how
    many half turns their gap's angles exceed those of a flat hole's polygon: near 0 for a hole,
    near 4 for what lies outside; how many rims.
    """
    seen = np.zeros((len(size), FAN), np.bool_)
    rims, n = 0, 0
    for first in range(len(size)):
        for s in range(size[first]):
            if seen[first, s] or row_to_left(fan, size, first, fan[first, s, 1]) >= 0:
                continue
            x, row, turns = first, s, 0.0
            start[rims] = n
            while row >= 0 and not seen[x, row]:
                seen[x, row] = True
                rim[n] = x
                n += 1
                z = fan[x, row, 1]
                row, angle = next_on_rim(points, normals, fan, size, slack, x, z)
                turns += angle
                x = z
            excess[rims] = turns / math.pi - (n - start[rims] - 2)
            rims += 1
            start[rims] = n
    return rims


@kernel
def triangle_price(points: F64, normals: F64, a: int, b: int, c: int) -> float:
    """Area of a triangle, dearer the more it turns away from the normals at its corners."""
    u, v = points[b] - points[a], points[c] - points[a]
    x, y, z = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
    twice = math.sqrt(x * x + y * y + z * z)
    m = normals[a] + normals[b] + normals[c]
    lean = x * m[0] + y * m[1] + z * m[2]
    cosine = lean / max(twice * math.sqrt(m[0] * m[0] + m[1] * m[1] + m[2] * m[2]), 1e-300)
    return 0.5 * twice * (2.0 - cosine if cosine > 0.0 else 100.0)


@inlined
def close_rim(points: F64, normals: F64, fan: I32, size: I32, rim: I32) -> int:
    """Close one rim (k,) by its cheapest triangulation that uses no edge the surface already has;
    how many triangles, 0 where none is.
    """
    k = len(rim)
    cost, split = np.full((k, k), np.inf), np.full((k, k), -1, np.int64)
    for i in range(k - 1):
        cost[i, i + 1] = 0.0
    for width in range(2, k):
        for i in range(k - width):
            j = i + width
            a, c = rim[i], rim[j]
            inner = not (i == 0 and j == k - 1)
            if a == c or (
                inner and (row_to_left(fan, size, a, c) >= 0 or row_to_right(fan, size, a, c) >= 0)
            ):
                continue
            for m in range(i + 1, j):
                if rim[m] == a or rim[m] == c or cost[i, m] + cost[m, j] >= cost[i, j]:
                    continue
                whole = cost[i, m] + cost[m, j] + triangle_price(points, normals, a, rim[m], c)
                if whole < cost[i, j]:
                    cost[i, j], split[i, j] = whole, m
    if not math.isfinite(cost[0, k - 1]):
        return 0
    return write_rim(fan, size, rim, split)


@kernel
def write_rim(fan: I32, size: I32, rim: I32, split: I64) -> int:
    """Add the triangles of a triangulated rim, if every fan has room for them."""
    k = len(rim)
    for v in rim:
        if size[v] + k > FAN + 2 and size[v] > FAN // 2:
            return 0
    stack, top = np.empty((k, 2), np.int64), 1
    stack[0, 0], stack[0, 1] = 0, k - 1
    while top > 0:
        top -= 1
        i, j = stack[top, 0], stack[top, 1]
        m = split[i, j]
        add_to_fans(fan, size, rim[i], rim[m], rim[j], 0)
        if m > i + 1:
            stack[top, 0], stack[top, 1] = i, m
            top += 1
        if j > m + 1:
            stack[top, 0], stack[top, 1] = m, j
            top += 1
    return k - 2


@kernel
def close_holes(
    points: F64, normals: F64, fan: I32, size: I32, rim: I32, start: I64, chosen: I64
) -> tuple[int, int]:
    """Close the chosen rims: how many holes, and with how many triangles."""
    holes, triangles = 0, 0
    for r in chosen:
        added = close_rim(points, normals, fan, size, rim[start[r] : start[r + 1]])
        triangles += added
        holes += added > 0
    return holes, triangles


def fill_holes(
    points: F64, normals: F64, fan: I32, size: I32, slack: float, largest_m: float, opened: Bool
) -> tuple[int, int]:
    """Close every hole whose rim is no longer than that of a circle of diameter ``largest_m``, or
    that was opened (n,) at one of its vertices: how many, with how many triangles.
    """
    rim, start, excess = rims(points, normals, fan, size, slack)
    corners = np.diff(start)
    wanted = (rim_lengths(points, rim, start) <= math.pi * largest_m) | rims_at_vertices(
        rim, start, opened
    )
    chosen = np.flatnonzero(
        wanted & (np.abs(excess) < OF_A_HOLE) & (corners >= 3) & (corners <= LONGEST)
    )
    order = np.argsort(corners[chosen], kind="stable")
    return close_holes(points, normals, fan, size, rim, start, chosen[order])


def open_handles(points: F64, normals: F64, fan: I32, size: I32, slack: float, opened: Bool) -> int:
    """Take away all triangles round rims where strips of triangles cross, and mark what then is
    their rim ``opened`` (n,); how many went.

    Rims too long to be closed again stay.
    """
    rim, start, excess = rims(points, normals, fan, size, slack)
    crossed = (excess < -OF_A_HOLE) & (np.diff(start) <= LONGEST)
    return clear_vertices(fan, size, np.unique(rim[np.repeat(crossed, np.diff(start))]), opened)


@kernel
def clear_vertices(fan: I32, size: I32, at: I32, touched: Bool) -> int:
    """Take away all triangles at vertices ``at`` (k,) and mark their corners; how many went."""
    gone = 0
    for i in at:
        while size[i] > 0:
            touched[i] = touched[fan[i, 0, 0]] = touched[fan[i, 0, 1]] = True
            remove_from_fans(fan, size, i, fan[i, 0, 0], fan[i, 0, 1])
            gone += 1
    return gone


def rim_lengths(points: F64, rim: I32, start: I64) -> F64:
    """Length (r,) of each rim, m."""
    if len(rim) == 0:
        return np.zeros(0)
    following = np.append(rim[1:], rim[0])
    following[start[1:] - 1] = rim[start[:-1]]
    length: F64 = np.add.reduceat(
        np.linalg.norm(points[following] - points[rim], axis=1), start[:-1]
    )
    return length


def rims_at_vertices(rim: I32, start: I64, marked: Bool) -> Bool:
    """Whether (r,) a rim passes a marked vertex (n,)."""
    number = np.repeat(np.arange(len(start) - 1), np.diff(start))
    return np.bincount(number, marked[rim], len(start) - 1) > 0


def rims(points: F64, normals: F64, fan: I32, size: I32, slack: float) -> tuple[I32, I64, F64]:
    """As :func:`trace_rims`, cut to length: vertices of all rims, where each begins (and where the
    last ends), excess.
    """
    most = int(size.sum())
    rim, start, excess = np.empty(most, np.int32), np.zeros(most + 1, np.int64), np.empty(most)
    count = trace_rims(points, normals, fan, size, slack, rim, start, excess)
    return rim[: start[count]], start[: count + 1], excess[:count]
