"""Piles with known volumes above every base: error, and whether the intervals hold.

Two cones of 8 and 10 m radius on ground that is level or tilts by 2 or 5 %, 3.3 points per m², 2 cm
of noise; outlines of 40 corners 0.6 m outside the toe.

    python -m benchmarks.pile_bases --seeds 30
"""

from __future__ import annotations

import argparse

import numpy as np

from ladar_volume.clouds.cloud_surface import cloud_surface
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.piles import Pile
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.piles.pile_site import SiteTask
from ladar_volume.piles.pile_volumes import piles_of
from ladar_volume.piles.toe_line import places_along
from ladar_volume.volume.polygon import signed_area

#: Centre, radius, height.
CONES = ((-12.0, -8.0, 8.0, 4.0), (10.0, 9.0, 10.0, 5.0))
TILTS, NOISE_M, POINTS, HALF_M, MARGIN_M = (0.0, 0.02, 0.05), 0.02, 12_000, 30.0, 0.6
BASES = ("ground", "site_ground", "toe_plane", "toe_tin", "toe_mean", "toe_lowest", "toe_highest")


def outline(x: float, y: float, r: float) -> np.ndarray:
    """A ring (40, 2) around a cone."""
    a = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    return np.column_stack([x + (r + MARGIN_M) * np.cos(a), y + (r + MARGIN_M) * np.sin(a)])


def truth(base: str, k: int, tilt: float) -> float:
    """The volume, m³, of cone k above a base made from the true ground."""
    x, y, r, h = CONES[k]
    ring = outline(x, y, r)
    ground = tilt * places_along(ring, 0.05)[0][:, 0]
    lift = {"toe_lowest": tilt * x - ground.min(), "toe_highest": tilt * x - ground.max()}
    return np.pi * r * r * h / 3.0 + lift.get(base, 0.0) * signed_area(ring)


def run(seed: int) -> list[tuple[str, float, float, bool]]:
    """Base, error in percent, error in sigmas, sound: of each base and cone."""
    rng, tilt = np.random.default_rng(seed), TILTS[seed % len(TILTS)]
    xy = rng.uniform(-HALF_M, HALF_M, (POINTS, 2))
    z = 100.0 + tilt * xy[:, 0] + rng.normal(0.0, NOISE_M, POINTS)
    for x, y, r, h in CONES:
        z += np.maximum(0.0, h * (1.0 - np.hypot(xy[:, 0] - x, xy[:, 1] - y) / r))
    options = SurfaceParameters(ratio=1.0, relevant="sampled")
    surface = cloud_surface(np.column_stack([xy, z]), options)
    piles = [Pile(str(k), outline(x, y, r)) for k, (x, y, r, _) in enumerate(CONES)]
    out = []
    for base in BASES:
        found = piles_of(surface, piles, SiteTask(Parameters(), base, True, base), lambda _: None)
        for k, pile in enumerate(found.piles):
            error = pile.volume.net_m3 - truth(base, k, tilt)
            percent = 100.0 * error / truth(base, k, tilt)
            out.append((base, percent, error / pile.volume.sigma_m3, pile.verdict.sound))
    return out


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=30)
    rows = [row for seed in range(parser.parse_args().seeds) for row in run(seed)]
    print("base          n   bias %   rms %   z mean   z rms   95 % holds   sound")
    for base in BASES:
        own = [row for row in rows if row[0] == base]
        error, z = np.array([row[1] for row in own]), np.array([row[2] for row in own])
        sound = np.mean([row[3] for row in own])
        print(
            f"{base:12s} {len(own):3d} {error.mean():8.3f} {np.sqrt(np.mean(error**2)):7.3f} "
            f"{z.mean():8.2f} {np.sqrt(np.mean(z**2)):7.2f} {np.mean(np.abs(z) < 1.96):12.2f} "
            f"{sound:7.2f}"
        )


if __name__ == "__main__":
    main()
