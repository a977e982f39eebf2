"""WGS 84 to the map frame: geodetic -> earth-centred (pyproj) -> local east, north, up at a datum.

The map frame is the plane tangent to the ellipsoid at the datum, an exact rotation and shift of the
earth-centred frame; no map projection, no scale. A sensor that is levelled where it stands has its
own east, north, up; :func:`convergence` is the rotation from there into the map (0.009 degrees per
kilometre from the datum).
"""

from __future__ import annotations

import functools
import math

import numpy as np
import numpy.typing as npt
import pyproj

from ladar_volume.model.errors import FixError
from ladar_volume.model.records import F64, Datum


@functools.cache
def _to_ecef() -> pyproj.Transformer:
    # EPSG:4979 takes latitude, longitude, ellipsoidal height in this order; EPSG:4978 is
    # earth-centred, metres
    return pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978")


def rotation_enu_ecef(latitude_deg: float, longitude_deg: float) -> F64:
    """Rotation from the earth-centred frame to east, north, up at a place; (3, 3). Rows are the
    local axes.
    """
    lat, lon = math.radians(latitude_deg), math.radians(longitude_deg)
    sp, cp, sl, cl = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
    return np.array([[-sl, cl, 0.0], [-sp * cl, -sp * sl, cp], [cp * cl, cp * sl, sp]])


class LocalFrame:
    """The map frame at a datum.

    Raises :class:`FixError` where the datum is not finite or not on the earth.
    """

    def __init__(self, datum: Datum) -> None:
        place = (datum.latitude_deg, datum.longitude_deg, datum.height_m)
        if not all(math.isfinite(v) for v in place) or abs(datum.latitude_deg) > 90:
            raise FixError(
                f"no map frame at latitude, longitude, height {place}",
                reason="fix_nan",
                value=place,
            )
        self.datum = datum
        self.R_map_ecef = rotation_enu_ecef(datum.latitude_deg, datum.longitude_deg)
        self._origin_ecef = np.array(_to_ecef().transform(*place))

    def to_map(
        self, latitude_deg: npt.ArrayLike, longitude_deg: npt.ArrayLike, height_m: npt.ArrayLike
    ) -> F64:
        """Geodetic (deg, deg, m above the ellipsoid), arrays of one shape (...) -> r_map (..., 3),
        m.
        """
        ecef = np.stack(_to_ecef().transform(latitude_deg, longitude_deg, height_m), axis=-1)
        # written out: the same bits for one point as for many, which a matrix product does not
        # promise
        d, R = ecef - self._origin_ecef, self.R_map_ecef
        out: F64 = np.stack(
            [R[i, 0] * d[..., 0] + R[i, 1] * d[..., 1] + R[i, 2] * d[..., 2] for i in range(3)],
            axis=-1,
        )
        return out

    def to_geodetic(self, r_map: npt.ArrayLike) -> F64:
        """r_map (..., 3), m -> latitude (deg), longitude (deg), ellipsoidal height (m), stacked to
        (..., 3).
        """
        ecef = np.asarray(r_map, dtype=np.float64) @ self.R_map_ecef + self._origin_ecef
        parts = _to_ecef().transform(ecef[..., 0], ecef[..., 1], ecef[..., 2], direction="INVERSE")
        out: F64 = np.stack(parts, axis=-1)
        return out

    def convergence(self, latitude_deg: float, longitude_deg: float) -> F64:
        """Rotation from the east, north, up of a place into the map frame; (3, 3), the identity at
        the datum.
        """
        out: F64 = self.R_map_ecef @ rotation_enu_ecef(latitude_deg, longitude_deg).T
        return out
