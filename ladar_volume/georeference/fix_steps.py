"""Steps of the position: from one fix to the next all later ones are off by a constant.

A platform moves smoothly. In a window of fixes a cubic in time and a step before its middle are
fitted to the positions, for every middle; the fit with the largest step is kept, with the median of
all, which says what turns and noise make of none (Chow's test, 1960, with a known model either
side; the window is short enough for a cubic).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ladar_volume.model.records import F64
from ladar_volume.model.verdict import Doubt, Verdict

#: Fixes on either side of a step, and the longest time between two of a window, s.
SIDE, LONGEST_S = 6, 1.0
#: A step is so many times the median one and no less than so many metres.
TIMES, LEAST_M = 5.0, 0.05
#: Doubts that a step may be the cause of.
CAUSED = ("passes_shifted", "budget")


class FixStep(NamedTuple):
    """t_ns : of the first fix after the step · step_m : (3,) east, north, up · usual_m : median of
    the steps that are fitted elsewhere
    """

    t_ns: int
    step_m: F64
    usual_m: float

    @property
    def size_m(self) -> float:
        """Length of the step, m."""
        return float(np.linalg.norm(self.step_m))


class FixSteps:
    """Finds the largest step of a sequence of positions. It holds a window and a number a fix."""

    def __init__(self) -> None:
        self._t: list[int] = []
        self._p: list[F64] = []
        self._sizes: list[float] = []
        self._largest: tuple[int, F64] = (0, np.zeros(3))
        #: Time of the first position, ns; None before it.
        self.first_ns: int | None = None

    def add(self, t_ns: int, p: F64) -> None:
        """The next position p (3,) m."""
        if self.first_ns is None:
            self.first_ns = t_ns
        if self._t and t_ns - self._t[-1] > LONGEST_S * 1e9:
            self._t, self._p = [], []
        self._t.append(t_ns)
        self._p.append(np.asarray(p, np.float64))
        if len(self._t) < 2 * SIDE:
            return
        step = step_in_window(np.array([(t - self._t[SIDE]) * 1e-9 for t in self._t]), self._p)
        size = float(np.linalg.norm(step))
        if size > float(np.linalg.norm(self._largest[1])):
            self._largest = (self._t[SIDE], step)
        self._sizes.append(size)
        del self._t[0], self._p[0]

    def largest(self) -> FixStep | None:
        """The largest step, None where it does not stand out."""
        if len(self._sizes) < 4 * SIDE:
            return None
        found = FixStep(*self._largest, float(np.median(self._sizes)))
        return found if found.size_m > max(LEAST_M, TIMES * found.usual_m) else None


def step_in_window(t_s: F64, p: list[F64]) -> F64:
    """The step (3,) m at time 0 of positions p, n of (3,), at times (n,) s: beside a cubic."""
    x = t_s / max(float(np.abs(t_s).max()), 1e-9)
    X = np.column_stack([np.ones(len(x)), x, x**2, x**3, x >= 0.0])
    out: F64 = np.linalg.lstsq(X, np.stack(p), rcond=None)[0][4]
    return out


def step_doubts(found: FixStep | None, first_ns: int, verdict: Verdict) -> Verdict:
    """Where the passes disagree and the fixes have a step: when, and by how much. first_ns : begin
    of the recording.
    """
    if found is None or not any(doubt.name in CAUSED for doubt in verdict.doubts):
        return Verdict()
    east, north, up = (round(1e2 * float(c)) for c in found.step_m)
    after = (found.t_ns - first_ns) * 1e-9
    words = (
        f"the fixes step by {1e2 * found.size_m:.2g} cm ({east:+d} east, {north:+d} north, {up:+d} "
        f"up) at {after:.1f} s of the recording, {found.size_m / found.usual_m:.2g} times what the "
        "path makes of no step: look at the receiver's status there, or replay what lies before "
        "(--duration) or after (--start) by itself"
    )
    return Verdict((Doubt("fix_step", words, after),))
