"""Noise from the surfaces themselves, where a cloud was sampled along lines: the scatter across a
surface changes with the angle at which beams meet it, and surfaces show it place by place.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ladar_volume.clouds.filter import cell_surface
from ladar_volume.clouds.filter.cell_cover import Projection, project_on_cells
from ladar_volume.clouds.filter.line_tuning import (
    line_regions,
    point_noise,
    residuals,
    surface_noise,
)
from ladar_volume.clouds.filter.self_tuning import SIGMAS, Tuning
from ladar_volume.clouds.filter.surface_misfit import misfit_variance
from ladar_volume.model.parameters import FilterParameters
from ladar_volume.model.records import F64

#: Offset of the first cover's grid over its largest radius.
SET_OFF = np.array([0.35, 0.2289, 0.4127])
#: Where a surface is known no better than to this share of the noise it was carried on beyond what
#: supports it.
KNOWN = 0.7
#: A surface that keeps its points lies no farther from the truth than this many times their noise.
FARTHEST = 2.0
#: Least noise, over the extent of the cloud.
ROUNDING = 1e-12


def project_with_own_noise(
    r: F64, tuned: Tuning, steps: F64, parameters: FilterParameters
) -> tuple[Tuning, Projection]:
    """The cover of points (n, 3) m twice: with the noise believed, on a grid set off, and with the
    noise that the surfaces then show; sigma and variance as the last surfaces show them.
    """
    if not tuned.noise_known:
        return tuned, project_on_cells(r, tuned.regions, parameters, tuned.degree)
    tuned = _with_noise(tuned, float(np.ptp(r, axis=0).max(initial=0.0)))
    off = tuned.regions.ball_m[-1] * SET_OFF
    before = project_on_cells(r + off, tuned.regions, parameters, tuned.degree)
    before = replace(before, q=before.q - off)
    sigma = _noise_of_surfaces(r, tuned, before, steps)
    threshold = np.maximum(SIGMAS * sigma, parameters.outlier_floor_m)
    lines = tuned.lines
    assert lines is not None
    tuned = replace(tuned, regions=line_regions(r, lines, sigma, threshold))
    done = project_on_cells(r, tuned.regions, parameters, tuned.degree)
    believed = tuned.regions.sigma_m
    sigma = _noise_of_surfaces(r, tuned, done, steps)
    share = done.variance / believed**2
    kept = done.reason == cell_surface.KEPT
    done.reason[kept & (share > KNOWN**2)] = cell_surface.UNSUPPORTED
    # a fit that holds no several lines is carried on from elsewhere
    done.reason[kept & np.isnan(lines.reach_m)] = cell_surface.FEW_POINTS
    variance = done.variance * (sigma / believed) ** 2
    rows = np.flatnonzero(done.reason == cell_surface.KEPT)
    wrong = disagreement(before, done, variance)
    off = misfit_variance(r[rows], done.q[rows], done.normal[rows], sigma[rows])
    wrong[rows] = np.minimum(np.maximum(wrong[rows], off), (FARTHEST * sigma[rows]) ** 2)
    variance += wrong
    return (
        replace(tuned, regions=replace(tuned.regions, sigma_m=sigma)),
        replace(done, variance=variance),
    )


def _with_noise(tuned: Tuning, extent_m: float) -> Tuning:
    """With noise no less than rounding leaves: drawn points have none."""
    regions = tuned.regions
    least = np.maximum(regions.sigma_m, ROUNDING * extent_m)
    return replace(tuned, regions=replace(regions, sigma_m=least))


def disagreement(one: Projection, two: Projection, variance: F64) -> F64:
    """Variance (n,) m² that two covers on different grids show beyond ``variance``, that of the
    noise: where a surface bends or ends between few lines, each cell draws it its own way.
    """
    both = (one.reason == cell_surface.KEPT) & (two.reason == cell_surface.KEPT)
    between = two.q - one.q
    along = [np.abs(np.einsum("ni,ni->n", between, c.normal)) for c in (one, two)]
    square = np.maximum(*along) ** 2
    return np.asarray(np.where(both, 0.5 * np.maximum(square - 2.0 * variance, 0.0), 0.0))


def _noise_of_surfaces(r: F64, tuned: Tuning, projection: Projection, steps: F64) -> F64:
    """Noise (n,) m as the surfaces show it."""
    believed, where = tuned.regions.sigma_m, tuned.places
    assert where is not None
    distance, found = residuals(r, projection, cell_surface.KEPT, cell_surface.OUTLIER)
    each = surface_noise(distance, projection.variance / believed**2, found, believed, where)
    if not np.isfinite(each).any():
        return believed
    floor = max(math.sqrt(np.mean(steps**2) / 12.0), ROUNDING * float(np.ptp(r, axis=0).max()))
    return np.asarray(np.maximum(point_noise(each, where, float(np.nanmedian(each))), floor))
