"""A VLP-16 that fires as the real one: 16 beams in cycles of 55.296 µs, one every 2.304 µs, 10
turns a second.

Every sweep starts a fresh cycle at azimuth zero; the real scanner's turn holds 1808.4 cycles, so
that its azimuths shift by a part of a step from turn to turn and the 25 µs at the end of a turn are
not idle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ladar_volume.model.parameters import BudgetParameters

F64 = npt.NDArray[np.float64]
#: Elevations in firing order (degrees); the ring number counts them from below, as the driver does.
FIRING_ORDER_DEG = np.array([-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15], float)
RINGS = np.argsort(np.argsort(FIRING_ORDER_DEG)).astype(np.uint16)
CYCLE_S, FIRING_S, TURN_S = 55.296e-6, 2.304e-6, 0.1
RANGE_STEP_M = 0.002


@dataclass(frozen=True)
class Firings:
    """One sweep: seconds since the start, azimuth and elevation as the driver will report them
    (rad), ring.
    """

    time_s: F64
    azimuth: F64
    elevation: F64
    ring: npt.NDArray[np.uint16]


def sweep(start_s: float, thin: int) -> Firings:
    """All firings of one turn beginning at ``start_s``; every ``thin``-th cycle."""
    cycles = np.arange(int(TURN_S / CYCLE_S))[::thin]
    t = start_s + cycles[:, None] * CYCLE_S + np.arange(16) * FIRING_S
    azimuth = -2 * np.pi * (t / TURN_S)  # clockwise seen from above
    return Firings(
        t.ravel(),
        azimuth.ravel(),
        np.tile(np.radians(FIRING_ORDER_DEG), len(cycles)),
        np.tile(RINGS, len(cycles)),
    )


def directions(azimuth: F64, elevation: F64) -> F64:
    """Unit vectors in the laser frame (x forward, z along the spin axis)."""
    c = np.cos(elevation)
    return np.column_stack([c * np.cos(azimuth), c * np.sin(azimuth), np.sin(elevation)])


@dataclass(frozen=True)
class BeamErrors:
    """What is wrong with one instrument: range bias, and per ring a range offset (m) and a vertical
    offset (rad).
    """

    range_bias: float
    rho: F64
    eps: F64

    @staticmethod
    def draw(budget: BudgetParameters, rng: np.random.Generator) -> BeamErrors:
        """One instrument of this budget."""
        return BeamErrors(
            float(rng.normal(0, budget.range_bias_sigma_m)),
            rng.normal(0, budget.beam_range_sigma_m, 16),
            rng.normal(0, budget.beam_vertical_sigma_rad, 16),
        )


def true_directions(
    f: Firings, errors: BeamErrors, budget: BudgetParameters, rng: np.random.Generator
) -> F64:
    """Where the pulses really went: encoder noise, the beam's own vertical offset, and where in the
    footprint it was reflected.
    """
    spot = budget.beam_divergence_rad / 4.0
    azimuth = f.azimuth + rng.normal(
        0, np.hypot(budget.azimuth_noise_rad, spot), len(f.azimuth)
    ) / np.cos(f.elevation)
    elevation = (
        f.elevation
        + errors.eps[f.ring]
        + rng.normal(0, np.hypot(budget.vertical_noise_rad, spot), len(f.azimuth))
    )
    return directions(azimuth, elevation)


def measured_ranges(
    true: F64,
    ring: npt.NDArray[Any],
    errors: BeamErrors,
    budget: BudgetParameters,
    mixed_share: float,
    rng: np.random.Generator,
    step_m: float = RANGE_STEP_M,
) -> F64:
    """Ranges as the instrument reports them (m), NaN where there is no return.

    A pulse whose neighbour in time of the same beam lies deeper by more than 0.2 m and less than 20
    m may return a mixture of both. ``step_m`` is the instrument's range resolution; 0 leaves ranges
    unrounded.
    """
    rho = (
        true + errors.range_bias + errors.rho[ring] + rng.normal(0, budget.range_noise_m, len(true))
    )
    after = np.roll(true, -16)
    step = (
        np.isfinite(after)
        & np.isfinite(true)
        & (np.abs(after - true) > 0.2)
        & (np.abs(after - true) < 20.0)
    )
    mixed = step & (rng.random(len(true)) < mixed_share)
    rho[mixed] += (after - true)[mixed] * rng.random(int(mixed.sum()))
    reported: F64 = np.round(rho / step_m) * step_m if step_m > 0 else rho
    return reported
