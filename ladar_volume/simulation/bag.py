"""A survey written as a recording: rosbag2 MCAP, ``config.yaml`` with nominal values, and
``truth.json``.

The pipeline never opens truth.json.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import yaml
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from ladar_volume.model.errors import OutputError
from ladar_volume.simulation.survey import HEIGHT_M, LATITUDE_DEG, LONGITUDE_DEG, Survey, Sweep

STORE = get_typestore(Stores.ROS2_JAZZY)
T = STORE.types
FLOAT32, UINT16 = 7, 4
#: What a recording holds: topic and kind of sensor_msgs.
TOPICS = {"/velodyne_points": "PointCloud2", "/gnss/fix": "NavSatFix", "/imu/data": "Imu"}


def _header(t_ns: int, frame: str) -> Any:
    stamp = T["builtin_interfaces/msg/Time"](
        sec=t_ns // 1_000_000_000, nanosec=t_ns % 1_000_000_000
    )
    return T["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def cloud_message(sweep: Sweep) -> Any:
    """PointCloud2 with the Velodyne driver's fields x y z intensity ring time, 22 bytes a point."""
    columns = [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("intensity", "<f4"),
        ("ring", "<u2"),
        ("time", "<f4"),
    ]
    layout = np.dtype(columns)
    packed = np.empty(len(sweep.time_s), layout)
    packed["x"], packed["y"], packed["z"] = sweep.xyz.T
    packed["intensity"], packed["ring"], packed["time"] = sweep.intensity, sweep.ring, sweep.time_s
    kinds = {"<f4": FLOAT32, "<u2": UINT16}
    fields, offset = [], 0
    for name, code in columns:
        fields.append(
            T["sensor_msgs/msg/PointField"](name=name, offset=offset, datatype=kinds[code], count=1)
        )
        offset += np.dtype(code).itemsize
    return T["sensor_msgs/msg/PointCloud2"](
        header=_header(sweep.stamp_ns, "velodyne"),
        height=1,
        width=len(packed),
        fields=fields,
        is_bigendian=False,
        point_step=layout.itemsize,
        row_step=layout.itemsize * len(packed),
        data=packed.view(np.uint8),
        is_dense=True,
    )


def _fix_messages(survey: Survey) -> Iterator[tuple[int, str, Any]]:
    frame = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=cart +ellps=WGS84 +step +proj=topocentric "
        f"+ellps=WGS84 +lon_0={LONGITUDE_DEG} "
        f"+lat_0={LATITUDE_DEG} +h_0={HEIGHT_M}"
    )
    t, p, sigma, status = survey.fixes()
    lon, lat, h = frame.transform(p[:, 0], p[:, 1], p[:, 2], direction="INVERSE")
    for i in range(len(t)):
        yield (
            int(t[i]),
            "/gnss/fix",
            T["sensor_msgs/msg/NavSatFix"](
                header=_header(int(t[i]), "gnss"),
                status=T["sensor_msgs/msg/NavSatStatus"](status=int(status[i]), service=1),
                latitude=float(lat[i]),
                longitude=float(lon[i]),
                altitude=float(h[i]),
                position_covariance=np.diag(sigma[i] ** 2).ravel(),
                position_covariance_type=2,
            ),
        )


def _imu_messages(survey: Survey) -> Iterator[tuple[int, str, Any]]:
    vector = T["geometry_msgs/msg/Vector3"]
    unknown = np.concatenate([[-1.0], np.zeros(8)])
    t, q, rates, covariance = survey.attitudes()
    for i in range(len(t)):
        yield (
            int(t[i]),
            "/imu/data",
            T["sensor_msgs/msg/Imu"](
                header=_header(int(t[i]), "imu"),
                orientation=T["geometry_msgs/msg/Quaternion"](*(float(v) for v in q[i])),
                orientation_covariance=covariance[i].ravel(),
                angular_velocity=vector(*(float(v) for v in rates[i])),
                angular_velocity_covariance=np.diag([1e-6] * 3).ravel(),
                linear_acceleration=vector(0.0, 0.0, 0.0),
                linear_acceleration_covariance=unknown,
            ),
        )


def nominal_config(survey: Survey, extra: dict[str, dict[str, Any]]) -> str:
    """The configuration a surveyor would have: nominal mounting and the budget, in the ROS
    layout.
    """
    p = survey.platform
    sections: dict[str, dict[str, Any]] = {
        "calibration": {
            "boresight_roll_deg": p.boresight_deg[0],
            "boresight_pitch_deg": p.boresight_deg[1],
            "boresight_yaw_deg": p.boresight_deg[2],
            "lever_laser_m": list(p.lever_laser_m),
            "lever_antenna_m": list(p.lever_antenna_m),
        },
        "georeference": {
            "datum_latitude_deg": LATITUDE_DEG,
            "datum_longitude_deg": LONGITUDE_DEG,
            "datum_height_m": HEIGHT_M,
        },
    }
    for section, values in extra.items():
        sections.setdefault(section, {}).update(values)
    return yaml.safe_dump(
        {"/**": {"ros__parameters": sections}}, sort_keys=False, default_flow_style=None
    )


def write_bag(
    survey: Survey, path: Path, extra: dict[str, dict[str, Any]], progress: Callable[[float], None]
) -> None:
    """Write the recording folder; ``progress`` is told the share done. Raises OutputError where it
    cannot be written; a recording broken off leaves nothing behind.
    """
    if path.exists():
        raise OutputError(f"{path} exists already", reason="output_exists", value=str(path))
    messages = sorted([*_fix_messages(survey), *_imu_messages(survey)], key=lambda m: m[0])
    try:
        writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with writer:
            _write_messages(TopicWriter(writer), survey, messages, progress)
        (path / "truth.json").write_text(
            json.dumps(survey.truth, indent=1) + "\n", encoding="utf-8"
        )
        (path / "config.yaml").write_text(nominal_config(survey, extra), encoding="utf-8")
    except BaseException as error:
        shutil.rmtree(path, ignore_errors=True)
        if isinstance(error, OSError):
            raise OutputError(f"{path}: cannot be written: {error}", value=str(path)) from error
        raise


class TopicWriter:
    """Messages of :data:`TOPICS` into an open recording."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._connections = {
            topic: writer.add_connection(topic, f"sensor_msgs/msg/{kind}", typestore=STORE)
            for topic, kind in TOPICS.items()
        }

    def write(self, topic: str, message: object, t_ns: int) -> None:
        """Append one message."""
        connection = self._connections[topic]
        data = bytes(STORE.serialize_cdr(message, connection.msgtype))
        self._writer.write(connection, t_ns, data)


def _write_messages(
    out: TopicWriter,
    survey: Survey,
    messages: list[tuple[int, str, Any]],
    progress: Callable[[float], None],
) -> None:
    """Sweeps, and between them the messages (time, topic, message) in the order of their times."""
    waiting, total = 0, max(1, int(survey.options.duration_s * 10))
    for done, sweep in enumerate(survey.sweeps()):
        # a driver sends a sweep when it is complete
        end = sweep.stamp_ns + int(float(sweep.time_s[-1]) * 1e9)
        while waiting < len(messages) and messages[waiting][0] <= end:
            out.write(messages[waiting][1], messages[waiting][2], messages[waiting][0])
            waiting += 1
        out.write("/velodyne_points", cloud_message(sweep), end)
        progress(min(1.0, (done + 1) / total))
    for t_ns, topic, message in messages[waiting:]:
        out.write(topic, message, t_ns)
