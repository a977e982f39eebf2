"""A finished trajectory as a file holds it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ladar_volume.math.se3 import multiply_quaternions
from ladar_volume.model.errors import InputError
from ladar_volume.model.records import F64

#: Half turns from north, east, down to east, north, up, and of the body from forward, right, down
#: to forward, left, up; quaternions xyzw.
_TO_ENU = np.array([np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0])
_TO_FLU = np.array([1.0, 0.0, 0.0, 0.0])
#: Fewest poses of a path.
LEAST = 2


@dataclass(frozen=True)
class FlownPath:
    """time_s : (n,) strictly increasing, s · clock : "week" for seconds of a GPS week, which may
    run on beyond its end, "gps" for seconds since 6 January 1980 · place : (n, 3) latitude and
    longitude, deg, and height above the ellipsoid, m, WGS 84 · attitude : (n, 4) quaternion xyzw,
    body forward, left, up to the local east, north, up; None where the file has none ·
    position_sigma_m : (n, 3) east, north, up · attitude_sigma_rad : (n, 3) roll, pitch, heading;
    both None where the file says nothing · path : of the file
    """

    path: Path
    time_s: F64
    clock: str
    place: F64 = field(repr=False)
    attitude: F64 | None = field(repr=False)
    position_sigma_m: F64 | None = field(default=None, repr=False)
    attitude_sigma_rad: F64 | None = field(default=None, repr=False)

    def __len__(self) -> int:
        return len(self.time_s)


def attitudes(roll: F64, pitch: F64, heading: F64) -> F64:
    """Quaternions (n, 4), forward, left, up to east, north, up, of roll, pitch and true heading,
    rad, each (n,), of a body forward, right, down in north, east, down: ``Rz(heading) Ry(pitch)
    Rx(roll)``.
    """
    half = [0.5 * angle for angle in (roll, pitch, heading)]
    (cr, cp, cy), (sr, sp, sy) = (f(half) for f in (np.cos, np.sin))
    q = np.column_stack(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ]
    )
    turned = multiply_quaternions(np.broadcast_to(_TO_ENU, q.shape), q)
    out: F64 = multiply_quaternions(turned, np.broadcast_to(_TO_FLU, q.shape))
    return out


def check_path(path: FlownPath) -> FlownPath:
    """The path with poses of equal time counted once. Raises :class:`InputError`
    (input_trajectory) for numbers that are none, a time that runs back, and places that are not on
    the earth.
    """
    name, t, place = path.path.name, path.time_s, path.place
    arrays = (t, place, path.attitude, path.position_sigma_m, path.attitude_sigma_rad)
    given = [array for array in arrays if array is not None]
    if not all(np.isfinite(array).all() for array in given):
        raise InputError(f"{name}: holds numbers that are none", reason="input_trajectory")
    step = np.diff(t)
    if (step < 0).any():
        at = int(np.argmax(step < 0))
        raise InputError(
            f"{name}: time runs back from {t[at]:.3f} to {t[at + 1]:.3f} s at pose {at + 2}: give "
            "one flight",
            reason="input_trajectory",
            value=at,
        )
    lat, lon, height = np.abs(place).max(axis=0)
    if lat > 90.0 or lon > 360.0 or height > 100_000.0:
        raise InputError(
            f"{name}: latitudes to {lat:.4g}°, longitudes to {lon:.4g}°, heights to {height:.4g} m "
            "are not on the earth: no trajectory of this kind",
            reason="input_trajectory",
        )
    sigmas = [s for s in (path.position_sigma_m, path.attitude_sigma_rad) if s is not None]
    if any((s < 0).any() for s in sigmas):
        raise InputError(f"{name}: negative standard deviations", reason="input_trajectory")
    keep = np.r_[True, step > 0]
    if np.count_nonzero(keep) < LEAST:
        raise InputError(f"{name}: holds fewer than {LEAST} poses", reason="input_trajectory")
    return path if keep.all() else rows_of(path, np.flatnonzero(keep))


def rows_of(path: FlownPath, rows: slice | np.ndarray) -> FlownPath:
    """Some poses of a path."""

    def part(array: F64 | None) -> F64 | None:
        return None if array is None else array[rows]

    return FlownPath(
        path.path,
        path.time_s[rows],
        path.clock,
        path.place[rows],
        part(path.attitude),
        part(path.position_sigma_m),
        part(path.attitude_sigma_rad),
    )
