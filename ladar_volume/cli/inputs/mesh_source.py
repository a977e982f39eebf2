"""Mesh files as surfaces on the command line: the options, what contradicts them, what is said."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.clouds.mesh_surface import mesh_surface
from ladar_volume.io.meshfiles.mesh_files import MeshFile, holds_faces, read_mesh
from ladar_volume.model.errors import ConfigurationError
from ladar_volume.model.records import F64, Tin
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.model.verdict import Doubt
from ladar_volume.tin.locate import height_at
from ladar_volume.tin.scan_frame import Frame

#: Options that say how points become a surface, and what they are where no one gives them.
OF_POINTS = {
    "screen": None,
    "median": None,
    "window": None,
    "duplicates": 0.0,
    "bins": None,
    "clean": "auto",
}
#: Breaklines farther than this above or below their faces, m, are not kept.
OFF_M = 0.01
#: Options that thinning needs.
OF_THINNING = {
    "criterion": "residual-area",
    "adjust": "rms",
    "iterations": None,
    "height_tolerance": None,
    "exchange": "none",
}


def read_faces(path: Path, arguments: argparse.Namespace, second: bool = False) -> MeshFile | None:
    """The mesh in a file; None for a point cloud. Raises :class:`ConfigurationError` for a surface
    by name where there are only points.
    """
    a = arguments
    name = getattr(a, "surface_b", None) if second else a.surface
    if holds_faces(path):
        return read_mesh(path, name)
    if name is not None:
        raise ConfigurationError(
            f"{path} is a point cloud: --surface is for a LandXML or DXF", value=name
        )
    return None


def reduces_vertices(arguments: argparse.Namespace) -> bool:
    """Whether fewer vertices than the file has are asked for."""
    return arguments.tolerance is not None or arguments.vertices not in (None, 1.0)


def surface_of_mesh(
    arguments: argparse.Namespace,
    mesh: MeshFile,
    path: Path,
    options: SurfaceParameters,
    frame: Frame | None,
    sigma: tuple[F64 | float | None, str],
) -> CloudSurface:
    """The faces of a mesh as a surface. Raises :class:`ConfigurationError` for options of points
    and :class:`SurfaceError` for a mesh that is no surface.
    """
    thin = reduces_vertices(arguments)
    wrong = dict(OF_POINTS) if thin else {**OF_POINTS, **OF_THINNING}
    for name, default in wrong.items():
        if getattr(arguments, name) != default:
            word = name.replace("_", "-")
            how = "with --vertices or --tolerance, or " if name in OF_THINNING else ""
            raise ConfigurationError(
                f"{path} is a mesh, whose faces are taken as they are: --{word} applies {how}with "
                "--no-faces",
                value=name,
            )
    r = mesh.vertices if frame is None else frame.points(mesh.vertices)
    surface = mesh_surface(r, mesh.triangles, options, *sigma, thin)
    if frame is not None or not mesh.breaklines:
        return surface
    return dataclasses.replace(
        surface, doubts=surface.doubts + breakline_doubts(mesh, surface.representation.tin)
    )


def breakline_doubts(mesh: MeshFile, tin: Tin) -> tuple[Doubt, ...]:
    """Whether faces leave the breaklines that their file says they keep."""
    lines = np.concatenate(mesh.breaklines)
    apart = np.abs(height_at(tin, lines[:, :2]) - lines[:, 2])
    off = int(np.count_nonzero(apart > OFF_M))
    if not off:
        return ()
    most = float(np.nanmax(apart))
    words = (
        f"{off} of {len(lines)} points of the breaklines lie up to {most:.3g} m above or below the "
        "faces: the TIN does not keep them; triangulate it again"
    )
    return (Doubt("mesh_breaklines", words, most),)


def mesh_facts(mesh: MeshFile) -> dict[str, Any]:
    """What the JSON says of a mesh as its file holds it."""
    return {
        "vertices": len(mesh.vertices),
        "faces": len(mesh.triangles),
        "dropped_faces": mesh.dropped,
        "duplicate_faces": mesh.twice,
        "invisible_faces": mesh.invisible,
        "joined_vertices": mesh.joined,
        "joined_within_m": mesh.joined_m,
        "surface": mesh.surface or None,
        "unit": mesh.unit or None,
        "epsg": mesh.epsg or None,
        "breaklines": len(mesh.breaklines),
    }


def face_facts(mesh: MeshFile, surface: CloudSurface) -> dict[str, Any]:
    """What the JSON says of a mesh as a surface."""
    found = surface.given_faces
    if found is None:
        return mesh_facts(mesh)
    return {
        **mesh_facts(mesh),
        "vertical_faces": found.vertical,
        "turned_faces": found.clockwise_faces,
        "unused_vertices": found.unused_vertices,
        "parts": found.parts,
        "overlap_m2": found.overlap.area_m2,
    }


def mesh_doubts(
    paths: Sequence[Path], meshes: Sequence[MeshFile | None], surfaces: Sequence[CloudSurface]
) -> tuple[Doubt, ...]:
    """What is doubtful about meshes as surfaces and the files they are from, by name where there
    are several; nothing of point clouds, whose mesh is None.
    """
    out: list[Doubt] = []
    for path, mesh, surface in zip(paths, meshes, surfaces, strict=True):
        name = f"{path.name}: " if len(paths) > 1 else ""
        own = () if mesh is None else (*mesh.doubts, *surface.doubts)
        out += [Doubt(d.name, name + d.text, d.value) for d in own]
    return tuple(out)


def noise_doubts(paths: Sequence[Path], surfaces: Sequence[CloudSurface]) -> tuple[Doubt, ...]:
    """That a volume has no standard deviation, since a mesh has none, and what gives it one."""
    unknown = [surface.sigma_m is None for surface in surfaces]
    if not any(unknown):
        return ()
    at = unknown.index(True)
    text = (
        f"the heights of {paths[at].name} have no standard deviation, so the volume has none: give "
        f"{('--sigma', '--sigma-b')[at]}, 0 for a design, which is exact"
    )
    return (Doubt("no_sigma", text),)


def mesh_words(facts: dict[str, Any]) -> str:
    """One line on a mesh: its faces, and whatever about them is out of the ordinary."""
    words = [f"{facts['faces']:,} faces as given"]
    if facts["surface"]:
        words.append(f"surface '{facts['surface']}'")
    if facts["unit"]:
        words.append(f"in {facts['unit']}")
    names = {
        "parts": "parts",
        "vertical_faces": "vertical",
        "invisible_faces": "invisible",
        "dropped_faces": "without area",
        "duplicate_faces": "double",
        "turned_faces": "turned round",
        "joined_vertices": "vertices joined",
        "unused_vertices": "vertices in no face",
    }
    for key, name in names.items():
        if facts.get(key, 0) > (1 if key == "parts" else 0):
            words.append(f"{facts[key]:,} {name}")
    return ", ".join(words)
