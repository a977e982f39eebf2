"""Times of points on the clock of a trajectory: seconds of the GPS week, GPS seconds, or LAS's
adjusted standard GPS time (GPS seconds less a thousand million).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from ladar_volume.io.trajectories.flown_path import FlownPath
from ladar_volume.io.trajectories.sbet import WEEK_S
from ladar_volume.model.errors import InputError
from ladar_volume.model.records import F64

#: Names of a column of times, in lower case, in order of preference.
NAMES = ("gps_time", "gpstime", "gps_seconds", "timestamp", "time", "t")
#: What LAS takes from GPS seconds; between these are adjusted ones; beyond are seconds since 1970.
ADJUSTED_S, LEAST_GPS_S, UNIX_S = 1e9, 8e8, 1.6e9


def time_column(columns: Mapping[str, npt.NDArray[Any]]) -> F64:
    """The times (n,) s of points as they stand in the file. Raises :class:`InputError`
    (input_times).
    """
    lower = {name.lower(): name for name in columns}
    name = next((lower[n] for n in NAMES if n in lower), None)
    if name is None:
        raise InputError(
            "--trajectory: the points have no time (a column gps_time): export them with GPS time",
            reason="input_times",
        )
    time = np.asarray(columns[name])
    if time.dtype.kind not in "fiu" or time.ndim != 1 or not np.isfinite(time).all():
        raise InputError(f"--trajectory: {name} holds no times", reason="input_times")
    time = time.astype(np.float64)
    if not time.any() or (len(time) > 1 and float(np.ptp(time)) == 0.0):
        raise InputError(
            f"--trajectory: {name} is {time[0]:g} at every point: export the points with GPS time",
            reason="input_times",
        )
    return time


def on_clock(time_s: F64, flown: FlownPath) -> tuple[F64, str]:
    """Times (n,) of points as the trajectory counts them, and how they were counted, in words.
    Raises :class:`InputError` (input_times) where the two are of different times.
    """
    low, high = float(time_s.min()), float(time_s.max())
    if low >= UNIX_S:
        raise InputError(
            f"--trajectory: times of points from {low:.0f} s: seconds since 1970, not GPS time",
            reason="input_times",
            value=low,
        )
    if high < 2.0 * WEEK_S:
        words, week = "seconds of the GPS week", True
        shift = 0.0 if flown.clock == "week" else WEEK_S * np.floor(flown.time_s[0] / WEEK_S)
    else:
        adjusted = low < LEAST_GPS_S
        words = "adjusted standard GPS time" if adjusted else "GPS seconds"
        shift, week = ADJUSTED_S if adjusted else 0.0, False
        if flown.clock == "week":
            shift -= WEEK_S * np.floor((low + shift) / WEEK_S)
    # a flight may run on beyond the end of a week
    turns = (0.0, WEEK_S, -WEEK_S) if week or flown.clock == "week" else (0.0,)
    some = time_s[:: max(1, len(time_s) // 10_000)] + shift
    first, last = float(flown.time_s[0]), float(flown.time_s[-1])
    shares = [np.mean((some + turn >= first) & (some + turn <= last)) for turn in turns]
    best = int(np.argmax(shares))
    if not shares[best] > 0.0:
        raise InputError(
            f"--trajectory: the points are of {low + shift:.1f} to {high + shift:.1f} s "
            f"({words}), {flown.path.name} of {first:.1f} to {last:.1f} s: of another flight, or "
            "another clock; --set calibration.clock_offset_s shifts the points",
            reason="input_times",
            value=low + shift,
        )
    return time_s + (shift + turns[best]), words
