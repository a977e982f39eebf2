"""Surfaces of LandXML 1.x (and its kin Inframodel): points, faces, and the units they are in.

A point is "northing easting height", in the file's linear unit; read as x east, y north, z up, in
m. A face with ``i="1"`` is invisible, which is how a TIN marks what lies outside of its surface or
in a hole, and does not count. A file with a document type is refused, so entities expand to
nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

import numpy as np

from ladar_volume.model.errors import InputError, short_repr
from ladar_volume.model.records import F64, I32

#: Metres of a linear unit (LandXML 1.2, metLinear and impLinear), in lower case.
LINEAR_M = {
    "millimeter": 1e-3,
    "centimeter": 1e-2,
    "meter": 1.0,
    "kilometer": 1e3,
    "inch": 0.0254,
    "foot": 0.3048,
    "ussurveyfoot": 1200.0 / 3937.0,
    "mile": 1609.344,
}
#: Linear units that each unit of heights (elevationUnit) is the same as.
HEIGHTS = {
    "millimeter": ("millimeter",),
    "centimeter": ("centimeter",),
    "meter": ("meter",),
    "kilometer": ("kilometer",),
    "feet": ("foot", "ussurveyfoot"),
    "foot": ("foot", "ussurveyfoot"),
    "ussurveyfoot": ("ussurveyfoot",),
    "miles": ("mile",),
    "inch": ("inch",),
}


#: Most elements within each other; LandXML has about ten.
DEEPEST = 100
#: Path of a line within a surface.
BREAKLINE = ["SourceData", "Breaklines", "Breakline", "PntList3D"]


@dataclass
class Definition:
    """One surface as its file holds it: name · kind : TIN or grid · points : text by id · faces :
    text of the visible ones · invisible : number of the others · breaklines : text of each
    """

    name: str
    kind: str = "TIN"
    points: dict[str, str] = field(default_factory=dict)
    faces: list[str] = field(default_factory=list)
    invisible: int = 0
    breaklines: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class LandSurface:
    """vertices : (n, 3) m, east, north, height · faces : (m, 3) or one array each · name · unit :
    the file's linear unit, empty where it names none · epsg : code of its horizontal frame, or
    empty · invisible : faces that do not count · wkt : of its system, or empty · breaklines :
    (k, 3) m each
    """

    vertices: F64
    faces: list[I32] | I32
    name: str
    unit: str
    epsg: str
    invisible: int
    wkt: str = ""
    breaklines: tuple[F64, ...] = ()


def invalid_surface(words: str, reason: str = "mesh_file_values") -> InputError:
    """The error of this reader."""
    return InputError(words, reason=reason)


class Scan:
    """What the elements of a LandXML file hold, gathered while it is read."""

    def __init__(self) -> None:
        self.path: list[str] = []
        self.units: dict[str, str] | None = None
        self.epsg = self.wkt = ""
        self.surfaces: list[Definition] = []
        self.key = ""
        self.text: list[str] | None = None

    def start(self, name: str, attributes: dict[str, str]) -> None:
        """An element begins."""
        tag = name.rsplit(":", 1)[-1]
        if not self.path and tag != "LandXML":
            raise invalid_surface(f"no LandXML: its root is <{tag}>", "mesh_file_header")
        if len(self.path) == DEEPEST:
            raise invalid_surface(f"elements within each other over more than {DEEPEST} levels")
        self.path.append(tag)
        inside = self.path[1:2] == ["Surfaces"] and self.surfaces
        if self.path[1:-1] == ["Units"]:
            self.units = {"system": tag, **attributes}
        elif self.path[1:] == ["CoordinateSystem"]:
            self.epsg = attributes.get("epsgCode", "")
            self.wkt = attributes.get("ogcWktCode", "")
        elif self.path[1:] == ["Surfaces", "Surface"]:
            self.surfaces.append(Definition(attributes.get("name", "")))
        elif inside and self.path[3:] == ["Definition"]:
            self.surfaces[-1].kind = attributes.get("surfType", "TIN")
        elif inside and self.path[3:] == ["Definition", "Pnts", "P"]:
            self.key, self.text = attributes.get("id", ""), []
        elif inside and self.path[3:] == BREAKLINE:
            self.text = []
        elif inside and self.path[3:] == ["Definition", "Faces", "F"]:
            if attributes.get("i", "0").strip() == "1":
                self.surfaces[-1].invisible += 1
            else:
                self.text = []

    def data(self, words: str) -> None:
        """Text of an element."""
        if self.text is not None:
            self.text.append(words)

    def end(self, name: str) -> None:
        """An element ends."""
        tag = self.path.pop()
        if self.text is None:
            return
        text, self.text, surface = "".join(self.text), None, self.surfaces[-1]
        if tag == "F":
            surface.faces.append(text)
        elif tag == "PntList3D":
            surface.breaklines.append(text)
        elif self.key in surface.points:
            raise invalid_surface(f"surface {surface.name!r}: point {self.key!r} is there twice")
        else:
            surface.points[self.key] = text


def refuse_doctype(*_: object) -> None:
    """A document type could define entities."""
    raise invalid_surface(
        "it has a document type (<!DOCTYPE ...>), which is not read", "mesh_file_header"
    )


def scan(path: Path) -> Scan:
    """The elements of a file. Raises :class:`InputError` (mesh_file_header) and OSError."""
    found, parser = Scan(), expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler, parser.EndElementHandler = found.start, found.end
    parser.CharacterDataHandler = found.data
    parser.StartDoctypeDeclHandler = refuse_doctype
    try:
        with path.open("rb") as file:
            parser.ParseFile(file)
    except (expat.ExpatError, LookupError, ValueError) as error:  # the latter two: its encoding
        words = f"no well-formed XML: {short_repr(str(error))}"
        raise invalid_surface(words, "mesh_file_header") from error
    return found


def metres(units: dict[str, str] | None) -> tuple[float, str]:
    """Metres of the file's linear unit, and its name; 1 and nothing where the file names none.
    Raises :class:`InputError` (landxml_units) for a unit that is not known, or heights in another
    one than positions.
    """
    if units is None:
        return 1.0, ""
    name = units.get("linearUnit", "")
    key, high = name.lower(), units.get("elevationUnit", "").lower()
    if key not in LINEAR_M:
        known = "millimeter, centimeter, meter, kilometer, foot, USSurveyFoot, inch, mile"
        raise invalid_surface(f"its linear unit is {name!r}, none of {known}", "landxml_units")
    if high and key not in HEIGHTS.get(high, ()):
        raise invalid_surface(
            f"positions are in {name!r} and heights in {units['elevationUnit']!r}: write both in "
            "one unit (attributes linearUnit and elevationUnit of Units)",
            "landxml_units",
        )
    return LINEAR_M[key], name


def choose_surface(surfaces: list[Definition], name: str | None) -> Definition:
    """The surface of that name, or the only one. Raises :class:`InputError` (landxml_surface)."""
    names = ", ".join(repr(s.name) for s in surfaces)
    if not surfaces:
        raise invalid_surface("there is no surface in it", "mesh_file_empty")
    if name is None and len(surfaces) > 1:
        raise invalid_surface(
            f"it holds {len(surfaces)} surfaces: choose one of {names}", "landxml_surface"
        )
    found = surfaces if name is None else [s for s in surfaces if s.name == name]
    if len(found) != 1:
        many = "no surface" if not found else f"{len(found)} surfaces"
        raise invalid_surface(f"{many} named {name!r} among {names}", "landxml_surface")
    return found[0]


def read_landxml(path: Path, name: str | None = None) -> LandSurface:
    """One surface of a LandXML file, the only one or that of a name.

    Raises :class:`InputError`: mesh_file_header (no LandXML), landxml_units, landxml_surface,
    mesh_file_values, mesh_file_index, mesh_file_empty, mesh_file_fields (a grid); and OSError.
    """
    found = scan(path)
    to_m, unit = metres(found.units)
    surface = choose_surface(
        [s for s in found.surfaces if s.faces or s.invisible or s.points], name
    )
    if surface.kind.lower() != "tin":
        raise invalid_surface(
            f"surface {surface.name!r} is a {surface.kind}, no TIN", "mesh_file_fields"
        )
    if not surface.faces:
        raise invalid_surface(f"surface {surface.name!r} has no visible face", "mesh_file_empty")
    try:
        rows = [list(map(float, text.split())) for text in surface.points.values()]
        lines = [list(map(float, text.split())) for text in surface.breaklines]
    except ValueError as error:
        raise invalid_surface(f"a value that is no number: {error}") from error
    if any(len(r) != 3 for r in rows) or any(len(line) % 3 for line in lines):
        raise invalid_surface("a point that is not northing, easting, height")
    place = {key: k for k, key in enumerate(surface.points)}
    try:
        faces = [[place[key] for key in text.split()] for text in surface.faces]
    except KeyError as error:
        raise invalid_surface(
            f"a face names point {error}, which is not there", "mesh_file_index"
        ) from error
    xyz = np.array(rows, dtype=np.float64).reshape(-1, 3)[:, [1, 0, 2]] * to_m
    alike = {len(f) for f in faces} == {3}
    out = np.array(faces, np.int32) if alike else [np.array(f, np.int32) for f in faces]
    kept = tuple(in_map(line, to_m) for line in lines if line)
    more = found.epsg, surface.invisible, found.wkt, kept
    return LandSurface(xyz, out, surface.name, unit, *more)


def in_map(numbers: list[float], to_m: float) -> F64:
    """Northing, easting, height, ... as points (k, 3), m, east, north, height. Raises
    :class:`InputError` (mesh_file_values) for what is not finite.
    """
    out: F64 = np.array(numbers, dtype=np.float64).reshape(-1, 3)[:, [1, 0, 2]] * to_m
    if not np.isfinite(out).all():
        raise invalid_surface("a breakline with a coordinate that is not finite")
    return out
