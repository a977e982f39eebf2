"""Triangulated surfaces as PLY files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ladar_volume.io.atomic_write import atomic_file
from ladar_volume.io.pointfiles.ply_elements import write_elements
from ladar_volume.model.errors import OutputError
from ladar_volume.model.records import F64, Tin


def check_tin_output(path: str | Path, endings: Sequence[str] = (".ply",)) -> Path:
    """The path, where a TIN can be written there with one of the endings; to ask before a long
    computation. Raises :class:`OutputError`.
    """
    path = Path(path)
    if path.suffix.lower() not in endings:
        words = f"{path}: a TIN is written as {', '.join(endings)}"
        raise OutputError(words, reason="output_format", value=str(path))
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
    columns: dict[str, npt.NDArray[Any]] = {} if sigma_z is None else {"sigma_z": sigma_z}
    columns["source"] = tin.source.astype(np.int32)
    return write_columns(path, tin, columns, every, notes)


def write_columns(
    path: Path,
    tin: Tin,
    columns: Mapping[str, npt.NDArray[Any]],
    every: bool = False,
    notes: Sequence[str] = (),
) -> tuple[int, int]:
    """Write the relevant triangles as binary PLY with columns (n,) of the vertices, of the type
    that they have; whole or not. ``every`` and ``notes`` as in :func:`write_tin`. Returns numbers
    of vertices, faces. Raises :class:`OutputError`.
    """
    whole = every or bool(tin.relevant.all())
    triangles = tin.triangles if whole else tin.triangles[tin.relevant]
    # without compiled code: a process that only logs loads none
    corner, number = np.zeros(len(tin.vertices), np.bool_), np.zeros(len(tin.vertices), np.int32)
    corner[triangles] = True
    used = np.flatnonzero(corner)
    number[used] = np.arange(len(used), dtype=np.int32)
    vertices = tin.vertices if len(used) == len(corner) else tin.vertices[used]
    vertex = dict(zip("xyz", vertices.T, strict=True))
    face: dict[str, npt.NDArray[Any]] = {"vertex_indices": number[triangles]}
    if every:
        face["relevant"] = tin.relevant.astype(np.uint8)
    every_column = vertex | {name: c[used] for name, c in columns.items()}
    with atomic_file(path) as part:
        write_elements(part, notes, {"vertex": every_column, "face": face})
    return len(used), len(triangles)
