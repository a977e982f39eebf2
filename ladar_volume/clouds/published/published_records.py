"""What the kernels of the published filter share: its numbers, its working arrays, its outcome and
its threshold.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ladar_volume.math.array_types import F64, I8, I32, I64, U64
from ladar_volume.math.kernels import kernel

#: Most planes in a neighbourhood: the source omits four and more.
PLANES = 3
#: Entries of the tally: fits, fits with an edge, fits with a corner, trials, inliers, points in the
#: band, sum of squares, thresholds.
FITS, EDGES, CORNERS, TRIALS, INLIERS, IN_BAND, SQUARES, THRESHOLDS = range(8)


class Sampling(NamedTuple):
    """How a start surface is sampled. size : points of a sample · trials : most samples · ransac :
    by truncated squares beyond ``threshold``, m, else by the median · confidence : trials end once
    a sample without outliers was drawn with this probability
    """

    size: int
    trials: int
    ransac: bool
    threshold: float
    confidence: float


class PublishedRule(NamedTuple):
    """Numbers the kernels need; lengths in m. sigmas : threshold of an inlier in sigma, 0 for the
    fixed threshold ``floor`` · edge_ratio : ratio of outliers from which an edge is looked for ·
    min_share : share of a neighbourhood that lies on its surfaces · min_points : fewest points of a
    surface · iterations : most refits · snap : points beyond an edge are set onto it
    """

    radius: float
    degree: int
    sampling: Sampling
    sigmas: float
    floor: float
    edge_ratio: float
    min_share: float
    min_points: int
    iterations: int
    snap: bool
    seed: int


class Sampler(NamedTuple):
    """state : (1,) of the random numbers · permutation : (n,) indices that samples are drawn from ·
    distances : (n,) m, of the points from a surface
    """

    state: U64
    permutation: I64
    distances: F64


class Neighbourhood(NamedTuple):
    """Points of a neighbourhood about its middle, and working arrays, all with room for n points.
    slots : their rows in the cloud · x : (n, 3), xt : (3, n), m · pending : 1 for a point within
    the radius that is not projected yet · label : plane of each · free : those on no plane so far
    """

    slots: I64
    x: F64
    xt: F64
    pending: I8
    label: I64
    free: I64
    sampler: Sampler


class PlaneSet(NamedTuple):
    """Planes that share a neighbourhood, with room for k. plane : (k, 4) normal and offset · mean :
    (k, 3), inverse : (k, 3, 3), used : (k,) of the fit · side : (k, k) +1 or −1, the side of
    another plane on which more of a plane's points lie; 0 for no majority or no intersection to
    speak of
    """

    plane: F64
    mean: F64
    inverse: F64
    used: I64
    side: I64


class Voxels(NamedTuple):
    """Voxels of edge r that the points are sorted by. voxel : (n,) of each point · keys : (v,),
    table : their hash table · first : (v + 1,) first point of each
    """

    voxel: I64
    keys: I64
    table: I32
    first: I64


class Outcome(NamedTuple):
    """By point: r, normal : (n, 3), variance : (n,) m² along the normal, reason : (n,). tally :
    (8,) sums over the fits
    """

    r: F64
    normal: F64
    variance: F64
    reason: I64
    tally: F64


def neighbourhood(n: int) -> Neighbourhood:
    """Room for neighbourhoods of up to n points."""
    slots, label, free, permutation = (np.empty(n, np.int64) for _ in range(4))
    sampler = Sampler(np.empty(1, np.uint64), permutation, np.empty(n))
    return Neighbourhood(
        slots, np.empty((n, 3)), np.empty((3, n)), np.empty(n, np.int8), label, free, sampler
    )


@kernel
def plane_set(k: int) -> PlaneSet:
    """Room for k planes."""
    return PlaneSet(
        np.zeros((k, 4)),
        np.zeros((k, 3)),
        np.zeros((k, 3, 3)),
        np.zeros(k, np.int64),
        np.zeros((k, k), np.int64),
    )


@kernel
def inlier_threshold(sigma: float, rule: PublishedRule) -> float:
    """The inlier threshold, m; above the rounding of coordinates where there is no noise."""
    return max(rule.sigmas * sigma, rule.floor, 1e-7 * rule.radius)
