"""What the kernels of the published filter share: its numbers, its working arrays and its
threshold.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from ladar_volume.math.kernels import kernel


class Rules(NamedTuple):
    """Numbers the kernels need; lengths in m. ``sigmas`` 0 makes ``floor`` a fixed threshold."""

    radius: float
    degree: int
    sample: int
    trials: int
    ransac: bool
    ransac_threshold: float
    confidence: float
    sigmas: float
    floor: float
    edges: float
    share: float
    least: int
    iterations: int
    snap: bool
    seed: int


class Scratch(NamedTuple):
    """Arrays reused by all neighbourhoods of a sweep: n entries each."""

    slots: Any
    x: Any
    xt: Any
    label: Any
    free: Any
    pick: Any
    work: Any


@kernel
def limit_of(sigma: Any, rules: Any) -> Any:
    """The inlier threshold; above the rounding of coordinates where there is no noise."""
    return max(rules.sigmas * sigma, rules.floor, 1e-7 * rules.radius)
