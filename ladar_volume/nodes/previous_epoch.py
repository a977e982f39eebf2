"""What volume_node knows of the epoch before: the frozen surface, and the change since then."""

from __future__ import annotations

from typing import Any

from ladar_volume.change.epoch_change import EpochDifference, epoch_difference
from ladar_volume.model.errors import LadarVolumeError
from ladar_volume.model.records import Volume
from ladar_volume.uncertainty.epoch_budget import Epoch
from ladar_volume.volume.estimator import VolumeEstimator


class SinceEpoch:
    """One per node. Nothing is compared before :meth:`keep`."""

    def __init__(self) -> None:
        self._previous: Epoch | None = None
        self._why_not = ""
        self.change: EpochDifference | None = None

    def keep(self, epoch: Epoch) -> None:
        """From now on changes count from here."""
        self._previous, self.change, self._why_not = epoch, None, "no surface yet"

    def compare(self, stage: VolumeEstimator) -> None:
        """The change up to now, or why it cannot be told."""
        self.change = None
        if self._previous is None:
            return
        try:
            self.change = epoch_difference(stage.epoch(), self._previous)[0]
        except LadarVolumeError as error:
            self._why_not = str(error)

    def rows(self) -> list[Volume]:
        """The change as a row of the table ``volumes``."""
        return [] if self.change is None else [self.change.volume]

    def lines(self) -> dict[str, Any]:
        """For the diagnostics."""
        if self._previous is None:
            return {}
        if self.change is None:
            return {"epoch_change_m3": self._why_not}
        d = self.change
        return {
            "epoch_change_m3": f"{d.volume.volume_m3:.4f}",
            "epoch_sigma_m3": f"{d.volume.sigma_m3:.4f}",
            "epoch_z": f"{d.z:.2f}",
            "epoch_p_value": f"{d.p_value:.2g}",
        }
