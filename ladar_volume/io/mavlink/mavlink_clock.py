"""The autopilot's clock against another: offset and drift from noisy pairs of readings, with a
sigma.

Three kinds of pairs. *Arrivals* (boot time in a message, time of its receipt) are late by the
link's delay, never early: the line below all of them is the offset plus the shortest delay (the
convex-hull estimate of clock skew in network measurement). *Round trips* (TIMESYNC) bound the
offset from both sides. *Readings* (SYSTEM_TIME: boot and UTC side by side) scatter to both sides.
Times are int64 nanoseconds, an offset is local minus remote.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from dataclasses import dataclass

S = 1_000_000_000
#: Pairs are thinned to one per this time: the best of it.
BIN_NS = S // 2
#: Below this span a drift cannot be told from noise.
DRIFT_SPAN_NS = 10 * S
#: Crystals drift by tens of millionths; more is an artefact.
MAX_DRIFT = 3e-4
#: The offset in use follows the estimate at this rate at most, so that stamps never run backwards.
SLEW = 0.005
#: Beyond this an offset is not corrected but replaced: a clock was set, or the autopilot restarted.
STEP_NS = S // 2
#: A receipt later than the line by a step may be a jam on the link; for this long it cannot be.
JAM_NS = 5 * S


@dataclass(frozen=True)
class ClockLine:
    """``base_ns + rest_ns + drift · (remote − at_ns)`` and the sigma of that; the base keeps
    nanoseconds out of floating point.
    """

    at_ns: int
    rest_ns: float
    drift: float
    sigma_ns: float
    base_ns: int = 0

    def offset(self, remote_ns: int) -> int:
        """Offset at a time of the remote clock, ns."""
        return self.base_ns + round(self.residual_ns(remote_ns))

    def residual_ns(self, remote_ns: int) -> float:
        """The offset less its base, ns."""
        return self.rest_ns + self.drift * (remote_ns - self.at_ns)


def _median(values: list[float]) -> float:
    ordered = sorted(values)
    n = len(ordered)
    return 0.5 * (ordered[(n - 1) // 2] + ordered[n // 2])


def lower_line(points: list[tuple[int, float]]) -> ClockLine:
    """The line below all points that is nearest to them: the edge of the lower convex hull under
    their mean.

    sigma: median height of the points above the line, which is how far a typical interval's fastest
    message still was from the fastest of all.
    """
    t0, base = points[0][0], points[0][1]
    mean = sum(t - t0 for t, _ in points) / len(points)
    low = min(v for _, v in points)
    line = ClockLine(t0, low, 0.0, 0.0)
    if points[-1][0] - t0 >= DRIFT_SPAN_NS:
        hull: list[tuple[float, float]] = []
        for t, v in points:
            x, y = float(t - t0), v - base
            while len(hull) > 1 and (hull[-1][0] - hull[-2][0]) * (y - hull[-2][1]) <= (
                hull[-1][1] - hull[-2][1]
            ) * (x - hull[-2][0]):
                hull.pop()
            hull.append((x, y))
        for (xa, ya), (xb, yb) in itertools.pairwise(hull):
            if xa <= mean <= xb and xb > xa and abs(yb - ya) <= MAX_DRIFT * (xb - xa):
                drift = (yb - ya) / (xb - xa)
                line = ClockLine(t0, base + ya - drift * xa, drift, 0.0)
                break
    return ClockLine(
        line.at_ns, line.rest_ns, line.drift, _median([v - line.residual_ns(t) for t, v in points])
    )


def middle_line(points: list[tuple[int, float]]) -> ClockLine:
    """The line through the middle: median of all slopes (Theil 1950, Sen 1968), median of the
    remainders; sigma of that median.
    """
    t0 = points[0][0]
    drift = 0.0
    if points[-1][0] - t0 >= DRIFT_SPAN_NS:
        half = len(points) // 2  # slopes over half the window: pairs far apart, and not all of them
        slopes = [
            (b[1] - a[1]) / (b[0] - a[0])
            for a, b in zip(points[:half], points[-half:], strict=True)
            if b[0] > a[0]
        ]
        drift = min(MAX_DRIFT, max(-MAX_DRIFT, _median(slopes))) if slopes else 0.0
    rest = [v - drift * (t - t0) for t, v in points]
    offset = _median(rest)
    spread = 1.4826 * _median([abs(r - offset) for r in rest])
    return ClockLine(t0, offset, drift, spread / math.sqrt(len(points)))


class ClockOffset:
    """Online estimate. ``two_sided`` for readings and round trips, else arrivals. ``floor_ns`` is
    added to sigma in quadrature.
    """

    def __init__(self, window_s: float, settle_s: float, two_sided: bool, floor_ns: float) -> None:
        self._window, self._settle = int(window_s * S), int(settle_s * S)
        self._two_sided, self._floor = two_sided, floor_ns
        self.resets = 0
        self._clear()

    def _clear(self) -> None:
        self._bins: deque[tuple[int, float, float]] = deque()
        self._bin = self._base = 0
        self._first: int | None = None
        self._line: ClockLine | None = None
        self._off = 0
        self._off_since = 0

    def reset(self) -> None:
        """Forget everything: one of the clocks was set or restarted."""
        self.resets += 1
        self._clear()

    def add(self, remote_ns: int, local_ns: int, doubt_ns: float = 0.0) -> None:
        """One pair of readings; ``doubt_ns`` half the round trip, where there is one. Of each
        interval the best is kept.
        """
        if not self._bins:
            self._base = local_ns - remote_ns
        offset = float(local_ns - remote_ns - self._base)
        if self._line is not None and self._is_off(remote_ns, offset):
            if not self._has_jumped(remote_ns, offset):
                return
            self.reset()
            self._base, offset = local_ns - remote_ns, 0.0
        if self._first is None:
            self._first = remote_ns
        number = remote_ns // BIN_NS
        rank = doubt_ns if self._two_sided else offset
        if self._bins and number <= self._bin:
            if rank < self._bins[-1][2]:
                self._bins[-1] = (remote_ns, offset, rank)
                if self._line is None or offset < self._line.residual_ns(remote_ns):
                    self._fit()
            return
        self._bin = number
        self._bins.append((remote_ns, offset, rank))
        while self._bins[0][0] < remote_ns - self._window:
            self._bins.popleft()
        self._fit()

    def _is_off(self, remote_ns: int, offset: float) -> bool:
        """Whether a pair is far from the line, which it then must not move."""
        assert self._line is not None
        if abs(offset - self._line.residual_ns(remote_ns)) < STEP_NS:
            self._off = 0
            return False
        self._off += 1
        if self._off == 1:
            self._off_since = remote_ns
        return True

    def _has_jumped(self, remote_ns: int, offset: float) -> bool:
        assert self._line is not None
        # earlier than the fastest message ever was is impossible; three times is no stray value
        early = self._off >= 3 and (self._two_sided or offset < self._line.residual_ns(remote_ns))
        return early or abs(remote_ns - self._off_since) > JAM_NS

    def _fit(self) -> None:
        best = list(self._bins)
        if self._two_sided:
            limit = 2.0 * min(b[2] for b in best)
            best = [b for b in best if b[2] <= limit]
        points = sorted((t, v) for t, v, _ in best)
        line = middle_line(points) if self._two_sided else lower_line(points)
        doubt = min(b[2] for b in best) / math.sqrt(3.0) if self._two_sided else 0.0
        sigma = math.sqrt(line.sigma_ns**2 + doubt**2 + self._floor**2)
        self._line = ClockLine(line.at_ns, line.rest_ns, line.drift, sigma, self._base)

    @property
    def ready(self) -> bool:
        """Whether the clocks have been compared for long enough."""
        return (
            self._first is not None
            and bool(self._bins)
            and self._bins[-1][0] - self._first >= self._settle
        )

    @property
    def line(self) -> ClockLine | None:
        """The present estimate."""
        return self._line


class ClockInUse:
    """The offset that stamps are made with: it follows an estimate slowly, so that a later remote
    time gives a later stamp even where the estimate improves or another one takes over, and jumps
    only where a clock did.
    """

    def __init__(self) -> None:
        self._applied: tuple[int, int] | None = None

    def local(self, remote_ns: int, line: ClockLine) -> int:
        """The local time of a remote one."""
        wanted = line.offset(remote_ns)
        if self._applied is None or abs(wanted - self._applied[1]) > STEP_NS:
            self._applied = (remote_ns, wanted)
        elif remote_ns > self._applied[0]:
            most = int(SLEW * (remote_ns - self._applied[0]))
            change = min(most, max(-most, wanted - self._applied[1]))
            self._applied = (remote_ns, self._applied[1] + change)
        return remote_ns + self._applied[1]
