"""What a file or an option says of its coordinates: CRS, units, vertical datum (pyproj, loaded only
where a CRS is named).
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from ladar_volume.io.pointfiles.units import METRE, WORDS, Unit, unit_of_size, unit_of_word
from ladar_volume.model.errors import ConfigurationError, InputError

if TYPE_CHECKING:
    from pyproj import CRS


@dataclass(frozen=True)
class Coordinates:
    """Coordinates as they stand in a file.

    crs : the system, where one is named · across : unit of x and y; None for degrees and where
    nothing is said · up : unit of z, None where nothing is said · degrees : x and y are longitude
    and latitude · heights : what z is counted from, where that is said · said_by : "header",
    "--crs", "--units" · conflict : two statements of one header that exclude each other
    """

    crs: CRS | None = None
    across: Unit | None = None
    up: Unit | None = None
    degrees: bool = False
    heights: str | None = None
    said_by: str = "header"
    conflict: str | None = None

    @property
    def name(self) -> str:
        """The system in a few words."""
        if self.crs is None:
            return "degrees" if self.degrees else "no CRS"
        code = code_of(self.crs)
        return f"{self.crs.name} ({code})" if code else str(self.crs.name)


@dataclass(frozen=True)
class Reading:
    """Options of reading: crs : what pyproj understands, say "EPSG:25832" · across, up : units of
    x, y and of z · classes : those that are read; None: all but noise; empty: all ·
    refuse_degrees : of a file that names no CRS, where its coordinates look so
    """

    crs: str | None = None
    across: Unit | None = None
    up: Unit | None = None
    classes: tuple[int, ...] | None = None
    refuse_degrees: bool = True


def reading_units(text: str) -> tuple[Unit, Unit]:
    """Units of ``--units``: one word for all axes, or two with a comma, across and up."""
    words = [word.strip().lower() for word in text.split(",")]
    if not 1 <= len(words) <= 2 or not set(words) <= set(WORDS):
        raise ConfigurationError(
            f"--units {text}: one of {', '.join(WORDS)}, or two with a comma (across,up)",
            value=text,
        )
    return WORDS[words[0]], WORDS[words[-1]]


def code_of(crs: CRS) -> str | None:
    """Authority and code, as "EPSG:25832"; for a compound of two such, "EPSG:25832+7837"."""
    parts = [part.to_authority(min_confidence=100) for part in (crs.sub_crs_list or [crs])]
    if not all(parts) or len({a for a, _ in parts}) != 1:
        return None
    return f"{parts[0][0]}:{'+'.join(code for _, code in parts)}"


def crs_of_text(text: str, where: str) -> CRS:
    """A CRS from WKT, PROJJSON or a code. Raises :class:`InputError` (input_crs)."""
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        return CRS.from_user_input(text)
    except (CRSError, ValueError, TypeError) as error:
        brief = re.sub(r"\s+", " ", text)[:60]
        raise InputError(
            f"the CRS of {where} cannot be understood: {brief!r}", reason="input_crs", value=text
        ) from error


def coordinates_of(crs: CRS, said_by: str) -> Coordinates:
    """Units and datum of a CRS. Raises :class:`InputError` (input_crs) for systems that hold no
    volume: geocentric, axes of unlike units, depths that count down.
    """
    flat, vertical = parts_of(crs)
    if flat is None:
        raise _unfit(crs, "it has no horizontal part: name a projected CRS (--crs EPSG:...)")
    if flat.is_geocentric:
        raise _unfit(crs, "geocentric X, Y, Z have no up: transform to a projected CRS first")
    axes = flat.axis_info
    if len(axes) < 2 or abs(axes[0].unit_conversion_factor / axes[1].unit_conversion_factor - 1) > (
        1e-8
    ):
        raise _unfit(crs, "its two axes have unlike units: reproject first")
    up_axis = vertical.axis_info[0] if vertical else axes[2] if len(axes) > 2 else None
    if up_axis is not None and up_axis.direction.lower() == "down":
        raise _unfit(crs, "its heights count downwards: turn them first")
    if flat.is_geographic and abs(axes[0].unit_conversion_factor / 0.017453292519943295 - 1) > 1e-6:
        raise _unfit(crs, f"angles in {axes[0].unit_name}, not degrees: reproject first")
    heights = str(vertical.name) if vertical else None
    if heights is None and up_axis is not None:
        heights = f"ellipsoid ({flat.geodetic_crs.name if flat.geodetic_crs else flat.name})"
    return Coordinates(
        crs,
        None if flat.is_geographic else _unit(axes[0].unit_name, axes[0].unit_conversion_factor),
        None if up_axis is None else _unit(up_axis.unit_name, up_axis.unit_conversion_factor),
        flat.is_geographic,
        heights,
        said_by,
    )


def parts_of(crs: CRS) -> tuple[CRS | None, CRS | None]:
    """The horizontal and the vertical part, shifts to other datums taken off."""
    if crs.is_bound and crs.source_crs is not None:
        return parts_of(crs.source_crs)
    if not crs.is_compound:
        return (None, crs) if crs.is_vertical else (crs, None)
    parts = [p.source_crs if p.is_bound and p.source_crs else p for p in crs.sub_crs_list]
    return (
        next((p for p in parts if not p.is_vertical), None),
        next((p for p in parts if p.is_vertical), None),
    )


def _unit(name: str, factor: float) -> Unit:
    return unit_of_size(name, factor)


def _unfit(crs: CRS, why: str) -> InputError:
    return InputError(f"CRS {crs.name}: {why}", reason="input_crs", value=crs.name)


def same_crs(a: CRS, b: CRS) -> bool:
    """Whether two systems are one, whatever they are called and in whichever order they name their
    axes.
    """
    if a.equals(b, ignore_axis_order=True):
        return True
    codes = a.to_authority(min_confidence=70), b.to_authority(min_confidence=70)
    return codes[0] is not None and codes[0] == codes[1]


def reconcile(file: Coordinates | None, reading: Reading) -> Coordinates:
    """What holds of the coordinates: of the file and of the options, where these agree.

    Raises :class:`InputError` (input_crs, input_units) with both values where they do not.
    """
    said = file or Coordinates(said_by="nothing")
    if reading.crs is not None:
        said = _with_crs(said, coordinates_of(crs_of_text(reading.crs, "--crs"), "--crs"))
    if reading.across is not None and reading.up is not None:
        said = _with_units(said, reading.across, reading.up)
    if said.conflict is not None:
        raise InputError(
            f"the header contradicts itself: {said.conflict}; say which holds with --units",
            reason="input_units",
        )
    return said


def _with_crs(declared: Coordinates, given: Coordinates) -> Coordinates:
    if declared.crs is not None and given.crs is not None:
        for mine, theirs in zip(parts_of(declared.crs), parts_of(given.crs), strict=True):
            if mine is not None and theirs is not None and not same_crs(mine, theirs):
                raise InputError(
                    f"the header says {declared.name}, --crs says {given.name}: which one holds?",
                    reason="input_crs",
                    value=[declared.name, given.name],
                )
        # the option may add the vertical part that the header lacks
        return (
            declared if parts_of(given.crs)[1] is None else replace(given, said_by="header, --crs")
        )
    for unit, other, axes in (
        (declared.across, given.across, "x and y"),
        (declared.up, given.up, "z"),
    ):
        if unit is not None and (given.degrees and axes != "z"):
            raise _contradiction("the file", unit, "--crs", "degrees", axes)
        if unit is not None and other is not None and not unit.equals(other):
            raise _contradiction("the file", unit, "--crs", other, axes)
    if declared.degrees and not given.degrees:
        raise _contradiction("the file", "degrees", "--crs", given.across or METRE, "x and y")
    both = "header, --crs" if declared.degrees else given.said_by
    up, heights = given.up or declared.up, given.heights or declared.heights
    return replace(given, up=up, heights=heights, said_by=both)


def _with_units(declared: Coordinates, across: Unit, up: Unit) -> Coordinates:
    who = "--crs" if declared.said_by == "--crs" else "the header"
    if declared.degrees:
        raise _contradiction(who, "degrees", "--units", across, "x and y")
    if (
        declared.across is not None
        and not declared.across.equals(across)
        and declared.conflict is None
    ):
        raise _contradiction(who, declared.across, "--units", across, "x and y")
    if declared.up is not None and not declared.up.equals(up):
        raise _contradiction(who, declared.up, "--units", up, "z")
    if declared.conflict is not None and across.name not in declared.conflict:
        raise InputError(f"{declared.conflict}, --units says {across}", reason="input_units")
    source = declared.said_by if declared.across is not None else "--units"
    return replace(declared, across=across, up=up, said_by=source, conflict=None)


def _contradiction(
    one: str, value: Unit | str, two: str, other: Unit | str, axes: str
) -> InputError:
    return InputError(
        f"{one} says {value} for {axes}, {two} says {other}: which one holds?",
        reason="input_units",
        value=[str(value), str(other)],
    )


#: A line of a PLY, PCD or text header that names the system, and one that names the units.
NOTE = re.compile(r"^(crs|units)\s*[:=]\s*(\S.*)$", re.IGNORECASE)


def of_comments(comments: list[str]) -> Coordinates | None:
    """What comments of a header say, lines ``crs: WKT`` and ``units: m``; None for nothing."""
    found = {m[1].lower(): m[2].strip() for c in comments if (m := NOTE.match(c.strip()))}
    if "crs" in found:
        return coordinates_of(crs_of_text(found["crs"], "the header"), "header")
    words = [unit_of_word(w) for w in found.get("units", "").split(",")]
    if words and all(words):
        return Coordinates(across=words[0], up=words[-1])
    return None
