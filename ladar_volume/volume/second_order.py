"""Where the first order fails: the volume's second derivatives by the boresight angles (UNCERTAINTY step 9).

A boresight error is one rotation vector theta for the whole survey. A point seen at ``v`` (body frame, laser to target), normal
``m = Rᵀn``, moves by ``theta x v + ½ theta x (theta x v)``. The height along n at a fixed place changes by ``theta·(v x m)`` and, to second
order, by ``½ m·(theta x (theta x v)) − a·∇(theta·(v x m))``: what is found there was displaced by ``a``, the part of ``theta x v`` along
the surface, and brought its own first-order error with it. How that error changes along the surface is in the patch's slopes: over
ground straight below one standpoint the terms add up to ``−½ h theta²``, under a moving sensor to ``+½ h theta²`` for a turn about the
axis across the path. With the patches' loads they give ``½ thetaᵀ H theta`` for the volume.

For Gaussian theta the two orders are uncorrelated; the second has the mean ``½ tr(HC)`` and the variance ``½ tr(HCHC)``. The volume is
not corrected for that mean: the line of the budget is the mean square, both together. Curvature times
shift squared is left out: over a whole body it cancels but for the body's shear, and the sum of fitted curvatures at rim and toe would be
less true than nothing. On a round hill of 100 m³ straight below the path this makes the line's sigma 15 % too large.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ladar_volume.model.records import F64, I64, Patches
from ladar_volume.volume.navigation import NavigationBins

#: Columns of M_cal and C_cal that hold the boresight.
BORESIGHT = slice(1, 4)
#: The second order is said to matter from this share of the first order's variance on, or for a boresight sigma (rad) beyond this.
SHARE, SIGMA_RAD = 0.01, math.radians(0.1)
#: Walls count as no steeper than this vertical component of their normal.
STEEPEST = 0.2


@dataclass(frozen=True)
class SecondOrder:
    """Of a boresight error in the volume. shift_m3 : mean of the second-order term · variance_m6 : its variance · matters : whether it
    changes what the first order says, or the boresight is so uncertain that it may"""

    shift_m3: float
    variance_m6: float
    matters: bool

    @property
    def line_m6(self) -> float:
        """Mean square of the term: its line in the budget, m⁶."""
        return self.variance_m6 + self.shift_m3**2


def passes(owner: I64, bins: I64) -> I64:
    """Number (k,) of the pass each entry of a patch (owner (k,), ascending) and a time bin (k,) belongs to: bins without a gap are one."""
    new = (owner[1:] != owner[:-1]) | (bins[1:] > bins[:-1] + 1)
    return np.concatenate([[0], np.cumsum(new)]).astype(np.int64)


def pooled(label: I64, values: F64) -> F64:
    """Sums (groups, c) of rows (k, c) by label (k,)."""
    return np.stack([np.bincount(label, column) for column in values.T], axis=1)


def boresight_curvature(q: F64, patches: Patches, navigation: NavigationBins) -> F64:
    """H (3, 3), unit of the result per rad², of one result with loads q (m, p) on the patches' parameters.

    Each patch was seen from one or more time bins: v and m are taken from the mean pose in the bin, the bin's share of the patch from the
    patch's own sensitivities to the attitude, which turns the ray as the boresight does. The slope of the first-order error is that under a
    standing sensor, and over each pass what the patch's slopes say beyond it: there the sensor moves with the places it sees.
    """
    owner = np.repeat(np.arange(len(patches)), np.diff(patches.nav_start))
    used = np.flatnonzero(q[owner, 0] != 0.0)
    if not len(used):
        return np.zeros((3, 3))
    row = owner[used]
    M, n, load = patches.M_nav[used], patches.normal[row], q[row, 0]
    position, R = navigation.mean_pose(patches.nav_bin[used])
    part = np.einsum("kc,kc->k", M[:, 0, :3], n)
    share, label, weight = load * part, passes(row, patches.nav_bin[used]), np.abs(part) + 1e-12
    m, v = (np.einsum("kji,kj->ki", R, x) for x in (n, patches.centre[row] - position))
    upright = np.copysign(np.maximum(np.abs(n[:, 2]), STEEPEST), n[:, 2])
    half = 0.5 * np.einsum("k,ki,kj->ij", share, m, v)
    for number, along in enumerate((patches.tangent[row], np.cross(n, patches.tangent[row])), start=1):
        body = np.einsum("kji,kj->ki", R, along)
        # a place is one of the map's plane: what moved along the normal came from beside it
        shift = np.cross(v, body) - (along[:, 2] / upright)[:, None] * np.cross(v, m)
        standing = np.cross(body, m)
        moving = pooled(label, load[:, None] * (M[:, number, 3:] - part[:, None] * standing))
        mean = pooled(label, weight[:, None] * shift) / np.bincount(label, weight)[:, None]
        half -= np.einsum("k,ki,kj->ij", share, shift, standing) + mean.T @ moving
    out: F64 = half + half.T - float(share @ np.einsum("kc,kc->k", m, v)) * np.eye(3)
    return out


def second_order(H: F64, C: F64, first_m6: float) -> SecondOrder:
    """The second-order term of curvature H (3, 3) under a boresight covariance C (3, 3) rad², beside the first order's variance."""
    HC = H @ C
    shift, variance = 0.5 * float(np.trace(HC)), 0.5 * float(np.trace(HC @ HC))
    strong = variance + shift**2 > SHARE * first_m6
    return SecondOrder(shift, variance, bool(strong or np.sqrt(np.diag(C)).max() > SIGMA_RAD))
