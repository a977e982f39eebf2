"""Two epochs of a stockpile: the volume between two TINs over their common footprint, its bias,
spread and predicted sigma, and the time.

A cosine-shaped pile of exactly 5,000 m³ on undulating ground; height noise of 3 cm, other positions
in each epoch, and a density that varies 10 to 1 across the site and is striped along it. Numbers of
points count both epochs.

``python -m benchmarks.epochs``: points, seeds, bias and spread in per cent, wall and CPU seconds
(medians of three).
"""

from __future__ import annotations

import statistics
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from ladar_volume.model.records import F64
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.volume.overlay import VolumesBetween, volumes_between

VOLUME_M3, HEIGHT_M, HALF_M, SIGMA_M = 5000.0, 8.0, 32.0, 0.03
#: ``V = h π R² (1/2 − 2/π²)``
RADIUS_M = float(np.sqrt(VOLUME_M3 / (HEIGHT_M * np.pi * (0.5 - 2.0 / np.pi**2))))
SIZES, SEEDS = (100_000, 1_000_000), 8


def places(n: int, rng: np.random.Generator) -> F64:
    """n positions (n, 2), m, by rejection from a density that varies 10 to 1."""
    kept, have = [], 0
    while have < n:
        xy = rng.uniform(-HALF_M, HALF_M, (2 * n, 2))
        density = (0.2 + 0.8 * (xy[:, 0] / HALF_M + 1.0) / 2.0) * (
            0.75 + 0.25 * np.cos(2.0 * np.pi * xy[:, 1] / 9.0)
        )
        kept.append(xy[rng.random(2 * n) < density])
        have += len(kept[-1])
    return np.concatenate(kept)[:n]


def epoch(n: int, with_pile: bool, rng: np.random.Generator) -> F64:
    """Points (n, 3), m, of one survey."""
    xy = places(n, rng)
    rho = np.hypot(xy[:, 0], xy[:, 1])
    z = 0.4 * np.sin(xy[:, 0] / 7.0) + 0.02 * xy[:, 1]
    if with_pile:
        z = z + np.where(
            rho < RADIUS_M,
            0.5 * HEIGHT_M * (1.0 + np.cos(np.pi * np.minimum(rho / RADIUS_M, 1.0))),
            0.0,
        )
    return np.c_[xy, z + SIGMA_M * rng.standard_normal(n)]


def surveys(points: int, seed: int) -> tuple[F64, F64]:
    """The two epochs, together so many points."""
    rng = np.random.default_rng([seed, points])
    return epoch(points // 2, True, rng), epoch(points - points // 2, False, rng)


def measure(after: F64, before: F64) -> VolumesBetween:
    """What is timed: both TINs, on a thread each, and the overlay, gradients included."""
    with ThreadPoolExecutor(2) as pool:
        upper, lower = pool.map(build_tin, (after, before))
    return volumes_between(upper, lower)


def run(sizes: tuple[int, ...] = SIZES, seeds: int = SEEDS) -> dict[str, float | int | str]:
    """Bias and spread over the seeds, and the time of one volume (median of three)."""
    measure(*surveys(2000, 0))
    out: dict[str, float | int | str] = {}
    for points in sizes:
        errors, sigmas, walls, cpus = [], [], [], []
        for seed in range(seeds):
            pair = surveys(points, seed)
            wall, cpu = time.perf_counter(), time.process_time()
            r = measure(*pair)
            walls.append(time.perf_counter() - wall)
            cpus.append(time.process_time() - cpu)
            errors.append(100.0 * (r.net_m3 / VOLUME_M3 - 1.0))
            vertical = np.r_[r.gradient_net[:, 2], r.lower_net[:, 2]]
            sigmas.append(100.0 * SIGMA_M * float(np.sqrt(vertical @ vertical)) / VOLUME_M3)
        name = f"{points:,} points"
        out[f"{name}: bias / %"], out[f"{name}: spread / %"] = (
            statistics.fmean(errors),
            statistics.stdev(errors),
        )
        out[f"{name}: largest error / %"] = max(map(abs, errors))
        out[f"{name}: predicted sigma / %"] = float(np.sqrt(np.mean(np.square(sigmas))))
        out[f"{name}: wall per million / s"] = 1e6 * statistics.median(walls[:3]) / points
        out[f"{name}: CPU per million / s"] = 1e6 * statistics.median(cpus[:3]) / points
    return out


if __name__ == "__main__":
    for key, value in run().items():
        print(f"{key}: {value:.4g}")
