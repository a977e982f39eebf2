"""The coordinate system that files are written in: metres, or the units of the file that was read;
of a survey its own east, north, up, or a map projection.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ladar_volume.io.pointfiles.crs import code_of, crs_of_text, parts_of
from ladar_volume.io.pointfiles.metres import MapCoordinates, stretch
from ladar_volume.io.pointfiles.units import METRE, Unit
from ladar_volume.model.errors import ConfigurationError, InputError
from ladar_volume.model.records import F64, Datum

if TYPE_CHECKING:
    from pyproj import CRS

#: Datums farther than this, m, from WGS 84 at the site are not the receiver's own.
SAME_DATUM_M = 2.5


def plain_words(text: str) -> str:
    """Text that every format can hold: no control characters, no halves of characters."""
    return "".join(c if c.isprintable() else "?" for c in text)


@dataclass(frozen=True)
class OutputSystem:
    """crs : of the numbers in the files, None where none is known · unit : of all three axes ·
    scale : part by which lengths on the map are longer than those that V is computed from · datum :
    that the numbers are east, north, up about; None for others
    """

    crs: CRS | None = None
    unit: Unit = METRE
    scale: float = 1.0
    datum: Datum | None = None

    def numbers(self, r_m: F64) -> F64:
        """Lengths or coordinates in m, any shape, as they stand in the files."""
        return r_m if self.unit.metres == 1.0 else r_m / self.unit.metres

    @property
    def code(self) -> str:
        """Authority and code, as "EPSG:25832"; empty where there is none."""
        return "" if self.crs is None else code_of(self.crs) or ""

    @property
    def name(self) -> str:
        """The system in words; empty where none is known."""
        return "" if self.crs is None else plain_words(str(self.crs.name))

    @property
    def wkt(self) -> str:
        """WKT of the system on one line; empty where none is known."""
        return "" if self.crs is None else plain_words(str(self.crs.to_wkt()))

    @property
    def unit_word(self) -> str:
        """The unit as ``--units`` has it."""
        word = {"metre": "m", "international foot": "ft", "US survey foot": "us-ft"}
        return word.get(self.unit.name, self.unit.name)

    def notes(self) -> list[str]:
        """Lines for the head of a file, as the readers of this program understand them."""
        units = f"units: {self.unit_word}"
        return [f"crs: {self.wkt}", units] if self.crs is not None else [units]


def system_of_cloud(at: MapCoordinates, file_units: bool) -> OutputSystem:
    """The system of a cloud's metres, or with ``file_units`` of its file. Raises
    :class:`ConfigurationError` where the file has no one unit of length.
    """
    if not file_units:
        return OutputSystem(at.crs)
    if at.across is None or not at.across.equals(at.up):
        words = "degree" if at.across is None else f"{at.across.name}, heights {at.up.name}"
        raise ConfigurationError(
            f"--file-units: the file is in {words}, and the files need one unit of length for all "
            "axes: leave --file-units out",
            value=words,
        )
    return OutputSystem(at.file_coordinates.crs, at.across)


def local_system(datum: Datum) -> OutputSystem:
    """East, north, up about a datum, as an engineering system in WKT: true lengths."""
    from pyproj import CRS

    place = f"{datum.latitude_deg:.9f} N, {datum.longitude_deg:.9f} E, {datum.height_m:.4f} m"
    axes = "".join(
        f'AXIS["{name} ({letter})",{name},ORDER[{k}],LENGTHUNIT["metre",1]],'
        for k, (name, letter) in enumerate((("east", "E"), ("north", "N"), ("up", "U")), 1)
    ).rstrip(",")
    wkt = (
        f'ENGCRS["east, north, up about {place} (WGS 84)",'
        f'EDATUM["plane tangent to the ellipsoid at {place}"],CS[Cartesian,3],{axes}]'
    )
    return OutputSystem(CRS.from_wkt(wkt), datum=datum)


def projection(datum: Datum, text: str) -> OutputSystem:
    """A projected system in metres for a survey about a datum; heights are above the ellipsoid.

    Latitude and longitude of the survey are taken as those of the projection's own datum, which is
    what a receiver gives that is corrected in it. Raises :class:`InputError` (input_crs) for what
    is no such system, is on a datum farther than 2.5 m from WGS 84 there, or stretches areas.
    """
    from pyproj import Transformer

    crs = crs_of_text(text, "--crs")
    flat, vertical = parts_of(crs)
    geodetic = None if flat is None else flat.geodetic_crs
    if flat is None or geodetic is None or not flat.is_projected or vertical is not None:
        raise InputError(
            f"--crs {text}: a projected system without heights is needed, such as a UTM zone "
            "(heights of a survey are above the ellipsoid)",
            reason="input_crs",
            value=text,
        )
    if any(abs(axis.unit_conversion_factor - 1.0) > 1e-12 for axis in flat.axis_info[:2]):
        raise InputError(
            f"--crs {text}: its axes are in {flat.axis_info[0].unit_name}: name one in metres",
            reason="input_crs",
            value=text,
        )
    there = (datum.longitude_deg, datum.latitude_deg)
    one, two = (
        np.array(Transformer.from_crs(source, flat.to_2d(), always_xy=True).transform(*there))
        for source in (geodetic.to_2d(), "EPSG:4326")
    )
    apart = float(np.hypot(*(one - two)))
    if not apart <= SAME_DATUM_M:
        raise InputError(
            f"--crs {text}: it lies {apart:.3g} m from WGS 84 at the survey: name a system on the "
            "receiver's datum",
            reason="input_crs",
            value=text,
        )
    scale, _ = stretch(np.array([[*one, datum.height_m]]), flat)
    return OutputSystem(flat.to_3d(), METRE, scale or 1.0)


def in_projection(r_geodetic: F64, system: OutputSystem) -> F64:
    """Latitude, longitude (deg), ellipsoidal height (m), (n, 3), as x, y, z of a projection."""
    from pyproj import Transformer

    assert system.crs is not None
    flat = system.crs.to_2d()
    assert flat.geodetic_crs is not None
    change = Transformer.from_crs(flat.geodetic_crs.to_2d(), flat, always_xy=True)
    x, y = change.transform(r_geodetic[:, 1], r_geodetic[:, 0])
    out: F64 = np.column_stack([x, y, r_geodetic[:, 2]])
    return out
