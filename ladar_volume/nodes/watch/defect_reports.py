"""Log lines about defects that show while a node runs. Each names its place in the code; one place
is logged at most once a minute.
"""

from __future__ import annotations

import traceback
from pathlib import Path

#: Least time between two lines about one place, s: a defect that shows with every message would
#: fill disk and log.
REPORT_INTERVAL_S = 60.0


class Defects:
    """The defects of one node, by place: when each was last reported, how often it came since."""

    def __init__(self) -> None:
        self._reported_s: dict[str, float] = {}
        self._since: dict[str, int] = {}

    def report_text(self, error: Exception, now_s: float) -> str | None:
        """The line to log for an error, with the number of errors from its place since the last
        line; None while the interval has not passed.
        """
        frames = traceback.extract_tb(error.__traceback__)
        place = (
            f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "unknown place"
        )
        self._since[place] = self._since.get(place, 0) + 1
        if now_s - self._reported_s.get(place, -REPORT_INTERVAL_S) < REPORT_INTERVAL_S:
            return None
        count, self._reported_s[place], self._since[place] = self._since[place], now_s, 0
        return f"{type(error).__name__} in {place}: {error}" + (
            f" ({count} times)" if count > 1 else ""
        )
