"""Rings of the scanner against ``georeference.beams``: a configuration of another scanner is told
from damaged returns before it costs most of the survey.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.io.drivers.point_layouts import NO_RING
from ladar_volume.model.errors import ParameterValueError
from ladar_volume.model.records import Returns

#: Share of the returns beyond the configured rings above which the configuration is wrong, and from
#: how many returns on: below it single returns are damaged.
WRONG_SHARE, FEWEST = 0.01, 1000


class RingCount:
    """Fed with the returns of a recording in its order."""

    def __init__(self, beams: int, returns: int = 0, beyond: int = 0, highest: int = -1) -> None:
        """returns, beyond, highest : :attr:`counts` of a part of the recording"""
        self._beams = beams
        self._returns, self._beyond, self._highest = returns, beyond, highest

    @property
    def counts(self) -> tuple[int, int, int]:
        """Returns, those beyond the configured rings, and the highest ring of these."""
        return self._returns, self._beyond, self._highest

    def add(self, returns: Returns) -> None:
        """Returns (n,). Raises ParameterValueError where more than :data:`WRONG_SHARE` so far have
        a ring that is not configured.
        """
        self.look(returns)
        self.check()

    def look(self, returns: Returns) -> None:
        """Count returns (n,) of a part of the recording, without a verdict."""
        beyond = (returns.ring >= self._beams) & (returns.ring < NO_RING)
        self._returns += len(returns)
        self._beyond += int(np.count_nonzero(beyond))
        if beyond.any():
            self._highest = max(self._highest, int(returns.ring[beyond].max()))

    def merge(self, other: RingCount) -> None:
        """Add what was counted of another part of the recording."""
        self._returns += other._returns
        self._beyond += other._beyond
        self._highest = max(self._highest, other._highest)

    def check(self) -> None:
        """Raises as :meth:`add`."""
        if self._returns >= FEWEST and self._beyond > WRONG_SHARE * self._returns:
            raise ParameterValueError(
                f"the cloud has rings up to {self._highest} and georeference.beams is "
                f"{self._beams}: {100.0 * self._beyond / self._returns:.0f} % of the returns would "
                f"be lost; set georeference.beams to the scanner's, {_usual(self._highest)}",
                value=self._highest,
            )


def _usual(highest: int) -> int:
    """The number of beams a scanner with this ring has: 16, 32, 40, 64, 80, 128 are made; else
    one more than the ring.
    """
    return next((n for n in (16, 32, 40, 64, 80, 128) if highest < n), highest + 1)
