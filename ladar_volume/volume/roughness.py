"""The ground is not the polynomial fitted to it: roughness as a source of its own.

Residuals of the ground points beyond their noise are a random field with variance s² and correlation ``exp(−d / L)``. The field
acts twice: through the fit, and under the body, where the ground is not seen. Both are one linear functional of the field, ``Σ
w e``, with the outline's area as weight inside and the fit's weights outside; its variance ``s² Σ_ij w_i w_j exp(−d_ij / L)``
is summed on a grid by FFT.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ladar_volume.model.kernels import kernel
from ladar_volume.model.records import F64, Bool

#: Points used for the autocorrelation, taken at equal index steps: two million pairs.
MAX_POINTS = 1500
MAX_CELLS = 400


@dataclass(frozen=True)
class Roughness:
    """variance_m2 : s², m² · length_m : L, m, of the exponential correlation with the same integral over the plane · spacing_m : mean
    distance of the points it was estimated from"""

    variance_m2: float
    length_m: float
    spacing_m: float


def mean_spacing(xy: F64) -> float:
    """Side (m) of the square that one of the points (n, 2) occupies on average: of the occupied cells of a coarse grid."""
    low, high = xy.min(axis=0), xy.max(axis=0)
    side = max(float((high - low).max()) / 40.0, 1e-9)
    cells = np.floor((xy - low) / side).astype(np.int64)
    occupied = int(np.count_nonzero(np.bincount(cells[:, 0] * 64 + cells[:, 1])))
    return math.sqrt(occupied * side * side / len(xy))


@kernel
def pair_products(xy: F64, e: F64, edges: F64) -> tuple[F64, F64]:
    """Sums of ``e_i e_j`` and numbers of pairs (k + 1,) of points xy (n, 2) whose distance lies between ascending edges (k,)."""
    products, counts = np.zeros(len(edges) + 1), np.zeros(len(edges) + 1)
    for i in range(len(xy)):
        for j in range(i + 1, len(xy)):
            d = math.sqrt((xy[i, 0] - xy[j, 0]) ** 2 + (xy[i, 1] - xy[j, 1]) ** 2)
            k = np.searchsorted(edges, d, side="right")
            products[k] += e[i] * e[j]
            counts[k] += 1.0
    return products, counts


def estimate_roughness(xy: F64, residual: F64, noise_variance: F64, parameters: int) -> Roughness:
    """s² and L from ground residuals (n,) m at xy (n, 2) m with known independent noise variances (n,) m².

    s² is the mean square residual, corrected for the fitted parameters, minus the mean noise, never below zero; L is that of the
    exponential with the integral of the empirical autocorrelation over the plane, which is what a body much larger than L feels, at least
    half the spacing. (The distance at which the correlation falls to 1/e makes the sigma of a smooth ground 1.4 times too large.)
    """
    n = len(residual)
    spacing = mean_spacing(xy)
    if n <= parameters:
        return Roughness(0.0, spacing / 2, spacing)
    s2 = max(0.0, float(residual @ residual) / (n - parameters) - float(noise_variance.mean()))
    if s2 == 0.0:
        return Roughness(0.0, spacing / 2, spacing)
    step = max(1, math.ceil(n / MAX_POINTS))
    p, e = xy[::step], residual[::step]
    extent = float(np.linalg.norm(xy.max(axis=0) - xy.min(axis=0)))
    edges = np.geomspace(max(spacing, extent / 1000), max(extent / 2, 2 * spacing), 25)
    products, counts = pair_products(np.ascontiguousarray(p), np.ascontiguousarray(e), edges)
    lag = np.concatenate([[edges[0] / 2], np.sqrt(edges[:-1] * edges[1:])])
    ok = counts[:-1] >= 30
    return Roughness(s2, max(spacing / 2, integral_length(lag[ok], products[:-1][ok] / counts[:-1][ok] / s2)), spacing)


def integral_length(lag: F64, rho: F64) -> float:
    """L of the exponential correlation with the same integral over the plane: ``L² = ∫ rho(d) d dd``, of a correlation sampled at ascending
    lags, up to where it first falls to zero; linear between samples, starting at 1 for lag 0. The last lag, where none falls to 1/e."""
    d, r = np.concatenate([[0.0], lag]), np.concatenate([[1.0], np.minimum(rho, 1.0)])
    if not (r < math.exp(-1.0)).any():
        return float(d[-1])
    end = np.flatnonzero(r <= 0.0)
    if len(end):  # up to the crossing, which lies between two samples
        k = int(end[0])
        d = np.append(d[:k], d[k - 1] + (d[k] - d[k - 1]) * r[k - 1] / (r[k - 1] - r[k]))
        r = np.append(r[:k], 0.0)
    h, one, two = np.diff(d), d[:-1], d[1:]
    # exact for a correlation that is linear between the samples
    return math.sqrt(float((h * (one * (2.0 * r[:-1] + r[1:]) + two * (r[:-1] + 2.0 * r[1:])) / 6.0).sum()))


def field_variance(xy: F64, weight: F64, point: Bool, rough: Roughness) -> float:
    """Variance of ``Σ w e`` for weights (n,) at xy (n, 2) m: unit² of w times m².

    point : (n,) whether a weight acts at a point; the others are spread over their surroundings, about one spacing wide.
    """
    if rough.variance_m2 == 0.0 or len(xy) == 0:
        return 0.0
    low = xy.min(axis=0)
    extent = float((xy.max(axis=0) - low).max())
    h = max(rough.spacing_m, extent / MAX_CELLS, 1e-9)
    cell = np.floor((xy - low) / h).astype(np.int64)
    shape = cell.max(axis=0) + 1
    grid = np.bincount(cell[:, 0] * shape[1] + cell[:, 1], weight, int(shape[0] * shape[1])).reshape(shape)
    size = [int(2 ** math.ceil(math.log2(2 * s))) for s in shape]
    dx, dy = (np.minimum(np.arange(s), s - np.arange(s)) * h for s in size)
    kernel = np.exp(-np.hypot(dx[:, None], dy[None]) / rough.length_m)
    # two points of one cell are 0.52 h apart on average; for L below h the cell's mean correlation is its integral over its area
    kernel[0, 0] = min(math.exp(-0.5214 * h / rough.length_m), 2 * math.pi * (rough.length_m / h) ** 2)
    spectrum = np.fft.rfft2(grid, s=size)
    smooth = np.fft.irfft2(spectrum * np.fft.rfft2(kernel), s=size)[: shape[0], : shape[1]]
    # a point is fully correlated with itself, not as two points of one cell are
    alone = (1.0 - kernel[0, 0]) * float((weight[point] ** 2).sum())
    return rough.variance_m2 * max(0.0, float((grid * smooth).sum()) + float(alone))
