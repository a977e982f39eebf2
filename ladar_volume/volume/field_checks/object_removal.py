"""The surface of a survey without what stands on it."""

from __future__ import annotations

import dataclasses

import numpy as np

from ladar_volume.model.errors import GroundError, SurfaceError, VolumeError
from ladar_volume.model.parameters import Parameters, VolumeParameters
from ladar_volume.model.records import F64, I64, Bool, StandingObject, Volume
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.tin.represent import RepresentedSurface, represent
from ladar_volume.volume.field_checks.standing_objects import (
    bent_vertices,
    objects_of,
    standing_vertices,
)
from ladar_volume.volume.measured_body import (
    Footing,
    SurveyedSurface,
    footing_of,
    surveyed_surface,
)


def surface_options(v: VolumeParameters) -> SurfaceParameters:
    """How the filtered points of a survey become its surface."""
    adjust = "none" if v.vertex_ratio == 1.0 else "rms"  # copies of a footprint stay out
    return SurfaceParameters(
        ratio=v.vertex_ratio,
        adjust=adjust,
        relevant=v.relevant,
        max_edge_m=v.max_edge_m,
        max_circumdiameter_m=v.max_circumdiameter_m,
    )


def surface_without(survey: SurveyedSurface, taken: Bool, v: VolumeParameters) -> SurveyedSurface:
    """The surface without the points of vertices ``taken`` (n,)."""
    keep = np.ones(len(survey.points), np.bool_)
    keep[survey.tin.source[taken]] = False
    rows = np.flatnonzero(keep)
    made = represent(survey.points.r_map[rows], surface_options(v), measured=False)
    return surveyed_surface(by_rows(made, rows), survey.points, survey.patches, survey.sources)


def by_rows(made: RepresentedSurface, rows: I64) -> RepresentedSurface:
    """A surface made from the points ``rows`` (k,), by the numbers of all points."""
    tin = dataclasses.replace(made.tin, source=rows[made.tin.source])
    fit = made.fit
    if fit is not None:
        fit = dataclasses.replace(fit, point=rows[fit.point])
    return dataclasses.replace(made, tin=tin, fit=fit)


def without_objects(
    survey: SurveyedSurface, footing: Footing, parameters: Parameters
) -> tuple[SurveyedSurface, Footing, tuple[StandingObject, ...]]:
    """The surface without what stands on it, its footing, and what that was."""
    if parameters.volume.objects != "remove":
        return survey, footing, ()
    tin, inside = survey.tin, footing.inside > 0.0
    standing = standing_vertices(tin, footing.base, inside, parameters.volume)
    if not standing.any():
        return survey, footing, ()
    taken = bent_vertices(tin, standing, parameters.filter.radius_m)
    try:
        cleared = surface_without(survey, taken, parameters.volume)
        new = footing_of(cleared, parameters)
    except (GroundError, SurfaceError, VolumeError):  # nothing is left without it
        return survey, footing, ()
    return cleared, new, objects_of(tin, standing, taken, inside)


def objects_by_body(
    objects: tuple[StandingObject, ...], volumes: tuple[Volume, ...]
) -> list[tuple[StandingObject, ...]]:
    """The objects of each of several bodies: those nearest to its outline."""
    if len(volumes) == 1:
        return [objects]

    def away(one: StandingObject, outline: F64) -> float:
        xy = outline - (one.x_m, one.y_m)
        return float((xy**2).sum(axis=1).min(initial=np.inf))

    nearest = [int(np.argmin([away(one, v.outline) for v in volumes])) for one in objects]
    return [
        tuple(one for one, at in zip(objects, nearest, strict=True) if at == k)
        for k in range(len(volumes))
    ]
