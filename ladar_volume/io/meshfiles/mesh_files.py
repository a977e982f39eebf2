"""Mesh files: PLY, OBJ, STL, OFF, LandXML and DXF, by the ending of their name, read here so that
coordinates keep every digit and bad files are refused.

Polygons are cut into triangles (:mod:`~ladar_volume.io.meshfiles.polygons`). STL has no shared
vertices: those at one position become one. Vertices along open edges that differ in their last
digits only are joined (:func:`~ladar_volume.mesh.welding.weld_open`), triangles without area by a
vertex that they have twice are left out, and of faces that are there twice one counts.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ladar_volume.io.atomic_write import atomic_file
from ladar_volume.io.endings import ENDINGS, LANDXML, READ_ENDINGS
from ladar_volume.io.meshfiles.dxf_meshes import read_dxf
from ladar_volume.io.meshfiles.landxml import read_landxml
from ladar_volume.io.meshfiles.mesh_notes import (
    coordinates_of_head,
    coordinates_of_land,
    stl_origin,
)
from ladar_volume.io.meshfiles.plain_meshes import read_obj, read_off, read_stl
from ladar_volume.io.meshfiles.ply_mesh import read_mesh_header, read_ply_mesh, write_ply_mesh
from ladar_volume.io.meshfiles.polygons import Faces, triangulate_faces
from ladar_volume.io.pointfiles.crs import Coordinates, Reading, reconcile
from ladar_volume.io.pointfiles.metres import MapCoordinates, to_metres
from ladar_volume.io.pointfiles.point_file import columns_in_metres
from ladar_volume.io.pointfiles.raw_table import no_place
from ladar_volume.mesh.topology import vertices_of
from ladar_volume.mesh.welding import distinct_triangles, split_edges, weld, weld_open
from ladar_volume.model.errors import InputError, OutputError
from ladar_volume.model.records import F64, I32
from ladar_volume.model.verdict import Doubt

#: Single-precision coordinates whose steps are wider than this part of the median edge are a doubt.
COARSE = 1e-3


@dataclass(frozen=True)
class MeshFile:
    """A mesh as its file holds it.

    vertices : (n, 3) float64, m, all finite · triangles : (m, 3) int32 · dropped : triangles with a
    corner twice, as they are or as joining vertices leaves them, and both sides of nothing · twice
    : triangles that were there already · joined, joined_m : vertices that were joined along open
    edges, and how far apart they were at most · invisible : faces of a LandXML that do not count ·
    columns : of the vertices, (n,), from a PLY · surface : name in a LandXML, layer of a DXF · unit
    : linear unit that a LandXML names · epsg : code of its frame · stated_coordinates : what the
    head says of the coordinates, which are as the file holds them until :func:`in_metres` · at :
    their system once they are in metres · breaklines : of a LandXML, (k, 3) m each · doubts : what
    makes it doubtful
    """

    vertices: F64
    triangles: I32
    dropped: int = 0
    twice: int = 0
    joined: int = 0
    joined_m: float = 0.0
    invisible: int = 0
    columns: Mapping[str, npt.NDArray[Any]] = field(default_factory=dict)
    surface: str = ""
    unit: str = ""
    epsg: str = ""
    stated_coordinates: Coordinates | None = None
    at: MapCoordinates | None = None
    breaklines: tuple[F64, ...] = ()
    doubts: tuple[Doubt, ...] = ()


def holds_faces(path: str | Path) -> bool:
    """Whether a file is a mesh: by its ending, and a PLY by whether its header announces faces."""
    path = Path(path)
    if path.suffix.lower() != ".ply":
        return path.suffix.lower() in READ_ENDINGS
    try:
        with path.open("rb") as file:
            elements = read_mesh_header(file).elements
    except (OSError, InputError):
        return False  # the reader of clouds says what is wrong
    return any(e.name == "face" and e.rows > 0 for e in elements)


def _read_kind(path: Path, ending: str, surface: str | None) -> MeshFile:
    """The mesh of a file by its ending."""
    if ending in LANDXML:
        return _read_land(path, surface)
    if ending == ".dxf":
        drawn = read_dxf(path, surface)
        mesh = _assemble(drawn.vertices, drawn.faces)
        return dataclasses.replace(
            mesh,
            surface=drawn.layer,
            stated_coordinates=drawn.said,
            doubts=mesh.doubts + drawn.doubts,
        )
    if surface is not None:
        raise InputError(
            "only a LandXML and a DXF have surfaces with names", reason="landxml_surface"
        )
    if ending == ".stl":
        soup = _finite(read_stl(path))
        origin = stl_origin(path)
        soup = soup if origin is None else soup + origin[0]
        said = None if origin is None else Coordinates(across=origin[1], up=origin[1])
        vertices, triangles, dropped = weld(
            soup, np.arange(len(soup), dtype=np.int32).reshape(-1, 3)
        )
        return _repair(
            MeshFile(vertices, triangles, dropped, stated_coordinates=said), origin is None
        )
    said = coordinates_of_head(path, ending)
    if ending == ".ply":
        vertices, faces, columns = read_ply_mesh(path)
        return dataclasses.replace(_assemble(vertices, faces, columns), stated_coordinates=said)
    mesh = _assemble(*(read_obj if ending == ".obj" else read_off)(path))
    return dataclasses.replace(mesh, stated_coordinates=said)


def read_mesh(path: str | Path, surface: str | None = None) -> MeshFile:
    """Read a mesh file; of a LandXML or DXF with several surfaces that of a name.

    Raises :class:`InputError`: input_missing, input_unreadable, input_format (unknown ending),
    mesh_file_header, mesh_file_short, mesh_file_values, mesh_file_fields, mesh_file_empty (no
    face), mesh_file_index (a face names a vertex that is not there), landxml_units,
    landxml_surface.
    """
    path = Path(path)
    ending = path.suffix.lower()
    if ending not in READ_ENDINGS:
        raise InputError(
            f"{path}: no known kind of mesh file ({', '.join(READ_ENDINGS)})",
            reason="input_format",
            value=str(path),
        )
    if not path.exists():
        raise InputError(f"{path}: no such file", reason="input_missing", value=str(path))
    try:
        return _read_kind(path, ending, surface)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read: {error}", reason="input_unreadable", value=str(path)
        ) from error
    except MemoryError as error:
        raise InputError(
            f"{path}: larger than the memory", reason="mesh_file_values", value=str(path)
        ) from error
    except InputError as error:
        raise InputError(f"{path}: {error}", reason=error.reason, value=error.value) from error


def _read_land(path: Path, surface: str | None) -> MeshFile:
    land = read_landxml(path, surface)
    mesh = _assemble(land.vertices, land.faces)
    doubts = mesh.doubts
    if not land.unit:
        text = (
            "the LandXML names no units: its numbers are taken for metres; give it a Units element"
        )
        doubts += (Doubt("mesh_units", text),)
    at, more = coordinates_of_land(land)
    return dataclasses.replace(
        mesh,
        invisible=land.invisible,
        surface=land.name,
        unit=land.unit,
        epsg=land.epsg,
        at=at,
        breaklines=land.breaklines,
        doubts=doubts + more,
    )


def in_metres(mesh: MeshFile, reading: Reading) -> MeshFile:
    """A mesh as its file holds it, in metres and with its system, as the head and the options say.
    Raises :class:`InputError` (input_crs, input_units) where these contradict one another.
    """
    if mesh.at is not None:
        return mesh
    said = reconcile(mesh.stated_coordinates, reading)
    # a body may be as tall and narrow as degrees look
    asked = dataclasses.replace(reading, refuse_degrees=False)
    vertices, at, more = to_metres(mesh.vertices.copy(), said, asked)
    columns = columns_in_metres(dict(mesh.columns), at)
    doubts = mesh.doubts + tuple(more)
    if mesh.surface and said.said_by == "nothing":  # a DXF
        text = "the DXF names no units: its numbers are taken for metres; say which with --units"
        doubts += (Doubt("mesh_units", text),)
    return dataclasses.replace(mesh, vertices=vertices, columns=columns, at=at, doubts=doubts)


def _finite(vertices: F64) -> F64:
    if not np.isfinite(vertices).all():
        raise InputError("a coordinate that is not finite", reason="mesh_file_values")
    if refusal := no_place(vertices):
        raise InputError(refusal, reason="mesh_file_values")
    return vertices


def _assemble(
    vertices: F64, faces: Faces, columns: Mapping[str, npt.NDArray[Any]] | None = None
) -> MeshFile:
    triangles, doubts = triangulate_faces(_finite(vertices), faces)
    mesh = MeshFile(vertices, triangles, columns=columns or {}, doubts=doubts)
    return _repair(mesh, False)


def _repair(mesh: MeshFile, single: bool) -> MeshFile:
    """The mesh without triangles that have a corner twice or are there twice, its open edges
    joined. ``single``: its coordinates have 24 bits.
    """
    t = mesh.triangles
    good = (t[:, 0] != t[:, 1]) & (t[:, 1] != t[:, 2]) & (t[:, 2] != t[:, 0])
    welded = weld_open(mesh.vertices, t[good])
    once, twice = distinct_triangles(welded.triangles)
    flat = len(welded.triangles) - len(once) - twice
    if len(once) == 0:
        raise InputError("no face with three corners at different places", reason="mesh_file_empty")
    vertices, out, source = split_edges(mesh.vertices, once)
    columns = {name: np.asarray(c)[source] for name, c in mesh.columns.items()}
    doubts: tuple[Doubt, ...] = ()
    if twice:
        text = f"{twice} faces are in the file twice and count once; check how it was exported"
        doubts += (Doubt("mesh_duplicate_faces", text, twice),)
    return dataclasses.replace(
        mesh,
        vertices=vertices,
        triangles=out,
        columns=columns,
        dropped=mesh.dropped + int(np.count_nonzero(~good)) + welded.dropped + flat,
        twice=twice,
        joined=welded.joined,
        joined_m=welded.farthest_m,
        doubts=mesh.doubts + doubts + coarse(vertices, out, single),
    )


def coarse(vertices: F64, triangles: I32, single: bool) -> tuple[Doubt, ...]:
    """The doubt about coordinates (n, 3) of single precision, by their kind or as all of them show,
    whose steps are wide against the edges of the mesh.
    """
    used = vertices[vertices_of(triangles)]
    whole = bool((used == np.round(used)).all())  # given to the metre, which any number holds
    if not single and (whole or not (used == used.astype(np.float32)).all()):
        return ()
    step = float(np.spacing(np.abs(used).max().astype(np.float32)))
    edge = float(np.median(np.linalg.norm(np.diff(vertices[triangles][:, :2], axis=1), axis=2)))
    if step <= COARSE * edge:
        return ()
    text = (
        f"coordinates are rounded to {step:.2g} m (24 bits), edges are {edge:.2g} m: write the "
        "mesh with double coordinates, or about an origin near it"
    )
    return (Doubt("mesh_rounded", text, step),)


def write_mesh(
    path: str | Path,
    vertices: F64,
    triangles: I32,
    comments: Sequence[str] = (),
    vertex: Mapping[str, I32] | None = None,
    face: Mapping[str, I32] | None = None,
) -> None:
    """Write a mesh; coordinates are kept to the last bit, except by STL, which is binary with 24
    bits (6 cm at 1e6 m: reduce them first).

    vertex, face : small numbers (0 to 255) beside each, which only PLY keeps. Raises
    :class:`OutputError` for an unknown ending or what cannot be written.
    """
    path = Path(path)
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise OutputError(
            f"{path}: no known kind of mesh file ({', '.join(ENDINGS)})",
            reason="output_format",
            value=str(path),
        )
    v = np.asarray(vertices, dtype=np.float64)
    t = np.asarray(triangles, dtype=np.int32)
    notes = [line for c in comments for line in c.splitlines()]
    with atomic_file(path) as part:
        if ending == ".ply":
            write_ply_mesh(part, v, t, notes, vertex, face)
        elif ending == ".stl":
            part.write_bytes(_stl(v, t, notes))
        else:
            part.write_text(_read_obj_or_off(v, t, notes, ending))


def _stl(v: F64, t: I32, notes: Sequence[str]) -> bytes:
    """A binary STL; its head of 80 bytes holds the first note."""
    head = " ".join(["binary stl", *notes[:1]]).encode("ascii", "replace")[:80]
    table = np.zeros(len(t), [("normal", "<f4", (3,)), ("v", "<f4", (3, 3)), ("attribute", "<u2")])
    table["v"] = v[t]
    return head.ljust(80) + len(t).to_bytes(4, "little") + table.tobytes()


def _read_obj_or_off(v: F64, t: I32, notes: Sequence[str], ending: str) -> str:
    """An OBJ or OFF."""
    head = [f"# {c}" for c in notes]
    if ending == ".off":
        head = ["OFF", *head, f"{len(v)} {len(t)} 0"]
    mark, corner, base = ("v ", "f ", 1) if ending == ".obj" else ("", "3 ", 0)
    rows = [mark + " ".join(map(repr, r)) for r in v.tolist()]
    faces = [corner + " ".join(map(str, r)) for r in (t + base).tolist()]
    return "\n".join([*head, *rows, *faces]) + "\n"
