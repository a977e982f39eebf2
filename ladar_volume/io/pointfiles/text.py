"""Point clouds as text: XYZ, TXT, ASC (white space), CSV (comma) and PTS (the number of points
first), with or without header, with comments; names, units and decimal commas of other programs.
"""

from __future__ import annotations

import codecs
import itertools
import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ladar_volume.io.pointfiles.crs import of_comments
from ladar_volume.io.pointfiles.ply import write_rows
from ladar_volume.io.pointfiles.raw_table import Columns, RawTable, axis_columns
from ladar_volume.model.errors import CloudError, OutputError

COMMENTS = ("#", "//", "%")
#: Longest line that is looked at: a file without line ends is not a table.
LINE_LIMIT = 100_000
#: Rows from which decimal commas and the step of the numbers are told.
SAMPLE = 2_000
#: Rows from which on a first column that counts them is no coordinate.
COUNTED = 4
#: A line that holds the number of points that follow.
COUNT = re.compile(r"^\d{1,15}$")
#: Columns after x, y, z of a PTS file, by the number of all.
PTS = {4: ["intensity"], 6: ["red", "green", "blue"], 7: ["intensity", "red", "green", "blue"]}
#: A number with a decimal comma.
COMMA = re.compile(r"^[+-]?\d*,\d+([eE][+-]?\d+)?$")
#: A row of decimal commas with commas between, which could mean two things.
AMBIGUOUS = re.compile(r"^[+-]?\d+,\d+(\s*,\s+[+-]?\d+,\d+)+\s*$")


@dataclass(frozen=True)
class _Layout:
    names: list[str]
    skip: int
    separator: str | None
    numeric: list[bool]
    comma: bool = False
    quoted: bool = False
    comments: list[str] = field(default_factory=list)
    encoding: str = "utf-8-sig"
    announced: int | None = None


def text_table(path: Path) -> RawTable:
    """The columns (n,) of a table in file order, numbers as float64, anything else as text; what
    comments say of CRS and units, and the step of the numbers.

    The separator is a semicolon, a tab, a comma, or white space, as the first row shows; with the
    others than a comma, numbers may have decimal commas. Names come from a header, also one that is
    a comment; without one they are x, y, z, c3, c4, ... Lines that begin with #, // or % before the
    table, and # after it, are comments. Raises :class:`CloudError` (cloud_empty, cloud_fields,
    cloud_values) and OSError.
    """
    layout = _layout(path)
    try:
        columns = _columns(path, layout)
    except (ValueError, OverflowError) as error:
        raise CloudError(
            _first_bad_row(path, layout) or f"a row that does not fit the table: {error}",
            reason="cloud_values",
        ) from error
    _check_counted(layout, columns)
    count = len(columns[layout.names[0]])
    if layout.announced is not None and layout.announced != count:
        words = f"{layout.announced} points are announced in the first line, {count} are there"
        raise CloudError(words, reason="cloud_short", value=count)
    return RawTable(columns, of_comments(layout.comments), _step(path, layout))


def _check_counted(layout: _Layout, columns: Columns) -> None:
    """Refuse a table without a header whose first column counts the rows: it is the number of a
    point, as in "number, northing, easting, height", and no coordinate.
    """
    first = columns[layout.names[0]]
    if layout.names[:4] != ["x", "y", "z", "c3"] or len(first) < COUNTED or first.dtype.kind != "f":
        return
    if bool((np.diff(first) == 1.0).all()):
        raise CloudError(
            f"the first column counts the rows, {first[0]:g} to {first[-1]:g}: name the columns in "
            "a first line, as number northing easting height",
            reason="cloud_fields",
        )


def _columns(path: Path, layout: _Layout) -> Columns:
    plain = all(layout.numeric)
    with warnings.catch_warnings(), path.open(encoding=layout.encoding) as file:
        warnings.simplefilter("ignore", UserWarning)  # no rows at all is refused by the caller
        points = (line.replace(",", ".") for line in file)
        table = np.loadtxt(
            points if plain and layout.comma else path,
            dtype=np.float64 if plain else np.str_,
            delimiter=layout.separator,
            skiprows=layout.skip,
            ndmin=2,
            quotechar=None if plain and not layout.quoted else '"',
            encoding=layout.encoding,
        )
    if table.size and table.shape[1] != len(layout.names):
        raise CloudError(
            f"{table.shape[1]} columns under {len(layout.names)} names", reason="cloud_fields"
        )
    table = table.reshape(-1, len(layout.names))
    out: Columns = {}
    for k, (name, numeric) in enumerate(zip(layout.names, layout.numeric, strict=True)):
        column: npt.NDArray[Any] = table[:, k]
        if not plain and numeric and layout.comma:
            column = np.char.replace(column, ",", ".")
        out[name] = column.astype(np.float64 if numeric else np.str_)
    return out


def _layout(path: Path) -> _Layout:
    header: list[str] = []
    comments: list[str] = []
    titled, encoding, announced = False, _encoding(path), None
    with path.open(encoding=encoding, errors="replace") as file:
        for number in itertools.count():
            line = file.readline(LINE_LIMIT)
            text = line.strip("\r\n ")
            if not line:
                raise CloudError("there is no row of numbers", reason="cloud_empty")
            if len(line) == LINE_LIMIT:
                raise CloudError("a line without end: this is not a table", reason="cloud_values")
            comment = next((c for c in COMMENTS if text.startswith(c)), None)
            if not text.strip() or comment:
                if comment and not titled:
                    note = text.lstrip("#/% ")
                    comments.append(note)
                    words = _words(note, _separator(note))
                    header = words if _has_xyz(words) or not _has_xyz(header) else header
                continue
            separator = _separator(text)
            words = _words(text, separator)
            comma = separator != "," and any(COMMA.match(w) for w in words)
            if COUNT.match(text) and announced is None and not titled:
                announced = int(text)
                continue
            if _is_number(words[0], separator != ","):
                named = titled or (
                    len(header) == len(words) and _has_xyz(header)
                )  # a comment may be no header at all
                names = header if named else usual_names(path, len(words))
                if AMBIGUOUS.match(text):
                    raise CloudError(
                        f"the row {text[:80]!r}: commas between numbers and within them; write "
                        "decimal points, or semicolons between",
                        reason="cloud_fields",
                    )
                if len(words) < 3 or len(names) != len(words) or len(set(names)) < len(names):
                    raise CloudError(
                        f"line {number + 1}: the row {text[:80]!r} does not fit the columns "
                        f"{', '.join(names)[:100]}",
                        reason="cloud_fields",
                    )
                rows = [text, *itertools.islice(file, SAMPLE)]
                comma = comma or (
                    separator != "," and any(COMMA.match(w) for w in _sample_rows(rows, separator))
                )
                numeric = [_is_number(w, separator != ",") or not w for w in words]
                quoted = '"' in text
                return _Layout(
                    *(names, number, separator, numeric, comma, quoted, comments, encoding),
                    announced,
                )
            if titled or not _has_xyz(words):
                raise CloudError(
                    f"line {number + 1}: the row {text[:80]!r} is neither numbers nor a header "
                    "that names x, y, z (or easting, northing, height)",
                    reason="cloud_fields",
                )
            header, titled = words, True
    raise AssertionError("unreachable")


def usual_names(path: Path, count: int) -> list[str]:
    """What the columns of a table without names are."""
    more = PTS.get(count) if path.suffix.lower() == ".pts" else None
    return [*"xyz", *(more or [f"c{k}" for k in range(3, count)])]


def _encoding(path: Path) -> str:
    """UTF-8, UTF-16 with its mark ("Unicode text" of spreadsheets), or Latin-1 where the first
    lines are neither.
    """
    with path.open("rb") as file:
        start = file.read(LINE_LIMIT)
    if start.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    try:
        codecs.getincrementaldecoder("utf-8")().decode(start)
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8-sig"


def _sample_rows(rows: list[str], separator: str | None) -> Iterator[str]:
    return (w for row in rows for w in _words(row.strip("\r\n "), separator))


def _separator(text: str) -> str | None:
    """What stands between the columns of a row; None: white space."""
    bare = re.sub(r'"[^"]*"', "", text)
    if ";" in bare:
        return ";"
    words = bare.split()
    if len(words) >= 3 and all(_is_number(w, True) for w in words):
        return None  # white space alone tells them apart, decimal commas or not
    tabbed = text.strip().split("\t")
    if len(tabbed) >= 3 and all(w.strip() for w in tabbed):
        return "\t"
    if "," not in bare:
        return None
    return ","


def _words(text: str, separator: str | None) -> list[str]:
    if separator is None:
        text = re.sub(r"\s+([\[(][^\])]*[\])])", r"\1", text)  # "X [m]" is one name
    return [w.strip().strip('"') for w in text.split(separator)]


def _is_number(word: str, comma: bool = False) -> bool:
    try:
        float(word.replace(",", ".") if comma and COMMA.match(word) else word)
    except ValueError:
        return False
    return True


def _has_xyz(words: list[str]) -> bool:
    try:
        return len(axis_columns(words)[0]) == 3
    except CloudError:
        return True  # named twice: refused with both names, later


def _rows(path: Path, layout: _Layout) -> Iterator[tuple[int, list[str]]]:
    """Line number, from 1, and words of every row."""
    with path.open(encoding=layout.encoding, errors="replace") as file:
        for number, line in enumerate(file, 1):
            text = line.split("#")[0].strip("\r\n ")
            if number > layout.skip and text.strip():
                yield number, _words(text, layout.separator)


def _first_bad_row(path: Path, layout: _Layout) -> str | None:
    """The first row that does not fit, in words with its line number."""
    for number, words in _rows(path, layout):
        row = repr((layout.separator or " ").join(words)[:60])
        if len(words) != len(layout.names):
            return f"line {number}: {len(words)} columns where there are {len(layout.names)}: {row}"
        for word, name, numeric in zip(words, layout.names, layout.numeric, strict=True):
            if numeric and not _is_number(word, layout.comma):
                return f"line {number}: {name[:30]} is no number: {word[:30]!r}"
    return None


def _step(path: Path, layout: _Layout) -> tuple[float, float, float] | None:
    """The finest decimal of the first rows, for x, y, z."""
    try:
        axes, _ = axis_columns(layout.names)
        places = [layout.names.index(axes[a]) for a in "xyz"]
    except (CloudError, KeyError):
        return None
    finest = [10**9] * 3
    for _, words in itertools.islice(_rows(path, layout), SAMPLE):
        for k, place in enumerate(places):
            try:
                exponent = Decimal(words[place].replace(",", ".")).as_tuple().exponent
            except (InvalidOperation, IndexError):
                return None
            if isinstance(exponent, int):
                finest[k] = min(finest[k], exponent)
    x, y, z = (10.0 ** max(e, -300) if e < 300 else 0.0 for e in finest)
    return x, y, z


def write_text(path: Path, columns: Columns, comments: list[str], encoding: str) -> None:
    """Write columns (n,) with a header: ``encoding`` "csv" with commas, "text" with spaces and the
    header as a comment, after the ``comments`` of CRS and units (a CSV has no place for these).

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
        notes = [] if encoding == "csv" else [f"# {c}\n" for c in comments]
        file.write(("".join(notes) + mark + separator.join(columns) + "\n").encode())
        write_rows(file, columns, separator)
