"""Ground by random sampling with a gravity prior, then least squares on the inliers, iterated to a
fixed point.

Sources: seed 002 chapter 6 (RANSAC ground); UNCERTAINTY steps 2 and 3 (constant term, threshold of
at least three robust sigma, fixed point).
"""

from __future__ import annotations

import contextlib
import dataclasses
import math

import numpy as np

from ladar_volume.ground.ground_sampling import best_candidate
from ladar_volume.ground.heights import (
    design_sums,
    height_above,
    heights_above,
    solve_points,
)
from ladar_volume.ground.polynomial import (
    COEFFICIENTS,
    base_height,
    tilt_of,
)
from ladar_volume.math.kernels import kernel
from ladar_volume.math.large_arrays import in_its_room, taken
from ladar_volume.model.errors import GroundError
from ladar_volume.model.parameters import GroundParameters
from ladar_volume.model.records import F64, I64, Bool, Plane

MAD_TO_SIGMA = 1.4826
#: Inlier threshold in robust sigma; 3 is the least for which the printed covariance is true
#: (UNCERTAINTY step 3).
THRESHOLD_SIGMAS = 3.5
MAX_REFITS = 50
#: Clouds with at least twice as many points are searched on a subset of about this many, and
#: refined as a whole.
SEARCHED_POINTS = 50_000
#: Least width of a surface in thicknesses, both as standard deviations; of a shapeless cloud, both
#: are the same.
WIDE = 2.0
#: A layer with this many times the points of the layers of the same thickness above and below is a
#: surface.
CONTRAST = 1.5
#: Threshold of the random search where none is given, m.
COARSE_M = 0.1


def robust_sigma(residuals: F64) -> float:
    """Median absolute residual times 1.4826, m."""
    size = np.abs(residuals)
    return MAD_TO_SIGMA * float(np.median(size, overwrite_input=True)) if len(size) else 0.0


def ground_sigma(residuals: F64) -> float:
    """Standard deviation of ground from the residuals (n,) m of what is taken for it: the robust
    one, or the root mean square of those below the surface where that is larger. Ground that
    undulates has more small residuals than noise has; a threshold from their median alone cuts off
    crests and hollows, then finds the rest smoother and cuts more. Plants and bodies stand above.
    """
    below = residuals[residuals < 0.0]
    lower = math.sqrt(float(below @ below) / len(below)) if len(below) else 0.0
    return max(robust_sigma(residuals), lower)


def refine(
    points: F64,
    variance: F64,
    start: Plane,
    parameters: GroundParameters,
    reach_m: float = math.inf,
) -> Plane:
    """Least squares on the inliers of a starting surface, iterated until the inliers no longer
    change.

    points : (n, 3) m · variance : (n,) m², independent vertical noise, for C_beta · reach_m :
    inliers of the first fit lie within it. The threshold is ``parameters.threshold_m``, or 3.5
    :func:`ground_sigma` of the inliers where that is 0. ``support`` indexes ``points``. Raises
    :class:`GroundError` where too few points are left or the surface tilts beyond max_tilt.
    """
    threshold = parameters.threshold_m
    origin, degree = start.origin_xy, parameters.degree
    z = points[:, 2]
    inside: Bool = np.abs(z - base_height(start, points[:, :2])) <= (threshold or reach_m)
    # a floor of rounding size keeps exact planes from losing points to the last bit
    floor = 1e-9 * (1.0 + max(float(z.max(initial=0.0)), -float(z.min(initial=0.0))))
    beta, N, inside = _iterate_inliers(points, origin, inside, parameters, floor)
    residual = heights_above(points, origin, beta)[inside]
    C_beta = N @ design_sums(points, inside, origin, degree, variance)[0] @ N
    support: I64 = in_its_room(np.flatnonzero(inside).astype(np.int64, copy=False))
    plane = Plane(origin, beta, C_beta, support, float(np.sqrt(np.mean(residual**2))))
    check_tilt(plane, parameters)
    return plane


def _iterate_inliers(
    points: F64, origin_xy: F64, inside: Bool, parameters: GroundParameters, floor: float
) -> tuple[F64, F64, Bool]:
    """Coefficients (p,), inverse normal matrix (p, p) and inliers (n,) of the fit to points (n, 3)
    m, from first inliers; a threshold of its own is at least ``floor``, m.
    """
    seen: set[bytes] = set()
    for left in range(MAX_REFITS, -1, -1):
        beta, N = solve_points(points, inside, origin_xy, parameters.degree)
        residual = heights_above(points, origin_xy, beta)
        limit = parameters.threshold_m or max(
            THRESHOLD_SIGMAS * ground_sigma(residual[inside]), floor
        )
        new = np.abs(residual) <= limit
        if left == 0 or np.array_equal(new, inside) or new.tobytes() in seen:
            break
        seen.add(new.tobytes())
        inside = new
    return beta, N, inside


def check_tilt(plane: Plane, parameters: GroundParameters) -> None:
    """Refuse a ground steeper than max_tilt at its origin."""
    tilt = tilt_of(plane)
    if tilt > parameters.max_tilt_rad + 1e-9:
        raise GroundError(
            f"the ground tilts by {math.degrees(tilt):.2f} degrees, more than "
            f"{math.degrees(parameters.max_tilt_rad):g}: turn the points "
            "upright, or raise ground.max_tilt_deg",
            reason="ground_tilt",
            value=tilt,
        )


def fit_ground(
    points: F64,
    variance: F64,
    parameters: GroundParameters,
    coarse_m: float = COARSE_M,
    select: I64 | None = None,
) -> Plane:
    """The ground below and around a body: one surface.

    points : (n, 3) m, z up · variance : (n,) m², independent vertical noise · coarse_m : threshold
    of the random search where ``parameters.threshold_m`` is 0 · select : indices of the points to
    use. ``support`` indexes ``points``. Raises :class:`GroundError` for too few or degenerate
    points, where no surface has enough points, for a tilt beyond max_tilt, and for points that show
    no surface.
    """
    chosen = (
        np.arange(len(points), dtype=np.int64)
        if select is None
        else np.asarray(select, dtype=np.int64)
    )
    p = points
    if not np.array_equal(chosen, np.arange(len(points))):  # all are not copied: for memory
        p, variance = taken(points, chosen), taken(variance, chosen)
    check_points(p, variance, parameters.degree)
    step = max(1, len(p) // SEARCHED_POINTS)
    plane = search_surface(p[::step], variance[::step], parameters, coarse_m)
    if step > 1:
        plane = refine(p, variance, plane, parameters, THRESHOLD_SIGMAS * plane.rms_m)
    check_surface(p, variance, plane, parameters)
    return dataclasses.replace(plane, support=taken(chosen, plane.support))


def check_points(p: F64, variance: F64, degree: int) -> None:
    """Refuses too few points (n, 3) for a surface of a degree, and what is not finite."""
    needed = COEFFICIENTS[degree]
    if len(p) < needed:
        raise GroundError(
            f"a ground of degree {degree} needs {needed} points, there are "
            f"{len(p)}: give more of the ground, or a lower ground.degree",
            reason="ground_too_few_points",
            value=len(p),
        )
    if not (np.isfinite(p).all() and np.isfinite(variance).all()):
        raise GroundError(
            "a ground point with a coordinate or variance that is not finite: remove it",
            reason="ground_not_finite",
        )


def search_surface(p: F64, variance: F64, parameters: GroundParameters, coarse_m: float) -> Plane:
    """Random search and refinement. Where no threshold is given and the result is thicker than the
    one of the search, the surface may lie across steps or have grown into the clutter: finer
    thresholds are tried, then fixed ones. The first result stands if nothing helps: rough ground.
    """
    origin = np.round([c.mean() for c in p.T[:2]])
    tried: list[tuple[float, Plane, Plane]] = []
    for threshold in (
        (parameters.threshold_m,)
        if parameters.threshold_m
        else (coarse_m, coarse_m / 2, coarse_m / 4)
    ):
        try:
            beta = best_candidate(p, origin, threshold, parameters)
            start = Plane(origin, beta, np.zeros((len(beta), len(beta))), np.zeros(0, np.int64))
            plane = refine(p, variance, start, parameters, threshold)
        except GroundError:
            if not tried:
                raise
            break
        if plane.rms_m <= threshold:
            return plane
        tried.append((threshold, start, plane))
    if parameters.threshold_m == 0.0 and parameters.below_weight > 0.0:
        for threshold, start, _ in tried:
            with contextlib.suppress(GroundError):
                plane = refine(
                    p, variance, start, dataclasses.replace(parameters, threshold_m=threshold)
                )
                if bottom_layer(p, plane, threshold):
                    return plane
    return tried[0][2]


def check_surface(points: F64, variance: F64, plane: Plane, parameters: GroundParameters) -> None:
    """Refuse points that fill space: scattered about the surface as far as across it. With a given
    threshold that is asked of what the surface grows to without it, where the layer within it is no
    denser than those above and below.
    """
    threshold = parameters.threshold_m
    grown = plane
    if threshold > 0.0:
        own, above, below = count_layers(points, plane, threshold)
        if own >= CONTRAST * max(above, below):
            return
        try:
            grown = refine(
                points, variance, plane, dataclasses.replace(parameters, threshold_m=0.0), threshold
            )
        except GroundError:
            return  # it grows into what is too steep to be ground
    check_spread(np.asarray(covariance_of(points, grown.support)), grown.rms_m)


@kernel
def covariance_of(points: F64, rows: I64) -> F64:
    """Covariance (3, 3) m² of some (k,) of points (n, 3) m."""
    mean, out = np.zeros(3), np.zeros((3, 3))
    for i in rows:
        for c in range(3):
            mean[c] += points[i, c] / len(rows)
    for i in rows:
        x, y, z = points[i, 0] - mean[0], points[i, 1] - mean[1], points[i, 2] - mean[2]
        out[0, 0] += x * x
        out[0, 1] += x * y
        out[0, 2] += x * z
        out[1, 1] += y * y
        out[1, 2] += y * z
        out[2, 2] += z * z
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]
    return out / len(rows)


def check_spread(covariance: F64, rms_m: float) -> None:
    """Refuse a surface whose points, with covariance (3, 3) m² and residuals of ``rms_m``, are
    scattered about it as far as across it.
    """
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance), 0.0))
    # a level does not follow a slope: its residuals are no thickness
    thick, wide = min(rms_m, float(spread[0])), float(spread[1])
    if wide < WIDE * thick:
        raise GroundError(
            f"the points show no ground, they scatter by {thick:.3g} m about a surface "
            f"{wide:.3g} m wide (standard deviations): give more "
            "of the ground around the body, or its level",
            reason="ground_no_surface",
            value=wide / thick,
        )


def count_layers(points: F64, plane: Plane, threshold_m: float) -> tuple[int, int, int]:
    """How many points lie within the threshold of a surface, and how many in the layers of the same
    thickness above and below.
    """
    r = height_above(points, plane)
    above, below = (
        int(np.count_nonzero((side > threshold_m) & (side <= 3.0 * threshold_m)))
        for side in (r, -r)
    )
    return int(np.count_nonzero(np.abs(r) <= threshold_m)), above, below


def bottom_layer(points: F64, plane: Plane, threshold_m: float) -> bool:
    """Whether the points about a surface are a layer of their own at the bottom of denser clutter:
    half as many again as in the layer of the same thickness above, and four times as many as in
    that below. Rough ground has equally many on both sides.
    """
    own, above, below = count_layers(points, plane, threshold_m)
    return bool(own >= CONTRAST * above and own >= 4.0 * below)
