"""What errors that neighbouring heights share do to sums over them: ``Var(Σ g e) = sigma² Σ_ij g_i
g_j exp(−d_ij / L)`` for gradients g by the heights at places with distances d.

The double sum over points would take n² steps. The gradients are laid on a grid finer than a
sixteenth of L, each shared by the four nearest nodes, and the sum over the lags of the grid is
exact there (:mod:`ladar_volume.uncertainty.correlated_sum`). What sharing takes from the
correlation of a point with itself is put back.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import fft

from ladar_volume.model.errors import ConfigurationError
from ladar_volume.model.piles import HeightError
from ladar_volume.model.records import F64
from ladar_volume.uncertainty.correlated_sum import lags

#: Nodes of the grid per correlation length, fewest and most of them along a side.
PER_LENGTH, SHORTEST, LONGEST = 16.0, 400, 2048
#: Fewest nodes per correlation length.
FEWEST = 2.0


def shared_variances(xy: F64, gradient: F64, error: HeightError) -> F64:
    """Variances (k,) of k results with gradients (n, k) by the heights at places xy (n, 2), m.

    Raises :class:`ConfigurationError` for a correlation length too short for the size of the site.
    """
    if math.isinf(error.correlation_m):
        total: F64 = gradient.sum(axis=0)
        return error.sigma_m**2 * total**2
    counts = gradient.any(axis=1)
    if not counts.any():
        return np.zeros(gradient.shape[1])
    at, g = xy[counts], gradient[counts]
    extent = float(np.ptp(at, axis=0).max())
    cell = max(min(error.correlation_m / PER_LENGTH, extent / SHORTEST), extent / LONGEST)
    cell = cell or error.correlation_m / PER_LENGTH  # a single place
    if cell * FEWEST > error.correlation_m:
        raise ConfigurationError(
            f"{error.name}: a correlation length of {error.correlation_m:g} m is too short for "
            f"what counts, {extent:.4g} m long; from {FEWEST * extent / LONGEST:.2g} m on",
            value=error.correlation_m,
        )
    maps = on_grid(at, g, cell)
    size = [fft.next_fast_len(2 * n - 1, real=True) for n in maps.shape[1:]]
    rho = np.exp(-lags(maps.shape[1:], (size[0], size[1]), cell) / error.correlation_m)
    alone = correlation_losses(at, cell, error.correlation_m) @ g**2
    sums = [
        float(np.vdot(np.asarray(fft.irfft2(np.abs(fft.rfft2(one, size)) ** 2, size)), rho))
        for one in maps
    ]
    out: F64 = error.sigma_m**2 * np.maximum(np.array(sums) + alone, 0.0)
    return out


def correlation_losses(xy: F64, cell_m: float, length_m: float) -> F64:
    """By how much the correlation (n,) of a point at xy (n, 2), m, with itself falls short of 1
    where it is shared by four nodes.
    """
    part = (xy - xy.min(axis=0)) / cell_m % 1.0
    u, v = (2.0 * p * (1.0 - p) for p in part.T)  # chance that two shares differ, along x and y
    side, corner = np.exp(-cell_m / length_m), np.exp(-math.sqrt(2.0) * cell_m / length_m)
    kept = (1.0 - u) * (1.0 - v) + (u * (1.0 - v) + v * (1.0 - u)) * side + u * v * corner
    out: F64 = 1.0 - kept
    return out


def on_grid(xy: F64, gradient: F64, cell_m: float) -> F64:
    """Gradients (n, k) at places xy (n, 2), m, as maps (k, r, c): each shared by the four nodes
    around it so that its place stays their centre.
    """
    place = (xy - xy.min(axis=0)) / cell_m
    low = np.floor(place).astype(np.int64)
    part = place - low
    c, r = (low.max(axis=0) + 2).tolist()
    out = np.zeros((gradient.shape[1], r, c))
    for dx in (0, 1):
        for dy in (0, 1):
            share = np.abs(1 - dx - part[:, 0]) * np.abs(1 - dy - part[:, 1])
            node = (low[:, 1] + dy) * c + low[:, 0] + dx
            for k in range(gradient.shape[1]):
                out[k] += np.bincount(node, share * gradient[:, k], r * c).reshape(r, c)
    return out
