"""MAVLink messages → records, in the conventions of this package: east-north-up, forward-left-up,
ellipsoidal heights, one clock.

What cannot be used is refused with a reason and counted; an unknown covariance stays unknown.
Message definitions: mavlink.io, common.xml. Where ArduPilot's habits matter (units of RAW_IMU,
repeated fixes), the heartbeat tells that it is one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import all as dialect

from ladar_volume.georeference.sample_admission import unit_quaternion
from ladar_volume.io.mavlink.mavlink_clock import ClockInUse, ClockOffset, S
from ladar_volume.io.mavlink.mavlink_frames import (
    enu_flu_from_ned_frd,
    flu_from_frd,
    quaternion_from_euler,
)
from ladar_volume.io.mavlink.mavlink_heights import Heights
from ladar_volume.io.mavlink.mavlink_poses import (
    UNKNOWN_U32,
    InertialSample,
    accuracy_covariance,
    inertial_sample,
    odometry_sample,
)
from ladar_volume.model.errors import (
    AttitudeError,
    FixError,
    InputError,
    TimeOrderError,
)
from ladar_volume.model.losses import Losses
from ladar_volume.model.mavlink_parameters import MavlinkParameters
from ladar_volume.model.records import F64, Fix, ImuSample, OdometrySample

#: Fix type → NavSatStatus: 3D; DGPS and PPP as augmented by satellites; RTK float, RTK fixed and a
#: static base as ground-based.
STATUS = {3: 0, 4: 1, 5: 2, 6: 2, 7: 2, 8: 1}
FIX_NAMES = ("no receiver", "no fix", "2D", "3D", "DGPS", "RTK float", "RTK fixed", "static", "PPP")
#: A time in microseconds beyond this is UTC, below it is since boot (the message definitions' own
#: rule).
UTC_US = 10**15
#: What a ROS stamp can hold.
LAST_NS = 2**31 * S
#: Boot time that runs back by more than this, and stays there for a second, is a restart; else it
#: is late packets.
RESTART_MS = 1000
#: No message is so far ahead of the newest boot time.
AHEAD_MS = 60_000
#: How long a value of another message stays current.
CURRENT_NS = 2 * S
GRAVITY = 9.80665
#: Readings of the autopilot's clock are whole milliseconds.
TICK_NS = 1e6 / math.sqrt(12.0)


Record = Fix | ImuSample | OdometrySample | InertialSample


class MavlinkDecoder:
    """Takes the vehicle's messages with their time of receipt and gives records. ``losses`` has a
    reason for every refusal.
    """

    def __init__(self, parameters: MavlinkParameters) -> None:
        self.parameters = p = parameters
        self.losses = Losses()
        self.system = p.system
        self.ardupilot = False
        self.restarts = 0
        self.repeated = 0
        self.fix_type = 0
        self.satellites = 0
        self.counts: dict[str, int] = {}
        floor = math.hypot(p.link_delay_sigma_s * 1e9, TICK_NS)
        self.arrivals = ClockOffset(p.clock_window_s, p.clock_settle_s, False, floor)
        self.round_trips = ClockOffset(p.clock_window_s, p.clock_settle_s, True, TICK_NS)
        self.utc = ClockOffset(p.clock_window_s, p.clock_settle_s, True, TICK_NS)
        self._in_use = ClockInUse()
        self._boot_ms: int | None = None
        self._behind_since: int | None = None
        self._newest_us: dict[str, int] = {}
        self.heights = Heights(p)
        self._heading: tuple[int, float] | None = None
        self._quaternion_ms: int | None = None
        self._last_fix_us = -1
        self._reset_counter: int | None = None
        self._handlers: dict[str, Callable[[Any], Record | None]] = {
            "HEARTBEAT": self._heartbeat,
            "SYSTEM_TIME": self._system_time,
            "GPS_RAW_INT": self._gps,
            "GPS2_RAW": self._gps,
            "GLOBAL_POSITION_INT": self._global_position,
            "ATTITUDE": self._attitude,
            "ATTITUDE_QUATERNION": self._attitude_quaternion,
            "ODOMETRY": self._odometry,
            "HIGHRES_IMU": self._highres_imu,
            "RAW_IMU": self._raw_imu,
        }

    def accepts(self, system: int, component: int) -> bool:
        """Whether a sender is the vehicle's autopilot."""
        return (self.system == 0 or system == self.system) and self.parameters.component in (
            0,
            component,
        )

    def take(self, message: Any, received_ns: int) -> Record | None:
        """One message; a record where it gives one. Never raises for its content."""
        system, component = message.get_srcSystem(), message.get_srcComponent()
        if not self.accepts(system, component):
            self.losses.add("mavlink_other_sender")
            return None
        kind = message.get_type()
        if (
            self.system == 0
            and kind == "HEARTBEAT"
            and message.autopilot != dialect.MAV_AUTOPILOT_INVALID
        ):
            self.system = system
        handler = self._handlers.get(kind)
        if handler is None:
            return None
        self.counts[kind] = self.counts.get(kind, 0) + 1
        try:
            boot_ms = getattr(message, "time_boot_ms", None)
            if boot_ms is not None:
                self._boot(boot_ms, received_ns)
            elif 0 < getattr(message, "time_usec", 0) < UTC_US:
                self._since_boot(kind, message.time_usec, received_ns)
            return handler(message)
        except InputError as error:
            self.losses.add(error.reason)
        return None

    # clocks
    # ----------------------------------------------------------------------------------------------
    def _boot(self, boot_ms: int, received_ns: int) -> None:
        if self._boot_ms is not None and boot_ms < self._boot_ms - RESTART_MS:
            self._behind(boot_ms, received_ns)
        self._behind_since = None
        self._boot_ms = max(boot_ms, self._boot_ms or 0)
        self.arrivals.add(
            boot_ms * 1_000_000, received_ns - round(self.parameters.link_delay_s * 1e9)
        )

    def _since_boot(self, kind: str, time_us: int, received_ns: int) -> None:
        """A message with microseconds since boot. A receiver's may repeat an old fix: each kind is
        compared with its own last one. A time far ahead of the boot time is damage, no standard.
        """
        newest = self._newest_us.get(kind, 0)
        if time_us < newest - 1000 * RESTART_MS:
            self._behind(time_us // 1000, received_ns)
            self._behind_since, newest = None, 0
        if time_us // 1000 <= (self._boot_ms or 0) + AHEAD_MS or self._boot_ms is None:
            self._newest_us[kind] = max(time_us, newest)

    def _behind(self, boot_ms: int, received_ns: int) -> None:
        """A time since boot that ran back. Raises TimeOrderError (mavlink_message_late) until that
        has lasted for a second; then it is a restart.
        """
        if self._behind_since is None:
            self._behind_since = received_ns
        if 0 <= received_ns - self._behind_since < S:
            raise TimeOrderError(
                "far behind its predecessor", reason="mavlink_message_late", value=boot_ms
            )
        self._on_restart()

    def _on_restart(self) -> None:
        self.restarts += 1
        for clock in (self.arrivals, self.round_trips, self.utc):
            clock.reset()
        self._in_use = ClockInUse()
        self._boot_ms, self._last_fix_us, self._quaternion_ms, self._heading = None, -1, None, None
        self._newest_us = {}

    def round_trip(self, sent_ns: int, autopilot_ns: int, received_ns: int) -> None:
        """An answered TIMESYNC."""
        self.round_trips.add(
            autopilot_ns, (sent_ns + received_ns) // 2, 0.5 * (received_ns - sent_ns)
        )

    @property
    def clock(self) -> ClockOffset:
        """The comparison that is used for stamps."""
        if self.parameters.clock == "utc":
            return self.utc
        return self.round_trips if self.round_trips.ready else self.arrivals

    def _stamp(self, boot_ns: int, unit: str) -> int:
        clock = self.clock
        if clock.line is None or not clock.ready:
            raise TimeOrderError(
                "the clocks have not been compared for long enough",
                reason=f"{unit}_clock_unsettled",
            )
        return time_in_range(self._in_use.local(boot_ns, clock.line), unit)

    def _stamp_us(self, time_us: int, unit: str) -> int:
        """A stamp of a field that holds time since boot or UTC, whichever its size says."""
        if time_us <= 0:
            raise TimeOrderError("message without time", reason=f"{unit}_no_time")
        if time_us < UTC_US:
            return self._stamp(time_us * 1000, unit)
        if self.parameters.clock == "utc":
            return time_in_range(time_us * 1000, unit)
        line = self.utc.line
        if line is None:
            raise TimeOrderError(
                "time in UTC, and no SYSTEM_TIME to relate it", reason=f"{unit}_clock_unsettled"
            )
        return self._stamp(
            time_us * 1000
            - line.offset(self._boot_ms * 1_000_000 if self._boot_ms else line.at_ns),
            unit,
        )

    def _heartbeat(self, m: Any) -> None:
        if m.autopilot == dialect.MAV_AUTOPILOT_INVALID:
            return  # a camera's or a computer's, where any component is listened to
        self.ardupilot = m.autopilot == dialect.MAV_AUTOPILOT_ARDUPILOTMEGA

    def _system_time(self, m: Any) -> None:
        if m.time_unix_usec >= UTC_US:  # before the first fix it counts from somewhere else
            self.utc.add(m.time_boot_ms * 1_000_000, m.time_unix_usec * 1000)

    # positions
    # ----------------------------------------------------------------------------------------------
    def _gps(self, m: Any) -> Fix | None:
        if m.alt_ellipsoid:
            self.heights.receiver_says((m.alt_ellipsoid - m.alt) * 1e-3)
        if m.get_type() != self.parameters.position:
            return None
        self.fix_type, self.satellites = m.fix_type, m.satellites_visible
        if m.fix_type not in STATUS:
            raise FixError("receiver has no fix", reason="fix_no_fix", value=m.fix_type)
        if m.time_usec == self._last_fix_us:  # sent again at the stream's rate
            self.repeated += 1
            return None
        self._last_fix_us = m.time_usec
        delay = round(self.parameters.gnss_delay_s * 1e9)
        t_ns = self._stamp_us(m.time_usec, "fix") - delay
        if 0 < m.yaw <= 36000 and 0 < m.hdg_acc < UNKNOWN_U32:
            self._heading = (t_ns, math.radians(m.hdg_acc * 1e-5))
        C = accuracy_covariance(m.h_acc, m.v_acc, self.parameters.horizontal_accuracy == "radial")
        return self._fix(t_ns, m, C, STATUS[m.fix_type])

    def _global_position(self, m: Any) -> Fix | None:
        if m.get_type() != self.parameters.position:
            return None
        t_ns = self._stamp(m.time_boot_ms * 1_000_000, "fix")
        return self._fix(t_ns, m, None, 0)

    def _fix(self, t_ns: int, m: Any, C: F64 | None, status: int) -> Fix:
        if abs(m.lat) > 900_000_000 or abs(m.lon) > 1_800_000_000 or (m.lat == 0 and m.lon == 0):
            raise FixError(
                "latitude or longitude out of range", reason="fix_range", value=(m.lat, m.lon)
            )
        place = (m.lat * 1e-7, m.lon * 1e-7)
        return Fix(t_ns, *place, self.heights.height(m.alt * 1e-3, place), C, status)

    # attitudes
    # ----------------------------------------------------------------------------------------------
    def _attitude(self, m: Any) -> ImuSample | None:
        chosen = self.parameters.attitude
        recent = (
            self._quaternion_ms is not None
            and m.time_boot_ms - self._quaternion_ms < CURRENT_NS // 1_000_000
        )
        if chosen == "ATTITUDE_QUATERNION" or (chosen == "auto" and recent):
            return None
        angles = (m.roll, m.pitch, m.yaw)
        if not all(math.isfinite(a) for a in angles):
            raise AttitudeError(f"attitude is not finite: {angles}", reason="imu_nan", value=angles)
        return self._imu(m, quaternion_from_euler(*angles))

    def _attitude_quaternion(self, m: Any) -> ImuSample | None:
        if self.parameters.attitude == "ATTITUDE":
            return None
        sample = self._imu(m, unit_quaternion((m.q2, m.q3, m.q4, m.q1), "imu"))
        self._quaternion_ms = m.time_boot_ms
        return sample

    def _imu(self, m: Any, q_ned_frd: F64) -> ImuSample:
        t_ns = self._stamp(m.time_boot_ms * 1_000_000, "imu")
        rates = np.array([m.rollspeed, m.pitchspeed, m.yawspeed], dtype=np.float64)
        omega = flu_from_frd(rates) if np.all(np.isfinite(rates)) else np.full(3, np.nan)
        return ImuSample(
            t_ns, enu_flu_from_ned_frd(q_ned_frd), omega, self._attitude_covariance(t_ns)
        )

    def _attitude_covariance(self, t_ns: int) -> F64 | None:
        """About east, north, up; None unless roll, pitch and heading are all known."""
        p = self.parameters
        current = self._heading is not None and abs(t_ns - self._heading[0]) < CURRENT_NS
        heading = self._heading[1] if current and self._heading is not None else p.heading_sigma_rad
        if p.roll_pitch_sigma_rad <= 0 or heading <= 0:
            return None
        return np.diag([p.roll_pitch_sigma_rad**2, p.roll_pitch_sigma_rad**2, heading**2])

    def _odometry(self, m: Any) -> OdometrySample:
        north = m.frame_id == dialect.MAV_FRAME_LOCAL_NED
        if (
            not (north or m.frame_id == dialect.MAV_FRAME_LOCAL_FRD)
            or m.child_frame_id != dialect.MAV_FRAME_BODY_FRD
        ):
            raise AttitudeError(
                "frames other than local NED or FRD and body FRD",
                reason="odometry_frame",
                value=m.frame_id,
            )
        if m.quality < 0:
            raise AttitudeError(
                "the autopilot calls its odometry failed", reason="odometry_failed", value=m.quality
            )
        if self._reset_counter not in (None, m.reset_counter):
            self.losses.add("odometry_estimator_reset")
        self._reset_counter = m.reset_counter
        t_ns = self._stamp_us(m.time_usec, "odometry")
        return odometry_sample(t_ns, m, north)

    # raw inertial data
    # --------------------------------------------------------------------------------------------
    def _highres_imu(self, m: Any) -> InertialSample:
        if m.fields_updated & 0x3F != 0x3F:
            raise InputError(
                "rates or accelerations were not updated",
                reason="inertial_incomplete",
                value=m.fields_updated,
            )
        return self._inertial(m, 1.0, 1.0)

    def _raw_imu(self, m: Any) -> InertialSample:
        if (
            not self.ardupilot
        ):  # the message has no unit; ArduPilot sends thousandths of g and of rad/s
            raise InputError("RAW_IMU of unknown scale", reason="inertial_unscaled")
        return self._inertial(m, 1e-3, 1e-3 * GRAVITY)

    def _inertial(self, m: Any, rate_unit: float, force_unit: float) -> InertialSample:
        return inertial_sample(self._stamp_us(m.time_usec, "inertial"), m, rate_unit, force_unit)


def time_in_range(t_ns: int, unit: str) -> int:
    """``t_ns`` where a ROS stamp can hold it; else raises TimeOrderError
    (``<unit>_time_range``).
    """
    if not 0 <= t_ns < LAST_NS:
        raise TimeOrderError(
            f"time {t_ns} ns is out of range", reason=f"{unit}_time_range", value=t_ns
        )
    return t_ns
