"""A scan of the box as it comes from the scanner, before it is cropped: returns from the floor and
the walls of the room behind the screens, and beams of some width (seed 000 Fig. 5.1).

A beam that meets the edge of a screen or of the box lights two surfaces. What is returned lies
between them, along the beam, where nothing is: a phantom point. Neither the room nor the beam is
printed in the source; both are chosen here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ladar_volume.experiments.nist.nist_scene import (
    DENSITIES,
    RANGE_SIGMA_M,
    ROUNDING_M,
    SCANNER_M,
    SCREEN_M,
    angle_grid,
    cast,
    rays_of,
    step_for,
)
from ladar_volume.model.records import F64, Bool

#: How far behind the screens the walls of the room are, and how far aside of screens and floor it
#: is scanned, m and rad.
BEHIND_M, ASIDE_RAD = 0.8, 0.12
#: Width of the beam, rad, and rays across it each way.
BEAM_RAD, ACROSS = 3e-3, 5
#: A beam whose rays' distances differ by more than this meets two surfaces, m.
STEP_M = 0.1


@dataclass(frozen=True)
class UncroppedScan:
    """points : (n, 3) m · phantom : (n,) whether the beam met two surfaces · behind : (n,) whether
    it met the room beyond the screens
    """

    points: F64
    phantom: Bool
    behind: Bool


def cast_beyond(ray: F64, with_box: bool) -> tuple[F64, Bool]:
    """Distance (n,) m along rays (n, 3) from the scanner to what they meet first, the floor and the
    walls behind the screens too; and whether (n,) it is these.
    """
    inner, _ = cast(ray, with_box)
    with np.errstate(divide="ignore"):
        t = (np.array([-BEHIND_M, -BEHIND_M, 0.0]) - SCANNER_M) / ray
        screens = -SCANNER_M[:2] / ray[:, :2]
    t[~(t > 0.0)] = np.inf
    # the screens hide what is behind them, also where their foot is not the corner's floor
    for k, s in enumerate(screens.T):
        at = SCANNER_M + np.where(s > 0.0, s, 0.0)[:, None] * ray
        other = at[:, 1 - k]
        on = (s > 0.0) & (other >= 0.0) & (other <= SCREEN_M[0])
        on &= (at[:, 2] >= 0.0) & (at[:, 2] <= SCREEN_M[1])
        inner = np.where(on, np.minimum(inner, s), inner)
    outer = t.min(axis=1)
    return np.minimum(inner, outer), outer < inner


def uncropped_scan(density: int, seed: int, with_box: bool = True) -> UncroppedScan:
    """A scan at a density setting 1 to 5 of Table 5.1: a beam returns the mean distance of its
    rays.
    """
    rng = np.random.default_rng([seed, density, 51])
    step = step_for(DENSITIES[density - 1][0])
    grid = angle_grid(step, rng)
    low, high = grid.min(axis=0) - ASIDE_RAD, grid.max(axis=0) + ASIDE_RAD
    axes = [np.arange(low[k] + step * rng.random(), high[k], step) for k in range(2)]
    middle = np.stack([a.ravel() for a in np.meshgrid(*axes)], axis=1)
    across = BEAM_RAD * (np.arange(ACROSS) - 0.5 * (ACROSS - 1)) / ACROSS
    offsets = np.stack([a.ravel() for a in np.meshgrid(across, across)], axis=1)
    found = [cast_beyond(rays_of(middle + o), with_box) for o in offsets]
    distance, behind = (np.stack(part) for part in zip(*found, strict=True))
    ok = np.isfinite(distance).all(axis=0)
    ray, distance, behind = rays_of(middle)[ok], distance[:, ok], behind[:, ok]
    noise = RANGE_SIGMA_M * rng.standard_normal(len(ray))
    points = SCANNER_M + (distance.mean(axis=0) + noise)[:, None] * ray
    phantom = np.ptp(distance, axis=0) > STEP_M
    return UncroppedScan(
        np.round(points / ROUNDING_M) * ROUNDING_M, phantom, behind.mean(axis=0) > 0.5
    )
