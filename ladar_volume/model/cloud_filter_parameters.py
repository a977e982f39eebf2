"""The parameters of the filters of point cloud files, one class per algorithm. They come from the
command line (``ladar_volume filter --set filter.KEY=VALUE``) and stand in no parameter file: the
section ``filter`` of such a file is that of the live filter.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ladar_volume.model.parameter import param

#: Which of them filters a file: every cell its own surface, in any order; or the published
#: sequential sweep (Algorithm 1).
ORDERS = ("cover", "published")
LIVE = "is read by the live filter alone (replay, nodes), not for point cloud files"
PUBLISHED = "is read in the published order alone: add --set filter.order=published"


@dataclass(frozen=True)
class FilterParameters:
    """The filter of point cloud files: every cell its own surface (order `cover`)."""

    elsewhere: ClassVar[dict[str, str]] = {
        **dict.fromkeys(("cap_per_voxel", "sampling_m", "nav_bin_s"), LIVE),
        **dict.fromkeys(("start", "confidence", "sample_size", "ransac_threshold_m"), PUBLISHED),
    }

    radius_m: float = param(
        0.5, "Range r: cells are r apart and are fitted over 2r.", unit="m", low=0.001, high=100
    )
    degree: int = param(2, "Polynomial degree of a surface.", low=1, high=2)
    trials: int = param(40, "Random samples per neighbourhood.", low=1, high=10000)
    outlier_sigmas: float = param(
        3.5,
        "Inlier threshold in robust sigma; below 3 the printed variance would be too small.",
        low=3,
        high=20,
    )
    outlier_floor_m: float = param(
        0.0,
        "The inlier threshold is never below this; in the published order it is this.",
        unit="m",
        low=0,
        high=10,
    )
    min_points: int = param(12, "Fewest inliers of a surface.", low=4, high=100000)
    refit_iterations: int = param(30, "Most refits towards the fixed point.", low=1, high=1000)
    grid_before_m: float = param(
        0.0,
        "Grid of the reduction before the filter; 0 for none.",
        unit="m",
        low=0,
        high=100,
    )
    grid_after_m: float = param(
        0.0,
        "Grid of the reduction after the filter; 0 for none.",
        unit="m",
        low=0,
        high=100,
    )
    reduce: str = param(
        "published",
        (
            "What stands for the points of a grid cell: its middle, their mean, or as "
            "published the middle before and the mean after."
        ),
        choices=("published", "round", "mean"),
    )
    edge: str = param(
        "snap", "Points beyond an edge are set onto it, or removed.", choices=("snap", "remove")
    )
    seed: int = param(
        1, "Seed of the random samples; each cell derives its own from it.", low=0, high=2**31 - 1
    )


@dataclass(frozen=True)
class PublishedFilterParameters(FilterParameters):
    """The filter of point cloud files as published, sequential (order `published`)."""

    elsewhere: ClassVar[dict[str, str]] = dict.fromkeys(
        ("cap_per_voxel", "sampling_m", "nav_bin_s"), LIVE
    )

    start: str = param("lmeds", "How the starting model is sampled.", choices=("lmeds", "ransac"))
    confidence: float = param(
        0.999,
        "Trials end once a sample without outliers was drawn with this probability; 1 for never.",
        low=0,
        high=1,
    )
    sample_size: int = param(
        4,
        "Points per random sample: a plane through three, or the mean plane of four.",
        low=3,
        high=4,
    )
    ransac_threshold_m: float = param(
        0.02, "Residual threshold of the weighted RANSAC start.", unit="m", low=1e-6, high=10
    )


#: The class of each order.
FILTERS: dict[str, type[FilterParameters]] = {
    "cover": FilterParameters,
    "published": PublishedFilterParameters,
}
