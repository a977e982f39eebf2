"""The sigma of a sum over a map of height differences whose errors are correlated in space: a check
from the data alone.

Where nothing changed between two epochs, their height difference is error. Its variogram there,
``gamma(d) = s² (n + (1 − n)(1 − exp(−d / L)))`` for differences in units of each cell's sigma, says
what the sum over any area is worth: ``Var(Σ w e) = s² Σ_ij w_i sigma_i w_j sigma_j rho(d_ij)``,
with ``rho = (1 − n) exp(−d / L)`` between two cells and 1 within one. The pairs of one lag share
their correlation, so the double sum is the autocorrelation of ``w sigma``, by FFT, times rho summed
over the lags: exact, in O(n log n). (Rolstad et al. 2009 and Hugonnet et al. 2022 treat the same
sum by circles and subsamples.)
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import fft
from scipy.optimize import minimize_scalar, nnls

from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64, Bool

#: Fewest cells of stable ground, and classes of distance of the empirical variogram.
LEAST_CELLS, CLASSES = 100, 30


@dataclass(frozen=True)
class Variogram:
    """variance : s², of differences over their sigmas: 1 where the sigmas are true · nugget : n,
    share of it that no neighbour shares · length_m : L, distance over which the rest falls to 1/e
    """

    variance: float
    nugget: float
    length_m: float

    def correlation(self, distance_m: F64) -> F64:
        """rho at distances (m); 1 at zero."""
        out: F64 = (1.0 - self.nugget) * np.exp(-distance_m / self.length_m)
        return np.where(distance_m == 0.0, 1.0, out)


def lags(shape: tuple[int, int], size: tuple[int, int], cell_m: float) -> F64:
    """Distances (m) of the lags of a zero-padded autocorrelation, in the order of the FFT."""
    dy, dx = (np.minimum(np.arange(n), n - np.arange(n)) * cell_m for n in size)
    return np.hypot(dy[:, None], dx[None, :])


def autocorrelation(first: F64, second: F64) -> F64:
    """``Σ_i first_i second_(i + lag)`` over all lags of two maps (r, c), zero-padded, in the order
    of the FFT.
    """
    size = [fft.next_fast_len(2 * n - 1, real=True) for n in first.shape]
    spectrum = fft.rfft2(first, size)
    product = (
        np.abs(spectrum) ** 2 if second is first else np.conj(spectrum) * fft.rfft2(second, size)
    )
    return np.asarray(fft.irfft2(product, size))


def sum_variance(sigma: F64, weight: F64, cell_m: float, variogram: Variogram) -> float:
    """Variance of ``Σ w e`` over a map: sigma (r, c) m, weight (r, c) in whatever unit, e.g. the
    cell's area in m² inside an outline and 0 elsewhere (cells of weight 0 may have any sigma). For
    the mean divide by ``(Σ w)²``.

    Raises :class:`VolumeError` for maps of different shape, sigmas that are negative or not finite,
    or a variogram that is none.
    """
    v = variogram
    if sigma.shape != weight.shape or sigma.ndim != 2:
        raise VolumeError(
            f"sigma and weight must be maps of one shape, not {sigma.shape} and {weight.shape}",
            reason="volume_map",
        )
    load = np.where(weight == 0.0, 0.0, weight * sigma)
    if not np.isfinite(load).all() or (sigma[weight != 0.0] < 0.0).any():
        raise VolumeError(
            "every cell that counts needs a weight and a sigma of 0 or more", reason="volume_map"
        )
    if not (
        v.variance >= 0.0
        and 0.0 <= v.nugget <= 1.0
        and 0.0 < v.length_m < math.inf
        and 0.0 < cell_m < math.inf
    ):
        raise VolumeError(
            f"not a variogram and a cell: {v}, {cell_m} m", reason="volume_variogram", value=v
        )
    pairs = autocorrelation(load, load)
    rho = v.correlation(
        lags((load.shape[0], load.shape[1]), (pairs.shape[0], pairs.shape[1]), cell_m)
    )
    return v.variance * max(0.0, float(np.vdot(pairs, rho)))


@dataclass(frozen=True)
class Empirical:
    """An empirical variogram: mean distance (k,) m, gamma (k,) and number of pairs (k,) of each
    class of distance.
    """

    distance_m: F64
    gamma: F64
    pairs: F64


def empirical_variogram(standard: F64, stable: Bool, cell_m: float, reach_m: float) -> Empirical:
    """Half the mean squared difference of all pairs of stable cells (r, c) up to ``reach_m`` apart,
    by classes of distance.
    """
    z, m = np.where(stable, standard, 0.0), stable.astype(np.float64)
    z = np.where(
        stable, z - z[stable].mean(), 0.0
    )  # differences do not mind, and small numbers keep their digits
    squares = autocorrelation(z * z, m)
    count, products = np.rint(autocorrelation(m, m)), autocorrelation(z, z)
    size = (count.shape[0], count.shape[1])
    # every pair is met at both lags: each lag's sum of squares holds z_i² of the one, its mirror
    # image's that of the other
    mirror = np.roll(squares[::-1, ::-1], (1, 1), axis=(0, 1))
    half = 0.5 * (squares + mirror) - products
    distance = lags((stable.shape[0], stable.shape[1]), size, cell_m)
    near = (distance > 0.0) & (distance <= reach_m) & (count > 0.5)
    edges = np.unique(
        np.concatenate([[0.0], np.geomspace(1.01 * cell_m, max(reach_m, 1.02 * cell_m), CLASSES)])
    )
    label = np.searchsorted(edges, distance[near])
    pairs = np.bincount(label, count[near])
    good = pairs > 0
    gamma, mean = (
        np.bincount(label, v)[good] / pairs[good]
        for v in (half[near], distance[near] * count[near])
    )
    return Empirical(mean, np.maximum(gamma, 0.0), pairs[good] / 2.0)


def fit_variogram(empirical: Empirical) -> Variogram:
    """Nugget, sill and length by least squares, classes weighted by pairs over squared distance
    (near ones decide the sum most).
    """
    d, g = empirical.distance_m, empirical.gamma
    root = np.sqrt(empirical.pairs) / d
    root = root / root.max()

    def solve(log_length: float) -> tuple[F64, float]:
        A = np.stack([np.ones(len(d)), 1.0 - np.exp(-d / math.exp(log_length))], axis=1)
        part, residual = nnls(A * root[:, None], g * root)
        return part, float(residual)

    low, high = math.log(d[0] / 4.0), math.log(d[-1])
    steps = np.linspace(low, high, 40)
    start = int(np.argmin([solve(x)[1] for x in steps]))
    around = (steps[max(start - 1, 0)], steps[min(start + 1, len(steps) - 1)])
    best = minimize_scalar(
        lambda x: solve(x)[1], bounds=around, method="bounded", options={"xatol": 1e-4}
    )
    nugget, sill = solve(float(best.x))[0]
    total = float(nugget + sill)
    return Variogram(total, float(nugget / total) if total > 0.0 else 1.0, math.exp(float(best.x)))


def estimate_variogram(
    difference: F64, sigma: F64, stable: Bool, cell_m: float, reach_m: float | None = None
) -> Variogram:
    """The variogram of height differences (r, c) m over their sigmas (r, c) m on stable ground (r,
    c); cells that are not finite do not count.

    reach_m : longest distance, by default a third of the ground's extent; a longer correlation
    cannot be told from a trend. Raises :class:`VolumeError` with fewer than a hundred stable cells.
    """
    if not difference.shape == sigma.shape == stable.shape or difference.ndim != 2:
        raise VolumeError(
            "differences, sigmas and stable ground must be maps of one shape", reason="volume_map"
        )
    with np.errstate(divide="ignore", invalid="ignore"):
        standard = difference / sigma
    good: Bool = stable & np.isfinite(standard) & (sigma > 0.0)
    count = int(np.count_nonzero(good))
    if count < LEAST_CELLS:
        raise VolumeError(
            f"{count} cells of stable ground; {LEAST_CELLS} are needed",
            reason="volume_stable_ground",
            value=count,
        )
    rows, columns = np.nonzero(good)
    extent = cell_m * math.hypot(float(np.ptp(rows)), float(np.ptp(columns)))
    return fit_variogram(
        empirical_variogram(standard, good, cell_m, extent / 3.0 if reach_m is None else reach_m)
    )
