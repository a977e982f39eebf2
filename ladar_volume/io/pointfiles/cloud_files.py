"""Point cloud files: PLY, XYZ/TXT/ASC/CSV, NPY, PCD, LAS, LAZ, COPC (``.copc.laz``), and PTS, E57
and GeoTIFF, which are only read; by the ending of their name.

Coordinates come in metres, whatever the file holds. Points keep the order of the file; those left
out (no return, noise classes, withheld) are counted, and ``PointFile.rows`` tells the row of each
other one. What cannot be used is refused with a typed error that names the file.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tokenize import TokenError
from typing import Any
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from ladar_volume.io.atomic_write import atomic_file
from ladar_volume.io.endings import CLOUD_ENDINGS, ENCODINGS, unknown_cloud
from ladar_volume.io.pointfiles import pcd, ply, text
from ladar_volume.io.pointfiles.crs import Reading
from ladar_volume.io.pointfiles.point_file import NORMALS, PointFile, assemble
from ladar_volume.io.pointfiles.raw_table import Columns, RawTable
from ladar_volume.model.errors import CloudError, InputError, LadarVolumeError, OutputError
from ladar_volume.model.records import F64

__all__ = ["ENCODINGS", "PointFile", "Reading", "check_output", "read_cloud", "write_cloud"]

#: What the components of a normal are called, where not as the first of ``NORMALS``.
NORMALS_OF = {".pcd": NORMALS[1], ".las": NORMALS[2], ".laz": NORMALS[2]}
#: Most characters of an error that names a file.
MESSAGE = 300


def read_cloud(path: str | Path, columns: bool = True, reading: Reading | None = None) -> PointFile:
    """Read a point cloud file, in metres; without ``columns`` the positions alone. ``reading``:
    what the user says of CRS, units and classes; without it, a file that names no CRS is taken to
    be in metres even where its coordinates look like degrees.

    Raises :class:`InputError` for a file that is missing, unreadable or of unknown ending
    (input_missing, input_unreadable, input_format), for a CRS or units that cannot be understood or
    contradict the options (input_crs, input_units), for what looks like degrees (input_degrees);
    and :class:`CloudError` for what is in it: no points (cloud_empty), cut short (cloud_short), no
    x, y, z (cloud_fields), a header or a row that makes no sense (cloud_header, cloud_values),
    infinite coordinates (cloud_not_finite, value: how many), coordinates whose steps are coarser
    than the points are apart (cloud_resolution, value: m).
    """
    path = Path(path)
    ending = _ending(path, InputError)
    if not path.exists():
        raise InputError(f"{path}: no such file", reason="input_missing", value=str(path))
    try:
        if path.is_file() and path.stat().st_size == 0:
            raise CloudError("the file is empty", reason="cloud_empty")
        return assemble(
            _reader(ending, columns)(path), columns, reading or Reading(refuse_degrees=False)
        )
    except OSError as error:
        raise InputError(
            _brief(path, f"cannot be read: {error}"), reason="input_unreadable", value=str(path)
        ) from error
    except MemoryError as error:
        raise CloudError(
            f"{path}: larger than the memory", reason="cloud_values", value=str(path)
        ) from error
    except InputError as error:  # CloudError among them
        raise type(error)(
            _brief(path, str(error)), reason=error.reason, value=error.value
        ) from error


def _brief(path: Path, words: str) -> str:
    """One line that names the file, of at most 300 characters where the path leaves room."""
    words, room = " ".join(words.split()), max(120, MESSAGE - len(str(path)) - 2)
    return f"{path}: {words if len(words) <= room else words[: room - 1] + '…'}"


def _ending(path: Path, error: type[LadarVolumeError]) -> str:
    ending, kinds = path.suffix.lower(), CLOUD_ENDINGS if error is InputError else tuple(ENCODINGS)
    if ending not in kinds:
        raise error(unknown_cloud(path, kinds), reason=f"{error.reason}_format")
    return ending


def _reader(ending: str, columns: bool) -> Callable[[Path], RawTable]:
    if ending in (".las", ".laz"):
        from ladar_volume.io.pointfiles.las import (
            read_las,  # laspy and its decompressor only where needed
        )

        return lambda path: read_las(path, columns)
    if ending == ".e57":
        from ladar_volume.io.pointfiles.e57 import read_e57  # libE57

        return lambda path: read_e57(path, columns)
    if ending in (".tif", ".tiff"):
        from ladar_volume.io.pointfiles.geotiff import read_geotiff  # rasterio

        return read_geotiff
    return {".ply": ply.ply_table, ".pcd": pcd.pcd_table, ".npy": _read_npy}.get(
        ending, text.text_table
    )


def _read_npy(path: Path) -> RawTable:
    try:
        # mapped, so that a header that promises more than the file holds is found before anything
        # is allocated
        table = np.load(path, mmap_mode="r", allow_pickle=False)
    except (
        ValueError,
        EOFError,
        SyntaxError,
        TokenError,
        TypeError,
        KeyError,
        OverflowError,
        RecursionError,
        BadZipFile,
        AttributeError,
        NotImplementedError,
    ) as error:
        raise CloudError(
            f"no plain array, damaged or cut short: {error}", reason="cloud_values"
        ) from error
    if not isinstance(table, np.ndarray):
        raise CloudError("an archive of arrays, not one array", reason="cloud_fields")
    if table.dtype.names:
        flat = table.reshape(-1)
        return RawTable({name: ply.native(flat[name]) for name in table.dtype.names})
    if table.ndim != 2 or table.shape[1] < 3:
        raise CloudError(
            f"an array (n, 3) or wider is needed, not {table.shape}",
            reason="cloud_fields",
            value=table.shape,
        )
    names = [*"xyz", *(f"c{k}" for k in range(3, table.shape[1]))]
    return RawTable({name: ply.native(table[:, k]) for k, name in enumerate(names)})


def write_cloud(
    path: str | Path,
    r: F64,
    columns: Mapping[str, npt.NDArray[Any]] | None = None,
    names: Mapping[str, Sequence[str]] | None = None,
    encoding: str | None = None,
    template: PointFile | None = None,
) -> None:
    """Write points (n, 3), m, and columns, (n,) or (n, count), as the kind of file its name ends
    in; whole, or not at all. There may be none: the file then holds its columns' names. COPC
    orders points by an octree; the other kinds keep their order.

    ``names`` gives words to the codes of an integer column: text and NPY hold the words, the others
    the codes, and the words in a comment (LAS: in a record). ``encoding`` chooses among
    :data:`ENCODINGS`. ``template`` is the file that the points come from: its CRS and units are
    written (not to CSV and NPY, which have no place for them), to LAS also its point format,
    offsets and records. LAS rounds coordinates to 0.1 mm; the others are lossless. Raises
    :class:`OutputError` for an unknown ending or encoding, columns that do not fit, and files that
    cannot be written.
    """
    path = Path(path)
    ending = _ending(path, OutputError)
    encoding = encoding or ENCODINGS[ending][0]
    if encoding not in ENCODINGS[ending]:
        raise OutputError(
            f"{path}: {encoding!r} is not one of {', '.join(ENCODINGS[ending])}", value=encoding
        )
    flat, comments = flatten(np.asarray(r, np.float64), dict(columns or {}), names or {}, ending)
    with atomic_file(path) as part:
        if ending in (".las", ".laz"):
            _write_las(part, flat, comments, template)
        else:
            notes = [] if template is None else template.coordinates.notes()
            _writer(ending)(part, flat, [*notes, *comments], encoding)


def _write_las(
    path: Path, columns: Columns, comments: list[str], template: PointFile | None
) -> None:
    from ladar_volume.io.pointfiles.las_write import is_copc, write_las

    if template is None:
        write_las(path, columns, comments)
        return
    at = template.coordinates
    crs = at.crs_to_write(template.las, as_wkt=is_copc(path))
    write_las(path, columns, comments, template.las, crs, at.are_metres)


def check_output(path: str | Path) -> Path:
    """The path, where a point cloud file can be written there; to ask before a long computation.
    Raises :class:`OutputError`.
    """
    path = Path(path)
    _ending(path, OutputError)
    if not path.parent.is_dir() or path.is_dir():
        raise OutputError(
            (
                f"{path}: cannot be written: {path if path.is_dir() else path.parent} is "
                f"{'a' if path.is_dir() else 'no'} folder"
            ),
            value=str(path),
        )
    return path


def flatten(
    r: F64, columns: dict[str, npt.NDArray[Any]], names: Mapping[str, Sequence[str]], ending: str
) -> tuple[Columns, list[str]]:
    """Columns (n,) as a file of this ending holds them, and comments with words of codes."""
    if r.ndim != 2 or r.shape[1] != 3 or any(len(c) != len(r) for c in columns.values()):
        raise OutputError(
            (
                f"positions {r.shape} and columns "
                f"{ ({n: c.shape for n, c in columns.items()}) } make no table"
            ),
            value=r.shape,
        )
    flat: Columns = {axis: np.ascontiguousarray(r[:, k]) for k, axis in enumerate("xyz")}
    worded, comments = ending in (".csv", ".xyz", ".txt", ".asc", ".npy"), []
    for name, column in columns.items():
        if name in names:
            if worded:
                column = np.asarray(names[name], np.str_)[column]
            else:
                comments.append(
                    f"{name}: " + ", ".join(f"{k} {word}" for k, word in enumerate(names[name]))
                )
        if column.ndim == 2:
            parts = (
                NORMALS_OF.get(ending, NORMALS[0])
                if name == "normal"
                else [f"{name}_{k}" for k in range(column.shape[1])]
            )
            flat |= {part: np.ascontiguousarray(column[:, k]) for k, part in enumerate(parts)}
        else:
            flat[name] = np.ascontiguousarray(column)
    strange = [
        n
        for n, c in flat.items()
        if c.dtype.kind not in ("fiuU" if worded else "fiu")
        or not (n.isidentifier() or (ending in (".las", ".laz") and n.strip() and n.isprintable()))
    ]
    if strange:
        raise OutputError(f"columns {', '.join(strange)} cannot be kept in {ending}", value=strange)
    return flat, comments


def _writer(ending: str) -> Callable[[Path, Columns, list[str], str], None]:
    return {".ply": ply.write_ply, ".pcd": pcd.write_pcd, ".npy": _write_npy}.get(
        ending, text.write_text
    )


def _write_npy(path: Path, columns: Columns, comments: list[str], encoding: str) -> None:
    table = np.empty(len(columns["x"]), [(name, c.dtype) for name, c in columns.items()])
    for name, c in columns.items():
        table[name] = c
    np.save(
        path, np.column_stack(list(columns.values())) if list(columns) == ["x", "y", "z"] else table
    )
