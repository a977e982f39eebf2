"""What the folded-normal correction leaves in cut and in fill, and how uncertain that is; and how
much wider the vertices of a partial TIN scatter than the noise of their points says.

The correction takes the true height from a plane with noise s'. Where the true height is zero it
leaves ``(2 − √2) φ(0) s' = 0.234 s'`` per area, where it is far from zero nothing. Ground that did
not change lies at zero exactly: the part is told from the smoothed heights μ̂ by
``0.234 √2 s' exp(−μ̂² / 2s'²)``, whose mean at a true height of zero is what is left.

Near zero, but not at it, less is left; over true heights that are spread evenly about zero the
parts that are left cancel. Weighted alike, μ̂²/s'² is 1/2 on average where all true
heights are zero, and 1 where they are spread evenly: twice the excess is the share that is not
taken, and that is uncertain with the standard error of that mean. Where a neighbourhood ended early
the ground is not at zero all around: nothing is taken there, half of it is uncertain.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ladar_volume.math.kernels import kernel
from ladar_volume.model.records import F64, I32, I64, Bool
from ladar_volume.volume.neighbourhood import Smooth, grow

#: What is left per area and standard deviation of the smoothed height, where the truth is zero.
LEFT = (2.0 - math.sqrt(2.0)) / math.sqrt(2.0 * math.pi)
#: Variance of ``2 Σ w μ̂²/s'² / Σ w − 1``, w = exp(−μ̂² / 2s'²), of one independent place where the
#: truth is zero: ``4 E w² (x² − 1/2)² / (E w)²``, and E w² = 1/√3, x² of variance 1/3 under w².
OF_SPREAD = 2.0 / math.sqrt(3.0)
#: Median of chi square over its degrees of freedom for a neighbourhood of two rings (16 of them).
MEDIAN = 0.959
#: Most by which the vertices' variances are raised; beyond, the ground is rough, not noisy.
WIDEST = 4.0


class RemainingFold(NamedTuple):
    """fold_m3 : what the correction leaves in cut and in fill alike · sigma_m3 : of it."""

    fold_m3: float
    sigma_m3: float

    def with_scatter(self, apart_m3: float) -> RemainingFold:
        """The same, where what the noise of chosen vertices folds is uncertain by so much too."""
        return RemainingFold(self.fold_m3, math.hypot(self.sigma_m3, apart_m3))


def remaining_fold(smooth: Smooth, triangles: I32, area: F64, rings: int) -> RemainingFold:
    """What is left over triangles (m, 3) of areas (m,) m² near the base; ``rings`` : of a whole
    neighbourhood.
    """
    return fold_of_sums(fold_sums(smooth, triangles, area, rings))


def fold_sums(
    smooth: Smooth, triangles: I32, area: F64, rings: int, counted: Bool | None = None
) -> F64:
    """Sums (5,) over the ``counted`` (n,) vertices, None for all, of what :func:`remaining_fold`
    takes: what may be left where neighbourhoods are whole, and where they ended, m³; members of
    neighbourhoods and their number; the first weighted with the squares.
    """
    s, grown = np.sqrt(smooth.variance), smooth.rings()
    ratio = np.divide(smooth.heights, s, out=np.full(len(s), np.inf), where=s > 0.0)
    square = np.minimum(ratio**2, 1e3)
    own = np.bincount(triangles.ravel(), np.repeat(area / 3.0, 3), len(s))
    if counted is not None:
        own[~counted] = 0.0
    left = LEFT * math.sqrt(2.0) * own * s * np.exp(-0.5 * square)
    whole, some = grown == rings, grown[own > 0.0]
    members = (1 + 3 * some * (some + 1)).sum()
    of_squares = (left * square)[whole].sum()
    return np.array([left[whole].sum(), left[~whole].sum(), members, len(some), of_squares])


def fold_of_sums(sums: F64) -> RemainingFold:
    """:func:`remaining_fold` from :func:`fold_sums`."""
    fold, ended, members, count, of_squares = sums.tolist()
    if not fold > 0.0:
        return RemainingFold(0.0, 0.5 * ended)
    independent = max(count**2 / members, 1.0)
    spread = 2.0 * of_squares / fold - 1.0
    error = math.sqrt(OF_SPREAD / independent)
    taken = fold * (1.0 - min(max(spread, -0.5), 1.0))
    return RemainingFold(taken, math.hypot(min(max(spread, 0.0) + error, 1.0) * fold, 0.5 * ended))


@kernel
def plane_misfits(start: I64, link: I64, xy: F64, h: F64, variance: F64, rows: I64) -> F64:
    """Weighted squares of the heights about the plane of two rings around each vertex of rows
    (r,), over their degrees of freedom; NaN where three are not left.
    """
    out, mark = np.full(len(rows), np.nan), np.full(len(h), -1, np.int32)
    member = np.empty(256, np.int64)
    for i in range(len(rows)):
        member[0], mark[rows[i]] = rows[i], i
        begin, count = 0, 1
        for _ in range(2):
            member, more = grow(start, link, member, begin, count, mark, i)
            begin, count = count, more
        A, b, square = np.zeros((3, 3)), np.zeros(3), 0.0
        for j in range(count):
            v = member[j]
            row = np.array([1.0, xy[v, 0] - xy[rows[i], 0], xy[v, 1] - xy[rows[i], 1]])
            w = 1.0 / max(variance[v], 1e-300)
            for k in range(3):
                b[k] += w * row[k] * h[v]
                for c in range(3):
                    A[k, c] += w * row[k] * row[c]
            square += w * h[v] * h[v]
        scale = np.sqrt(np.array([A[0, 0], A[1, 1], A[2, 2]]))
        if count < 6 or scale.min() <= 0.0:
            continue
        explained = quadratic_form(A, b, scale)
        if np.isfinite(explained):
            out[i] = max(square - explained, 0.0) / (count - 3)
    return out


@kernel
def quadratic_form(A: F64, b: F64, scale: F64) -> float:
    """``bᵀ A⁻¹ b`` of a symmetric A (3, 3) with the roots of its diagonal (3,); NaN where A is as
    good as singular.
    """
    x, y, z = b[0] / scale[0], b[1] / scale[1], b[2] / scale[2]
    xy = A[0, 1] / (scale[0] * scale[1])
    xz = A[0, 2] / (scale[0] * scale[2])
    yz = A[1, 2] / (scale[1] * scale[2])
    det = 1.0 + 2.0 * xy * xz * yz - xy * xy - xz * xz - yz * yz
    if det <= 1e-6:
        return np.nan
    own = x * x * (1.0 - yz * yz) + y * y * (1.0 - xz * xz) + z * z * (1.0 - xy * xy)
    mixed = x * y * (xz * yz - xy) + x * z * (xy * yz - xz) + y * z * (xy * xz - yz)
    out: float = (own + 2.0 * mixed) / det
    return out


def scatter_factor(start: I64, link: I64, xy: F64, h: F64, variance: F64, rows: I64) -> float:
    """By how much the variances (n,) of a partial TIN's heights (n,) are too small near vertices
    rows (r,), from 1 to 4: where points become vertices because they stand out, their heights
    scatter more than their noise.
    """
    found = plane_misfits(start, link, np.ascontiguousarray(xy), h, variance, rows)
    found = found[np.isfinite(found)]
    return float(np.clip(np.median(found) / MEDIAN, 1.0, WIDEST)) if len(found) else 1.0
