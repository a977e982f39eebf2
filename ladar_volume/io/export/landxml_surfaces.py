"""LandXML 1.2: every part of a result as a TIN surface, with units, coordinate system and
breaklines.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterator
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from ladar_volume.io.export.deliverable import Deliverable, Part
from ladar_volume.io.export.output_system import OutputSystem
from ladar_volume.io.pointfiles.units import Unit
from ladar_volume.model.errors import OutputError
from ladar_volume.model.records import F64
from ladar_volume.version import version

NAMESPACE = "http://www.landxml.org/schema/LandXML-1.2"
#: Attributes of Units by the unit's name in this program.
METRIC = {"metre": "meter", "millimetre": "millimeter", "centimetre": "centimeter"}
METRIC |= {"kilometre": "kilometer"}
IMPERIAL = {"international foot": "foot", "US survey foot": "USSurveyFoot"}
#: Rows that are joined at a time.
CHUNK = 100_000
WHAT = {
    "surface": "the surface",
    "counted": "where the volume counts",
    "around": "the surface outside of that",
    "base": "what the volume stands on",
    "second": "the surface that it is compared with",
}


def write_landxml(path: Path, d: Deliverable) -> None:
    """Write the parts. Raises :class:`OutputError` for a unit that LandXML has no word for."""
    system = d.system
    with path.open("w", encoding="utf-8", newline="\n") as file:
        for text in head(d.name, system):
            file.write(text)
        for part in d.parts:
            lines = d.breaklines if part is d.parts[0] else ()
            for text in surface(part, system, list(lines)):
                file.write(text)
        file.write("</Surfaces>\n</LandXML>\n")


def units(unit: Unit) -> str:
    """The Units element."""
    if unit.name in METRIC:
        return (
            f'<Units><Metric areaUnit="squareMeter" linearUnit="{METRIC[unit.name]}" '
            'volumeUnit="cubicMeter" temperatureUnit="celsius" pressureUnit="HPA" '
            'angularUnit="decimal degrees" directionUnit="decimal degrees"/></Units>\n'
        )
    if unit.name in IMPERIAL:
        return (
            f'<Units><Imperial areaUnit="squareFoot" linearUnit="{IMPERIAL[unit.name]}" '
            'volumeUnit="cubicFeet" temperatureUnit="fahrenheit" pressureUnit="inHG" '
            'angularUnit="decimal degrees" directionUnit="decimal degrees"/></Units>\n'
        )
    raise OutputError(
        f"LandXML has no word for the unit {unit.name}: leave --file-units out, for metres",
        reason="output_units",
        value=unit.name,
    )


def head(name: str, system: OutputSystem) -> Iterator[str]:
    """Everything before the surfaces."""
    now = datetime.datetime.now(datetime.UTC)
    yield (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<LandXML xmlns="{NAMESPACE}" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" '
        f'xsi:schemaLocation="{NAMESPACE} {NAMESPACE}/LandXML-1.2.xsd" version="1.2" '
        f'date="{now:%Y-%m-%d}" time="{now:%H:%M:%S}" language="English" readOnly="false">\n'
    )
    yield units(system.unit)
    if system.crs is not None:
        code = system.code.partition(":")[2].partition("+")[0]
        epsg = f' epsgCode="{code}"' if system.code.startswith("EPSG:") else ""
        yield (
            f"<CoordinateSystem name={quoteattr(system.name)}{epsg} "
            f"ogcWktCode={quoteattr(system.wkt)}/>\n"
        )
    yield f"<Project name={quoteattr(name)}/>\n"
    yield f'<Application name="ladar_volume" version={quoteattr(version())}/>\n<Surfaces>\n'


def surface(part: Part, system: OutputSystem, breaklines: list[F64]) -> Iterator[str]:
    """One surface; points are "northing easting height"."""
    yield f"<Surface name={quoteattr(part.name)} desc={quoteattr(WHAT[part.name])}>\n"
    if breaklines:
        yield "<SourceData><Breaklines>\n"
        for line in breaklines:
            rows = system.numbers(line)[:, [1, 0, 2]].ravel().tolist()
            yield '<Breakline brkType="standard"><PntList3D>'
            yield " ".join(map(repr, rows)) + "</PntList3D></Breakline>\n"
        yield "</Breaklines></SourceData>\n"
    r = system.numbers(part.vertices)
    a, b, c = (r[part.triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    flat, steep = 0.5 * np.abs(normal[:, 2]).sum(), 0.5 * np.linalg.norm(normal, axis=1).sum()
    yield (
        f'<Definition surfType="TIN" area2DSurf="{flat!s}" area3DSurf="{steep!s}" '
        f'elevMin="{r[:, 2].min()!s}" elevMax="{r[:, 2].max()!s}">\n<Pnts>\n'
    )
    for first in range(0, len(r), CHUNK):
        rows = r[first : first + CHUNK, [1, 0, 2]].tolist()
        yield "".join(
            f'<P id="{n}">{y!r} {x!r} {z!r}</P>\n' for n, (y, x, z) in enumerate(rows, first + 1)
        )
    yield "</Pnts>\n<Faces>\n"
    for first in range(0, len(part.triangles), CHUNK):
        faces = (part.triangles[first : first + CHUNK] + 1).tolist()
        yield "".join(f"<F>{i} {j} {k}</F>\n" for i, j, k in faces)
    yield "</Faces>\n</Definition>\n</Surface>\n"
