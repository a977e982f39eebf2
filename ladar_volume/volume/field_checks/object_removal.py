"""The surface of a survey without what stands on it."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from ladar_volume.model.errors import GroundError, SurfaceError, VolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, I32, Bool, PatchTable, StandingObject, Volume
from ladar_volume.tin.full_tin import vertex_mask
from ladar_volume.volume.field_checks.standing_objects import (
    APART_M,
    bent_vertices,
    clumps,
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

#: Patches of mixed returns scatter so many times as much as usual, and so many metres, and have at
#: most such a part of the usual number of returns. Where more of the returns are in such patches,
#: the survey itself scatters.
SCATTERED, LEAST_M, FEW, MOST_MIXED = 5.0, 0.05, 0.25, 0.25


class Cleared(NamedTuple):
    """survey : the surface without what does not belong to it · footing : its base and outlines ·
    objects : what stood on it · mixed : points (n,) of patches of mixed returns that were left out
    """

    survey: SurveyedSurface
    footing: Footing
    objects: tuple[StandingObject, ...]
    mixed: Bool


def without_points(
    survey: SurveyedSurface, out: Bool, parameters: Parameters
) -> tuple[SurveyedSurface, Footing] | None:
    """The surface without the points ``out`` (n,), which it keeps the places of, and its footing;
    None where nothing is left.
    """
    try:
        made = survey_surface(survey.points, parameters, np.flatnonzero(~out))
        cleared = surveyed_surface(made, survey.points, survey.patches, survey.sources)
        cleared = dataclasses.replace(cleared, hidden=survey.points.r_map[out, :2])
        return cleared, footing_of(cleared, parameters)
    except (GroundError, SurfaceError, VolumeError):
        return None


def all_of(survey: SurveyedSurface, footing: Footing) -> Cleared:
    """A surface of which nothing is left out."""
    return Cleared(survey, footing, (), np.zeros(len(survey.points), np.bool_))


def mixed_patches(patches: PatchTable) -> Bool:
    """Patches (m,) of returns that lie on no surface, such as those measured half on an edge and
    half on what lies behind it, and echoes from below the ground: few where all around has many,
    and scattered as nothing around. What is usual is told from patches and from returns, as few
    such returns make many patches.
    """
    usual = min(float(np.median(patches.sigma)), of_returns(patches.sigma, patches.used))
    many = max(float(np.median(patches.used)), of_returns(patches.used, patches.used))
    out: Bool = patches.sigma > max(LEAST_M, SCATTERED * usual)
    return out & (patches.used < FEW * many)


def of_returns(value: F64 | I32, used: I32) -> float:
    """The median over returns of values (m,) of patches with so many returns each (m,)."""
    order = np.argsort(value, kind="stable")
    below = np.cumsum(used[order])
    return float(value[order[np.searchsorted(below, 0.5 * below[-1])]])


def without_mixed(survey: SurveyedSurface, footing: Footing, parameters: Parameters) -> Cleared:
    """The surface without patches of mixed returns: what they lie in is a shadow, which nobody
    saw.
    """
    patches = survey.patches
    scattered = mixed_patches(patches)
    mixed = scattered[survey.sources.geometry.row]
    few = patches.used[scattered].sum() <= MOST_MIXED * patches.used.sum()
    cleared = without_points(survey, mixed, parameters) if few and mixed.any() else None
    if cleared is None:
        return all_of(survey, footing)
    return Cleared(*cleared, (), mixed)


def without_objects(survey: SurveyedSurface, footing: Footing, parameters: Parameters) -> Cleared:
    """The surface without patches of mixed returns and without what stands on it."""
    if parameters.volume.objects != "remove":
        return all_of(survey, footing)
    found = without_mixed(survey, footing, parameters)
    tin, inside = found.survey.tin, found.footing.inside > 0.0
    standing = standing_vertices(tin, found.footing.base, inside, parameters.volume)
    if not standing.any():
        return found
    taken = bent_vertices(tin, standing, parameters.filter.radius_m)
    out = found.mixed.copy()
    out[tin.source[taken]] = True
    cleared = without_points(found.survey, out, parameters)
    if cleared is None:
        return found
    label = clumps(tin.vertices[standing, :2], APART_M)
    things = objects_of(tin, standing, taken, vertex_mask(tin, inside), label)
    return Cleared(*cleared, things, found.mixed)


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
