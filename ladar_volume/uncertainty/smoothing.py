"""What the fits of the filter smooth away, and what that does to a result (UNCERTAINTY step 2).

Each patch is fitted to its voxel and the surroundings, and rounds off what bends within them. The
returns of the voxel itself lie off it by their mean residual, ``own_residual``: a result is
corrected by moving all patches there (twicing: Tukey, *Exploratory Data Analysis*, 1977, ch. 16).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ladar_volume.math.kernels import kernel
from ladar_volume.model.records import F32, F64, I64, PatchTable

#: Standard deviation of what is left of the smoothing, over what is found: of the rounded toe of
#: simulated piles three quarters are.
LEFT = 1.0 / 3.0
#: Points that are added up at once.
PART = 1024


@dataclass(frozen=True)
class Smoothing:
    """shift_m3 : what a result is too large by · variance_m6 : of that"""

    shift_m3: float
    variance_m6: float


def own_shift(gradient: F64, patches: PatchTable, row: I64) -> float:
    """What a result with gradients (n, 3) gains where the returns lie off the patches ``row`` (n,)
    of its points, and these are moved there. The normals count as they are sent, in 32 bits, so
    that a volume is the same on either side of the wire.
    """
    if not len(patches.own_residual):
        return 0.0
    normal = patches.normal.astype(np.float32)
    return float(shift_kernel(gradient, normal, patches.own_residual, row))


@kernel
def shift_kernel(gradient: F64, normal: F32, residual: F32, row: I64) -> float:
    """See :func:`own_shift`: normal (m, 3), residual (m,) m of the patches. The sum of each
    :data:`PART` points is added as one, which keeps its digits.
    """
    total = part = 0.0
    for i in range(len(gradient)):
        n = normal[row[i]]
        along = gradient[i, 0] * n[0] + gradient[i, 1] * n[1] + gradient[i, 2] * n[2]
        part += along * residual[row[i]]
        if i % PART == PART - 1:
            total, part = total + part, 0.0
    return total + part


def smoothing_of(gradient: F64, q: F64, patches: PatchTable, row: I64) -> Smoothing:
    """Of a result with gradients (n, 3) by the points of patches ``row`` (n,) and loads q
    (m, p + 2) on the patches.

    The residuals of a patch's fit are not correlated with it, and those of neighbours cancel where
    nothing is smoothed away, so that the squares of all single contributions are more than the
    noise of their sum.
    """
    if not len(patches.own_residual):
        return Smoothing(0.0, 0.0)
    shift = -own_shift(gradient, patches, row)
    by_patch = q[:, 0] * patches.own_residual
    return Smoothing(shift, float(by_patch @ by_patch) + (LEFT * shift) ** 2)


def cut_shift(cut_m3: float, fill_m3: float, found_m3: float, net_m3: float) -> float:
    """What cut is too large by, m³: as ``found_m3``, no more than leaves cut and fill at 0 or more,
    where their difference is too large by ``net_m3``.
    """
    return min(found_m3, cut_m3, fill_m3 + net_m3)
