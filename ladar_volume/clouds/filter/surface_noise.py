"""Noise from the surfaces themselves, where a cloud was sampled along lines: the scatter across a
surface changes with the angle at which beams meet it, and surfaces show it place by place.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ladar_volume.clouds.filter import cell_surface
from ladar_volume.clouds.filter.cell_cover import Covered, cover
from ladar_volume.clouds.filter.line_tuning import line_regions, of_points, residuals, surface_noise
from ladar_volume.clouds.filter.self_tuning import SIGMAS, Tuned
from ladar_volume.model.parameters import FilterParameters
from ladar_volume.model.records import F64

#: Passes over the cloud after the first.
PASSES = 1
#: Where a surface is known no better than to this share of the noise it was carried on beyond what
#: supports it.
KNOWN = 0.7


def settled(
    r: F64, tuned: Tuned, done: Covered, steps: F64, parameters: FilterParameters
) -> tuple[Tuned, Covered]:
    """The cover (of ``r``, (n, 3) m) once more with the noise that the first one's surfaces show;
    sigma and variance as the last surfaces show them.
    """
    if not tuned.told:
        return tuned, done
    for _ in range(PASSES):
        sigma = _shown(r, tuned, done, steps)
        threshold = np.maximum(SIGMAS * sigma, parameters.outlier_floor_m)
        assert tuned.lines is not None
        tuned = replace(tuned, regions=line_regions(r, tuned.lines, sigma, threshold))
        done = cover(r, tuned.regions, parameters, tuned.degree)
    believed = tuned.regions.sigma_m
    sigma = _shown(r, tuned, done, steps)
    share = done.variance / believed**2
    kept = done.reason == cell_surface.KEPT
    done.reason[kept & (share > KNOWN**2)] = cell_surface.UNSUPPORTED
    return (
        replace(tuned, regions=replace(tuned.regions, sigma_m=sigma)),
        replace(done, variance=done.variance * (sigma / believed) ** 2),
    )


def _shown(r: F64, tuned: Tuned, done: Covered, steps: F64) -> F64:
    """Noise (n,) m as the surfaces show it."""
    believed, where = tuned.regions.sigma_m, tuned.places
    assert where is not None
    distance, found = residuals(r, done, cell_surface.KEPT, cell_surface.OUTLIER)
    each = surface_noise(distance, done.variance / believed**2, found, believed, where)
    if not np.isfinite(each).any():
        return believed
    floor = np.sqrt(np.mean(steps**2) / 12.0)
    return np.asarray(np.maximum(of_points(each, where, float(np.nanmedian(each))), floor))
