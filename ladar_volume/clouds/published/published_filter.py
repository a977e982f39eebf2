"""The published filter (seed 002 chapter 4, Algorithm 1), sequential and order dependent: the
option ``order: published``.

Beside the source: planes and quadrics lie over a local tangent plane, never over the map's, and the
sampled model is only a start for a least-squares refit on its inliers. The published thresholds cut
into the noise. That makes the scatter of the inliers smaller than the noise and the fit less sure
than least squares would say, so sigmas are inflated by what the cut costs:

    d fit / d (shift of the noise) = 1 − 2 threshold · f(threshold) / P(inlier)

for a density f of the residuals, hence variances by one over its square (Huber's one-step estimate
of a skipped mean). f comes from the residuals of all fits in a band about the threshold: normal
noise cut at 1.73 sigma gives 2.3, at 3 sigma 1.06.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from ladar_volume.clouds.filter.cell_surface import FEW_POINTS, KEPT
from ladar_volume.clouds.filter.filter_result import REASONS, CloudResult, check_cloud_points
from ladar_volume.clouds.filter.point_reduction import sorted_by_voxel
from ladar_volume.clouds.published import published_records as records
from ladar_volume.clouds.published.published_records import (
    Outcome,
    PublishedRule,
    Sampling,
    Voxels,
    neighbourhood,
)
from ladar_volume.clouds.published.published_sweep import BAND, sweep
from ladar_volume.model.cloud_filter_parameters import PublishedFilterParameters
from ladar_volume.model.errors import FilterError
from ladar_volume.model.records import F64, I64

#: Least factor of the sensitivity of a fit to its points: below, the cut takes all and the
#: inflation stays at 100.
LEAST_SENSITIVITY = 0.1


@dataclass(frozen=True)
class PublishedParameters:
    """Names of the source in brackets; lengths in m.

    radius_m (delta) : fits reach over twice this · degree (polDeg) · sample_size (k) : points per
    random sample, at least six for a quadric · trials (T) · confidence : trials end once an
    outlier-free sample was drawn with it, 1 for never · start : ``lmeds`` or ``ransac`` ·
    ransac_threshold_m (residualsThreshold) · threshold_m (outliersThreshold) : 0 for
    ``outlier_sigmas`` robust sigma · edges_threshold (edgesThreshold) : ratio of outliers above
    which an edge is looked for · min_share : share of a neighbourhood that has to lie on its
    surfaces: with more outliers than the breakdown point there is none (section 4.1) · min_points
    (minPts) : fewest points within the radius that are not filtered yet · edge : points beyond an
    intersection are set onto it (``snap``) or taken out (``remove``) · sort : visit points by the
    sum of their coordinates (section 4.3), else as they come
    """

    radius_m: float = 0.2
    degree: int = 1
    sample_size: int = 4
    trials: int = 200
    confidence: float = 0.999
    start: str = "ransac"
    ransac_threshold_m: float = 0.02
    threshold_m: float = 0.0
    outlier_sigmas: float = 3.5
    edges_threshold: float = 0.1
    min_share: float = 0.5
    min_points: int = 20
    refit_iterations: int = 30
    edge: str = "snap"
    sort: bool = True
    seed: int = 1

    def __post_init__(self) -> None:
        wrong = [
            f.name
            for f in dataclasses.fields(self)
            if f.name not in ("start", "edge", "sort") and not getattr(self, f.name) >= 0
        ]
        wrong += [
            name
            for name in ("radius_m", "trials", "ransac_threshold_m", "refit_iterations")
            if not getattr(self, name) > 0
        ]
        wrong += ["sample_size"] * (self.sample_size < 3) + ["min_points"] * (self.min_points < 4)
        wrong += ["degree"] * (self.degree not in (1, 2)) + ["start"] * (
            self.start not in ("lmeds", "ransac")
        )
        wrong += ["edge"] * (self.edge not in ("snap", "remove")) + ["confidence"] * (
            not 0.0 <= self.confidence <= 1.0
        )
        if wrong:
            value = getattr(self, wrong[0])
            raise FilterError(
                f"{wrong[0]} cannot be {value!r}", reason="filter_parameter", value=value
            )


def settings(parameters: PublishedFilterParameters, **changes: float) -> PublishedParameters:
    """From the parameters of the published order. Their floor of the threshold, where there is one,
    is the published threshold itself.
    """
    names = {f.name for f in dataclasses.fields(PublishedParameters)} & {
        f.name for f in dataclasses.fields(parameters)
    }
    values: dict[str, Any] = {name: getattr(parameters, name) for name in names}
    return PublishedParameters(**{**values, "threshold_m": parameters.outlier_floor_m, **changes})


def filter_published(r: F64, parameters: PublishedParameters) -> CloudResult:
    """Algorithm 1 on points (n, 3), m, in any frame, without its reductions. Raises FilterError as
    ``filter_cloud.filter_cloud``.

    Points never projected keep their last reason: ``few_neighbours`` where no neighbourhood with
    enough new points reached them.
    """
    points = check_cloud_points(r)
    # digits: neighbourhoods work on offsets of the cloud's size, not on map coordinates
    origin = points.mean(axis=0)
    local = points - origin
    order, keys, first, table = sorted_by_voxel(local, parameters.radius_m)
    voxel = np.repeat(np.arange(len(keys)), np.diff(first))
    row = np.empty(len(points), np.int64)  # of each point among the ordered ones
    row[order] = np.arange(len(points))
    visit = row[np.lexsort((*local.T, local.sum(axis=1)))] if parameters.sort else row
    found = _empty(len(points))
    sweep(
        visit,
        Voxels(voxel, keys, table, first),
        local[order],
        _rule(parameters),
        neighbourhood(len(points)),
        found,
    )
    return _result(found, row, origin, parameters)


def _empty(n: int) -> Outcome:
    """The outcome of n points before the first visit."""
    reason = np.full(n, FEW_POINTS, np.int64)
    return Outcome(np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n), reason, np.zeros(8))


def _result(found: Outcome, row: I64, origin: F64, p: PublishedParameters) -> CloudResult:
    """What became of each point; row : (n,) of each point among the ordered ones."""
    reason, tally = found.reason[row], found.tally
    index, outliers = np.flatnonzero(reason == KEPT), np.flatnonzero(reason != KEPT)
    rows = row[index]
    factor = inflation(tally[records.INLIERS], tally[records.IN_BAND])
    report = _report(p, tally, factor)
    report |= {
        "points": len(row),
        "kept": len(index),
        **{name: int(np.count_nonzero(reason == i)) for i, name in enumerate(REASONS) if i},
    }
    sigma = np.sqrt(factor * found.variance[rows])
    return CloudResult(
        found.r[rows] + origin,
        index,
        found.normal[rows],
        sigma,
        outliers,
        reason[outliers],
        report,
    )


def inflation(inliers: float, in_band: float) -> float:
    """Variance of a fit that leaves out what lies beyond a threshold, over what least squares on
    its inliers says.

    in_band : residuals within ``BAND`` of the threshold, as a share of it, on either side.
    """
    density = in_band / (2.0 * BAND * inliers) if inliers else 0.0
    return float(max(1.0 - density, LEAST_SENSITIVITY) ** -2)


def _rule(p: PublishedParameters) -> PublishedRule:
    sampling = Sampling(
        int(p.sample_size),
        int(p.trials),
        p.start == "ransac",
        float(p.ransac_threshold_m),
        float(p.confidence),
    )
    return PublishedRule(
        float(p.radius_m),
        int(p.degree),
        sampling,
        0.0 if p.threshold_m > 0.0 else float(p.outlier_sigmas),
        float(p.threshold_m),
        float(p.edges_threshold),
        float(p.min_share),
        int(p.min_points),
        int(p.refit_iterations),
        p.edge == "snap",
        int(p.seed),
    )


def _report(p: PublishedParameters, tally: F64, factor: float) -> dict[str, float | int | str]:
    fits = max(tally[records.FITS], 1.0)
    noise = float(np.sqrt(tally[records.SQUARES] / max(tally[records.INLIERS], 1.0)))
    threshold = p.threshold_m or float(tally[records.THRESHOLDS] / fits)
    return {
        "order": "published",
        "radius_m": p.radius_m,
        "fit_radius_m": 2 * p.radius_m,
        "degree": p.degree,
        "threshold_m": threshold,
        "noise_m": noise,
        "threshold_over_noise": threshold / noise if noise > 0.0 else 0.0,
        "variance_inflation": factor,
        "fits": int(tally[records.FITS]),
        "fits_edge": int(tally[records.EDGES]),
        "fits_corner": int(tally[records.CORNERS]),
        "trials_per_fit": float(tally[records.TRIALS] / fits),
    }
