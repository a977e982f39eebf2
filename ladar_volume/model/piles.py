"""What a user says of piles: where they are, what lies there, above what; and how good heights
are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ladar_volume.model.errors import ConfigurationError
from ladar_volume.model.parameter import param
from ladar_volume.model.records import F64

#: Bases that the heights along the outline of a pile make.
TOE_BASES = (
    "toe_plane",
    "toe_quadratic",
    "toe_tin",
    "toe_lowest",
    "toe_mean",
    "toe_highest",
)
#: Bases from the ground around a pile, and around all of them.
GROUND_BASES = ("ground", "site_ground")
#: Bases that each pile is computed above, whichever was asked for.
PILE_BASES = (*GROUND_BASES, *TOE_BASES)
#: Bases between which a user who names none cannot choose.
ALIKE = ("ground", "toe_plane", "toe_tin")


@dataclass(frozen=True)
class PileParameters:
    """What a user says of all piles of a site, and of its heights."""

    density_t_m3: float | None = param(
        None, "Density of the material as it lies, for tonnes.", unit="t/m3", low=0
    )
    density_sigma_t_m3: float | None = param(
        None, "Standard deviation of the density.", unit="t/m3", low=0
    )
    height_sigma_m: float | None = param(
        None, "Standard deviation of an error that neighbouring heights share.", unit="m", low=0
    )
    correlation_m: float | None = param(
        None, "Distance over which its correlation falls to 1/e.", unit="m", low=0.001
    )
    undulation_m: float | None = param(
        None,
        "Height above the ellipsoid of the zero that the points' heights are counted from.",
        unit="m",
        low=-120,
        high=120,
    )


@dataclass(frozen=True)
class Material:
    """name : of the material, or empty · density_t_m3 : as it lies, t/m³ · sigma_t_m3 : its
    standard deviation; NaN where nobody said it
    """

    name: str
    density_t_m3: float
    sigma_t_m3: float = math.nan

    def __post_init__(self) -> None:
        if not 0.0 < self.density_t_m3 < math.inf:
            raise ConfigurationError(
                f"a density of {self.density_t_m3:g} t/m³: a number above 0",
                value=self.density_t_m3,
            )
        if not (math.isnan(self.sigma_t_m3) or 0.0 <= self.sigma_t_m3 < math.inf):
            raise ConfigurationError(
                f"a standard deviation of the density of {self.sigma_t_m3:g} t/m³: 0 or more",
                value=self.sigma_t_m3,
            )


@dataclass(frozen=True)
class Pile:
    """name · ring : (k, 2) m, its outline, counter-clockwise, the first corner not repeated ·
    material : None where no density is known · is_found : whether it was found by rising above the
    ground of its site, rather than drawn
    """

    name: str
    ring: F64
    material: Material | None = None
    is_found: bool = False


#: A height that may be off by more is none, m.
MOST_HEIGHT_SIGMA_M = 1e6


@dataclass(frozen=True)
class HeightError:
    """An error that neighbouring heights of one survey share.

    name : a line of the budget · sigma_m : standard deviation · correlation_m : distance over which
    the correlation falls to 1/e, exponential; infinite: all heights share it
    """

    name: str
    sigma_m: float
    correlation_m: float = math.inf

    def __post_init__(self) -> None:
        if not 0.0 <= self.sigma_m <= MOST_HEIGHT_SIGMA_M:
            raise ConfigurationError(
                f"{self.name}: a standard deviation of {self.sigma_m:g} m: "
                f"from 0 to {MOST_HEIGHT_SIGMA_M:g}",
                value=self.sigma_m,
            )
        if not self.correlation_m > 0.0:
            raise ConfigurationError(
                f"{self.name}: a correlation length of {self.correlation_m:g} m: above 0",
                value=self.correlation_m,
            )
