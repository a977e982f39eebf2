"""What a reader finds in a file, before it is a cloud: columns and what the file says of them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ladar_volume.io.pointfiles.crs import Coordinates
from ladar_volume.io.pointfiles.units import Unit, unit_of_word
from ladar_volume.model.errors import CloudError
from ladar_volume.model.records import F64, Bool

if TYPE_CHECKING:
    from laspy import LasHeader

Columns = dict[str, npt.NDArray[Any]]

#: What the axes are called, the first where several are there; longitude and latitude apart.
AXES = {
    "x": (
        *("x", "easting", "east", "e", "eastings", "rechtswert", "ostwert", "este"),
        *("x_coord", "xcoord", "coord_x", "x_coordinate", "points_0"),
    ),
    "y": (
        *("y", "northing", "north", "n", "northings", "hochwert", "nordwert", "norte"),
        *("y_coord", "ycoord", "coord_y", "y_coordinate", "points_1"),
    ),
    "z": (
        *("z", "height", "elevation", "elev", "h", "altitude", "alt", "hoehe", "höhe", "rl"),
        *("reduced_level", "cota", "z_coord", "zcoord", "coord_z", "z_coordinate", "points_2"),
    ),
}
DEGREES = {"x": ("longitude", "lon", "long", "lng"), "y": ("latitude", "lat")}
#: Dimensions of LAS points that belong to a waveform.
WAVES = {
    "wavepacket_index",
    "wavepacket_offset",
    "wavepacket_size",
    "return_point_wave_location",
    "x_t",
    "y_t",
    "z_t",
}
#: No coordinate is larger, in any unit: it is damaged, and its square may not be a number.
FARTHEST = 1e12
#: No cloud is narrower, in any unit: areas and their squares would be zero.
NARROWEST = 1e-30
#: A name with its unit: ``X[m]``, ``Northing (us-ft)``.
UNIT = re.compile(r"^(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]$")


@dataclass(frozen=True)
class RawTable:
    """columns : by name, (n,) or (n, count), in file order · coordinates : what the file says of
    them · step : smallest step of x, y, z that the file can hold, in its own units · las : header
    of a LAS file
    """

    columns: Columns
    coordinates: Coordinates | None = None
    step: tuple[float, float, float] | None = None
    las: LasHeader | None = None


def plain_column_name(name: str) -> str:
    """A column's name without its unit, marks and case."""
    found = UNIT.match(name.strip())
    word = (found[1] if found else name).strip().strip("\"'").lower()
    return re.sub(r"[\s:]+", "_", word)


def axis_columns(names: Iterable[str]) -> tuple[dict[str, str], bool]:
    """The columns of x, y, z among the names, each where there is one, and whether x and y are
    longitude and latitude. Raises :class:`CloudError` (cloud_fields) for two of one axis.
    """
    given: dict[str, list[str]] = {}
    for name in names:
        given.setdefault(plain_column_name(name), []).append(name)
    exact = {n for n in given if n in "xyz"}
    out: dict[str, str] = {}
    degrees = not {"x", "y"} <= exact and any(n in given for k in DEGREES.values() for n in k)
    for axis in "xyz":
        words = DEGREES.get(axis, ()) if degrees else ()
        candidates = [n for w in (words or AXES[axis]) for n in given.get(w, [])]
        if axis in exact and not words:
            candidates = given[axis][:1]
        if len(candidates) > 1:
            raise CloudError(
                f"columns {' and '.join(candidates[:3])} may both be {axis}: rename one",
                reason="cloud_fields",
                value=candidates,
            )
        if candidates:
            out[axis] = candidates[0]
    return out, degrees


def units_of_names(names: dict[str, str]) -> Coordinates | None:
    """The units that the names of the axes carry. Raises :class:`CloudError` for x and y of unlike
    units.
    """
    units: dict[str, Unit] = {}
    for axis, name in names.items():
        if (found := UNIT.match(name.strip())) and (unit := unit_of_word(found[2])):
            units[axis] = unit
    if not units:
        return None
    x, y = units.get("x"), units.get("y")
    if x is not None and y is not None and not x.equals(y):
        raise CloudError(f"x is in {x}, y in {y}", reason="cloud_fields")
    return Coordinates(across=x or y, up=units.get("z"))


def float32_step(r: F64, single: tuple[bool, bool, bool]) -> tuple[float, float, float] | None:
    """The step of float32 at the largest finite coordinate of each axis that is stored so, or holds
    nothing but such numbers down to their last bit; 0 for the others, None for none.
    """
    out = [0.0, 0.0, 0.0]
    for k in range(3):
        column = r[:, k]
        column = column[np.isfinite(column)]
        far = float(np.abs(column).max()) if len(column) else 0.0
        if not 0.0 < far < float(np.finfo(np.float32).max):
            continue
        step = float(np.spacing(np.float32(far)))
        if single[k] or (
            bool((column == column.astype(np.float32)).all()) and not on_lattice(column, 2.0 * step)
        ):
            out[k] = step
    return (out[0], out[1], out[2]) if any(out) else None


def on_lattice(column: F64, step: float) -> bool:
    """Whether (almost) all of a column are multiples of a step."""
    some = column[:: max(1, len(column) // 20_000)] / step
    return bool((np.abs(some - np.round(some)) < 1e-6).mean() > 0.99)


def no_place(r: F64) -> str:
    """Why coordinates (n, 3), NaN for none, are none of a place; empty where they may be."""
    low, high = np.nanmin(r, axis=0, initial=np.inf), np.nanmax(r, axis=0, initial=-np.inf)
    return words_on_ends(np.column_stack([low, high]))


def words_on_ends(ends: F64) -> str:
    """Why coordinates between these (3, 2), least and greatest of each axis, are none of a place;
    infinite, the other way round, where an axis has none.
    """
    low, high = ends.T
    far = float(np.where(low <= high, np.maximum(np.abs(low), np.abs(high)), 0.0).max())
    if far > FARTHEST:
        return f"coordinates up to {far:.3g}: no place is so far; check the file or its export"
    wide = float((high - low).max())
    if 0.0 < wide < NARROWEST:
        return f"all points lie within {wide:.3g}: no place is so small; check the file"
    return ""


def rows_without_return(r: F64) -> Bool:
    """(n,) points with a NaN coordinate: no return. Raises :class:`CloudError` (cloud_not_finite,
    value: how many are not finite) where some are infinite.
    """
    # of numbers alone, all is said by their least and greatest
    ends = np.array([[c.min(initial=np.inf), c.max(initial=-np.inf)] for c in r.T])
    if np.isfinite(ends).all() and not words_on_ends(ends):
        return np.zeros(len(r), np.bool_)
    if np.isinf(r).any():
        bad = int(np.count_nonzero(~np.isfinite(r).all(axis=1)))
        raise CloudError(
            f"{bad} of {len(r)} points have a coordinate that is not finite, infinite ones among "
            "them: NaN alone means no return",
            reason="cloud_not_finite",
            value=bad,
        )
    refusal = no_place(r)
    if refusal:
        raise CloudError(refusal, reason="cloud_values")
    missing = np.isnan(r).any(axis=1)
    if missing.all():
        raise CloudError(
            f"all {len(r)} points are without a return: coordinates not finite (NaN)",
            reason="cloud_empty",
        )
    return np.asarray(missing)
