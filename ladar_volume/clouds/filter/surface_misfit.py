"""What residuals say against surfaces: the noise of neighbouring points is independent, so the mean
of their residuals is small; where it is not, the surface lies beside the points as a whole, and
its printed variance, that of the noise alone, is too small.

The square of the mean of k residuals, less the variance σ² / k of that mean, is the square of how
far the surface is off there. One such value scatters as much as it says; so it is averaged over the
neighbours, and what is more than chance makes of noise counts.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.math.kernels import kernel, parallel_kernel, signed
from ladar_volume.model.records import F64, I64

#: Neighbours whose mean residual is taken, few and many: what is off beside an edge changes sign
#: within a few points, what is off across a wide fit does not. How often it is averaged over many.
FEW, MANY, AVERAGED = 8, 32, 2
#: Standard deviations of chance above which a surface is off; independent means in an average.
CHANCE, MEANS = 4.0, 80.0
#: Points looked at at a time.
PART = 200_000


def misfit_variance(r: F64, q: F64, normal: F64, noise: F64) -> F64:
    """Variance (n,) m² by which surfaces are off points (n, 3) m beyond what noise explains, 0
    where it explains all.

    q : (n, 3) m foot points · normal : (n, 3) · noise : (n,) m, standard deviation of a residual
    """
    n = len(r)
    if n <= MANY:
        return np.zeros(n)
    near = np.empty((n, MANY), np.int64)
    tree = cKDTree(r, balanced_tree=False)
    for low in range(0, n, PART):
        near[low : low + PART] = tree.query(r[low : low + PART], k=MANY, workers=-1)[1]
    out = np.zeros(n)
    for k in (FEW, MANY):
        square = np.empty(n)
        _mean_squares(
            np.ascontiguousarray(r - q), normal, noise, np.ascontiguousarray(near[:, :k]), square
        )
        for _ in range(AVERAGED):
            mean = np.empty(n)
            _averages(square, near, mean)
            square = mean
        chance = CHANCE * math.sqrt(2.0 / (MEANS * k))
        out = np.maximum(out, square - chance)
    return np.asarray(out * noise**2)


@kernel
def _mean_square(i: int, d: F64, normal: F64, noise: F64, near: I64) -> float:
    """Square of the mean residual along the normal of point i, less what noise makes it, over the
    noise of the points squared.
    """
    mean, variance, k = 0.0, 0.0, near.shape[1]
    for j in near[i]:
        along, turned = 0.0, 0.0
        for c in range(3):
            along += d[j, c] * normal[i, c]
            turned += normal[j, c] * normal[i, c]
        mean += along
        variance += (noise[j] * turned) ** 2
    return float((mean * mean - variance) / (k * k * noise[i] ** 2))


@parallel_kernel
def _mean_squares(d: F64, normal: F64, noise: F64, near: I64, out: F64) -> None:
    """Of all points (n,), from residuals d (n, 3) and neighbours (n, k)."""
    for i in numba.prange(len(d)):
        out[i] = _mean_square(signed(i), d, normal, noise, near)


@parallel_kernel
def _averages(values: F64, near: I64, out: F64) -> None:
    """Means (n,) of values (n,) over neighbours (n, k)."""
    for i in numba.prange(len(values)):
        total = 0.0
        for j in range(near.shape[1]):
            total += values[near[i, j]]
        out[i] = total / near.shape[1]
