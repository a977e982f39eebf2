"""GeoJSON of outlines and contours, with heights, in the coordinate system of the other files.

The member ``crs`` names the system, as GeoJSON of 2008 has it and GIS programs read it: longitude
and latitude, which RFC 7946 asks for, would need a shift of datum that no file tells.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ladar_volume.io.export.contour_lines import contours, interval_of
from ladar_volume.io.export.deliverable import Deliverable
from ladar_volume.io.export.output_system import OutputSystem
from ladar_volume.io.results import finite
from ladar_volume.model.records import F64


def crs_member(system: OutputSystem) -> dict[str, Any] | None:
    """The member ``crs``: a URN, WKT where there is no code, None for no system."""
    if system.crs is None:
        return None
    authority, _, codes = system.code.partition(":")
    name = f"urn:ogc:def:crs:{authority}::{codes.partition('+')[0]}" if codes else system.wkt
    return {"type": "name", "properties": {"name": name}}


def write_features(path: Path, name: str, system: OutputSystem, features: Iterable[Any]) -> None:
    """A FeatureCollection, one feature a line."""
    head = {"name": name, "crs": crs_member(system), "units": system.unit.name}
    text = json.dumps({"type": "FeatureCollection", **head})[:-1] + ', "features": [\n'
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(text)
        for number, feature in enumerate(features):
            file.write(",\n" if number else "")
            file.write(json.dumps(finite(feature), allow_nan=False))
        file.write("\n]}\n")


def ring(points: F64, system: OutputSystem) -> list[list[float]]:
    """A ring (k, 3), m, closed, as coordinates."""
    out: list[list[float]] = system.numbers(np.vstack([points, points[:1]])).tolist()
    return out


def outline_features(d: Deliverable) -> Iterator[dict[str, Any]]:
    """A polygon for each part that counts, with its volume where each has one."""
    same = len(d.rows) == len(d.polygons) and (len(d.rows) == 1 or bool(d.outlines))
    for number, polygon in enumerate(d.polygons, 1):
        rings = [ring(each, d.system) for each in (polygon.outer, *polygon.holes)]
        named = d.rows[number - 1] if same else {}
        facts = {**named, "part": number, "area_m2": polygon.area_m2}
        geometry = {"type": "Polygon", "coordinates": rings}
        yield {"type": "Feature", "properties": facts, "geometry": geometry}


def write_outline(path: Path, d: Deliverable) -> None:
    """Outlines of what counts."""
    write_features(path, f"outline of {d.name}", d.system, outline_features(d))


def contour_features(d: Deliverable, interval: float | None) -> Iterator[dict[str, Any]]:
    """Contours of the surface; the interval is in the units of the files."""
    tin, to = d.tin, d.system.unit.metres
    triangles = tin.triangles[tin.relevant]
    # levels are whole multiples in the file's own units
    r = np.column_stack([tin.vertices[:, :2], tin.vertices[:, 2] / to])
    z = r[np.unique(triangles), 2]
    step = interval_of(float(z.min()), float(z.max())) if interval is None else interval
    for contour in contours(r, triangles, step):
        line = np.column_stack([contour.line / to, np.full(len(contour.line), contour.height_m)])
        geometry = {"type": "LineString", "coordinates": line.tolist()}
        facts = {"height": contour.height_m, "index": contour.index}
        yield {"type": "Feature", "properties": facts, "geometry": geometry}


def write_contours(path: Path, d: Deliverable, interval: float | None) -> None:
    """Contours of the surface."""
    write_features(path, f"contours of {d.name}", d.system, contour_features(d, interval))
