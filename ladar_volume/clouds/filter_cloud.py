"""The filter for a whole cloud of points without times or poses (seed 002 chapter 4): every input
point is kept or named.
"""

from __future__ import annotations

import math

import numpy as np

from ladar_volume.clouds.filter import cell_surface
from ladar_volume.clouds.filter.cell_cover import Covered, Regions, cover
from ladar_volume.clouds.filter.filter_result import REASONS as REASONS
from ladar_volume.clouds.filter.filter_result import CloudResult as CloudResult
from ladar_volume.clouds.filter.filter_result import checked
from ladar_volume.clouds.filter.point_reduction import expanded, merged, reduce_points
from ladar_volume.clouds.filter.self_tuning import choose
from ladar_volume.clouds.published.published_filter import filter_published, settings
from ladar_volume.model.parameters import FilterParameters
from ladar_volume.model.records import F64

#: Reduction before and after the filter, by ``FilterParameters.reduce``.
REDUCE = {"published": ("round", "mean"), "round": ("round", "round"), "mean": ("mean", "mean")}
#: Self-set parameters: where a surface is known no better than to this share of the noise, some six
#: points' worth, it was carried on beyond what supports it; the noise is told where it is known to
#: better than the second share, and corrected by these factors at most.
KNOWN, SURE, NARROWER, WIDER = 0.4, 0.25, 0.8, 1.25


def filter_cloud(r: F64, parameters: FilterParameters, auto: bool = False) -> CloudResult:
    """Robust moving least squares on points (n, 3), m, in any frame.

    auto : estimate noise, radius and degree from the cloud instead of taking them from the
    parameters. Raises :class:`FilterError` for a wrong shape, a coordinate that is not finite, or
    no points.
    """
    points = checked(r)
    how_before, how_after = REDUCE[parameters.reduce]
    before = reduce_points(points, parameters.grid_before_m, how_before)
    result = _filter(before.r, parameters, auto)
    if parameters.grid_before_m > 0.0:
        result = expanded(
            result, before, parameters.grid_before_m if how_before == "round" else 0.0
        )
    return merged(result, parameters.grid_after_m, how_after)


def _filter(points: F64, parameters: FilterParameters, auto: bool) -> CloudResult:
    """The points that are left after the first reduction, in the order asked for."""
    # digits: cells work on offsets of the cloud's size, not on map coordinates; a mean would depend
    # on the order of the points
    origin = 0.5 * (points.min(axis=0) + points.max(axis=0))
    local = points - origin
    if parameters.order == "published" and not auto:
        return filter_published(points, settings(parameters))
    tuned = choose(local, parameters, auto)
    if parameters.order == "published":
        own = settings(
            parameters,
            radius_m=tuned.ball_m / 2,
            degree=tuned.degree,
            threshold_m=tuned.threshold_m,
        )
        return filter_published(points, own)
    n = len(local)
    done = cover(local, tuned.regions, parameters, tuned.degree)
    factor = judge(local, done, tuned.regions) if auto else 1.0
    kept = done.reason == cell_surface.KEPT
    index, outliers = np.flatnonzero(kept), np.flatnonzero(~kept)
    report: dict[str, float | int | str] = {
        **tuned.report(factor),
        "points": n,
        "kept": len(index),
        "cells": done.cells,
        "on_quadrics": int(np.count_nonzero(done.kind == -1)),
        "on_planes": int(np.count_nonzero(done.kind == 1)),
        "on_sharp": int(np.count_nonzero(done.kind > 1)),
    }
    for number, name in enumerate(REASONS[1:], 1):
        report[name] = int(np.count_nonzero(done.reason == number))
    return CloudResult(
        done.q[index] + origin,
        index,
        done.normal[index],
        factor * np.sqrt(done.variance[index]),
        outliers,
        done.reason[outliers].astype(np.int64),
        report,
        noise=factor * tuned.regions.sigma_m[index],
        reach=tuned.regions.ball_m[done.level[index]],
        curved=done.kind[index] == -1,
    )


def judge(r: F64, done: Covered, regions: Regions) -> float:
    """A second look at self-set parameters, once there are surfaces, at points (n, 3): names in
    ``done.reason`` those whose surface is hardly known where they are, and those beyond the
    threshold that the noise about all surfaces gives. Returns that noise over the one the filter
    began with, which edges and curvature raise and few samples scatter by some per cent.
    """
    kept = np.flatnonzero(done.reason == cell_surface.KEPT)
    sigma = regions.sigma_m[kept]
    square = np.sum((done.q[kept] - r[kept]) ** 2, axis=1) / sigma**2
    share = done.variance[kept] / sigma**2
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
    done.reason[kept[share > KNOWN**2]] = cell_surface.UNSUPPORTED
    done.reason[kept[square > limit**2]] = cell_surface.OUTLIER
    return factor
