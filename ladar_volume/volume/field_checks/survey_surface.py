"""From the filtered points of a survey to its surface, as ``volume.vertex_ratio``,
``volume.relevant`` and the section ``tin`` say (seed 000 chapters 2 and 3).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, I64, LEAST_UPWARD, FilteredPoints
from ladar_volume.model.surface_parameters import RepresentationParameters, SurfaceParameters
from ladar_volume.tin.median_screen import tin_filter, tin_screen
from ladar_volume.tin.represent import RepresentedSurface, represent

#: What a survey's surface and a cloud's have in common.
SHARED = tuple(f.name for f in dataclasses.fields(RepresentationParameters))


def surface_options(parameters: Parameters) -> SurfaceParameters:
    """How the filtered points of a survey become its surface. Raises
    :class:`~ladar_volume.model.errors.ConfigurationError` for options without effect.
    """
    v, t = parameters.checked().volume, parameters.tin
    shared = {name: getattr(t, name) for name in SHARED}
    if v.vertex_ratio == 1.0:
        shared["adjust"] = "none"  # copies of a footprint stay out
    return SurfaceParameters(
        **shared,
        ratio=v.vertex_ratio,
        relevant=v.relevant,
        max_edge_m=v.max_edge_m,
        max_circumdiameter_m=v.max_circumdiameter_m,
        bins_per_row=t.bins_per_row or None,
    )


def survey_surface(
    points: FilteredPoints, parameters: Parameters, rows: I64 | None = None
) -> RepresentedSurface:
    """The surface of the points ``rows`` (k,), of all where there are none, by the numbers of all
    points; screened and levelled before.

    A levelled point keeps its own sensitivities and noise: those of its neighbours, whose median
    its height is, are all but the same. Raises :class:`~ladar_volume.model.errors.SurfaceError` for
    points that make no surface.
    """
    t = parameters.tin
    r = points.r_map if rows is None else points.r_map[rows]
    screened = levelled = 0
    if t.screen_m > 0.0:
        kept = tin_screen(r, t.screen_m)
        rows = kept.index if rows is None else rows[kept.index]
        r, screened = kept.points_map, kept.count
    if t.median_m > 0.0:
        found = tin_filter(r, t.median_m)
        r, levelled = found.points_map, found.count
    sigma = height_sigma(points, rows) if t.criterion == "residual-sigma" else None
    made = represent(r, surface_options(parameters), sigma, measured=False)
    made = made if rows is None else by_rows(made, rows)
    if screened or levelled:
        made = dataclasses.replace(made, screened_count=screened, levelled_count=levelled)
    return made


def height_sigma(points: FilteredPoints, rows: I64 | None) -> F64:
    """Standard deviation (k,) m of the heights of points ``rows`` (k,), of all for None."""
    upward = np.maximum(np.abs(points.normal[:, 2]), LEAST_UPWARD)
    sigma: F64 = np.sqrt(points.variance) / upward
    return sigma if rows is None else sigma[rows]


def by_rows(made: RepresentedSurface, rows: I64) -> RepresentedSurface:
    """A surface made from the points ``rows`` (k,), by the numbers of all points."""
    tin, fit, on = (made.tin, made.fit, made.adjusted_on)
    tin = dataclasses.replace(tin, source=rows[tin.source])
    if fit is not None:
        fit = dataclasses.replace(fit, point=rows[fit.point])
    if on is not None:
        on = dataclasses.replace(on, source=rows[on.source])
    return dataclasses.replace(made, tin=tin, fit=fit, adjusted_on=on)
