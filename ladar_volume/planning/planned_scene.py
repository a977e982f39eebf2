"""What a planned survey will meet: a pile or pit of simple shape on level ground, and where a beam
hits it, in closed form.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64

#: Sinusoids that make up the roughness of the ground.
WAVES = 40


@dataclass(frozen=True)
class Pile:
    """An elliptic frustum on level ground, centred at the origin of the map.

    length_m, width_m : of the foot, along x and y · height_m : of the top above the ground;
    negative for a pit · top : size of the flat top over that of the foot, 0 for a cone · rough_m,
    rough_length_m : standard deviation of the ground's roughness and the distance over which its
    correlation falls to 1/e, m
    """

    length_m: float
    width_m: float
    height_m: float
    top: float = 0.0
    rough_m: float = 0.01
    rough_length_m: float = 1.0

    def __post_init__(self) -> None:
        sizes = (self.length_m, self.width_m, self.rough_length_m)
        good = (
            all(math.isfinite(v) and v > 0 for v in sizes)
            and math.isfinite(self.height_m)
            and self.height_m != 0
        )
        if not good or not 0.0 <= self.top < 1.0 or not 0.0 <= self.rough_m < math.inf:
            raise VolumeError(
                "a pile needs a length, width and correlation length above 0, a height "
                "that is not 0, a top from 0 to below 1 and a "
                f"roughness of 0 or more, not {self}",
                reason="plan_pile",
                value=self,
            )

    @classmethod
    def cone(
        cls, volume_m3: float, repose_rad: float, rough_m: float = 0.01, rough_length_m: float = 1.0
    ) -> Pile:
        """The cone of this volume at its angle of repose: ``V = π D³ tan(angle) / 24`` (seed 004
        section 5.2).
        """
        if not 0.0 < volume_m3 < math.inf or not 0.0 < repose_rad < math.pi / 2:
            raise VolumeError(
                "a cone needs a volume and an angle of repose, 0 to 90°, above 0",
                reason="plan_pile",
                value=volume_m3,
            )
        width = (24.0 * volume_m3 / (math.pi * math.tan(repose_rad))) ** (1.0 / 3.0)
        return cls(width, width, width / 2.0 * math.tan(repose_rad), 0.0, rough_m, rough_length_m)

    @property
    def volume_m3(self) -> float:
        """Volume above the ground, m³; negative for a pit."""
        return (
            math.pi
            * self.length_m
            * self.width_m
            / 4.0
            * self.height_m
            * (1.0 + self.top + self.top**2)
            / 3.0
        )

    def roughness(self, xy: F64, seed: int) -> F64:
        """Heights (n,) m of the ground's roughness at xy (n, 2) m: sinusoids drawn from the
        seed.
        """
        if self.rough_m == 0.0:
            return np.zeros(len(xy))
        rng = np.random.default_rng([seed, 3])
        wave, phase = (
            rng.normal(0.0, math.sqrt(2.0) / self.rough_length_m, (WAVES, 2)),
            rng.uniform(0.0, 2.0 * math.pi, WAVES),
        )
        out = np.zeros(len(xy))
        for k, p in zip(wave, phase, strict=True):
            out += np.sin(xy @ k + p)
        return out * self.rough_m * math.sqrt(2.0 / WAVES)

    def ranges(self, origin: F64, ray: F64) -> F64:
        """Distance (n,) m along unit rays (n, 3) from origins (n, 3) m to the first hit of the
        smooth surface; inf where there is none.
        """
        a, b, k, top = self.length_m / 2.0, self.width_m / 2.0, self.top, self.height_m
        # in units of the foot's semi-axes the wall is the cone rho = s(z) with s = 1 − z (1 − top)
        # / height
        o = np.stack(
            [origin[:, 0] / a, origin[:, 1] / b, 1.0 - origin[:, 2] * (1.0 - k) / top], axis=1
        )
        d = np.stack([ray[:, 0] / a, ray[:, 1] / b, -ray[:, 2] * (1.0 - k) / top], axis=1)
        sign = np.array([1.0, 1.0, -1.0])
        A, B, C = ((x * y * sign).sum(axis=1) for x, y in ((d, d), (o, d), (o, o)))
        with np.errstate(divide="ignore", invalid="ignore"):
            q = -(B + np.copysign(np.sqrt(B * B - A * C), B))
            hits = [q / A, C / q, -origin[:, 2] / ray[:, 2], (top - origin[:, 2]) / ray[:, 2]]
            best = np.full(len(ray), np.inf)
            for part, t in enumerate(hits):
                s = o[:, 2] + t * d[:, 2]
                rho = np.hypot(o[:, 0] + t * d[:, 0], o[:, 1] + t * d[:, 1])
                there = (s >= k) & (s <= 1.0) if part < 2 else rho >= 1.0 if part == 2 else rho <= k
                best = np.where(there & (t > 0.0) & (t < best), t, best)
        return best
