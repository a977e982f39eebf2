"""The faces of a DXF drawing, read by ezdxf: 3DFACE, polyface and polygon meshes, MESH. The faces
of one layer are a surface.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ladar_volume.io.pointfiles.crs import Coordinates, of_comments
from ladar_volume.io.pointfiles.units import INSUNITS
from ladar_volume.model.errors import InputError
from ladar_volume.model.records import F64
from ladar_volume.model.verdict import Doubt

if TYPE_CHECKING:
    from ezdxf.document import Drawing


@dataclass(frozen=True)
class DxfSurface:
    """vertices : (n, 3) as the file holds them · faces : the corners of each · layer : its name ·
    said : units and system that the header names, None for neither · doubts : faces in blocks
    """

    vertices: F64
    faces: list[list[int]]
    layer: str
    said: Coordinates | None
    doubts: tuple[Doubt, ...]


def read_dxf(path: Path, layer: str | None = None) -> DxfSurface:
    """The faces of the only layer that has any, or of that of a name.

    Raises :class:`InputError`: mesh_file_header (no DXF, or a unit that is not known),
    mesh_file_empty, landxml_surface (several layers, or none of that name); and OSError.
    """
    from ezdxf.filemanagement import readfile

    by_layer: dict[str, list[F64]] = {}
    try:
        drawing = readfile(path)
        for name, face in faces_of(drawing):
            by_layer.setdefault(name, []).append(face)
        said, doubts = said_by_header(drawing), block_doubts(drawing)
    except (InputError, MemoryError):
        raise
    except OSError as error:
        if error.errno is not None:
            raise
        raise InputError("no DXF", reason="mesh_file_header") from error
    except Exception as error:  # a damaged drawing fails anywhere inside ezdxf
        raise InputError(
            f"no DXF that can be read: {type(error).__name__} {error}", reason="mesh_file_header"
        ) from error
    found = choose_layer(by_layer, layer)
    corners = by_layer[found]
    vertices, row = np.unique(np.concatenate(corners), axis=0, return_inverse=True)
    ends = np.cumsum([len(face) for face in corners])
    faces = [part.tolist() for part in np.split(row.reshape(-1), ends[:-1])]
    return DxfSurface(vertices, faces, found, said, doubts)


def choose_layer(layers: dict[str, list[F64]], name: str | None) -> str:
    """The layer of that name, or the only one. Raises :class:`InputError`."""
    if not layers:
        raise InputError(
            "no 3DFACE and no mesh in the model space: give an outline with --piles, and points "
            "and breaklines as a triangulated surface",
            reason="mesh_file_empty",
        )
    names = ", ".join(map(repr, layers))
    if name is None and len(layers) > 1:
        raise InputError(
            f"its faces lie on {len(layers)} layers: choose one of {names} with --surface, "
            "of a second file with --surface-b",
            reason="landxml_surface",
        )
    found = next(iter(layers)) if name is None else name
    if found not in layers:
        raise InputError(f"no face on a layer {found!r}, but on {names}", reason="landxml_surface")
    return found


def faces_of(drawing: Drawing) -> Iterator[tuple[str, F64]]:
    """Layer and corners (k, 3) of every face in the model space."""
    from ezdxf.render.mesh import MeshBuilder

    entity: Any
    for entity in drawing.modelspace().query("3DFACE POLYLINE MESH"):
        layer, kind = str(entity.dxf.layer), entity.dxftype()
        if kind == "3DFACE":  # three corners where the fourth repeats the third
            yield layer, np.array([tuple(p) for p in entity.wcs_vertices()], dtype=np.float64)
            continue
        if kind == "POLYLINE" and not (entity.is_poly_face_mesh or entity.is_polygon_mesh):
            continue
        from_entity = MeshBuilder.from_mesh if kind == "MESH" else MeshBuilder.from_polyface
        made = from_entity(entity)
        r = np.array([tuple(p) for p in made.vertices], dtype=np.float64).reshape(-1, 3)
        yield from ((layer, r[list(face)]) for face in made.faces)


def block_doubts(drawing: Drawing) -> tuple[Doubt, ...]:
    """That faces in blocks, which do not count, may be part of the surface."""
    names = [str(one.dxf.name) for one in drawing.modelspace().query("INSERT")]
    blocks = [drawing.blocks.get(name) for name in names]
    held = sum(1 for block in blocks if block is not None and block.query("3DFACE MESH"))
    if not held:
        return ()
    words = f"{held} blocks of the drawing hold faces, which do not count: explode the blocks"
    return (Doubt("mesh_blocks", words, held),)


def said_by_header(drawing: Drawing) -> Coordinates | None:
    """Units, and the system as this program writes it. Raises :class:`InputError`."""
    own = drawing.header.custom_vars
    named = own.get("CRS WKT") or own.get("CRS")
    if named:
        return of_comments([f"crs: {named}"])
    code = int(drawing.header.get("$INSUNITS", 0))
    if code == 0:
        return None
    if code not in INSUNITS:
        raise InputError(
            f"$INSUNITS is {code}, no unit of a map: write it in metres or feet",
            reason="mesh_file_header",
        )
    return Coordinates(across=INSUNITS[code], up=INSUNITS[code])
