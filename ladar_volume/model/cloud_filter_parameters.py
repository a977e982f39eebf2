"""The parameters of the filters of point cloud files, one class per algorithm. They come from the
command line (``ladar_volume filter --set filter.KEY=VALUE``) and stand in no parameter file: the
section ``filter`` of such a file is that of the live filter.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ladar_volume.model.parameter import param
from ladar_volume.model.robust_fit_parameters import RandomStartParameters, RobustFitParameters

#: Which of them filters a file: every cell its own surface, in any order; or the published
#: sequential sweep (Algorithm 1).
ORDERS = ("cover", "published")
LIVE = "is read by the live filter alone (replay, nodes), not for point cloud files"
PUBLISHED = "is read in the published order alone: add --set filter.order=published"


@dataclass(frozen=True)
class FilterParameters(RobustFitParameters):
    """The filter of point cloud files: every cell its own surface (order `cover`)."""

    elsewhere: ClassVar[dict[str, str]] = {
        **dict.fromkeys(("cap_per_voxel", "sampling_m", "nav_bin_s"), LIVE),
        **dict.fromkeys(
            (
                "start",
                "confidence",
                "sample_size",
                "ransac_threshold_m",
                "edges_threshold",
                "min_share",
                "sort",
            ),
            PUBLISHED,
        ),
    }

    outlier_floor_m: float = param(
        0.0,
        "The inlier threshold is never below this; in the published order it is this.",
        unit="m",
        low=0,
        high=10,
    )
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


@dataclass(frozen=True)
class PublishedFilterParameters(FilterParameters, RandomStartParameters):
    """The filter of point cloud files as published, sequential (order `published`)."""

    elsewhere: ClassVar[dict[str, str]] = dict.fromkeys(
        ("cap_per_voxel", "sampling_m", "nav_bin_s"), LIVE
    )

    sample_size: int = param(
        4,
        "Points per random sample (thesis: k = 20 or 10; the fewer the likelier without outliers).",
        low=3,
        high=1000,
    )
    edges_threshold: float = param(
        0.1,
        "Share of outliers above which an edge, then a corner, is looked for (edgesThreshold).",
        low=0,
        high=1,
    )
    min_share: float = param(
        0.5,
        "Share of a neighbourhood that has to lie on its surfaces (the breakdown point).",
        low=0,
        high=1,
    )
    sort: bool = param(True, "Visit points by the sum of their coordinates; else as they come.")
    confidence: float = param(
        0.999,
        "Trials end once a sample without outliers was drawn with this probability; 1 for never.",
        low=0,
        high=1,
    )


#: The class of each order.
FILTERS: dict[str, type[FilterParameters]] = {
    "cover": FilterParameters,
    "published": PublishedFilterParameters,
}
