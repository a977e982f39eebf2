"""The CRS of a LAS header: WKT records, or GeoTIFF keys with their units of length.

Keys after OGC GeoTIFF 1.1 (19-008r4), records after LAS 1.4 R15.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from ladar_volume.io.pointfiles.crs import Coordinates, coordinates_of, crs_of_text, parts_of
from ladar_volume.io.pointfiles.units import FOOT, METRE, US_FOOT, Unit, unit_of_size
from ladar_volume.model.errors import InputError

USER = "LASF_Projection"
WKT, DIRECTORY, DOUBLES, ASCII = 2112, 34735, 34736, 34737
#: Codes of units of length.
UNITS = {9001: METRE, 9002: FOOT, 9003: US_FOOT}
USER_DEFINED = 32767
#: Codes of vertical datums that writers give in place of a vertical CRS.
DATUMS = {5103: "NAVD88", 5102: "NGVD29", 5101: "Newlyn", 5129: "EVRF2000", 5773: "EGM96"}


def coordinates_of_records(records: Iterable[Any], wkt: bool) -> Coordinates | None:
    """What the projection records of a LAS header say; ``wkt``: the header's bit that its WKT
    counts. None where there are none. Raises :class:`InputError` (input_crs).
    """
    found: dict[int, bytes] = {}
    for record in records:
        if record.user_id == USER:
            found.setdefault(int(record.record_id), bytes(record.record_data_bytes()))
    text = found.get(WKT, b"").decode("utf-8", "replace").strip("\0 \n")
    directory = found.get(DIRECTORY)
    if text and (wkt or directory is None):
        return coordinates_of(crs_of_text(text, "the header"), "header")
    if directory is None:
        return None
    return of_keys(keys_of(directory, found.get(DOUBLES, b""), found.get(ASCII, b"")))


def keys_of(directory: bytes, doubles: bytes, text: bytes) -> dict[int, int | float | str]:
    """The GeoTIFF keys with their values. Raises :class:`InputError` (input_crs)."""
    out: dict[int, int | float | str] = {}
    try:
        count = struct.unpack_from("<4H", directory, 0)[3]
        for k in range(count):
            key, place, length, value = struct.unpack_from("<4H", directory, 8 + 8 * k)
            if place == DOUBLES:
                out[key] = float(struct.unpack_from("<d", doubles, 8 * value)[0])
            elif place == ASCII:
                out[key] = text[value : value + length].decode("latin-1").strip("|\0 ")
            else:
                out[key] = value
    except struct.error as error:
        raise InputError(
            "the GeoTIFF keys of the header are cut short", reason="input_crs"
        ) from error
    return out


def of_keys(keys: Mapping[int, int | float | str]) -> Coordinates | None:
    """CRS and units of GeoTIFF keys."""
    projected, geographic = _code(keys, 3072), _code(keys, 2048)
    length = _length(keys, 3076, 3077)
    flat: Coordinates | None = None
    if projected is not None:
        flat = coordinates_of(crs_of_text(f"EPSG:{projected}", "the header"), "header")
        if length is not None and flat.across is not None and not length.equals(flat.across):
            words = f"EPSG:{projected} is in {flat.across}, its key of units says {length}"
            flat = replace(flat, conflict=words)
    elif keys.get(1024) == 1 or length is not None:
        flat = Coordinates(across=length) if length is not None else None
    elif geographic is not None and keys.get(1024) in (2, None):
        flat = coordinates_of(crs_of_text(f"EPSG:{geographic}", "the header"), "header")
    elif keys.get(1024) == 2:
        raise InputError(
            "the header says degrees of an unnamed datum: give --crs EPSG:...", reason="input_crs"
        )
    elif keys.get(1024) == 3:
        raise InputError("geocentric X, Y, Z: transform to a projected CRS", reason="input_crs")
    return _with_heights(flat, keys)


def _with_heights(
    flat: Coordinates | None, keys: Mapping[int, int | float | str]
) -> Coordinates | None:
    code, unit = _code(keys, 4096), _length(keys, 4099, None)
    if code is None and unit is None:
        return flat
    flat = flat or Coordinates()
    name = str(keys[4097]) if isinstance(keys.get(4097), str) else None
    vertical = None
    if code is not None:
        try:
            vertical = crs_of_text(f"EPSG:{code}", "the header")
        except InputError:
            name = name or DATUMS.get(code, f"vertical code {code}")
    if vertical is None or not vertical.is_vertical:
        return replace(flat, up=unit or flat.up, heights=name or DATUMS.get(code or 0))
    own = coordinates_of_vertical(vertical)
    crs = flat.crs
    if crs is not None and parts_of(crs)[1] is None:
        from pyproj.crs import CompoundCRS

        crs = CompoundCRS(f"{crs.name} + {vertical.name}", [crs.to_2d(), vertical])
    # the key of units says what z is stored in, whatever unit the named system has
    return replace(flat, crs=crs, up=unit or own, heights=str(vertical.name))


def coordinates_of_vertical(vertical: Any) -> Unit:
    """The unit of a vertical CRS. Raises :class:`InputError` where it counts down."""
    axis = vertical.axis_info[0]
    if axis.direction.lower() == "down":
        raise InputError(
            f"CRS {vertical.name}: its heights count downwards: turn them first", reason="input_crs"
        )
    return unit_of_size(axis.unit_name, axis.unit_conversion_factor)


def _code(keys: Mapping[int, int | float | str], key: int) -> int | None:
    value = keys.get(key)
    return value if isinstance(value, int) and 1024 <= value < USER_DEFINED else None


def _length(keys: Mapping[int, int | float | str], key: int, size: int | None) -> Unit | None:
    value = keys.get(key)
    if not isinstance(value, int) or value == 0:
        return None
    if value in UNITS:
        return UNITS[value]
    metres = keys.get(size) if size is not None else None
    if value == USER_DEFINED and isinstance(metres, float) and metres > 0.0:
        return unit_of_size(f"unit of {metres:g} m", metres)
    from pyproj.database import get_units_map

    known = next(
        (u for u in get_units_map("EPSG", "linear").values() if u.code == str(value)), None
    )
    if known is None:
        raise InputError(f"the header's unit {value} is not known", reason="input_units")
    return unit_of_size(known.name, known.conv_factor)
