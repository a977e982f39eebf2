"""Several ground surfaces of one scene (terraces, steps), and heights above them.

Surfaces are taken one after another from the points that are left (seed 002 chapter 6 finds one).
It ends with ``ground.surfaces`` of them, when no surface with ``ground.min_support`` of all points
is left, or when the best one left is thicker than the threshold of the random search: clutter. A
surface that repeats an earlier one is not listed; its points count as that one's.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.ground.clusters import clusters
from ladar_volume.ground.polynomial import (
    base_height,
    degree_of,
    design,
)
from ladar_volume.ground.robust_ground import COARSE_M, THRESHOLD_SIGMAS, fit_ground
from ladar_volume.model.errors import GroundError
from ladar_volume.model.parameters import GroundParameters
from ladar_volume.model.records import F64, I64, Plane

#: Clusters of a surface's support with less than this share of the largest one's points do not
#: carry it.
MAIN_SHARE = 0.1


def further_grounds(
    points: F64,
    variance: F64,
    main: Plane,
    parameters: GroundParameters,
    coarse_m: float = COARSE_M,
    select: I64 | None = None,
) -> tuple[Plane, ...]:
    """The ground surfaces beside the one of :func:`fit_ground`, ``parameters.surfaces - 1`` at
    most, the largest of what is left first.

    Arguments as of :func:`fit_ground`; ``support`` of each indexes ``points``, and no point
    supports two.
    """
    rest = (
        np.arange(len(points), dtype=np.int64)
        if select is None
        else np.asarray(select, dtype=np.int64)
    )
    rest = np.setdiff1d(rest, main.support)
    least = parameters.min_support * (len(rest) + len(main.support))
    found = [main]
    while len(found) < parameters.surfaces and len(rest) >= max(least, 1.0):
        try:
            # what stands on the surfaces found so far lies below the higher ones: it must not count
            # against them
            share = dataclasses.replace(parameters, min_support=least / len(rest), below_weight=0.0)
            new = fit_ground(points, variance, share, coarse_m, rest)
        except GroundError:
            break  # what is left is no ground
        if len(new.support) < least or new.rms_m > (parameters.threshold_m or coarse_m):
            break
        rest = np.setdiff1d(rest, new.support)
        if not any(is_same_surface(new, old, points) for old in found):
            found.append(new)
    return tuple(found[1:])


def is_same_surface(new: Plane, old: Plane, points: F64) -> bool:
    """Whether a surface is the same as another over most of its own support: closer than 3.5 times
    the larger of their residuals.
    """
    xy = points[new.support, :2]
    apart = float(np.median(np.abs(base_height(new, xy) - base_height(old, xy))))
    return apart <= THRESHOLD_SIGMAS * max(new.rms_m, old.rms_m)


def heights_above(
    points: F64, grounds: Sequence[Plane], supports: F64, reach_m: float
) -> tuple[F64, F64]:
    """Heights (n,) m of points (n, 3) above the ground, and their standard deviations (n,) m.

    grounds : surfaces whose ``support`` indexes ``supports`` (k, 3), or one surface without support
    · reach_m : a surface counts at a point where its support comes as near, horizontally, as that
    of the nearest surface plus ``reach_m``. Above all surfaces that count the height is that over
    the highest, below all of them that under the lowest, and 0 between: the face of a step belongs
    to neither. The standard deviation is that of the ground: its residuals, and the covariance of
    its coefficients.
    """
    xy = points[:, :2]
    z = np.stack([points[:, 2] - base_height(g, xy) for g in grounds])
    sigma = np.stack([surface_sigma(g, xy) for g in grounds])
    if len(grounds) > 1:
        away = np.stack(
            [cKDTree(main_part(supports[g.support], reach_m)[:, :2]).query(xy)[0] for g in grounds]
        )
        counts = away <= away.min(axis=0) + reach_m
    else:
        counts = np.ones(z.shape, dtype=np.bool_)
    over, under = np.where(counts, z, np.inf), np.where(counts, z, -np.inf)
    top, bottom = over.argmin(axis=0), under.argmax(axis=0)
    rows = np.arange(len(points))
    high, low = over[top, rows], under[bottom, rows]
    return np.where(high > 0, high, np.where(low < 0, low, 0.0)), np.where(
        high > 0, sigma[top, rows], sigma[bottom, rows]
    )


def main_part(support: F64, distance_m: float) -> F64:
    """Points (k, 3) that carry a surface: its clusters with a tenth of the largest one's points.
    Others, such as the course round a wall at the height of a terrace, lie on it by chance. Steps
    are ``distance_m``, or five times the distance of neighbours if longer.
    """
    spacing = np.asarray(cKDTree(support).query(support, k=2)[0])[:, 1]
    label = clusters(support, max(distance_m, 5.0 * float(np.median(spacing))), 1)
    count = np.bincount(label)
    out: F64 = support[count[label] >= MAIN_SHARE * count[0]]
    return out


def surface_sigma(plane: Plane, xy: F64) -> F64:
    """Standard deviation (n,) m of single ground points about a surface at xy (n, 2): its residuals
    and its own uncertainty.
    """
    X = design(xy, plane.origin_xy, degree_of(plane))
    own = np.einsum("np,pq,nq->n", X, plane.C_beta, X)
    out: F64 = np.sqrt(plane.rms_m**2 + np.maximum(own, 0.0))
    return out
