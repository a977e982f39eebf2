"""Ellipsoidal heights from an autopilot's heights above mean sea level: by what the receiver says,
by the geoid, or, for want of both, not at all, which is then said.

The reference is chosen once, at the first fix: heights of two references in one survey would be a
step in the trajectory.
"""

from __future__ import annotations

import math

from ladar_volume.model.errors import ConfigurationError, FixError
from ladar_volume.model.mavlink_parameters import MavlinkParameters

#: Grids of the geoid as PROJ names them, best first; a file must be in PROJ's own folders.
GRIDS = ("us_nga_egm08_25.tif", "us_nga_egm96_15.tif", "egm08_25.gtx", "egm96_15.gtx")
RECEIVER = "ellipsoidal, the receiver's own"
GIVEN = "ellipsoidal, mean sea level plus geoid_undulation_m"
SEA_LEVEL = (
    "above mean sea level, not the ellipsoid: the receiver sends no ellipsoidal height and PROJ "
    "has no geoid grid; heights are off by one constant of up to 107 m, volumes above ground of "
    "the same survey are not"
)


def geoid_undulation(latitude_deg: float, longitude_deg: float) -> tuple[float, str] | None:
    """Geoid above the ellipsoid (m) with the grid it is from; None where PROJ has none."""
    import pyproj  # a second and tens of megabytes, for receivers that leave it out alone

    for grid in GRIDS:
        try:
            shift = pyproj.Transformer.from_pipeline(
                "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
                f"+step +proj=vgridshift +grids={grid} +multiplier=1"
            )
            z = shift.transform(longitude_deg, latitude_deg, 0.0, errcheck=True)[2]
        except pyproj.exceptions.ProjError:
            continue
        if math.isfinite(z):
            return float(z), grid
    return None


class Heights:
    """From mean sea level to the height that is taken. Raises ConfigurationError where heights
    above mean sea level are asked for without the geoid.
    """

    def __init__(self, parameters: MavlinkParameters) -> None:
        self._wanted, self._given = parameters.height, parameters.geoid_undulation_m
        if self._wanted == "msl" and math.isnan(self._given):
            raise ConfigurationError(
                "mavlink.height msl needs mavlink.geoid_undulation_m: heights here are ellipsoidal"
            )
        self._receiver_m: float | None = None
        self._constant_m: float | None = None
        self.reference = GIVEN if self._wanted == "msl" else ""

    def receiver_says(self, undulation_m: float) -> None:
        """The receiver's two heights, as their difference."""
        self._receiver_m = undulation_m

    def height(self, msl_m: float, place: tuple[float, float]) -> float:
        """The height (m) of a fix. place : latitude, longitude (deg). Raises FixError
        (fix_no_ellipsoidal_height) where only the receiver's is taken and there is none.
        """
        if self._wanted == "msl":
            return msl_m + self._given
        if not self.reference:
            self._choose(place)
        if self._constant_m is not None:
            return msl_m + self._constant_m
        if self._receiver_m is None:
            raise FixError("no ellipsoidal height is sent", reason="fix_no_ellipsoidal_height")
        return msl_m + self._receiver_m

    def _choose(self, place: tuple[float, float]) -> None:
        """Once, at the first fix."""
        if self._receiver_m is not None:
            self.reference = RECEIVER
        elif self._wanted == "auto":
            geoid = None if not math.isnan(self._given) else geoid_undulation(*place)
            if not math.isnan(self._given):
                self._constant_m, self.reference = self._given, GIVEN
            elif geoid is not None:
                self._constant_m = geoid[0]
                self.reference = f"ellipsoidal, mean sea level plus {geoid[0]:.2f} m by {geoid[1]}"
            else:
                self._constant_m, self.reference = 0.0, SEA_LEVEL
