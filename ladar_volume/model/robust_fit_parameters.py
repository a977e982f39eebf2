"""The parameters that every robust moving least squares filter has, live and for files."""

from __future__ import annotations

from dataclasses import dataclass

from ladar_volume.model.parameter import param


@dataclass(frozen=True)
class RobustFitParameters:
    """Robust fits of surfaces to the points around a grid of places (seed 002 chapter 4)."""

    radius_m: float = param(
        0.5,
        "Range r: patches, or cells, are r apart and are fitted over 2r.",
        unit="m",
        low=0.001,
        high=100,
    )
    degree: int = param(2, "Polynomial degree of a surface.", low=1, high=2)
    trials: int = param(40, "Random samples per surface.", low=1, high=10000)
    outlier_sigmas: float = param(
        3.5,
        "Inlier threshold in robust sigma; below 3 the printed variance would be too small.",
        low=3,
        high=20,
    )
    outlier_floor_m: float = param(
        0.0, "The inlier threshold is never below this.", unit="m", low=0, high=10
    )
    min_points: int = param(12, "Fewest inliers of a surface.", low=4, high=100000)
    refit_iterations: int = param(30, "Most refits towards the fixed point.", low=1, high=1000)
    seed: int = param(
        1,
        "Seed of the random samples; each surface derives its own from it and its place.",
        low=0,
        high=2**31 - 1,
    )


@dataclass(frozen=True)
class RandomStartParameters(RobustFitParameters):
    """Fits that start from random samples."""

    start: str = param("lmeds", "How the starting model is sampled.", choices=("lmeds", "ransac"))
    sample_size: int = param(
        4,
        "Points per random sample: a plane through three, or the mean plane of four.",
        low=3,
        high=4,
    )
    ransac_threshold_m: float = param(
        0.02, "Residual threshold of the weighted RANSAC start.", unit="m", low=1e-6, high=10
    )
