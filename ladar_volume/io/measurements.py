"""Tables of repeated measurements: CSV with a header, one row per measurement, optionally a column
that names the mounting.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ladar_volume.model.errors import CalibrationError, short_repr
from ladar_volume.model.records import F64


@dataclass(frozen=True)
class Measurements:
    """columns : values (n,) by name, in the table's units · mounting : label of each row, None
    where the table has no such column
    """

    columns: dict[str, F64]
    mounting: list[str] | None


def _value_columns(path: Path, rows: list[list[str]], known: tuple[str, ...]) -> list[str]:
    """Names of the columns of values. Refuses other columns, and rows of another length."""
    names = rows[0]
    strange = [n for n in names if n not in (*known, "mounting", "note")]
    values = [n for n in names if n in known]
    if strange or not values or len(set(names)) < len(names):
        raise CalibrationError(
            (
                f"{path}: columns {', '.join(names)}: expected are some of "
                f"{', '.join(known)}, each once, and 'mounting' or 'note'"
            ),
            reason="calibration_columns",
            value=strange or names,
        )
    for number, row in enumerate(rows[1:], 1):
        if len(row) != len(names):
            raise CalibrationError(
                f"{path}: row {number} has {len(row)} cells, the header {len(names)}",
                reason="calibration_values",
            )
    return values


def read_measurements(path: Path, known: tuple[str, ...]) -> Measurements:
    """Read a table whose columns are among ``known``, ``mounting`` and, left aside, ``note``.

    Comma or semicolon separates; lines that begin with # are comments. Raises
    :class:`CalibrationError` naming row and column: calibration_file, calibration_columns,
    calibration_values.
    """
    try:
        lines = [
            line
            for line in path.read_text(encoding="utf-8-sig").splitlines()
            if line.strip() and not line.lstrip().startswith("#")
        ]
    except (OSError, UnicodeDecodeError) as error:
        raise CalibrationError(
            f"{path}: cannot be read: {error}", reason="calibration_file", value=str(path)
        ) from error
    if len(lines) < 2:
        raise CalibrationError(
            f"{path}: a header and rows of numbers are expected",
            reason="calibration_file",
            value=str(path),
        )
    rows = [
        [w.strip() for w in row]
        for row in csv.reader(lines, delimiter=";" if ";" in lines[0] else ",")
    ]
    names = rows[0]
    values = _value_columns(path, rows, known)
    columns = {
        name: _numbers(path, name, [row[names.index(name)] for row in rows[1:]]) for name in values
    }
    mounting = [row[names.index("mounting")] for row in rows[1:]] if "mounting" in names else None
    if mounting is not None and "" in mounting:
        raise CalibrationError(
            f"{path}: row {mounting.index('') + 1} names no mounting", reason="calibration_values"
        )
    return Measurements(columns, mounting)


def _numbers(path: Path, name: str, words: list[str]) -> F64:
    out = np.empty(len(words))
    for number, word in enumerate(words):
        try:
            out[number] = float(word)
        except ValueError:
            out[number] = np.nan
        if not np.isfinite(out[number]):
            raise CalibrationError(
                f"{path}: row {number + 1}, {name}: {short_repr(word)} is not a finite number",
                reason="calibration_values",
                value=word,
            )
    return out
