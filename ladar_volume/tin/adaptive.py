"""Partial TINs by adaptive insertion (seed 000 sections 2.3 and 2.4): few vertices that represent
all points.

The map's corners come first, then the point nearest the centre of every bin, then, strictly one at
a time, the point that the current surface misses most by one of :data:`CRITERIA`. Greedy selection
prefers the points with the largest errors: the heights of a partial TIN are to be adjusted to all
points (:mod:`ladar_volume.tin.elevation_adjustment`) before a volume is taken from it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ladar_volume.model.choices import CRITERIA
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I32, I64, Bool, Tin
from ladar_volume.tin.delaunay import finite_points
from ladar_volume.tin.duplicates import first_within
from ladar_volume.tin.greedy import (
    Cloud,
    Heap,
    InsertedPoints,
    fit_kernel,
    greedy_kernel,
    heap_kernel,
    start_kernel,
)
from ladar_volume.tin.insertion_order import by_rounds, hilbert_order
from ladar_volume.tin.predicates import COUNTS, workspace
from ladar_volume.tin.triangle_table import (
    MeshTable,
    export,
    first_triangle,
    insert_point,
    triangle_table,
)
from ladar_volume.tin.window import (
    Window,
    central_points,
    corners,
    default_bins,
    inside,
    map_window,
)

#: Part of the points that become vertices where nothing else is asked (seed 000 section 5.1: about
#: a third gave the best volumes).
RATIO = 1.0 / 3.0


@dataclass(frozen=True)
class AdaptiveTin:
    """A partial TIN and how it represents the n points it was made from.

    tin : the surface; its vertices are data points in the order of the input, then the artificial
    corners, whose ``source`` is -1; triangles that meet one of these are not relevant;
    ``duplicates`` counts the points on the map that lie on others · artificial : (a,) vertices that
    are no data points · triangle : (n,) triangle of each point, -1 off the map · residual : (n,) m,
    point minus surface, NaN off the map · same : (n,) the first point within the tolerance of each,
    -1 off the map · insertion_order : (v,) data vertices in the order of insertion, the first
    ``initial`` of them by binning · score : (v,) criterion at insertion, NaN for the initial ones ·
    off_map_count : points off the map · window : the map · exact_predicates : how many predicates
    reached the exact stage
    """

    tin: Tin
    artificial: I64
    triangle: I32
    residual: F64
    same: I32
    insertion_order: I64
    initial: int
    score: F64
    off_map_count: int
    window: Window
    exact_predicates: int


def vertex_limit(
    points: int,
    open_points: int,
    vertices: int | None,
    ratio: float | None,
    tolerance_m: float | None,
) -> int:
    """How many data vertices may be inserted. Raises :class:`SurfaceError` for a number below one
    or a ratio outside (0, 1].
    """
    if vertices is not None and ratio is not None:
        raise SurfaceError(
            "a number of vertices or a ratio, not both",
            reason="surface_vertices",
            value=(vertices, ratio),
        )
    if vertices is None and ratio is None:
        if tolerance_m is not None:
            return open_points
        ratio = RATIO
    if ratio is not None and not 0.0 < ratio <= 1.0:
        raise SurfaceError(
            f"the ratio {ratio} of vertices is not in (0, 1]",
            reason="surface_vertices",
            value=ratio,
        )
    limit = round(ratio * points) if ratio is not None else vertices
    assert limit is not None
    if vertices is not None and vertices < 1:
        raise SurfaceError(
            f"{vertices} vertices; there must be one or more",
            reason="surface_vertices",
            value=vertices,
        )
    return min(max(1, limit), open_points)


def check_residual_factors(
    points_map: F64, sigma_m: F64 | None, criterion: str, tolerance_m: float | None
) -> tuple[F64, F64]:
    """Points and the factor of each residual; raises :class:`SurfaceError` for what
    :func:`adaptive_tin` refuses.
    """
    if criterion not in CRITERIA:
        raise SurfaceError(
            f"the criterion is one of {CRITERIA}, not {criterion!r}",
            reason="surface_criterion",
            value=criterion,
        )
    points = finite_points(points_map)
    if tolerance_m is not None and not tolerance_m >= 0.0:
        raise SurfaceError(
            f"the tolerance is {tolerance_m}; it must be 0 or more",
            reason="surface_tolerance",
            value=tolerance_m,
        )
    if criterion != "residual-sigma":
        return points, np.ones(len(points))
    sigma = np.zeros(0) if sigma_m is None else np.asarray(sigma_m, dtype=np.float64)
    if sigma.shape != (len(points),) or not (np.isfinite(sigma) & (sigma > 0)).all():
        raise SurfaceError(
            "every point needs a positive standard deviation", reason="surface_sigma"
        )
    return points, 1.0 / sigma


def adaptive_tin(
    points_map: F64,
    *,
    vertices: int | None = None,
    ratio: float | None = None,
    tolerance: float | None = None,
    criterion: str = "residual-area",
    sigma_m: F64 | None = None,
    bins_per_row: int | None = None,
    window: Window | None = None,
    corner_height_m: float | None = None,
    duplicate_tolerance_m: float = 0.0,
) -> AdaptiveTin:
    """Partial (or, with ratio 1, full) Delaunay TIN of points (n, 3), m, map frame.

    vertices, ratio : when to stop, as a number of data vertices (points at the map's corners are
    always vertices) or as a part of the points on the map; one third where neither these nor a
    tolerance is given · tolerance : only points whose residual is larger are inserted, in metres,
    or in sigmas for the criterion "residual-sigma" · criterion : one of :data:`CRITERIA` · sigma_m
    : (n,) standard deviations · bins_per_row : of the initial binning; by default about a tenth of
    the vertices are initial · window : the map, to which the points are cropped; their bounding box
    by default · corner_height_m : height of corners without a point; by default that of the nearest
    point · duplicate_tolerance_m : points this near an earlier one do not become vertices, but
    count in the fit.
    Raises :class:`SurfaceError` for a wrong shape, values that are not finite, no point on the map,
    a map without area, unknown or contradicting options, and bins that hold more points than there
    may be vertices.
    """
    points, scale = check_residual_factors(points_map, sigma_m, criterion, tolerance)
    area = map_window(points[:, :2], window)
    on_map = np.flatnonzero(inside(points[:, :2], area))
    if len(on_map) == 0:
        raise SurfaceError("no point lies on the map", reason="surface_too_few_points", value=0)
    same = first_within(points[on_map, :2], duplicate_tolerance_m)
    first = same == np.arange(len(same))
    work, most = Insertion(points[on_map], scale[on_map], first, area, corner_height_m), first.sum()
    limit = vertex_limit(len(on_map), int(most), vertices, ratio, tolerance)
    work.start(limit, bins_per_row, full=tolerance is None and limit >= int(most))
    work.insert(limit, criterion == "residual-area", -1.0 if tolerance is None else tolerance)
    return work.result(len(points), on_map, same)


class Insertion:
    """One run of the insertion over the n points of a map; the points are kept along the Hilbert
    curve, so that neighbours are near.
    """

    def __init__(
        self, points: F64, scale: F64, first: Bool, window: Window, corner_height_m: float | None
    ) -> None:
        self.window, self.first, self.w = window, first, workspace()
        self.order = hilbert_order(points[:, :2])
        n, corner = len(points), corners(window)
        sorted_points = points[self.order]
        xy = np.concatenate([sorted_points[:, :2], corner])
        nearest = [int(np.argmin(((sorted_points[:, :2] - c) ** 2).sum(axis=1))) for c in corner]
        heights = (
            sorted_points[nearest, 2]
            if corner_height_m is None
            else np.full(4, float(corner_height_m))
        )
        after = np.full(n, -1, np.int32)
        self.cloud = Cloud(
            xy,
            np.concatenate([sorted_points[:, 2], heights]),
            scale[self.order],
            self.order,
            first[self.order],
            after,
        )
        self.mesh = triangle_table(int(np.count_nonzero(first)) + 4)
        self.corner = np.arange(n, n + 4)
        for k in range(4):
            at = np.flatnonzero((xy[:n] == corner[k]).all(axis=1) & self.cloud.open)
            if len(at):
                self.corner[k] = at[0]
                after[at[0]], self.cloud.open[at[0]] = -2, False
        a, b, c, d = self.corner.tolist()
        first_triangle(xy, self.mesh, a, b, c, self.w)
        self.size, self.hint, _ = insert_point(xy, self.mesh, 4, 0, d, self.w, False)
        self.taken = self.corner[self.corner < n].astype(np.int32)
        self.score = np.zeros(0)
        self.initial = 0

    def start(self, limit: int, bins_per_row: int | None, full: bool) -> None:
        """Insert the initial points: all of them for a full triangulation, else by binning."""
        n = len(self.order)
        if full:
            initial = by_rounds(np.arange(n, dtype=np.int32))
            initial = initial[self.cloud.open[initial]]
        else:
            place = np.empty(n, np.int64)
            place[self.order] = np.arange(n)
            xy = np.empty((n, 2))
            xy[self.order] = self.cloud.xy[:n]
            left = max(0, limit - len(self.taken))
            bins = default_bins(self.window, max(1, left)) if bins_per_row is None else bins_per_row
            chosen = place[central_points(xy, self.first, self.window, bins)]
            initial = chosen[self.cloud.open[chosen]].astype(np.int32)
            if bins_per_row is None:
                initial = initial[:left]
            elif len(initial) > left:
                words = (
                    f"the bins hold {len(initial)} points, but there may be {limit} vertices; "
                    "use fewer bins"
                )
                raise SurfaceError(words, reason="surface_bins", value=len(initial))
        self.size, _ = start_kernel(self.cloud, self.mesh, self.size, self.hint, initial, self.w)
        self.taken = np.concatenate([self.taken, initial])
        self.initial = len(self.taken)

    def insert(self, limit: int, by_area: bool, tolerance: float) -> None:
        """Insert the worst points up to the limit."""
        rows, left = len(self.mesh), max(0, limit - self.initial)
        heap = Heap(np.empty(rows), np.empty(rows, np.int32), np.empty(rows, np.int32))
        taken, score = np.empty(left, np.int32), np.empty(left)
        heap_kernel(self.cloud, heap, self.mesh, self.size, by_area, tolerance)
        self.size, count = greedy_kernel(
            self.cloud,
            heap,
            self.mesh,
            self.size,
            by_area,
            tolerance,
            self.w,
            InsertedPoints(taken, score),
        )
        self.taken, self.score = np.concatenate([self.taken, taken[:count]]), score[:count]

    def result(self, n: int, on_map: I64, same: I32) -> AdaptiveTin:
        """The record, with indices of the n points of the input; ``on_map`` are those of this
        run.
        """
        m: MeshTable = self.mesh[: self.size]
        k = len(self.order)
        row, residual = np.empty(k, np.int32), np.empty(k)
        fit_kernel(self.cloud, m, row, residual)
        inserted = on_map[self.order[self.taken]]
        rank = np.argsort(inserted)
        vertex = np.concatenate([self.taken[rank], self.corner[self.corner >= k]])
        name = np.full(k + 4, -1, np.int32)
        name[vertex] = np.arange(len(vertex))
        triangles, neighbours = export(m, name)
        artificial = np.arange(len(inserted), len(vertex))
        relevant: Bool = np.all(triangles < len(inserted), axis=1)
        at = np.column_stack([self.cloud.xy, self.cloud.z])[vertex]
        source = np.concatenate([inserted[rank], np.full(len(artificial), -1)])
        tin = Tin(at, triangles, neighbours, relevant, source, int(np.count_nonzero(~self.first)))
        out_triangle, out_same = np.full(n, -1, np.int32), np.full(n, -1, np.int32)
        out_residual = np.full(n, np.nan)
        out_triangle[on_map[self.order]], out_residual[on_map[self.order]] = m[row, 3], residual
        out_same[on_map] = on_map[same]
        score = np.concatenate([np.full(self.initial, np.nan), self.score])
        exact = int(self.w[COUNTS, :2].sum())
        return AdaptiveTin(
            tin,
            artificial,
            out_triangle,
            out_residual,
            out_same,
            inserted,
            self.initial,
            score,
            n - len(on_map),
            self.window,
            exact,
        )
