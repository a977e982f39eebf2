"""Parameters that set themselves: noise, radius and threshold from the cloud itself, per region
(seed 002, future work).

Noise is the residual of robust quadrics over the smallest neighbourhoods that are clearly wider
than it. The radius is the largest, up to a number of points from which more would gain little, at
which the filter's own surfaces still describe the points as well as they do at small radii; planes
that meet count as described, so edges do not make the radius small, but clutter and strong
curvature do. Whether a neighbourhood is one quadric or several planes each decides for itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.clouds.filter.cell_cover import Regions, project_on_cells
from ladar_volume.clouds.filter.line_tuning import NoiseSites, first_noise, line_regions
from ladar_volume.clouds.filter.noise_estimate import hashes, scatter
from ladar_volume.clouds.sampling.rounding_step import dither, remove_dither_noise
from ladar_volume.clouds.sampling.sampling_lines import (
    Lines,
    find_lines,
    has_uneven_spacing,
    lies_along_lines,
)
from ladar_volume.model.parameters import FilterParameters
from ladar_volume.model.records import F64, I64, Bool

#: Points at which the cloud is looked at; those at which the filter is tried; neighbours whose
#: median makes a region's value.
SAMPLES, TRIED, SMOOTH = 400, 40, 60
#: Points at which a cloud sampled along lines is looked at; quantile of its spacing that starts the
#: search for lines.
PLACES, FINEST = 2000, 0.05
#: Noise over the spacing along a line where nothing tells it.
DEFAULT = 0.5
#: Neighbours in the largest neighbourhood, and in those from which noise is told.
MOST = 1000
LADDER = (30, 60, 120, 250, 500, MOST)
#: A neighbourhood tells noise from extent when its radius is this many sigma.
PLATE = 5.0
#: Quantile of the samples' noise by which regions are compared.
LOW = 0.2
#: Noise that differs from the whole cloud's by less than this share is the whole cloud's.
ALIKE = 0.15
#: More than this many times the cloud's noise is no noise but leaves and branches.
CLUTTER = 5.0
#: Noise is larger where surfaces leave this much more of it, in squares, than elsewhere.
NOISIER = 1.4
#: Threshold in sigma: from three on the variance of what is left within it is that of the noise.
SIGMAS = 3.0
#: Neighbouring radii differ by this factor; so many smaller ones are tried.
STEP, STEPS = float(np.sqrt(2.0)), 3
#: A larger radius may describe the points worse by this share, and by this many standard deviations
#: of a mean of squares.
WORSE, DEVIATIONS = 0.08, 2.0
#: Share of the cloud's diagonal that a neighbourhood's radius may have.
WIDEST = 0.25


@dataclass(frozen=True)
class Tuning:
    """regions as the cover wants them · degree of the surfaces · lines : along which the cloud was
    sampled, None for an even one · places : from which the noise of such a cloud is estimated ·
    noise_known : whether the noise is the cloud's own; if not, a default stands in
    """

    regions: Regions
    degree: int
    lines: Lines | None = None
    places: NoiseSites | None = None
    noise_known: bool = True

    @property
    def ball_m(self) -> float:
        """Median radius of a neighbourhood."""
        return float(np.median(self.regions.ball_m[self.regions.level]))

    @property
    def sigma_m(self) -> float:
        """Median noise."""
        return float(np.median(self.regions.sigma_m))

    @property
    def threshold_m(self) -> float:
        """Median threshold."""
        return float(np.median(self.regions.threshold_m))

    def report(self, factor: float = 1.0) -> dict[str, float | int | str]:
        """The chosen values by name; where regions differ their median and range. factor : noise as
        found in the end over that chosen.
        """
        used = self.regions.ball_m[np.unique(self.regions.level)]
        out: dict[str, float | int | str] = {
            "radius_m": self.ball_m / 2,
            "fit_radius_m": self.ball_m,
            "noise_m": factor * self.sigma_m,
            "threshold_m": min(factor, 1.0) * self.threshold_m,
            "degree": self.degree,
            "radii": len(used),
        }
        if len(used) > 1:
            out |= {
                "least_radius_m": float(used.min()) / 2,
                "largest_radius_m": float(used.max()) / 2,
            }
        if np.ptp(self.regions.sigma_m) > 0.0:
            noise = factor * self.regions.sigma_m
            out |= {"least_noise_m": float(noise.min()), "largest_noise_m": float(noise.max())}
        return out


def tune(r: F64, parameters: FilterParameters, auto: bool, steps: F64) -> Tuning:
    """Regions and degree for points (n, 3) m near the origin. Without ``auto`` radius and degree
    are the parameters', fits reach over 2 r, and only the noise is estimated, one for the whole
    cloud. steps : (3,) m, to which the coordinates were rounded.
    """
    n = len(r)
    at = _samples(r, parameters.seed)
    tree = cKDTree(r, balanced_tree=False, compact_nodes=False)
    distance, near = _query(tree, r[at], MOST)
    smooth = _nearest(r[at], r[at], SMOOTH)
    evenly = dither(r, steps, parameters.seed)
    if lies_along_lines(r, near) or has_uneven_spacing(r, near, distance, smooth):
        return _along_lines(r, evenly, steps, distance, parameters, auto)
    noise, narrow = _noise(evenly, distance, near, smooth, parameters.seed)
    noise = remove_dither_noise(noise, steps)
    regional = noise[:, 0] * np.median(noise[:, 1] / noise[:, 0])
    if not auto:
        regions = _one_region(n, float(np.median(regional)), parameters)
        return Tuning(regions, parameters.degree)
    extent = WIDEST * float(np.linalg.norm(np.ptp(r, axis=0)))
    wide = np.maximum(np.minimum(np.median(distance[:, -1][smooth], axis=1), extent), narrow)
    return Tuning(_own_regions(r, tree, at, _SampleNoise(regional, narrow, wide), parameters), 2)


def _one_region(n: int, whole: float, parameters: FilterParameters) -> Regions:
    """The parameters' radius for all n points, with one noise, m."""
    limit = max(parameters.outlier_sigmas * whole, parameters.outlier_floor_m)
    balls, zero = np.array([2.0 * parameters.radius_m]), np.zeros(n, np.int64)
    return Regions(balls, zero, zero, np.full(n, whole), np.full(n, limit))


@dataclass(frozen=True)
class _SampleNoise:
    """Around each sample, (s,) m: noise · narrow : radius from which it was told · wide : largest
    radius
    """

    noise: F64
    narrow: F64
    wide: F64


def _own_regions(
    r: F64, tree: cKDTree, at: I64, around: _SampleNoise, parameters: FilterParameters
) -> Regions:
    """Noise and radius of points (n, 3) as the samples ``at`` (s,) show them."""
    whole = float(np.median(around.noise))
    sigma = np.where(
        (np.abs(around.noise / whole - 1.0) > ALIKE) & (around.noise < CLUTTER * whole),
        around.noise,
        whole,
    )
    low = float(around.wide.min()) / STEP**STEPS
    level = np.rint(np.log(around.wide / low) / np.log(STEP)).astype(np.int64)
    balls = low * STEP ** np.arange(level.max() + 1)
    least = np.minimum(
        np.ceil(np.log(np.maximum(around.narrow / low, 1.0)) / np.log(STEP)).astype(np.int64), level
    )
    down, noisier = _trial(r, tree, at, balls, level, whole, parameters)
    level = np.maximum(level - down, least)
    sigma = np.where(noisier, sigma, np.minimum(sigma, whole))
    nearest = _nearest(r[at], r, 1)[:, 0]
    threshold = np.maximum(SIGMAS * sigma, parameters.outlier_floor_m)
    return Regions(balls, level[nearest], least[nearest], sigma[nearest], threshold[nearest])


def _along_lines(
    r: F64, evenly: F64, steps: F64, distance: F64, parameters: FilterParameters, auto: bool
) -> Tuning:
    """Regions for a cloud sampled along lines or unevenly."""
    lines = find_lines(r, float(np.quantile(distance[:, 4], FINEST)))
    found = first_noise(r, evenly, _samples(r, parameters.seed, PLACES), lines)
    if found is None:
        sigma, where = np.full(len(r), DEFAULT * float(np.median(distance[:, 1]))), None
    else:
        sigma, where = remove_dither_noise(found[0], steps), found[1]
    if not auto:
        whole = float(np.median(sigma))
        regions = _one_region(len(r), whole, parameters)
        return Tuning(regions, parameters.degree, lines, where, where is not None)
    threshold = np.maximum(SIGMAS * sigma, parameters.outlier_floor_m)
    regions = line_regions(r, lines, sigma, threshold)
    return Tuning(regions, 2, lines, where, where is not None)


def _samples(r: F64, seed: int, most: int = SAMPLES) -> I64:
    """Random points in random order, the same ones in whatever order the cloud comes: those with
    the lowest hashes.
    """
    mixed = np.full(len(r), seed, np.uint64)
    for axis in range(3):
        mixed = hashes(mixed ^ (r[:, axis] + 0.0).view(np.uint64))  # + 0.0: one zero
    few = min(most, len(r))
    lowest = np.argpartition(mixed, few - 1)[:few]
    out: I64 = lowest[np.argsort(mixed[lowest], kind="stable")]
    return out


def _query(tree: cKDTree, points: F64, k: int) -> tuple[F64, I64]:
    """Distances and indices (n, k) of the k nearest points of the tree, all of them where there are
    fewer.
    """
    distance, index = tree.query(points, k=np.arange(1, min(k, tree.n) + 1), workers=-1)
    return np.asarray(distance, np.float64), np.asarray(index, np.int64)


def _nearest(samples: F64, points: F64, k: int) -> I64:
    """Indices (n, k) of the samples nearest to points (n, 3)."""
    return _query(cKDTree(samples), points, k)[1]


def _noise(r: F64, distance: F64, near: I64, smooth: I64, seed: int) -> tuple[F64, F64]:
    """Noise (s, 2) m around the samples, and the radius (s,) m from which it was told: the smallest
    that is clearly wider than it.

    smooth : (s, k) samples around each; one by one they would choose the radius by their own error.
    First comes a low quantile of theirs, for comparing regions: near edges most of them see two
    planes. Second comes the median.
    """
    sigma, narrow = np.full((len(near), 2), np.nan), distance[:, -1].copy()
    undecided = np.ones(len(near), np.bool_)
    for k in LADDER:
        if k > near.shape[1] or not undecided.any():
            break
        each = np.empty(len(near))
        scatter(r, np.ascontiguousarray(near[:, :k]), seed, each)
        each = np.where(
            np.isfinite(each), each, np.nanmedian(each) if np.isfinite(each).any() else np.nan
        )
        found, width = (
            np.quantile(each[smooth], (LOW, 0.5), axis=1).T,
            np.median(distance[:, k - 1][smooth], axis=1),
        )
        sigma = np.where((undecided & np.isfinite(found[:, 0]))[:, None], found, sigma)
        plate = undecided & (width >= PLATE * found[:, 1])
        narrow[plate] = width[plate]
        undecided &= ~plate
    # where nothing was found, that is on lines and in tiny clouds, any noise serves: no surface
    # will be found either
    extent = max(float(narrow.max(initial=0.0)), 1e-6)
    sigma = np.where(np.isfinite(sigma), sigma, 0.01 * extent)
    # without noise, coordinates still round
    return np.maximum(sigma, 1e-7 * extent), np.maximum(narrow, 1e-3 * extent)


def _trial(
    r: F64,
    tree: cKDTree,
    at: I64,
    balls: F64,
    level: I64,
    sigma: float,
    parameters: FilterParameters,
) -> tuple[I64, Bool]:
    """The filter on some cells, with one noise for all. By how many steps (s,) the radius around
    each sample must be smaller for the surfaces to describe the points as well as small ones do;
    and where (s,) even those do not, so that the noise there is larger.
    """
    some = np.arange(min(TRIED, len(at)))
    # a cell's planes are offered by cells up to a radius away, and these look one radius further
    inside = tree.query_ball_point(r[at[some]], 3.0 * balls[level[some]])
    window = np.unique(np.concatenate([np.asarray(i, np.int64) for i in inside]))
    sample = _nearest(r[at[some]], r[window], 1)[:, 0]
    centre = np.searchsorted(window, at[some])
    mine = np.zeros(len(window), np.bool_)
    mine[centre] = True
    noise = np.full(len(window), sigma)
    misfit = np.empty((STEPS + 1, len(some)))
    for step in range(STEPS + 1):
        at_step = np.maximum(level[some] - step, 0)[sample]
        regions = Regions(balls, at_step, at_step, noise, SIGMAS * noise)
        misfit[step] = project_on_cells(r[window], regions, parameters, 2, mine).misfit[centre]
    around = _nearest(r[at[some]], r[at], TRIED // 4)
    least = np.median(misfit[STEPS][around[some]], axis=1)
    points = MOST * STEP ** (-2.0 * np.arange(STEPS + 1))[:, None]
    fits = misfit <= least * (1.0 + WORSE) + DEVIATIONS * np.sqrt(2.0 / points)
    fits[STEPS] = True
    down: I64 = np.median(np.argmax(fits, axis=0)[around], axis=1).astype(np.int64)
    noisier: Bool = np.median(misfit[STEPS][around], axis=1) > NOISIER * np.median(misfit[STEPS])
    return down, noisier
