"""What the sensors' messages say of their own set-up: frames, rings, stamps, axes. Each
contradiction is one sentence with both values.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Protocol

import numpy as np

from ladar_volume.io.drivers.point_layouts import RING_FIELDS
from ladar_volume.io.frames.static_frames import Quaternion, Vector
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, Returns
from ladar_volume.nodes.watch.clock_words import APART_S, known_step

#: Accelerations (m/s²) that are mostly gravity; over how many attitudes the direction is a mean;
#: how far it may be from up, deg.
GRAVITY, ATTITUDES, FEWEST, UP_DEG = (8.0, 11.6), 200, 20, 30.0
#: Accelerations that are of gravity in g, m/s² taken for it.
IN_G = (0.8, 1.2)
#: Share of the returns beyond the configured rings above which the configuration is wrong: below it
#: single returns are damaged.
WRONG_SHARE = 0.01
#: Frames in which no scanner measures: a cloud there was transformed before.
FIXED_FRAMES = frozenset({"map", "odom", "world", "earth", "utm"})
#: Frames of the body: a cloud there needs no mounting.
BODY_FRAMES = frozenset({"base_link", "base_footprint"})


class Stamp(Protocol):
    """builtin_interfaces/Time."""

    sec: int
    nanosec: int


class Header(Protocol):
    """std_msgs/Header."""

    stamp: Stamp
    frame_id: str


class StampedMessage(Protocol):
    """A message with a header."""

    header: Header


class Inertial(StampedMessage, Protocol):
    """sensor_msgs/Imu."""

    orientation: Quaternion
    linear_acceleration: Vector
    linear_acceleration_covariance: F64


class SensorChecks:
    """Fed with every message of georeference_node's inputs, in its worker."""

    def __init__(self, parameters: Parameters) -> None:
        p = parameters.node
        self._wanted = {"cloud": p.lidar_frame, "imu": p.imu_frame, "fix": p.gnss_frame}
        c = parameters.calibration
        angles = (c.boresight_roll_rad, c.boresight_pitch_rad, c.boresight_yaw_rad)
        self._mounted = any(angles) or any(c.lever_laser_m)
        self._beams = parameters.georeference.beams
        self._frames: dict[str, str] = {}
        self._changes: dict[str, str] = {}
        self._stamps: dict[str, float] = {}
        self._highest_ring = -1
        self._without_ring = 0
        self._returns = self._beyond = 0
        self._up: deque[tuple[float, float, float]] = deque(maxlen=ATTITUDES)
        #: Sizes of the newest accelerations, in the unit of the driver.
        self._sizes: deque[float] = deque(maxlen=ATTITUDES)
        #: Why packets are refused as those of another scanner than configured; empty where not.
        self.other_scanner = ""

    def message(self, kind: str, message: StampedMessage) -> None:
        """One message as it came."""
        stamp, frame = message.header.stamp, message.header.frame_id
        self._stamps[kind] = stamp.sec + 1e-9 * stamp.nanosec
        before = self._frames.get(kind)
        if before is not None and before != frame:
            self._changes[kind] = before
        self._frames[kind] = frame

    def imu(self, message: Inertial) -> None:
        """An attitude with its acceleration: at rest the latter points up in the map."""
        a, q = message.linear_acceleration, message.orientation
        size = math.sqrt(a.x * a.x + a.y * a.y + a.z * a.z)
        if message.linear_acceleration_covariance[0] == -1.0:
            return
        self._sizes.append(size)
        if GRAVITY[0] < size < GRAVITY[1]:
            self._up.append(_rotate(q, a))

    def returns(self, returns: Returns, fields: set[str]) -> None:
        """The returns (n,) of a cloud, and the names of its fields."""
        self._without_ring += fields.isdisjoint(RING_FIELDS)
        if len(returns):
            self._highest_ring = max(self._highest_ring, int(returns.ring.max()))
            self._returns += len(returns)
            self._beyond += int(np.count_nonzero(returns.ring >= self._beams))

    def lines(self) -> dict[str, str | int]:
        """For the diagnostics: frames as they come, the highest ring."""
        found: dict[str, str | int] = {f"frame_{k}": f for k, f in self._frames.items()}
        return found | ({"highest_ring": self._highest_ring} if self._highest_ring >= 0 else {})

    def warnings(self) -> list[str]:
        """What may be right and is worth a look."""
        out = []
        if self._without_ring and self._beams > 1:
            out.append(
                f"{self._without_ring} clouds had no field ring: all returns count as beam 0 of "
                f"{self._beams}, so errors of single beams are not apart; update the driver"
            )
        for kind, before in self._changes.items():
            out.append(f"the frame of {kind} changed from '{before}' to '{self._frames[kind]}'")
        if not self._frames.get("cloud", "frame").strip("/ "):
            out.append(
                "the cloud comes without a frame (frame_id is empty): that it is the scanner's own "
                "cannot be told; name it in the driver"
            )
        return out + self._unit()

    def errors(self) -> list[str]:
        """What contradicts the configuration or another sensor; of rings, since the last call."""
        other = [self.other_scanner] if self.other_scanner else []
        rings, frames = self._wrong_rings(), self._wrong_frames()
        return [*other, *rings, *frames, *self._wrong_stamps(), *self._axes()]

    def _wrong_rings(self) -> list[str]:
        share = self._beyond / max(self._returns, 1)
        self._returns = self._beyond = 0
        if share <= WRONG_SHARE:
            return []
        return [
            f"rings up to {self._highest_ring} come and georeference.beams is {self._beams}: "
            f"{100.0 * share:.0f} % of the returns are lost, set it to the scanner's"
        ]

    def _wrong_frames(self) -> list[str]:
        out = []
        for kind, wanted in self._wanted.items():
            frame = self._frames.get(kind)
            if frame is None:
                continue
            last = frame.strip("/").rpartition("/")[2]  # of several vehicles each has its own
            if wanted and frame != wanted:
                out.append(f"{kind} comes in frame '{frame}', configured is '{wanted}'")
            elif not wanted and kind == "cloud" and last in FIXED_FRAMES:
                out.append(
                    f"the cloud comes in frame '{frame}', where no scanner measures: take the "
                    "driver's own topic, or name the frame in node.lidar_frame"
                )
            elif not wanted and kind == "cloud" and last in BODY_FRAMES and self._mounted:
                out.append(
                    f"the cloud comes in frame '{frame}', and calibration has a mounting between "
                    "body and laser, which would count twice: take the driver's own topic, or name "
                    "the frame in node.lidar_frame"
                )
        return out

    def _wrong_stamps(self) -> list[str]:
        out = [
            f"the stamps of {kind} are 0: its driver has no time"
            for kind, stamp in self._stamps.items()
            if stamp == 0.0
        ]
        if not out and len(self._stamps) > 1:
            first, last = min(self._stamps, key=self._at), max(self._stamps, key=self._at)
            apart = self._at(last) - self._at(first)
            if apart > APART_S:
                out.append(
                    f"the stamps of {first} are {apart:.0f} s before those of {last}"
                    f"{known_step(apart)}: one of the two has another clock or none; set it (PTP, "
                    "NTP, PPS)"
                )
        return out

    def _at(self, kind: str) -> float:
        return self._stamps[kind]

    def _unit(self) -> list[str]:
        if len(self._sizes) < FEWEST:
            return []
        size = float(np.median(self._sizes))
        if not IN_G[0] < size < IN_G[1]:
            return []
        return [
            f"the accelerations are {size:.2f} in the median: the IMU's driver gives g in place of "
            "m/s² (REP-103), and its axes cannot be checked"
        ]

    def _axes(self) -> list[str]:
        if len(self._up) < FEWEST:
            return []
        mean = np.mean(np.array(self._up), axis=0)
        tilt = math.degrees(math.acos(np.clip(mean[2] / np.linalg.norm(mean), -1.0, 1.0)))
        if tilt <= UP_DEG:
            return []
        return [
            f"by the attitude the acceleration at rest points {tilt:.0f} deg away from up: axes of "
            "the IMU are swapped (NED or FRD in place of ENU and FLU, REP-103 and REP-145)"
        ]


def _rotate(q: Quaternion, a: Vector) -> tuple[float, float, float]:
    """a by the quaternion q, in plain numbers: of every attitude, hundreds a second."""
    tx, ty, tz = (
        2.0 * (q.y * a.z - q.z * a.y),
        2.0 * (q.z * a.x - q.x * a.z),
        2.0 * (q.x * a.y - q.y * a.x),
    )
    return (
        a.x + q.w * tx + q.y * tz - q.z * ty,
        a.y + q.w * ty + q.z * tx - q.x * tz,
        a.z + q.w * tz + q.x * ty - q.y * tx,
    )
