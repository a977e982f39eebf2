"""From a cloud to the surface that represents it: full or partial TIN, relevant triangles,
boundary, adjustment, exchange of diagonals.

The order is that of seed 000 chapters 2 and 3. Where diagonals are exchanged, the heights are
adjusted before, since the choice of diagonals depends on them, and again after.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ladar_volume.math.sparse_diagonal import diagonal_matrix
from ladar_volume.model.choices import ADJUST, MEASURES
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, Tin
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.tin.adaptive import RATIO, adaptive_tin
from ladar_volume.tin.adjustment_adjoint import height_covariance, raw_gradients
from ladar_volume.tin.asd_adjustment import adjust_asd
from ladar_volume.tin.boundary import edit_boundary
from ladar_volume.tin.diagonal_exchange import exchange_diagonals
from ladar_volume.tin.elevation_adjustment import (
    Adjustment,
    SurfaceFit,
    adjust_rms,
    adjust_rms_by_iteration,
    fit_of,
    fit_of_shared,
    measures,
    raw_gradient,
)
from ladar_volume.tin.full_tin import build_tin, part_of
from ladar_volume.tin.relevant import mark_relevant, with_relevant
from ladar_volume.tin.sampled_area import (
    SampledArea,
    sampled_without_isolated,
    triangles_in_sampled_area,
)
from ladar_volume.tin.window import inside, map_window

#: Variance of least sizes over that of least squares for Gaussian noise, in the limit of many
#: points per vertex.
ASD_VARIANCE = math.pi / 2.0


@dataclass(frozen=True)
class RepresentedSurface:
    """A surface and what its heights are made of.

    tin : vertices with ``source``, their rows among the points given; -1 for artificial corners,
    which are there for the relevant triangles "all" only · fit : the points the heights were
    adjusted to; None where the heights are those of the points · adjust : how · converged : whether
    the adjustment reached its tolerance · exchanges : of diagonals · initial : vertices from
    binning · off_map_count : points off the map · rms_m, asd_m, fit_count : measures of fit in the
    end, and over how many points; rms_before_m, asd_before_m : with the heights as measured ·
    sampled_area : the sampled area, where it tells the relevant triangles · adjusted_on : the
    surface before the exchange of diagonals, where the heights were adjusted on that one ·
    screened_count, levelled_count : points left out, and given the median of their neighbours,
    before
    """

    tin: Tin
    fit: SurfaceFit | None
    adjust: str
    converged: bool
    exchanges: int
    initial: int
    off_map_count: int
    rms_m: float
    asd_m: float
    fit_count: int
    rms_before_m: float
    asd_before_m: float
    sampled_area: SampledArea | None = None
    adjusted_on: Tin | None = None
    screened_count: int = 0
    levelled_count: int = 0

    def by_points(self, gradient: F64, points: int) -> F64:
        """From gradients (n, k, 3) of k results by the vertices to gradients (points, k, 3) by the
        points given.
        """
        if self.fit is not None:
            return raw_gradients(self.adjusted_on or self.tin, self.fit, gradient, points)
        out = np.zeros((points, gradient.shape[1], 3))
        own = self.tin.source >= 0
        out[self.tin.source[own]] = gradient[own]
        return out

    def by_heights(self, gradient_z: F64, points: int) -> F64:
        """As :meth:`by_points`, heights alone: from (n, k) to (points, k)."""
        if self.fit is not None:
            return raw_gradient(self.adjusted_on or self.tin, self.fit, gradient_z, points)
        out = np.zeros((points, gradient_z.shape[1]))
        own = self.tin.source >= 0
        out[self.tin.source[own]] = gradient_z[own]
        return out

    @property
    def variance_factor(self) -> float:
        """What the variance from the adjoint of least squares is to be multiplied with: above 1 for
        least sizes.
        """
        return ASD_VARIANCE if self.adjust == "asd" else 1.0

    def covariance(self, sigma_m: F64) -> Any:
        """Covariance (n, n), sparse, m², of the vertex heights for standard deviations (points,) m
        of the points: for adjusted heights the diagonal and the pairs joined by an edge. Artificial
        corners have none.
        """
        own = np.where(self.tin.source >= 0, sigma_m[self.tin.source] ** 2, 0.0)
        if self.fit is None:
            return diagonal_matrix(own)
        scale = float(np.median(self.fit.weight * sigma_m[self.fit.point] ** 2))
        factor = self.variance_factor * scale
        on = self.adjusted_on or self.tin
        C = height_covariance(on, self.fit, own / (factor or 1.0))
        C.data *= factor
        return C


def check_options(options: SurfaceParameters) -> None:
    """Raise :class:`SurfaceError` for an unknown adjustment or exchange."""
    if options.adjust not in ADJUST:
        raise SurfaceError(
            f"the adjustment is one of {ADJUST}, not {options.adjust!r}",
            reason="surface_adjustment",
            value=options.adjust,
        )
    if options.exchange not in (*MEASURES, "none"):
        raise SurfaceError(
            f"diagonals are exchanged by {MEASURES} or 'none', not {options.exchange!r}",
            reason="surface_measure",
        )


def represent(
    points_map: F64, options: SurfaceParameters, sigma_m: F64 | None = None, measured: bool = True
) -> RepresentedSurface:
    """The surface of points (n, 3), m; their standard deviations (n,), where known, weight the
    adjustment. Not ``measured``, a surface that nothing is adjusted on has NaN for its measures of
    fit, and costs no search for its points.

    Raises :class:`SurfaceError` for options that contradict one another and for points that make no
    surface.
    """
    check_options(options)
    points = np.asarray(points_map, dtype=np.float64)
    tin, initial, cropped = initial_triangulation(points, options, sigma_m)
    by_area = options.relevant == "sampled"
    tin = with_relevant(
        tin,
        "corners" if by_area else options.relevant,
        options.max_edge_m,
        options.max_circumdiameter_m,
    )
    found: SampledArea | None = None
    if by_area:
        tin, found = restrict_to_sampled_area(tin, points, options)
    if (
        math.isfinite(options.max_ear_edge_m)
        or options.min_island_m2 > 0.0
        or options.max_hole_m2 > 0.0
    ):
        tin = edit_boundary(
            tin, options.max_ear_edge_m, options.min_island_m2, options.max_hole_m2
        ).tin
    if options.relevant != "all":
        tin = without_artificial(tin)
    if not measured and (options.adjust, options.exchange) == ("none", "none"):
        none = (math.nan, math.nan, 0, math.nan, math.nan)
        made = RepresentedSurface(tin, None, "none", True, 0, initial, cropped, *none)
    else:
        made = adjust_surface(tin, points, options, sigma_m, initial, cropped)
    return made if found is None else dataclasses.replace(made, sampled_area=found)


def restrict_to_sampled_area(
    tin: Tin, points: F64, options: SurfaceParameters
) -> tuple[Tin, SampledArea]:
    """The surface with the triangles relevant that lie where the points sampled, and that area."""
    if options.full:
        tin, found = sampled_without_isolated(tin)
        mask = found.mask
    else:
        if options.window is not None:
            points = points[inside(points[:, :2], map_window(points[:, :2], options.window))]
        mask, found = triangles_in_sampled_area(tin, points)
    return mark_relevant(tin, tin.relevant & mask, "option 'sampled'"), found


def initial_triangulation(
    points: F64, options: SurfaceParameters, sigma_m: F64 | None
) -> tuple[Tin, int, int]:
    """The triangulation, how many of its vertices are from binning, and how many points lie off the
    map.
    """
    if options.full:
        if options.window is None:
            return build_tin(points), 0, 0
        keep = np.flatnonzero(inside(points[:, :2], map_window(points[:, :2], options.window)))
        tin = build_tin(points[keep])
        return dataclasses.replace(tin, source=keep[tin.source]), 0, len(points) - len(keep)
    o = options
    ratio = RATIO if (o.vertices, o.ratio, o.tolerance) == (None, None, None) else o.ratio
    found = adaptive_tin(
        points,
        vertices=o.vertices,
        ratio=ratio,
        tolerance=o.tolerance,
        criterion=o.criterion,
        sigma_m=sigma_m,
        window=o.window,
        bins_per_row=o.bins_per_row,
        duplicate_tolerance_m=o.duplicate_tolerance_m,
    )
    return found.tin, found.initial, found.off_map_count


def without_artificial(tin: Tin) -> Tin:
    """The same surface without its artificial corners and the triangles that meet them: nothing
    that is not data is left.
    """
    own = tin.source >= 0
    return tin if own.all() else part_of(tin, own)


def adjust_surface(
    tin: Tin, points: F64, o: SurfaceParameters, sigma_m: F64 | None, initial: int, cropped: int
) -> RepresentedSurface:
    """The surface with its heights adjusted and diagonals exchanged, as the options say."""
    # a surface through all points has nothing to be adjusted to
    through_all = o.full and tin.duplicates == 0
    if through_all:
        return RepresentedSurface(
            tin, None, "none", True, 0, initial, cropped, 0.0, 0.0, len(points) - cropped, 0.0, 0.0
        )
    sigma = sigma_m if sigma_m is not None and bool((sigma_m > 0).all()) else None
    if o.full and (o.adjust, o.exchange) == ("rms", "none"):
        return means_of_shared(tin, points, sigma, initial, cropped)
    raw, exchanges = fit_of(tin, points, sigma), 0
    before = measures(raw.residuals(tin.vertices[:, 2]))
    done = adjust_elevations(tin, points, o, raw)
    tin, fit = tin if done is None else done.tin, raw
    adjusted_on: Tin | None = None
    if o.exchange != "none":
        exchange = exchange_diagonals(tin, points, o.exchange)
        exchanges, raw = exchange.exchanges, fit_of(exchange.tin, points, sigma)
        if done is not None and not o.readjust:
            tin, adjusted_on = exchange.tin, tin
        else:
            done = adjust_elevations(exchange.tin, points, o, raw)
            tin, fit = exchange.tin if done is None else done.tin, raw
    after = measures(raw.residuals(tin.vertices[:, 2]))
    return RepresentedSurface(
        tin,
        None if done is None else fit,
        o.adjust,
        done is None or done.converged,
        exchanges,
        initial,
        cropped,
        *after,
        len(raw.point),
        *before,
        adjusted_on=adjusted_on,
    )


def means_of_shared(
    tin: Tin, points: F64, sigma_m: F64 | None, initial: int, cropped: int
) -> RepresentedSurface:
    """The surface through all points, at the mean height where several have one footprint."""
    fit, count = fit_of_shared(tin, points, sigma_m)
    done = adjust_rms(tin, points, fit=fit)
    before, after = (measures(fit.residuals(t.vertices[:, 2]), count) for t in (tin, done.tin))
    counts = (0, initial, cropped)
    return RepresentedSurface(done.tin, fit, "rms", True, *counts, *after, count, *before)


def adjust_elevations(
    tin: Tin, points: F64, options: SurfaceParameters, fit: SurfaceFit
) -> Adjustment | None:
    """The elevation adjustment asked for; None where there is none."""
    if options.adjust == "rms":
        return adjust_rms(tin, points, fit=fit)
    if options.adjust == "rms-iterated":
        return adjust_rms_by_iteration(
            tin, points, options.max_iterations, options.height_tolerance_m, fit=fit
        )
    return adjust_asd(tin, points, fit=fit) if options.adjust == "asd" else None
