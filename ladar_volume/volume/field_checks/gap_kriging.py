"""Kriging of a surface in a gap from the points around it: its heights, and the integral of these
with its variance.

The surface is an intrinsic random field of order 1 with the generalised covariance ``c |h|³``
(Chilès and Delfiner 2012, *Geostatistics*, sections 4.5 and 4.6): unknown planes cancel, and kinks
such as the toe and the crest of a pile, which are seldom and whose second differences grow with
the distance, have this exponent. Its kriging is the smooth continuation of the slopes at the rim.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from ladar_volume.math.kernels import kernel
from ladar_volume.model.records import F64, I64

#: Points that predict a gap, at most.
SEEN = 110
#: They do from this distance on, in diameters of a circle of its area, and no less than so many
#: spacings.
REACH, SPACINGS = 0.6, 4.0
#: A gap is long where that circle is more than so many times as wide as the widest one in the gap;
#: up to so many times as many points predict it.
LONG, MORE = 1.5, 2.0


@dataclass(frozen=True)
class ObservedPoints:
    """Points that were seen: r (n, 3) m, variance (n,) m² of their heights, their usual spacing, m,
    and mean unit vectors (n, 3) to where they were seen from; of no length where these are not
    known. by_x : their rows (n,) by x, then y, whatever their order
    """

    r: F64
    variance: F64
    spacing_m: float
    tree: cKDTree
    by_x: I64
    view: F64 = field(default_factory=lambda: np.zeros((0, 3)))

    @classmethod
    def of(cls, r: F64, variance: F64, spacing_m: float, view: F64 | None = None) -> ObservedPoints:
        """The points with a tree to find them."""
        known = np.zeros((0, 3)) if view is None else view
        by_x = np.lexsort((r[:, 1], r[:, 0]))
        return cls(r, variance, spacing_m, cKDTree(r[:, :2]), by_x, known)


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


def diameter(area_m2: float) -> float:
    """Of a circle of this area, m."""
    return 2.0 * math.sqrt(area_m2 / math.pi)


def rim_points(seen: ObservedPoints, xy: F64, weight: F64, apart: F64, wide_m: float) -> I64:
    """Points (k,) around a gap of places xy (k, 2) m with areas weight (k,) m², but not in it: each
    further from its places than ``apart`` (k,) m, by x, then y, and the one next to the middle of
    each square of a grid, so wide that they are few. wide_m : of the widest circle in it: the rim
    of a long gap is seen by its width
    """
    round_m = diameter(float(weight.sum()))
    size = min(round_m, LONG * wide_m)
    most = SEEN * min(round_m / max(size, 1e-9), MORE)
    reach = max(REACH * size, SPACINGS * seen.spacing_m) + float(apart.max())
    middle = (weight @ xy) / weight.sum()
    far = float(np.hypot(*(xy - middle).T).max()) + reach
    span = (middle[0] - far, middle[0] + far)
    first, last = np.searchsorted(seen.r[:, 0], span, sorter=seen.by_x)
    rows = seen.by_x[first:last]
    at = np.ascontiguousarray(seen.r[rows, :2])
    rows = rows[rim_kernel(at, middle, np.ascontiguousarray(xy), apart, (far, reach))]
    side = seen.spacing_m
    while len(rows) > most:
        rows, side = rows[next_to_middles(seen.r[rows, :2] / side)], 1.3 * side
    return rows


def next_to_middles(xy: F64) -> I64:
    """Rows (k,), ascending, of places (n, 2): that next to the middle of each unit square."""
    square = np.floor(xy)
    off = ((xy - square - 0.5) ** 2).sum(axis=1)
    order = np.lexsort((off, square[:, 1], square[:, 0]))
    new = np.r_[True, (np.diff(square[order], axis=0) != 0).any(axis=1)][: len(order)]
    return np.sort(order[new])


@kernel
def rim_kernel(r: F64, middle: F64, place: F64, apart: F64, metres: tuple[float, float]) -> I64:
    """Rows (k,), ascending, of points r (n, 2) m: see :func:`rim_points`. metres : how far they
    are from the middle (2,) at most, and from the nearest place (p, 2)
    """
    far, reach = metres
    rows, count = np.empty(len(r), np.int64), 0
    x0, x1 = place[:, 0].min() - reach, place[:, 0].max() + reach
    y0, y1 = place[:, 1].min() - reach, place[:, 1].max() + reach
    for i in range(len(r)):
        if not (x0 <= r[i, 0] <= x1 and y0 <= r[i, 1] <= y1):
            continue
        if (r[i, 0] - middle[0]) ** 2 + (r[i, 1] - middle[1]) ** 2 > far * far:
            continue
        best, at = np.inf, 0
        for k in range(len(place)):
            d = (r[i, 0] - place[k, 0]) ** 2 + (r[i, 1] - place[k, 1]) ** 2
            if d < best:
                best, at = d, k
        if apart[at] <= math.sqrt(best) <= reach:
            rows[count] = i
            count += 1
    return rows[:count].copy()


def kriging_equations(seen: ObservedPoints, rim: I64, xy: F64, power: int = 3) -> Kriging | None:
    """The equations of points ``rim`` for places xy (k, 2) m; None where these do not tell a
    plane. power : of the distance; 1 for a surface as tight as chords.
    """
    r = seen.r[rim]
    if len(r) < 6:
        return None
    middle, scale = r[:, :2].mean(axis=0), float(np.ptp(r[:, :2], axis=0).max())
    p, q = (r[:, :2] - middle) / scale, (xy - middle) / scale
    n = len(p)
    A, K = np.zeros((n + 3, n + 3)), np.zeros((n + 3, len(q)))
    A[:n, :n] = covariances(p, p, power)
    A[:n, n], A[:n, n + 1 :] = 1.0, p
    A[n:, :n] = A[:n, n:].T
    K[:n], K[n], K[n + 1 :] = covariances(p, q, power), 1.0, q.T
    return Kriging(A, K, covariances(q, q, power), scale)


def covariances(p: F64, q: F64, power: int) -> F64:
    """Generalised covariances (n, k) between places p (n, 2) and q (k, 2), for c = 1."""
    d: F64 = cdist(p, q)
    return d * d * d if power == 3 else -d  # a power takes ten times as long


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


def above_film(seen: ObservedPoints, rim: I64, xy: F64) -> tuple[F64, F64]:
    """How far the smooth surface lies above one as tight as a film at places xy (k, 2), m, and the
    standard deviation (k,) of that from the points' own noise; NaN where the points ``rim`` do not
    tell it.
    """
    smooth, film = kriging_equations(seen, rim, xy), kriging_equations(seen, rim, xy, 1)
    unknown = np.full(len(xy), math.nan)
    if smooth is None or film is None:
        return unknown, unknown
    try:
        by_point = np.linalg.solve(smooth.A, smooth.K) - np.linalg.solve(film.A, film.K)
    except np.linalg.LinAlgError:
        return unknown, unknown
    by_point = by_point[: len(rim)]
    return by_point.T @ seen.r[rim, 2], np.sqrt((by_point**2).T @ seen.variance[rim])
