"""Records ↔ ROS messages. Large arrays go in as one block of bytes, never element by element."""

from __future__ import annotations

import array
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry
from sensor_msgs.msg import NavSatFix, PointCloud2, PointField
from std_msgs.msg import Header

from ladar_volume.io.cloud_messages import stamp_ns
from ladar_volume.io.message_tables import Columns
from ladar_volume.io.tables import NUMBERS, encode
from ladar_volume.math.se3 import matrix_from_quaternion
from ladar_volume.model.records import Datum, PlatformStates


def time_message(t_ns: int) -> Time:
    """An int64 nanosecond time."""
    return Time(sec=t_ns // 1_000_000_000, nanosec=t_ns % 1_000_000_000)


def time_ns(message: Time) -> int:
    """The inverse of :func:`time_message`."""
    return int(message.sec) * 1_000_000_000 + int(message.nanosec)


def header(t_ns: int, frame: str) -> Header:
    """A header at an int64 nanosecond time."""
    return Header(stamp=time_message(t_ns), frame_id=frame)


def table_message(columns: Columns, t_ns: int, frame: str) -> PointCloud2:
    """A table as PointCloud2."""
    table = encode(columns)
    message = PointCloud2(
        header=header(t_ns, frame), height=1, width=table.rows, is_bigendian=False, is_dense=True
    )
    message.fields = [
        PointField(name=c.name, offset=c.offset, datatype=NUMBERS[c.code], count=c.count)
        for c in table.columns
    ]
    message.point_step, message.row_step = table.row_bytes, table.row_bytes * table.rows
    data = array.array("B")
    data.frombytes(table.data.data)
    message.data = data
    return message


def datum_message(datum: Datum, t_ns: int, frame: str) -> NavSatFix:
    """The datum as NavSatFix, in the frame whose origin it is."""
    return NavSatFix(
        header=header(t_ns, frame),
        latitude=datum.latitude_deg,
        longitude=datum.longitude_deg,
        altitude=datum.height_m,
    )


def datum_of(message: NavSatFix) -> Datum:
    """The inverse of :func:`datum_message`."""
    return Datum(message.latitude, message.longitude, message.altitude)


def platform_messages(
    states: PlatformStates, last_segment: int | None, frames: tuple[str, str]
) -> list[Odometry]:
    """One Odometry per state: pose of the IMU origin, twist in the body frame, pose covariance
    about fixed axes (its position block is the antenna's). The first state after a gap has −1 in
    twist.covariance[0]: nothing ties it to the one before. twist.covariance[1] is the time between
    the fixes around, s, 0 where it is not known. frames : of the map and of the body.
    """
    R = matrix_from_quaternion(states.q_map_body)
    T = np.zeros((len(states), 6, 6))
    T[:, :3, :3], T[:, 3:, 3:] = np.eye(3), R
    covariance = T @ states.C_nav @ T.transpose(0, 2, 1)
    messages = []
    for i in range(len(states)):
        m = Odometry(header=header(int(states.t_ns[i]), frames[0]), child_frame_id=frames[1])
        p, q, v, w = (
            m.pose.pose.position,
            m.pose.pose.orientation,
            m.twist.twist.linear,
            m.twist.twist.angular,
        )
        p.x, p.y, p.z = states.p_map_body[i].tolist()
        q.x, q.y, q.z, q.w = states.q_map_body[i].tolist()
        v.x, v.y, v.z = states.v_body[i].tolist()
        w.x, w.y, w.z = states.omega_body[i].tolist()
        m.pose.covariance = covariance[i].ravel()
        if last_segment is None or int(states.segment[i]) != last_segment:
            m.twist.covariance[0] = -1.0
        if states.fix_gap_s is not None:
            m.twist.covariance[1] = float(states.fix_gap_s[i])
        last_segment = int(states.segment[i])
        messages.append(m)
    return messages


def platform_state(messages: list[Any], segment: int) -> tuple[PlatformStates, int]:
    """The inverse of :func:`platform_messages`; returns the states and the last segment number."""
    n = len(messages)
    segments = np.empty(n, np.int64)
    p, q, v, w, C = (
        np.empty((n, 3)),
        np.empty((n, 4)),
        np.empty((n, 3)),
        np.empty((n, 3)),
        np.empty((n, 6, 6)),
    )
    for i, m in enumerate(messages):
        if m.twist.covariance[0] == -1.0:
            segment += 1
        segments[i] = segment
        a, b, c, d = (
            m.pose.pose.position,
            m.pose.pose.orientation,
            m.twist.twist.linear,
            m.twist.twist.angular,
        )
        p[i], q[i], v[i], w[i] = (
            (a.x, a.y, a.z),
            (b.x, b.y, b.z, b.w),
            (c.x, c.y, c.z),
            (d.x, d.y, d.z),
        )
        C[i] = np.asarray(m.pose.covariance).reshape(6, 6)
    T = np.zeros((n, 6, 6))
    T[:, :3, :3], T[:, 3:, 3:] = np.eye(3), matrix_from_quaternion(q).transpose(0, 2, 1)
    t_ns = np.array([stamp_ns(m) for m in messages], np.int64)
    gap_s = np.array([m.twist.covariance[1] for m in messages], np.float64)
    gap_s[~(gap_s > 0.0)] = np.nan
    states = PlatformStates(t_ns, p, q, v, w, T @ C @ T.transpose(0, 2, 1), segments, gap_s)
    return states, segment
