"""Do the 95 % intervals of cut, of fill and of the net volume between two clouds hold? Simulated
pairs of surveys whose truth is known: level and sloping ground, unchanged, shifted, gently and
strongly changed; full and partial TINs.

``python -m benchmarks cut_fill_coverage``. A row: mean and standard deviation of z, and share of
the intervals that hold.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.clouds.cloud_surface import cloud_surface
from ladar_volume.clouds.cloud_volume import between_clouds
from ladar_volume.model.records import F64
from ladar_volume.model.surface_parameters import SurfaceParameters

#: Side of the square ground and standard deviation of the heights, m.
SIDE, SIGMA = 10.0, 0.02
#: What changed between the surveys, m.
CHANGES = {
    "unchanged": lambda x, y: 0.0 * x,
    "raised 15 mm": lambda x, y: 0.015 + 0.0 * x,
    "wave of 20 mm": lambda x, y: 0.02 * np.sin(2.0 * np.pi * x / SIDE),
    "pile and pit": lambda x, y: (
        np.maximum(1.0 - np.hypot(x - 3.0, y - 5.0) / 2.0, 0.0)
        - 0.8 * np.maximum(1.0 - np.hypot(x - 7.0, y - 5.0) / 2.0, 0.0)
    ),
}


def truth(change: str, cells: int = 1000) -> tuple[float, float]:
    """Cut and fill, m³, by the midpoints of small cells."""
    side = (np.arange(cells) + 0.5) * SIDE / cells
    d = CHANGES[change](*np.meshgrid(side, side))
    return float(np.maximum(d, 0.0).mean()) * SIDE**2, float(np.maximum(-d, 0.0).mean()) * SIDE**2


def errors(change: str, slope: float, ratio: float, draws: int, points: int, seed: int) -> F64:
    """Errors of cut, fill and net in their standard deviations (draws, 3)."""
    rng, out = np.random.default_rng(seed), []
    cut, fill = truth(change)
    rim = np.array([[x, y] for x in (0.0, SIDE) for y in (0.0, SIDE)])
    for _ in range(draws):
        surveys = []
        for changed in (1.0, 0.0):
            xy = np.r_[rim, rng.uniform(0.0, SIDE, (points, 2))]
            z = slope * (xy[:, 0] + 0.5 * xy[:, 1]) + changed * CHANGES[change](*xy.T)
            z += SIGMA * rng.normal(size=len(xy))
            surveys.append(cloud_surface(np.c_[xy, z], SurfaceParameters(ratio=ratio), SIGMA))
        v = between_clouds(*surveys, "the survey before")
        out.append(
            [
                (v.cut_m3 - cut) / v.sigma_cut_m3,
                (v.fill_m3 - fill) / v.sigma_fill_m3,
                (v.net_m3 - cut + fill) / v.sigma_m3,
            ]
        )
    return np.array(out)


def row(z: F64) -> str:
    """z and coverage in words."""
    held = (np.abs(z) < 1.96).mean(axis=0)
    return ", ".join(
        f"{name} {m:+.2f} ± {s:.2f} ({100 * share:.0f} %)"
        for name, m, s, share in zip(
            ("cut", "fill", "net"), z.mean(axis=0), z.std(axis=0), held, strict=True
        )
    )


def run(draws: int = 300, points: int = 1500) -> dict[str, float | int | str]:
    """The figures of docs/cutfill.md."""
    out: dict[str, float | int | str] = {"draws of each": draws, "points of each survey": points}
    for ratio, name in ((1.0, "full"), (1.0 / 3.0, "partial")):
        for seed, change in enumerate(CHANGES):
            slope = 0.2 * (seed % 2 == 0)
            ground = "sloping" if slope else "level"
            z = errors(change, slope, ratio, draws, points, 100 + seed)
            out[f"{change}, {ground}, {name} TIN"] = row(z)
    return out


if __name__ == "__main__":
    for key, value in run().items():
        print(f"{key} : {value}")
