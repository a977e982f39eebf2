"""What a body's sigma must hold beside the noise: how far the filter's surfaces are off their own
points, and how far the mesh is off what lies between them.

Off their points: a plane through a curved wall lies inside it where the points it moves are. The
mean residual shows that: ``sum of A_i d_i`` over the points, with A_i the derivative of the volume
by a move along the normal and d_i the residual, is what the volume lacks to first order (smoothing
the residuals and adding them back is Tukey's *twicing*, Exploratory Data Analysis 1977). Its own
noise is ``sum of (A_i d_i)²``. What stands out of it is added to the volume; what might hide in it
goes into sigma. Points near an edge do not count: there the noise decides which face a point is
given to, and residuals are not zero in the mean.

Between the points: each half of a body's points makes a body of its own. The error of a mesh falls
with the square of the spacing, so that of a half is twice the whole's, and their difference is the
whole's (Richardson 1911).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.clouds.body_points import BodyPoints, halves
from ladar_volume.clouds.body_volume import Body, Uncertain, cloud_uncertainty, mesh_uncertainty
from ladar_volume.clouds.body_walls import shape_lines, thin_walls
from ladar_volume.clouds.cloud_bodies import CloudBodies, body_at
from ladar_volume.model.body_parameters import SHARP_RAD, BodyParameters, LocalMeshParameters
from ladar_volume.model.errors import SurfaceError, VolumeError
from ladar_volume.model.records import F64, I64, Bool
from ladar_volume.model.verdict import Doubt

#: Points nearer to another face than so many sigmas of the noise are at an edge; neighbours asked.
AT_EDGE, ASKED = 4.0, 24
#: A sum of residuals stands out where it is this many times its own noise.
STANDS_OUT = 2.0
#: Lengths of a mesh through half of the points over those through all.
COARSER = float(np.sqrt(2.0))


@dataclass(frozen=True)
class FilterComparison:
    """fit_m3 : added to the volume, since the filter's surfaces are off their points · fit_m6 :
    variance of what is left of it · between_m3 : (k,) volumes through half of the points less
    that through all · half_count : how many halves · failure : why one makes no body, or nothing
    """

    fit_m3: float
    fit_m6: float
    between_m3: tuple[float, ...]
    half_count: int = 0
    failure: str = ""


def at_edges(r: F64, normal: F64, reach_m: float) -> Bool:
    """Which of points (n, 3) m have one of another face within ``reach_m`` among the nearest."""
    k = min(ASKED, len(r))
    away, near = cKDTree(r).query(r, k=k, distance_upper_bound=max(reach_m, 1e-300))
    there = np.isfinite(np.asarray(away).reshape(len(r), k))
    index = np.where(there, np.asarray(near).reshape(len(r), k), 0)
    lean = np.abs(np.einsum("ni,nki->nk", normal, normal[index]))
    out: Bool = (there & (lean < np.cos(SHARP_RAD))).any(axis=1)
    return out


def off_points(body: Body, rows: I64, raw: F64, points: BodyPoints) -> tuple[float, float]:
    """What the volume lacks, m³, since the surfaces are off their points, as far as it stands out;
    and the variance, m⁶, of what is left.
    """
    f = points.filtered
    if f is None or f.reach is None or f.count is not None:
        return 0.0, 0.0
    normal = f.normal[rows]
    off = np.einsum("ni,ni->n", raw[f.index[rows]] - f.r[rows], normal)
    each = np.einsum("ni,ni->n", body.gradient, normal) * off
    each = each[~at_edges(f.r[rows], normal, AT_EDGE * points.noise_m)]
    total, own = float(each.sum()), float(each @ each)
    if total == 0.0:
        return 0.0, 0.0
    share = max(0.0, 1.0 - STANDS_OUT**2 * own / total**2)
    return share * total, max(((1.0 - share) * total) ** 2 - own, 0.0) + share**2 * own


def coarser(o: BodyParameters) -> BodyParameters:
    """Options for half of the points: given lengths grow with the spacing."""
    m = o.mesh
    mesh = LocalMeshParameters(COARSER * m.radius_m, COARSER * m.hole_m, m.signed)
    return dataclasses.replace(o, mesh=mesh, close_m=COARSER * o.close_m)


def between_points(
    body: Body, rows: I64, points: BodyPoints, made: CloudBodies, o: BodyParameters
) -> tuple[tuple[float, ...], int, str]:
    """Volumes, m³, through each half of a body's points less that through all; how many halves were
    tried; and why one makes none.
    """
    found, failed, tried = [], "", halves(points.r[rows])
    for half in tried:
        try:
            one = body_at(points.r, points.normal, points.curved, rows[half], made.ground, o)[0]
            found.append(one.volume_m3 - body.volume_m3)
        except (SurfaceError, VolumeError) as error:
            failed = str(error)
    return tuple(found), len(tried), failed


def check_bodies(
    made: CloudBodies, points: BodyPoints, raw: F64, options: BodyParameters
) -> tuple[CloudBodies, tuple[FilterComparison, ...]]:
    """The bodies with what their surfaces were off their points put right, and what was found of
    each. raw : (n, 3) m, the cloud before the filter. Raises as :func:`check_thin_walls`.
    """
    bodies, found = [], []
    for body, rows, mesh in zip(made.bodies, made.sources, made.meshes, strict=True):
        if "method_published" in mesh.report:
            found.append(FilterComparison(0.0, 0.0, ()))
            bodies.append(body)
            continue
        fit_m3, fit_m6 = off_points(body, rows, raw, points)
        between, tried, failed = between_points(body, rows, points, made, coarser(options))
        found.append(FilterComparison(fit_m3, fit_m6, between, tried, failed))
        volume = body.volume_m3 + fit_m3
        bodies.append(dataclasses.replace(body, volume_m3=volume, fit_m3=fit_m3))
    check_thin_walls(made, found, points)
    return dataclasses.replace(made, bodies=tuple(bodies)), tuple(found)


def uncertainty(
    made: CloudBodies,
    checked: Sequence[FilterComparison],
    points: BodyPoints,
    raw: F64,
    growth_m: float = 0.0,
) -> Uncertain | None:
    """Covariance of the bodies with all sources; None where the noise is not known. growth_m : of
    plants on the ground.

    The mesh errs to the same side in all bodies: its mean difference is common to them, that
    between the halves each body's own.
    """
    if points.filtered is not None:
        start = cloud_uncertainty(made.bodies, made.sources, raw, points.filtered, made.ground)
    elif points.sigma is not None:
        sigma = [points.sigma[rows] for rows in made.sources]
        start = mesh_uncertainty(made.bodies, sigma, made.ground)
    else:
        return None
    mean = np.array([np.mean(c.between_m3) if c.between_m3 else 0.0 for c in checked])
    own = np.array([np.var(c.between_m3) if c.between_m3 else 0.0 for c in checked])
    fit = np.array([c.fit_m6 for c in checked])
    shape = shape_lines(made, points)
    alone = np.array([sum(lines.values()) for lines in shape])
    # plants lift the base of all bodies
    grown = growth_m * np.array([b.by_ground[0] if growth_m else 0.0 for b in made.bodies])
    budget = []
    for k, lines in enumerate(start.budget_m6):
        more = {"fit": float(fit[k]), "between": float(mean[k] ** 2 + own[k]), **shape[k]}
        budget.append(
            {**lines, **more} | ({"vegetation": float(grown[k] ** 2)} if growth_m else {})
        )
    common = np.outer(mean, mean) + np.outer(grown, grown)
    return Uncertain(start.C_m6 + common + np.diag(own + fit + alone), tuple(budget))


def check_thin_walls(
    made: CloudBodies, checked: Sequence[FilterComparison], points: BodyPoints
) -> None:
    """Raises :class:`SurfaceError` (body_thin_wall; value: share) for a thin-walled body that half
    of its points do not make: its sheets may then be joined wrongly in the whole, too.
    """
    for k, (share, thin_m) in enumerate(thin_walls(made, points)):
        if share and checked[k].failure:
            raise SurfaceError(
                f"{100 * share:.0f} % of the surface of body {k + 1} has a wall behind it thinner "
                f"than {thin_m:.3g} m, two thirds of the filter's reach, and half of its points do "
                f"not always make a body ({checked[k].failure}): its two sides cannot be told "
                "apart; scan it more densely",
                reason="body_thin_wall",
                value=share,
            )


def check_doubts(checked: Sequence[FilterComparison]) -> tuple[Doubt, ...]:
    """Doubts about bodies that half of their points do not make."""
    return tuple(
        Doubt(
            "body_half",
            f"half of the points of body {k} do not always make a body ({c.failure}): "
            f"{c.half_count - len(c.between_m3)} of {c.half_count} do not, and sigma may not hold "
            "what lies between the points; scan it more densely",
            float(c.half_count - len(c.between_m3)),
        )
        for k, c in enumerate(checked, 1)
        if c.failure
    )
