"""The filter for a whole cloud of points without times or poses (seed 002 chapter 4): every input point is kept or named."""

from __future__ import annotations

import numpy as np

from ladar_volume.filtering import cells
from ladar_volume.filtering.cover import cover
from ladar_volume.filtering.published import filter_published, settings
from ladar_volume.filtering.result import REASONS as REASONS
from ladar_volume.filtering.result import CloudResult as CloudResult
from ladar_volume.filtering.result import checked
from ladar_volume.filtering.sampling import expanded, merged, reduce_points
from ladar_volume.filtering.tuning import choose
from ladar_volume.model.parameters import FilterParameters
from ladar_volume.model.records import F64

#: Reduction before and after the filter, by ``FilterParameters.reduce``.
REDUCE = {"published": ("round", "mean"), "round": ("round", "round"), "mean": ("mean", "mean")}


def filter_cloud(r: F64, parameters: FilterParameters, auto: bool = False) -> CloudResult:
    """Robust moving least squares on points (n, 3), m, in any frame.

    auto : estimate noise, radius and degree from the cloud instead of taking them from the parameters. Raises
    :class:`FilterError` for a wrong shape, a coordinate that is not finite, or no points.
    """
    points = checked(r)
    how_before, how_after = REDUCE[parameters.reduce]
    before = reduce_points(points, parameters.grid_before_m, how_before)
    result = _filter(before.r, parameters, auto)
    if parameters.grid_before_m > 0.0:
        result = expanded(result, before, parameters.grid_before_m if how_before == "round" else 0.0)
    return merged(result, parameters.grid_after_m, how_after)


def _filter(points: F64, parameters: FilterParameters, auto: bool) -> CloudResult:
    """The points that are left after the first reduction, in the order asked for."""
    # digits: cells work on offsets of the cloud's size, not on map coordinates; a mean would depend on the order of the points
    origin = 0.5 * (points.min(axis=0) + points.max(axis=0))
    local = points - origin
    if parameters.order == "published" and not auto:
        return filter_published(points, settings(parameters))
    tuned = choose(local, parameters, auto)
    if parameters.order == "published":
        own = settings(parameters, radius_m=tuned.ball_m / 2, degree=tuned.degree, threshold_m=tuned.threshold_m)
        return filter_published(points, own)
    n = len(local)
    done = cover(local, tuned.regions, parameters, tuned.degree)
    kept = done.reason == cells.KEPT
    index, outliers = np.flatnonzero(kept), np.flatnonzero(~kept)
    report: dict[str, float | int | str] = {
        **tuned.report(),
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
        done.q[index] + origin, index, done.normal[index], np.sqrt(done.variance[index]), outliers, done.reason[outliers], report,
        noise=tuned.regions.sigma_m[index], reach=tuned.regions.ball_m[tuned.regions.level[index]],
        curved=done.kind[index] == -1,
    )  # fmt: skip
