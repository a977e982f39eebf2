"""PLY meshes: vertices and faces, ascii and both binary orders, lists of any length.

Every element is read row after row from one stream; where all rows of an element are alike, as
triangles are, in one piece.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from ladar_volume.io.pointfiles.ply_elements import Element, Header, read_header, write_elements
from ladar_volume.model.errors import InputError
from ladar_volume.model.records import F64, I32

INDEX_NAMES = ("vertex_indices", "vertex_index")
Column = npt.NDArray[Any] | list[npt.NDArray[Any]]


def bad(words: str, reason: str = "mesh_file_header") -> InputError:
    """The error of this reader."""
    return InputError(words, reason=reason)


def read_mesh_header(file: IO[bytes]) -> Header:
    """The header of a file, which is left at its body. Raises :class:`InputError`
    (mesh_file_header).
    """
    try:
        return read_header(file)
    except InputError as error:
        raise bad(f"not a PLY file: {error}") from error


class Stream:
    """The body of the file: bytes of one order, or in ascii numbers that stand for any type."""

    def __init__(self, data: bytes, order: str) -> None:
        self.order, self.at = order, 0
        if order:
            self.body: npt.NDArray[Any] = np.frombuffer(data, np.uint8)
        else:
            try:
                self.body = np.array(data.split(), dtype=np.float64)
            except ValueError as error:
                raise bad(f"a value that is no number: {error}", "mesh_file_values") from error

    def take(self, code: str, count: int) -> npt.NDArray[Any]:
        """The next values of one type."""
        size = np.dtype(code).itemsize if self.order else 1
        part = self.body[self.at : self.at + size * count]
        if count < 0 or len(part) < size * count:
            raise bad("the file ends early", "mesh_file_short")
        self.at += size * count
        return part.view(self.order + code) if self.order else part

    def length(self, code: str) -> int:
        """The next value as the length of a list."""
        value = float(self.take(code, 1)[0])
        if not value.is_integer() or value < 0:
            reason = "mesh_file_short" if value < 0 else "mesh_file_values"
            raise bad(f"a list of {value:g} values", reason)
        return int(value)

    def table(self, fields: list[tuple[str, str, int]], rows: int) -> dict[str, npt.NDArray[Any]]:
        """``rows`` rows of the fields (name, type, how many values): arrays (rows, how many),
        without moving on.
        """
        if self.order:
            dtype = np.dtype(
                [(f"{i}", self.order + code, (n,)) for i, (_, code, n) in enumerate(fields)]
            )
            part = self.body[self.at : self.at + dtype.itemsize * rows]
            if len(part) < dtype.itemsize * rows:
                return {}
            records = part.view(dtype)
            return {name: records[f"{i}"] for i, (name, _, _) in enumerate(fields)}
        width = sum(n for _, _, n in fields)
        part = self.body[self.at : self.at + width * rows]
        if len(part) < width * rows:
            return {}
        columns = np.split(
            part.reshape(rows, width), np.cumsum([n for _, _, n in fields])[:-1], axis=1
        )
        return {name: c for (name, _, _), c in zip(fields, columns, strict=True)}


def read_element(stream: Stream, element: Element) -> dict[str, Column]:
    """The columns of one element: arrays (rows, 1), for lists (rows, length) where all are alike,
    else one array per row.
    """
    if element.rows == 0 or not element.properties:
        return {}
    start = stream.at
    lengths: dict[str, int] = {}
    for p in element.properties:  # the first row tells how long the lists are
        lengths[p.name] = stream.length(p.count) if p.count else 1
        stream.take(p.code, lengths[p.name])
    row = stream.at - start
    stream.at = start
    fields: list[tuple[str, str, int]] = []
    for p in element.properties:
        fields += ([(f"#{p.name}", p.count, 1)] if p.count else []) + [
            (p.name, p.code, lengths[p.name])
        ]
    table = stream.table(fields, element.rows)
    if table and all(
        (table[f"#{p.name}"] == lengths[p.name]).all() for p in element.properties if p.count
    ):
        stream.at = start + row * element.rows
        return {p.name: table[p.name] for p in element.properties}
    columns: dict[str, list[npt.NDArray[Any]]] = {p.name: [] for p in element.properties}
    for _ in range(element.rows):
        for p in element.properties:
            columns[p.name].append(stream.take(p.code, stream.length(p.count) if p.count else 1))
    return dict(columns)


def scalars(found: Mapping[str, Column]) -> dict[str, npt.NDArray[Any]]:
    """The columns (rows,) of an element that hold one value per row."""
    return {
        name: np.asarray(c)[:, 0]
        for name, c in found.items()
        if isinstance(c, np.ndarray) and c.ndim == 2 and c.shape[1] == 1
    }


def read_ply_mesh(path: Path) -> tuple[F64, list[I32] | I32, dict[str, npt.NDArray[Any]]]:
    """Vertices (n, 3), faces, (m, k) where all have k corners, else one array each, and the other
    columns (n,) of the vertices. Faces whose property ``relevant`` is 0 do not count: so a TIN that
    was written with all its triangles comes back as it was.

    Raises :class:`InputError` (mesh_file_header, mesh_file_short, mesh_file_values,
    mesh_file_fields) and OSError.
    """
    with path.open("rb") as file:
        header = read_mesh_header(file)
        stream = Stream(file.read(), header.order)
    found = {e.name: read_element(stream, e) for e in header.elements}
    vertex, face = found.get("vertex", {}), found.get("face", {})
    name = next((n for n in INDEX_NAMES if n in face), None)
    if not all(axis in vertex for axis in "xyz") or name is None:
        raise bad("no vertices with x, y, z, or no faces: is it a point cloud?", "mesh_file_fields")
    xyz = np.concatenate(
        [np.asarray(vertex[axis], dtype=np.float64).reshape(-1, 1) for axis in "xyz"], axis=1
    )
    columns = {k: c for k, c in scalars(vertex).items() if k not in "xyz"}
    faces, keep = face[name], scalars(face).get("relevant")
    counts = np.ones(len(faces), bool) if keep is None else keep != 0
    if isinstance(faces, np.ndarray):
        return xyz, _index(faces[counts]), columns
    return xyz, [_index(f) for f, c in zip(faces, counts, strict=True) if c], columns


def _index(corners: npt.NDArray[Any]) -> I32:
    """Corners of faces as they are used. Raises :class:`InputError` (mesh_file_index) for what is
    no whole number of 31 bits.
    """
    if not ((corners >= 0) & (corners < 2**31) & (corners == np.floor(corners))).all():
        raise bad("a face names a vertex by what is no index", "mesh_file_index")
    return corners.astype(np.int32)


def write_ply_mesh(
    path: Path,
    vertices: F64,
    triangles: I32,
    comments: list[str],
    vertex: Mapping[str, npt.NDArray[Any]] | None = None,
    face: Mapping[str, npt.NDArray[Any]] | None = None,
) -> None:
    """Write a binary PLY with double coordinates; ``vertex`` and ``face`` are small numbers (0 to
    255) beside each. Raises OSError.
    """
    places = dict(zip("xyz", vertices.T, strict=True))
    corners = {"vertex_indices": triangles.astype(np.int32, copy=False)}
    elements = {
        "vertex": places | {n: c.astype(np.uint8) for n, c in (vertex or {}).items()},
        "face": corners | {n: c.astype(np.uint8) for n, c in (face or {}).items()},
    }
    write_elements(path, comments, elements)
