"""What is surveyed in ``ladar_volume study coverage``, and what one survey gives: scenarios,
variants, and the numbers of one seed.

A variant is a pair of budgets: the one the errors are drawn from and the one the propagation
believes. ``all`` has both alike; ``lines`` draws one source at a time; the others draw what the
propagation does not know of.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from ladar_volume.change.epoch_change import epoch_difference
from ladar_volume.experiments.coverage.coverage_box import (
    BOX,
    BoxSite,
    ClosedBox,
    body_on_ground,
    closed_box,
)
from ladar_volume.experiments.coverage.coverage_flight import FIX_HZ, ground_of
from ladar_volume.experiments.coverage.coverage_scene import FIELDS, Site, level_truth
from ladar_volume.experiments.coverage.coverage_survey import (
    SOURCES,
    MappedSurvey,
    VertexSurvey,
    budget_of_lines,
    fly,
    noiseless_surface,
    survey,
    vertices,
)
from ladar_volume.model.parameters import (
    BudgetParameters,
    GeoreferenceParameters,
    Parameters,
    SurfaceFilterParameters,
    VolumeParameters,
)
from ladar_volume.model.records import Tin, Volume
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.tin.represent import represent
from ladar_volume.uncertainty.navigation_sum import NavigationBins
from ladar_volume.volume.base import base_and_outline, polygon_of
from ladar_volume.volume.chord_bias import chord_volumes
from ladar_volume.volume.estimator import VolumeEstimator
from ladar_volume.volume.overlay import volumes_between
from ladar_volume.volume.polygon import weights_of_rows
from ladar_volume.volume.prismoids import prismoids

#: The first seed; the rest count up.
SEED = 20_000
#: Half a margin beyond the foot, m, of the rectangle in which a volume above a level is counted.
MARGIN_M = 1.5
#: Between the two grounds over which one source alone errs.
OTHER_GROUND = 1_000_000
GROUND, LEVEL, EPOCHS, CLOSED = "own ground", "design level", "two epochs", "closed"
SITES: dict[str, Site | BoxSite] = {**FIELDS, BOX.name: BOX}


@dataclass(frozen=True)
class Row:
    """One volume: error, its predicted sigma, the naive one (all points independent), those for a
    third of and three times the correlation times, m³; and the variance of every line of the
    budget, m⁶.
    """

    error_m3: float
    sigma_m3: float
    naive_m3: float
    tau_m3: tuple[float, float]
    budget_m6: dict[str, float]


def scale_budget(
    budget: BudgetParameters, sigmas: float = 1.0, tau: float = 1.0
) -> BudgetParameters:
    """The budget with all standard deviations and all correlation times multiplied."""
    changes: dict[str, Any] = {}
    for fields in SOURCES.values():
        for name, _ in fields:
            value = getattr(budget, name)
            changes[name] = (
                tuple(sigmas * v for v in value) if isinstance(value, tuple) else sigmas * value
            )
    return dataclasses.replace(
        budget,
        **changes,
        tau_position_s=tau * budget.tau_position_s,
        tau_attitude_s=tau * budget.tau_attitude_s,
    )


DEFAULT = BudgetParameters()
ALL, LINES = "all", "lines"
NOISE, BASE_SURFACE = "noise", "base_surface"
#: Variant → the budget the errors are drawn from, and the one that is believed.
VARIANTS: dict[str, tuple[BudgetParameters, BudgetParameters]] = {
    ALL: (DEFAULT, DEFAULT),
    "tau three times as long": (scale_budget(DEFAULT, tau=3.0), DEFAULT),
    "tau a third": (scale_budget(DEFAULT, tau=1.0 / 3.0), DEFAULT),
    "sigmas 30 % larger": (scale_budget(DEFAULT, sigmas=1.3), DEFAULT),
    "sigmas 30 % smaller": (scale_budget(DEFAULT, sigmas=0.7), DEFAULT),
    "beams not modelled": (
        DEFAULT,
        dataclasses.replace(DEFAULT, beam_range_sigma_m=0.0, beam_vertical_sigma_rad=0.0),
    ),
}
SCENARIOS = tuple(SITES)


def bases(site: Site | BoxSite) -> tuple[str, ...]:
    """What the volumes of a site stand on."""
    if isinstance(site, BoxSite):
        return (CLOSED,)
    return (EPOCHS,) if site.height_m < 0 else (GROUND, LEVEL)


def believed_parameters(budget: BudgetParameters, site: Site, base: str) -> Parameters:
    """Parameters of the estimation: the body's automatic outline above its own ground, or a
    rectangle above the level 0.
    """
    volume = VolumeParameters(max_edge_m=site.max_edge_m)
    if base == LEVEL:
        x, y = level_half(site)
        volume = dataclasses.replace(
            volume, base="level", outline="polygon", polygon_m=(-x, -y, x, -y, x, y, -x, y)
        )
    return dataclasses.replace(at_vertex_level(budget), volume=volume)


def at_vertex_level(budget: BudgetParameters) -> Parameters:
    """Parameters of a survey whose every return is a vertex. The rate of the fixes is known, by the
    longest gap that is bridged, and a time bin is as long: a few returns for each fix do not see
    the same as those for the next one, as thousands would.
    """
    step_s = 1.0 / FIX_HZ
    return Parameters(
        budget=budget,
        georeference=GeoreferenceParameters(max_position_gap_s=step_s),
        filter=SurfaceFilterParameters(nav_bin_s=step_s),
    )


def level_half(site: Site) -> tuple[float, float]:
    """Half length and width of that rectangle."""
    return site.a + MARGIN_M, site.b + MARGIN_M


def truth(site: Site | BoxSite, base: str, seed: int) -> float:
    """The exact volume, m³."""
    if base == LEVEL and isinstance(site, Site):
        return level_truth(site, ground_of(site, seed), level_half(site), 0.0)
    return site.volume_m3


def measure_survey(
    site: Site | BoxSite, drawn: BudgetParameters, believed: BudgetParameters, seed: int
) -> dict[str, Row]:
    """One whole survey, or two for a difference: by base its error and what the propagation says of
    it.
    """
    if isinstance(site, BoxSite):
        P = at_vertex_level(believed)
        return {CLOSED: box_row(site, survey(site, drawn, P, seed), P)}
    if site.height_m < 0:
        P = believed_parameters(believed, site, EPOCHS)
        before, after = (
            estimator_of(VertexSurvey(vertices(f, P), f.states), P).epoch()
            for f in epochs(site, drawn, believed, seed)
        )
        return {EPOCHS: row_of(epoch_difference(after, before)[0].volume, site.volume_m3)}
    first, out = believed_parameters(believed, site, GROUND), {}
    estimator = estimator_of(survey(site, drawn, first, seed), first)
    for base in bases(site):
        estimator.set_parameters(believed_parameters(believed, site, base))
        out[base] = row_of(estimator.estimate().volume, truth(site, base, seed))
    return out


def row_of(v: Volume, true_m3: float) -> Row:
    """A volume as its error and what it says of itself."""
    return Row(
        v.volume_m3 - true_m3,
        v.sigma_m3,
        v.sigma_naive_m3,
        v.sigma_tau_range_m3,
        by_source(v.budget_m6),
    )


def box_row(site: BoxSite, flown: VertexSurvey, parameters: Parameters) -> Row:
    """The closed body of a survey of a box."""
    navigation = NavigationBins(parameters.filter.nav_bin_s)
    navigation.add(flown.states)
    return closed_row(
        closed_box(flown.update.points, flown.update.patches, navigation, parameters),
        site.volume_m3,
    )


def closed_row(found: ClosedBox, true_m3: float) -> Row:
    """A closed body as its error and what it says of itself."""
    return Row(
        found.volume_m3 - true_m3,
        found.sigma_m3,
        found.sigma_naive_m3,
        found.sigma_tau_range_m3,
        by_source(found.budget_m6),
    )


#: Lines of the budget that are part of another one's source.
PARTS = {
    "noise_tangential": "noise",
    "smoothing": "noise",
    "boresight_second_order": "boresight",
    "attitude_second_order": "attitude",
}


def by_source(budget_m6: dict[str, float]) -> dict[str, float]:
    """The budget by source: what one source does in several lines, or in both of two epochs, in
    one.
    """
    out: dict[str, float] = {}
    for line, variance in budget_m6.items():
        own = line.removesuffix("_previous")
        own = PARTS.get(own, own)
        out[own] = out.get(own, 0.0) + variance
    return out


def epochs(
    site: Site,
    drawn: BudgetParameters,
    believed: BudgetParameters,
    seed: int,
    ground: int | None = None,
) -> tuple[MappedSurvey, MappedSurvey]:
    """Before and after: one instrument and one ground, two flights."""
    before = dataclasses.replace(site, height_m=0.0)
    return fly(before, drawn, believed, seed, 2 * seed, ground), fly(
        site, drawn, believed, seed, 2 * seed + 1, ground
    )


def full_tin(flown: MappedSurvey, parameters: Parameters) -> Tin:
    """Every vertex of the survey in one TIN, with the triangles that the parameters call
    relevant.
    """
    return represent(flown.points.r_map, options_of(parameters), measured=False).tin


def options_of(parameters: Parameters) -> SurfaceParameters:
    """A full TIN's options."""
    v = parameters.volume
    return SurfaceParameters(
        ratio=1.0,
        adjust="none",
        relevant=v.relevant,
        max_edge_m=v.max_edge_m,
        max_circumdiameter_m=v.max_circumdiameter_m,
    )


def estimator_of(flown: VertexSurvey, parameters: Parameters) -> VolumeEstimator:
    """The volume stage, with one survey in it."""
    estimator = VolumeEstimator(parameters)
    estimator.add_platform(flown.states)
    estimator.add(flown.update)
    return estimator


def net_volumes(
    site: Site | BoxSite, drawn: BudgetParameters, seed: int, ground: int | None = None
) -> dict[str, float]:
    """By base the volume alone, m³, of a survey with other errors than believed, over the ground of
    ``seed`` or another.
    """
    if isinstance(site, BoxSite):
        return {
            CLOSED: body_on_ground(
                noiseless_surface(fly(site, drawn, DEFAULT, seed, ground=ground))
            )[0].volume_m3
        }
    if site.height_m < 0:
        before, after = (
            full_tin(s, believed_parameters(DEFAULT, site, EPOCHS))
            for s in epochs(site, drawn, DEFAULT, seed, ground)
        )
        return {EPOCHS: volumes_between(after, before, gradients=False).net_m3}
    P = believed_parameters(DEFAULT, site, GROUND)
    flown = fly(site, drawn, DEFAULT, seed, ground=ground)
    tin = full_tin(flown, P)
    plane, inside = base_and_outline(tin, np.zeros(len(tin.vertices)), P)
    rows, held = weights_of_rows(tin, polygon_of(believed_parameters(DEFAULT, site, LEVEL).volume))
    weights = np.zeros((len(tin.triangles), 3))
    weights[rows] = held
    above_level = float((weights * tin.vertices[tin.triangles, 2]).sum())
    volumes = prismoids(tin, plane, inside > 0).net_m3, above_level
    chords = (
        float(chord_volumes(tin, flown.normal[tin.source], area).sum())
        for area in (inside, weights.sum(axis=1))
    )
    return {
        base: volume - chord
        for base, volume, chord in zip((GROUND, LEVEL), volumes, chords, strict=True)
    }


def volume_changes_by_source(site: Site | BoxSite, seed: int) -> dict[str, dict[str, list[float]]]:
    """By base and line of the budget: the changes of the volume (m³) when that source alone errs,
    the same errors over two grounds of their own roughness; over one for noise, and for a box, on
    whose smooth ground little depends.

    The change is against the same survey without any error, so that what the sampling of the
    surface does is in both. The roughness of the ground is what is left without any other error:
    its change is the error of that survey.
    """
    out: dict[str, dict[str, list[float]]] = {base: {} for base in bases(site)}
    for ground in (seed,) if isinstance(site, BoxSite) else (seed, seed + OTHER_GROUND):
        off = net_volumes(site, budget_of_lines(DEFAULT), seed, ground)
        for line in SOURCES:
            if line == NOISE and ground != seed:
                continue
            changed = net_volumes(site, budget_of_lines(DEFAULT, line), seed, ground)
            for base, volume in off.items():
                out[base].setdefault(line, []).append(changed[base] - volume)
        for base in {GROUND, CLOSED} & set(off):
            out[base].setdefault(BASE_SURFACE, []).append(off[base] - truth(site, base, ground))
    return out
