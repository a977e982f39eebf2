"""``velodyne_msgs/VelodyneScan``: the packets of a Velodyne as its driver collects them, decoded by
velodyne-decoder with the calibration and the firing times of the model.

A packet has 1206 bytes; its last six are the sensor's clock (4, microseconds in the hour, the first
firing of the packet), the return mode and the model (user manuals of VLP-16 and VLP-32C,
chapter 9).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from ladar_volume.model.errors import CloudError, ParameterValueError
from ladar_volume.model.parameters import GeoreferenceParameters
from ladar_volume.model.records import I64, Returns

#: Names of the message and of its topic, as velodyne_driver has them.
KIND, TOPIC = "velodyne_msgs/msg/VelodyneScan", "velodyne_packets"
#: Bytes of a data packet.
PACKET = 1206
#: Model and number of beams by the last byte of a packet.
MODELS = {
    0x21: ("HDL-32E", 32),
    0x22: ("VLP-16", 16),
    0x24: ("Puck Hi-Res", 16),
    0x28: ("VLP-32C", 32),
    0xA1: ("Alpha Prime", 128),
}
#: The sensor's clock counts the microseconds of an hour.
HOUR_US = 3_600_000_000
#: A packet's stamp that is its own clock's, as far as a float64 of seconds since 1970 tells, us.
SAME_US = 2
#: What a VelodyneScan is made of; recordings of ROS 2 do not always say.
DEFINITIONS = {
    "velodyne_msgs/msg/VelodynePacket": "builtin_interfaces/Time stamp\nuint8[1206] data\n",
    KIND: "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets\n",
}


class Stamp(Protocol):
    """builtin_interfaces/Time."""

    sec: int
    nanosec: int


class Packet(Protocol):
    """velodyne_msgs/VelodynePacket."""

    stamp: Stamp
    data: Sequence[int]


class Scan(Protocol):
    """velodyne_msgs/VelodyneScan."""

    packets: Sequence[Packet]


def packet_clock_us(data: bytes) -> int:
    """The sensor's clock in a packet, us in the hour."""
    return int(struct.unpack_from("<I", data, PACKET - 6)[0])


def model_of(packets: Sequence[bytes]) -> tuple[str, int]:
    """Name and number of beams of the one model that sent all packets.

    Raises CloudError: cloud_packets for none, other sizes or two models, cloud_model for one that
    is not known.
    """
    if not packets or any(len(p) != PACKET for p in packets):
        raise CloudError(f"a scan is packets of {PACKET} bytes", reason="cloud_packets")
    codes = {p[-1] for p in packets}
    if len(codes) > 1:
        raise CloudError(
            f"packets of models {sorted(map(hex, codes))} in one scan: two scanners on one port",
            reason="cloud_packets",
        )
    code = codes.pop()
    if code not in MODELS:
        names = ", ".join(name for name, _ in MODELS.values())
        raise CloudError(
            f"packets of model {code:#x}: read are those of {names}; convert the recording to "
            "PointCloud2 with its driver",
            reason="cloud_model",
            value=code,
        )
    return MODELS[code]


def check_beams(packets: Sequence[bytes], beams: int) -> None:
    """Raises ParameterValueError where the scanner has another number of beams than configured."""
    name, count = model_of(packets)
    if count != beams:
        raise ParameterValueError(
            f"the packets are of a {name} with {count} beams and georeference.beams is {beams}: "
            f"set georeference.beams to {count}",
            value=beams,
        )


def first_firing_ns(stamps_ns: I64, clock_us: I64) -> int:
    """Time of the first firing of a scan, from the stamps (n,) of its packets and the sensor's own
    clock (n,), which tells how they lie to one another.

    Stamps that are the sensor's clock in the hour (``gps_time`` of the driver) stand. Others tell
    when a packet had come, a packet's length after its first firing; the one that was least late
    counts.
    """
    since = (clock_us - clock_us[0] + HOUR_US // 2) % HOUR_US - HOUR_US // 2
    in_hour = (stamps_ns // 1000 - clock_us + HOUR_US // 2) % HOUR_US - HOUR_US // 2
    if bool((np.abs(in_hour) <= SAME_US).all()):
        return int(stamps_ns[0])
    length_us = int(np.median(np.diff(since))) if len(since) > 1 else 0
    return int((stamps_ns - 1000 * since).min()) - 1000 * length_us


def returns_from_scan(message: Scan, parameters: GeoreferenceParameters) -> Returns:
    """All returns of a VelodyneScan, two of one firing in dual mode.

    Axes as velodyne_pointcloud has them: x forward, y left, z up; rings upwards. Raises CloudError
    as :func:`model_of`, cloud_all_nan for a scan without return, and ParameterValueError as
    :func:`check_beams`.
    """
    import velodyne_decoder as velodyne  # with packets alone

    packets = [bytes(p.data) for p in message.packets]
    check_beams(packets, parameters.beams)
    stamps = np.array([p.stamp.sec * 10**9 + p.stamp.nanosec for p in message.packets], np.int64)
    start = first_firing_ns(stamps, np.array([packet_clock_us(p) for p in packets], np.int64))
    # all ranges: what is too near or too far is counted where other clouds' is
    config = velodyne.Config(min_range=0.0, max_range=1000.0, timestamp_first_packet=True)
    scan = velodyne.PacketVector()
    for stamp, data in zip(stamps, packets, strict=True):
        scan.append(velodyne.VelodynePacket(float(stamp) * 1e-9, bytearray(data)))
    try:
        _, points = velodyne.ScanDecoder(config).decode(scan)
    except RuntimeError as error:
        raise CloudError(f"packets: {error}", reason="cloud_packets") from error
    if not len(points):
        raise CloudError("no return in any packet", reason="cloud_all_nan", value=0)
    since = np.rint(points[:, 4].astype(np.float64) * 1e9).astype(np.int64)
    return Returns(
        start + since,
        points[:, :3].astype(np.float64),
        points[:, 6].astype(np.uint16),
        np.ascontiguousarray(points[:, 3]),
    )
