"""Triangulated surfaces as PLY files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ladar_volume.io.atomic_write import atomic_file
from ladar_volume.io.pointfiles.ply import NAMES
from ladar_volume.model.errors import OutputError
from ladar_volume.model.records import F64, Tin


def check_tin_output(path: str | Path) -> Path:
    """The path, where a TIN can be written there; to ask before a long computation. Raises
    :class:`OutputError`.
    """
    path = Path(path)
    if path.suffix.lower() != ".ply":
        raise OutputError(
            f"{path}: a TIN is written as .ply", reason="output_format", value=str(path)
        )
    if path.is_dir() or not path.parent.is_dir():
        raise OutputError(
            (
                f"{path}: cannot be written: {path if path.is_dir() else path.parent} is "
                f"{'a' if path.is_dir() else 'no'} folder"
            ),
            value=str(path),
        )
    return path


def write_tin(
    path: str | Path,
    tin: Tin,
    sigma_z: F64 | None = None,
    every: bool = False,
    notes: Sequence[str] = (),
) -> tuple[int, int]:
    """Write a surface as binary PLY in double; whole or not. Returns numbers of vertices, faces.

    Every vertex has ``source``, the row of its point in the cloud (-1: an artificial corner), and
    where ``sigma_z`` (n,), m, is given the standard deviation of its height. Faces are the relevant
    triangles; with ``every`` all of them, marked by ``relevant``. ``notes`` become comments. Raises
    :class:`OutputError`.
    """
    path = check_tin_output(path)
    triangles = tin.triangles if every else tin.triangles[tin.relevant]
    used, inverse = np.unique(triangles, return_inverse=True)
    columns = {"x": tin.vertices[used, 0], "y": tin.vertices[used, 1], "z": tin.vertices[used, 2]}
    if sigma_z is not None:
        columns["sigma_z"] = sigma_z[used]
    columns["source"] = tin.source[used].astype(np.int32)
    vertex = np.empty(len(used), [(name, c.dtype.newbyteorder("<")) for name, c in columns.items()])
    for name, c in columns.items():
        vertex[name] = c
    marked = [("relevant", "u1")] if every else []
    face = np.empty(len(triangles), [("n", "u1"), ("v", "<i4", 3), *marked])
    face["n"], face["v"] = 3, inverse.reshape(-1, 3)
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {n}" for n in notes)]
    lines.append(f"element vertex {len(vertex)}")
    lines += [f"property {NAMES[c.dtype.str[1:]]} {name}" for name, c in columns.items()]
    lines += [f"element face {len(face)}", "property list uchar int vertex_indices"]
    if every:
        face["relevant"] = tin.relevant
        lines.append("property uchar relevant")
    with atomic_file(path) as part:
        part.write_bytes(
            ("\n".join([*lines, "end_header"]) + "\n").encode() + vertex.tobytes() + face.tobytes()
        )
    return len(vertex), len(face)
