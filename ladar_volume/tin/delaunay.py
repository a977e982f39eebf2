"""Delaunay triangulations of whole point sets, and the proof that one is valid.

The points are sorted once into the order of insertion and inserted by the moves of
:mod:`ladar_volume.tin.triangle_table`, with predicates that are exact where they have to be. Seed
000 sections 2.2 (empty circle) and 2.4.2 (insertion).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ladar_volume.math.kernels import kernel
from ladar_volume.math.large_arrays import in_its_room
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I32, I64
from ladar_volume.tin.insertion_order import insertion_order
from ladar_volume.tin.predicates import COUNTS, incircle, workspace
from ladar_volume.tin.triangle_table import (
    MeshTable,
    export,
    first_triangle,
    insert_kernel,
    orientation_of,
    triangle_table,
)

#: Words of the codes of :func:`check_kernel`.
FAULTS = (
    "",
    "a neighbour does not point back",
    "a triangle is not counter-clockwise",
    "a vertex lies inside a circumcircle",
    "the hull is not convex",
    "the hull is not one loop",
)


@kernel
def check_kernel(xy: F64, tri: I32, nb: I32, w: F64) -> int:
    """0 where the triangulation is Delaunay with a convex hull, else a code that :data:`FAULTS`
    puts in words.
    """
    for t in range(len(tri)):
        if orientation_of(xy, tri[t, 0], tri[t, 1], tri[t, 2], w) <= 0.0:
            return 2
        for k in range(3):
            o = nb[t, k]
            if o < 0:
                continue
            j = -1
            for m in range(3):
                if nb[o, m] == t:
                    j = m
            if (
                j < 0
                or tri[o, (j + 1) % 3] != tri[t, (k + 2) % 3]
                or tri[o, (j + 2) % 3] != tri[t, (k + 1) % 3]
            ):
                return 1
            if o > t and incircle(xy, tri[t, 0], tri[t, 1], tri[t, 2], tri[o, j], w) > 0.0:
                return 3
    return 0


@kernel
def check_hull_kernel(xy: F64, tri: I32, nb: I32, w: F64) -> int:
    """0 where the edges without a neighbour are one convex loop, else a code as
    :func:`check_kernel` gives.
    """
    after = np.full(len(xy), -1, np.int64)
    hull, last = 0, -1
    for t in range(len(tri)):
        for k in range(3):
            if nb[t, k] < 0:
                last, hull = tri[t, (k + 1) % 3], hull + 1
                after[last] = tri[t, (k + 2) % 3]
    at, steps = last, 0
    while steps <= hull and at >= 0 and (steps == 0 or at != last):
        b = after[at]
        if b < 0 or after[b] < 0 or orientation_of(xy, at, b, after[b], w) < 0.0:
            return 4
        at, steps = b, steps + 1
    return 0 if steps == hull and hull > 0 else 5


def find_fault(xy: F64, triangles: I32, neighbours: I32) -> str:
    """What is wrong with a triangulation of points xy (n, 2), in words; empty where it is a valid
    Delaunay triangulation.

    Checks that neighbours are mutual, triangles counter-clockwise, circumcircles empty, every
    vertex used, Euler's formula, and the hull convex.
    """
    points, tri, nb, w = (
        np.ascontiguousarray(xy),
        triangles.astype(np.int32),
        neighbours.astype(np.int32),
        workspace(),
    )
    if (
        len(tri) == 0
        or tri.min() < 0
        or tri.max() >= len(points)
        or nb.min() < -1
        or nb.max() >= len(tri)
    ):
        return "an index is out of range"
    code = int(check_kernel(points, tri, nb, w)) or int(check_hull_kernel(points, tri, nb, w))
    if code:
        return FAULTS[code]
    if not np.array_equal(np.unique(triangles), np.arange(len(xy))):
        return "a vertex is in no triangle"
    hull = int(np.count_nonzero(neighbours < 0))
    return "" if len(triangles) == 2 * len(xy) - 2 - hull else "Euler's formula does not hold"


def is_valid(xy: F64, triangles: I32, neighbours: I32) -> bool:
    """Whether (triangles, neighbours), both (m, 3), is a Delaunay triangulation of all points xy
    (n, 2).
    """
    return not find_fault(xy, triangles, neighbours)


@dataclass(frozen=True)
class Triangulation:
    """A Delaunay triangulation of points (n, 2).

    triangles : (m, 3) counter-clockwise · neighbours : (m, 3), ``neighbours[t, k]`` lies across the
    edge opposite ``triangles[t, k]``, -1 at the hull · same : (n,) the first point at each point's
    position, which is the vertex there · exact_orientations, exact_incircles : how many predicates
    the floating-point filter could not decide
    """

    triangles: I32
    neighbours: I32
    same: I32
    exact_orientations: int
    exact_incircles: int

    @property
    def vertices(self) -> I64:
        """Indices (k,), ascending, of the points that are vertices."""
        return in_its_room(np.flatnonzero(self.same == np.arange(len(self.same), dtype=np.int32)))


@kernel
def first_three(xy: F64, w: F64) -> tuple[int, int]:
    """The first point that differs from point 0 and the first off the line through both; len(xy)
    where there is none.
    """
    n = len(xy)
    second = 1
    while second < n and xy[second, 0] == xy[0, 0] and xy[second, 1] == xy[0, 1]:
        second += 1
    third = second + 1
    while third < n and orientation_of(xy, 0, second, third, w) == 0.0:
        third += 1
    return second, min(third, n)


def insertion_sequence(xy: F64, w: F64) -> I32:
    """Permutation (n,) in which points xy (n, 2) are inserted; its first three are not collinear.

    Raises :class:`SurfaceError` for fewer than three distinct points, or when all are collinear.
    """
    order = insertion_order(xy)
    if len(order) < 3:
        raise SurfaceError(
            f"a triangulation needs three points, there are {len(xy)}",
            reason="surface_too_few_points",
            value=len(xy),
        )
    second, third = first_three(xy[order], w)
    if third == len(order):
        distinct = len(np.unique(xy, axis=0))
        if distinct < 3:
            raise SurfaceError(
                f"a triangulation needs three points, there are {distinct}",
                reason="surface_too_few_points",
                value=distinct,
            )
        raise SurfaceError(
            f"all {distinct} points are collinear", reason="surface_collinear", value=distinct
        )
    if (second, third) != (1, 2):
        order = np.concatenate([order[[0, second, third]], np.delete(order, [0, second, third])])
    return order


def finite_points(points_map: F64) -> F64:
    """Points (n, 3), m, as float64. Raises :class:`SurfaceError` for another shape, or a value that
    is not finite.
    """
    points = np.asarray(points_map, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise SurfaceError(
            f"points are (n, 3), not {points.shape}", reason="surface_shape", value=points.shape
        )
    return finite(points)


def finite(values: F64) -> F64:
    """The values, (n, k); raises :class:`SurfaceError` where one is not finite."""
    if not np.isfinite(values).all():
        raise SurfaceError(
            "a point with a coordinate that is not finite", reason="surface_not_finite"
        )
    return values


@dataclass(frozen=True)
class Insertion:
    """The points inserted so far. order : (n,) their indices, first inserted first · same : (n,)
    place in that order of the first point at each one's position · table : their triangles, of
    which the first ``size`` rows are in use · hint : a real triangle · w : workspace of the
    predicates
    """

    order: I32
    same: I32
    table: MeshTable
    size: int
    hint: int
    w: F64

    @classmethod
    def of(cls, xy: F64) -> tuple[Insertion, F64]:
        """All points xy (n, 2), and these in the order of insertion; raises as
        :func:`triangulate`.
        """
        xy = finite(np.asarray(xy, dtype=np.float64))
        n, w = len(xy), workspace()
        order = insertion_sequence(xy, w)
        s = xy[order]
        m, same = triangle_table(n), np.empty(n, np.int32)
        first_triangle(s, m, 0, 1, 2, w)
        same[:3] = 0, 1, 2
        return cls(order, same, m, *insert_kernel(s, m, 4, 0, 3, same, w), w), s

    def triangulation(self) -> Triangulation:
        """The triangulation of the points so far; more may be inserted after it."""
        name = first_names(self.order, self.same)
        triangles, neighbours = export(self.table[: self.size], name)
        return Triangulation(
            triangles,
            neighbours,
            original_order(self.order, self.same, name),
            int(self.w[COUNTS, 0]),
            int(self.w[COUNTS, 1]),
        )


class GrowingTriangulation:
    """:func:`triangulate` of points that are not all known at once: what is added is inserted into
    what there is, and the triangles are those of all points in one call.
    """

    def __init__(self, xy: F64) -> None:
        """xy : (n, 2) the first points. Raises as :func:`triangulate`."""
        self._so_far, self._xy = Insertion.of(xy)

    def add(self, xy: F64) -> None:
        """Insert points (k, 2), which follow those so far. Raises :class:`SurfaceError` for
        coordinates that are not finite.
        """
        old, more = self._so_far, finite(np.asarray(xy, dtype=np.float64))
        n, order = len(old.order), insertion_order(more)
        s = np.concatenate([self._xy, more[order]])
        table, same = triangle_table(len(s)), np.empty(len(s), np.int32)
        table[: old.size], same[:n] = old.table[: old.size], old.same
        size, hint = insert_kernel(s, table, old.size, old.hint, n, same, old.w)
        every = np.concatenate([old.order, order + np.int32(n)])
        self._so_far, self._xy = Insertion(every, same, table, size, hint, old.w), s

    def triangulation(self) -> Triangulation:
        """That of the points so far."""
        return self._so_far.triangulation()


def triangulate(xy: F64) -> Triangulation:
    """Delaunay triangulation of points xy (n, 2), of which those at one position (bit by bit)
    become one vertex.

    Where four or more points are co-circular the diagonals are those at the first by x, then y: the
    triangles depend on the points alone, in any order. Raises :class:`SurfaceError` for coordinates
    that are not finite, fewer than three distinct points, or when all are collinear.
    """
    return Insertion.of(xy)[0].triangulation()


@kernel
def first_names(order: I32, same: I32) -> I32:
    """The smallest point index at the position of each vertex, by place in the order of
    insertion.
    """
    name = order.copy()
    for p in range(len(order)):
        name[same[p]] = min(name[same[p]], order[p])
    return name


@kernel
def original_order(order: I32, same: I32, name: I32) -> I32:
    """``same`` by point index instead of by place in the order."""
    out = np.empty_like(order)
    for p in range(len(order)):
        out[order[p]] = name[same[p]]
    return out


def delaunay(xy: F64) -> tuple[I32, I32]:
    """Delaunay triangulation of distinct points xy (n, 2): triangles (m, 3) counter-clockwise and
    neighbours (m, 3), -1 at the hull.

    ``neighbours[t, k]`` lies across the edge opposite ``triangles[t, k]``. Raises
    :class:`SurfaceError` as :func:`triangulate` does, and where two points are at one position.
    """
    out = triangulate(xy)
    if len(out.vertices) < len(xy):
        extra = int(len(xy) - len(out.vertices))
        raise SurfaceError(
            f"{extra} points lie on others", reason="surface_duplicates", value=extra
        )
    return out.triangles, out.neighbours
