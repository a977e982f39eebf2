"""What lies on no surface: too sparse for one, and kept as it is; leaves and branches; outliers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.clouds.filter import cell_surface
from ladar_volume.clouds.filter.cell_cover import Covered
from ladar_volume.clouds.filter.filter_result import REASONS
from ladar_volume.clouds.filter.self_tuning import Tuned
from ladar_volume.clouds.sampling.isolation import belonging, spacing
from ladar_volume.model.records import F64, Bool

CLUTTER = REASONS.index("clutter")
#: Points of a line that tell its direction.
LINE = 8
#: The spacing of points too few for a surface over that of the points next to them: from ring to
#: ring it may jump; and of those beside a surface among themselves.
JUMP, BESIDE = 4.0, 2.0
#: Quantile of the noise on surfaces that a point on none may have: surfaces that face the scanner
#: show all of it.
FACING = 0.9


@dataclass(frozen=True)
class Sparse:
    """stays : (n,) which points are kept as they are · normal : (n, 3) theirs · sigma_m : noise of
    each · reach_m : radius of a fit that holds none but the point itself
    """

    stays: Bool
    normal: F64
    sigma_m: float
    reach_m: float


def name_the_rest(r: F64, done: Covered, tuned: Tuned, auto: bool, keep: frozenset[str]) -> Sparse:
    """Tells apart what lies on no surface, in ``done.reason``; points (n, 3) m."""
    reason, n = done.reason, len(r)
    stays = np.zeros(n, np.bool_)
    kept = reason == cell_surface.KEPT
    if auto and not tuned.told:
        own = spacing(r, r)
        reason[kept] = cell_surface.FEW_POINTS
        kept = own <= np.median(own)
        stays = kept | belonging(r, kept, own, ~kept, JUMP)
    elif auto and kept.any():
        stays = _beside(r, done, tuned)
        if tuned.lines is not None:
            stays |= _sparse(r, done, tuned)
    leaves = ~stays & (reason == cell_surface.NO_SURFACE)
    if tuned.lines is not None:
        reason[leaves & np.isfinite(tuned.lines.reach_m)] = CLUTTER
        if "clutter" in keep:
            stays |= reason == CLUTTER
    normal = np.zeros((n, 3))
    if stays.any():
        normal[stays] = _normals(r, stays)
    sigma = tuned.regions.sigma_m[kept if kept.any() else slice(None)]
    return Sparse(
        stays, normal, float(np.quantile(sigma, FACING)), 1e-3 * float(tuned.regions.ball_m[0])
    )


def _sparse(r: F64, done: Covered, tuned: Tuned) -> Bool:
    """Which points (n,) belong to the survey though they lie on no surface."""
    reason = done.reason
    kept = reason == cell_surface.KEPT
    off = reason == cell_surface.OUTLIER
    assert tuned.lines is not None
    open_ = (reason == cell_surface.NO_SURFACE) & np.isfinite(tuned.lines.reach_m)
    thin = ~kept & ~off & ~open_
    own = spacing(r, r)
    stays = belonging(r, kept, own, thin, JUMP)
    # beside a surface all are near it: what belongs to something else has others like it about
    alone = np.flatnonzero(~kept)
    if off.any() and len(alone) > LINE:
        among = own.copy()
        among[alone] = spacing(r[alone], r[alone])
        stays |= belonging(r, kept | stays, among, off, BESIDE)
    return stays


def _beside(r: F64, done: Covered, tuned: Tuned) -> Bool:
    """Which points (n,) whose cells found no surface lie on that of the points next to them."""
    kept = np.flatnonzero(done.reason == cell_surface.KEPT)
    open_ = np.flatnonzero(done.reason == cell_surface.NO_SURFACE)
    out = np.zeros(len(r), np.bool_)
    if len(open_):
        k = min(LINE, len(kept))
        tree = cKDTree(r[kept], balanced_tree=False)
        distance, near = tree.query(r[open_], k=k, workers=-1)
        near, distance = kept[np.reshape(near, (-1, k))], np.reshape(distance, (-1, k))
        off = np.abs(np.einsum("ski,ski->sk", r[open_, None] - done.q[near], done.normal[near]))
        reach = tuned.regions.ball_m[done.level[near]]
        fits = (off <= tuned.regions.threshold_m[near]) & (distance <= reach)
        out[open_] = fits.any(axis=1)
    return out


def _normals(r: F64, which: Bool) -> F64:
    """Normals (m, 3) of points that lie on lines: across their neighbours."""
    k = min(LINE, len(r))
    near = cKDTree(r, balanced_tree=False).query(r[which], k=k, workers=-1)[1].reshape(-1, k)
    x = r[near] - r[near].mean(axis=1, keepdims=True)
    return np.asarray(np.linalg.eigh(np.einsum("ski,skj->sij", x, x))[1][:, :, 0])
