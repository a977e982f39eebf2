"""The one reader of PLY headers and the one writer of PLY elements: types, encodings, properties.

What stands in the body is read by :mod:`~ladar_volume.io.pointfiles.ply` for points and by
:mod:`~ladar_volume.io.meshfiles.ply_mesh` for meshes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from ladar_volume.io.pointfiles.raw_table import Columns
from ladar_volume.model.errors import InputError, short_repr

#: Code of numpy by the word of a type, and the word that is written.
TYPES = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
NAMES = {
    "i1": "char",
    "u1": "uchar",
    "i2": "short",
    "u2": "ushort",
    "i4": "int",
    "u4": "uint",
    "f4": "float",
    "f8": "double",
}
#: Byte order by encoding, empty for text; the word of the header for each.
ENCODINGS = {"ascii": "", "binary": "<", "binary_big_endian": ">"}
#: Rows of an element that are written at once.
AT_ONCE = 1 << 18
FORMATS = {
    "ascii": "ascii",
    "binary": "binary_little_endian",
    "binary_big_endian": "binary_big_endian",
}
#: Longest header, bytes.
HEADER_LIMIT = 1_000_000


@dataclass
class Property:
    """name · code : type of a value · count : type of the length, empty where the property is no
    list
    """

    name: str
    code: str
    count: str = ""


@dataclass
class Element:
    """name · rows · properties"""

    name: str
    rows: int
    properties: list[Property] = field(default_factory=list)


@dataclass
class Header:
    """order : of the bytes, empty for text · elements : in the order of the body · comments"""

    order: str
    elements: list[Element]
    comments: list[str]


def read_header(file: IO[bytes]) -> Header:
    """The header of a file, which is left at its body. Raises :class:`InputError` (ply_header)."""
    if file.readline(16).strip() != b"ply":
        raise _bad("does not begin with 'ply'")
    order: str | None = None
    elements: list[Element] = []
    comments: list[str] = []
    while True:
        line = file.readline(HEADER_LIMIT)
        if not line.endswith(b"\n") or file.tell() > HEADER_LIMIT:
            raise _bad("the header has no end")
        words = line.decode("latin-1").split()
        if words[:1] == ["end_header"]:
            break
        try:
            if words[:1] == ["comment"]:
                comments.append(line.decode("utf-8", "replace").strip()[len("comment") :].strip())
            elif words[:1] == ["format"]:
                order = {name: ENCODINGS[key] for key, name in FORMATS.items()}[words[1]]
            elif words[:1] == ["element"]:
                elements.append(Element(words[1], int(words[2])))
            elif words[:2] == ["property", "list"]:
                elements[-1].properties.append(Property(words[4], TYPES[words[3]], TYPES[words[2]]))
            elif words[:1] == ["property"]:
                elements[-1].properties.append(Property(words[2], TYPES[words[1]]))
        except (KeyError, IndexError, ValueError) as error:
            text = short_repr(" ".join(words))
            raise _bad(f"header line {text} cannot be understood") from error
    if order is None or any(e.rows < 0 for e in elements):
        raise _bad("the header names no format, or a negative count")
    return Header(order, elements, comments)


def _bad(words: str) -> InputError:
    return InputError(words, reason="ply_header")


def header_bytes(encoding: str, comments: Sequence[str], elements: Mapping[str, Columns]) -> bytes:
    """The header of elements with columns (n,), or lists of k values each (n, k)."""
    lines = ["ply", f"format {FORMATS[encoding]} 1.0", *(f"comment {c}" for c in comments)]
    for name, columns in elements.items():
        lines.append(f"element {name} {_rows(columns)}")
        for key, column in columns.items():
            kind = NAMES[column.dtype.str[1:]]
            lines.append(f"property {kind if column.ndim == 1 else f'list uchar {kind}'} {key}")
    return ("\n".join([*lines, "end_header"]) + "\n").encode()


def write_elements(
    path: Path,
    comments: Sequence[str],
    elements: Mapping[str, Columns],
    encoding: str = "binary",
) -> None:
    """Write elements with columns (n,), or lists (n, k), as binary PLY. Raises OSError."""
    with path.open("wb") as file:
        file.write(header_bytes(encoding, comments, elements))
        for columns in elements.values():
            for first in range(0, _rows(columns), AT_ONCE):
                some = {name: c[first : first + AT_ONCE] for name, c in columns.items()}
                file.write(_table(some, ENCODINGS[encoding]).data)


def _rows(columns: Columns) -> int:
    return len(next(iter(columns.values())))


def _table(columns: Columns, order: str) -> npt.NDArray[Any]:
    """The rows of an element as they stand in the file."""
    fields: list[tuple[str, str, tuple[int, ...]]] = []
    for name, column in columns.items():
        fields += [(f"#{name}", "u1", ())] if column.ndim > 1 else []
        fields.append((name, order + column.dtype.str[1:], column.shape[1:]))
    table = np.empty(_rows(columns), fields)
    for name, column in columns.items():
        if column.ndim > 1:
            table[f"#{name}"] = column.shape[1]
        table[name] = column
    return table
