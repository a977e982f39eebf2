"""What is in a file of outlines: GeoJSON, Shapefile, GeoPackage, KML, DXF and FlatGeobuf as GDAL
reads them (pyogrio), and text in WKT.
"""

from __future__ import annotations

import codecs
import json
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ladar_volume.io.pointfiles.crs import crs_of_text
from ladar_volume.model.errors import InputError

if TYPE_CHECKING:
    from pyproj import CRS
    from shapely.geometry.base import BaseGeometry

#: Endings of files with outlines.
OUTLINE_ENDINGS = (".geojson", ".json", ".shp", ".gpkg", ".kml", ".dxf", ".wkt", ".fgb")
#: Most outlines of a file, and most corners of each.
MOST, MOST_CORNERS = 10_000, 10_000
#: Largest file, and deepest brackets of WKT.
MOST_BYTES, DEEPEST = 2**28, 20
#: How files of an ending begin; text after what XML may have before its root.
_PROLOG = rb"(?s)\s*(?>(?><\?.*?\?>|<!--.*?-->)\s*)*+"
BEGINS = {
    ".geojson": re.compile(rb"\s*\{"),
    ".json": re.compile(rb"\s*\{"),
    ".shp": re.compile(rb"\x00\x00\x27\x0a"),
    ".gpkg": re.compile(rb"SQLite format 3\x00"),
    ".fgb": re.compile(rb"fgb"),
    ".kml": re.compile(_PROLOG + rb"<(?:kml:)?kml\b"),
    ".dxf": re.compile(rb"AutoCAD Binary DXF|\s*(?:0|999)\s*\n"),
}
#: Columns of a file: names in small letters, of which several may be alike, and values.
Columns = Sequence[tuple[str, Sequence[Any]]]


@dataclass(frozen=True)
class Features:
    """shapes : geometries, x and y as they stand · columns : names and values, one a shape · crs :
    of the file, None where it names none · default_crs : whether the format and not the file
    names it · no_geometry : rows without a shape
    """

    shapes: list[BaseGeometry]
    columns: Columns
    crs: CRS | None
    default_crs: bool = False
    no_geometry: int = 0


def features_of(path: Path) -> Features:
    """What is in the file. Raises :class:`InputError`."""
    if not path.is_file():
        raise InputError(f"{path}: no such file", reason="input_file", value=str(path))
    check_kind(path)
    if path.suffix.lower() == ".wkt":
        return wkt_features(path)
    import pyogrio
    import shapely

    pyogrio.set_gdal_config_options({"DXF_CLOSED_LINE_AS_POLYGON": "TRUE"})
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what matters of them is found below
            meta, _, wkb, values = pyogrio.raw.read(path, max_features=MOST + 1)
            some = [bytes(w) for w in wkb if w is not None]
            shapes = [shapely.from_wkb(w) for w in some]
    except Exception as error:  # a damaged file fails anywhere inside GDAL and its drivers
        raise InputError(
            f"{path.name}: no outlines can be read: {brief(error, path)}", reason="input_outlines"
        ) from error
    if len(shapes) > MOST:
        raise InputError(f"{path.name}: more than {MOST:,} shapes", reason="input_outlines")
    kept = [w is not None for w in wkb]
    columns = [
        (str(name).lower(), [v for v, keep in zip(column, kept, strict=True) if keep])
        for name, column in zip(meta["fields"], values, strict=True)
    ]
    crs = None if meta["crs"] is None else crs_of_text(str(meta["crs"]), path.name)
    members = json_members(path) if path.suffix.lower() in (".geojson", ".json") else None
    if members is not None and members.get("crs", crs) is None:
        crs = None  # null says that none is known; GDAL takes it for degrees
    by_format = members is not None and "crs" not in members
    return Features(shapes, columns, crs, by_format, kept.count(False))


def json_members(path: Path) -> dict[str, Any]:
    """Members of a JSON object; none where Python cannot read what GDAL can."""
    try:
        members = json.loads(path.read_text("utf-8-sig", "ignore"))
    except (ValueError, RecursionError):
        return {}
    return members if isinstance(members, dict) else {}


def wkt_features(path: Path) -> Features:
    """Text with one geometry a line, empty lines and those that begin with # left out."""
    import shapely

    try:
        lines = path.read_text("utf-8").splitlines()
        rows = [line for line in lines if line.strip() and not line.lstrip().startswith("#")]
        if any(depth(line) > DEEPEST for line in rows):
            raise ValueError(f"brackets within more than {DEEPEST} brackets")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # NaN: such rings are refused below
            shapes = [shapely.from_wkt(line) for line in rows[: MOST + 1]]
    except Exception as error:  # NotImplementedError of curves among them
        raise InputError(
            f"{path.name}: no WKT, one geometry a line: {brief(error, path)}",
            reason="input_outlines",
        ) from error
    return Features(shapes, (), None)


def check_kind(path: Path) -> None:
    """Refuse a file whose content is not what its ending says: GDAL goes by the content, and some
    of what it opens leads to other files and to the network. Raises :class:`InputError`.
    """
    ending, why = path.suffix.lower(), ""
    with path.open("rb") as stream:
        start = stream.read(65_536).removeprefix(codecs.BOM_UTF8)
    if ending not in OUTLINE_ENDINGS:
        why = f"its ending is none of {', '.join(OUTLINE_ENDINGS)}"
    elif path.stat().st_size > MOST_BYTES:
        why = f"larger than {MOST_BYTES // 2**20} MB"
    elif ending in BEGINS and not BEGINS[ending].match(start):
        why = f"it does not begin as a {ending} file does"
    if why:
        raise InputError(
            f"{path.name}: no outlines can be read: {why}", reason="input_outlines", value=str(path)
        )


def depth(line: str) -> int:
    """Most brackets that are open at once: GEOS reads them by recursion, without a bound."""
    steps = np.frombuffer(line.encode("utf-8", "replace"), np.uint8)
    open_ = np.cumsum((steps == ord("(")).astype(np.int64) - (steps == ord(")")))
    return int(open_.max(initial=0))


def brief(error: Exception, path: Path) -> str:
    """The first line of a library's error, without the folder."""
    lines = str(error).replace(str(path), path.name).splitlines() or [type(error).__name__]
    return lines[0][:160]
