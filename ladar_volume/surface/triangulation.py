"""A Delaunay triangulation that changes: points come and go, the triangulation is valid at every
moment.

For one that is made once from all its points :func:`ladar_volume.surface.delaunay.triangulate` is
faster.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I32, I64, Bool
from ladar_volume.surface.delaunay import fault, insertion_sequence
from ladar_volume.surface.duplicates import first_within
from ladar_volume.surface.mesh import export, first_triangle, locate, triangle_table
from ladar_volume.surface.ordering import hilbert_order, insertion_order
from ladar_volume.surface.predicates import COUNTS, workspace
from ladar_volume.surface.removal import insert_within, real_beside, remove_kernel
from ladar_volume.surface.window import Window, corners, map_window


class Triangulation:
    """Delaunay triangulation of a changing set of points in the plane.

    Vertices are numbered in the order in which their points were given, and keep their numbers for
    good; with a map window (low x, low y, high x, high y, in m) its four corners are vertices 0 to
    3, and stay. A point that lies no farther than ``tolerance_m`` from a vertex does not become
    one: :meth:`insert` reports that vertex in its place.

    Raises :class:`SurfaceError` for points xy (n, 2), m, of a wrong shape or not finite, a map
    without area or a tolerance that is not a number >= 0; without a map also for fewer than three
    distinct points, or collinear ones.
    """

    def __init__(
        self, xy: F64 | None = None, window: Window | None = None, tolerance_m: float = 0.0
    ) -> None:
        if not 0.0 <= tolerance_m < np.inf:
            raise SurfaceError(
                f"the tolerance is {tolerance_m} m; it must be 0 or more",
                reason="surface_tolerance",
                value=tolerance_m,
            )
        points = checked(np.empty((0, 2)) if xy is None else xy)
        self.tolerance_m, self.fixed = float(tolerance_m), 0 if window is None else 4
        self._w = workspace()
        if window is not None:
            points = np.concatenate([corners(map_window(points, window)), points])
        #: For every point given at the start (corners included) the vertex it is, or lies at: the
        #: first of those within the tolerance.
        self.same: I64 = first_within(points, tolerance_m).astype(np.int64)
        if (self.same[: self.fixed] != np.arange(self.fixed)).any():
            raise SurfaceError(
                f"the map {window} is no larger than the tolerance",
                reason="surface_window",
                value=window,
            )
        kept = np.flatnonzero(self.same == np.arange(len(points)))
        a, b, c = (
            (0, 1, 2)
            if window is not None
            else kept[insertion_sequence(points[kept], self._w)[:3]].tolist()
        )
        self._used, self._xy, self._alive = len(points), points.copy(), np.zeros(len(points), bool)
        self._mesh, self._size, self._hint = triangle_table(len(points)), 4, 0
        first_triangle(self._xy, self._mesh, a, b, c, self._w)
        self._add(0, np.setdiff1d(kept, [a, b, c]), self.same)

    @property
    def xy(self) -> F64:
        """Positions (k, 2), m, by vertex number; also of points that are no vertices (any more)."""
        return self._xy[: self._used]

    @property
    def alive(self) -> Bool:
        """Which numbers (k,) are vertices."""
        return self._alive[: self._used]

    @property
    def exact_predicates(self) -> tuple[int, int]:
        """How many orientations and how many incircle tests reached the exact stage so far."""
        return int(self._w[COUNTS, 0]), int(self._w[COUNTS, 1])

    def _add(self, start: int, chosen: I64, same: I64) -> None:
        order = chosen[insertion_order(self._xy[start + chosen])].astype(np.int32)
        square = self.tolerance_m**2
        self._size, self._hint = insert_within(
            self._xy, self._mesh, self._size, self._hint, start, order, square, same, self._w
        )
        self._alive[start : start + len(same)] |= same == np.arange(start, start + len(same))

    def insert(self, xy: F64) -> I64:
        """Insert points xy (n, 2), m; returns the vertex (n,) that each is or, within the
        tolerance, lies at.

        Of new points near each other the first in the (deterministic) order of insertion is kept.
        Raises :class:`SurfaceError` for a wrong shape, coordinates that are not finite, or points
        off the map.
        """
        points, start = checked(xy), self._used
        if self.fixed and not ((points >= self._xy[0]) & (points <= self._xy[2])).all():
            raise SurfaceError("a point lies off the map", reason="surface_off_map")
        self._used += len(points)
        if self._used > len(self._xy):
            room = 2 * self._used
            self._xy = np.concatenate([self._xy[:start], np.zeros((room - start, 2))])
            self._alive = np.concatenate([self._alive[:start], np.zeros(room - start, bool)])
            self._mesh = np.concatenate(
                [self._mesh[: self._size], triangle_table(room - self._size // 2)]
            )
        self._xy[start : self._used] = points
        same = np.empty(len(points), np.int64)
        self._add(start, np.arange(len(points)), same)
        return same

    def remove(self, vertices: I64) -> None:
        """Remove vertices (n,), along a curve, so that the way from one to the next is short.

        Raises :class:`SurfaceError` for a number that is no vertex, comes twice or is a corner of
        the map (nothing is removed then), and where fewer than three vertices or only collinear
        ones would be left (some are gone then).
        """
        gone = np.atleast_1d(np.asarray(vertices, dtype=np.int64))
        good = (gone >= self.fixed) & (gone < self._used)
        if not good.all() or not self.alive[gone].all() or len(np.unique(gone)) < len(gone):
            raise SurfaceError(
                "not a vertex that can be removed", reason="surface_vertex", value=gone[~good]
            )
        gone = gone[hilbert_order(self._xy[gone])]
        self._size, self._hint, done = remove_kernel(
            self._xy, self._mesh, self._size, self._hint, gone, self._w
        )
        self._alive[gone[:done]] = False
        if done < len(gone):
            raise SurfaceError(
                "the vertices left would be collinear",
                reason="surface_collinear",
                value=int(gone[done]),
            )

    def triangles(self) -> tuple[I32, I32]:
        """Triangles (m, 3), counter-clockwise, by vertex number, and neighbours (m, 3) opposite
        each vertex, -1 at the hull.
        """
        return export(self._mesh[: self._size], np.arange(self._used, dtype=np.int32))

    def locate(self, xy: F64) -> I32:
        """Vertices (n, 3) of a triangle that holds each of the points xy (n, 2), m; -1 outside the
        hull.
        """
        points = checked(xy)
        every = np.concatenate([self.xy, points])
        out, hint = np.full((len(points), 3), -1, np.int32), self._hint
        for i in range(len(points)):
            t, _ = locate(every, self._mesh, hint, self._used + i, self._w)
            hint = real_beside(self._mesh, t)
            if t == hint:
                out[i] = self._mesh[t, :3]
        return out

    def fault(self) -> str:
        """What is wrong with the triangulation, in words (see
        :func:`ladar_volume.surface.delaunay.fault`); empty where it is valid.
        """
        triangles, neighbours = self.triangles()
        number = np.cumsum(self.alive, dtype=np.int32) - 1
        return fault(self.xy[self.alive], number[triangles], neighbours)

    def is_valid(self) -> bool:
        """Whether the circle of every triangle is empty and the topology that of a triangulation of
        all vertices.
        """
        return not self.fault()


def checked(xy: F64) -> F64:
    """Points (n, 2) as float64; raises :class:`SurfaceError` for a wrong shape or coordinates that
    are not finite.
    """
    points = np.asarray(xy, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2:
        raise SurfaceError(
            f"points are (n, 2), not {points.shape}", reason="surface_shape", value=points.shape
        )
    if not np.isfinite(points).all():
        raise SurfaceError(
            "a point with a coordinate that is not finite", reason="surface_not_finite"
        )
    return points
