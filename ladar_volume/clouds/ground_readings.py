"""Other readings of the ground around a body, to be compared with the one its volume stands on."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.ground.polynomial import height_above
from ladar_volume.ground.robust_ground import refine
from ladar_volume.model.errors import LadarVolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, I64, Plane
from ladar_volume.volume.outline import surroundings
from ladar_volume.volume.prismoids import prismoids

#: Fewest points of a stretch of ground, and fewest stretches that show how uneven it is.
FEWEST_POINTS, FEWEST_STRETCHES = 8, 6


@dataclass(frozen=True)
class GroundReadings:
    """ring : points around the body · support : share of them that the base goes through · degree :
    of the base · plane_m3 : the volume above it; quadric_m3, quadric_sigma_m3 : above a surface one
    degree higher through the same ring, and how well that is known from the noise, NaN where there
    is none · uneven_m : RMS of the mean distances of stretches of ground half as long as the body
    from the base, beyond their noise; uneven_m3 : over its area
    """

    ring: int
    support: float
    degree: int
    plane_m3: float
    quadric_m3: float
    quadric_sigma_m3: float
    uneven_m: float
    uneven_m3: float


def ground_readings(
    surface: CloudSurface, base: Plane, inside: F64, parameters: Parameters
) -> GroundReadings | None:
    """The readings; inside (m,) m² is the area of each triangle within the outline. None where
    nothing lies around it.
    """
    source = surface.made.tin.source
    variance = np.zeros(len(source))
    if surface.sigma_m is not None:  # of the points themselves: adjusted heights have no more
        variance = np.where(source >= 0, surface.sigma_m[source] ** 2, 0.0)
    tin, p = surface.made.tin, parameters.volume
    mask = inside > 0
    ring = surroundings(tin, mask, p.ground_ring_m if p.outline == "auto" else 0.0)
    if p.outline == "all":
        ring = np.unique(tin.triangles[tin.relevant]).astype(np.int64)
    if not len(ring):
        return None
    support = float(np.isin(base.support, ring).sum()) / len(ring)
    own = prismoids(tin, base, mask)
    other, sigma = higher(surface, base, inside, parameters, variance, ring)
    body = float(inside.sum())
    uneven = unevenness(
        tin.vertices[ring], base, variance[ring], 0.5 * math.sqrt(body), p.object_height_m
    )
    degree = parameters.ground.degree
    net = own.cut_m3 - own.fill_m3
    return GroundReadings(len(ring), support, degree, net, other, sigma, uneven, uneven * body)


def higher(
    surface: CloudSurface,
    base: Plane,
    inside: F64,
    parameters: Parameters,
    variance: F64,
    ring: I64,
) -> tuple[float, float]:
    """The volume above a ground of the next degree through the ring (k,), and its standard
    deviation from the noise of the ground; NaN where there is none.
    """
    tin, ground = surface.made.tin, parameters.ground
    if ground.degree >= 2:
        return math.nan, math.nan
    beta = np.concatenate([base.beta, np.zeros(3 if ground.degree else 2)])
    start = Plane(base.origin_xy, beta, np.zeros((len(beta), len(beta))), base.support)
    # points that the base leaves out for being off it are the ones in question
    reach = parameters.volume.object_height_m
    try:
        fitted = refine(
            tin.vertices[ring],
            variance[ring],
            start,
            dataclasses.replace(ground, degree=ground.degree + 1),
            reach,
        )
        found = prismoids(tin, fitted, inside > 0)
    except LadarVolumeError:
        return math.nan, math.nan
    g = found.base_net
    return found.cut_m3 - found.fill_m3, math.sqrt(max(float(g @ fitted.C_beta @ g), 0.0))


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
