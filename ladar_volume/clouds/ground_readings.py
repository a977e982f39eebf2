"""Other readings of the ground around a body, to be compared with the one its volume stands on; and
how the ground deviates from its plane under closed bodies, where it is not seen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ladar_volume.clouds.body_points import BodyPoints
from ladar_volume.clouds.body_volume import Body, Uncertain
from ladar_volume.clouds.cloud_bodies import CloudBodies
from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.ground.ground_adjoint import ground_residuals
from ladar_volume.ground.heights import height_above
from ladar_volume.math.equal_rows import distinct_cells
from ladar_volume.mesh.linear_mesh import GROUND
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, I64, Plane
from ladar_volume.uncertainty.ground_field import GroundField, Roughness, mean_spacing
from ladar_volume.uncertainty.roughness import estimate_roughness
from ladar_volume.volume.field_checks.base_readings import BaseReadings, base_readings
from ladar_volume.volume.outline import surroundings

#: Fewest points of a stretch of ground, and fewest stretches that show how uneven it is.
FEWEST_POINTS, FEWEST_STRETCHES = 8, 6
#: From where on the toe line is read beyond the outline, at least: in spacings of the points, and
#: as a part of the body's width.
TOE_SPACINGS, TOE_PART = 2.0, 0.01


@dataclass(frozen=True)
class GroundReadings:
    """ring : points around the body · support : share of them that the base goes through ·
    uneven_m : RMS of the mean distances of stretches of ground half as long as the body from the
    base, beyond their noise; uneven_m3 : over its area · others : other readings of the base, and
    how well its own random field is known; None where too few points show it
    """

    ring: int
    support: float
    uneven_m: float
    uneven_m3: float
    others: BaseReadings | None


def ground_readings(
    surface: CloudSurface,
    base: Plane,
    inside: F64,
    parameters: Parameters,
    ring: I64 | None = None,
) -> GroundReadings | None:
    """The readings; inside (m,) m² is the area of each triangle within the outline. None where
    nothing lies around it. ring : (k,) vertices around it, where not all are ground.
    """
    tin, p, variance = surface.representation.tin, parameters.volume, surface.vertex_variance
    mask = inside > 0
    if ring is None:
        ring = surroundings(tin, mask, p.ground_ring_m if p.outline == "auto" else 0.0)
    if p.outline == "all":
        ring = np.unique(tin.triangles[tin.relevant]).astype(np.int64)
    if not len(ring):
        return None
    support = float(np.isin(base.support, ring).sum()) / len(ring)
    body = float(inside.sum())
    uneven = unevenness(
        tin.vertices[ring], base, variance[ring], 0.5 * math.sqrt(body), p.object_height_m
    )
    reach = max(TOE_SPACINGS * mean_spacing(tin.vertices[ring, :2]), TOE_PART * math.sqrt(body))
    others = base_readings(tin, base, inside, variance, reach)
    return GroundReadings(len(ring), support, uneven, uneven * body, others)


def unevenness(points: F64, base: Plane, variance: F64, length_m: float, reach_m: float) -> float:
    """RMS, m, of the mean distances of stretches of ground ``length_m`` long from the base, beyond
    what their noise explains; NaN for few stretches. points : (k, 3), those within
    reach_m of the base count.
    """
    off = height_above(points, base)
    near = np.abs(off) <= reach_m
    if np.count_nonzero(near) < FEWEST_POINTS or not length_m > 0:
        return math.nan
    cell = np.floor((points[near, :2] - points[near, :2].min(axis=0)) / length_m).astype(np.int64)
    _, number = distinct_cells(cell)
    sums, noise = (
        np.bincount(number, values[near]).astype(np.float64) for values in (off, variance)
    )
    return uneven_stretches(np.bincount(number), sums, noise)


def uneven_stretches(count: I64, off: F64, variance: F64) -> float:
    """The same from how many points each stretch has (k,), and the sums of their distances (k,) m
    and variances (k,) m².
    """
    mean, noise = off / count, variance / count**2
    full = count >= FEWEST_POINTS
    if np.count_nonzero(full) < FEWEST_STRETCHES:
        return math.nan
    weight = count[full] / count[full].sum()
    return math.sqrt(max(float(weight @ (mean[full] ** 2 - noise[full])), 0.0))


def ground_roughness(points: BodyPoints, ground: Plane, raw: F64 | None = None) -> Roughness:
    """How the ground deviates from the plane through points of it.

    raw : (n, 3) m, the cloud before the filter, whose noise is independent from point to point;
    None to tell it from the filtered points, where each is of very many. What passes disagree about
    counts as well.
    """
    f, rows = points.filtered, ground.support
    r = points.r[rows]
    sigma = np.zeros(len(rows)) if points.sigma is None else points.sigma[rows]
    if raw is not None and f is not None and f.noise is not None:
        r, sigma = raw[f.index[rows]], f.noise[rows]
    height = height_above(r, ground)
    return estimate_roughness(r[:, :2], height, sigma**2, len(ground.beta))


def field_under(body: Body, points: F64, ground: Plane, rough: Roughness) -> GroundField:
    """How the deviation of the ground from its plane, through some of points (n, 3) m, enters the
    volume of a closed body: under it, where it is not seen, and through the fit.
    """
    p = body.skin.vertices
    by_beta = body.by_ground[: len(ground.beta)]
    xy, _, fit = ground_residuals(points, ground, by_beta)
    bottom = body.closed.mesh.triangles[body.skin.face == GROUND]
    a, b, c = (p[corner] for corner in bottom.T)
    down = np.cross(b - a, c - a)[:, 2] / 2.0
    return GroundField(p, bottom, -down, xy, fit, rough)


def with_base_surface(
    known: Uncertain, made: CloudBodies, points: BodyPoints, raw: F64 | None = None
) -> Uncertain:
    """The uncertainty of bodies with the line ``base_surface``: the ground under them is not the
    plane through that around them. What moves the plane is common to all. raw : as
    :func:`ground_roughness` takes it. A ground that is given has no such line.
    """
    ground = made.ground
    if ground is None or not len(ground.support):
        return known
    rough = ground_roughness(points, ground, raw)
    own = [field_under(body, points.r, ground, rough).variance_m6 for body in made.bodies]
    J = np.stack([body.by_ground[: len(ground.beta)] for body in made.bodies])
    common = J @ plane_covariance(points.r, ground, rough) @ J.T
    lines = np.maximum(own, np.diagonal(common))
    C = known.C_m6 + common + np.diag(lines - np.diagonal(common))
    pairs = zip(known.budget_m6, lines.tolist(), strict=True)
    return Uncertain(C, tuple({**of, "base_surface": line} for of, line in pairs))


def plane_covariance(points: F64, ground: Plane, rough: Roughness) -> F64:
    """Covariance (p, p) of the coefficients of a ground through some of points (n, 3) m from its
    deviation: by the variances of their sums and differences.
    """
    p = len(ground.beta)
    none = np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros(0)
    xy, _, weight = zip(*(ground_residuals(points, ground, e) for e in np.eye(p)), strict=True)

    def variance(w: F64) -> float:
        return GroundField(*none, xy[0], w, rough).variance_m6

    C = np.diag([variance(w) for w in weight])
    for i, j in combinations(range(p), 2):
        C[i, j] = C[j, i] = 0.25 * (
            variance(weight[i] + weight[j]) - variance(weight[i] - weight[j])
        )
    return C
