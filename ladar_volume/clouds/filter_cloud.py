"""The filter for a whole cloud of points without times or poses (seed 002 chapter 4): every input
point is kept or named.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ladar_volume.clouds.filter import cell_surface
from ladar_volume.clouds.filter.cell_cover import Projection, Regions, project_on_cells
from ladar_volume.clouds.filter.filter_doubts import doubts
from ladar_volume.clouds.filter.filter_result import REASONS as REASONS
from ladar_volume.clouds.filter.filter_result import CloudResult as CloudResult
from ladar_volume.clouds.filter.filter_result import check_cloud_points
from ladar_volume.clouds.filter.point_reduction import expand_result, merge_results, reduce_points
from ladar_volume.clouds.filter.self_tuning import Tuning, tune
from ladar_volume.clouds.filter.sparse_points import CLUTTER, Sparse, classify_off_surface
from ladar_volume.clouds.filter.surface_noise import project_with_own_noise
from ladar_volume.clouds.published.published_filter import filter_published, settings
from ladar_volume.clouds.sampling.distinct_points import distinct_rows, restore_copies
from ladar_volume.clouds.sampling.isolation import far_from_cloud
from ladar_volume.clouds.sampling.rounding_step import rounding_steps, shared_rounding
from ladar_volume.model.cloud_filter_parameters import FilterParameters, PublishedFilterParameters
from ladar_volume.model.records import F64, I64

#: Reduction before and after the filter, by ``FilterParameters.reduce``.
REDUCE = {"published": ("round", "mean"), "round": ("round", "round"), "mean": ("mean", "mean")}
#: Self-set parameters: where a surface is known no better than to this share of the noise, some six
#: points' worth, it was carried on beyond what supports it; the noise is told where it is known to
#: better than the second share, and corrected by these factors at most.
KNOWN, SURE, NARROWER, WIDER = 0.4, 0.25, 0.8, 1.25


def filter_cloud(
    r: F64, parameters: FilterParameters, auto: bool = False, keep: frozenset[str] = frozenset()
) -> CloudResult:
    """Robust moving least squares on points (n, 3), m, in any frame.

    auto : estimate noise, radius and degree from the cloud instead of taking them from the
    parameters · keep : reasons of ``KEEPABLE`` for which a point stays as it is. Raises
    :class:`FilterError` for a wrong shape, a coordinate that is not finite, or no points.
    """
    points = check_cloud_points(r)
    how_before, how_after = REDUCE[parameters.reduce]
    before = reduce_points(points, parameters.grid_before_m, how_before)
    if isinstance(parameters, PublishedFilterParameters):
        result = _filter_published(before.r, parameters, auto)
    else:
        once = distinct_rows(before.r)
        result = restore_copies(_filter_near(once.r, parameters, auto, keep), once)
    if parameters.grid_before_m > 0.0:
        result = expand_result(
            result, before, parameters.grid_before_m if how_before == "round" else 0.0
        )
    return merge_results(result, parameters.grid_after_m, how_after)


def _centre(points: F64) -> F64:
    """Origin (3,) of the cells. Digits: they work on offsets of the cloud's size, not on map
    coordinates; a mean would depend on the order of the points.
    """
    return np.asarray(0.5 * (points.min(axis=0) + points.max(axis=0)))


def _filter_published(
    points: F64, parameters: PublishedFilterParameters, auto: bool
) -> CloudResult:
    """The published order."""
    if not auto:
        return filter_published(points, settings(parameters))
    tuned = tune(points - _centre(points), parameters, auto, rounding_steps(points))
    own = settings(
        parameters,
        radius_m=tuned.ball_m / 2,
        degree=tuned.degree,
        threshold_m=tuned.threshold_m,
    )
    return filter_published(points, own)


def _filter_near(
    points: F64, parameters: FilterParameters, auto: bool, keep: frozenset[str]
) -> CloudResult:
    """The distinct points that are left after the first reduction; those far away from the cloud
    are outliers before anything is asked of it.
    """
    far = far_from_cloud(points)
    if not far.any():
        return _filter(points, parameters, auto, keep)
    near, reason = np.flatnonzero(~far), np.where(far, cell_surface.OUTLIER, cell_surface.KEPT)
    done = _filter(points[near], parameters, auto, keep)
    reason[near[done.outliers]] = done.reason
    outliers = np.flatnonzero(reason != cell_surface.KEPT)
    return replace(done, index=near[done.index], outliers=outliers, reason=reason[outliers])


def _filter(
    points: F64, parameters: FilterParameters, auto: bool, keep: frozenset[str]
) -> CloudResult:
    """Distinct points (n, 3), none of them far away."""
    origin, steps = _centre(points), rounding_steps(points)
    local = points - origin
    tuned = tune(local, parameters, auto, steps)
    factor = 1.0
    if auto and tuned.lines is not None:
        tuned, done = project_with_own_noise(local, tuned, steps, parameters)
    else:
        done = project_on_cells(local, tuned.regions, parameters, tuned.degree)
        factor = judge(local, done, tuned.regions) if auto else 1.0
    sparse = classify_off_surface(local, done, tuned, auto, keep)
    return _result(local, origin, tuned, done, sparse, factor, steps)


def _result(
    local: F64,
    origin: F64,
    tuned: Tuning,
    projection: Projection,
    sparse: Sparse,
    factor: float,
    steps: F64,
) -> CloudResult:
    """What became of each point, and the report."""
    stays = (projection.reason == cell_surface.KEPT) | sparse.stays
    index, outliers = np.flatnonzero(stays), np.flatnonzero(~stays)
    flag = sparse.stays[index]
    flags = np.where(flag, np.where(projection.reason[index] == CLUTTER, 2, 1), 0)
    report = {**tuned.report(factor), **_counts(projection, index, outliers)}
    if tuned.lines is not None or flag.any():
        report["sparse"] = int(np.count_nonzero(flags == 1))
    if steps.any():
        report["rounded_to_m"] = float(steps.max())
    noise = factor * tuned.regions.sigma_m[index]
    reach = tuned.regions.ball_m[projection.level[index]]
    rounding = shared_rounding(projection.normal[index], steps, noise, reach)
    sigma = np.sqrt(factor**2 * projection.variance[index] + rounding)
    return CloudResult(
        np.where(flag[:, None], local[index], projection.q[index]) + origin,
        index,
        np.where(flag[:, None], sparse.normal[index], projection.normal[index]),
        np.where(flag, sparse.sigma_m[index], sigma),
        outliers,
        projection.reason[outliers].astype(np.int64),
        report,
        noise=np.where(flag, sparse.sigma_m[index], noise),
        reach=np.where(flag, sparse.reach_m, reach),
        curved=(projection.kind[index] == -1) & ~flag,
        flag=flags if flag.any() else None,
        verdict=doubts(report, tuned.noise_known),
    )


def _counts(projection: Projection, index: I64, outliers: I64) -> dict[str, int]:
    """How many points, and where they went."""
    return {
        "points": len(index) + len(outliers),
        "kept": len(index),
        "cells": projection.cells,
        "on_quadrics": int(np.count_nonzero(projection.kind == -1)),
        "on_planes": int(np.count_nonzero(projection.kind == 1)),
        "on_sharp": int(np.count_nonzero(projection.kind > 1)),
        **{
            name: int(np.count_nonzero(projection.reason[outliers] == number))
            for number, name in enumerate(REASONS[1:], 1)
        },
    }


def judge(r: F64, projection: Projection, regions: Regions) -> float:
    """A second look at self-set parameters, once there are surfaces, at points (n, 3): names in
    ``done.reason`` those whose surface is hardly known where they are, and those beyond the
    threshold that the noise about all surfaces gives. Returns that noise over the one the filter
    began with, which edges and curvature raise and few samples scatter by some per cent.
    """
    kept = np.flatnonzero(projection.reason == cell_surface.KEPT)
    sigma = regions.sigma_m[kept]
    square = np.sum((projection.q[kept] - r[kept]) ** 2, axis=1) / sigma**2
    share = projection.variance[kept] / sigma**2
    sure = share < SURE**2
    # a residual's own variance is that of the noise less that of the surface, which followed it
    # summed exactly: the order of the points must not show
    factor = (
        math.sqrt(math.fsum(square[sure] / (1.0 - share[sure])) / np.count_nonzero(sure))
        if sure.any()
        else 1.0
    )
    factor = min(max(factor, NARROWER), WIDER)
    limit = np.minimum(factor, 1.0) * regions.threshold_m[kept] / sigma
    projection.reason[kept[share > KNOWN**2]] = cell_surface.UNSUPPORTED
    projection.reason[kept[square > limit**2]] = cell_surface.OUTLIER
    return factor
