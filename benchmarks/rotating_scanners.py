"""Simulated rotating scanners through the cloud filter with parameters it sets itself, against
surfaces that have a formula (:mod:`benchmarks.scanner_scene`).

Root mean squares over the points of surfaces that are kept. ``sigma``: distance of the filtered
points from the true surface over the printed sigma, 0.8 to 1.25 wanted. ``lost``: surface points
taken out, at most 1 %. ``far``: outliers more than 0.5 m from everything that are taken out, at
least 98 %. ``noise``: what the filter believes over the distances of the points as they came, 1/1.5
to 1.5. Points flagged sparse are as they came, and are no part of the first and the last;
``flagged`` is how far they are off over their printed sigma.
"""

from __future__ import annotations

import time

import numpy as np

from benchmarks.scanner_scene import SURFACE, Case, Scan, scan, to_surface
from benchmarks.truth import F64
from ladar_volume.clouds.filter_cloud import CloudResult, filter_cloud
from ladar_volume.model.parameters import FilterParameters

SEEDS = 2
SIGMA, LOST, FAR, FACTOR = (0.8, 1.25), 0.01, 0.98, 1.5
CASES = (
    Case(16, "standing", 0.010),
    Case(16, "standing", 0.010, 0.02),
    Case(16, "standing", 0.030, 0.05),
    Case(16, "rolling", 0.003),
    Case(16, "rolling", 0.020, 0.02, copies=2),
    Case(16, "flying", 0.010, 0.0, 0.001),
    Case(16, "flying", 0.030),
    Case(32, "standing", 0.003, 0.0, 0.005),
    Case(32, "standing", 0.020, 0.0, 0.001),
    Case(32, "standing", 0.020, copies=3),
    Case(32, "rolling", 0.010, 0.05),
    Case(32, "flying", 0.020, 0.02, 0.01),
    Case(64, "standing", 0.005, 0.0, 0.01),
    Case(64, "standing", 0.010, copies=2),
    Case(64, "rolling", 0.030, 0.01, 0.001),
    Case(64, "flying", 0.003, 0.02),
    Case(128, "standing", 0.003),
    Case(128, "standing", 0.015, 0.05, 0.001, copies=3),
    Case(128, "rolling", 0.010, 0.0, 0.005),
    Case(128, "flying", 0.030, 0.03),
)


def own(points: F64) -> CloudResult:
    """The filter at hand, parameters set by itself."""
    return filter_cloud(points, FilterParameters(), auto=True)


def measure(made: Scan, result: CloudResult) -> dict[str, float]:
    """The figures of one scan."""
    good = made.label == SURFACE
    kept = np.zeros(len(made.r), bool)
    kept[result.index] = True
    sparse = getattr(result, "sparse", None)
    flag = np.zeros(len(result.index), bool) if sparse is None else np.asarray(sparse)
    use = good[result.index] & ~flag
    lone = good[result.index] & flag
    after = to_surface(made.scene, result.r[use])
    noise = np.full(use.sum(), np.nan)
    if result.noise is not None:
        noise = result.noise[use]
    return {
        "sigma": rms(after) / rms(result.sigma[use]),
        "lost": float(np.mean(~kept[good])),
        "far": float(np.mean(~kept[made.far])) if made.far.any() else np.nan,
        "noise": rms(noise) / rms(made.distance[result.index[use]]),
        "sparse": float(np.mean(flag)),
        "after_mm": 1e3 * rms(after),
        "before_mm": 1e3 * rms(made.distance[result.index[use]]),
        "flagged": rms(made.distance[result.index[lone]]) / rms(result.sigma[lone]),
    }


def rms(x: F64) -> float:
    """Root mean square, NaN of nothing."""
    return float(np.sqrt(np.mean(x**2))) if len(x) else np.nan


def met(f: dict[str, float]) -> bool:
    """Whether all four hold."""
    return (
        SIGMA[0] <= f["sigma"] <= SIGMA[1]
        and f["lost"] <= LOST
        and not f["far"] < FAR
        and 1 / FACTOR <= f["noise"] <= FACTOR
    )


def line(f: dict[str, float]) -> str:
    """One row of the table."""
    return (
        f"{'' if met(f) else '**not met** '}sigma {f['sigma']:.2f}, lost {100 * f['lost']:.2f} %, "
        f"far {100 * f['far']:.1f} %, noise {f['noise']:.2f}; sparse {100 * f['sparse']:.1f} %, "
        f"{f['before_mm']:.2f} mm before, {f['after_mm']:.2f} mm after, flagged {f['flagged']:.2f}"
    )


def run(seeds: int = SEEDS, cases: tuple[Case, ...] = CASES) -> dict[str, float | int | str]:
    """All cases, each seed with a scene of its own."""
    out: dict[str, float | int | str] = {}
    rows = []
    for case in cases:
        for seed in range(seeds):
            made = scan(case, seed)
            began = time.perf_counter()
            figures = measure(made, own(made.r))
            took = time.perf_counter() - began
            rows.append(figures)
            out[f"{case.name}, seed {seed} ({len(made.r)})"] = f"{line(figures)}, {took:.1f} s"
    out["cases"] = len(rows)
    out["cases that meet all four"] = sum(met(row) for row in rows)
    ratios = [row["sigma"] for row in rows]
    out["sigma, least"], out["sigma, largest"] = min(ratios), max(ratios)
    out["lost, largest"] = max(row["lost"] for row in rows)
    out["far outliers taken out, least"] = float(np.nanmin([row["far"] for row in rows]))
    return out


if __name__ == "__main__":
    for key, value in run().items():
        print(f"{key}: {value:.4g}" if isinstance(value, float) else f"{key}: {value}")
