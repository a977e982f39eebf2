"""What explains the riddles of seed 000 chapter 5: each is answered by numbers, from simulated
scans and from the printed tables.

The riddles: the volume is underestimated; density 3 does better than 2; the median filter makes it
worse; a better fit is no better volume; volumes change linearly with the level, with both signs;
Method 2 is too large, but not for subset 3; volumes fall with the number of vertices, and one third
of the points seems best.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ladar_volume.experiments.nist.nist_experiments import (
    COUNTS,
    FILTER_TOLERANCE_M,
    SUBSET_VERTICES,
    MethodComparison,
    box_volume,
    error_pct,
    scan_frame,
    subsets,
    surface_pairs,
)
from ladar_volume.experiments.nist.nist_published import (
    LEVELS_5_7,
    TABLE_5_3A,
    TABLE_5_8A,
    TABLE_5_8B,
    box_volumes,
)
from ladar_volume.experiments.nist.nist_scene import BOX_M, TRUE_M3, pair
from ladar_volume.model.records import F64, Tin
from ladar_volume.tin.locate import height_at
from ladar_volume.tin.median_screen import tin_filter
from ladar_volume.volume.overlay import volumes_between

#: Half width of the strips about walls, four times the range noise, and side of the cells of a
#: difference map, m.
STRIP_M, CELL_M = 0.08, 0.008
REGIONS = ("along the screens", "along the box's walls", "on the box", "elsewhere")


def difference_map(surfaces: tuple[Tin, Tin]) -> tuple[F64, F64, F64]:
    """Heights with minus without the box (n,) m on a fine grid over both, NaN where one is missing;
    the true one; positions (n, 2).
    """
    axis = np.arange(-0.2, 2.2, CELL_M) + 0.5 * CELL_M
    xy = np.stack([g.ravel() for g in np.meshgrid(axis, axis)], axis=1)
    share = np.clip(
        (BOX_M[:2] - xy) / CELL_M + 0.5, 0.0, 1.0
    )  # of each cell that the box covers, along each axis
    true = np.where((xy > 0).all(axis=1), BOX_M[2] * share.prod(axis=1), 0.0)
    return height_at(surfaces[0], xy) - height_at(surfaces[1], xy), true, xy


def by_region(surfaces: tuple[Tin, Tin]) -> F64:
    """Errors of the volume by :data:`REGIONS`, over the common footprint, and (last) by the
    difference of the footprints; % of the box.
    """
    difference, true, xy = difference_map(surfaces)
    wall = (np.abs(xy - BOX_M[:2]) < STRIP_M) & (xy[:, ::-1] < BOX_M[1::-1] + STRIP_M)
    masks = [(xy < STRIP_M).any(axis=1)]
    masks.append(wall.any(axis=1) & ~masks[0])
    masks.append((true > 0) & ~masks[0] & ~masks[1])
    masks.append(~(masks[0] | masks[1] | masks[2]))
    error = np.nan_to_num(difference - true, nan=0.0) * CELL_M**2 * 100.0 / TRUE_M3
    common = volumes_between(*surfaces, gradients=False).net_m3
    return np.array(
        [
            *(error[m].sum() for m in masks),
            float(error_pct(box_volume(surfaces)) - error_pct(common)),
        ]
    )


def sensitivity(seed: int) -> dict[str, F64]:
    """Errors (%) of one subset by Experiment 3's procedure, changed one thing at a time, and by
    region; ``common``: over the common footprint; ``directed``: along the scan direction, over the
    common footprint.
    """
    out: dict[str, F64] = {}
    for name, sigma in (
        ("as published", 0.02),
        ("noise 1 cm", 0.01),
        ("noise 4 cm", 0.04),
        ("no noise", 0.0),
    ):
        a, b = pair(1, seed, sigma)
        i, j = subsets(a, seed, 0)[0], subsets(b, seed, 1)[0]
        points = a.points[i], b.points[j]
        surfaces = subset_surfaces(*points)
        out[name] = np.r_[error_pct(box_volume(surfaces)), by_region(surfaces)]
        if name == "as published":
            frame = scan_frame(b)
            turned = subset_surfaces(frame.points(points[0]), frame.points(points[1]))
            out["common footprint"] = common_error(surfaces)
            out["scan direction, common footprint"] = common_error(turned)
            out |= median_filter_shares(*points)
    return out


def subset_surfaces(with_box: F64, without_box: F64) -> tuple[Tin, Tin]:
    """Surfaces of two subsets (n, 3), m, with as many vertices as published."""
    return surface_pairs((with_box, without_box), (SUBSET_VERTICES, SUBSET_VERTICES))[1]


def common_error(surfaces: tuple[Tin, Tin]) -> F64:
    """Error (1,), %, of the volume over the common footprint."""
    return error_pct(volumes_between(*surfaces, gradients=False).net_m3).reshape(1)


def median_filter_shares(with_box: F64, without_box: F64) -> dict[str, F64]:
    """The same with the median filter; ``replaced``: the share of points that it replaced, and how
    many of these lie near a wall of the box.
    """
    first, second = (tin_filter(p, FILTER_TOLERANCE_M) for p in (with_box, without_box))
    surfaces = subset_surfaces(first.points_map, second.points_map)
    near_wall = [
        np.abs(p[:, None] - np.r_[0.0, edge]).min(axis=1) < STRIP_M
        for p, edge in ((with_box[:, 0], BOX_M[0]), (with_box[:, 1], BOX_M[1]))
    ]
    near = (near_wall[0] | near_wall[1])[first.outliers].mean()
    return {
        "median filter": np.r_[error_pct(box_volume(surfaces)), by_region(surfaces)],
        "replaced": np.array([len(first.outliers) / len(with_box), near]),
    }


def published_levels() -> dict[str, Any]:
    """Riddles of the levels from the printed digits of Table 5.8 alone.

    For each subset the slope of the cut volumes is minus a footprint, so the two footprints are
    known; ``V2 − V1`` is then predicted by their difference times the distance between the two
    methods' levels.
    """
    out: dict[str, Any] = {}
    for name, table in (("with adjustment", TABLE_5_8A), ("without", TABLE_5_8B)):
        volume = box_volumes(table)
        areas = -np.polyfit(
            LEVELS_5_7[1] / 100.0, table[:, 1].transpose(1, 0, 2).reshape(5, -1), 1
        )[0].reshape(-1, 2)
        slope = np.array(
            [
                [np.polyfit(LEVELS_5_7[m] / 100.0, volume[k, m], 1)[0] for m in range(2)]
                for k in range(len(volume))
            ]
        )
        area = areas[:, 0] - areas[:, 1]
        observed = volume[:, 1, 0] - volume[:, 0, 4]
        predicted = area * (LEVELS_5_7[0, 4] - LEVELS_5_7[1, 0]) / 100.0
        out[name] = {
            "area_difference_cm2": 1e4 * area,
            "slope_method_1_cm2": 1e4 * slope[:, 0],
            "slope_method_2_cm2": 1e4 * slope[:, 1],
            "method_2_minus_1_m3": observed,
            "predicted_m3": predicted,
            "correlation": float(np.corrcoef(observed, predicted)[0, 1]),
            "rest_rms_m3": float(np.sqrt(np.mean((observed - predicted) ** 2))),
        }
    return out


def simulated_levels(experiments: list[list[list[MethodComparison]]]) -> dict[str, Any]:
    """The same in simulated scans (seeds, clouds, without and with adjustment)."""
    rows = np.array(
        [
            (
                d.two.areas_m2[0] - d.two.areas_m2[1],
                d.one.slope_m2,
                d.two.slope_m2,
                d.two.volume_m3[0] - d.one.volume_m3[-1],
                d.one.level_with_m[-1] - d.two.level_with_m[0],
                d.offset.offset_m,
            )
            for seed in experiments
            for cloud in seed
            for d in cloud
        ]
    )
    predicted = rows[:, 0] * rows[:, 4]
    return {
        "area_difference_mean_cm2": float(1e4 * rows[:, 0].mean()),
        "area_difference_spread_cm2": float(1e4 * rows[:, 0].std(ddof=1)),
        "slopes_negative_share": (rows[:, 1:3] < 0).mean(axis=0),
        "slope_is_area_correlation": [
            float(np.corrcoef(-rows[:, 0], rows[:, c])[0, 1]) for c in (1, 2)
        ],
        "correlation": float(np.corrcoef(rows[:, 3], predicted)[0, 1]),
        "rest_rms_m3": float(np.sqrt(np.mean((rows[:, 3] - predicted) ** 2))),
        "offset_mean_mm": float(1e3 * np.nanmean(rows[:, 5])),
        "offset_spread_mm": float(1e3 * np.nanstd(rows[:, 5], ddof=1)),
    }


def densities(volumes: F64, measures: F64) -> dict[str, Any]:
    """Whether density 3 beats 2, and a better fit a better volume. volumes : (seeds, 5, 4) ·
    measures : (seeds, 5, 2, 2, 4).
    """
    error = error_pct(volumes)
    out: dict[str, Any] = {
        "mean_pct": error.mean(axis=0),
        "spread_pct": error.std(axis=0, ddof=1) if len(error) > 1 else error[0] * np.nan,
    }
    if error.shape[1] >= 3:
        out["density_3_better_than_2_share"] = float(
            (np.abs(error[:, 2, 0]) < np.abs(error[:, 1, 0])).mean()
        )
        out["as_far_apart_as_published_share"] = float(
            (
                np.abs(np.diff(error[:, 1:3, 0], axis=1))
                >= abs(TABLE_5_3A[2, 0] - TABLE_5_3A[1, 0])
            ).mean()
        )
    fit = measures[..., 1, :].mean(axis=2)
    out["fit_better_share"] = (fit[..., 1:] < fit[..., :1]).mean(axis=(0, 1))
    out["volume_better_share"] = (np.abs(error[..., 1:]) < np.abs(error[..., :1])).mean(axis=(0, 1))
    return out


def vertices(volumes: F64, counts: tuple[int, ...] = COUNTS) -> dict[str, Any]:
    """Error by the number of vertices. volumes : (seeds, 2, counts, bins), Experiment 1."""
    mean = error_pct(np.nanmean(volumes, axis=3))
    middle = mean.mean(axis=0)
    scatter = mean.std(axis=0, ddof=1) if len(mean) > 1 else mean[0] * np.nan
    best = [[counts[int(np.argmin(np.abs(m)))] for m in one] for one in mean]
    return {
        "counts": counts,
        "without_pct": middle[0],
        "with_pct": middle[1],
        "spread_pct": scatter,
        "falls_share": (mean[:, :, -1] < mean[:, :, 0]).mean(axis=0),
        "best_count_by_seed": best,
    }
