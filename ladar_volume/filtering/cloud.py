"""The filter for a whole cloud of points without times or poses (seed 002 chapter 4): every input point is kept or named."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ladar_volume.filtering import cells
from ladar_volume.filtering.store import HALF, pack_key, place_all
from ladar_volume.filtering.tuning import choose
from ladar_volume.model.errors import FilterError
from ladar_volume.model.parameters import FilterParameters
from ladar_volume.model.records import F64, I32, I64

#: Names of the reasons, by the numbers of ``CloudResult.reason``.
REASONS = ("kept", "outlier", "few_neighbours", "no_surface", "beyond_edge", "unsupported")


@dataclass(frozen=True)
class CloudResult:
    """What became of a cloud.

    r : (k, 3) m, filtered points in the order of their input · index : (k,) input point of each · normal : (k, 3), towards no
    side in particular · sigma : (k,) m, standard deviation along the normal · outliers : (m,) input points taken out, ascending ·
    reason : (m,) index into ``REASONS`` · report : what was chosen and what came of it
    """

    r: F64
    index: I64
    normal: F64
    sigma: F64
    outliers: I64
    reason: I64
    report: dict[str, float | int | str]


def sorted_by_voxel(r: F64, edge_m: float) -> tuple[I64, I64, I64, I32]:
    """Order (n,) of points by voxel of the given edge, keys (v,), first point of each voxel (v + 1,), hash table."""
    ijk = np.floor(r / edge_m).astype(np.int64)
    if np.abs(ijk).max(initial=0) >= HALF - 8:
        raise FilterError(f"a cloud wider than {2 * HALF} voxels of {edge_m} m", reason="filter_too_wide", value=edge_m)
    key = pack_key(ijk)
    order = np.lexsort((r[:, 2], r[:, 1], r[:, 0], key))
    keys, first = np.unique(key[order], return_index=True)
    table = np.full(1 << max(4, int(4 * len(keys) - 1).bit_length()), -1, np.int32)
    place_all(table, keys, len(keys))
    return order, keys, np.append(first, len(r)).astype(np.int64), table


def filter_cloud(r: F64, parameters: FilterParameters, auto: bool = False) -> CloudResult:
    """Robust moving least squares on points (n, 3), m, in any frame.

    auto : estimate noise, radius and degree from the cloud instead of taking them from the parameters. Raises
    :class:`FilterError` for a wrong shape, a coordinate that is not finite, or no points.
    """
    points = np.ascontiguousarray(r, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0:
        raise FilterError(f"points are (n, 3), not {points.shape}", reason="filter_shape", value=points.shape)
    bad = int(np.count_nonzero(~np.isfinite(points).all(axis=1)))
    if bad:
        raise FilterError(f"{bad} points with a coordinate that is not finite", reason="filter_not_finite", value=bad)
    origin = points.mean(axis=0)  # digits: cells work on offsets of the cloud's size, not on map coordinates
    local = points - origin
    tuned = choose(local, parameters, auto)
    ball = tuned.ball_m
    order, keys, first, table = sorted_by_voxel(local, ball / 2)
    n = len(local)
    q, normals, variance = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n)
    reason, kind = np.full(n, cells.NO_SURFACE, np.int64), np.zeros(len(keys), np.int64)
    main, found, ordered = np.zeros((len(keys), cells.OFFERED, 4)), np.zeros(len(keys), np.int64), local[order]
    cells.main_planes(
        keys, table, first, ordered, ball / 2.5, tuned.sigma_m, tuned.threshold_m, parameters.trials, parameters.min_points,
        parameters.seed, main, found,
    )  # fmt: skip
    cells.filter_cells(
        keys, table, first, ordered, main, found, ball, tuned.degree, tuned.sigma_m, tuned.threshold_m, parameters.min_points,
        parameters.refit_iterations, True, q, normals, variance, reason, kind,
    )  # fmt: skip
    back = np.empty(n, np.int64)
    back[order] = np.arange(n)
    kept = reason[back] == cells.KEPT
    index = np.flatnonzero(kept)
    rows = back[index]
    outliers = np.flatnonzero(~kept)
    report: dict[str, float | int | str] = {
        **tuned.report(),
        "points": n,
        "kept": len(index),
        "cells": len(keys),
        "cells_quadric": int(np.count_nonzero(kind == -1)),
        "cells_plane": int(np.count_nonzero(kind == 1)),
        "cells_sharp": int(np.count_nonzero(kind > 1)),
    }
    for number, name in enumerate(REASONS[1:], 1):
        report[name] = int(np.count_nonzero(reason == number))
    return CloudResult(q[rows] + origin, index, normals[rows], np.sqrt(variance[rows]), outliers, reason[back[outliers]], report)
