"""What slow checks found, kept for the estimates that follow: while a survey grows, its passes, its
ground and the edges of its bodies need not be checked after every update.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, Protocol, TypeVar

import numpy as np

from ladar_volume.model.records import F64, Tin
from ladar_volume.volume.centroid import plan_centre

T = TypeVar("T")
#: By what share of its area a body may have grown, and of its width have moved, and be the same.
SAME = 0.03


class Ask(Protocol):
    """Gives what the check of this name found before; where it was not made yet, makes it."""

    def __call__(self, name: str, check: Callable[[], T], /) -> T: ...


class Findings:
    """What checks found of a survey and of its bodies. Each check is made once, when it is first
    asked for. parts : for each body the area (m,) m² of each triangle of the TIN that is its
    """

    def __init__(self, tin: Tin, parts: Iterable[F64]) -> None:
        self._bodies = [area_and_centre(tin, part) for part in parts]
        self._found: dict[tuple[int, str], Any] = {}

    def suit(self, tin: Tin, parts: Iterable[F64]) -> bool:
        """Whether these are the same bodies: as many, and each about as large and where it was."""
        now = [area_and_centre(tin, part) for part in parts]
        return len(now) == len(self._bodies) and all(
            abs(area - before) <= SAME * before
            and math.dist(centre, middle) <= SAME * math.sqrt(before)
            for (area, centre), (before, middle) in zip(now, self._bodies, strict=True)
        )

    def of_body(self, number: int) -> Ask:
        """The checks of one body."""
        return partial(self._ask, number)

    def of_survey(self, name: str, check: Callable[[], T]) -> T:
        """What the check of this name found of the whole survey."""
        return self._ask(-1, name, check)

    def _ask(self, number: int, name: str, check: Callable[[], T]) -> T:
        key = (number, name)
        if key not in self._found:
            self._found[key] = check()
        found: T = self._found[key]
        return found


def area_and_centre(tin: Tin, part: F64) -> tuple[float, tuple[float, float]]:
    """Area, m², of a body of which part (m,) m² of each triangle counts, and its centre in plan."""
    rows = np.flatnonzero(part > 0.0)
    weight = part[rows]
    return float(weight.sum()), plan_centre(tin, tin.triangles[rows], weight)
