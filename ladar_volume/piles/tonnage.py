"""Tonnes from a volume and the density of the material as it lies: ``m = rho V`` with ``sigma² =
(rho sigma_V)² + (V sigma_rho)²``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ladar_volume.model.piles import Material


@dataclass(frozen=True)
class Tonnage:
    """mass_t : tonnes · sigma_t : standard deviation; of the volume alone where the density's own
    is not known · by_volume_t, by_density_t : its parts, the second NaN where it is not known
    """

    mass_t: float
    sigma_t: float
    by_volume_t: float
    by_density_t: float


def tonnage(volume_m3: float, sigma_m3: float, material: Material) -> Tonnage:
    """Tonnes of a volume, m³, and its standard deviation, m³."""
    by_volume = material.density_t_m3 * sigma_m3
    by_density = abs(volume_m3) * material.sigma_t_m3
    both = by_volume if math.isnan(by_density) else math.hypot(by_volume, by_density)
    return Tonnage(material.density_t_m3 * volume_m3, both, by_volume, by_density)


def total_tonnage(parts: list[Tonnage], names: list[str], correlated: float) -> Tonnage:
    """The sum over piles: densities of one material are wrong alike, those of others not;
    ``correlated`` t is the standard deviation of the sum by the volumes.
    """
    by_material: dict[str, float] = {}
    for part, name in zip(parts, names, strict=True):
        by_material[name] = by_material.get(name, 0.0) + part.by_density_t
    by_density = math.sqrt(sum(s**2 for s in by_material.values()))
    both = correlated if math.isnan(by_density) else math.hypot(correlated, by_density)
    return Tonnage(sum(part.mass_t for part in parts), both, correlated, by_density)
