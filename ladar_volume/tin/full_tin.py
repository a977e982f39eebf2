"""A full TIN: every point is a vertex (seed 000 section 2, "full triangulation")."""

from __future__ import annotations

from typing import Any

import numpy as np

from ladar_volume.math.equal_rows import rows_of
from ladar_volume.math.kernels import kernel, leaf_kernel, run_in_ranges
from ladar_volume.math.large_arrays import large_zeros
from ladar_volume.model.records import F64, I32, I64, Bool, Tin
from ladar_volume.tin.delaunay import Triangulation, finite_points, triangulate
from ladar_volume.tin.triangle_table import precedes


def build_tin(points_map: F64) -> Tin:
    """Delaunay TIN over the horizontal plane of points (n, 3), m, map frame; all triangles
    relevant.

    Of points with exactly equal x and y the first is kept; ``duplicates`` counts the others. Raises
    :class:`SurfaceError` for NaN, fewer than three distinct points, or collinear ones. Where every
    point is a vertex these are the points given, not a copy.
    """
    points = finite_points(points_map)
    return tin_of(points, triangulate(points[:, :2]))


def tin_of(points: F64, out: Triangulation) -> Tin:
    """The TIN of points (n, 3), m, that were triangulated."""
    source, triangles = out.vertices, out.triangles
    if len(source) < len(points):
        triangles = places_in(source, len(points))[triangles]
    return Tin(
        rows_of(points, source),
        triangles,
        out.neighbours,
        np.ones(len(triangles), bool),
        source,
        len(points) - len(source),
    )


def places_in(source: I64, n: int) -> I32:
    """Place in ``source`` (k,) of each of n points, (n,); -1 where it is not there."""
    out = np.full(n, -1, np.int32)
    out[source] = np.arange(len(source), dtype=np.int32)
    return out


def part_of(tin: Tin, chosen: Bool) -> Tin:
    """The part of a surface over the vertices ``chosen`` (n,): these, in their order, and the
    triangles that have no other.
    """
    keep = ~any_corner(tin.triangles, ~chosen)
    own = np.flatnonzero(chosen)
    number = np.full(len(keep) + 1, -1, np.int32)  # the last stays -1, for the hull
    number[np.flatnonzero(keep)] = np.arange(np.count_nonzero(keep))
    return Tin(
        tin.vertices[own],
        places_in(own, len(chosen))[tin.triangles[keep]],
        number[tin.neighbours[keep]],
        tin.relevant[keep],
        tin.source[own],
        tin.duplicates,
    )


@leaf_kernel
def area_of(vertices: F64, triangles: I32, t: int) -> float:
    """Signed horizontal area, m², of triangle t."""
    a, b, c = vertices[triangles[t, 0]], vertices[triangles[t, 1]], vertices[triangles[t, 2]]
    out: float = 0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
    return out


@kernel
def area_kernel(first: int, end: int, vertices: F64, triangles: I32, out: F64) -> None:
    """See :func:`footprint_areas`; some triangles."""
    for t in range(first, end):
        out[t] = area_of(vertices, triangles, t)


def footprint_areas(vertices: F64, triangles: I32) -> F64:
    """Signed horizontal areas (m,) m² of triangles (m, 3) over vertices (n, 3); positive
    counter-clockwise from above.
    """
    out = large_zeros((len(triangles),))
    run_in_ranges(area_kernel, len(out), vertices, triangles, out)
    return out


@kernel
def corner_kernel(triangles: I32, mask: Bool, n: int) -> Bool:
    """See :func:`vertex_mask`."""
    out = np.zeros(n, np.bool_)
    for t in range(len(triangles)):
        if mask[t]:
            for k in range(3):
                out[triangles[t, k]] = True
    return out


def vertex_mask(tin: Tin, mask: Bool) -> Bool:
    """Vertices (n,) of the triangles chosen by ``mask`` (m,)."""
    return np.asarray(corner_kernel(tin.triangles, mask, len(tin.vertices)))


def corners_of(triangles: I32, n: int) -> I64:
    """The vertices (k,), of n, that triangles (m, 3) have as corners, ascending."""
    return np.flatnonzero(corner_kernel(triangles, np.ones(len(triangles), np.bool_), n))


@kernel
def any_kernel(first: int, end: int, triangles: I32, chosen: Bool, out: Bool) -> None:
    """See :func:`any_corner`; some triangles."""
    for t in range(first, end):
        out[t] = chosen[triangles[t, 0]] or chosen[triangles[t, 1]] or chosen[triangles[t, 2]]


def any_corner(triangles: I32, chosen: Bool) -> Bool:
    """Which of triangles (m, 3) have a vertex among the ``chosen`` (n,)."""
    out = np.empty(len(triangles), np.bool_)
    run_in_ranges(any_kernel, len(out), triangles, chosen, out)
    return out


@leaf_kernel
def first_corner(vertices: F64, triangles: I32, t: int) -> Any:
    """The first vertex, of (n, 2) or (n, 3), of triangle t by x, then y."""
    first = triangles[t, 0]
    for c in range(1, 3):
        if precedes(vertices, triangles[t, c], first):
            first = triangles[t, c]
    return first


@kernel
def first_corners(vertices: F64, triangles: I32) -> I64:
    """The first vertex, of (n, 2) or (n, 3), of each triangle (m,) by x, then y."""
    out = np.empty(len(triangles), np.int64)
    for t in range(len(triangles)):
        out[t] = first_corner(vertices, triangles, t)
    return out


@kernel
def across_sides(triangles: I32, n: int) -> I32:
    """The triangle (m, 3) across the side opposite each corner, -1 where there is not exactly one;
    over n vertices.
    """
    m, sides = len(triangles), 0
    head, after = np.full(n, -1, np.int32), np.empty(3 * m, np.int32)
    high, first = np.empty(3 * m, np.int32), np.empty(3 * m, np.int32)
    second, count = np.empty(3 * m, np.int32), np.zeros(3 * m, np.int32)
    for t in range(m):
        for c in range(3):
            p, q = triangles[t, (c + 1) % 3], triangles[t, (c + 2) % 3]
            low = min(p, q)
            at = head[low]
            while at >= 0 and high[at] != max(p, q):
                at = after[at]
            if at < 0:
                at, after[sides], high[sides] = sides, head[low], max(p, q)
                head[low], first[at] = at, 3 * t + c
                sides += 1
            second[at] = 3 * t + c
            count[at] += 1
    out = np.full((m, 3), -1, np.int32)
    for s in range(sides):
        if count[s] == 2:
            i, j = first[s], second[s]
            out[i // 3, i % 3], out[j // 3, j % 3] = j // 3, i // 3
    return out
