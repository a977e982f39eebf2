"""Parameters that set themselves where a cloud was sampled along lines: noise and radii from
neighbourhoods across several lines (:mod:`~ladar_volume.clouds.sampling.sampling_lines`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.clouds.filter.cell_cover import Projection, Regions
from ladar_volume.clouds.sampling.sampling_lines import OVER, Lines
from ladar_volume.clouds.sampling.trimmed_noise import trimmed_noise
from ladar_volume.model.records import F64, I64, Bool

#: Neighbourhoods over the distance at which lines come together: that which tells noise, that of
#: the fits, and the least of a fit.
TELLS, FITS, LEAST = 2.3, 3.0, 1.6
#: The same over the noise.
THICK, FITS_THICK, LEAST_THICK = 6.0, 7.0, 5.0
#: A neighbourhood that tells noise is thinned to voxels of its radius over this, and to so many.
FINE, POINTS = 12.0, 250
#: Fewest points of such a neighbourhood.
FEWEST = 20
#: A plane's points are a line where they are less wide than this share of the radius.
ACROSS = 0.1
#: Neighbouring radii differ by this factor.
STEP = float(np.sqrt(2.0))
#: Noise is the median of so many samples' values.
SMOOTH = 5
#: Noise of a place lies within these shares of the cloud's; above it it is leaves and branches.
QUIET, CLUTTER = 0.05, 5.0
#: Residuals that tell the noise of a place lie within so many sigma; what their squares miss, and
#: how often that is settled. Real lines have tails, which a closer cut would hide.
CUT, MISSED, ROUNDS = 3.5, 0.9939, 3
#: They are sought from this share of the noise believed on.
FROM = 0.8


@dataclass(frozen=True)
class NoiseSites:
    """Where noise is told: at : (s,) points · near : (s, k) points around each, evenly thinned, −1
    where there are fewer · of : (n, SMOOTH) places next to each point
    """

    at: I64
    near: I64
    of: I64


def noise_sites(r: F64, at: I64, lines: Lines, reach_m: F64) -> NoiseSites:
    """Neighbourhoods within ``reach_m`` (s,) of the points ``at`` (s,), thinned across their
    lines.
    """
    near = np.full((len(at), POINTS), -1)
    level = np.array([lines.level_near(float(reach) / FINE) for reach in reach_m])
    for i in np.unique(level):
        thinned, own = lines.levels[i], np.flatnonzero(level == i)
        k = min(POINTS, len(thinned.first))
        distance, index = thinned.tree.query(r[at[own]], k=k)
        distance, index = distance.reshape(len(own), k), index.reshape(len(own), k)
        inside = distance <= reach_m[own, None]
        near[own, :k] = np.where(inside, thinned.first[np.where(inside, index, 0)], -1)
    full = (near >= 0).sum(axis=1) >= FEWEST
    at, near = at[full], near[full]
    if not len(at):
        return NoiseSites(at, near, np.zeros((len(r), 0), np.int64))
    of = cKDTree(r[at]).query(r, k=min(SMOOTH, len(at)), workers=-1)[1]
    return NoiseSites(at, near, np.asarray(of, np.int64).reshape(len(r), -1))


def first_noise(r: F64, spread_r: F64, at: I64, lines: Lines) -> tuple[F64, NoiseSites] | None:
    """Noise (n,) m, from trimmed fits across lines, and the places that tell it; None where no
    place does.

    spread_r : (n, 3), the points spread evenly over the steps to which they were rounded.
    """
    at = at[np.isfinite(lines.reach_m[at])]
    whole, where, each = 0.0, None, np.empty(0)
    for _ in range(2):
        where = noise_sites(r, at, lines, np.maximum(TELLS * lines.reach_m[at], THICK * whole))
        if not len(where.at):
            return None
        each = trimmed_noise(spread_r, where.near)
        if not np.isfinite(each).any():
            return None
        whole = float(np.nanmedian(each))
    assert where is not None
    return point_noise(each, where, whole), where


def point_noise(each: F64, sites: NoiseSites, whole: float) -> F64:
    """Noise (n,) m of points from that of places (s,): the median of those next to it that are
    surfaces, and the cloud's where none is.
    """
    near = np.where(each < CLUTTER * whole, each, np.nan)[sites.of]
    near[~np.isfinite(near).any(axis=1)] = whole
    return np.asarray(np.maximum(np.nanmedian(near, axis=1), QUIET * whole))


def line_regions(r: F64, lines: Lines, sigma: F64, threshold: F64) -> Regions:
    """Radii of the fits: several lines, and clearly wider than the noise. Points that see no
    surface get the widest.
    """
    known = np.isfinite(lines.reach_m)
    widest = lines.reach_m[known].max() if known.any() else OVER * lines.levels[-1].edge_m
    reach = np.where(known, lines.reach_m, widest)
    wide = np.maximum(FITS * reach, FITS_THICK * sigma)
    narrow = np.minimum(np.maximum(LEAST * reach, LEAST_THICK * sigma), wide)
    low = float(narrow.min())
    level = np.rint(np.log(wide / low) / np.log(STEP)).astype(np.int64)
    least = np.minimum(np.ceil(np.log(narrow / low) / np.log(STEP)).astype(np.int64), level)
    balls = low * STEP ** np.arange(level.max() + 1)
    return Regions(balls, level, least, sigma, threshold, ACROSS)


def surface_noise(distance: F64, share: F64, found: Bool, sigma: F64, sites: NoiseSites) -> F64:
    """Noise (s,) m of places from residuals about surfaces.

    distance : (n,) m, of points from their surfaces · share : (n,) variance of the surface there
    over that of the noise · found : (n,) whether there is one · sigma : (n,) m, noise believed.
    """
    inside = (sites.near >= 0) & found[sites.near]
    d = np.where(
        inside, distance[sites.near] / np.sqrt(1.0 - np.minimum(share, 0.5))[sites.near], np.nan
    )
    enough = inside.sum(axis=1) >= FEWEST
    d[~enough] = 0.0
    each = np.maximum(1.4826 * np.nanmedian(d, axis=1), FROM * sigma[sites.at])
    for _ in range(ROUNDS):
        cut = np.where(d <= CUT * each[:, None], d, np.nan)
        each = np.sqrt(np.nanmean(cut**2, axis=1) / MISSED)
        each = np.where(np.isfinite(each), each, 0.0)
    return np.asarray(np.where(enough, each, np.nan))


def residuals(r: F64, projection: Projection, kept: int, outlier: int) -> tuple[F64, Bool]:
    """Distances (n,) m of points from their surfaces, and which (n,) have one."""
    found = (projection.reason == kept) | (projection.reason == outlier)
    return np.linalg.norm(projection.q - r, axis=1), found
