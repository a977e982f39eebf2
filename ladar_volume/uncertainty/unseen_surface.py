"""A surface where nothing was seen, from what was seen around it: its mean height and the variance
of its volume.

The surface is an intrinsic random field of order 1 with the generalised covariance ``c |h|³``
(Chilès and Delfiner 2012, *Geostatistics*, sections 4.5 and 4.6): unknown planes cancel, and kinks
such as the toe and the crest of a pile, which are seldom and whose second differences grow with
the distance, have this exponent. Its kriging is the smooth continuation of the slopes at the rim.
The factor c is the survey's own: the same gap is laid over places around it that were seen, the
volume there is predicted from the rim alone, and the mean of ``error² / predicted variance`` is c.

In the shadow of an edge (:mod:`~ladar_volume.uncertainty.sight_lines`) the surface is not smooth:
there it lies anywhere between the line of sight and the steepest slope of loose material.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from ladar_volume.model.records import F64, I64, Bool
from ladar_volume.uncertainty.sight_lines import shadow_heights

#: Places of a gap where its surface is predicted, and points that predict it, at most.
CELLS, SEEN = 80, 110
#: Points predict a gap from this distance on, in diameters of a circle of its area, and no less
#: than so many spacings.
REACH, SPACINGS = 0.6, 4.0
#: Places over which the gap is laid, at most, within so many of its diameters; sizes that are tried
#: until there are enough of them.
TRIALS, AWAY, SIZES, ENOUGH = 12, 2.5, (1.0, 0.7, 0.5, 0.35), 6
#: Standard deviation of what the smooth surface adds to the chords, over itself, before the gap was
#: laid over seen places, and how many of these it counts for.
DOUBTED, BEFORE = 0.5, 4.0
#: Standard deviation of where a surface falls that is level on both sides of a gap, over the area
#: between smooth surface and chords, above them and below. As far as from the middle to either end
#: for a step of 45 degrees in a gap 1.75 times as wide as it is high: in the shadow of an edge,
#: which is where most such gaps come from, the surface falls at once.
FALLS = 3.5
#: Slope that loose material keeps, at most; a surface that is seen to be steeper has no such bound.
REPOSE = math.tan(math.radians(45.0))
#: A place of a gap laid over what was seen has a point within so many spacings.
FILLED = 2.0


@dataclass(frozen=True)
class ObservedPoints:
    """Points that were seen: r (n, 3) m, variance (n,) m² of their heights, their usual spacing, m,
    and mean unit vectors (n, 3) to where they were seen from; of no length where these are not
    known.
    """

    r: F64
    variance: F64
    spacing_m: float
    tree: cKDTree
    view: F64 = field(default_factory=lambda: np.zeros((0, 3)))

    @classmethod
    def of(
        cls, r: F64, variance: F64, spacing_m: float, view: F64 | None = None
    ) -> ObservedPoints:
        """The points with a tree to find them."""
        known = np.zeros((0, 3)) if view is None else view
        return cls(r, variance, spacing_m, cKDTree(r[:, :2]), known)


@dataclass(frozen=True)
class Kriging:
    """Equations of n points and a plane: A (n + 3, n + 3), right sides K (n + 3, k) of k places,
    covariances ``own`` (k, k) of these, for c = 1 in units of scale_m.
    """

    A: F64
    K: F64
    own: F64
    scale_m: float


@dataclass(frozen=True)
class Prediction:
    """A gap as predicted from its rim. volume_m3 : integral of the heights · unit_m6 : variance of
    it for c = 1 · noise_m6 : from the points' own noise
    """

    volume_m3: float
    unit_m6: float
    noise_m6: float


@dataclass(frozen=True)
class GapTrial:
    """A gap laid over a seen place: squares, m², of the mean height's error, beyond its noise, of
    its standard deviation for c = 1, and of the difference between smooth surface and chords.
    """

    error_m2: float
    unit_m2: float
    bulge_m2: float


@dataclass(frozen=True)
class UnseenVolume:
    """The volume of an unseen surface, m³ above height 0, its variance, m⁶, and from how many gaps
    laid over seen places the variance was told.
    """

    volume_m3: float
    variance_m6: float
    trials: int


def diameter(area_m2: float) -> float:
    """Of a circle of this area, m."""
    return 2.0 * math.sqrt(area_m2 / math.pi)


def rim_points(seen: ObservedPoints, xy: F64, weight: F64, apart: F64) -> I64:
    """Points (k,) around a gap of places xy (k, 2) m with areas weight (k,) m², but not in it: each
    further from its places than ``apart`` (k,) m, and one of each square of a grid, so many that
    they are few.
    """
    size = diameter(float(weight.sum()))
    reach = max(REACH * size, SPACINGS * seen.spacing_m) + float(apart.max())
    centre = (weight @ xy) / weight.sum()
    far = float(np.hypot(*(xy - centre).T).max()) + reach
    near = np.asarray(seen.tree.query_ball_point(centre, far, return_sorted=True), np.int64)
    if not len(near):
        return near
    d, at = cKDTree(xy).query(seen.r[near, :2])
    near = near[(np.asarray(d) >= apart[at]) & (np.asarray(d) <= reach)]
    return thin_to_grid(seen.r[near, :2], near, seen.spacing_m)


def thin_to_grid(xy: F64, rows: I64, spacing_m: float) -> I64:
    """One of ``rows`` (k,) in each square of a grid over xy (k, 2), at most about :data:`SEEN`."""
    side = spacing_m
    while len(rows) > SEEN:
        square = np.floor(xy / side).astype(np.int64)
        first = np.unique(square, axis=0, return_index=True)[1]
        first.sort()
        rows, xy, side = rows[first], xy[first], 1.3 * side
    return rows


def kriging_equations(seen: ObservedPoints, rim: I64, xy: F64, power: int = 3) -> Kriging | None:
    """The equations of points ``rim`` for places xy (k, 2) m; None where these do not tell a
    plane. power : of the distance; 1 for a surface as tight as chords.
    """
    r = seen.r[rim]
    if len(r) < 6:
        return None
    middle, scale = r[:, :2].mean(axis=0), float(np.ptp(r[:, :2], axis=0).max())
    p, q = (r[:, :2] - middle) / scale, (xy - middle) / scale
    n, sign = len(p), 1.0 if power == 3 else -1.0
    A, K = np.zeros((n + 3, n + 3)), np.zeros((n + 3, len(q)))
    A[:n, :n] = sign * cdist(p, p) ** power
    A[:n, n], A[:n, n + 1 :] = 1.0, p
    A[n:, :n] = A[:n, n:].T
    K[:n], K[n], K[n + 1 :] = sign * cdist(p, q) ** power, 1.0, q.T
    return Kriging(A, K, sign * cdist(q, q) ** power, scale)


def predict_integral(seen: ObservedPoints, rim: I64, xy: F64, weight: F64) -> Prediction | None:
    """The integral over places xy (k, 2) m with areas weight (k,) m², from points ``rim``; None
    where these do not tell a plane.
    """
    made = kriging_equations(seen, rim, xy)
    if made is None:
        return None
    k0 = made.K @ weight
    try:
        solved = np.linalg.solve(made.A, k0)
    except np.linalg.LinAlgError:
        return None
    unit = float(weight @ made.own @ weight) - float(k0 @ solved)
    by_point = solved[: len(rim)]
    return Prediction(
        float(by_point @ seen.r[rim, 2]),
        max(unit, 0.0) * made.scale_m**3,
        float(by_point**2 @ seen.variance[rim]),
    )


def predict_heights(seen: ObservedPoints, rim: I64, xy: F64, power: int = 3) -> F64:
    """Heights (k,) m at places xy (k, 2) m from points ``rim``."""
    made = kriging_equations(seen, rim, xy, power)
    if made is None:
        return np.full(len(xy), math.nan)
    try:
        solved = np.linalg.solve(made.A, np.append(seen.r[rim, 2], np.zeros(3)))
    except np.linalg.LinAlgError:
        return np.full(len(xy), math.nan)
    out: F64 = made.K.T @ solved
    return out


def within_repose(r: F64, xy: F64, weight: F64, z: F64) -> tuple[F64, float]:
    """Heights z (k,) m at xy (k, 2) no lower and no higher than slopes of loose material allow from
    points r (n, 3), and the volume between these bounds, m³; as they are, and NaN, where the points
    themselves are steeper.
    """
    d = cdist(xy, r[:, :2]) * REPOSE
    high, low = (r[:, 2] + d).min(axis=1), (r[:, 2] - d).max(axis=1)
    if not (low <= high + 1e-9).all():
        return z, math.nan
    return np.clip(z, low, high), float(weight @ (high - low))


def fall_variance(seen: ObservedPoints, rim: I64, xy: F64, weight: F64, z: F64) -> float:
    """Variance, m⁶, for not knowing where in a gap its surface falls: a smooth surface of heights
    z (k,) m lies above the chords on one side and below them on the other, and the volumes cancel.
    """
    apart = weight * (z - predict_heights(seen, rim, xy, 1))
    both, net = float(np.abs(apart).sum()), float(apart.sum())
    return FALLS**2 * max(both**2 - net**2, 0.0) if math.isfinite(both) else 0.0


def trial_places(seen: ObservedPoints, xy: F64, weight: F64) -> F64:
    """Shifts (k, 2) m of a gap, in a spiral about it, evenly over the disc around."""
    size = diameter(float(weight.sum()))
    number = np.arange(1, 8 * TRIALS + 1)
    radius = AWAY * size * np.sqrt(number / len(number))
    angle = number * math.pi * (3.0 - math.sqrt(5.0))  # the golden angle: no direction twice
    out = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    return out[np.argsort(radius, kind="stable")]


def try_gap(seen: ObservedPoints, xy: F64, weight: F64, apart: F64) -> list[GapTrial]:
    """The gap laid over seen places."""
    out: list[GapTrial] = []
    for shift in trial_places(seen, xy, weight):
        place = xy + shift
        d, at = seen.tree.query(place)
        if float(np.max(d)) > FILLED * seen.spacing_m:
            continue  # not wholly seen
        rim = rim_points(seen, place, weight, apart)
        found = predict_integral(seen, rim, place, weight)
        if found is None or found.unit_m6 <= 0.0:
            continue
        error = float(weight @ seen.r[np.asarray(at), 2]) - found.volume_m3
        own = float((weight**2) @ seen.variance[np.asarray(at)])
        bulge = found.volume_m3 - float(weight @ predict_heights(seen, rim, place, 1))
        scale = float(weight.sum()) ** 2  # of heights: gaps of several sizes go together
        out.append(
            GapTrial(
                max(error**2 - found.noise_m6 - own, 0.0) / scale,
                found.unit_m6 / scale,
                bulge**2 / scale,
            )
        )
        if len(out) >= TRIALS:
            break
    return out


def scale_from_trials(trials: list[GapTrial], shape_m2: float) -> tuple[float, float]:
    """The factor c, and the share of a smooth surface's difference from chords that is a standard
    deviation, squared, for a gap with that difference (mean height, squared) shape_m2.
    """
    c = float(np.mean([t.error_m2 / t.unit_m2 for t in trials])) if trials else 0.0
    before = BEFORE * shape_m2
    error = math.fsum(min(t.error_m2, t.bulge_m2) for t in trials)
    bulge = math.fsum(t.bulge_m2 for t in trials)
    total = before + bulge
    return c, (before * DOUBTED**2 + error) / total if total > 0.0 else 0.0


@dataclass(frozen=True)
class Shadow:
    """Of a gap's places: which are in shadow (k,), the middle (k,) m of the heights that their
    surface may have, and the volume between these bounds, m³.
    """

    dark: Bool
    middle: F64
    room_m3: float


def shadow_of(seen: ObservedPoints, rim: I64, xy: F64, weight: F64) -> Shadow:
    """The part of a gap of places xy (k, 2) m with areas weight (k,) m² that is in shadow: below
    the line of sight, and above the rim's lowest point and the steepest slopes of loose material,
    where the rim itself keeps to these.
    """
    none = np.zeros(len(xy), np.bool_)
    if not len(seen.view) or not len(rim):
        return Shadow(none, np.zeros(len(xy)), 0.0)
    r = seen.r[rim]
    high = shadow_heights(r, seen.view[rim], xy, seen.spacing_m)
    dark = np.isfinite(high)
    steep, _ = within_repose(r, xy, weight, np.full(len(xy), -math.inf))
    low = np.minimum(np.maximum(steep, r[:, 2].min(initial=math.inf)), high)
    middle = np.where(dark, 0.5 * (low + high), 0.0)
    return Shadow(dark, middle, float(weight[dark] @ (high - low)[dark]))


def trials_of(seen: ObservedPoints, xy: F64, weight: F64, apart: F64) -> list[GapTrial]:
    """The gap laid over seen places, smaller where there are too few for it."""
    trials: list[GapTrial] = []
    centre = (weight @ xy) / weight.sum()
    for size in SIZES:
        trials += try_gap(seen, centre + size * (xy - centre), size**2 * weight, size * apart)
        if len(trials) >= ENOUGH:
            break
    return trials


def unseen_surface(
    seen: ObservedPoints, xy: F64, weight: F64, apart: F64, chord: F64
) -> UnseenVolume | None:
    """The surface of a gap of places xy (k, 2) m with areas weight (k,) m², and how well it is
    known; None where nothing can be told of it.

    apart : (k,) m, distance from each place within which no point was seen · chord : (k,) m,
    heights of the triangles that span it. Where the slopes at the rim go on until they meet, the
    surface lies a third further from the chords than the smooth one (exact for a cone in a round
    gap); where they end at the rim it lies as low as the chords. So half of the difference between
    smooth surface and chords counts as a standard deviation, less where seen places tell otherwise.
    """
    rim = rim_points(seen, xy, weight, np.zeros(len(xy)))
    shade = shadow_of(seen, rim, xy, weight)
    lit = np.where(shade.dark, 0.0, weight)
    found = predict_integral(seen, rim, xy, lit)
    if found is None:
        return None
    z, room = within_repose(seen.r[rim], xy, lit, predict_heights(seen, rim, xy))
    bulge_m3, area = float(lit @ (z - chord)), float(weight.sum())
    trials = trials_of(seen, xy, weight, apart) if lit.any() else []
    factor, share = scale_from_trials(trials, (bulge_m3 / area) ** 2)
    variance = factor * found.unit_m6 + found.noise_m6 + share * bulge_m3**2
    variance += fall_variance(seen, rim, xy, lit, z)
    if math.isfinite(room):
        variance = min(variance, room**2 / 12.0) if trials else room**2 / 12.0
    elif not trials and lit.any():
        return None
    volume_m3 = float(weight @ np.where(shade.dark, shade.middle, z))
    return UnseenVolume(volume_m3, variance + shade.room_m3**2 / 12.0, len(trials))
