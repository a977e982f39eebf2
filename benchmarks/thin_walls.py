"""Closed bodies with thin walls seen from all sides, in random orientation: a half bowl of
1 m with a wall of 8 cm, a pipe of 0.4 m and 1 m length with one of 4 cm, a plate of 1 × 0.7 m and 2
cm. 3 to 10 mm of noise.

``python -m benchmarks.thin_walls [SHAPE ...] [--seeds N] [--first SEED]``: error in per cent and in
sigma of each, and whether it is doubtful.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np
from scipy.spatial.transform import Rotation

from ladar_volume.clouds.body_checks import (
    check_bodies,
    check_doubts,
    uncertainty,
)
from ladar_volume.clouds.body_points import filtered_points
from ladar_volume.clouds.body_verdict import bodies_verdict
from ladar_volume.clouds.body_walls import wall_doubts
from ladar_volume.clouds.cloud_bodies import cloud_bodies
from ladar_volume.clouds.filter_cloud import filter_cloud
from ladar_volume.model.body_parameters import BodyParameters
from ladar_volume.model.cloud_filter_parameters import FilterParameters
from ladar_volume.model.errors import LadarVolumeError
from ladar_volume.model.records import F64
from ladar_volume.model.verdict import Verdict

#: Points per square metre.
DENSITY = 4000.0


def disc(inner: float, outer: float, rng: np.random.Generator) -> F64:
    """Points (n, 3) of a level ring."""
    n = int(DENSITY * np.pi * (outer**2 - inner**2))
    r = np.sqrt(rng.uniform(inner**2, outer**2, n))
    turn = rng.uniform(0.0, 2.0 * np.pi, n)
    return np.c_[r * np.cos(turn), r * np.sin(turn), np.zeros(n)]


def bowl(rng: np.random.Generator, radius: float = 0.5, wall: float = 0.08) -> tuple[F64, float]:
    """Points and volume of a half bowl."""
    parts = [disc(radius - wall, radius, rng)]
    for r in (radius, radius - wall):
        n = int(DENSITY * 2.0 * np.pi * r**2)
        z, turn = rng.uniform(-1.0, 0.0, n), rng.uniform(0.0, 2.0 * np.pi, n)
        s = np.sqrt(1.0 - z**2)
        parts.append(r * np.c_[s * np.cos(turn), s * np.sin(turn), z])
    return np.concatenate(parts), 2.0 / 3.0 * np.pi * (radius**3 - (radius - wall) ** 3)


def pipe(rng: np.random.Generator, radius: float = 0.2, wall: float = 0.04) -> tuple[F64, float]:
    """Points and volume of a pipe of 1 m."""
    up = np.array([0.0, 0.0, 1.0])
    ends = [disc(radius - wall, radius, rng) + z * up for z in (0.0, 1.0)]
    parts = []
    for r in (radius, radius - wall):
        n = int(DENSITY * 2.0 * np.pi * r)
        turn = rng.uniform(0.0, 2.0 * np.pi, n)
        parts.append(np.c_[r * np.cos(turn), r * np.sin(turn), rng.uniform(0.0, 1.0, n)])
    return np.concatenate(parts + ends), np.pi * (radius**2 - (radius - wall) ** 2)


def plate(rng: np.random.Generator, thick: float = 0.02) -> tuple[F64, float]:
    """Points and volume of a plate with its four narrow sides."""
    size = np.array([1.0, 0.7, thick])
    parts = []
    for axis in range(3):
        wide = np.delete(size, axis).prod()
        for side in (0.0, 1.0):
            p = rng.uniform(size=(int(DENSITY * wide), 3))
            p[:, axis] = side
            parts.append(p * size)
    return np.concatenate(parts), float(size.prod())


#: Points and volume by shape.
SHAPES = {"bowl": bowl, "pipe": pipe, "plate": plate}


def measured(shape: str, noise_m: float, seed: int) -> tuple[float, float, str]:
    """Error in per cent and in sigma, NaN where refused, and the doubts' names or the refusal's."""
    rng = np.random.default_rng([seed, 8])
    points, volume = SHAPES[shape](rng)
    raw = Rotation.random(random_state=seed).apply(points) + noise_m * rng.normal(size=points.shape)
    try:
        of = filtered_points(filter_cloud(raw, FilterParameters(), auto=True))
        label, options = np.zeros(len(of.r), np.int64), BodyParameters()
        made = cloud_bodies(of.r, of.normal, of.curved, label, None, options)
        made, checked = check_bodies(made, of, raw, options)
        known = uncertainty(made, checked, of, raw)
    except LadarVolumeError as error:
        return np.nan, np.nan, f"refused: {error.reason}"
    assert known is not None
    verdict = bodies_verdict(made, of.r, None) + Verdict(
        check_doubts(checked) + wall_doubts(made, of) + made.bodies[0].doubts
    )
    error_m3 = made.bodies[0].volume_m3 - volume
    names = ", ".join(d.name for d in verdict.doubts) or "sound"
    return 100.0 * error_m3 / volume, error_m3 / float(known.sigma_m3[0]), names


def row(rows: list[tuple[float, float, str]]) -> str:
    """Errors in words: of those with an answer, and how many are right within two sigma, named as
    doubtful, refused, or wrong with a sound verdict.
    """
    error, z = (np.array([r[k] for r in rows]) for k in (0, 1))
    sound = np.array([words == "sound" for *_, words in rows])
    refused = np.isnan(error)
    within = np.abs(np.where(refused, np.inf, z)) <= 2.0
    if refused.all():
        return f"refused {len(rows)} of {len(rows)}"
    return (
        f"error {np.nanmean(error):+.2f} ± {np.nanstd(error):.2f} %, z {np.nanmean(z):+.1f} ± "
        f"{np.nanstd(z):.1f}; sound {sound.sum()}, of these within 2 sigma "
        f"{(sound & within).sum()}; doubtful {(~sound & ~refused).sum()}, refused "
        f"{refused.sum()}; right or named {(within | ~sound).sum()} of {len(rows)}"
    )


def run(
    seeds: int = 5, first: int = 0, shapes: list[str] | None = None
) -> dict[str, float | int | str]:
    """By shape and noise: errors, how many lie within two sigma or are named."""
    out: dict[str, float | int | str] = {"seeds of each": seeds}
    for shape in shapes or list(SHAPES):
        for noise_m in (0.003, 0.005, 0.010):
            rows = [measured(shape, noise_m, seed) for seed in range(first, first + seeds)]
            out[f"{shape}, {1e3 * noise_m:.0f} mm"] = words = row(rows)
            for seed, one in enumerate(rows, first):
                print(shape, noise_m, seed, *one, file=sys.stderr)
            print(shape, noise_m, words, file=sys.stderr, flush=True)
    return out


def main() -> None:
    """Run the shapes named, all by default."""
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("shapes", nargs="*", choices=[*SHAPES, []])
    ask.add_argument("--seeds", type=int, default=5)
    ask.add_argument("--first", type=int, default=0)
    given = ask.parse_args()
    for key, value in run(given.seeds, given.first, given.shapes).items():
        print(f"{key} : {value}")


if __name__ == "__main__":
    main()
