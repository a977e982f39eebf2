"""Other readings of the ground around a body, to be compared with the one its volume stands on."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.ground.polynomial import height_above
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, I64, Plane
from ladar_volume.uncertainty.ground_field import mean_spacing
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
    number = np.unique(cell, axis=0, return_inverse=True)[1].reshape(-1)
    count = np.bincount(number)
    mean = np.bincount(number, off[near]) / count
    noise = np.bincount(number, variance[near]) / count**2
    full = count >= FEWEST_POINTS
    if np.count_nonzero(full) < FEWEST_STRETCHES:
        return math.nan
    weight = count[full] / count[full].sum()
    return math.sqrt(max(float(weight @ (mean[full] ** 2 - noise[full])), 0.0))
