"""Trajectories as text: the ``.pos`` of RTKLIB, and tables whose first line names the columns, as
post-processing programs write them.

A line that begins with ``%`` or ``#`` is a comment; the last one before the numbers may name the
columns. Angles are degrees, heights above the ellipsoid in m.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from ladar_volume.io.trajectories.flown_path import FlownPath, attitudes, check_path
from ladar_volume.io.trajectories.sbet import WEEK_S, clock_of
from ladar_volume.model.errors import InputError
from ladar_volume.model.records import F64

#: What columns are called, in lower case without units and signs.
NAMES = {
    "time": ("time", "gpstime", "gpst", "utc", "sow", "tow", "secondsofweek", "gpssow", "seconds"),
    "week": ("week", "gpsweek"),
    "lat": ("latitude", "lat"),
    "lon": ("longitude", "lon", "long"),
    "height": ("height", "hell", "ellipsoidalheight", "altitude", "alt", "ellheight", "h"),
    "roll": ("roll",),
    "pitch": ("pitch",),
    "heading": ("heading", "yaw", "trueheading"),
    "sigma_n": ("sdn", "sdnorth", "stdn", "northstd"),
    "sigma_e": ("sde", "sdeast", "stde", "eaststd"),
    "sigma_u": ("sdu", "sdheight", "sdup", "stdu", "upstd"),
    "sigma_roll": ("rollsd", "sdroll", "rollstd"),
    "sigma_pitch": ("pitchsd", "sdpitch", "pitchstd"),
    "sigma_heading": ("headingsd", "hdngsd", "sdheading", "headingstd", "yawstd"),
}
#: Leap seconds, GPS ahead of UTC, from these dates on.
LEAPS = ((2006, 1, 14), (2009, 1, 15), (2012, 7, 16), (2015, 7, 17), (2017, 1, 18))
EPOCH = datetime(1980, 1, 6, tzinfo=UTC)
DATE = re.compile(r"^(\d{4})[/-](\d{2})[/-](\d{2})$")
#: Most characters of a file.
SIZE = 500_000_000


def read_pos(path: Path) -> FlownPath:
    """The trajectory of a text file. Raises :class:`InputError` (input_trajectory)."""
    head, rows = lines_of(path)
    names = names_of(head[-1]) if head else {}
    dated = bool(DATE.match(rows[0][0]))
    if not names:
        raise InputError(
            f"{path.name}: no line names its columns; write one above the numbers, for example "
            "'% time latitude longitude height roll pitch heading'",
            reason="input_trajectory",
        )
    utc = "utc" in re.sub(r"[^a-z ]", " ", head[-1].lower()).split()
    # a date takes two columns, and RTKLIB's week and seconds stand under one name
    spread = dated or ("week" not in names and is_week(rows, names))
    wide = {key: at + (spread and at > names["time"]) for key, at in names.items()}
    columns = numbers(path, rows, wide, dated, spread)
    time, clock = seconds(rows, columns, dated, spread)
    if utc and clock == "gps":
        time = time + leap_s(time)
    elif utc:
        raise InputError(
            f"{path.name}: seconds of a week in UTC: give GPS time, or dates",
            reason="input_trajectory",
        )
    place = np.column_stack([columns[k] for k in ("lat", "lon", "height")])
    turned = {"roll", "pitch", "heading"} <= set(columns)
    attitude = None
    if turned:
        attitude = attitudes(*(np.radians(columns[k]) for k in ("roll", "pitch", "heading")))
    return check_path(
        FlownPath(
            path,
            time,
            clock,
            place,
            attitude,
            stacked_columns(columns, ("sigma_e", "sigma_n", "sigma_u")),
            stacked_columns(columns, ("sigma_roll", "sigma_pitch", "sigma_heading"), np.pi / 180.0),
        )
    )


def lines_of(path: Path) -> tuple[list[str], list[list[str]]]:
    """Lines of comment before the numbers, and the numbers' words."""
    try:
        if path.stat().st_size > SIZE:
            raise InputError(f"{path.name}: too large", reason="input_trajectory")
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read: {error.strerror}", reason="input_missing", value=str(path)
        ) from error
    head: list[str] = []
    rows: list[list[str]] = []
    for line in lines:
        words = re.split(r"[\s,;]+", line.strip().strip(",;"))
        if words and words[0][:1].isdigit():
            rows.append(words)
        elif not rows and line.strip():
            head.append(line.strip().lstrip("%#").strip())
    if not rows:
        raise InputError(f"{path.name}: holds no poses", reason="input_trajectory")
    return head, rows


def names_of(line: str) -> dict[str, int]:
    """Which column is what, by the words of a line; empty where time or place is missing."""
    words = [re.sub(r"\(.*?\)|\[.*?\]|[^a-z]", "", w) for w in re.split(r"[\s,;]+", line.lower())]
    words = [w for w in words if w and w not in ("deg", "m", "s")]
    found = {}
    for key, known in NAMES.items():
        at = next((k for k, word in enumerate(words) if word in known), None)
        if at is not None:
            found[key] = at
    return found if {"time", "lat", "lon", "height"} <= set(found) else {}


def is_week(rows: list[list[str]], names: dict[str, int]) -> bool:
    """Whether the time is a week and its seconds: a whole number below 10,000 in every row, and
    one column more than there are names for place.
    """
    at = names["time"]
    first = {row[at] for row in (rows[0], rows[-1])}
    return all(w.isdigit() and 1000 <= int(w) < 10_000 for w in first)


def numbers(
    path: Path, rows: list[list[str]], names: dict[str, int], dated: bool, spread: bool
) -> dict[str, F64]:
    """The columns by their keys; of a date or a week that of the seconds."""
    out = {}
    for key, at in names.items():
        if key == "time" and dated:
            continue
        place = at + (spread and key == "time")
        try:
            out[key] = np.array([float(row[place]) for row in rows])
        except (ValueError, IndexError) as error:
            raise InputError(
                f"{path.name}: the column {key} holds what is no number, or ends early",
                reason="input_trajectory",
            ) from error
    return out


def seconds(
    rows: list[list[str]], columns: dict[str, F64], dated: bool, spread: bool
) -> tuple[F64, str]:
    """Times, s, and their clock."""
    if dated:
        stamps = [f"{row[0].replace('/', '-')}T{row[1]}+00:00" for row in rows]
        return np.array([_gps_seconds(stamp) for stamp in stamps]), "gps"
    if spread:
        week = np.array([float(row[0]) for row in rows])
        return week * WEEK_S + columns["time"], "gps"
    if "week" in columns:
        return columns["week"] * WEEK_S + columns["time"], "gps"
    return columns["time"], clock_of(columns["time"])


def _gps_seconds(stamp: str) -> float:
    """Seconds since 6 January 1980. Raises :class:`InputError`."""
    try:
        return (datetime.fromisoformat(stamp) - EPOCH) / timedelta(seconds=1)
    except ValueError as error:
        raise InputError(f"{stamp[:40]}: no date", reason="input_trajectory") from error


def leap_s(time_s: F64) -> float:
    """By how much GPS time is ahead of UTC at the first of times, s since 1980."""
    ahead = 13.0
    for year, month, total in LEAPS:
        if EPOCH + timedelta(seconds=float(time_s[0])) >= datetime(year, month, 1, tzinfo=UTC):
            ahead = float(total)
    return ahead


def stacked_columns(
    columns: dict[str, F64], keys: tuple[str, str, str], unit: float = 1.0
) -> F64 | None:
    """Three columns (n, 3); None where one is missing."""
    if not set(keys) <= set(columns):
        return None
    return unit * np.column_stack([columns[key] for key in keys])
