"""PCD files of the Point Cloud Library, version 0.7: ascii, binary, binary_compressed.

Read and written here, with numpy, because Open3D gives uninitialised memory for an ascii file that
ends early, writes ten digits, and corrupts the heap where it compresses columns of different
widths.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from ladar_volume.io.pointfiles.crs import of_comments
from ladar_volume.io.pointfiles.lzf import RATIO, pack, unpack
from ladar_volume.io.pointfiles.ply import (
    check_size,
    integers,
    narrow,
    native,
    text_rows,
    write_rows,
)
from ladar_volume.io.pointfiles.raw_table import Columns, RawTable
from ladar_volume.model.errors import CloudError, OutputError, short_repr

ENCODINGS = ("ascii", "binary", "binary_compressed")
KINDS = {"F": "f", "I": "i", "U": "u"}
CODES = {"f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8"}
HEADER_LIMIT = 100_000
#: Largest row, bytes: a count beyond it is no measurement (the largest descriptors have 2 kB).
ROW_LIMIT = 2**20
#: Packed data of points stand for two to four times their size; more than this, in more than that
#: many bytes, is refused before it is unpacked.
MOST_PACKED, UNPACKED_LIMIT = 20, 2**28


@dataclass(frozen=True)
class _Header:
    fields: tuple[tuple[str, str, int], ...]  # name, numpy code, count
    points: int
    data: str
    comments: list[str]

    @property
    def dtype(self) -> np.dtype[Any]:
        names = [
            f"{name}@{k}" if name == "_" else name for k, (name, _, _) in enumerate(self.fields)
        ]  # padding may repeat
        if len(set(names)) < len(names):
            raise CloudError(f"a field appears twice in {' '.join(names)}", reason="cloud_fields")
        return np.dtype(
            [
                (n, f"<{code}") if count == 1 else (n, f"<{code}", (count,))
                for n, (_, code, count) in zip(names, self.fields, strict=True)
            ]
        )


def pcd_table(path: Path) -> RawTable:
    """The fields as columns (n,) or (n, count), native byte order, in file order; organised clouds
    row by row; what comments say of CRS and units.

    Raises :class:`CloudError` (cloud_header, cloud_fields, cloud_short, cloud_values) and OSError.
    """
    with path.open("rb") as file:
        header = _header(file)
        dtype, left = header.dtype, path.stat().st_size - file.tell()
        said = of_comments(header.comments)
        if header.data == "binary_compressed":
            return RawTable(_read_compressed(file, header, left), said)
        if header.data == "ascii":
            return RawTable(_ascii(file, header, left), said)
        check_size(header.points, dtype.itemsize, left)
        table = np.fromfile(file, dtype, header.points)
        columns = {n: native(table[n]) for n in dtype.names or () if not n.startswith("_@")}
        return RawTable(columns, said)


def _header(file: IO[bytes]) -> _Header:
    entries: dict[str, list[str]] = {}
    comments: list[str] = []
    while "DATA" not in entries:
        line = file.readline(HEADER_LIMIT)
        if not line.endswith(b"\n") or file.tell() > HEADER_LIMIT:
            raise CloudError("the header has no end", reason="cloud_header")
        words = line.decode("latin-1").split()
        if words and words[0].startswith("#"):
            comments.append(line.decode("utf-8", "replace").strip().lstrip("# "))
        elif words:
            entries[{"COLUMNS": "FIELDS"}.get(words[0], words[0])] = words[1:]
    try:
        names, sizes, kinds = entries["FIELDS"], entries["SIZE"], entries["TYPE"]
        counts = [int(c) for c in entries.get("COUNT", ["1"] * len(names))]
        fields = tuple(
            (n, KINDS[k] + s, c) for n, k, s, c in zip(names, kinds, sizes, counts, strict=True)
        )
        size = int(entries["WIDTH"][0]) * int(entries["HEIGHT"][0])
        points, data = int(entries.get("POINTS", [str(size)])[0]), entries["DATA"][0]
    except (KeyError, IndexError, ValueError) as error:
        raise CloudError(
            f"the header lacks or garbles an entry: {short_repr(error)}", reason="cloud_header"
        ) from error
    if (
        points != size
        or points < 0
        or data not in ENCODINGS
        or min(counts, default=0) < 1
        or not {f[1] for f in fields} <= CODES
    ):
        raise CloudError("the header contradicts itself", reason="cloud_header", value=entries)
    row = sum(int(code[1]) * count for _, code, count in fields)
    if row > ROW_LIMIT:
        raise CloudError(f"a row of {row} bytes is no point", reason="cloud_header", value=row)
    return _Header(fields, points, data, comments)


def _ascii(file: IO[bytes], header: _Header, left: int) -> Columns:
    width = sum(count for _, _, count in header.fields)
    check_size(header.points, 2 * width - 1, left)
    values, at, out = text_rows(file, 0, header.points, width), 0, {}
    for name, code, count in header.fields:
        column = values[:, at] if count == 1 else values[:, at : at + count]
        at += count
        if name != "_":
            out[name] = integers(column, code) if code[0] in "iu" else column.copy()
    return out


def _read_compressed(file: IO[bytes], header: _Header, left: int) -> Columns:
    # column after column, without the padding, as the Point Cloud Library packs it
    dtype = np.dtype([d for d in header.dtype.descr if not d[0].startswith("_@")])
    sizes = np.frombuffer(file.read(8), "<u4").astype(np.int64)
    size = header.points * dtype.itemsize
    if len(sizes) < 2 or sizes[0] > left - 8:
        raise CloudError("the compressed data end early", reason="cloud_short")
    if sizes[1] != size or size > RATIO * sizes[0]:
        raise CloudError(
            f"{sizes[1]} bytes to unpack where the header asks for {size}",
            reason="cloud_header",
            value=int(sizes[1]),
        )
    if size > UNPACKED_LIMIT and size > MOST_PACKED * int(sizes[0]):
        raise CloudError(
            f"{sizes[0]} packed bytes claim to be {size}, more than points give: refused unread",
            reason="cloud_header",
            value=size,
        )
    done, data = unpack(np.fromfile(file, np.uint8, int(sizes[0])), size)
    if done != size:
        raise CloudError("the compressed data cannot be unpacked", reason="cloud_values")
    columns, at = {}, 0
    for name in dtype.names or ():
        kind, shape = dtype[name].base, (header.points, *dtype[name].shape)
        columns[name] = native(np.frombuffer(data, kind, math.prod(shape), at).reshape(shape))
        at += columns[name].nbytes
    return columns


def _header_lines(columns: Columns, comments: list[str], encoding: str) -> list[str]:
    """The header of columns (n,)."""
    rows = len(next(iter(columns.values())))
    codes = [c.dtype.str[1:] for c in columns.values()]
    return [
        "# .PCD v0.7 - Point Cloud Data file format",
        *(f"# {c}" for c in comments),
        "VERSION 0.7",
        f"FIELDS {' '.join(columns)}",
        f"SIZE {' '.join(c[1:] for c in codes)}",
        f"TYPE {' '.join(c[0].upper() for c in codes)}",
        f"COUNT {' '.join('1' for _ in codes)}",
        f"WIDTH {rows}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {rows}",
        f"DATA {encoding}",
    ]


def write_pcd(path: Path, columns: Columns, comments: list[str], encoding: str) -> None:
    """Write columns (n,); ``encoding`` is ascii, binary or binary_compressed. Raises OSError and
    :class:`OutputError`.
    """
    columns = {name: narrow(c) for name, c in columns.items()}
    lines = _header_lines(columns, comments, encoding)
    with path.open("wb") as file:
        file.write(("\n".join(lines) + "\n").encode())
        if encoding == "ascii":
            write_rows(file, columns, " ")
            return
        if encoding == "binary_compressed":
            data = np.frombuffer(
                b"".join(c.astype(c.dtype.newbyteorder("<")).tobytes() for c in columns.values()),
                np.uint8,
            )
            if len(data) >= 2**32:
                raise OutputError(
                    "more than 4 GB cannot be compressed in this format", value=len(data)
                )
            packed = pack(data)
            file.write(np.array([len(packed), len(data)], "<u4").tobytes() + packed.tobytes())
            return
        rows = len(next(iter(columns.values())))
        table = np.empty(rows, [(name, "<" + c.dtype.str[1:]) for name, c in columns.items()])
        for name, c in columns.items():
            table[name] = c
        file.write(table.data)
