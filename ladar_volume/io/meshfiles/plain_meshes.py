"""OBJ, OFF and STL: the formats without a header to speak of. Errors do not name the file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ladar_volume.io.meshfiles.polygons import Faces
from ladar_volume.model.errors import InputError, short_repr
from ladar_volume.model.records import F64

#: No index or count reaches this.
MOST = 10**18


def numbers(words: Sequence[str | bytes], kind: type = float) -> list[Any]:
    """Words as numbers. Raises :class:`InputError` (mesh_file_values)."""
    try:
        found = [kind(w) for w in words]
    except ValueError as error:
        raise InputError(
            f"a value that is no number: {short_repr(error)}", reason="mesh_file_values"
        ) from error
    if kind is int and any(abs(n) >= MOST for n in found):
        raise InputError("an index or count of more than 18 digits", reason="mesh_file_values")
    return found


def read_obj(path: Path) -> tuple[F64, Faces]:
    """Vertices (n, 3) and faces of an OBJ file."""
    vertices: list[list[float]] = []
    faces: list[list[int]] = []
    for line in path.read_text("latin-1").replace("\\\n", " ").splitlines():
        words = line.split("#")[0].split()
        if words[:1] == ["v"]:
            vertices.append(numbers(words[1:4]))
            if len(vertices[-1]) < 3:
                raise InputError(
                    "a vertex with fewer than three coordinates", reason="mesh_file_values"
                )
        elif words[:1] == ["f"]:
            index = numbers([w.split("/")[0] for w in words[1:]], int)
            if 0 in index:
                raise InputError(
                    "a face names vertex 0; they count from 1", reason="mesh_file_index", value=0
                )
            faces.append([i - 1 if i > 0 else len(vertices) + i for i in index])
    return np.array(vertices, dtype=np.float64).reshape(-1, 3), faces


def read_off(path: Path) -> tuple[F64, Faces]:
    """Vertices (n, 3) and faces of an OFF file."""
    lines = [
        words
        for line in path.read_text("latin-1").splitlines()
        if (words := line.split("#")[0].split())
    ]
    if not lines or not lines[0][0].upper().endswith("OFF"):
        raise InputError("does not begin with OFF", reason="mesh_file_header")
    rest = lines[0][1:]
    lines = [rest, *lines[1:]] if rest else lines[1:]
    count = numbers(lines[0][:2], int) if lines else []
    if len(count) < 2 or min(count) < 0:
        raise InputError("no counts of vertices and faces", reason="mesh_file_header")
    if len(lines) - 1 < sum(count):
        raise InputError(
            f"{len(lines) - 1} rows where {sum(count)} are announced", reason="mesh_file_short"
        )
    rows = [numbers(words[:3]) for words in lines[1 : 1 + count[0]]]
    if any(len(r) < 3 for r in rows):
        raise InputError("a vertex with fewer than three coordinates", reason="mesh_file_values")
    faces = []
    for words in lines[1 + count[0] : 1 + sum(count)]:
        corners = int(numbers(words[:1], int)[0])
        faces.append(numbers(words[1 : 1 + max(corners, 0)], int))
        if len(faces[-1]) != corners:
            raise InputError("a face shorter than announced", reason="mesh_file_short")
    return np.array(rows, dtype=np.float64).reshape(-1, 3), faces


def read_stl(path: Path) -> F64:
    """Corners (3 m, 3) of the triangles of an STL file, binary or ascii."""
    data = path.read_bytes()
    count = int.from_bytes(data[80:84], "little") if len(data) >= 84 else -1
    if count >= 0 and len(data) == 84 + 50 * count:
        records = np.frombuffer(
            data, [("normal", "<f4", (3,)), ("v", "<f4", (3, 3)), ("attribute", "<u2")], count, 84
        )
        soup = records["v"].astype(np.float64).reshape(-1, 3)
    elif data[:5].lower() == b"solid" and b"facet" in data[:2000].lower():
        rows = [line.split()[1:4] for line in data.splitlines() if line.split()[:1] == [b"vertex"]]
        if any(len(r) < 3 for r in rows) or len(rows) % 3 or b"endsolid" not in data[-400:].lower():
            raise InputError(
                "a facet that is not three vertices, or no end", reason="mesh_file_short"
            )
        soup = np.array(numbers([w for r in rows for w in r]), dtype=np.float64).reshape(-1, 3)
    else:
        raise InputError(
            f"neither ascii STL nor binary with {max(count, 0)} triangles in {len(data)} bytes",
            reason="mesh_file_short",
        )
    if len(soup) == 0:
        raise InputError("no face", reason="mesh_file_empty")
    return soup
