"""Closed bodies of a georeferenced survey: the returns around them go through the filter of point
cloud files, which keeps edges and corners; ground, objects, mesh, edges and closing are those of
``cloud_bodies``.

The budget is the survey's own. Noise, ground, closing, fit, what lies between the points and how
the ground deviates from its plane come from the returns as in a file. Calibration and navigation
come from the sensitivities of the survey's patches (``survey_gradient``): the whole gradient of a
closed body, walls and ground with it.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from ladar_volume.clouds.body_checks import (
    check_bodies,
    check_doubts,
    uncertainty,
)
from ladar_volume.clouds.body_points import (
    BodyPoints,
    excluded_points,
    filtered_points,
    good_points,
    ground_threshold,
    step_between,
)
from ladar_volume.clouds.body_verdict import bodies_verdict, filter_doubts
from ladar_volume.clouds.body_volume import Body
from ladar_volume.clouds.body_walls import closing_doubts, foot_doubts, wall_doubts
from ladar_volume.clouds.cloud_bodies import CLEAR, NO_BODY, CloudBodies, cloud_bodies
from ladar_volume.clouds.filter_cloud import filter_cloud
from ladar_volume.clouds.ground_cover import doubts_about_growth, growth_about_bodies
from ladar_volume.clouds.ground_readings import with_base_surface
from ladar_volume.clouds.sampling.even_points import even_rows, sparse_spacing
from ladar_volume.clouds.survey.survey_gradient import OnSurvey, on_survey
from ladar_volume.ground.ground_adjoint import ground_gradient
from ladar_volume.ground.objects import Objects, find_objects, heights_above_ground
from ladar_volume.ground.robust_ground import fit_ground
from ladar_volume.model.body_parameters import BodyParameters, ObjectParameters
from ladar_volume.model.cloud_filter_parameters import FilterParameters
from ladar_volume.model.errors import SurfaceError, VolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, I64, Estimate, Plane, Volume
from ladar_volume.model.verdict import Doubt, Verdict
from ladar_volume.tin.full_tin import footprint_areas
from ladar_volume.uncertainty.volume_budget import Sources

#: Most returns that are filtered at once.
MOST_RETURNS = 3_000_000
#: Share of a body's gradient for which the survey may have no patch on the same side.
MOST_APART = 0.05
#: How far away, in radii of the live filter, a patch still stands for a point.
REACH = 3.0
#: Meshes that are tried: times the spacing of the sparsest tenth of the points.
COARSER = (1.0, 2.0**0.5, 2.0)
#: Lines of the survey's budget that the returns give a body by themselves.
OF_RETURNS = ("noise", "noise_tangential", "smoothing", "base_surface")


@dataclass(frozen=True)
class SurveyBody:
    """One closed body. volume_m3 ± sigma_m3 · interval_m3 : of the survey's confidence ·
    budget_m6 : variances by source, which add up · body : its mesh · height_m : above the ground ·
    points : of the filtered ones
    """

    volume_m3: float
    sigma_m3: float
    interval_m3: tuple[float, float]
    budget_m6: dict[str, float]
    body: Body
    height_m: float
    points: int


@dataclass(frozen=True)
class SurveyBodies:
    """bodies : the largest first · ground : on which they stand · verdict : what speaks against
    them, objects of which no body came among it · returns : used
    """

    bodies: tuple[SurveyBody, ...]
    ground: Plane
    verdict: Verdict
    returns: int


@dataclass(frozen=True)
class MeshedReturns:
    """Closed bodies before the survey's calibration and navigation are asked. made : the bodies ·
    points : the filtered ones · ground : on which they stand · budget_m6 : of each, what the
    returns say · height_m : of each above the ground · verdict : so far · returns : used
    """

    bodies: CloudBodies
    points: BodyPoints
    ground: Plane
    budget_m6: tuple[dict[str, float], ...]
    height_m: tuple[float, ...]
    verdict: Verdict
    returns: int


def points_near_outlines(outlines: tuple[F64, ...], margin_m: float, r: F64) -> F64:
    """The points (n, 3) m within a margin of the rectangle about outlines (c, 2 or more) m; all of
    them without outlines.
    """
    corners = [o[:, :2] for o in outlines if len(o)]
    if not corners:
        return r
    at = np.concatenate(corners)
    low, high = at.min(axis=0) - margin_m, at.max(axis=0) + margin_m
    return np.asarray(r[((r[:, :2] >= low) & (r[:, :2] <= high)).all(axis=1)])


def returns_around(estimate: Estimate, returns: F64, parameters: Parameters) -> F64:
    """The returns (n, 3) m around what an estimate of the surface found."""
    outlines = tuple(v.outline for v in (estimate.volume, *estimate.bodies))
    return points_near_outlines(outlines, parameters.volume.ground_ring_m, returns)


def volume_rows(found: SurveyBodies, t_ns: int, parameters: Parameters) -> list[Volume]:
    """The bodies as rows of the table ``volumes``; area : of their plan. What is doubtful of one is
    told of all.
    """
    p = parameters.volume.confidence
    k = NormalDist().inv_cdf(0.5 + p / 2)
    rows = []
    for b in found.bodies:
        vertices, triangles = b.body.skin.vertices, b.body.closed.mesh.triangles
        x, y, z = b.body.centroid_map.tolist()
        rows.append(
            Volume(
                volume_m3=b.volume_m3,
                sigma_m3=b.sigma_m3,
                confidence=p,
                coverage_factor=k,
                cut_m3=b.volume_m3,
                fill_m3=0.0,
                area_m2=0.5 * float(np.abs(footprint_areas(vertices, triangles)).sum()),
                base="ground of the same survey, closed body",
                base_same_survey=True,
                centroid_map=(x, y, z),
                budget_m6=b.budget_m6,
                sigma_tau_range_m3=(math.nan, math.nan),
                sigma_naive_m3=math.nan,
                outline=np.zeros((0, 2)),
                vertices=len(vertices),
                triangles=len(triangles),
                t_ns=t_ns,
                verdict=found.verdict,
            )
        )
    return rows


def bodies_of_survey(raw: F64, sources: Sources, parameters: Parameters) -> SurveyBodies:
    """The closed bodies within georeferenced returns (n, 3) m, in the map frame.

    sources : the error sources of the survey's filtered surface, which covers them. Raises as
    :func:`mesh_returns`.
    """
    return with_budget(mesh_returns(raw, parameters), sources, parameters)


def mesh_returns(raw: F64, parameters: Parameters) -> MeshedReturns:
    """The closed bodies within georeferenced returns (n, 3) m, with what the returns themselves
    say of their uncertainty.

    Raises :class:`VolumeError` (survey_returns: too many; volume_no_body), :class:`GroundError`
    without a ground, :class:`ObjectError` where the filter left out most of what rises, and
    :class:`SurfaceError` where none can be meshed and closed.
    """
    check_count(raw)
    result = filter_cloud(raw, FilterParameters(), auto=True)
    points = filtered_points(result)
    # what lies along the ground within its scatter is no object
    sigma = np.zeros(len(points.r)) if points.sigma is None else points.sigma
    plane = dataclasses.replace(parameters.ground, degree=1, surfaces=1)
    ground = fit_ground(points.r, sigma**2, plane, ground_threshold(points))
    doubts = filter_doubts(excluded_points(raw, good_points(raw, result), result, ground))
    options = BodyParameters()
    found, made = meshed_objects(points, ground, parameters.volume.object_height_m, options)
    made, checked = check_bodies(made, points, raw, options)
    growth_m = growth_about_bodies(raw, made, points)
    known = uncertainty(made, checked, points, raw, growth_m)
    if known is None:
        raise VolumeError("the returns show no noise", reason="survey_noise")
    known = with_base_surface(known, made, points)
    verdict = bodies_verdict(made, points.r, None)
    verdict += Verdict(doubts + check_doubts(checked) + foot_doubts(made, points))
    grown = doubts_about_growth(made, growth_m)
    verdict += Verdict(wall_doubts(made, points) + closing_doubts(made) + grown)
    height_m = tuple(found.records[k].height_m for k in made.numbers)
    return MeshedReturns(made, points, ground, known.budget_m6, height_m, verdict, len(raw))


def with_budget(meshed: MeshedReturns, sources: Sources, parameters: Parameters) -> SurveyBodies:
    """The bodies with the whole budget: what the returns say, and the survey's calibration and
    navigation.
    """
    made, verdict, out = meshed.bodies, meshed.verdict, []
    for k, body in enumerate(made.bodies):
        rows = made.sources[k]
        moved = shared_gradient(body, rows, meshed.points, meshed.ground, sources)
        verdict += Verdict(body.doubts + apart_doubts(k + 1, moved))
        budget = {**meshed.budget_m6[k], **shared_lines(moved, sources)}
        out.append(_row(body, budget, meshed.height_m[k], len(rows), parameters))
    out.sort(key=lambda b: -b.volume_m3)
    return SurveyBodies(tuple(out), meshed.ground, verdict, meshed.returns)


def check_count(raw: F64) -> None:
    """Refuses more returns (n, 3) than are filtered at once."""
    if len(raw) > MOST_RETURNS:
        raise VolumeError(
            f"{len(raw):,} returns lie around the bodies, {MOST_RETURNS:,} at most make closed "
            "bodies: name the place by georeference.region_m",
            reason="survey_returns",
            value=len(raw),
        )


def _row(
    body: Body, budget: dict[str, float], height_m: float, points: int, parameters: Parameters
) -> SurveyBody:
    """A body with its sigma and interval."""
    sigma = math.sqrt(sum(budget.values()))
    half = sigma * NormalDist().inv_cdf(0.5 + parameters.volume.confidence / 2)
    v = body.volume_m3
    return SurveyBody(v, sigma, (v - half, v + half), budget, body, height_m, points)


def meshed_objects(
    points: BodyPoints, ground: Plane, height_m: float, options: BodyParameters
) -> tuple[Objects, CloudBodies]:
    """The objects on the ground that are at least so high, and their closed meshes: as fine as most
    of what was seen, or coarser where a face that few returns met would stay open. Raises as
    :func:`objects_on` and, of the finest meshes,
    :func:`~ladar_volume.clouds.cloud_bodies.cloud_bodies`.
    """
    first: SurfaceError | None = None
    for coarser in COARSER:
        found, even = objects_on(points, ground, height_m, coarser)
        try:
            return found, cloud_bodies(
                points.r, points.normal, points.curved, even, ground, options
            )
        except SurfaceError as error:
            first = first or error
    assert first is not None
    raise first


def objects_on(
    points: BodyPoints, ground: Plane, height_m: float, coarser: float = 1.0
) -> tuple[Objects, I64]:
    """The objects on the ground that are at least so high, and the label (n,) of those of their
    points that are to be meshed: thinned to ``coarser`` times the spacing of the sparsest walls.
    Raises :class:`VolumeError` (volume_no_body) without any.
    """
    p = ObjectParameters(min_height_m=CLEAR * (points.noise_m or ground.rms_m))
    raised = np.flatnonzero(heights_above_ground(points.r, [ground], p)[1])
    some = raised[even_rows(points.r[raised], coarser * sparse_spacing(points.r[raised]))]
    step = step_between(points.r[some])
    if step:
        p = dataclasses.replace(p, distance_m=step, step_m=step)
    found = find_objects(points.r, [ground], p)
    high = np.array([record.height_m >= height_m for record in found.records], bool)
    if not high.any():
        raise VolumeError(NO_BODY, reason="volume_no_body")
    number: I64 = np.append(np.where(high, np.cumsum(high) - 1, -1), -1).astype(np.int64)
    records = tuple(r for r, keep in zip(found.records, high, strict=True) if keep)
    label = number[found.label]
    even: I64 = np.full(len(label), -1, np.int64)
    even[some] = label[some]
    return dataclasses.replace(found, label=label, records=records), even


def shared_gradient(
    body: Body, rows: I64, points: BodyPoints, ground: Plane, sources: Sources
) -> OnSurvey:
    """The gradient of a body by the survey's points, through its own points ``rows`` (k,) among the
    filtered ones and through those that the ground was fitted to.
    """
    assert points.normal is not None
    gradient = np.zeros((len(points.r), 3))
    np.add.at(gradient, rows, body.gradient)
    if len(ground.support):
        by_beta = body.by_ground[: len(ground.beta), None]
        np.add.at(gradient, ground.support, ground_gradient(points.r, ground, by_beta)[:, 0])
    reach_m = REACH * sources.parameters.filter.radius_m
    return on_survey(points.r, points.normal, gradient, sources.points, reach_m)


def shared_lines(moved: OnSurvey, sources: Sources) -> dict[str, float]:
    """Variances m⁶ from calibration and navigation, by source."""
    s = sources.sensitivities(moved.gradient[:, None])
    lines = sources.budget(s, 0.0).lines
    return {name: value for name, value in lines.items() if name not in OF_RETURNS}


def apart_doubts(number: int, moved: OnSurvey) -> tuple[Doubt, ...]:
    """Doubt where the survey's surface lacks sides that body ``number`` has."""
    if moved.apart <= MOST_APART:
        return ()
    return (
        Doubt(
            "body_apart",
            f"for {100.0 * moved.apart:.0f} % of body {number} the live filter has no surface on "
            "the same side: what calibration and navigation do there is taken from the nearest "
            "one; lower filter.radius_m or filter.min_points",
            moved.apart,
        ),
    )
