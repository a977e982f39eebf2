"""Point clouds as text: XYZ, TXT, ASC (white space) and CSV (comma), with or without header, with
comments.
"""

from __future__ import annotations

import itertools
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ladar_volume.io.pointfiles.ply import Columns, write_rows
from ladar_volume.model.errors import CloudError, OutputError

COMMENTS = ("#", "//", "%")
#: Longest line that is looked at: a file without line ends is not a table.
LINE_LIMIT = 100_000


@dataclass(frozen=True)
class _Layout:
    names: list[str]
    skip: int
    separator: str | None
    numeric: list[bool]


def read_text(path: Path) -> Columns:
    """The columns (n,) of a table in file order, numbers as float64, anything else as text.

    The separator is a semicolon, a comma, or white space, as the first row shows. Names come from a
    header, also one that is a comment; without one they are x, y, z, c3, c4, ... Lines that begin
    with #, // or % before the table, and # after it, are comments. Raises :class:`CloudError`
    (cloud_empty, cloud_fields, cloud_values) and OSError.
    """
    layout = _layout(path)
    plain = all(layout.numeric)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # no rows at all is refused by the caller
            table = np.loadtxt(
                path,
                dtype=np.float64 if plain else np.str_,
                delimiter=layout.separator,
                skiprows=layout.skip,
                ndmin=2,
                encoding="utf-8-sig",
                quotechar=None if plain else '"',
            )
            if table.size and table.shape[1] != len(layout.names):
                raise CloudError(
                    f"{table.shape[1]} columns under {len(layout.names)} names",
                    reason="cloud_fields",
                )
            table = table.reshape(-1, len(layout.names))
            kinds = [np.float64 if numeric else np.str_ for numeric in layout.numeric]
            return {name: table[:, k].astype(kinds[k]) for k, name in enumerate(layout.names)}
    except ValueError as error:
        raise CloudError(
            f"a row that does not fit the table: {error}", reason="cloud_values"
        ) from error


def _layout(path: Path) -> _Layout:
    header: list[str] = []
    titled = False
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        for number in itertools.count():
            line = file.readline(LINE_LIMIT)
            text = line.strip()
            if not line:
                raise CloudError("there is no row of numbers", reason="cloud_empty")
            if len(line) == LINE_LIMIT:
                raise CloudError("a line without end: this is not a table", reason="cloud_values")
            comment = next((c for c in COMMENTS if text.startswith(c)), None)
            if not text or comment:
                if comment and not titled:
                    header = _words(text.lstrip("#/% "), _separator(text))
                continue
            separator = _separator(text)
            words = _words(text, separator)
            if _is_number(words[0]):
                named = titled or (
                    len(header) == len(words) and _has_xyz(header)
                )  # a comment may be no header at all
                names = header if named else [*"xyz", *(f"c{k}" for k in range(3, len(words)))]
                if len(words) < 3 or len(names) != len(words) or len(set(names)) < len(names):
                    raise CloudError(
                        f"the row {text[:80]!r} does not fit the columns {', '.join(names)}",
                        reason="cloud_fields",
                    )
                return _Layout(names, number, separator, [_is_number(w) or not w for w in words])
            if titled or not _has_xyz(words):
                raise CloudError(
                    f"the row {text[:80]!r} is neither numbers nor a header with x, y, z",
                    reason="cloud_fields",
                )
            header, titled = words, True
    raise AssertionError("unreachable")


def _separator(text: str) -> str | None:
    return next((s for s in (";", ",") if s in text), None)


def _words(text: str, separator: str | None) -> list[str]:
    return [w.strip().strip('"') for w in text.split(separator)]


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _has_xyz(words: list[str]) -> bool:
    return {"x", "y", "z"} <= {w.lower() for w in words}


def write_text(path: Path, columns: Columns, comments: list[str], encoding: str) -> None:
    """Write columns (n,) with a header: ``encoding`` "csv" with commas, "text" with spaces and the
    header as a comment.

    Raises OSError, and :class:`OutputError` for text that holds a separator.
    """
    separator = "," if encoding == "csv" else " "
    for name, c in columns.items():
        if c.dtype.kind == "U" and any(
            set(v) & set(' ,;#"\n\t') or not v for v in np.unique(c).tolist()
        ):
            raise OutputError(f"column {name!r} holds text with a separator, or none", value=name)
    with path.open("wb") as file:
        mark = "" if encoding == "csv" else "# "
        file.write((mark + separator.join(columns) + "\n").encode())
        write_rows(file, columns, separator)
