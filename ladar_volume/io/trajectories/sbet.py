"""SBET, the smoothed best estimate of a trajectory (Applanix and others), and the file of its
accuracies (smrmsg), both little-endian doubles without a header.

SBET, 17 a pose: time (s), latitude, longitude (rad), height above the ellipsoid (m), three
velocities in the wander frame (m/s), roll, pitch, platform heading, wander angle (rad), three
accelerations (m/s²) and three angular rates (rad/s). The true heading is the platform heading less
the wander angle. smrmsg, 10 a pose: time, standard deviations of north, east, down (m) and of their
velocities (m/s), and of roll, pitch, heading (minutes of arc).
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from ladar_volume.io.trajectories.flown_path import FlownPath, attitudes, check_path
from ladar_volume.model.errors import InputError
from ladar_volume.model.records import F64

#: Doubles of a pose, and of its accuracies.
POSE, ACCURACY = 17, 10
#: Seconds of a GPS week; a flight may run on into the next.
WEEK_S = 604_800.0
MINUTE = math.radians(1.0 / 60.0)


def read_doubles(path: Path, columns: int) -> F64:
    """A table (n, columns) of doubles. Raises :class:`InputError` for a file that holds none."""
    try:
        size = path.stat().st_size
        if not size or size % (8 * columns):
            raise InputError(
                f"{path.name}: {size:,} bytes are no whole number of rows of {columns} doubles",
                reason="input_trajectory",
                value=size,
            )
        return np.fromfile(path, "<f8").astype(np.float64).reshape(-1, columns)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read: {error.strerror}", reason="input_missing", value=str(path)
        ) from error


def read_sbet(path: Path) -> FlownPath:
    """The trajectory of a file. Raises :class:`InputError` (input_trajectory)."""
    table = read_doubles(path, POSE)
    time, angles = table[:, 0], table[:, [1, 2, 7, 8, 9, 10]]
    # compared so that a number that is none is refused, too
    if not (np.abs(angles) <= 4.0 * math.pi).all() or not (np.abs(table[:, 1]) <= 1.58).all():
        raise InputError(
            f"{path.name}: its angles are no radians: no SBET of {POSE} doubles a pose",
            reason="input_trajectory",
        )
    lat, lon, roll, pitch, platform, wander = angles.T
    place = np.column_stack([np.degrees(lat), np.degrees(lon), table[:, 3]])
    return check_path(
        FlownPath(
            path, time.copy(), clock_of(time), place, attitudes(roll, pitch, platform - wander)
        )
    )


def clock_of(time_s: F64) -> str:
    """Seconds of a week, or since 1980, by their size."""
    return "week" if float(time_s.max()) < 2.0 * WEEK_S else "gps"


def with_accuracy(flown: FlownPath, path: Path) -> FlownPath:
    """The trajectory with the standard deviations of a smrmsg file at its times. Raises
    :class:`InputError` where that covers another time.
    """
    table = read_doubles(path, ACCURACY)
    time = table[:, 0]
    good = np.isfinite(table).all() and (np.diff(time) >= 0).all()
    if not good or (table[:, [1, 2, 3, 7, 8, 9]] < 0).any():
        raise InputError(
            f"{path.name}: no standard deviations in {ACCURACY} doubles a row",
            reason="input_trajectory",
        )
    slack = 1.0 + float(np.diff(time).max(initial=0.0))
    if time[0] > flown.time_s[0] + slack or time[-1] < flown.time_s[-1] - slack:
        raise InputError(
            f"{path.name} covers {time[0]:.1f} to {time[-1]:.1f} s, {flown.path.name} "
            f"{flown.time_s[0]:.1f} to {flown.time_s[-1]:.1f} s: of another flight?",
            reason="input_trajectory",
        )

    def at(column: int, unit: float = 1.0) -> F64:
        return np.interp(flown.time_s, time, table[:, column]) * unit

    return FlownPath(
        flown.path,
        flown.time_s,
        flown.clock,
        flown.place,
        flown.attitude,
        np.column_stack([at(2), at(1), at(3)]),
        np.column_stack([at(7, MINUTE), at(8, MINUTE), at(9, MINUTE)]),
    )
