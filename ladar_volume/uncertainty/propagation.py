"""From a gradient per surface point to a variance per source (UNCERTAINTY steps 3 and 4).

A point is ``centre + u tangent + v binormal + (x·beta) normal`` of its patch, so a result with
gradients ``g_i`` has the load ``q_patch = Σ_i (g_i · normal) x_i`` on the patch's parameters.
Patches share raw points: the stored blocks C_ab carry that. What all returns of a patch share moves
its points along the surface too, where the result has the loads ``Σ_i g_i · tangent`` and ``Σ_i g_i
· binormal``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ladar_volume.georeference.error_budget import calibration_columns
from ladar_volume.math.large_arrays import in_its_room, large_zeros, taken
from ladar_volume.model.choices import CALIBRATION_GROUPS
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64, I32, I64, FilteredPoints, PatchTable
from ladar_volume.uncertainty.load_kernels import (
    calibration_kernel,
    cross_kernel,
    load_kernel,
    navigation_kernel,
    neighbour_rows,
    quadratic_kernel,
)
from ladar_volume.uncertainty.packing import calibration_parts, factor_loads, navigation_units

#: Longest survey, in time bins, whose bins are looked up in a table.
LONGEST = 1 << 22
#: Sensitivities that are numbered at a time.
AT_ONCE = 1 << 20


@dataclass(frozen=True)
class SurfaceGeometry:
    """What every result on one filtered surface shares.

    row : (n,) index of each point's patch · local : (n, 2) m, its tangent coordinates there ·
    parameters : of a patch, p · start : (m + 1,) first block of each patch · right : (k,) the other
    patch of each block, -1 where it is not in the store (such blocks count as zero)
    """

    row: I64
    local: F64
    parameters: int
    start: I64
    right: I32

    def design(self, points: I64) -> F64:
        """Design rows (..., p) of points (...,)."""
        return design_rows(taken(self.local, points), self.parameters)

    @property
    def block_rows(self) -> I64:
        """Patch (k,) that each block is stored with."""
        return np.repeat(np.arange(len(self.start) - 1), np.diff(self.start))


def design_rows(local: F64, p: int) -> F64:
    """Rows ``(1, u, v[, u², uv, v²])`` (..., p) of tangent coordinates (..., 2), m."""
    out: F64 = large_zeros((*local.shape[:-1], p))
    out[..., 0] = 1.0
    out[..., 1:3] = local
    for k, (a, b) in enumerate(((0, 0), (0, 1), (1, 1))[: p - 3], start=3):
        np.multiply(local[..., a], local[..., b], out=out[..., k])
    return out


def surface_geometry(points: FilteredPoints, patches: PatchTable) -> SurfaceGeometry:
    """Index the points and cross blocks of patches sorted by key. Raises :class:`VolumeError`
    (volume_patches) for patches of neither 3 nor 6 parameters, and for sensitivities that are not
    those of the parameters and two tangents.
    """
    p = patches.beta.shape[1]
    if p not in (3, 6):
        raise VolumeError(
            f"patches have 3 or 6 parameters, not {p}", reason="volume_patches", value=p
        )
    for M in (patches.M_cal, patches.M_nav):
        if M.shape[1] != p + 2:
            raise VolumeError(
                f"patches of {p} parameters with sensitivities in {M.shape[1]} rows, not {p + 2}",
                reason="volume_patches",
            )
    row = in_its_room(np.searchsorted(patches.key, points.patch))
    right = neighbour_rows(patches.key, patches.cross_start, patches.cross_key)
    return SurfaceGeometry(row, points.local, p, patches.cross_start, right)


def patch_loads(gradient: F64, patches: PatchTable, geometry: SurfaceGeometry) -> F64:
    """Loads q (m, p + 2, k) of k results with gradients (n, k, 3): on the patch parameters, then on
    the patch's place along its tangent and binormal.
    """
    q: F64 = large_zeros((len(patches), geometry.parameters + 2, gradient.shape[1]))
    load_kernel(gradient, patches.normal, patches.tangent, geometry.local, geometry.row, q)
    return q


def independent_covariance(q: F64, patches: PatchTable, geometry: SurfaceGeometry) -> F64:
    """Covariance (k, k) of k results from the independent noise of the returns: ``Σ_ab q_aᵀ C_ab
    q_b`` over all pairs of patches, with the loads on their parameters.
    """
    k = q.shape[2]
    q = factor_loads(q, patches, k + -k % 4)
    half = np.empty((q.shape[2], q.shape[2]))
    for j in range(0, k, 4):
        four = np.ascontiguousarray(q[:, :, j : j + 4])
        half[:, j : j + 4] = cross_kernel(
            q, four, patches.cross_start, geometry.right, patches.cross
        )
    out: F64 = 0.5 * (half + half.T)[:k, :k]  # the transposed pairs
    return out


def tangential_variance(gradient: F64, points: FilteredPoints) -> float:
    """``Σ g_tᵀ C_tangent g_t`` of a gradient (n, 3): noise of the points within their surface."""
    return float(quadratic_kernel(gradient, points.C_tangent))


def calibration_groups(columns: int) -> dict[str, I64]:
    """Indices of each group's columns among ``columns`` = 11 + 2 beams."""
    names = calibration_columns((columns - 11) // 2)
    groups = {
        g: np.array(
            [i for i, n in enumerate(names) if n == g or n.rsplit("_", 1)[0] == g], np.int64
        )
        for g in CALIBRATION_GROUPS
    }
    if sum(len(g) for g in groups.values()) != columns:
        raise VolumeError(
            f"{columns} calibration columns cannot be grouped",
            reason="volume_calibration",
            value=columns,
        )
    return groups


def calibration_variance(J: F64, C_cal: F64) -> dict[str, float]:
    """Variance by group of a sensitivity J (c,); one line ``calibration`` where C_cal (c, c)
    correlates groups.
    """
    if J.shape[0] != C_cal.shape[0]:
        raise VolumeError(
            f"patches have {J.shape[0]} calibration columns, the budget {C_cal.shape[0]}",
            reason="volume_calibration",
        )
    groups = calibration_groups(len(J))
    label = np.empty(len(J), np.int64)
    for number, index in enumerate(groups.values()):
        label[index] = number
    if (C_cal[label[:, None] != label[None]] != 0).any():
        return {"calibration": float(J @ C_cal @ J)}
    return calibration_marginals(J, C_cal)


def calibration_marginals(J: F64, C_cal: F64) -> dict[str, float]:
    """Variance of each group by itself, of a sensitivity J (c,): within a correlated block they do
    not add up to its variance.
    """
    groups = calibration_groups(len(J))
    return {name: float(J[i] @ C_cal[np.ix_(i, i)] @ J[i]) for name, i in groups.items()}


def calibration_sensitivity(q: F64, patches: PatchTable) -> F64:
    """``J_cal = Σ_patches qᵀ M_cal`` (c,) of loads q (m, p + 2)."""
    return np.asarray(calibration_kernel(q, *calibration_parts(patches)))


def navigation_sensitivity(
    q: F64, patches: PatchTable, listed: tuple[I64, I32] | None = None
) -> tuple[F64, I64]:
    """Sensitivities ``J_e = Σ_patches qᵀ M_nav[e]`` (b, 6) to position and attitude, and their
    ascending bins (b,) of loads q (m, p + 2).

    listed : :func:`time_bins`, where known.
    """
    bins, index = time_bins(patches) if listed is None else listed
    J = navigation_kernel(
        q,
        patches.nav_start,
        index,
        patches.M_nav,
        navigation_units(patches),
        patches.normal,
        patches.tangent,
        len(bins),
    )
    used = np.flatnonzero(J.any(axis=1))
    return J[used], bins[used]


def time_bins(patches: PatchTable) -> tuple[I64, I32]:
    """Bins (b,) of all navigation sensitivities, ascending, and the row (l,) of each sensitivity's
    own among them.
    """
    low = int(patches.nav_bin.min()) if len(patches.nav_bin) else 0
    if (
        len(patches.nav_bin) and int(patches.nav_bin.max()) - low > LONGEST
    ):  # a table of all between would be larger than the data
        bins = np.unique(patches.nav_bin)
        return bins, np.searchsorted(bins, patches.nav_bin).astype(np.int32)
    count = int(patches.nav_bin.max()) - low + 1 if len(patches.nav_bin) else 0
    seen, index = np.zeros(count, np.bool_), large_zeros(patches.nav_bin.shape, np.int32)
    parts = [slice(at, at + AT_ONCE) for at in range(0, len(index), AT_ONCE)]
    for part in parts:
        seen[patches.nav_bin[part] - low] = True
    number = (np.cumsum(seen) - 1).astype(np.int32)
    for part in parts:
        index[part] = number[patches.nav_bin[part] - low]
    return np.flatnonzero(seen) + low, index
