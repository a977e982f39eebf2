"""Positions of GeoJSON: longitude and latitude in WGS 84, as RFC 7946 has them, where it is known
how the system of the files lies on the earth; otherwise the numbers of the other files.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ladar_volume.georeference.geodesy import LocalFrame
from ladar_volume.io.export.output_system import OutputSystem
from ladar_volume.io.pointfiles.datum_shift import datum_shift, place_of
from ladar_volume.model.errors import InputError
from ladar_volume.model.records import F64
from ladar_volume.volume.polygon import signed_area

#: Digits of a degree that are written: 1e-11 of it is a micrometre.
DIGITS = 11


@dataclass(frozen=True)
class Positions:
    """How points stand in a file.

    system : of the other files · degrees : points (n, 3), m, to longitude and latitude (n, 2);
    None where it is not known where on the earth they lie · words : what the positions are ·
    accuracy_m : of the change of datum, 0 for none, nan where there are no degrees · note : what
    a user is to know, empty for nothing
    """

    system: OutputSystem
    words: str
    degrees: Callable[[F64], F64] | None = None
    accuracy_m: float = math.nan
    note: str = ""

    def numbers(self, r_m: F64) -> F64:
        """Points (n, 3), m, as they stand in the file: (n, 2) degrees, or (n, 3) in the units of
        the other files.
        """
        if self.degrees is None:
            return self.system.numbers(r_m)
        out = np.round(self.degrees(r_m), DIGITS)
        if np.ptp(out[:, 0]) > 180.0:  # goes on beyond 180° instead of around the earth
            out[:, 0] += np.where(out[:, 0] < 0.0, 360.0, 0.0)
        return out

    def ring(self, r_m: F64, hole: bool = False) -> list[list[float]]:
        """A ring (k, 3), m, closed; counter-clockwise, a hole clockwise."""
        out = self.numbers(r_m)
        if (signed_area(out) < 0.0) is not hole:
            out = out[::-1]
        closed: list[list[float]] = np.vstack([out, out[:1]]).tolist()
        return closed

    def members(self) -> dict[str, Any]:
        """Members of the file that say what its positions are."""
        if self.degrees is not None:
            return {"positions": self.words, "accuracy_m": self.accuracy_m}
        return {"positions": self.words, "crs": crs_member(self.system)} | {
            "units": self.system.unit.name
        }


def crs_member(system: OutputSystem) -> dict[str, Any] | None:
    """The member ``crs`` of GeoJSON of 2008: a URN, WKT where there is no code, None for no
    system.
    """
    if system.crs is None:
        return None
    authority, _, codes = system.code.partition(":")
    name = f"urn:ogc:def:crs:{authority}::{codes.partition('+')[0]}" if codes else system.wkt
    return {"type": "name", "properties": {"name": name}}


def positions_of(system: OutputSystem, r_m: F64) -> Positions:
    """Positions of points (n, 3), m."""
    if system.datum is not None:
        frame = LocalFrame(system.datum)
        words = f"longitude, latitude (WGS 84) of {system.name}"
        return Positions(system, words, lambda r: frame.to_geodetic(r)[:, 1::-1], 0.0)
    if system.crs is None:
        return in_the_system(system, "no CRS is known")
    middle = system.numbers(np.median(r_m[:, :2], axis=0))
    place = place_of(system.crs, *middle.tolist())
    if place is None:
        return in_the_system(system, f"{system.name} does not say where that is")
    return in_degrees(system, place)


def in_degrees(system: OutputSystem, place: tuple[float, float]) -> Positions:
    """Longitude and latitude by pyproj, about a place in degrees."""
    from pyproj import CRS

    assert system.crs is not None
    wgs84 = CRS.from_epsg(4326)
    try:
        shift = datum_shift(system.crs, wgs84, place)
        back = datum_shift(wgs84, system.crs, place).transformer
    except InputError as error:
        return in_the_system(system, str(error))
    if math.isnan(shift.accuracy_m):
        return in_the_system(system, f"how {system.name} lies in WGS 84 is not known")

    def degrees(r_m: F64) -> F64:
        # the way back, which readers go, leads up to 1 mm beside where it began: taken off
        to, xy = shift.transformer, system.numbers(r_m[:, :2]).T
        off = np.array(back.transform(*to.transform(*xy))) - xy
        return np.column_stack(to.transform(*(xy - off)))

    note = f"longitude and latitude of the GeoJSON are known to {shift.accuracy_words}"
    return Positions(
        system,
        f"longitude, latitude (WGS 84) from {system.name}",
        degrees,
        shift.accuracy_m,
        f"{note}: {system.name} to WGS 84" if shift.doubtful else "",
    )


def in_the_system(system: OutputSystem, why: str) -> Positions:
    """The numbers of the other files, and why."""
    words = f"x, y, z of the other files, not longitude and latitude: {why}"
    return Positions(system, words, note=f"the GeoJSON holds {words}")
