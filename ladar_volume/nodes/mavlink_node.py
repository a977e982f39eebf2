"""mavlink_node: an autopilot's messages, live or from its log, as fixes, attitudes and odometry."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu, NavSatFix

from ladar_volume.io.mavlink.mavlink_links import Link, open_link
from ladar_volume.io.mavlink.mavlink_log import MavlinkLog, log_file
from ladar_volume.io.mavlink.mavlink_poses import InertialSample
from ladar_volume.io.mavlink.mavlink_records import Record
from ladar_volume.io.mavlink.mavlink_session import MavlinkSession
from ladar_volume.model.losses import Losses
from ladar_volume.model.records import F64, Fix, ImuSample, OdometrySample
from ladar_volume.nodes.base import StageNode
from ladar_volume.nodes.convert import header
from ladar_volume.nodes.qos import STREAM
from ladar_volume.nodes.running import spin

#: A log that is played as fast as possible waits while more than this is queued.
AHEAD = 1000
#: How long an autopilot may send no position until that is an error, s.
POSITIONS_S = 3.0


def fix_message(fix: Fix) -> NavSatFix:
    """A fix; without accuracies its covariance type is unknown."""
    message = NavSatFix(
        header=header(fix.t_ns, ""),
        latitude=fix.latitude_deg,
        longitude=fix.longitude_deg,
        altitude=fix.height_m,
    )
    message.status.status, message.status.service = fix.status, 1
    if fix.C_enu is not None:
        message.position_covariance = fix.C_enu.ravel()
        message.position_covariance_type = NavSatFix.COVARIANCE_TYPE_DIAGONAL_KNOWN
    return message


def _set_fields(target: Any, values: F64) -> None:
    target.x, target.y, target.z = values[:3].tolist()
    if len(values) == 4:
        target.w = float(values[3])


def imu_message(sample: ImuSample) -> Imu:
    """An attitude with its rates; what the autopilot does not say has −1 (absent) or zeros
    (unknown), as REP-145 has it.
    """
    message = Imu(header=header(sample.t_ns, ""))
    _set_fields(message.orientation, sample.q_map_body)
    if sample.C_axes is not None:
        message.orientation_covariance = sample.C_axes.ravel()
    if np.all(np.isfinite(sample.omega_body)):
        _set_fields(message.angular_velocity, sample.omega_body)
    else:
        message.angular_velocity_covariance[0] = -1.0
    message.linear_acceleration_covariance[0] = -1.0
    return message


def inertial_message(sample: InertialSample) -> Imu:
    """Raw rates and accelerations without an attitude."""
    message = Imu(header=header(sample.t_ns, ""))
    message.orientation_covariance[0] = -1.0
    _set_fields(message.angular_velocity, sample.omega_body)
    _set_fields(message.linear_acceleration, sample.acceleration_body)
    return message


def odometry_message(sample: OdometrySample) -> Odometry:
    """A pose; a covariance of zeros is unknown."""
    message = Odometry(header=header(sample.t_ns, ""))
    _set_fields(message.pose.pose.position, sample.p_map_body)
    _set_fields(message.pose.pose.orientation, sample.q_map_body)
    _set_fields(message.twist.twist.linear, sample.v_body)
    _set_fields(message.twist.twist.angular, sample.omega_body)
    if sample.C_pose is not None:
        message.pose.covariance = sample.C_pose.ravel()
    return message


class MavlinkNode(StageNode):
    """Wraps one MavlinkSession over a link, or plays a log."""

    sections = ("mavlink", "node")

    def __init__(self, **options: Any) -> None:
        super().__init__("mavlink_node", **options)

    def build(self) -> None:
        """Open the link or the log."""
        p = self.parameters.mavlink
        self._session = MavlinkSession(p)
        self._before = Losses()
        self._link: Link | None = None
        self._log: MavlinkLog | None = None
        self._playback = ""
        self._ended = threading.Event()
        self.sent: dict[str, int] = {"fix": 0, "imu": 0, "inertial": 0, "odometry": 0}
        self._out: dict[type, tuple[str, Any, Callable[[Any], Any]]] = {
            Fix: ("fix", self.create_publisher(NavSatFix, "gnss/fix", STREAM), fix_message),
            ImuSample: ("imu", self.create_publisher(Imu, "imu/data", STREAM), imu_message),
            InertialSample: (
                "inertial",
                self.create_publisher(Imu, "imu/data_raw", STREAM),
                inertial_message,
            ),
            OdometrySample: (
                "odometry",
                self.create_publisher(Odometry, "odometry", STREAM),
                odometry_message,
            ),
        }
        self._positions, self._positions_s = 0, time.monotonic()
        self._heard_s = time.monotonic()
        path = log_file(p.url)
        if path is None:
            self._link = open_link(p.url)
        else:
            self._log, self._playback = MavlinkLog(path, p), "waiting"
        self._reader = threading.Thread(
            target=self._listen if path is None else self._play, name="mavlink", daemon=True
        )
        self._reader.start()

    # the reading thread
    # -------------------------------------------------------------------------------------------
    def _listen(self) -> None:
        assert self._link is not None
        while not self._ended.is_set():
            data = self._link.read(0.05)
            if data and self._active:
                self.offer("bytes", (data, int(self.get_clock().now().nanoseconds)))

    def _play(self) -> None:
        assert self._log is not None
        rate, first, began = self.parameters.mavlink.playback_rate, None, 0.0
        while not self._active and not self._ended.is_set():
            time.sleep(0.02)
        self._playback = "playing"
        for record in self._log.records():
            if first is None:
                first, began = record.t_ns, time.monotonic()
            wait = (
                (record.t_ns - first) * 1e-9 / rate - (time.monotonic() - began)
                if rate > 0
                else 0.0
            )
            if self._ended.wait(max(wait, 0.0)):
                return
            while self.queue.qsize() > AHEAD and not self._ended.is_set():
                time.sleep(0.002)
            self.offer("record", record)
        self._playback = "done"

    # the worker
    # ----------------------------------------------------------------------------------------------
    def work(self, kind: str, item: Any) -> None:
        """Bytes to records to messages."""
        if kind == "reset":
            self._before.merge(self._session.losses())
            self._session = MavlinkSession(self.parameters.mavlink)
            if self._link is not None:
                self._link.forget()
        elif kind == "bytes":
            for record in self._session.feed(*item):
                self._publish(record)
        elif kind == "record":
            self._publish(item)

    def _publish(self, record: Record) -> None:
        if not self.context.ok():
            return  # interrupted: nobody can hear it any more
        name, publisher, convert = self._out[type(record)]
        publisher.publish(self._framed(convert(record)))
        self.sent[name] += 1

    def _framed(self, message: NavSatFix | Imu | Odometry) -> object:
        """The message in the frames that the parameters name."""
        node = self.parameters.node
        if isinstance(message, NavSatFix):
            message.header.frame_id = node.gnss_frame or "gnss"
        elif isinstance(message, Odometry):
            message.header.frame_id = node.odom_frame or node.map_frame
            message.child_frame_id = node.base_frame
        else:
            message.header.frame_id = node.imu_frame or node.base_frame
        return message

    def idle(self) -> None:
        """Say what is due on the link."""
        if self._link is not None and self._active:
            data = self._session.due(int(self.get_clock().now().nanoseconds))
            if data:
                self._link.write(data)

    def stop(self) -> None:
        """Stop reading, work off what came, close the link."""
        if hasattr(self, "_reader"):  # else it could not be configured
            self._ended.set()
            self._reader.join(timeout=2.0)
        super().stop()
        link: Link | None = getattr(self, "_link", None)
        if link is not None:
            link.close()

    def all_losses(self) -> Losses:
        """What link, stream, decoder and log refused or missed."""
        total = Losses(self.losses.as_dict())
        parts = [self._before, self._session.losses()]
        if self._link is not None:
            parts.append(self._link.losses)
        if self._log is not None:
            parts.append(self._log.losses())
        for part in parts:
            total.merge(part)
        return total

    def errors(self) -> list[str]:
        """A link that is not there, nobody on it, or an autopilot that gives no position."""
        if self._link is not None and not self._link.is_open:
            return [
                f"{self.parameters.mavlink.url} cannot be opened: another program holds it, or it "
                "is not there; it is tried again every second"
            ]
        now, positions = time.monotonic(), self.sent["fix"] + self.sent["odometry"]
        if self._link is None or not self._session.alive or positions != self._positions:
            self._positions, self._positions_s = positions, now
        if self._link is None or self._session.alive or not self._active:
            self._heard_s = now
        if now - self._heard_s >= POSITIONS_S:
            return [self._nobody(now - self._heard_s)]
        missing = now - self._positions_s
        if missing < POSITIONS_S:
            return []
        found = self._session.status()
        return [
            f"no position of the autopilot for {missing:.0f} s: its fix is {found['fix_type']} "
            f"with {found['satellites']} satellites"
        ]

    def _nobody(self, seconds: float) -> str:
        """Nobody has sent a heartbeat for so long, in words."""
        came = self.received_counts().get("bytes", 0)
        why = "what comes holds none: baud rate, mavlink.system, component or signing key"
        why = why if came else "nothing comes: port, cable, and where the autopilot sends to"
        return f"no heartbeat on {self.parameters.mavlink.url} for {seconds:.0f} s, {why}"

    def status(self) -> dict[str, Any]:
        """The link and what was made of it."""
        source = self._session if self._log is None else self._log
        playback = {"playback": self._playback} if self._playback else {}
        return {
            "url": self.parameters.mavlink.url,
            **playback,
            **source.status(),
            **{f"sent_{k}": n for k, n in self.sent.items()},
        }


def main(argv: Sequence[str] | None = None) -> int:
    """Run the node alone."""
    return spin(MavlinkNode, argv)
