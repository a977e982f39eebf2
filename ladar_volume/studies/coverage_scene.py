"""Sites of ``ladar_volume study coverage``: a frustum on rough, tilted ground as a height field, its exact volume, and where rays meet it.

The same bodies as the scenes for ray casting, but without a mesh: a new ground for every survey costs nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ladar_volume.model.records import F64, Bool
from ladar_volume.simulation.scenes import Ground

#: Steps of the march along a ray; each leaves at most half of the way that is left on what a flight sees.
STEPS = 30
REPOSE = math.radians(35.0)
SLOPE = (0.012, -0.008)


@dataclass(frozen=True)
class Site:
    """An elliptic frustum on its ground, centred at the origin.

    a, b : semi-axes of the foot, m · height_m : of the top above the ground, negative for a pit · top : size of the flat top over that of
    the foot · around_m : ground surveyed around the foot · flight_m : half length and height of the flight · pulses : that go down in one
    survey · rough_m, length_m : standard deviation and length of the ground's sinusoids
    """

    name: str
    a: float
    b: float
    height_m: float
    top: float
    around_m: float
    flight_m: tuple[float, float]
    pulses: int
    rough_m: float = 0.010
    length_m: float = 1.0

    @property
    def volume_m3(self) -> float:
        """Volume above the ground, m³; negative for a pit."""
        return math.pi * self.a * self.b * self.height_m * (1.0 + self.top + self.top**2) / 3.0

    @property
    def half_m(self) -> tuple[float, float]:
        """Half length and width of the surveyed rectangle."""
        return self.a + self.around_m, self.b + self.around_m

    def ground(self, seed: int) -> Ground:
        """The ground of one survey."""
        return Ground(slope=SLOPE, rough_m=self.rough_m, length_m=self.length_m, seed=seed)

    def smooth(self, xy: F64) -> F64:
        """Heights (n,) m at xy (n, 2) m without the ground's roughness."""
        rho = np.hypot(xy[:, 0] / self.a, xy[:, 1] / self.b)
        out: F64 = xy @ np.array(SLOPE) + self.height_m * np.clip((1.0 - rho) / (1.0 - self.top), 0.0, 1.0)
        return out

    def normals(self, xy: F64) -> F64:
        """Upward unit normals (n, 3) of the smooth surface."""
        rho = np.maximum(np.hypot(xy[:, 0] / self.a, xy[:, 1] / self.b), 1e-12)
        wall = np.where((rho > self.top) & (rho < 1.0), self.height_m / (1.0 - self.top), 0.0) / rho
        n = np.stack([wall * xy[:, 0] / self.a**2 - SLOPE[0], wall * xy[:, 1] / self.b**2 - SLOPE[1], np.ones(len(xy))], axis=1)
        out: F64 = n / np.linalg.norm(n, axis=1, keepdims=True)
        return out

    def inside(self, xy: F64) -> Bool:
        """Whether xy (n, 2) lie in the surveyed rectangle."""
        out: Bool = (np.abs(xy[:, 0]) <= self.half_m[0]) & (np.abs(xy[:, 1]) <= self.half_m[1])
        return out

    def ranges(self, origin: F64, ray: F64, ground: Ground) -> F64:
        """Distance (n,) m along downward unit rays (n, 3) from origins (n, 3) m to their first hit within the rectangle, NaN without.

        A surface no steeper than G is not passed by steps of the height above it over ``|d_z| + G |d_xy|``.
        """
        steepest = abs(self.height_m) / (1.0 - self.top) / min(self.a, self.b) + math.hypot(*SLOPE)
        fall = np.abs(ray[:, 2]) + steepest * np.hypot(ray[:, 0], ray[:, 1])
        t = np.maximum((origin[:, 2] - abs(self.height_m) - 1.0) / -ray[:, 2], 0.0) if self.height_m > 0 else np.zeros(len(ray))
        for _ in range(STEPS):
            t = t + (origin[:, 2] + t * ray[:, 2] - self.smooth(origin[:, :2] + t[:, None] * ray[:, :2])) / fall
        hit = origin[:, :2] + t[:, None] * ray[:, :2]
        out = np.full(len(ray), np.nan)
        rows = np.flatnonzero(self.inside(hit))
        n, o, d, t = self.normals(hit[rows]), origin[rows], ray[rows], t[rows]
        slope = (n * d).sum(axis=1) / n[:, 2]
        off = o[:, 2] + t * d[:, 2] - self.smooth(hit[rows])
        at = hit[rows]
        for _ in range(2):  # the roughness is small: the beam meets it a little before or after
            rough = ground(at[:, 0], at[:, 1]) - at @ np.array(SLOPE)
            out[rows] = t + (rough - off) / slope
            at = o[:, :2] + out[rows, None] * d[:, :2]
        return out


def level_truth(site: Site, ground: Ground, half: tuple[float, float], level_m: float) -> float:
    """Exact net volume (m³) above a level over a rectangle that holds the whole body."""
    return site.volume_m3 + 4.0 * half[0] * half[1] * (ground.mean_over_box(-half[0], half[0], -half[1], half[1]) - level_m)


SITES = {
    s.name: s
    for s in (
        Site("stockpile_100", 5.14, 5.14, 5.14 * math.tan(REPOSE), 0.0, 7.0, (10.0, 25.0), 9_000),
        Site("stockpile_5000", 22.0, 18.0, 18.0 * math.tan(REPOSE) * 0.8, 0.2, 11.0, (28.0, 35.0), 12_000),
        Site("pit", 5.0, 5.0, -2.0, 0.6, 3.0, (10.0, 25.0), 7_000),
    )
}
