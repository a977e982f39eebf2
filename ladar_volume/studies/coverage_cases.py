"""What is surveyed in ``ladar_volume study coverage``, and what one survey gives: scenarios, variants, and the numbers of one seed.

A variant is a pair of budgets: the one the errors are drawn from and the one the propagation believes. ``all`` has both alike;
``lines`` draws one source at a time; the others draw what the propagation does not know of.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ladar_volume.ground.polynomial import design_surface
from ladar_volume.model.parameters import BudgetParameters, Parameters, VolumeParameters
from ladar_volume.model.records import F64, FilterUpdate, Tin
from ladar_volume.studies.coverage_scene import SITES, Site, level_truth
from ladar_volume.studies.coverage_survey import SOURCES, VertexSurvey, survey, without
from ladar_volume.surface.represent import SurfaceOptions, represent
from ladar_volume.volume.assembly import vertex_variance
from ladar_volume.volume.base import base_and_outline, polygon_of
from ladar_volume.volume.budget import Sources
from ladar_volume.volume.estimator import VolumeEstimator
from ladar_volume.volume.navigation import NavigationBins, NavigationLoads, navigation_loads, navigation_variance
from ladar_volume.volume.overlay import between
from ladar_volume.volume.polygon import areas_inside, clipped_prismoids
from ladar_volume.volume.prismoids import prismoids
from ladar_volume.volume.propagation import (
    calibration_sensitivity,
    calibration_variance,
    independent_covariance,
    navigation_sensitivity,
    patch_loads,
    surface_geometry,
    tangential_variance,
)

#: First seeds; the rest count up. Surveys with one source at a time have seeds of their own.
SEED, LINES_SEED = 20_000, 60_000
#: Half a margin beyond the foot, m, of the rectangle in which a volume above a level is counted.
MARGIN_M = 1.5
GROUND, LEVEL, EPOCHS = "own ground", "design level", "two epochs"


@dataclass(frozen=True)
class Row:
    """One volume: error, its predicted sigma, the naive one (all points independent), those for a third of and three times the correlation
    times, m³; and the variance of every line of the budget, m⁶."""

    error_m3: float
    sigma_m3: float
    naive_m3: float
    tau_m3: tuple[float, float]
    budget_m6: dict[str, float]


def scaled(budget: BudgetParameters, sigmas: float = 1.0, tau: float = 1.0) -> BudgetParameters:
    """The budget with all standard deviations and all correlation times multiplied."""
    changes: dict[str, Any] = {}
    for fields in SOURCES.values():
        for name, _ in fields:
            value = getattr(budget, name)
            changes[name] = tuple(sigmas * v for v in value) if isinstance(value, tuple) else sigmas * value
    return dataclasses.replace(
        budget, **changes, tau_position_s=tau * budget.tau_position_s, tau_attitude_s=tau * budget.tau_attitude_s
    )  # fmt: skip


DEFAULT = BudgetParameters()
ALL, LINES = "all", "lines"
#: Variant → the budget the errors are drawn from, and the one that is believed.
VARIANTS: dict[str, tuple[BudgetParameters, BudgetParameters]] = {
    ALL: (DEFAULT, DEFAULT),
    "tau three times as long": (scaled(DEFAULT, tau=3.0), DEFAULT),
    "tau a third": (scaled(DEFAULT, tau=1.0 / 3.0), DEFAULT),
    "sigmas 30 % larger": (scaled(DEFAULT, sigmas=1.3), DEFAULT),
    "sigmas 30 % smaller": (scaled(DEFAULT, sigmas=0.7), DEFAULT),
    "beams not modelled": (DEFAULT, dataclasses.replace(DEFAULT, beam_range_sigma_m=0.0, beam_vertical_sigma_rad=0.0)),
}
SCENARIOS = tuple(SITES)


def bases(site: Site) -> tuple[str, ...]:
    """What the volumes of a site stand on."""
    return (EPOCHS,) if site.height_m < 0 else (GROUND, LEVEL)


def believed_parameters(budget: BudgetParameters, site: Site, base: str) -> Parameters:
    """Parameters of the estimation: the body's automatic outline above its own ground, or a rectangle above the level 0."""
    if base == GROUND:
        volume = VolumeParameters()
    else:
        x, y = level_half(site)
        volume = VolumeParameters(base="level", outline="polygon", polygon_m=(-x, -y, x, -y, x, y, -x, y))
    return Parameters(budget=budget, volume=volume)


def level_half(site: Site) -> tuple[float, float]:
    """Half length and width of that rectangle."""
    return site.a + MARGIN_M, site.b + MARGIN_M


def truth(site: Site, base: str, seed: int) -> float:
    """The exact volume, m³."""
    return level_truth(site, site.ground(seed), level_half(site), 0.0) if base == LEVEL else site.volume_m3


def measured(site: Site, drawn: BudgetParameters, believed: BudgetParameters, seed: int) -> dict[str, Row]:
    """One whole survey, or two for a difference: by base its error and what the propagation says of it."""
    if site.height_m < 0:
        P = believed_parameters(believed, site, EPOCHS)
        return {EPOCHS: difference(*flights(site, drawn, P, seed), P, site.volume_m3)}
    first = believed_parameters(believed, site, GROUND)
    flown, estimator, out = survey(site, drawn, first, seed), VolumeEstimator(first), {}
    estimator.add_platform(flown.states)
    estimator.add(flown.update)
    for base in bases(site):
        estimator.set_parameters(believed_parameters(believed, site, base))
        v = estimator.estimate().volume
        error = v.volume_m3 - truth(site, base, seed)
        out[base] = Row(error, v.sigma_m3, v.sigma_naive_m3, v.sigma_tau_range_m3, with_tangential(v.budget_m6))
    return out


def with_tangential(budget_m6: dict[str, float]) -> dict[str, float]:
    """The budget with both parts of the returns' noise in one line."""
    lines = dict(budget_m6)
    lines["noise"] += lines.pop("noise_tangential")
    return lines


def flights(site: Site, drawn: BudgetParameters, believed: Parameters, seed: int) -> tuple[VertexSurvey, VertexSurvey]:
    """Before and after: one instrument and one ground, two flights."""
    before = dataclasses.replace(site, height_m=0.0)
    return survey(before, drawn, believed, seed, 2 * seed), survey(site, drawn, believed, seed, 2 * seed + 1)


def full_tin(update: FilterUpdate, parameters: Parameters) -> Tin:
    """Every vertex of the survey in one TIN, with the triangles that the parameters call relevant."""
    return represent(update.points.r_map, options_of(parameters), measured=False).tin


def options_of(parameters: Parameters) -> SurfaceOptions:
    """A full TIN's options."""
    v = parameters.volume
    return SurfaceOptions(
        ratio=1.0, adjust="none", relevant=v.relevant, max_edge_m=v.max_edge_m, max_circumdiameter_m=v.max_circumdiameter_m
    )  # fmt: skip


def difference(before: VertexSurvey, after: VertexSurvey, parameters: Parameters, true_m3: float) -> Row:
    """The volume between two epochs over their common footprint: constants of calibration enter with the difference of their
    sensitivities, navigation and noise independently (UNCERTAINTY step 10)."""
    tins = [full_tin(s.update, parameters) for s in (after, before)]
    found = between(tins[0], tins[1])
    noise = naive = 0.0
    J_cal: F64 | float = 0.0
    loads: list[NavigationLoads] = []
    tangential = 0.0
    for one, tin, g in zip((after, before), tins, (found.gradient_net, found.lower_net), strict=True):
        points, patches = one.update.points, one.update.patches
        bins = NavigationBins(parameters.filter.nav_bin_s)
        bins.add(one.states)
        gradient = np.zeros((len(points), 1, 3))
        gradient[tin.source, 0] = g
        sources, geometry = Sources(points, patches, bins, parameters), surface_geometry(points, patches)
        q = patch_loads(gradient, patches, geometry)
        noise += float(independent_covariance(q, patches, geometry)[0, 0])
        tangential += tangential_variance(gradient[:, 0], points)
        naive += float((q[:, 0, 0] ** 2 * sources.total_variance).sum())
        first = np.ascontiguousarray(q[:, :, 0])
        J_cal = J_cal + calibration_sensitivity(first, patches)
        loads.append(navigation_loads(*navigation_sensitivity(first, patches), bins, parameters.georeference.max_position_gap_s))
        C_cal = sources.C_cal

    def navigation(factor: float) -> dict[str, float]:
        both = [navigation_variance(load, parameters.budget, factor) for load in loads]
        return {name: both[0][name] + both[1][name] for name in both[0]}

    constant = {"noise": noise + tangential, **calibration_variance(np.asarray(J_cal), C_cal)}
    lines = {**constant, **navigation(1.0)}
    low, high = sorted(math.sqrt(sum(constant.values()) + sum(navigation(f).values())) for f in (1.0 / 3.0, 3.0))
    return Row(found.net_m3 - true_m3, math.sqrt(sum(lines.values())), math.sqrt(naive + tangential), (low, high), lines)


def net_volumes(site: Site, drawn: BudgetParameters, seed: int) -> dict[str, float]:
    """By base the volume alone, m³, of a survey with other errors than believed."""
    if site.height_m < 0:
        P = believed_parameters(DEFAULT, site, EPOCHS)
        before, after = (full_tin(s.update, P) for s in flights(site, drawn, P, seed))
        return {EPOCHS: between(after, before, gradients=False).net_m3}
    P = believed_parameters(DEFAULT, site, GROUND)
    points = survey(site, drawn, P, seed).update.points
    surface = represent(points.r_map, options_of(P), measured=False)
    plane, inside = base_and_outline(surface.tin, vertex_variance(surface, points), P)
    level, polygon = design_surface([0.0]), polygon_of(believed_parameters(DEFAULT, site, LEVEL).volume)
    rectangle = clipped_prismoids(surface.tin, level, polygon, areas_inside(surface.tin, polygon) > 0)
    return {GROUND: prismoids(surface.tin, plane, inside > 0).net_m3, LEVEL: rectangle.net_m3}


def alone(site: Site, seed: int) -> dict[str, dict[str, tuple[float, float]]]:
    """By base and line of the budget: the change of the volume (m³) when that source alone errs, and the variance (m⁶) predicted for it.

    The change is against the same survey without any error, so that what the sampling of the surface does is in both. The roughness of
    the ground is what is left without any other error: its change is the error of that survey, its prediction that of one with noise.
    """
    off = measured(site, without(DEFAULT), DEFAULT, seed)
    noisy = measured(site, without(DEFAULT, "noise"), DEFAULT, seed)
    out: dict[str, dict[str, tuple[float, float]]] = {base: {} for base in off}
    for line in SOURCES:
        changed = None if line == "noise" else net_volumes(site, without(DEFAULT, line), seed)
        for base, row in off.items():
            error = noisy[base].error_m3 if changed is None else changed[base] - truth(site, base, seed)
            out[base][line] = (error - row.error_m3, row.budget_m6[line])
    if GROUND in off:
        out[GROUND]["base_surface"] = (off[GROUND].error_m3, noisy[GROUND].budget_m6["base_surface"])
    return out
