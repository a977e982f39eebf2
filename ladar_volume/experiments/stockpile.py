"""``ladar_volume study stockpile``: section 5 and Table 2 of seed 004, recomputed as printed and as
they should read.

The source takes the precision of one point from the LiDAR equation and compares it with the change
of height and width that changes a coal cone of 100 m³ by 5 %. Its geometry is not printed; the one
in :data:`ALONG` gives all six sigmas within 1.3 mm.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ladar_volume.georeference.error_budget import (
    PRESETS,
    calibration_covariance,
    independent_sigmas,
    navigation_covariance,
)
from ladar_volume.georeference.lidar_equation import mounting
from ladar_volume.georeference.point_jacobian import (
    PointGeometry,
    independent_covariance,
    point_covariance,
)
from ladar_volume.model.errors import ConfigurationError
from ladar_volume.model.parameters import BudgetParameters, CalibrationParameters
from ladar_volume.model.records import F64

#: Flying heights (m) as printed.
HEIGHTS_M = (150.0, 200.0)
#: Printed sigmas X, Y, Z (m) at each, and Table 2 as rounded there.
PRINTED = ((0.193627, 0.498572, 0.113703), (0.257801, 0.664298, 0.150233))
PRINTED_TABLE_2 = ((0.193, 0.258, 0.086), (0.499, 0.664, 0.086), (0.114, 0.150, 0.060))
PRINTED_POSITION_M = (0.01429, 0.01429, 0.02143)
#: The error vector of the position, m, root mean square.
POSITION_RMS_M = 0.05
#: Coal: volume (m³), tolerated share, angle of repose.
CONE_M3, SHARE, REPOSE_DEG = 100.0, 0.05, 35.0
#: Beam directions 30° from nadir, map X along the flight: in the plane of flight, and across it as
#: a scanner would be.
ALONG = (math.sin(math.radians(30.0)), 0.0, -math.cos(math.radians(30.0)))
ACROSS = (0.0, math.sin(math.radians(30.0)), -math.cos(math.radians(30.0)))
#: Standard deviation of a height interpolated between independent nodes over that of a node, the
#: mean over a triangle (Zhu et al. 2005).
INTERPOLATED = math.sqrt(0.5)
#: Fields of the budget by source of error.
SOURCES = {
    "position": ("position_sigma_m",),
    "attitude": ("attitude_sigma_rad",),
    "boresight": ("boresight_sigma_rad",),
    "range": ("range_noise_m",),
    "scan angle": ("azimuth_noise_rad", "vertical_noise_rad"),
    "lever arm": ("lever_antenna_sigma_m",),
}


@dataclass(frozen=True)
class Reading:
    """One way to read the reference case: a budget, the direction of the beam, and whether 150 and
    200 m are ranges or heights.
    """

    title: str
    preset: str
    beam: tuple[float, float, float]
    is_range: bool = True

    def sigmas(self, height_m: float, budget: BudgetParameters | None = None) -> F64:
        """Standard deviations (3,) m of X, Y, Z at a printed flying height."""
        distance = height_m if self.is_range else height_m / -self.beam[2]
        return point_sigmas(PRESETS[self.preset] if budget is None else budget, self.beam, distance)


READINGS = (
    Reading(
        "as printed: beam in the plane of flight, 150 and 200 m along the beam", "survey", ALONG
    ),
    Reading("position in quadrature", "survey_corrected", ALONG),
    Reading("beam across the flight, as a scanner's", "survey", ACROSS),
    Reading(
        "across, position in quadrature, 150 and 200 m as heights",
        "survey_corrected",
        ACROSS,
        is_range=False,
    ),
)


def point_sigmas(budget: BudgetParameters, beam: npt.ArrayLike, range_m: float) -> F64:
    """Standard deviations (3,) m of one point on a level platform with body axes along the map's:
    beam (3,) unit, range m.
    """
    vector, one = np.asarray(beam, dtype=np.float64) * range_m, np.zeros((1, 3))
    mount, index = mounting(CalibrationParameters()), np.zeros(1, np.int64)
    geometry = PointGeometry(
        np.ones(1, np.bool_), np.eye(3)[None], vector[None], one, one, index, np.zeros(1), mount
    )
    C_ind = independent_covariance(geometry, independent_sigmas(budget))
    C_nav = navigation_covariance(budget, np.array([0.0, 0.0, 0.0, 1.0]))[None]
    C = point_covariance(
        geometry, np.zeros(1, np.uint16), C_ind, C_nav, calibration_covariance(budget, 1)
    )[0]
    return np.sqrt(np.diag(C))


def budget_of_source(budget: BudgetParameters, source: str) -> BudgetParameters:
    """The budget with one of :data:`SOURCES` only."""
    off: dict[str, Any] = {}
    for fields in (f for name, f in SOURCES.items() if name != source):
        off |= {
            field: (0.0, 0.0, 0.0) if isinstance(getattr(budget, field), tuple) else 0.0
            for field in fields
        }
    return dataclasses.replace(budget, **off)


def position_sigmas(in_quadrature: bool) -> tuple[float, float, float]:
    """Position sigmas X, Y, Z (m) of an error vector of 0.05 m with sigma_Z = 1.5 sigma_X: added as
    printed, or in quadrature.
    """
    x = POSITION_RMS_M / (math.sqrt(1.0 + 1.0 + 1.5**2) if in_quadrature else 1.0 + 1.0 + 1.5)
    return x, x, 1.5 * x


@dataclass(frozen=True)
class Cone:
    """A cone at its angle of repose: ``V = π D³ tan(angle) / 24``."""

    volume_m3: float
    repose_rad: float

    @property
    def width_m(self) -> float:
        """Diameter D of the foot, m."""
        return float((24.0 * self.volume_m3 / (math.pi * math.tan(self.repose_rad))) ** (1.0 / 3.0))

    @property
    def height_m(self) -> float:
        """Height, m."""
        return self.width_m / 2.0 * math.tan(self.repose_rad)

    @property
    def area_m2(self) -> float:
        """Area of the foot, m²."""
        return math.pi * self.width_m**2 / 4.0

    def changes(self, share: float) -> dict[str, float]:
        """Changes (m) for a change of the volume by ``share``: radius, width and height to first
        order and exactly, and the shift of the whole surface above a fixed base that does the same
        (equal to the first-order change of the height, since V = area height / 3).
        """
        first, exact = share / 3.0, (1.0 + share) ** (1.0 / 3.0) - 1.0
        return {
            "radius": self.width_m / 2.0 * first,
            "width": self.width_m * first,
            "height": self.height_m * first,
            "radius_exact": self.width_m / 2.0 * exact,
            "width_exact": self.width_m * exact,
            "height_exact": self.height_m * exact,
            "common_shift": share * self.volume_m3 / self.area_m2,
        }


COAL = Cone(CONE_M3, math.radians(REPOSE_DEG))


@dataclass(frozen=True)
class ToleranceRule:
    """A pile and the share of its volume by which a survey may miss it."""

    cone: Cone = COAL
    share: float = SHARE

    def __post_init__(self) -> None:
        c = self.cone
        if not (0.0 < c.volume_m3 < math.inf and 0.0 < c.repose_rad < 0.5 * math.pi):
            raise ConfigurationError(
                "a pile needs a volume above 0 m³ and an angle of repose between 0 and 90°",
                value=(c.volume_m3, math.degrees(c.repose_rad)),
            )
        if not 0.0 < self.share < 1.0:
            raise ConfigurationError(
                f"the tolerated share is between 0 and 1, not {self.share:g}", value=self.share
            )

    @property
    def needed_m(self) -> tuple[float, float]:
        """Change of the width by equation 5 and of the height by equation 6, m: with
        ``W = (24 V / (π tan Ω))^(1/3)`` and ``H = W/2 tan Ω``, both for V and V (1 + share).
        """
        changes = self.cone.changes(self.share)
        return changes["width_exact"], changes["height_exact"]

    def within(self, sigma_z_m: float) -> bool:
        """The rule of section 5.2: a point's height errs by no more than the change of the height
        that changes the volume by the share.
        """
        return sigma_z_m <= self.needed_m[1]

    def smallest_m3(self, sigma_z_m: float) -> float:
        """The smallest pile of this angle of repose for which that holds, m³; it grows with the
        third power of sigma.
        """
        height = sigma_z_m / math.expm1(math.log1p(self.share) / 3.0)
        return math.pi * height**3 / (3.0 * math.tan(self.cone.repose_rad) ** 2)


def summary(pile: ToleranceRule | None = None) -> dict[str, Any]:
    """Every number of the study as plain values, of a pile of coal by default."""
    pile, printed = pile or ToleranceRule(), READINGS[0]
    return {
        "position_sigma_m": {
            "printed": PRINTED_POSITION_M,
            "added": position_sigmas(False),
            "in_quadrature": position_sigmas(True),
        },
        "point_sigma_m": {
            "heights": HEIGHTS_M,
            "printed": PRINTED,
            "readings": {r.title: [r.sigmas(h).tolist() for h in HEIGHTS_M] for r in READINGS},
        },
        "by_source_m": {
            s: [
                printed.sigmas(h, budget_of_source(PRESETS["survey"], s)).tolist()
                for h in HEIGHTS_M
            ]
            for s in SOURCES
        },
        "interpolated_z_m": {
            "printed": [row[2] * INTERPOLATED for row in PRINTED],
            "readings": {
                r.title: [float(r.sigmas(h)[2]) * INTERPOLATED for h in HEIGHTS_M] for r in READINGS
            },
        },
        "cone": cone_facts(pile),
        "rule": rule_facts(pile),
    }


def cone_facts(pile: ToleranceRule) -> dict[str, Any]:
    """The pile as a cone (seed 004 equations 5 and 6)."""
    cone = pile.cone
    return {
        "volume_m3": cone.volume_m3,
        "repose_deg": math.degrees(cone.repose_rad),
        "width_m": cone.width_m,
        "height_m": cone.height_m,
        "area_m2": cone.area_m2,
        "share": pile.share,
        "changes_m": cone.changes(pile.share),
    }


def rule_facts(pile: ToleranceRule) -> dict[str, Any]:
    """Whether each reading's heights hold the tolerated share of the pile."""

    def row(reading: Reading, height_m: float) -> dict[str, Any]:
        sigma = float(reading.sigmas(height_m)[2])
        return {
            "sigma_z_m": sigma,
            "holds": pile.within(sigma),
            "smallest_m3": pile.smallest_m3(sigma),
        }

    return {
        "needed_width_m": pile.needed_m[0],
        "needed_height_m": pile.needed_m[1],
        "readings": {r.title: [row(r, h) for h in HEIGHTS_M] for r in READINGS},
    }
