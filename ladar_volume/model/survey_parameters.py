"""The parameters of simulated surveys, and of the calibration from their strips."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ladar_volume.model.errors import SimulationError
from ladar_volume.model.parameter import param, specs


@dataclass(frozen=True)
class SurveyParameters:
    """How a survey is flown and what goes wrong on the way. Raises :class:`SimulationError` for
    what cannot be flown.

    In ``outages_s`` (from, to) the receiver has no fix, in ``float_spans_s`` a float one of ten
    times the sigma.
    """

    duration_s: float = param(36.0, "Length of the survey.", unit="s", low=0.1, high=86400)
    thin: int = param(1, "Every n-th firing cycle is kept; 1 for the full rate.", low=1, high=1808)
    gnss_hz: float = param(10.0, "Rate of the fixes.", unit="Hz", low=0.1, high=1000)
    imu_hz: float = param(100.0, "Rate of the attitudes.", unit="Hz", low=1, high=10000)
    dropout_share: float = param(0.01, "Share of returns that are lost.", low=0, high=1)
    mixed_share: float = param(
        0.1, "Share of returns at a step in range that mix both sides.", low=0, high=1
    )
    outages_s: tuple[tuple[float, float], ...] = ()
    float_spans_s: tuple[tuple[float, float], ...] = ()
    max_range_m: float = param(
        100.0, "Longest range that is measured.", unit="m", low=0.3, high=1000
    )
    range_step_m: float = param(
        0.002, "Ranges are multiples of this; 0 for unrounded ones.", unit="m", low=0, high=1
    )
    seed: int = param(0, "Seed of the simulated errors.", low=0)

    def __post_init__(self) -> None:
        for spec in specs(type(self)):
            value = getattr(self, spec.name)
            low = -math.inf if spec.low is None else spec.low
            high = math.inf if spec.high is None else spec.high
            if not low <= value <= high:  # NaN too
                raise SimulationError(
                    f"{spec.name} is {value}; it must lie between {low} and {high}", value=value
                )
        for name in ("outages_s", "float_spans_s"):
            for first, last in getattr(self, name):
                if not first < last:
                    raise SimulationError(
                        f"{name}: a span must end after it begins, not {first} to {last}",
                        value=(first, last),
                    )


@dataclass(frozen=True)
class StripParameters:
    """The planar patches on which overlapping strips are compared."""

    edge_m: float = param(1.0, "Edge (m) of the voxels that hold one planar patch.", unit="m")
    min_points: int = param(6, "Fewest returns of one strip on a patch.")
    max_patches: int = param(2500, "Most patches.")
