"""From a gradient per surface point to a variance per source (UNCERTAINTY steps 3 and 4).

A point is ``centre + u tangent + v binormal + (x·beta) normal`` of its patch, so a result with gradients ``g_i`` has the load
``q_patch = Σ_i (g_i · normal) x_i`` on the patch's parameters. Patches share raw points: the stored blocks C_ab carry that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ladar_volume.georeference.budget import calibration_columns
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64, I64, Bool, FilteredPoints, Patches

#: Lines of the budget from the calibration, in order.
CALIBRATION_GROUPS = ("range_bias", "beam_range", "beam_vertical", "boresight", "lever_laser", "lever_antenna", "clock")


@dataclass(frozen=True)
class SurfaceGeometry:
    """What every result on one filtered surface shares.

    row : (n,) index of each point's patch · X : (n, p) design rows · weight : (k,) 1 for a patch's own block, 2 for a cross
    block · left, right : (k,) patches of the stored blocks · missing : cross blocks whose neighbour is not in the store (they
    count as zero)
    """

    row: I64
    X: F64
    left: I64
    right: I64
    weight: F64
    missing: int


def design_rows(local: F64, p: int) -> F64:
    """Rows ``(1, u, v[, u², uv, v²])`` (n, p) of tangent coordinates (n, 2), m."""
    u, v = local[:, 0], local[:, 1]
    columns = [np.ones(len(u)), u, v, u * u, u * v, v * v]
    if p not in (3, 6):
        raise VolumeError(f"patches have 3 or 6 parameters, not {p}", reason="volume_patches", value=p)
    return np.stack(columns[:p], axis=1)


def surface_geometry(points: FilteredPoints, patches: Patches) -> SurfaceGeometry:
    """Index the points and cross blocks of patches sorted by key."""
    row = np.searchsorted(patches.key, points.patch)
    left = np.repeat(np.arange(len(patches)), np.diff(patches.cross_start))
    right = np.minimum(np.searchsorted(patches.key, patches.cross_key), len(patches) - 1)
    known = patches.key[right] == patches.cross_key
    weight = np.where(known, np.where(left == right, 1.0, 2.0), 0.0)
    X = design_rows(points.local, patches.beta.shape[1])
    return SurfaceGeometry(row, X, left, right, weight, int(np.count_nonzero(~known)))


def patch_loads(gradient: F64, patches: Patches, geometry: SurfaceGeometry) -> F64:
    """Loads q (m, p, k) of k results with gradients (n, k, 3) on the patch parameters."""
    along = np.einsum("nkc,nc->nk", gradient, patches.normal[geometry.row])
    p, results = geometry.X.shape[1], along.shape[1]
    out = np.empty((len(patches), p, results))
    for a in range(p):
        for k in range(results):
            out[:, a, k] = np.bincount(geometry.row, geometry.X[:, a] * along[:, k], len(patches))
    return out


def independent_covariance(q: F64, patches: Patches, geometry: SurfaceGeometry) -> F64:
    """Covariance (k, k) of k results from the independent noise of the returns: ``Σ_ab q_aᵀ C_ab q_b`` over all pairs of patches."""
    loaded: Bool = np.any(q.reshape(len(q), -1) != 0, axis=1)
    active = np.flatnonzero((geometry.weight > 0) & loaded[geometry.left] & loaded[geometry.right])
    left, right = q[geometry.left[active]], q[geometry.right[active]]
    half = np.einsum("npa,npq,nqb,n->ab", left, patches.cross[active], right, geometry.weight[active], optimize=True)
    out: F64 = 0.5 * (half + half.T)  # the transposed pairs
    return out


def unpack(packed: F64) -> F64:
    """Packed symmetric (n, 6) -> (n, 3, 3)."""
    out: F64 = packed[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
    return out


def tangential_variance(gradient: F64, points: FilteredPoints) -> float:
    """``Σ g_tᵀ C_tangent g_t`` of a gradient (n, 3): noise of the points within their surface."""
    C = unpack(points.C_tangent.astype(np.float64))
    return float(np.einsum("ni,nij,nj->", gradient, C, gradient, optimize=True))


def calibration_groups(columns: int) -> dict[str, I64]:
    """Indices of each group's columns among ``columns`` = 11 + 2 beams."""
    names = calibration_columns((columns - 11) // 2)
    groups = {g: np.array([i for i, n in enumerate(names) if n == g or n.rsplit("_", 1)[0] == g], np.int64) for g in CALIBRATION_GROUPS}
    if sum(len(g) for g in groups.values()) != columns:
        raise VolumeError(f"{columns} calibration columns cannot be grouped", reason="volume_calibration", value=columns)
    return groups


def calibration_variance(J: F64, C_cal: F64) -> dict[str, float]:
    """Variance by group of a sensitivity J (c,); one line ``calibration`` where C_cal (c, c) correlates groups."""
    if J.shape[0] != C_cal.shape[0]:
        raise VolumeError(f"patches have {J.shape[0]} calibration columns, the budget {C_cal.shape[0]}", reason="volume_calibration")
    groups = calibration_groups(len(J))
    label = np.empty(len(J), np.int64)
    for number, index in enumerate(groups.values()):
        label[index] = number
    if (C_cal[label[:, None] != label[None]] != 0).any():
        return {"calibration": float(J @ C_cal @ J)}
    return calibration_marginals(J, C_cal)


def calibration_marginals(J: F64, C_cal: F64) -> dict[str, float]:
    """Variance of each group by itself, of a sensitivity J (c,): within a correlated block they do not add up to its variance."""
    groups = calibration_groups(len(J))
    return {name: float(J[i] @ C_cal[np.ix_(i, i)] @ J[i]) for name, i in groups.items()}


def calibration_sensitivity(q: F64, patches: Patches) -> F64:
    """``J_cal = Σ_patches qᵀ M_cal`` (c,) of loads q (m, p)."""
    out: F64 = np.einsum("mp,mpc->c", q, patches.M_cal, optimize=True)
    return out


def navigation_sensitivity(q: F64, patches: Patches) -> tuple[F64, I64]:
    """Sensitivities ``J_e = Σ_patches qᵀ M_nav[e]`` (b, 6) and their ascending bins (b,) of loads q (m, p)."""
    owner = np.repeat(np.arange(len(patches)), np.diff(patches.nav_start))
    loaded: Bool = np.any(q != 0, axis=1)
    used = np.flatnonzero(loaded[owner])
    rows = np.einsum("lp,lpc->lc", q[owner[used]], patches.M_nav[used])
    bins, index = np.unique(patches.nav_bin[used], return_inverse=True)
    return np.stack([np.bincount(index.ravel(), rows[:, c], len(bins)) for c in range(6)], axis=1), bins
