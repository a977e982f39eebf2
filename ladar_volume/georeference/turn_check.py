"""Whether the stamps of LiDAR and attitudes agree, from the turns that both see: of a message that
comes late the turn is at the right time, of a clock that is off it is not.

Each sweep is laid on the one before it, point to plane; the attitudes give the same turn. Moved in
time until both series agree, they tell how far the two clocks are apart.

Source: time delay estimation by comparing angular rates (Furgale, Rehder and Siegwart 2013); the
sweeps' turns by projective data association (Blais and Levine 1995).
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from ladar_volume.georeference.sweep_turns import Sweep, sweep_image, turn_between
from ladar_volume.model.records import F64, Returns

#: Longest time between two sweeps that are compared, s; over how long turns are kept, s.
PAIR_S, KEPT_S = 1.5, 60.0
#: Attitudes nearer in time than this are not needed, s.
ATTITUDE_S = 0.008
#: How far clocks may be apart, s, and the step of the search, s.
REACH_S, STEP_S = 3.0, 0.02
#: Differences of the two turns beyond this are mistakes, rad.
LIMIT_RAD = math.radians(2.0)
#: Pairs that a statement needs; how much of the LiDAR's turns the attitudes must explain; by how
#: much worse the fit must be elsewhere, from so many s on; how well the lag must be known, s.
PAIRS, EXPLAINED, WORSE, APART_S, SURE_S = 40, 0.5, 1.4, 0.3, 0.1
#: A lag is not known better than this, s: sweeps last longer, and see more on one side.
LEAST_S = 0.01
#: So many turns later the lag is looked for again.
AGAIN = 10
#: Slope of the LiDAR's turns by those of the attitudes.
SLOPES = (0.6, 1.6)


class TurnLag(NamedTuple):
    """lag_s : what has to be added to the LiDAR's stamps for its turns to be those of the attitudes
    · sigma_s · explained : share of the LiDAR's turns · pairs : of sweeps
    """

    lag_s: float
    sigma_s: float
    explained: float
    pairs: int


class Turns:
    """Collects turns, both about the scanner's axes. R_body_laser (3, 3)."""

    def __init__(self, R_body_laser: F64) -> None:
        self._R_laser_body = np.asarray(R_body_laser, np.float64).T
        self._zero_ns: int | None = None
        #: Times of the attitudes, s, and the sums of their turns about the axes of the body, rad.
        self.attitudes: deque[tuple[float, float, float, float]] = deque()
        self._last_q: tuple[float, ...] = ()
        self._sweep: Sweep | None = None
        #: Times of two sweeps, s, and the turn (3,) rad from one to the other.
        self.pairs: deque[tuple[float, float, F64]] = deque()
        self._since = 0
        #: The lag by the turns so far, looked for with every :data:`AGAIN` turns.
        self.found: TurnLag | None = None

    def add_attitude(self, t_ns: int, q: F64) -> None:
        """An attitude q (4,) xyzw, body to map, at t_ns."""
        t_s, now = self._seconds(t_ns), tuple(float(v) for v in q)
        if not self.attitudes:
            self.attitudes.append((t_s, 0.0, 0.0, 0.0))
        elif t_s >= self.attitudes[-1][0] + ATTITUDE_S:
            turn = turn_from(self._last_q, now)
            _, x, y, z = self.attitudes[-1]
            self.attitudes.append((t_s, x + turn[0], y + turn[1], z + turn[2]))
        else:
            return
        self._last_q = now
        while self.attitudes[0][0] < t_s - KEPT_S - 2.0 * REACH_S:
            self.attitudes.popleft()

    def add_sweep(self, returns: Returns) -> None:
        """A sweep (n returns) of the LiDAR, in its own time."""
        first_ns = int(returns.t_ns.min())
        mean_ns = first_ns + int((returns.t_ns - first_ns).mean())  # most see one side alone
        new, old = sweep_image(returns, self._seconds(mean_ns)), self._sweep
        self._sweep = new
        if old is None or not 0.0 < new.t_s - old.t_s <= PAIR_S:
            return
        turn = turn_between(old, new)
        if turn is None:
            return
        self.pairs.append((old.t_s, new.t_s, turn))
        while self.pairs[0][1] < new.t_s - KEPT_S:
            self.pairs.popleft()
        self._since += 1
        if self._since >= AGAIN:
            self._since, self.found = 0, self.lag()

    def _seconds(self, t_ns: int) -> float:
        """Since the first sample: nanoseconds since 1970 do not fit into a float."""
        if self._zero_ns is None:
            self._zero_ns = t_ns
        return (t_ns - self._zero_ns) * 1e-9

    def lag(self) -> TurnLag | None:
        """How far the clocks are apart, by the axis that tells best; None where no axis does: too
        few turns, too even, or not the same.
        """
        if len(self.pairs) < PAIRS or len(self.attitudes) < PAIRS:
            return None
        times = np.array([(a, b) for a, b, _ in self.pairs])
        seen = np.array([turn for *_, turn in self.pairs])
        attitudes = np.array(self.attitudes)
        told = attitudes[:, 1:] @ self._R_laser_body.T
        found = [
            best_lag(times, seen[:, axis], attitudes[:, 0], told[:, axis]) for axis in range(3)
        ]
        return min((f for f in found if f is not None), key=lambda f: f.sigma_s, default=None)


def turn_from(a: tuple[float, ...], b: tuple[float, ...]) -> tuple[float, float, float]:
    """The turn (rad) from attitude a to b (xyzw) about the axes of the body, in plain numbers: of
    every attitude, a hundred a second.
    """
    w = a[3] * b[3] + a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    x = a[3] * b[0] - a[0] * b[3] - a[1] * b[2] + a[2] * b[1]
    y = a[3] * b[1] + a[0] * b[2] - a[1] * b[3] - a[2] * b[0]
    z = a[3] * b[2] - a[0] * b[1] + a[1] * b[0] - a[2] * b[3]
    size = math.sqrt(x * x + y * y + z * z)
    if size == 0.0:
        return 0.0, 0.0, 0.0
    scale = math.copysign(2.0 * math.atan2(size, abs(w)) / size, w)
    return scale * x, scale * y, scale * z


def best_lag(times: F64, seen: F64, told_s: F64, told: F64) -> TurnLag | None:
    """The lag at which the turns about an axis agree best. times (n, 2) s : of two sweeps · seen
    (n,) rad : the turn between them · told_s, told (m,) : times and sums of the attitudes' turns.
    None where that is not clear.
    """
    inside = (times[:, 0] >= told_s[0] + REACH_S) & (times[:, 1] <= told_s[-1] - REACH_S)
    if np.count_nonzero(inside) < PAIRS:
        return None
    series = _Series(times[inside], seen[inside], told_s, told)
    lags = np.arange(-round(REACH_S / STEP_S), round(REACH_S / STEP_S) + 1) * STEP_S
    costs = np.array([_size(series.rest(lag)) for lag in lags])
    best = int(np.argmin(costs))
    if not 0 < best < len(lags) - 1:
        return None
    before, here, after = costs[best - 1 : best + 2]
    lag = float(
        lags[best] + 0.5 * STEP_S * (before - after) / max(before - 2 * here + after, 1e-300)
    )
    explained = 1.0 - here / max(_size(series.seen - np.median(series.seen)), 1e-12)
    elsewhere = float(costs[np.abs(lags - lag) > APART_S].min())
    slope, sigma = series.slope_and_sigma(lag)
    clear = elsewhere > WORSE * here and SLOPES[0] < slope < SLOPES[1] and sigma < SURE_S
    if not clear or explained <= EXPLAINED:
        return None
    return TurnLag(lag, math.hypot(sigma, LEAST_S), float(explained), len(series.seen))


def _size(rest: F64) -> float:
    """Mean size of differences, each up to a limit."""
    return float(np.minimum(np.abs(rest), LIMIT_RAD).mean())


class _Series(NamedTuple):
    """As in :func:`best_lag`."""

    times: F64
    seen: F64
    told_s: F64
    told: F64

    def turns(self, lag: float) -> F64:
        """What the attitudes say of the pairs' turns (n,), rad."""
        first, second = np.interp(self.times.T + lag, self.told_s, self.told)
        return np.asarray(second - first)

    def rest(self, lag: float) -> F64:
        """Difference of the two turns less its median: what a path shifts is a constant."""
        rest = self.seen - self.turns(lag)
        return np.asarray(rest - np.median(rest))

    def slope_and_sigma(self, lag: float) -> tuple[float, float]:
        """Slope of the LiDAR's turns by the attitudes', without mistakes; sigma of the lag, s:
        scatter of the rest, which is alike in pairs that follow each other, over how fast turns
        change.
        """
        rest, turns = self.rest(lag), self.turns(lag)
        good = np.abs(rest) < LIMIT_RAD
        x, y, r = turns[good] - turns[good].mean(), self.seen[good], rest[good]
        slope = float(x @ (y - y.mean())) / max(float(x @ x), 1e-12)
        like = float(r[1:] @ r[:-1]) / max(float(r @ r), 1e-12)
        fewer = math.sqrt((1.0 + max(like, 0.0)) / max(1.0 - like, 0.02))
        change = (self.turns(lag + STEP_S) - self.turns(lag - STEP_S)) / (2.0 * STEP_S)
        return slope, fewer * float(np.std(r)) / max(float(np.linalg.norm(change[good])), 1e-12)
