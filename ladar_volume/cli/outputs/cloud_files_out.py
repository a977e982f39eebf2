"""The files of ``ladar_volume volume -o``."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ladar_volume.cli.inputs.reading import Source, carried_columns
from ladar_volume.cli.outputs.file_choice import check_no_files, checked_choice
from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.ground.polynomial import base_height
from ladar_volume.io.export.deliverable import (
    Deliverable,
    SurfacePoints,
    faces_volume,
    file_facts,
    rows_of,
)
from ladar_volume.io.export.export_set import ExportedFiles, ExportRequest, write_export
from ladar_volume.io.export.output_system import OutputSystem, plain_words, system_of_cloud
from ladar_volume.model.errors import ConfigurationError
from ladar_volume.model.records import F64, Bool, Plane

#: Formats that hold standard deviations of the surface between its points.
OF_SURFACE = ("ply", "tif")


class ExportableResult(Protocol):
    """surfaces : of the files · base : of the first, None where the second is the base · counted :
    triangles (m,) of the first that count · outlines : polygons (k, 2) that cut these off ·
    facts : what the JSON says
    """

    @property
    def surfaces(self) -> Sequence[CloudSurface]: ...
    @property
    def base(self) -> Plane | None: ...
    @property
    def counted(self) -> Bool: ...
    @property
    def outlines(self) -> Sequence[F64]: ...
    @property
    def facts(self) -> Mapping[str, Any]: ...


def wanted_files(arguments: argparse.Namespace) -> ExportRequest | None:
    """The files that are asked for; None for none. Raises :class:`ConfigurationError` for options
    that contradict one another, and as :func:`checked_choice`.
    """
    if arguments.output is None:
        check_no_files(arguments)
        return None
    if arguments.frame != "level":
        raise ConfigurationError("-o writes maps: it goes with --frame level")
    return checked_choice(arguments)


def system_of_files(arguments: argparse.Namespace, sources: Sequence[Source]) -> OutputSystem:
    """The system of the files. Raises :class:`ConfigurationError` for ``--file-units`` of a file
    that has no one unit; to ask before a long computation.
    """
    return system_of_cloud(sources[0].cloud.coordinates, arguments.file_units)


def write_files(
    arguments: argparse.Namespace,
    request: ExportRequest,
    sources: Sequence[Source],
    result: ExportableResult,
) -> ExportedFiles:
    """Write the files. Raises OutputError."""
    system = system_of_files(arguments, sources)
    return write_export(arguments.output, deliverable(request, sources, result, system), request)


def deliverable(
    request: ExportRequest,
    sources: Sequence[Source],
    result: ExportableResult,
    system: OutputSystem,
) -> Deliverable:
    """The result as what files hold."""
    surface, tin = result.surfaces[0], result.surfaces[0].representation.tin
    base = None if result.base is None else base_height(result.base, tin.vertices[:, :2])
    covariance = None
    if surface.sigma_m is not None and set(request.formats) & set(OF_SURFACE):
        covariance = surface.representation.covariance(surface.sigma_m)
    # of two surfaces no one base makes the volume between them
    alone = len(result.surfaces) == 1
    volumes, outlines = result.facts.get("piles") or [result.facts], result.outlines
    volumes = [v for v in volumes if v.get("net_m3") is not None]
    parts = [[o] for o in outlines] if len(volumes) == len(outlines) > 1 else [outlines]
    own = base if alone else None
    faces = [faces_volume(tin, own, result.counted, part) for part in parts]
    points, lost = points_of(sources[0], surface)
    return Deliverable(
        name=plain_words(sources[0].path.stem),
        tin=tin,
        counted=result.counted,
        base_m=base,
        other=None if alone else result.surfaces[1].representation.tin,
        sigma_m=None if covariance is None else np.sqrt(covariance.diagonal()),
        covariance=covariance,
        points=points,
        facts={**result.facts, "files": file_facts(faces, system) | {"columns_lost": lost}},
        rows=rows_of(result.facts, volumes, faces),
        system=system,
        outlines=outlines,
        breaklines=() if sources[0].mesh is None else sources[0].mesh.breaklines,
    )


def points_of(source: Source, surface: CloudSurface) -> tuple[SurfacePoints, list[str]]:
    """The points that the surface is made from, with the attributes of their file, and the names of
    those that LAS cannot hold.
    """
    kept, lost = carried_columns(source.cloud, Path("points.laz"), ["index", "sigma_z"])
    columns = {name: values[surface.index] for name, values in kept.items()}
    columns["index"] = source.cloud.rows[surface.index]
    if surface.sigma_m is not None:
        columns["sigma_z"] = surface.sigma_m
    return SurfacePoints(surface.points, columns, source.cloud), lost
