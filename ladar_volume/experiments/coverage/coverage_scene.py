"""Sites of ``ladar_volume study coverage``: a frustum on rough, tilted ground as a height field,
its exact volume, and where rays meet it.

The same bodies as the scenes for ray casting, but without a mesh: a new ground for every survey
costs nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates, spline_filter

from ladar_volume.math.kernels import kernel
from ladar_volume.model.records import F64, I64, Bool
from ladar_volume.simulation.scenes import Ground

#: Steps of the march along a ray; each leaves at most half of the way that is left on what a flight
#: sees.
STEPS = 30
#: Height above the surface from which on a ray is at its end, m.
ON_SURFACE_M = 1e-10
REPOSE = math.radians(35.0)
SLOPE = (0.012, -0.008)
#: Grounds of 40 sinusoids each that are added up: few would make a field with rare large errors.
#: Cell of the table they are read from, m.
GROUNDS, CELL_M = 10, 0.25


@kernel
def march(origin: F64, ray: F64, fall: F64, shape: F64, t: F64) -> None:
    """Moves distances t (n,) along rays (n, 3) from origins (n, 3) on to the surface of
    :meth:`Site.smooth`, by its height below over ``fall`` (n,) a step. shape : semi-axes, height
    and top of the site, slope of its ground.
    """
    a, b, height, top, slope_x, slope_y = shape
    for i in range(len(t)):
        for _ in range(STEPS):
            x, y = origin[i, 0] + t[i] * ray[i, 0], origin[i, 1] + t[i] * ray[i, 1]
            part = (1.0 - math.sqrt((x / a) ** 2 + (y / b) ** 2)) / (1.0 - top)
            above = (
                origin[i, 2]
                + t[i] * ray[i, 2]
                - slope_x * x
                - slope_y * y
                - height * min(max(part, 0.0), 1.0)
            )
            t[i] += above / fall[i]
            if abs(above) < ON_SURFACE_M:
                break


class RoughGround:
    """The ground's roughness of one survey: sinusoids of the simulation's own ground, read from a
    table by cubic splines.

    A plane of :data:`SLOPE` lies beneath it. The table's error is below a thousandth of the
    roughness for a length of four cells.
    """

    def __init__(
        self, rough_m: float, length_m: float, seed: int, half_m: tuple[float, float]
    ) -> None:
        share = rough_m / math.sqrt(GROUNDS)
        self.parts = [
            Ground(rough_m=share, length_m=length_m, seed=seed * GROUNDS + k)
            for k in range(GROUNDS)
        ]
        x, y = (np.arange(-h - 2.0, h + 2.0 + CELL_M, CELL_M) for h in half_m)
        k, phase, amplitude = (
            np.concatenate(values)
            for values in zip(*(part.waves() for part in self.parts), strict=True)
        )
        along, across = np.outer(x, k[:, 0]) + phase, np.outer(y, k[:, 1])
        table = (amplitude * np.sin(along)) @ np.cos(across).T + (
            amplitude * np.cos(along)
        ) @ np.sin(across).T
        self._low, self._spline = (
            np.array([x[0], y[0]]),
            spline_filter(table, order=3, mode="mirror"),
        )

    def __call__(self, xy: F64) -> F64:
        """Heights (n,) m above the plane at xy (n, 2) m."""
        out: F64 = map_coordinates(
            self._spline, ((xy - self._low) / CELL_M).T, order=3, mode="nearest", prefilter=False
        )
        return out

    def mean_over_box(self, half_x: float, half_y: float) -> float:
        """Exact mean over a rectangle about the origin."""
        return math.fsum(
            part.mean_over_box(-half_x, half_x, -half_y, half_y) for part in self.parts
        )


@dataclass(frozen=True)
class Site:
    """An elliptic frustum on its ground, centred at the origin.

    a, b : semi-axes of the foot, m · height_m : of the top above the ground, negative for a pit ·
    top : size of the flat top over that of the foot · around_m : ground surveyed around the foot ·
    flight_m : half length and height of the flight · pulses : that go down in one survey ·
    max_edge_m : longest edge of its triangles · rough_m, length_m : standard deviation and length
    of the ground's sinusoids · sector_rad : pulses within this angle from straight down
    """

    name: str
    a: float
    b: float
    height_m: float
    top: float
    around_m: float
    flight_m: tuple[float, float]
    pulses: int
    max_edge_m: float = 3.0
    rough_m: float = 0.010
    length_m: float = 1.0
    sector_rad: float = math.radians(45.0)

    @property
    def volume_m3(self) -> float:
        """Volume above the ground, m³; negative for a pit."""
        return math.pi * self.a * self.b * self.height_m * (1.0 + self.top + self.top**2) / 3.0

    @property
    def half_m(self) -> tuple[float, float]:
        """Half length and width of the surveyed rectangle."""
        return self.a + self.around_m, self.b + self.around_m

    @property
    def heights_m(self) -> tuple[float, float]:
        """Between which the site lies, m, its ground's slope left out."""
        return min(0.0, self.height_m), max(0.0, self.height_m)

    def ground(self, seed: int) -> RoughGround:
        """The ground of one survey."""
        return RoughGround(self.rough_m, self.length_m, seed, self.half_m)

    def smooth(self, xy: F64) -> F64:
        """Heights (n,) m at xy (n, 2) m without the ground's roughness."""
        rho = np.hypot(xy[:, 0] / self.a, xy[:, 1] / self.b)
        out: F64 = xy @ np.array(SLOPE) + self.height_m * np.clip(
            (1.0 - rho) / (1.0 - self.top), 0.0, 1.0
        )
        return out

    def normals(self, xy: F64) -> F64:
        """Upward unit normals (n, 3) of the smooth surface."""
        rho = np.maximum(np.hypot(xy[:, 0] / self.a, xy[:, 1] / self.b), 1e-12)
        wall = np.where((rho > self.top) & (rho < 1.0), self.height_m / (1.0 - self.top), 0.0) / rho
        n = np.stack(
            [
                wall * xy[:, 0] / self.a**2 - SLOPE[0],
                wall * xy[:, 1] / self.b**2 - SLOPE[1],
                np.ones(len(xy)),
            ],
            axis=1,
        )
        out: F64 = n / np.linalg.norm(n, axis=1, keepdims=True)
        return out

    def sampled(self, true: F64) -> I64:
        """The hits (k,) among (n, 3) m, NaN for none, that are vertices: all."""
        return np.flatnonzero(np.isfinite(true[:, 0]))

    def normals_at(self, true: F64) -> F64:
        """Upward unit normals (n, 3) of the smooth surface that the rays truly hit at (n, 3) m: as
        a filter's, they go where the points go.
        """
        return self.normals(true[:, :2])

    def inside(self, xy: F64) -> Bool:
        """Whether xy (n, 2) lie in the surveyed rectangle."""
        out: Bool = (np.abs(xy[:, 0]) <= self.half_m[0]) & (np.abs(xy[:, 1]) <= self.half_m[1])
        return out

    def ranges(self, origin: F64, ray: F64, ground: RoughGround) -> F64:
        """Distance (n,) m along downward unit rays (n, 3) from origins (n, 3) m to their first hit
        within the rectangle, NaN without.

        A surface no steeper than G is not passed by steps of the height above it over ``|d_z| + G
        |d_xy|``.
        """
        steepest = abs(self.height_m) / (1.0 - self.top) / min(self.a, self.b) + math.hypot(*SLOPE)
        fall = np.abs(ray[:, 2]) + steepest * np.hypot(ray[:, 0], ray[:, 1])
        t = (
            np.maximum((origin[:, 2] - abs(self.height_m) - 1.0) / -ray[:, 2], 0.0)
            if self.height_m > 0
            else np.zeros(len(ray))
        )
        march(origin, ray, fall, np.array([self.a, self.b, self.height_m, self.top, *SLOPE]), t)
        hit = origin[:, :2] + t[:, None] * ray[:, :2]
        out = np.full(len(ray), np.nan)
        rows = np.flatnonzero(self.inside(hit))
        n, o, d, t = self.normals(hit[rows]), origin[rows], ray[rows], t[rows]
        slope = (n * d).sum(axis=1) / n[:, 2]
        off = o[:, 2] + t * d[:, 2] - self.smooth(hit[rows])
        at = hit[rows]
        for _ in range(2):  # the roughness is small: the beam meets it a little before or after
            out[rows] = t + (ground(at) - off) / slope
            at = o[:, :2] + out[rows, None] * d[:, :2]
        return out


def level_truth(
    site: Site, ground: RoughGround, half: tuple[float, float], level_m: float
) -> float:
    """Exact net volume (m³) above a level over a rectangle that holds the whole body."""
    return site.volume_m3 + 4.0 * half[0] * half[1] * (ground.mean_over_box(*half) - level_m)


#: Sites whose surface is a height field.
FIELDS = {
    s.name: s
    for s in (
        Site("stockpile_100", 5.14, 5.14, 5.14 * math.tan(REPOSE), 0.0, 7.0, (10.0, 25.0), 9_000),
        Site(
            "stockpile_5000",
            22.0,
            18.0,
            18.0 * math.tan(REPOSE) * 0.8,
            0.2,
            11.0,
            (28.0, 35.0),
            18_000,
            6.0,
        ),
        Site("pit", 5.0, 5.0, -2.0, 0.6, 3.0, (10.0, 25.0), 7_000),
    )
}
