"""The files of a result in a folder: which there are, what they need, and who writes them."""

from __future__ import annotations

import csv
import dataclasses
import importlib
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ladar_volume.io import results
from ladar_volume.io.export.deliverable import Deliverable
from ladar_volume.io.export.dxf_faces import write_dxf
from ladar_volume.io.export.formats import FORMATS
from ladar_volume.io.export.height_raster import write_tif
from ladar_volume.io.export.landxml_surfaces import write_landxml
from ladar_volume.io.export.map_features import write_contours, write_outline
from ladar_volume.io.export.scene_meshes import write_glb, write_obj, write_stl
from ladar_volume.io.meshfiles.tin_files import write_tin
from ladar_volume.io.output_set import output_set
from ladar_volume.io.pointfiles.cloud_files import flatten


@dataclass(frozen=True)
class ExportRequest:
    """formats : words of ``--as`` · cell : of a raster · interval : of contours; both in the units
    of the files, None for round ones
    """

    formats: Sequence[str]
    cell: float | None = None
    interval: float | None = None


@dataclass(frozen=True)
class ExportedFiles:
    """names : of the files · notes : sentences on what they hold that a user is to know"""

    names: list[str]
    notes: list[str]


def check_packages(formats: Sequence[str]) -> None:
    """Load what the formats need, before a long computation. Raises ModuleNotFoundError."""
    for name in formats:
        if FORMATS[name].needs:
            importlib.import_module(FORMATS[name].needs)


def write_export(folder: Path, d: Deliverable, request: ExportRequest) -> ExportedFiles:
    """Write the files into a folder, all or none. Raises OutputError."""
    names = [FORMATS[name].file for name in request.formats]
    every = [kind.file for kind in FORMATS.values()]
    with output_set(folder, every) as part:
        for name in request.formats:
            writer(name, request)(part / FORMATS[name].file, d)
    placed = {"geojson", "contours"} & set(request.formats)
    return ExportedFiles(names, [d.positions.note] if placed and d.positions.note else [])


def writer(name: str, request: ExportRequest) -> Callable[[Path, Deliverable], None]:
    """Who writes a format."""
    return {
        "json": write_json,
        "csv": write_rows,
        "las": write_points,
        "laz": write_points,
        "copc": write_points,
        "ply": write_surface,
        "tif": lambda path, d: write_tif(path, d, request.cell),
        "landxml": write_landxml,
        "dxf": write_dxf,
        "obj": write_obj,
        "stl": write_stl,
        "glb": write_glb,
        "geojson": write_outline,
        "contours": lambda path, d: write_contours(path, d, request.interval),
    }[name]


def write_json(path: Path, d: Deliverable) -> None:
    """The result."""
    results.write_text(path, results.json_text(d.facts))


def write_rows(path: Path, d: Deliverable) -> None:
    """One volume a row. A number that is not known is empty."""
    text = io.StringIO()
    table = csv.DictWriter(text, list(d.rows[0]), lineterminator="\n")
    table.writeheader()
    for row in d.rows:
        table.writerow({key: results.finite(value) for key, value in row.items()})
    results.write_text(path, text.getvalue())


def write_points(path: Path, d: Deliverable) -> None:
    """The points with their columns as LAS 1.4, in the system of the file that they were read from
    where that is the system of the files.
    """
    columns = {
        name: d.system.numbers(c) if name.startswith("sigma") else c
        for name, c in d.points.columns.items()
    }
    from ladar_volume.io.pointfiles.las_write import is_copc, write_las  # laspy only if needed

    flat, comments = flatten(d.system.numbers(d.points.r), columns, {}, path.suffix)
    like = d.points.like
    las = None if like is None else like.las
    kept = like is not None and like.coordinates.keeps(d.system.crs, d.system.unit)
    own = kept and like is not None and like.coordinates.file_coordinates.said_by == "header"
    own = own and las is not None and (las.global_encoding.wkt or not is_copc(path))
    write_las(path, flat, comments, las, None if own else d.system.crs, kept, "1.4")


def write_surface(path: Path, d: Deliverable) -> None:
    """The surface with sigma of its vertices."""
    tin = dataclasses.replace(d.tin, vertices=d.system.numbers(d.tin.vertices))
    sigma = None if d.sigma_m is None else d.system.numbers(d.sigma_m)
    write_tin(path, tin, sigma, notes=d.system.notes())
