"""From a surface and its base to the volume of each body with its budget, step by step.

Every step is a function of the records it names: :func:`footing_of` → :func:`measure_body` →
:func:`volume_of`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property, partial
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from ladar_volume.ground.ground_adjoint import ground_inverse
from ladar_volume.math.large_arrays import in_its_room, taken
from ladar_volume.math.run_concurrently import run_concurrently
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, I32, I64, FilteredPoints, PatchTable, Plane, Tin, Volume
from ladar_volume.tin.full_tin import any_corner, part_of, vertex_mask
from ladar_volume.tin.represent import RepresentedSurface
from ladar_volume.uncertainty.ground_field import Roughness
from ladar_volume.uncertainty.smoothing import cut_shift, own_shift
from ladar_volume.uncertainty.vertex_noise import MOST_RINGS
from ladar_volume.uncertainty.volume_budget import Budget, Sources
from ladar_volume.volume.base import base_and_outline, body_of_each, polygon_of
from ladar_volume.volume.centroid import centroid
from ladar_volume.volume.chord_bias import cut_and_fill_chords
from ladar_volume.volume.near_base import Fold
from ladar_volume.volume.neighbourhood import grow_kernel
from ladar_volume.volume.outline import boundary_loop
from ladar_volume.volume.polygon import clipped_prismoids
from ladar_volume.volume.prismoids import Prismoids, prismoids
from ladar_volume.volume.volume_loads import (
    KeepRoughness,
    base_name,
    ground_field,
    near_correction,
    result_gradients,
    vertex_variance,
)

#: How far around a body checks look, m; two radii of the filter where these are more.
AROUND_M = 4.0


@dataclass(frozen=True)
class SurveyedSurface:
    """The surface of a survey and what is known of its errors.

    points, patches : the filtered surface it is made from · height_variance : (v,) m² of the
    vertices, noise alone · hidden : (h, 2) m, where points were that were taken out
    """

    surface: RepresentedSurface
    points: FilteredPoints
    patches: PatchTable
    sources: Sources
    height_variance: F64
    hidden: F64 = field(default_factory=lambda: np.zeros((0, 2)))

    @property
    def tin(self) -> Tin:
        """The surface's triangles."""
        return self.surface.tin

    @cached_property
    def normal(self) -> F64:
        """Unit normals (v, 3) of the surface at its vertices."""
        return taken(self.points.normal, self.tin.source)


@dataclass(frozen=True)
class Footing:
    """What the bodies stand on, and where each counts.

    inside : (t,) area of each triangle that counts, m² · body : (t,) number of the body that each
    counts for, the main one's 0, -1 for none; None where there is one body · bodies : how many ·
    inverse : of the ground's normal equations, None for a base that is given
    """

    base: Plane
    inside: F64
    body: I32 | None
    bodies: int
    inverse: F64 | None

    def part(self, number: int) -> F64:
        """Area (t,) m² of each triangle that counts for the body with this number."""
        if self.body is None:
            return self.inside
        return in_its_room(np.where(self.body == number, self.inside, 0.0))

    def parts(self) -> Iterator[F64]:
        """The same of all bodies, one after the other."""
        return map(self.part, range(self.bodies))


class BodySurface(NamedTuple):
    """A body on its surface. whole : (t,) area of each triangle of the whole surface that counts,
    m² · survey : the part of it that checks of the body see · part : the same as ``whole`` of its
    triangles · vertex : (v,) its vertices in the whole, None where it is the whole
    """

    whole: F64
    survey: SurveyedSurface
    part: F64
    vertex: I64 | None


@dataclass(frozen=True)
class MeasuredBody:
    """One body: its surface, prismoids over that, budget, what noise does to cut and fill near the
    base, where that matters, and the field of the ground about its base, None above a base that is
    given.
    """

    on: BodySurface
    solid: Prismoids
    budget: Budget
    near: Fold | None
    rough: Roughness | None


def surveyed_surface(
    surface: RepresentedSurface, points: FilteredPoints, patches: PatchTable, sources: Sources
) -> SurveyedSurface:
    """A surface with the noise of its vertices."""
    return SurveyedSurface(surface, points, patches, sources, vertex_variance(surface, points))


def footing_of(survey: SurveyedSurface, parameters: Parameters) -> Footing:
    """Base, outline and bodies. Raises :class:`GroundError` where no base can be fitted and
    :class:`VolumeError` where nothing lies inside the outline.
    """
    base, inside = base_and_outline(survey.tin, survey.height_variance, parameters)
    body, bodies = body_of_each(survey.tin, base, inside, parameters.volume)
    inverse = ground_inverse(survey.tin.vertices, base) if len(base.support) else None
    return Footing(base, inside, body, bodies, inverse)


def solid_of(tin: Tin, base: Plane, part: F64, parameters: Parameters) -> Prismoids:
    """Cut, fill and net of the triangles that count."""
    if parameters.volume.outline == "polygon":
        return clipped_prismoids(tin, base, polygon_of(parameters.volume), part > 0)
    return prismoids(tin, base, part > 0)


def body_surface(
    survey: SurveyedSurface, footing: Footing, whole: F64, radius_m: float
) -> BodySurface:
    """The surface of one of several bodies, ``whole`` (t,) m² of each triangle, so that the work
    for it does not grow with the rest: with what lies as far around as neighbourhoods of heights,
    and checks of a surface by a filter of this radius, reach. One body alone has all.
    """
    if footing.body is None:
        return BodySurface(whole, survey, whole, None)
    tin, xy = survey.tin, survey.tin.vertices[:, :2]
    seen = vertex_mask(tin, whole > 0.0)
    reach_m = max(AROUND_M, 2.0 * radius_m)
    low, high = xy[seen].min(axis=0) - reach_m, xy[seen].max(axis=0) + reach_m
    grow_kernel(tin.triangles, seen, MOST_RINGS + 2)
    seen |= ((xy >= low) & (xy <= high)).all(axis=1)
    vertex = np.flatnonzero(seen)
    surface = dataclasses.replace(survey.surface, tin=part_of(tin, seen))
    variance = survey.height_variance[vertex]
    around = dataclasses.replace(survey, surface=surface, height_variance=variance)
    return BodySurface(whole, around, whole[~any_corner(tin.triangles, ~seen)], vertex)


def measure_body(
    survey: SurveyedSurface,
    footing: Footing,
    on: BodySurface,
    parameters: Parameters,
    naive: bool,
    keep: KeepRoughness,
    coefficients: bool = True,
) -> MeasuredBody:
    """Volume and budget of the triangles that count (t,) m², and the correction near the base.

    naive : also the sigma that all points independent would give · keep : see
    :func:`~ladar_volume.volume.volume_loads.ground_field` · coefficients : also the covariance of
    those of the base
    """
    solid = solid_of(on.survey.tin, footing.base, on.part, parameters)
    near = partial(_near_base, on, footing)
    return _measure_budget(survey, footing, on, solid, (naive, coefficients), near, keep)


def joint_sigma(
    survey: SurveyedSurface,
    footing: Footing,
    pair: tuple[int, int],
    parameters: Parameters,
    keep: KeepRoughness,
) -> float:
    """Standard deviation m³ of the sum of two bodies, by number."""
    whole = footing.part(pair[0]) + footing.part(pair[1])
    on = BodySurface(whole, survey, whole, None)
    solid = solid_of(survey.tin, footing.base, whole, parameters)
    measured = _measure_budget(survey, footing, on, solid, (False, False), lambda: None, keep)
    return measured.budget.sigma


def volume_of(footing: Footing, body: MeasuredBody, parameters: Parameters, t_ns: int) -> Volume:
    """The record of one body: net, cut and fill with the bias of chords and smoothing and the fold
    near the base taken out.
    """
    survey, part, base = body.on.survey, body.on.part, footing.base
    tin, mask = survey.tin, part > 0
    solid, budget, near = body.solid, body.budget, body.near
    above, below = cut_and_fill_chords(tin, survey.normal, base, part)
    folded = 0.0 if near is None else near.removed_m3(solid.cut_m3, solid.fill_m3)
    cut, fill = solid.cut_m3 - folded - above, solid.fill_m3 - folded + below
    smoothed = cut_shift(cut, fill, _smoothing_of_cut(body), budget.smoothing_m3)
    v = parameters.volume
    return Volume(
        volume_m3=solid.net_m3 - above - below - budget.smoothing_m3,
        sigma_m3=budget.sigma,
        confidence=v.confidence,
        coverage_factor=NormalDist().inv_cdf(0.5 + v.confidence / 2),
        cut_m3=cut - smoothed,
        fill_m3=fill - (smoothed - budget.smoothing_m3),
        area_m2=solid.area_m2,
        base=base_name(parameters),
        base_same_survey=v.base == "ground",
        centroid_map=centroid(tin, base, part),
        budget_m6=budget.lines,
        sigma_tau_range_m3=budget.sigma_tau_range,
        sigma_naive_m3=budget.sigma_naive,
        outline=polygon_of(v) if v.outline == "polygon" else boundary_loop(tin, mask),
        vertices=int(np.count_nonzero(vertex_mask(tin, mask))),
        triangles=int(np.count_nonzero(mask)),
        t_ns=t_ns,
        folded_m3=folded,
        budget_within_m6=budget.within,
        near_area_m2=0.0 if near is None else near.near_area_m2,
        second_order_m3=budget.second.shift_m3,
        second_order_matters=budget.second.matters,
        chord_m3=above + below,
        smoothing_m3=budget.smoothing_m3,
    )


def _smoothing_of_cut(body: MeasuredBody) -> float:
    """What smoothing made cut too large by, m³: of the smaller one of cut and fill through the
    surface alone; the other has what is left of the net volume's, with what the base has of it.
    """
    solid, net_m3, survey = body.solid, body.budget.smoothing_m3, body.on.survey
    row = taken(survey.sources.geometry.row, survey.tin.source)
    if solid.cut_m3 >= solid.fill_m3:
        return net_m3 - own_shift(solid.gradient_fill, survey.patches, row)
    return -own_shift(solid.gradient_cut, survey.patches, row)


def _near_base(on: BodySurface, footing: Footing) -> Fold | None:
    survey = on.survey
    return near_correction(
        survey.surface,
        footing.base,
        on.part,
        survey.points,
        survey.patches,
        survey.sources.geometry,
    )


def _roughness(
    survey: SurveyedSurface, footing: Footing, part: F64, solid: Prismoids, keep: KeepRoughness
) -> tuple[float, Roughness | None]:
    """Variance m⁶ from the ground between its points, and its field."""
    field = ground_field(
        survey.tin,
        footing.base,
        solid.base_net,
        part,
        survey.height_variance,
        survey.sources,
        footing.inverse,
        keep,
    )
    return (0.0, None) if field is None else (field.variance_m6, field.rough)


def _measure_budget(
    survey: SurveyedSurface,
    footing: Footing,
    on: BodySurface,
    solid: Prismoids,
    also: tuple[bool, bool],
    near: Callable[[], Fold | None],
    keep: KeepRoughness,
) -> MeasuredBody:
    """The budget of a solid: the ground's roughness in one thread, sensitivities in another.

    also : whether the naive sigma, and the covariance of the base, are asked for
    """
    sources, (naive, coefficients) = survey.sources, also

    def gradients() -> F64:  # large: held for the naive sigma alone
        return result_gradients(
            survey.tin,
            footing.base,
            solid,
            len(survey.points),
            survey.surface,
            footing.inverse,
            coefficients,
            on.vertex,
        )

    held = gradients() if naive else None
    (base_m6, rough), (sensitivities, fold) = run_concurrently(
        partial(_roughness, survey, footing, on.whole, solid, keep),
        lambda: (sources.sensitivities(gradients() if held is None else held), near()),
    )
    # afterwards: it uses and completes what the roughness knows of the patches' errors
    naive_m3 = math.nan if held is None else sources.naive_sigma(held[:, 0])
    budget = sources.budget(sensitivities, base_m6, naive_m3)
    return MeasuredBody(on, solid, budget, fold, rough)
