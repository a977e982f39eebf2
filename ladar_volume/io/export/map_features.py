"""GeoJSON of outlines and contours: longitude and latitude, with areas, volumes and heights of the
other files as properties.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ladar_volume.io.export.contour_lines import contours, interval_of
from ladar_volume.io.export.deliverable import Deliverable
from ladar_volume.io.export.positions import Positions
from ladar_volume.io.results import finite


def write_features(path: Path, name: str, d: Deliverable, features: Iterable[Any]) -> None:
    """A FeatureCollection, one feature a line."""
    head = {"type": "FeatureCollection", "name": name, **finite(d.positions.members())}
    text = json.dumps(head, allow_nan=False)[:-1] + ', "features": [\n'
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(text)
        for number, feature in enumerate(features):
            file.write(",\n" if number else "")
            file.write(json.dumps(finite(feature), allow_nan=False))
        file.write("\n]}\n")


def outline_features(d: Deliverable, at: Positions) -> Iterator[dict[str, Any]]:
    """A polygon for each part that counts, with its volume where each has one."""
    same = len(d.rows) == len(d.polygons) and (len(d.rows) == 1 or bool(d.outlines))
    for number, polygon in enumerate(d.polygons, 1):
        rings = [at.ring(polygon.outer)]
        rings += [at.ring(each, hole=True) for each in polygon.holes]
        z = polygon.outer[:, 2]
        facts = {
            **(d.rows[number - 1] if same else {}),
            "part": number,
            "area_m2": polygon.area_m2,
            "outline_lowest_m": float(z.min()),
            "outline_highest_m": float(z.max()),
        }
        geometry = {"type": "Polygon", "coordinates": rings}
        yield {"type": "Feature", "properties": facts, "geometry": geometry}


def write_outline(path: Path, d: Deliverable) -> None:
    """Outlines of what counts."""
    write_features(path, f"outline of {d.name}", d, outline_features(d, d.positions))


def contour_features(d: Deliverable, interval: float | None) -> Iterator[dict[str, Any]]:
    """Contours of the surface; the interval is in the units of the files, and so is the height,
    whose name has the unit.
    """
    tin, to = d.tin, d.system.unit.metres
    triangles = tin.triangles[tin.relevant]
    # levels are whole multiples in the file's own units
    r = np.column_stack([tin.vertices[:, :2], tin.vertices[:, 2] / to])
    z = r[np.unique(triangles), 2]
    step = interval_of(float(z.min()), float(z.max())) if interval is None else interval
    name = f"height_{d.system.unit_word.replace('-', '_')}"
    for contour in contours(r, triangles, step):
        level = np.full(len(contour.line), contour.height_m * to)
        line = d.positions.numbers(np.column_stack([contour.line, level]))
        line[:, 2:] = contour.height_m  # to its last digit, where there is a third coordinate
        geometry = {"type": "LineString", "coordinates": line.tolist()}
        facts = {name: contour.height_m, "index": contour.index}
        yield {"type": "Feature", "properties": facts, "geometry": geometry}


def write_contours(path: Path, d: Deliverable, interval: float | None) -> None:
    """Contours of the surface."""
    write_features(path, f"contours of {d.name}", d, contour_features(d, interval))
