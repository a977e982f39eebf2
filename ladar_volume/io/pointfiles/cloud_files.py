"""Point cloud files: PLY, XYZ/TXT/ASC/CSV, NPY, PCD, LAS, LAZ, by the ending of their name.

Points keep the order of the file, and none is left out: an index into the array is the row of the
file. What cannot be used is refused with a typed error that names the file.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np
import numpy.typing as npt

from ladar_volume.io.atomic_write import whole_file
from ladar_volume.io.endings import ENCODINGS
from ladar_volume.io.pointfiles import pcd, ply, text
from ladar_volume.io.pointfiles.ply import Columns
from ladar_volume.model.errors import CloudError, InputError, LadarVolumeError, OutputError
from ladar_volume.model.records import F64

#: What the three components of a normal are called; written as the first (PCD and LAS: see
#: NORMALS_OF).
NORMALS = (
    ("nx", "ny", "nz"),
    ("normal_x", "normal_y", "normal_z"),
    ("NormalX", "NormalY", "NormalZ"),
)
NORMALS_OF = {".pcd": NORMALS[1], ".las": NORMALS[2], ".laz": NORMALS[2]}


@dataclass(frozen=True)
class PointFile:
    """A point cloud as its file holds it.

    r : (n, 3) float64, m, in file order, all finite · columns : everything else by name, (n,) or
    (n, count); the components of a normal are one column "normal" (n, 3), whatever the file calls
    them
    """

    r: F64
    columns: dict[str, npt.NDArray[Any]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.r)


def read_cloud(path: str | Path, columns: bool = True) -> PointFile:
    """Read a point cloud file; without ``columns`` the positions alone.

    Raises :class:`InputError` for a file that is missing, unreadable or of unknown ending
    (input_missing, input_unreadable, input_format) and :class:`CloudError` for what is in it: no
    points (cloud_empty), cut short (cloud_short), no x, y, z (cloud_fields), a header or a row that
    makes no sense (cloud_header, cloud_values), coordinates that are not finite (cloud_not_finite,
    value: their count).
    """
    path = Path(path)
    ending = _ending(path, InputError)
    if not path.exists():
        raise InputError(f"{path}: no such file", reason="input_missing", value=str(path))
    try:
        if path.is_file() and path.stat().st_size == 0:
            raise CloudError("the file is empty", reason="cloud_empty")
        found = _reader(ending, columns)(path)
        return _assemble(found, columns)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read: {error}", reason="input_unreadable", value=str(path)
        ) from error
    except MemoryError as error:
        raise CloudError(
            f"{path}: larger than the memory", reason="cloud_values", value=str(path)
        ) from error
    except CloudError as error:
        raise CloudError(f"{path}: {error}", reason=error.reason, value=error.value) from error


def _ending(path: Path, error: type[LadarVolumeError]) -> str:
    ending = path.suffix.lower()
    if ending not in ENCODINGS:
        known = ", ".join(ENCODINGS)
        raise error(
            f"{path}: {ending or 'no ending'} is no known kind of point cloud file ({known})",
            reason=f"{error.reason}_format",
        )
    return ending


def _reader(ending: str, columns: bool) -> Callable[[Path], Columns]:
    if ending in (".las", ".laz"):
        from ladar_volume.io.pointfiles.las import (
            read_las,  # laspy and its decompressor only where needed
        )

        return lambda path: read_las(path, columns)
    return {".ply": ply.read_ply, ".pcd": pcd.read_pcd, ".npy": _read_npy}.get(
        ending, text.read_text
    )


def _read_npy(path: Path) -> Columns:
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
    ) as error:
        raise CloudError(
            f"no plain array, damaged or cut short: {error}", reason="cloud_values"
        ) from error
    if not isinstance(table, np.ndarray):
        raise CloudError("an archive of arrays, not one array", reason="cloud_fields")
    if table.dtype.names:
        flat = table.reshape(-1)
        return {name: ply.native(flat[name]) for name in table.dtype.names}
    if table.ndim != 2 or table.shape[1] < 3:
        raise CloudError(
            f"an array (n, 3) or wider is needed, not {table.shape}",
            reason="cloud_fields",
            value=table.shape,
        )
    return {
        name: ply.native(table[:, k])
        for k, name in enumerate([*"xyz", *(f"c{k}" for k in range(3, table.shape[1]))])
    }


def _assemble(found: Columns, columns: bool) -> PointFile:
    lower = {name.lower(): name for name in reversed(found)}
    axes = [found.pop(lower[axis]) for axis in "xyz" if axis in lower]
    if len(axes) < 3:
        raise CloudError(
            f"there are no columns x, y, z among {', '.join(found) or 'none'}",
            reason="cloud_fields",
            value=list(found),
        )
    if any(a.dtype.kind not in "fiu" or a.ndim != 1 for a in axes):
        raise CloudError("x, y, z are not numbers", reason="cloud_fields")
    r = np.column_stack([a.astype(np.float64) for a in axes])
    if not len(r):
        raise CloudError("there is no point in it", reason="cloud_empty")
    bad = int(np.count_nonzero(~np.isfinite(r).all(axis=1)))
    if bad:
        raise CloudError(
            f"{bad} of {len(r)} points have a coordinate that is not finite",
            reason="cloud_not_finite",
            value=bad,
        )
    if not columns:
        return PointFile(r)
    for triple in NORMALS:
        if set(triple) <= set(found):
            found = {"normal": np.column_stack([found.pop(name) for name in triple]), **found}
    return PointFile(r, found)


def write_cloud(
    path: str | Path,
    r: F64,
    columns: Mapping[str, npt.NDArray[Any]] | None = None,
    names: Mapping[str, Sequence[str]] | None = None,
    encoding: str | None = None,
) -> None:
    """Write points (n, 3), m, and columns, (n,) or (n, count), as the kind of file its name ends
    in; whole, or not at all. There may be none: the file then holds its columns' names.

    ``names`` gives words to the codes of an integer column: text and NPY hold the words, the others
    the codes, and the words in a comment (LAS: in a record). ``encoding`` chooses among
    :data:`ENCODINGS`. LAS rounds coordinates to 0.1 mm; the others are lossless. Raises
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
    flat, comments = _flatten(np.asarray(r, np.float64), dict(columns or {}), names or {}, ending)
    with whole_file(path) as part:
        _writer(ending)(part, flat, comments, encoding)


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


def _flatten(
    r: F64, columns: dict[str, npt.NDArray[Any]], names: Mapping[str, Sequence[str]], ending: str
) -> tuple[Columns, list[str]]:
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
        if c.dtype.kind not in ("fiuU" if worded else "fiu") or not n.isidentifier()
    ]
    if strange:
        raise OutputError(f"columns {', '.join(strange)} cannot be kept in {ending}", value=strange)
    return flat, comments


def _writer(ending: str) -> Callable[[Path, Columns, list[str], str], None]:
    if ending in (".las", ".laz"):
        from ladar_volume.io.pointfiles.las import write_las

        return write_las
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
