"""Defects that show while a node runs: told with the place they come from, and of one place once a
minute.
"""

from __future__ import annotations

import traceback
from pathlib import Path

#: Until a defect is told again, s: one that shows with every message would fill disk and log.
AGAIN_S = 60.0


class Defects:
    """Which were told, and when."""

    def __init__(self) -> None:
        self._told: dict[str, float] = {}
        self._since: dict[str, int] = {}

    def told(self, error: Exception, now_s: float) -> str | None:
        """What is to be said of an error, with the number of those that came from its place since
        it was last told; None for nothing.
        """
        frames = traceback.extract_tb(error.__traceback__)
        place = (
            f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "unknown place"
        )
        self._since[place] = self._since.get(place, 0) + 1
        if now_s - self._told.get(place, -AGAIN_S) < AGAIN_S:
            return None
        count, self._told[place], self._since[place] = self._since[place], now_s, 0
        return f"{type(error).__name__} in {place}: {error}" + (
            f" ({count} times)" if count > 1 else ""
        )
