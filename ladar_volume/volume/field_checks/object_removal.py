"""The surface of a survey without what stands on it."""

from __future__ import annotations

import numpy as np

from ladar_volume.model.errors import GroundError, SurfaceError, VolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, Bool, StandingObject, Volume
from ladar_volume.volume.field_checks.standing_objects import (
    bent_vertices,
    objects_of,
    standing_vertices,
)
from ladar_volume.volume.field_checks.survey_surface import survey_surface
from ladar_volume.volume.measured_body import (
    Footing,
    SurveyedSurface,
    footing_of,
    surveyed_surface,
)


def surface_without(survey: SurveyedSurface, taken: Bool, p: Parameters) -> SurveyedSurface:
    """The surface without the points of vertices ``taken`` (n,)."""
    keep = np.ones(len(survey.points), np.bool_)
    keep[survey.tin.source[taken]] = False
    made = survey_surface(survey.points, p, np.flatnonzero(keep))
    return surveyed_surface(made, survey.points, survey.patches, survey.sources)


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
        cleared = surface_without(survey, taken, parameters)
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
