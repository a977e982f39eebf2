"""From the coordinates of a file to metres: units converted, degrees projected, and what makes that
doubtful.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ladar_volume.io.pointfiles.crs import Coordinates, Reading, code_of, parts_of
from ladar_volume.io.pointfiles.units import METRE, Unit
from ladar_volume.model.errors import CloudError, InputError
from ladar_volume.model.records import F64
from ladar_volume.model.verdict import Doubt

if TYPE_CHECKING:
    from laspy import LasHeader
    from pyproj import CRS

#: A CRS that stretches areas by more than this holds no volume (Web Mercator: 2.4 at 50°).
MOST_STRETCH = 0.02
#: Largest coordinate, m: beyond it a double has steps of micrometres.
FARTHEST_M = 1e10
#: Smallest coordinate but 0, m: squares of smaller ones are none that a double holds.
SMALLEST_M = 1e-100
#: Whole numbers without a unit that spread further than this are hardly metres.
WHOLE_FROM = 500.0
#: Degrees are told from metres by heights that spread this many times more than the site is wide.
STEEP = 20.0
#: Systems that name longitude first, by their numbers in the EPSG register.
LONGITUDE_FIRST = {"CRS84": 4326, "CRS83": 4269, "CRS27": 4267}
#: Least share of a metre that one radian of latitude and longitude stands for: the earth's radius.
EARTH_M = 6_371_000.0


@dataclass(frozen=True)
class MapCoordinates:
    """The system of a cloud's metres.

    crs : of the metres, None where no CRS is named · file_coordinates : as they stood in the file ·
    across, up : units that were read, assumed ones included · factor : m per unit of x, y and of z
    (nan for degrees) · grid_scale : part by which lengths on the map are longer than on the
    ellipsoid
    """

    crs: CRS | None = None
    file_coordinates: Coordinates = field(default_factory=lambda: Coordinates(said_by="nothing"))
    across: Unit | None = METRE
    up: Unit = METRE
    factor: tuple[float, float] = (1.0, 1.0)
    grid_scale: float | None = None
    ground_factor: float | None = None

    def as_dict(self) -> dict[str, Any]:
        """For the JSON."""
        code = None if self.crs is None else code_of(self.crs)
        return {
            "crs": None if self.crs is None else self.crs.name,
            "code": code,
            "wkt": None if self.crs is None else self.crs.to_wkt(),
            "read_crs": self.file_coordinates.name
            if self.file_coordinates.crs is not None
            else None,
            "units_read": "degree" if self.across is None else self.across.name,
            "units_read_z": self.up.name,
            "units": "m",
            "units_from": "assumed"
            if self.file_coordinates.said_by == "nothing"
            else self.file_coordinates.said_by,
            "heights": self.file_coordinates.heights,
            "grid_scale": self.grid_scale,
            "volume_on_ground_factor": self.ground_factor,
        }

    @property
    def are_metres(self) -> bool:
        """Whether the metres are the file's own numbers."""
        return self.across is not None and self.factor == (1.0, 1.0)

    def crs_to_write(self, las: LasHeader | None, as_wkt: bool = False) -> CRS | None:
        """The system for a LAS file of these metres; None where the header that they were read with
        says the same already, and ``as_wkt`` says it so.
        """
        kept = las is not None and self.are_metres and self.file_coordinates.said_by == "header"
        kept = kept and (not as_wkt or bool(las is not None and las.global_encoding.wkt))
        return None if kept else self.crs

    def keeps(self, crs: CRS | None, unit: Unit) -> bool:
        """Whether coordinates in this system and unit are those that stood in the file."""
        if self.across is None or not (self.across.equals(unit) and self.up.equals(unit)):
            return False
        return crs is self.crs if self.are_metres else crs is self.file_coordinates.crs

    def notes(self) -> list[str]:
        """Lines for the header of a file that holds these metres."""
        if self.crs is not None:
            return [f"crs: {self.crs.to_wkt()}", "units: m"]
        return [] if self.file_coordinates.said_by == "nothing" else ["units: m"]

    @property
    def words(self) -> str:
        """One line for a person."""
        name = "no CRS named" if self.crs is None else (code_of(self.crs) or self.crs.name)
        units = "degree" if self.across is None else self.across.name
        both = units if self.up.name == units else f"{units}, heights {self.up.name}"
        change = " → m" if (units, self.up.name) != ("metre", "metre") else ""
        assumed = " (assumed)" if self.file_coordinates.said_by == "nothing" else ""
        heights = (
            f"; heights above {self.file_coordinates.heights}"
            if self.file_coordinates.heights
            else ""
        )
        return f"{name}; units: {both}{change}{assumed}{heights}"


def to_metres(
    r: F64, declared: Coordinates, reading: Reading
) -> tuple[F64, MapCoordinates, list[Doubt]]:
    """Points (n, 3) in m, changed in place where no CRS needs more. Raises :class:`InputError` and
    :class:`CloudError` for coordinates that contradict what is said of them.
    """
    doubts: list[Doubt] = []
    across = declared.across if declared.across is not None else None if declared.degrees else METRE
    up = declared.up or across or METRE
    if declared.up is None and across is not None and not across.equals(METRE):
        words = (
            f"the header gives {across.name} for x and y and no unit of z: z is taken in the same, "
            f"and V would be {1.0 / across.metres:.4g} times as large if z were in metres; confirm "
            "with --units"
        )
        doubts.append(Doubt("height_unit", words, 1.0 / across.metres))
    if declared.said_by == "nothing":
        doubts += whole_number_doubts(r)
    asked = reading.refuse_degrees or declared.crs is not None
    if not declared.degrees and reading.across is None and asked:
        refuse_degrees(r, declared)
    if up.metres != 1.0:
        r[:, 2] *= up.metres
    crs, factor = declared.crs, (np.nan, up.metres)
    if across is None:
        doubts += axis_order_doubts(r, declared)
        crs = project_to_utm(r, declared)
    else:
        factor = (across.metres, up.metres)
        if across.metres != 1.0:
            r[:, :2] *= across.metres
        if crs is not None and factor != (1.0, 1.0):
            crs = metric(crs)
    refuse_far(r)
    round_specks(r)
    scale, ground = (None, None) if crs is None else stretch(r, crs)
    return r, MapCoordinates(crs, declared, across, up, factor, scale, ground), doubts


def refuse_far(r: F64) -> None:
    """Refuse coordinates (n, 3) that no survey has. Raises :class:`CloudError`."""
    far = float(np.abs(r).max())
    if not far <= FARTHEST_M:
        raise CloudError(
            f"a coordinate of {far:.3g} m: beyond what a survey holds (most {FARTHEST_M:g} m)",
            reason="cloud_values",
            value=far,
        )


def round_specks(r: F64) -> None:
    """Coordinates (n, 3) that are 0 to whatever anybody measures become it, in place."""
    specks = np.abs(r) < SMALLEST_M
    specks &= r != 0.0
    if specks.any():
        r[specks] = 0.0


def refuse_degrees(r: F64, declared: Coordinates) -> None:
    """Refuse coordinates that look like longitude and latitude. Raises :class:`InputError`
    (input_degrees).
    """
    with np.errstate(over="ignore", invalid="ignore"):
        some = r[:: max(1, len(r) // 20_000)]
        low, mid, high = np.percentile(some, (1.0, 50.0, 99.0), axis=0)
        wide, tall = float((high - low)[:2].max()), float((high - low)[2])
        inside = bool((np.abs(some[:, 0]) <= 180.0).all() and (np.abs(some[:, 1]) <= 90.0).all())
        away = float(np.abs(mid[:2]).max())
        if len(r) < 4 or not inside or not 0.0 < wide < 5.0 or away < 5.0 * wide:
            return
    if tall > STEEP * wide:
        who = (
            f"though the header says {declared.name}"
            if declared.crs is not None
            else "and no CRS is named"
        )
        raise InputError(
            f"coordinates about {mid[0]:.5g}, {mid[1]:.5g} spread over {wide:.2g}, heights over "
            f"{tall:.3g}: they look like degrees, {who}; give --crs EPSG:4326 (or the true one), "
            "or --units m if they are metres",
            reason="input_degrees",
            value=[float(mid[0]), float(mid[1])],
        )


def whole_number_doubts(r: F64) -> list[Doubt]:
    """Coordinates (n, 3) without a unit that are all whole numbers and spread far: no survey in
    metres is rounded so, one in millimetres or centimetres is.
    """
    some = r[:: max(1, len(r) // 20_000)]
    wide = float(np.ptp(some[:, :2], axis=0).max(initial=0.0)) if len(some) else 0.0
    if not WHOLE_FROM < wide < np.inf or not (some == np.rint(some)).all():
        return []
    words = (
        f"nothing names a unit, and all coordinates are whole numbers over {wide:.3g}: they are "
        "taken for metres, and V would be 1e-09 times as large if they are millimetres; give "
        "--units"
    )
    return [Doubt("units_whole", words, wide)]


def axis_order_doubts(r: F64, declared: Coordinates) -> list[Doubt]:
    """Degrees by an option alone, whose system names latitude first: x is taken for longitude, as
    in every file of points, and nothing says whether it is, where both may be latitudes.
    """
    flat = None if declared.crs is None else parts_of(declared.crs)[0]
    if flat is None or declared.said_by != "--crs" or flat.axis_info[0].direction != "north":
        return []
    x, y = (float(np.median(c)) for c in r.T[:2])
    if abs(x) > 84.0:
        return []
    ratio = float(np.cos(np.radians(x)) / np.cos(np.radians(y)))
    if abs(ratio - 1.0) < 1e-3:
        return []
    words = (
        f"x about {x:.5g} is taken for longitude and y about {y:.5g} for latitude, though "
        f"{declared.name} names latitude first: V would be {ratio:.3g} times as large the other "
        "way round; name the columns longitude and latitude, or give --crs OGC:CRS84"
    )
    return [Doubt("axis_order", words, ratio)]


def project_to_utm(r: F64, declared: Coordinates) -> CRS:
    """Project longitude and latitude, degrees, in place to the UTM zone of their median on the same
    datum (no datum is shifted); the CRS, heights included.
    """
    from pyproj import Transformer
    from pyproj.crs import CompoundCRS
    from pyproj.exceptions import ProjError

    if declared.crs is None:
        raise InputError(
            "longitude and latitude of an unnamed datum: give --crs, say EPSG:4326 (WGS 84) or "
            "EPSG:4258 (ETRS89)",
            reason="input_crs",
        )
    flat, vertical = parts_of(declared.crs)
    assert flat is not None
    flat = registered(flat)
    lon, lat = r[:, 0], r[:, 1]
    if not (np.abs(lon) <= 360.0).all() or not (np.abs(lat) <= 84.0).all():
        raise InputError(
            f"the CRS is {declared.name} in degrees, and coordinates reach "
            f"{np.abs(lon).max():.6g}, {np.abs(lat).max():.6g}: longitude (x) and "
            "latitude (y) up to 84 are needed",
            reason="input_degrees",
        )
    utm = utm_of(flat, float(np.median(lon)), float(np.median(lat)))
    try:
        change = Transformer.from_crs(flat.to_2d(), utm, always_xy=True)
    except ProjError as error:
        raise InputError(
            f"{declared.name} has no UTM zone: name the datum with --crs, or transform to a "
            "projected CRS first",
            reason="input_crs",
        ) from error
    r[:, 0], r[:, 1] = change.transform(lon, lat)
    if not np.isfinite(r[:, :2]).all():
        raise InputError(f"the points lie too far from {utm.name}: cut them first")
    if vertical is not None:
        return metric(CompoundCRS(f"{utm.name} + {vertical.name}", [utm, vertical]))
    return utm.to_3d() if len(flat.axis_info) > 2 else utm


def registered(flat: CRS) -> CRS:
    """An OGC system, longitude first, as the register has it; others as they are."""
    from pyproj import CRS

    authority, code = flat.to_authority() or ("", "")
    number = LONGITUDE_FIRST.get(code) if authority == "OGC" else None
    return flat if number is None else CRS.from_epsg(number)


def utm_of(flat: CRS, lon: float, lat: float) -> CRS:
    """The UTM zone of a place, degrees, on the datum of a geographic CRS; from the EPSG register
    where it is there.
    """
    from pyproj import CRS
    from pyproj.aoi import AreaOfInterest
    from pyproj.crs import ProjectedCRS
    from pyproj.crs.coordinate_operation import UTMConversion
    from pyproj.database import query_utm_crs_info

    lon = (lon + 180.0) % 360.0 - 180.0
    zone = min(60, int((lon + 180.0) // 6.0) + 1)
    half = "N" if lat >= 0.0 else "S"
    name = f"{flat.name} / UTM zone {zone}{half}"
    area = AreaOfInterest(lon, lat, lon, lat)
    for info in query_utm_crs_info(datum_name=flat.name, area_of_interest=area):
        if info.name == name:
            return CRS.from_epsg(int(info.code))
    conversion = UTMConversion(str(zone), hemisphere=half)
    return ProjectedCRS(conversion, name=name, geodetic_crs=flat.to_2d())


def metric(crs: CRS) -> CRS:
    """The same system with its lengths in metres; named so, and without the code of the other."""
    from pyproj import CRS

    description: dict[str, Any] = crs.to_json_dict()
    if description["type"] == "BoundCRS":
        return metric(CRS.from_json_dict(description["source_crs"]))
    description.pop("bbox", None)
    changed = False
    for part in description.get("components", [description]):
        if part["type"] == "BoundCRS":
            part.update(part.pop("source_crs"))
        axes = part.get("coordinate_system", {}).get("axis", [])
        feet = [a for a in axes if a.get("unit") != "metre" and a.get("unit") != "degree"]
        for axis in feet:
            axis["unit"] = "metre"
        if feet:
            changed = True
            part.pop("id", None)
            part["name"] = f"{part['name']}, in metres"
    if not changed:
        return crs
    description.pop("id", None)
    if "components" in description:
        description["name"] = " + ".join(p["name"] for p in description["components"])
    return CRS.from_json_dict(description)


def stretch(r: F64, crs: CRS) -> tuple[float | None, float | None]:
    """By how much lengths on the map are longer than on the ellipsoid at the middle of the points,
    and by what a volume is to be multiplied to hold on the ground there.

    Scale of areas after Snyder (1987), as PROJ gives it; heights as if above the ellipsoid, on a
    sphere. Raises :class:`InputError` (input_crs) for systems that stretch areas by more than 2 %.
    """
    from pyproj import Proj, Transformer
    from pyproj.exceptions import ProjError

    flat, _ = parts_of(crs)
    if flat is None or not flat.is_projected or flat.geodetic_crs is None:
        return None, None
    x, y, z = np.median(r[:: max(1, len(r) // 20_000)], axis=0)
    try:
        plane = flat.to_2d()
        back = Transformer.from_crs(plane, flat.geodetic_crs.to_2d(), always_xy=True)
        lon, lat = back.transform(x, y, errcheck=True)
        areal = float(Proj(plane).get_factors(lon, lat, errcheck=True).areal_scale)
    except ProjError as error:
        raise InputError(
            f"{x:.0f}, {y:.0f} lies nowhere in {flat.name}: the CRS, its units or the order of the "
            "axes is wrong; say which holds with --crs or --units",
            reason="input_crs",
        ) from error
    if abs(areal - 1.0) > MOST_STRETCH:
        raise InputError(
            f"{flat.name} makes areas, and so volumes, {areal:.3f} times as large here: "
            "reproject to a UTM zone or the local grid first",
            reason="input_crs",
            value=areal,
        )
    return float(np.sqrt(areal)), float((1.0 + z / EARTH_M) ** 2 / areal)


def metres_of_steps(step: tuple[float, ...], to: MapCoordinates, latitude: float) -> F64:
    """Steps of the coordinates as they stood in the file, as m."""
    across, up = to.factor
    if to.across is None:
        degree = np.pi / 180.0 * EARTH_M
        return np.array(
            [step[0] * degree * np.cos(np.radians(latitude)), step[1] * degree, step[2] * up]
        )
    return np.array([step[0] * across, step[1] * across, step[2] * up])
