"""PLY vertex tables: ascii, binary little-endian and binary big-endian.

Read here, with numpy, and not by Open3D: that prints ascii coordinates with six digits, which at
map coordinates is metres, has no 64-bit integers, and gives uninitialised memory for a file that
ends early.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from ladar_volume.io.pointfiles.crs import of_comments
from ladar_volume.io.pointfiles.ply_elements import (
    Element,
    header_bytes,
    read_header,
    write_elements,
)
from ladar_volume.io.pointfiles.raw_table import Columns, RawTable
from ladar_volume.model.errors import CloudError, InputError, OutputError


def ply_table(path: Path) -> RawTable:
    """The properties of the vertices as columns (n,), native byte order, in file order, and what
    comments of the header say of CRS and units.

    Raises :class:`CloudError` (cloud_header, cloud_fields, cloud_short, cloud_values) and OSError.
    """
    with path.open("rb") as file:
        try:
            header = read_header(file)
        except InputError as error:
            raise CloudError(str(error), reason="cloud_header") from error
        before: list[Element] = []
        for element in header.elements:
            if element.name == "vertex":
                left = path.stat().st_size - file.tell()
                columns = (
                    _ascii(file, before, element, left)
                    if header.order == ""
                    else _binary(file, before, element, header.order, left)
                )
                return RawTable(columns, of_comments(header.comments))
            before.append(element)
    raise CloudError("the header declares no vertices", reason="cloud_header")


def row_type(element: Element, order: str) -> np.dtype[Any]:
    """The type of an element's rows. Raises :class:`CloudError` (cloud_fields) for lists, and for a
    property that appears twice.
    """
    names = [p.name for p in element.properties]
    for p in element.properties:
        if p.count:
            raise CloudError(
                f"element {element.name!r} has lists in or before the vertices, which is not read",
                reason="cloud_fields",
            )
        if names.count(p.name) > 1:
            raise CloudError(
                f"property {p.name!r} appears twice", reason="cloud_fields", value=p.name
            )
    return np.dtype([(p.name, order + p.code) for p in element.properties])


def _binary(
    file: IO[bytes], before: list[Element], vertex: Element, order: str, left: int
) -> Columns:
    skip = sum(e.rows * row_type(e, order).itemsize for e in before)
    dtype = row_type(vertex, order)
    check_size(vertex.rows, dtype.itemsize, left - skip)
    file.seek(skip, 1)
    table = np.fromfile(file, dtype, vertex.rows)
    return {name: native(table[name]) for name in dtype.names or ()}


def _ascii(file: IO[bytes], before: list[Element], vertex: Element, left: int) -> Columns:
    dtype = row_type(vertex, "=")
    names = dtype.names or ()
    check_size(vertex.rows, 2 * len(names) - 1, left)  # a digit and a separator for each value
    values = text_rows(file, sum(e.rows for e in before), vertex.rows, len(names))
    # floats keep the digits they are written with, whatever type is declared
    return {
        n: integers(values[:, k], dtype[n]) if dtype[n].kind in "iu" else values[:, k].copy()
        for k, n in enumerate(names)
    }


def integers(values: npt.NDArray[np.float64], kind: str | np.dtype[Any]) -> npt.NDArray[Any]:
    """Numbers of a text as integers of a kind. Raises :class:`CloudError` (cloud_values) for what
    is none.
    """
    info = np.iinfo(kind)
    # the largest of 64 bits is no float: the next one is beyond
    good = (values == np.floor(values)) & (values >= info.min) & (values < float(info.max) + 1.0)
    if not good.all():
        bad = float(values[~good].flat[0])
        raise CloudError(f"{bad:g} is no {np.dtype(kind).name}", reason="cloud_values", value=bad)
    return values.astype(kind)


def text_rows(file: IO[bytes], skip: int, count: int, width: int) -> npt.NDArray[np.float64]:
    """The next ``count`` rows of ``width`` numbers of a text body, after ``skip`` lines. Raises
    :class:`CloudError`.
    """
    if count == 0:
        return np.zeros((0, width))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # no rows at all is refused below
            rows = np.loadtxt(
                file, skiprows=skip, max_rows=count, ndmin=2, comments=None, encoding="latin-1"
            )
    except (ValueError, OverflowError) as error:
        raise CloudError(
            f"a row that is not {width} numbers: {error}", reason="cloud_values"
        ) from error
    if rows.shape != (count, width):
        raise CloudError(
            (
                f"{rows.shape[0]} rows of {rows.shape[1]} numbers where {count} of {width} "
                "are announced"
            ),
            reason="cloud_short" if rows.shape[0] < count else "cloud_values",
            value=rows.shape[0],
        )
    return rows


def check_size(count: int, row_bytes: int, left: int) -> None:
    """Refuse a count that the rest of the file cannot hold, before anything is allocated. Raises
    :class:`CloudError` (cloud_short).
    """
    if count * row_bytes > left:
        raise CloudError(
            f"{max(left, 0)} bytes for {count} points of {row_bytes}: the file ends early",
            reason="cloud_short",
            value=count,
        )


def native(column: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """A contiguous copy in the machine's byte order."""
    return np.ascontiguousarray(column, dtype=column.dtype.newbyteorder("="))


def narrow(column: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """An integer column as 32 bits where its values allow, for formats and readers without 64; else
    as double, exact to 2^53.

    Raises :class:`OutputError` for larger integers.
    """
    if column.dtype.kind not in "iu" or column.dtype.itemsize < 8:
        return column
    low, high = (int(column.min()), int(column.max())) if len(column) else (0, 0)
    for code in ("i4", "u4"):
        if np.iinfo(code).min <= low and high <= np.iinfo(code).max:
            return column.astype(code)
    if max(-low, high) > 2**53:
        raise OutputError("integers beyond 2^53 cannot be kept in this format", value=high)
    return column.astype(np.float64)


def write_ply(path: Path, columns: Columns, comments: list[str], encoding: str) -> None:
    """Write columns (n,) as vertices; ``encoding`` is ascii, binary or binary_big_endian. Raises
    OSError and :class:`OutputError`.
    """
    columns = {name: narrow(c) for name, c in columns.items()}
    if encoding != "ascii":
        return write_elements(path, comments, {"vertex": columns}, encoding)
    with path.open("wb") as file:
        file.write(header_bytes(encoding, comments, {"vertex": columns}))
        write_rows(file, columns, " ")


def write_rows(file: IO[bytes], columns: Columns, separator: str, chunk: int = 100_000) -> None:
    """Rows of text; floats with the fewest digits that read back the same."""
    rows = len(next(iter(columns.values())))
    for start in range(0, rows, chunk):
        parts = [[str(v) for v in c[start : start + chunk].tolist()] for c in columns.values()]
        file.write(
            ("\n".join(separator.join(row) for row in zip(*parts, strict=True)) + "\n").encode()
        )
