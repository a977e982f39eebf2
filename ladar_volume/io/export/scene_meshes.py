"""OBJ, STL and GLB of a result, with plain NumPy.

OBJ is text with every digit. STL and GLB hold 24 bits: they are written about a near origin, which
stands in their head.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ladar_volume.io.export.deliverable import Deliverable, Part
from ladar_volume.io.meshfiles.mesh_files import write_mesh
from ladar_volume.model.records import F64, I32

#: Colours of the parts, red, green, blue, opacity.
COLOURS = {
    "surface": (0.35, 0.62, 0.86, 1.0),
    "counted": (0.35, 0.62, 0.86, 1.0),
    "around": (0.62, 0.62, 0.60, 1.0),
    "base": (0.80, 0.62, 0.35, 0.6),
    "second": (0.80, 0.62, 0.35, 0.6),
}
#: Rows that are joined at a time.
CHUNK = 100_000
#: glTF's numbers for float and unsigned int, and for vertex and index buffers.
FLOAT, UINT, VERTICES, INDICES = 5126, 5125, 34962, 34963


def near_origin(r: F64) -> F64:
    """An origin (3,) of whole numbers near the middle of points (n, 3)."""
    out: F64 = np.round(0.5 * (r.min(axis=0) + r.max(axis=0)))
    return out


def write_obj(path: Path, d: Deliverable) -> None:
    """One object a part, in the units of the system."""
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write("".join(f"# {note}\n" for note in d.system.notes()))
        before = 1
        for part in d.parts:
            file.write(f"o {part.name}\n")
            r = d.system.numbers(part.vertices)
            for first in range(0, len(r), CHUNK):
                rows = r[first : first + CHUNK].tolist()
                file.write("".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in rows))
            for first in range(0, len(part.triangles), CHUNK):
                faces = (part.triangles[first : first + CHUNK] + before).tolist()
                file.write("".join(f"f {i} {j} {k}\n" for i, j, k in faces))
            before += len(r)


def write_stl(path: Path, d: Deliverable) -> None:
    """Where the volume counts, about a near origin, in the units of the system."""
    part = d.parts[0]
    r = d.system.numbers(part.vertices)
    origin = near_origin(r)
    note = "origin {:.0f} {:.0f} {:.0f} ".format(*origin) + d.system.unit.name
    write_mesh(path, r - origin, part.triangles, [note])


def write_glb(path: Path, d: Deliverable) -> None:
    """One node a part, in m about a near origin; y is up and z south, as glTF has it."""
    origin = near_origin(np.concatenate([part.vertices for part in d.parts]))
    document, data = gltf(d.parts, origin)
    document["asset"]["extras"] = {
        "origin_m": origin.tolist(),
        "axes": "x east, y up, z south, m from the origin (east, north, height)",
        "crs": d.system.wkt if d.system.unit.metres == 1.0 else None,
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    size = 12 + 8 + len(text) + 8 + len(data)
    whole = [b"glTF", number(2), number(size), number(len(text)), b"JSON", text]
    path.write_bytes(b"".join([*whole, number(len(data)), b"BIN\0", data]))


def number(value: int) -> bytes:
    """Four bytes of GLB."""
    return value.to_bytes(4, "little")


def gltf(parts: list[Part], origin: F64) -> tuple[dict[str, Any], bytes]:
    """The glTF of the parts and its buffer."""
    out: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "ladar_volume"},
        "scene": 0,
        "scenes": [{"nodes": list(range(len(parts)))}],
        "nodes": [{"mesh": k, "name": part.name} for k, part in enumerate(parts)],
        "meshes": [],
        "materials": [],
        "accessors": [],
        "bufferViews": [],
    }
    pieces: list[bytes] = []
    for k, part in enumerate(parts):
        local = (part.vertices - origin)[:, [0, 2, 1]] * [1.0, 1.0, -1.0]
        _add_buffer(out, pieces, local.astype("<f4"))
        _add_buffer(out, pieces, part.triangles.ravel())
        attributes = {"POSITION": 2 * k}
        primitive = {"attributes": attributes, "indices": 2 * k + 1, "material": k, "mode": 4}
        out["meshes"].append({"name": part.name, "primitives": [primitive]})
        colour = {"baseColorFactor": COLOURS[part.name], "metallicFactor": 0.0}
        material = {"name": part.name, "pbrMetallicRoughness": colour, "doubleSided": True}
        out["materials"].append(
            {**material, "alphaMode": "BLEND" if COLOURS[part.name][3] < 1.0 else "OPAQUE"}
        )
    data = b"".join(pieces)
    out["buffers"] = [{"byteLength": len(data)}]
    return out, data


def _add_buffer(out: dict[str, Any], pieces: list[bytes], values: F64 | I32) -> None:
    """An accessor of vertices (n, 3) or of indices (n,), with its view of the buffer."""
    vertices = values.ndim == 2
    data = values.astype("<f4" if vertices else "<u4").tobytes()
    view = {
        "buffer": 0,
        "byteOffset": sum(map(len, pieces)),
        "byteLength": len(data),
        "target": VERTICES if vertices else INDICES,
    }
    accessor: dict[str, Any] = {
        "bufferView": len(out["bufferViews"]),
        "componentType": FLOAT if vertices else UINT,
        "count": len(values),
        "type": "VEC3" if vertices else "SCALAR",
    }
    if vertices:
        low, high = values.min(axis=0), values.max(axis=0)
        accessor |= {"min": low.tolist(), "max": high.tolist()}
    out["bufferViews"].append(view)
    out["accessors"].append(accessor)
    pieces.append(data)
