"""The experiment of seed 000 chapter 5, simulated: a plywood box of known size in the corner of two
screens, scanned with it and without.

The corner is the origin, the screens stand on the planes x = 0 and y = 0, the floor is z = 0. Every
ray is cast in closed form; nothing of the package's georeferencing is used. What is not printed in
the source is chosen here: where the scanner stands, how large the screens are, and that the angular
steps are equal in azimuth and elevation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ladar_volume.model.errors import SimulationError
from ladar_volume.model.records import F64, I64

#: Sides of the box along x, y, z, m (seed 000 chapter 5: 4 ft, 5 ft and 3 ft), and its volume, m³.
BOX_M = np.array([1.2192, 1.5240, 0.9144])
TRUE_M3 = float(np.prod(BOX_M))
#: To how much the sides were verified, m, and what that allows the volume, m³: by the sum of all
#: three faces.
SIDE_BOUND_M = 0.0016
TRUE_BOUND_M3 = float(SIDE_BOUND_M * TRUE_M3 * (1.0 / BOX_M).sum())
#: Width and height of each screen, m, which fit the printed tables best (docs/study_nist.md);
#: position of the scanner, m.
SCREEN_M = (2.1, 1.3)
SCANNER_M = np.array([3.6, 3.3, 2.2])
RANGE_SIGMA_M, ROUNDING_M = 0.02, 0.001
#: Points with and without the box by density setting 1 to 5 (Table 5.1).
DENSITIES = ((15912, 15903), (10199, 10221), (7116, 7104), (3995, 3990), (2557, 2548))
#: What a ray met.
FLOOR, SCREEN_X, SCREEN_Y, BOX = 0, 1, 2, 3


@dataclass(frozen=True)
class Scan:
    """One scan, cropped to the screens and the floor between them.

    points : (n, 3) m, measured · true : (n, 3) m, without noise and rounding · ray : (n, 3) unit
    vectors from the scanner · target : (n,) what each ray met, one of FLOOR, SCREEN_X, SCREEN_Y,
    BOX · step_rad : of the angular grid
    """

    points: F64
    true: F64
    ray: F64
    target: I64
    step_rad: float

    def part(self, index: I64) -> Scan:
        """The points ``index`` (k,) of this scan."""
        return Scan(
            self.points[index], self.true[index], self.ray[index], self.target[index], self.step_rad
        )


def angles_of(points: F64) -> F64:
    """Azimuth and elevation (n, 2), rad, of points (n, 3), m, as seen from the scanner; azimuth 0
    is towards the corner.
    """
    d = points - SCANNER_M
    azimuth = np.arctan2(d[:, 1], d[:, 0]) - np.arctan2(-SCANNER_M[1], -SCANNER_M[0])
    out: F64 = np.stack(
        [(azimuth + np.pi) % (2 * np.pi) - np.pi, np.arctan2(d[:, 2], np.hypot(d[:, 0], d[:, 1]))],
        axis=1,
    )
    return out


def rays_of(angles: F64) -> F64:
    """Unit vectors (n, 3) of azimuths and elevations (n, 2), rad; the inverse of
    :func:`angles_of`.
    """
    azimuth = angles[:, 0] + np.arctan2(-SCANNER_M[1], -SCANNER_M[0])
    c = np.cos(angles[:, 1])
    out: F64 = np.stack([c * np.cos(azimuth), c * np.sin(azimuth), np.sin(angles[:, 1])], axis=1)
    return out


def cast(ray: F64, with_box: bool) -> tuple[F64, I64]:
    """Distance (n,), m, and what was met (n,) along rays (n, 3) from the scanner; infinite and −1
    where a ray meets neither screen, nor the floor between them, nor the box.
    """
    with np.errstate(divide="ignore"):
        t = -SCANNER_M / ray  # to the planes x = 0, y = 0, z = 0
    t[~(t > 0)] = np.inf
    first = np.argmin(t, axis=1)
    distance = t[np.arange(len(ray)), first]
    at = SCANNER_M + np.where(np.isfinite(distance), distance, 0.0)[:, None] * ray
    size = np.array([SCREEN_M[0], SCREEN_M[0], SCREEN_M[1]])
    inside = np.isfinite(distance) & (at <= size).all(axis=1)
    met = np.where(inside, np.array([SCREEN_X, SCREEN_Y, FLOOR])[first], -1)
    distance = np.where(inside, distance, np.inf)
    if with_box:
        with np.errstate(divide="ignore", invalid="ignore"):
            near, far = (
                (BOX_M - SCANNER_M) / ray,
                -SCANNER_M / ray,
            )  # the slab of each axis; the scanner is beyond all three faces
        near, far = np.where(ray < 0, near, -np.inf), np.where(ray < 0, far, -np.inf)
        enter, leave = near.max(axis=1), far.min(axis=1)
        hit = (enter < leave) & (enter < distance) & (ray < 0).all(axis=1)
        distance, met = np.where(hit, enter, distance), np.where(hit, BOX, met)
    return distance, met.astype(np.int64)


def scan(
    with_box: bool,
    step_rad: float,
    rng: np.random.Generator,
    sigma_m: float = RANGE_SIGMA_M,
    rounding_m: float = ROUNDING_M,
) -> Scan:
    """A scan on a regular grid of angles with random phase, independent range noise, coordinates
    rounded. Seen from the scanner no edge of this scene hides anything, so beams of no width do.

    Raises :class:`SimulationError` for a step that is not above zero or a sigma or rounding below
    it.
    """
    if not step_rad > 0.0 or not min(sigma_m, rounding_m) >= 0.0:
        raise SimulationError(
            "a scan needs a step above 0 and no negative noise",
            value=(step_rad, sigma_m, rounding_m),
        )
    ray = rays_of(angle_grid(step_rad, rng))
    distance, met = cast(ray, with_box)
    on = np.flatnonzero(met >= 0)
    ray, distance, met = ray[on], distance[on], met[on]
    true = SCANNER_M + distance[:, None] * ray
    points = true + (sigma_m * rng.standard_normal(len(ray)))[:, None] * ray
    return Scan(
        np.round(points / rounding_m) * rounding_m if rounding_m else points,
        true,
        ray,
        met,
        step_rad,
    )


def angle_grid(step_rad: float, rng: np.random.Generator) -> F64:
    """Angles (n, 2) rad of a regular grid with random phase over screens and floor."""
    w, h = SCREEN_M
    room = np.array(
        [
            [x, y, z]
            for x in (0.0, w)
            for y in (0.0, w)
            for z in (0.0, h)
            if x * y == 0.0 or z == 0.0
        ]
    )
    window = angles_of(room)
    axes = [
        np.arange(
            window[:, k].min() - step_rad * (1.0 + rng.random()),
            window[:, k].max() + step_rad,
            step_rad,
        )
        for k in range(2)
    ]
    return np.stack([a.ravel() for a in np.meshgrid(*axes)], axis=1)


@lru_cache
def silhouette_rad2(samples: int = 400) -> float:
    """Extent of screens and floor in azimuth times elevation as seen from the scanner, rad²: points
    of a scan are this over step².
    """
    rng = np.random.default_rng(0)
    step = 0.6 / samples
    return len(scan(False, step, rng, 0.0, 0.0).target) * step**2


def step_for(points: int) -> float:
    """Angular step, rad, that gives about so many points after cropping."""
    return float(np.sqrt(silhouette_rad2() / points))


def pair(
    density: int, seed: int, sigma_m: float = RANGE_SIGMA_M, rounding_m: float = ROUNDING_M
) -> tuple[Scan, Scan]:
    """The scans with and without the box at a density setting 1 to 5 of Table 5.1."""
    if not 1 <= density <= len(DENSITIES):
        raise SimulationError(
            f"density settings are 1 to {len(DENSITIES)}, not {density}", value=density
        )
    rng = np.random.default_rng([seed, density])
    step = step_for(DENSITIES[density - 1][0])
    return scan(True, step, rng, sigma_m, rounding_m), scan(False, step, rng, sigma_m, rounding_m)
