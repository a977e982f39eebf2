"""What lies on no surface: too sparse for one, and kept as it is; leaves and branches; outliers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.clouds.filter import cell_surface
from ladar_volume.clouds.filter.cell_cover import Projection
from ladar_volume.clouds.filter.filter_result import REASONS
from ladar_volume.clouds.filter.self_tuning import Tuning
from ladar_volume.clouds.sampling.isolation import connected_to_known, second_neighbour_distance
from ladar_volume.model.records import F64, Bool

CLUTTER = REASONS.index("clutter")
#: Points of a line that tell its direction.
LINE = 8
#: The spacing of points too few for a surface over that of the points next to them: from ring to
#: ring it may jump; and of those beside a surface among themselves.
JUMP, BESIDE = 4.0, 2.0
#: Points of a patch, and terms of its quadric; it is a sheet where they scatter about that by so
#: many times their noise at most, and a point lies on one where this share of its neighbours do.
#: Leaves fill their neighbourhood.
PATCH, TERMS, THICK, SHEETS = 24, 6, 3.0, 0.75
#: Quantile of the noise on surfaces that a point on none may have: surfaces that face the scanner
#: show all of it. Noise of angles grows with the range, and so with the spacing: the noise over the
#: spacing that surfaces of wide spacing, from that quantile on, show in the middle of them.
FACING, WIDELY = 0.9, 0.75


@dataclass(frozen=True)
class Sparse:
    """stays : (n,) which points are kept as they are · normal : (n, 3) theirs · sigma_m : (n,)
    noise of each · reach_m : radius of a fit that holds none but the point itself
    """

    stays: Bool
    normal: F64
    sigma_m: F64
    reach_m: float


def classify_off_surface(
    r: F64, projection: Projection, tuned: Tuning, auto: bool, keep: frozenset[str]
) -> Sparse:
    """Tells apart what lies on no surface, in ``done.reason``; points (n, 3) m."""
    reason, n = projection.reason, len(r)
    stays = np.zeros(n, np.bool_)
    kept = reason == cell_surface.KEPT
    if auto and not tuned.noise_known:
        own = second_neighbour_distance(r)
        reason[kept] = cell_surface.FEW_POINTS
        kept = own <= np.median(own)
        stays = kept | connected_to_known(r, kept, own, ~kept, JUMP)
    elif auto and kept.any():
        stays = _on_neighbour_surface(r, projection, tuned)
        if tuned.lines is not None:
            stays |= _sparse_survey_points(r, projection, tuned)
            stays |= kept & tuned.lines.remote  # a surface of few lines hides their noise
    leaves = ~stays & (reason == cell_surface.NO_SURFACE)
    if tuned.lines is not None:
        leaves &= np.isfinite(tuned.lines.reach_m)
        bent = auto & _on_sheet(r, leaves, tuned.regions.sigma_m)
        reason[bent] = cell_surface.FEW_POINTS
        stays |= bent
        reason[leaves & ~bent] = CLUTTER
        if "clutter" in keep:
            stays |= reason == CLUTTER
    normal = np.zeros((n, 3))
    if stays.any():
        normal[stays] = _normals(r, stays)
    sigma = _sigma(r, kept & ~stays, stays, tuned)
    return Sparse(stays, normal, sigma, 1e-3 * float(tuned.regions.ball_m[0]))


def _sigma(r: F64, kept: Bool, stays: Bool, tuned: Tuning) -> F64:
    """Noise (n,) m of points as they came: that of surfaces that face the scanner, and where they
    are told to err in angle, as much more as the spacing is wider.
    """
    known = tuned.regions.sigma_m[kept if kept.any() else slice(None)]
    sigma = np.full(len(r), float(np.quantile(known, FACING)))
    if kept.any() and stays.any() and tuned.noise_known:
        own = second_neighbour_distance(r)
        wide = kept & (own >= np.quantile(own[kept], WIDELY)) & (own > 0.0)
        if wide.any():
            grows = float(np.median(tuned.regions.sigma_m[wide] / own[wide]))
            sigma[stays] = np.maximum(sigma[stays], grows * own[stays])
    return sigma


def _sparse_survey_points(r: F64, projection: Projection, tuned: Tuning) -> Bool:
    """Which points (n,) belong to the survey though they lie on no surface."""
    reason = projection.reason
    kept = reason == cell_surface.KEPT
    off = reason == cell_surface.OUTLIER
    assert tuned.lines is not None
    open_ = (reason == cell_surface.NO_SURFACE) & np.isfinite(tuned.lines.reach_m)
    thin = ~kept & ~off & ~open_
    own = second_neighbour_distance(r)
    stays = connected_to_known(r, kept, own, thin, JUMP)
    # beside a surface all are near it: what belongs to something else has others like it about
    alone = np.flatnonzero(~kept)
    if off.any() and len(alone) > LINE:
        among = own.copy()
        among[alone] = second_neighbour_distance(r[alone])
        stays |= connected_to_known(r, kept | stays, among, off, BESIDE)
    return stays


def _on_neighbour_surface(r: F64, projection: Projection, tuned: Tuning) -> Bool:
    """Which points (n,) whose cells found no surface lie on that of the points next to them."""
    kept = np.flatnonzero(projection.reason == cell_surface.KEPT)
    open_ = np.flatnonzero(projection.reason == cell_surface.NO_SURFACE)
    out = np.zeros(len(r), np.bool_)
    if len(open_):
        k = min(LINE, len(kept))
        tree = cKDTree(r[kept], balanced_tree=False)
        distance, near = tree.query(r[open_], k=k, workers=-1)
        near, distance = kept[np.reshape(near, (-1, k))], np.reshape(distance, (-1, k))
        off = np.abs(
            np.einsum("ski,ski->sk", r[open_, None] - projection.q[near], projection.normal[near])
        )
        reach = tuned.regions.ball_m[projection.level[near]]
        fits = (off <= tuned.regions.threshold_m[near]) & (distance <= reach)
        out[open_] = fits.any(axis=1)
    return out


def _on_sheet(r: F64, open_: Bool, noise_m: F64) -> Bool:
    """Which of the points ``open_`` (n,), of r (n, 3) m with noise (n,) m, lie on a smooth sheet
    that bends by more over the distance at which lines come together, as a ball of few columns.
    """
    rows, out = np.flatnonzero(open_), np.zeros(len(r), np.bool_)
    if len(rows) <= PATCH:
        return out
    found = cKDTree(r[rows], balanced_tree=False).query(r[rows], k=PATCH, workers=-1)
    distance, near = np.asarray(found[0], np.float64), np.asarray(found[1], np.int64)
    left = _bent_residuals(r[rows][near])
    thick = np.sqrt(np.sum(left**2, axis=1) / (PATCH - TERMS))
    noise = THICK * noise_m[rows]
    sheet = (thick <= noise) & (np.abs(left[:, 0]) <= noise)
    among = distance[:, 2] <= BESIDE * np.median(distance[near, 2], axis=1)
    out[rows] = among & sheet & (sheet[near[:, : PATCH // 2]].mean(axis=1) >= SHEETS)
    return out


def _bent_residuals(points: F64) -> F64:
    """Residuals (s, k) m of patches of points (s, k, 3) m about a quadric of each."""
    values, axes = _patch_axes(points)
    x = np.einsum("ski,sij->skj", points - points.mean(axis=1, keepdims=True), axes)
    size = np.sqrt(np.maximum(values[:, 2], 1e-300))[:, None]
    u, v, w = x[:, :, 2] / size, x[:, :, 1] / size, x[:, :, 0]
    terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=2)
    normal = np.einsum("ski,skj->sij", terms, terms) + 1e-9 * np.eye(TERMS)
    right = np.einsum("ski,sk->si", terms, w)
    beta = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    return np.asarray(w - np.einsum("ski,si->sk", terms, beta))


def _normals(r: F64, which: Bool) -> F64:
    """Normals (m, 3) of points that lie on lines: across their neighbours."""
    k = min(LINE, len(r))
    near = cKDTree(r, balanced_tree=False).query(r[which], k=k, workers=-1)[1].reshape(-1, k)
    return _patch_axes(r[near])[1][:, :, 0]


def _patch_axes(points: F64) -> tuple[F64, F64]:
    """Mean squares (s, 3) m² along the own axes (s, 3, 3) of patches of points (s, k, 3) m, the
    thinnest first.
    """
    x = points - points.mean(axis=1, keepdims=True)
    values, axes = np.linalg.eigh(np.einsum("ski,skj->sij", x, x) / points.shape[1])
    return np.maximum(values, 0.0), np.asarray(axes)
