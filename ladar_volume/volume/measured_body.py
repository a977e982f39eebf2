"""From a surface and its base to the volume of each body with its budget, step by step.

Every step is a function of the records it names: :func:`footing_of` → :func:`measure_body` →
:func:`volume_of`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from statistics import NormalDist

import numpy as np

from ladar_volume.ground.ground_adjoint import ground_inverse
from ladar_volume.math.large_arrays import in_its_room
from ladar_volume.math.run_concurrently import run_concurrently
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, FilteredPoints, PatchTable, Plane, Tin, Volume
from ladar_volume.tin.full_tin import vertex_mask
from ladar_volume.tin.represent import RepresentedSurface
from ladar_volume.uncertainty.ground_field import Roughness
from ladar_volume.uncertainty.smoothing import cut_shift, own_shift
from ladar_volume.uncertainty.volume_budget import Budget, Sources
from ladar_volume.volume.base import area_by_body, base_and_outline, polygon_of
from ladar_volume.volume.centroid import centroid
from ladar_volume.volume.chord_bias import cut_and_fill_chords
from ladar_volume.volume.near_base import Fold
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

    @property
    def normal(self) -> F64:
        """Unit normals (v, 3) of the surface at its vertices."""
        return in_its_room(self.points.normal[self.tin.source])


@dataclass(frozen=True)
class Footing:
    """What the bodies stand on, and where each counts.

    inside : (t,) area of each triangle that counts, m² · parts : the same by body, the main body
    first · inverse : of the ground's normal equations, None for a base that is given
    """

    base: Plane
    inside: F64
    parts: tuple[F64, ...]
    inverse: F64 | None


@dataclass(frozen=True)
class MeasuredBody:
    """One body: area of each triangle that counts (t,) m², prismoids, budget, what noise does to
    cut and fill near the base, where that matters, and the field of the ground about its base, None
    above a base that is given.
    """

    part: F64
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
    parts = area_by_body(survey.tin, base, inside, parameters.volume)
    inverse = ground_inverse(survey.tin.vertices, base) if len(base.support) else None
    return Footing(base, inside, tuple(parts), inverse)


def solid_of(tin: Tin, base: Plane, part: F64, parameters: Parameters) -> Prismoids:
    """Cut, fill and net of the triangles that count."""
    if parameters.volume.outline == "polygon":
        return clipped_prismoids(tin, base, polygon_of(parameters.volume), part > 0)
    return prismoids(tin, base, part > 0)


def measure_body(
    survey: SurveyedSurface,
    footing: Footing,
    part: F64,
    parameters: Parameters,
    naive: bool,
    keep: KeepRoughness,
) -> MeasuredBody:
    """Volume and budget of the triangles that count (t,) m², and the correction near the base.

    naive : also the sigma that all points independent would give · keep : see
    :func:`~ladar_volume.volume.volume_loads.ground_field`.
    """
    solid = solid_of(survey.tin, footing.base, part, parameters)
    near = partial(_near_base, survey, footing, part)
    return _measure_budget(survey, footing, part, solid, naive, near, keep)


def joint_sigma(
    survey: SurveyedSurface,
    footing: Footing,
    pair: tuple[int, int],
    parameters: Parameters,
    keep: KeepRoughness,
) -> float:
    """Standard deviation m³ of the sum of two bodies, by number."""
    part = footing.parts[pair[0]] + footing.parts[pair[1]]
    solid = solid_of(survey.tin, footing.base, part, parameters)
    measured = _measure_budget(survey, footing, part, solid, False, lambda: None, keep)
    return measured.budget.sigma


def volume_of(
    survey: SurveyedSurface, footing: Footing, body: MeasuredBody, parameters: Parameters, t_ns: int
) -> Volume:
    """The record of one body: net, cut and fill with the bias of chords and smoothing and the fold
    near the base taken out.
    """
    tin, base, part, mask = survey.tin, footing.base, body.part, body.part > 0
    solid, budget, near = body.solid, body.budget, body.near
    above, below = cut_and_fill_chords(tin, survey.normal, base, part)
    folded = 0.0 if near is None else near.removed_m3(solid.cut_m3, solid.fill_m3)
    cut, fill = solid.cut_m3 - folded - above, solid.fill_m3 - folded + below
    smoothed = cut_shift(cut, fill, _smoothing_of_cut(survey, body), budget.smoothing_m3)
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


def _smoothing_of_cut(survey: SurveyedSurface, body: MeasuredBody) -> float:
    """What smoothing made cut too large by, m³: of the smaller one of cut and fill through the
    surface alone; the other has what is left of the net volume's, with what the base has of it.
    """
    solid, net_m3 = body.solid, body.budget.smoothing_m3
    row = survey.sources.geometry.row[survey.tin.source]
    if solid.cut_m3 >= solid.fill_m3:
        return net_m3 - own_shift(solid.gradient_fill, survey.patches, row)
    return -own_shift(solid.gradient_cut, survey.patches, row)


def _near_base(survey: SurveyedSurface, footing: Footing, part: F64) -> Fold | None:
    geometry = survey.sources.geometry
    return near_correction(
        survey.surface, footing.base, part, survey.points, survey.patches, geometry
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
    part: F64,
    solid: Prismoids,
    naive: bool,
    near: Callable[[], Fold | None],
    keep: KeepRoughness,
) -> MeasuredBody:
    """The budget of a solid: the ground's roughness in one thread, sensitivities in another."""
    sources = survey.sources

    def gradients() -> F64:  # large: held for the naive sigma alone
        return result_gradients(
            survey.tin, footing.base, solid, len(survey.points), survey.surface, footing.inverse
        )

    held = gradients() if naive else None
    (base_m6, rough), (sensitivities, fold) = run_concurrently(
        partial(_roughness, survey, footing, part, solid, keep),
        lambda: (sources.sensitivities(gradients() if held is None else held), near()),
    )
    # afterwards: it uses and completes what the roughness knows of the patches' errors
    naive_m3 = math.nan if held is None else sources.naive_sigma(held[:, 0])
    budget = sources.budget(sensitivities, base_m6, naive_m3)
    return MeasuredBody(part, solid, budget, fold, rough)
