"""Reference spheres, half seen: 12 random points, R = 0.1 m, 5 mm noise; RMS of the centre, and its
predicted sigma against it.
"""

from __future__ import annotations

import numpy as np

from benchmarks.truth import F64
from ladar_volume.registration.spheres import fit_sphere

RADIUS_M, SIGMA_M, POINTS = 0.1, 0.005, 12
#: Measured elsewhere, mm.
ELSEWHERE_MM = {"free": 7.7, "known": 4.9}


def half_seen(rng: np.random.Generator) -> F64:
    """Points (12, 3), m, spread at random over the upper half of a sphere about the origin, noise
    along the normal.
    """
    z, turn = rng.uniform(0.0, 1.0, POINTS), rng.uniform(0.0, 2.0 * np.pi, POINTS)
    s = np.sqrt(1.0 - z * z)
    u = np.stack([s * np.cos(turn), s * np.sin(turn), z], axis=1)
    out: F64 = (RADIUS_M + SIGMA_M * rng.standard_normal(POINTS))[:, None] * u
    return out


def run(spheres: int = 1500, seed: int = 4) -> dict[str, float | int | str]:
    """Figures with the radius free and known; the scanner stands above."""
    out: dict[str, float | int | str] = {"spheres": spheres}
    for name, radius in (("free", None), ("known", RADIUS_M)):
        rng = np.random.default_rng(seed)
        error, predicted, normal = np.empty((spheres, 3)), np.empty(spheres), np.empty(spheres)
        for k in range(spheres):
            s = fit_sphere(
                half_seen(rng), SIGMA_M, radius, instrument=np.array([0.0, 0.0, 9.0]), seed=k
            )
            error[k], predicted[k] = s.centre, np.trace(s.C_centre)
            normal[k] = s.centre @ np.linalg.solve(s.C_centre, s.centre) / 3.0
        rms = float(np.sqrt((error**2).sum(axis=1).mean()))
        out[f"radius {name}: RMS of the centre, mm"] = 1e3 * rms
        out[f"radius {name}: its standard error, mm"] = (
            1e3 * float((error**2).sum(axis=1).std()) / (2.0 * rms * np.sqrt(spheres))
        )
        out[f"radius {name}: measured elsewhere, mm"] = ELSEWHERE_MM[name]
        out[f"radius {name}: predicted over empirical sigma"] = (
            float(np.sqrt(predicted.mean())) / rms
        )
        out[f"radius {name}: mean normalised squared error"] = float(normal.mean())
    return out
