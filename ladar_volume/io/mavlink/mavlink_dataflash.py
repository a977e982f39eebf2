"""ArduPilot's DataFlash log (.bin) → the records of :mod:`ladar_volume.io.mavlink.mavlink_records`,
in UTC.

A fix carries its epoch (GPS week and milliseconds), which is its stamp. Everything else has the
autopilot's microseconds since boot; the GPS messages, written some time after their epoch, relate
the two: the line below all of them is the clock difference plus the receiver's shortest delay,
``gnss_delay_s``.
"""

from __future__ import annotations

import contextlib
import math
import mmap
import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.DFReader import FORMAT_TO_STRUCT, DFFormat, DFMessage, null_term

from ladar_volume.io.mavlink.mavlink_clock import BIN_NS, ClockLine, S, lower_line
from ladar_volume.io.mavlink.mavlink_frames import (
    enu_flu_from_ned_frd,
    flu_from_frd,
    quaternion_from_euler,
)
from ladar_volume.io.mavlink.mavlink_heights import Heights
from ladar_volume.io.mavlink.mavlink_poses import InertialSample, accuracy_covariance
from ladar_volume.io.mavlink.mavlink_records import STATUS, Record, time_in_range
from ladar_volume.model.errors import AttitudeError, BagError, FixError, InputError
from ladar_volume.model.losses import Losses
from ladar_volume.model.mavlink_parameters import MavlinkParameters
from ladar_volume.model.records import F64, Fix, ImuSample

#: GPS epoch 1980-01-06 in UTC seconds, and from which GPS second on GPS time is so many seconds
#: ahead of UTC (IERS Bulletin C).
GPS_EPOCH_S = 315_964_800
LEAPS = ((1_167_264_017, 18), (1_119_744_016, 17), (1_025_136_015, 16), (0, 15))
WANTED = frozenset({"GPS", "GPS2", "GPA", "GPA2", "POS", "ATT", "IMU"})
#: Every message begins with these; the one that defines the others has a number and a layout of its
#: own.
HEAD, FORMAT_NUMBER, FORMAT_LENGTH = b"\xa3\x95", 0x80, 89
_FORMAT = struct.Struct("<BB4s16s64s")


def log_messages(data: bytes | mmap.mmap, losses: Losses) -> Iterator[DFMessage]:
    """The wanted messages of a log; pymavlink knows the formats, the walk is this package's own
    because pymavlink's never ends on a format of no length. Bytes that belong to no known message
    are counted as noise.
    """
    formats: dict[int, tuple[DFFormat, struct.Struct]] = {}
    position, size = 0, len(data)
    while position + 3 <= size:
        number = data[position + 2]
        known = number == FORMAT_NUMBER or number in formats
        length = (
            FORMAT_LENGTH if number == FORMAT_NUMBER else formats[number][0].len if known else 0
        )
        if not known or data[position : position + 2] != HEAD or position + length > size:
            losses.add("mavlink_noise_byte")
            position += 1
            continue
        body = data[position + 3 : position + length]
        if number == FORMAT_NUMBER:
            _add_format(formats, body, losses)
        elif formats[number][0].name in WANTED:
            form, layout = formats[number]
            yield DFMessage(form, list(layout.unpack(body)), True, None)
        position += length


def _add_format(
    formats: dict[int, tuple[DFFormat, struct.Struct]], body: bytes, losses: Losses
) -> None:
    number, length, name, layout, columns = _FORMAT.unpack(body)
    letters = null_term(layout)
    if any(c not in FORMAT_TO_STRUCT for c in letters):
        losses.add("mavlink_log_format")
        return
    form = DFFormat(number, null_term(name), length, letters, null_term(columns))
    fields = struct.Struct(form.msg_struct)
    if fields.size + 3 != length or len(letters) != len(form.columns):
        losses.add("mavlink_log_format")
        return
    formats[number] = (form, fields)


class DataFlashLog:
    """A log, opened and related to UTC on construction. Raises BagError: bag_missing, bag_clock (no
    GPS time in it).
    """

    def __init__(self, path: Path, parameters: MavlinkParameters) -> None:
        self.heights = Heights(parameters)
        self.path, self.parameters = path, parameters
        self.losses = Losses()
        self.counts: dict[str, int] = {}
        second = parameters.position == "GPS2_RAW"
        self._instance = int(second)
        self._gps, self._gpa = (
            ("GPS2", "GPA2") if second else ("GPS", "GPA")
        )  # names before instances came
        self._accuracy: dict[int, Any] = {}
        points: dict[int, tuple[int, float]] = {}
        base, delay = None, round(parameters.gnss_delay_s * 1e9)
        for m in self._messages():
            if not self._is_position(m, self._gps, "GPS"):
                continue
            epoch = None
            with contextlib.suppress(AttributeError, TypeError, ValueError):
                epoch, boot = _epoch_ns(m), _time_us(m) * 1000 - delay
            if epoch is None:
                continue
            base = boot - epoch if base is None else base
            late = float(boot - epoch - base)
            if epoch // BIN_NS not in points or late < points[epoch // BIN_NS][1]:
                points[epoch // BIN_NS] = (epoch, late)
        if base is None:
            raise BagError(f"{path}: no GPS time in the log", reason="bag_clock", value=str(path))
        self.losses = Losses()  # what is noise is counted by the pass that gives the records
        line = lower_line(sorted(points.values()))
        self.line = ClockLine(line.at_ns, line.rest_ns, line.drift, line.sigma_ns, base)

    def _messages(self) -> Iterator[Any]:
        try:
            with self.path.open("rb") as stream:
                if os.fstat(stream.fileno()).st_size == 0:
                    return
                with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
                    yield from log_messages(data, self.losses)
        except OSError as error:
            raise BagError(
                f"{self.path}: {error}", reason="bag_missing", value=str(self.path)
            ) from error

    def _is_position(self, m: Any, old_name: str, name: str) -> bool:
        kind = m.get_type()
        instance = getattr(m, "I", None)
        return (
            bool(kind == name and instance == self._instance)
            if instance is not None
            else bool(kind == old_name)
        )

    def utc_ns(self, time_us: int) -> int:
        """UTC of a time since boot."""
        boot = time_us * 1000
        guess = boot - self.line.base_ns
        return boot - self.line.offset(guess)

    def records(self) -> Iterator[Record]:
        """All of the log, in its order."""
        # a fix's accuracy is logged behind it: positions wait for the message that follows
        waiting: Any = None
        for m in self._messages():
            kind = m.get_type()
            self.counts[kind] = self.counts.get(kind, 0) + 1
            if self._is_position(m, self._gpa, "GPA"):
                yield from self._safely(waiting, m)
                waiting = None
            elif self._is_position(m, self._gps, "GPS"):
                yield from self._safely(waiting, None)
                waiting = m
            elif kind in ("ATT", "IMU", "POS"):
                yield from self._safely(m, None)
        yield from self._safely(waiting, None)

    def _safely(self, m: Any, accuracy: Any) -> Iterator[Record]:
        if m is None:
            return
        try:
            record = self._record(m, accuracy)
        except InputError as error:
            self.losses.add(error.reason)
        except (AttributeError, TypeError, ValueError, OverflowError):
            self.losses.add("mavlink_log_message")
        else:
            if record is not None:
                yield record

    def _record(self, m: Any, accuracy: Any) -> Record | None:
        kind, fused = m.get_type(), self.parameters.position == "GLOBAL_POSITION_INT"
        if kind == "ATT":
            return self._attitude(m)
        if kind == "IMU":
            return self._inertial(m) if getattr(m, "I", 0) == 0 else None
        if kind == "POS":
            return (
                self._fix(time_in_range(self.utc_ns(_time_us(m)), "fix"), m, None, 0)
                if fused
                else None
            )
        if int(m.Status) not in STATUS:
            raise FixError("receiver has no fix", reason="fix_no_fix", value=m.Status)
        epoch = _epoch_ns(m)
        if epoch is None:
            raise FixError("fix without time", reason="fix_no_time")
        current = accuracy is not None and _time_us(accuracy) == _time_us(m)
        if current and getattr(accuracy, "Und", None):
            self.heights.receiver_says(-float(accuracy.Und))
        if fused:
            return None
        C = None
        if current:
            radial = self.parameters.horizontal_accuracy == "radial"
            C = accuracy_covariance(
                round(float(accuracy.HAcc) * 1e3), round(float(accuracy.VAcc) * 1e3), radial
            )
        return self._fix(time_in_range(epoch, "fix"), m, C, STATUS[int(m.Status)])

    def _fix(self, t_ns: int, m: Any, C: F64 | None, status: int) -> Fix:
        latitude, longitude, msl = float(m.Lat), float(m.Lng), float(m.Alt)
        if not all(math.isfinite(v) for v in (latitude, longitude, msl)):
            raise FixError("fix is not finite", reason="fix_nan")
        if abs(latitude) > 90 or abs(longitude) > 180 or (latitude == 0 and longitude == 0):
            raise FixError(
                "latitude or longitude out of range",
                reason="fix_range",
                value=(latitude, longitude),
            )
        height = self.heights.height(msl, (latitude, longitude))
        return Fix(t_ns, latitude, longitude, height, C, status)

    def _attitude(self, m: Any) -> ImuSample:
        angles = [math.radians(float(a)) for a in (m.Roll, m.Pitch, m.Yaw)]
        if not all(math.isfinite(a) for a in angles):
            raise AttitudeError("attitude is not finite", reason="imu_nan")
        p = self.parameters
        known = p.roll_pitch_sigma_rad > 0 and p.heading_sigma_rad > 0
        C = (
            np.diag([p.roll_pitch_sigma_rad**2, p.roll_pitch_sigma_rad**2, p.heading_sigma_rad**2])
            if known
            else None
        )
        q = enu_flu_from_ned_frd(quaternion_from_euler(*angles))
        return ImuSample(time_in_range(self.utc_ns(_time_us(m)), "imu"), q, np.full(3, np.nan), C)

    def _inertial(self, m: Any) -> InertialSample:
        omega, force = (
            np.array([m.GyrX, m.GyrY, m.GyrZ], float),
            np.array([m.AccX, m.AccY, m.AccZ], float),
        )
        if not np.all(np.isfinite(np.concatenate([omega, force]))):
            raise InputError("inertial data is not finite", reason="inertial_nan")
        return InertialSample(
            time_in_range(self.utc_ns(_time_us(m)), "inertial"),
            flu_from_frd(omega),
            flu_from_frd(force),
        )


def _time_us(m: Any) -> int:
    """Time since boot. Logs before 2015 have milliseconds; their GPS has those of the week there,
    and the time since boot as T.
    """
    known = getattr(m, "TimeUS", None)
    if known is not None:
        return int(known)
    return 1000 * int(m.T if m.get_type() in ("GPS", "GPS2") else m.TimeMS)


def _epoch_ns(m: Any) -> int | None:
    """UTC of a GPS message's epoch; None before the receiver knows the week."""
    week, ms = getattr(m, "GWk", None), getattr(m, "GMS", None)
    if week is None:
        week, ms = getattr(m, "Week", 0), getattr(m, "TimeMS", 0)
    if not isinstance(week, int) or not isinstance(ms, int) or week <= 0:
        return None
    second = week * 604_800 + ms // 1000
    leap = next(seconds for begin, seconds in LEAPS if second >= begin)
    return (GPS_EPOCH_S - leap + week * 604_800) * S + ms * 1_000_000
