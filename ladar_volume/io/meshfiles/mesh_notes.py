"""What the head of a mesh file says of its coordinates: comments of PLY, OBJ and OFF and the head
of an STL, as this program writes them; the system that a LandXML names.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ladar_volume.io.meshfiles.landxml import LandSurface
from ladar_volume.io.meshfiles.ply_mesh import read_mesh_header
from ladar_volume.io.pointfiles.crs import Coordinates, coordinates_of, crs_of_text, of_comments
from ladar_volume.io.pointfiles.metres import MapCoordinates, metric, stretch
from ladar_volume.io.pointfiles.units import METRE, SPELLINGS, WORDS, Unit, unit_of_word
from ladar_volume.model.errors import InputError
from ladar_volume.model.records import F64
from ladar_volume.model.verdict import Doubt

#: Bytes at the beginning that comments of the head lie in.
HEAD = 100_000
#: The head of an STL about a near origin.
ORIGIN = re.compile(rb"^binary stl origin (-?\d+) (-?\d+) (-?\d+) ([A-Za-z ]+?) *$")


def coordinates_of_head(path: Path, ending: str) -> Coordinates | None:
    """What the comments say, None for nothing. Raises :class:`InputError` (input_crs, and
    mesh_file_header for a damaged PLY).
    """
    with path.open("rb") as file:
        if ending == ".ply":
            return of_comments(read_mesh_header(file).comments)
        lines = file.read(HEAD).decode("utf-8", "replace").splitlines()
    notes: list[str] = []
    for line in lines:
        if line.startswith("#"):
            notes.append(line[1:].strip())
        elif line.strip() not in ("", "OFF"):
            break
    return of_comments(notes)


def stl_origin(path: Path) -> tuple[F64, Unit] | None:
    """The origin (3,) that the head of an STL names, in its unit; None for none."""
    with path.open("rb") as file:
        found = ORIGIN.match(file.read(80))
    if found is None:
        return None
    name = found[4].decode().lower()
    unit = next((u for u in WORDS.values() if u.name.lower() == name), unit_of_word(name))
    return np.array([float(found[k]) for k in (1, 2, 3)]), unit or METRE


def coordinates_of_land(land: LandSurface) -> tuple[MapCoordinates, tuple[Doubt, ...]]:
    """The system of a LandXML whose points are in m already; the doubt about one that is not
    known.
    """
    unit = WORDS.get(SPELLINGS.get(land.unit.lower(), land.unit.lower()), METRE)
    if land.unit.lower() == "ussurveyfoot":
        unit = WORDS["us-ft"]
    factor = (unit.metres, unit.metres)
    plain = Coordinates(across=unit, up=unit, said_by="header" if land.unit else "nothing")
    named = land.wkt or (f"EPSG:{land.epsg}" if land.epsg.strip().isdigit() else land.epsg)
    if not named.strip():
        return MapCoordinates(None, plain, unit, unit, factor), ()
    try:
        said = coordinates_of(crs_of_text(named, "the LandXML"), "header")
        if said.crs is None or said.degrees or said.across is None:
            raise InputError("it is not projected", reason="input_crs")
    except InputError as error:
        words = (
            f"{error}: 1 coordinate system of the LandXML is passed over; write its epsgCode anew"
        )
        return MapCoordinates(None, plain, unit, unit, factor), (Doubt("mesh_crs", words, 1.0),)
    crs = said.crs if unit is METRE and said.across.equals(METRE) else metric(said.crs)
    scale, ground = stretch(land.vertices, crs)
    return MapCoordinates(crs, said, unit, unit, factor, scale, ground), ()
