"""DXF (R2010): every part as 3DFACEs on a layer of its name, the outlines as closed 3D polylines.

The document is made by ezdxf. Its faces, which may be millions, are written into it as text: they
take the place and the handles that ezdxf gives to a mark.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np

from ladar_volume.io.export.deliverable import Deliverable, Part
from ladar_volume.io.pointfiles.units import INSUNITS, Unit
from ladar_volume.model.errors import OutputError
from ladar_volume.model.records import F64

#: AutoCAD's colours of the layers.
COLOURS = {"surface": 3, "counted": 3, "around": 8, "base": 30, "second": 30, "outline": 1}
#: Faces that are joined at a time.
CHUNK = 20_000
#: A 3DFACE with three corners: the fourth repeats the third.
FACE = (
    "  0\n3DFACE\n  5\n%X\n330\n%s\n100\nAcDbEntity\n  8\n%s\n100\nAcDbFace\n"
    " 10\n%s\n 20\n%s\n 30\n%s\n 11\n%s\n 21\n%s\n 31\n%s\n"
    " 12\n%s\n 22\n%s\n 32\n%s\n 13\n%s\n 23\n%s\n 33\n%s\n"
)


@dataclass(frozen=True)
class Document:
    """begin, end : text before and after the faces · handle : the first that is free for them ·
    owner : handle of the model space
    """

    begin: str
    end: str
    handle: int
    owner: str


def write_dxf(path: Path, d: Deliverable) -> None:
    """Write the parts and outlines. Raises :class:`OutputError` for a unit that DXF has no code
    for.
    """
    frame = document(d, sum(len(part.triangles) for part in d.parts))
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(frame.begin)
        handle = frame.handle
        for part in d.parts:
            write_faces(file, part, d.system.numbers(part.vertices), handle, frame.owner)
            handle += len(part.triangles)
        file.write(frame.end)


def document(d: Deliverable, faces: int) -> Document:
    """A document with layers, units, system and outlines, and handles left for so many faces."""
    from ezdxf.document import Drawing

    doc = Drawing.new("AC1024")
    doc.units = units_of(d.system.unit)
    doc.header["$MEASUREMENT"] = 0 if "foot" in d.system.unit.name else 1
    for key, value in (("CRS", d.system.code or d.system.name), ("CRS WKT", d.system.wkt)):
        if value:
            doc.header.custom_vars.append(key, value)
    doc.header.custom_vars.append("units", d.system.unit.name)
    for name in (*(part.name for part in d.parts), "outline"):
        doc.layers.add(name, color=COLOURS[name])
    space = doc.modelspace()
    mark = space.add_point((0.0, 0.0, 0.0))
    for polygon in d.polygons:
        for ring in (polygon.outer, *polygon.holes):
            line = list(map(tuple, d.system.numbers(ring).tolist()))
            space.add_polyline3d(line, close=True, dxfattribs={"layer": "outline"})
    every = np.concatenate([d.system.numbers(part.vertices) for part in d.parts])
    space.reset_extents(every.min(axis=0).tolist(), every.max(axis=0).tolist())
    first = int(str(doc.entitydb.handles), 16)
    doc.entitydb.handles.reset(f"{first + faces:X}")
    out = io.StringIO()
    doc.write(out)
    text = out.getvalue()
    at = text.index(f"  0\nPOINT\n  5\n{mark.dxf.handle}\n")
    after = text.index("\n  0\n", at) + 1
    return Document(text[:at], text[after:], first, str(mark.dxf.owner))


def units_of(unit: Unit) -> int:
    """The code of a unit."""
    code = next((k for k, known in INSUNITS.items() if known.name == unit.name), None)
    if code is None:
        raise OutputError(
            f"DXF has no code for the unit {unit.name}: leave --file-units out, for metres",
            reason="output_units",
            value=unit.name,
        )
    return code


def write_faces(file: TextIO, part: Part, r: F64, handle: int, owner: str) -> None:
    """The faces of a part, its vertices (n, 3) in the units of the file; handles from ``handle``
    on.
    """
    words = [tuple(map(repr, row)) for row in r.tolist()]  # each vertex is in six faces
    for first in range(0, len(part.triangles), CHUNK):
        faces = part.triangles[first : first + CHUNK].tolist()
        file.write(
            "".join(
                FACE % (handle + n, owner, part.name, *words[i], *words[j], *words[k], *words[k])
                for n, (i, j, k) in enumerate(faces, first)
            )
        )
