"""Whether the LiDAR's clock and the poses' clock tell the same time, from nothing but the order in
which their messages arrive.

A driver sends a sweep when it is complete, so that on arrival its last return is as old as the
newest attitude, up to the two latencies and half an attitude period. Their difference needs no
third clock, and is the same for a live stream and for a recording at any speed. It is as good as
the latencies are equal (some milliseconds to tens): enough to name a wrong clock and to start a
calibration from.
"""

from __future__ import annotations

from collections import deque
from statistics import median

import numpy as np

from ladar_volume.model.records import I64

#: Sweeps (or fixes) over which a clock is judged, and the fewest that allow a verdict.
WINDOW, FEWEST = 50, 10
#: A difference below this may be latency: half a turn of the scanner.
LATENCY_S = 0.05
#: Returns further than this from the middle of their cloud have a corrupt time: a sweep lasts 50 to
#: 200 ms.
SWEEP_LIMIT_NS = 1_000_000_000
#: Neighbouring sweeps may share this much time (rounded stamps).
OVERLAP_NS = 2_000_000


class Lead:
    """How far a reference clock's newest sample is ahead of another topic's samples on their
    arrival.
    """

    def __init__(self) -> None:
        self._newest: int | None = None
        self._steps: deque[int] = deque(maxlen=WINDOW)
        self._leads: deque[int] = deque(maxlen=WINDOW)

    def reference(self, t_ns: int) -> None:
        """A sample of the reference clock (ns)."""
        if self._newest is not None and t_ns > self._newest:
            self._steps.append(t_ns - self._newest)
        self._newest = t_ns

    def add_reference_clock(self, t_ns: int) -> None:
        """A sample of the other clock (ns), as it arrives."""
        if self._newest is not None:
            half = median(self._steps) // 2 if self._steps else 0
            self._leads.append(int(self._newest + half - t_ns))

    @property
    def estimate_s(self) -> tuple[float, float] | None:
        """The lead and its sigma (s): median and scatter of the window; None before there are
        enough samples.
        """
        if len(self._leads) < FEWEST:
            return None
        middle = median(self._leads)
        spread = 1.4826 * median(abs(v - middle) for v in self._leads)
        return middle * 1e-9, spread * 1e-9

    @property
    def state(self) -> str:
        """``unknown``, ``good``, ``offset`` (a constant difference beyond latency) or ``unsteady``
        (it scatters by more than that).
        """
        found = self.estimate_s
        if found is None:
            return "unknown"
        if found[1] > LATENCY_S:
            return "unsteady"
        return "offset" if abs(found[0]) > LATENCY_S + 3.0 * found[1] else "good"


class SweepTimes:
    """Looks at the times of the returns within and between clouds. Counts what is odd, but refuses
    only single returns.
    """

    def __init__(self) -> None:
        self.overlapping = 0
        self._last: int | None = None

    def corrupt(self, t_ns: I64) -> np.ndarray[tuple[int], np.dtype[np.bool_]] | None:
        """Which returns (n,) have a time that cannot belong to their cloud, or None where all
        can.
        """
        if len(t_ns) == 0 or int(t_ns.max()) - int(t_ns.min()) <= SWEEP_LIMIT_NS:
            return None
        middle = np.sort(t_ns)[len(t_ns) // 2]
        return np.asarray(np.abs(t_ns - middle) > SWEEP_LIMIT_NS)

    def add(self, first_ns: int, last_ns: int) -> None:
        """A cloud's earliest and latest return (ns): one that begins before the one before it ended
        is counted as overlapping.
        """
        if self._last is not None and first_ns < self._last - OVERLAP_NS < last_ns:
            self.overlapping += 1
        self._last = last_ns
