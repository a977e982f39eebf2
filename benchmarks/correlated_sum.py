"""The sigma of a spatially correlated sum: FFT against the double sum over all pairs of cells."""

from __future__ import annotations

import time
import tracemalloc

import numpy as np
import numpy.typing as npt

from ladar_volume.uncertainty.correlated_sum import Variogram, sum_variance

F64 = npt.NDArray[np.float64]
SMALL, LARGE = (100, 100), (1000, 1000)
CELL_M = 0.5
VARIOGRAM = Variogram(1.1, 0.2, 6.0)


def maps(shape: tuple[int, int], seed: int = 1) -> tuple[F64, F64]:
    """Sigmas that differ by a factor of four from cell to cell, and weights with a round hole in
    them.
    """
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: shape[0], : shape[1]]
    hole = np.hypot(y - 0.4 * shape[0], x - 0.6 * shape[1]) < 0.15 * min(shape)
    return rng.uniform(0.01, 0.04, shape), np.where(hole, 0.0, CELL_M**2)


def double_sum(sigma: F64, weight: F64, cell_m: float, variogram: Variogram) -> float:
    """The same variance by the sum over all pairs: the plain twin."""
    rows, columns = np.nonzero(weight)
    load, at = (weight * sigma)[rows, columns], np.stack([rows, columns], axis=1) * cell_m
    total = 0.0
    for a, p in zip(load, at, strict=True):
        d = np.sqrt(((at - p) ** 2).sum(axis=1))
        rho = np.where(d == 0.0, 1.0, (1.0 - variogram.nugget) * np.exp(-d / variogram.length_m))
        total += a * float(rho @ load)
    return variogram.variance * total


def lag_sum(shape: tuple[int, int], sigma: float, cell_m: float, variogram: Variogram) -> float:
    """Equal cells: each lag (i, j) has (r − |i|)(c − |j|) pairs."""
    i, j = np.arange(1 - shape[0], shape[0]), np.arange(1 - shape[1], shape[1])
    pairs = (shape[0] - np.abs(i))[:, None] * (shape[1] - np.abs(j))[None].astype(np.float64)
    rho = (1.0 - variogram.nugget) * np.exp(
        -np.hypot(i[:, None], j[None]) * cell_m / variogram.length_m
    )
    rho[shape[0] - 1, shape[1] - 1] = 1.0
    return variogram.variance * (sigma * cell_m**2) ** 2 * float((pairs * rho).sum())


def run() -> dict[str, float | int | str]:
    """Times, memory and differences."""
    sigma, weight = maps(SMALL)
    began = time.perf_counter()
    slow = double_sum(sigma, weight, CELL_M, VARIOGRAM)
    brute_s = time.perf_counter() - began
    fast = sum_variance(sigma, weight, CELL_M, VARIOGRAM)
    large, area = maps(LARGE)
    times = []
    for _ in range(5):
        began = time.perf_counter()
        sum_variance(large, area, CELL_M, VARIOGRAM)
        times.append(time.perf_counter() - began)
    tracemalloc.start()
    sum_variance(large, area, CELL_M, VARIOGRAM)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    equal = sum_variance(np.full(LARGE, 0.02), np.full(LARGE, CELL_M**2), CELL_M, VARIOGRAM)
    return {
        "10⁴ cells, double sum / s": brute_s,
        "10⁴ cells, relative difference of sigma": abs((fast / slow) ** 0.5 - 1.0),
        "10⁶ cells / s": float(np.median(times)),
        "10⁶ cells, peak memory / MB": peak / 1e6,
        "10⁶ equal cells, relative difference of sigma": abs(
            (equal / lag_sum(LARGE, 0.02, CELL_M, VARIOGRAM)) ** 0.5 - 1.0
        ),
    }


if __name__ == "__main__":
    print(run())
