"""Whether the angular velocities are those of the attitudes they come with: in rad/s, about the
axes of the body, and not left at zero.

Between attitudes the turn is known twice: from the attitudes, and as the sum of the rates. Both are
added up over half a second, so that the noise of single attitudes counts little, and each such
window in which the platform turns is sorted by what it says. Where nothing turns nothing is told.
"""

from __future__ import annotations

import math

import numpy as np

from ladar_volume.georeference.turn_check import turn_from
from ladar_volume.model.records import F64
from ladar_volume.model.verdict import Doubt, Verdict

#: Length of a window, and longest time between two of its attitudes, s.
WINDOW_S, GAP_S = 0.5, 0.25
#: A turn of an attitude that tells, and of rates that should have one, rad.
TURN_RAD, RATES_RAD = math.radians(3.0), math.radians(10.0)
#: Turn by the rates over that by the attitudes: of rates that are right, that are in degrees, that
#: turn while the attitudes stand still; and the cosine between both turns.
RIGHT, DEGREES, STILL, ALONG = (0.5, 2.0), (40.0, 80.0), 20.0, 0.7
#: Windows of one kind that are needed, and their share of those that tell.
FEWEST, SHARE = 6, 0.8

#: What windows are sorted into, and what is wrong where most are of that kind.
WORDS = {
    "right": "",
    "degrees": "the angular velocities are 57 times the turns of the attitudes: they are in "
    "degrees per second, REP-103 has rad/s",
    "unset": "the angular velocities stay at 0 while the attitudes turn: have the driver fill "
    "them, or set angular_velocity_covariance[0] to -1, and they are told from the attitudes",
    "axes": "the angular velocities turn about other axes than the attitudes: both must be of the "
    "body (x forward, y left, z up, REP-103)",
    "still": "the angular velocities turn and the attitudes stand still: the driver repeats an old "
    "attitude, or the angular velocities are not in rad/s",
    "other": "",
}


class RateCheck:
    """``add`` every attitude in order of time."""

    def __init__(self) -> None:
        self._t_ns: int | None = None
        self._q: tuple[float, ...] = ()
        self._omega = np.zeros(3)
        self._turn, self._told, self._length_s = np.zeros(3), np.zeros(3), 0.0
        #: Windows by kind.
        self.windows = dict.fromkeys(WORDS, 0)

    def add(self, t_ns: int, q: F64, omega: F64) -> None:
        """An attitude q (4,) xyzw, body to map, with its angular velocity omega (3,) rad/s about
        the body's axes; NaN where there is none.
        """
        before_ns, before, omega_before = self._t_ns, self._q, self._omega
        self._t_ns, self._q, self._omega = t_ns, tuple(float(v) for v in q), omega
        step_s = 0.0 if before_ns is None else (t_ns - before_ns) * 1e-9
        if not 0.0 < step_s <= GAP_S or not np.isfinite(omega + omega_before).all():
            self._turn, self._told, self._length_s = np.zeros(3), np.zeros(3), 0.0
            return
        self._turn = self._turn + turn_from(before, self._q)
        self._told = self._told + 0.5 * step_s * (omega + omega_before)
        self._length_s += step_s
        if self._length_s >= WINDOW_S:
            kind = window_kind(self._turn, self._told)
            if kind is not None:
                self.windows[kind] += 1
            self._turn, self._told, self._length_s = np.zeros(3), np.zeros(3), 0.0

    def doubts(self) -> Verdict:
        """What is wrong and what to do."""
        all_of_them = sum(self.windows.values())
        for kind, words in WORDS.items():
            count = self.windows[kind]
            if words and count >= max(FEWEST, SHARE * all_of_them):
                seen = f" (in {count} of {all_of_them} half seconds with turns)"
                return Verdict((Doubt("angular_velocity", words + seen, float(count)),))
        return Verdict()


def window_kind(turn: F64, told: F64) -> str | None:
    """What a window says of turns (3,) rad by the attitudes and by the rates; None where nothing
    turns.
    """
    size, by_rates = float(np.linalg.norm(turn)), float(np.linalg.norm(told))
    if size <= TURN_RAD and by_rates <= RATES_RAD:
        return None
    ratio = by_rates / max(size, 1e-12)
    along = float(turn @ told) > ALONG * size * by_rates
    if along and DEGREES[0] < ratio < DEGREES[1]:
        return "degrees"
    if size <= TURN_RAD:
        return "still" if ratio > STILL else "other"
    if by_rates == 0.0:  # a gyroscope is never that quiet: attitudes may be noisy, or jump
        return "unset"
    if RIGHT[0] < ratio < RIGHT[1]:
        return "right" if along else "axes"
    return "other"
