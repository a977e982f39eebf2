"""Velodyne data packets to sweeps, for tests and benchmarks alone: the package itself reads clouds.

A data packet has 1206 bytes: 12 blocks of 100, each a flag (EE FF), an azimuth in 0.01° and 32
returns of two bytes of range and one of intensity; then four bytes of time and two of mode and
model (user manuals of the VLP-16 and the VLP-32C, chapter 9 and appendix A). A VLP-16 fires its 16
lasers twice in a block and counts range in 2 mm, a VLP-32C once in 4 mm.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.truth import F64, I64
from ladar_volume.io.bags import BagReader

PACKET, BLOCKS, RETURNS = 1206, 12, 32
FIRING = np.dtype(
    [("flag", "<u2"), ("azimuth", "<u2"), ("shot", [("range", "<u2"), ("strength", "u1")], RETURNS)]
)
#: One firing of all lasers, and from one laser of a VLP-16 (or pair of a VLP-32C) to the next, s.
CYCLE_S, STEP_S = 55.296e-6, 2.304e-6
#: A sensor that turns slower than 5 Hz or faster than 20 Hz is none: azimuth of a block, degrees.
WIDEST_BLOCK_DEG = 1.0
#: Elevations and azimuth offsets of the lasers in the order of firing, degrees, and the unit of
#: range, m.
VLP16_DEG = (-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15)
VLP32C_DEG = (
    *(-25, -1, -1.667, -15.639, -11.31, 0, -0.667, -8.843, -7.254, 0.333, -0.333, -6.148, -5.333),
    *(1.333, 0.667, -4, -4.667, 1.667, 1, -3.667, -3.333, 3.333, 2.333, -2.667, -3, 7, 4.667),
    *(-2.333, -2, 15, 10.333, -1.333),
)
VLP32C_OFFSET = (
    *(1.4, -4.2, 1.4, -1.4, 1.4, -1.4, 4.2, -1.4, 1.4, -4.2, 1.4, -1.4, 4.2, -1.4, 4.2, -1.4),
    *(1.4, -4.2, 1.4, -4.2, 4.2, -1.4, 1.4, -1.4, 1.4, -1.4, 1.4, -4.2, 4.2, -1.4, 1.4, -1.4),
)
#: The lasers of a VLP-16 leave the axis as high above the centre as this, m per degree of
#: elevation.
VLP16_HEIGHT_M = -0.0112 / 15


@dataclass(frozen=True)
class Sweep:
    """One turn: r (n, 3) m about the sensor, x to the right, y ahead, z up · ring (n,) upwards."""

    r: F64
    ring: I64


def pcap_packets(path: Path) -> list[bytes]:
    """Payloads of the data packets of a capture (classic pcap, Ethernet, IPv4, UDP)."""
    data = path.read_bytes()
    order = "<" if data[:4] in (b"\xd4\xc3\xb2\xa1", b"\x4d\x3c\xb2\xa1") else ">"
    at, out = 24, []
    while at + 16 <= len(data):
        size = struct.unpack_from(order + "I", data, at + 8)[0]
        frame = data[at + 16 : at + 16 + size]
        at += 16 + size
        if len(frame) >= 42 + PACKET and frame[23] == 17:
            out.append(frame[-PACKET:])
    return out


def bag_packets(path: Path) -> list[list[bytes]]:
    """Payloads in each ``velodyne_msgs/msg/VelodyneScan`` of a recording."""
    with BagReader(path) as bag:
        return [scan_packets(raw.data) for raw in bag.raw() if raw.kind.endswith("/VelodyneScan")]


def scan_packets(message: bytes) -> list[bytes]:
    """Payloads in a serialised VelodyneScan (CDR, little endian): stamp and frame, then a sequence
    of stamp (8 bytes) and payload, each aligned to four bytes.
    """
    body = bytes(message[4:])
    at = 12 + struct.unpack_from("<I", body, 8)[0]
    at += -at % 4
    count = struct.unpack_from("<I", body, at)[0]
    stride = 8 + PACKET + -PACKET % 4
    first = at + 4 + 8
    return [body[first + i * stride : first + i * stride + PACKET] for i in range(count)]


def firings(packets: list[bytes]) -> tuple[F64, I64]:
    """Azimuths (b,) degrees, unwrapped, and ranges (b, 32) in units of the sensor."""
    blocks = np.concatenate([np.frombuffer(p, FIRING, BLOCKS) for p in packets])
    blocks = blocks[blocks["flag"] == 0xEEFF]
    azimuth = np.unwrap(blocks["azimuth"] * 0.01, period=360.0)
    return azimuth, blocks["shot"]["range"].astype(np.int64)


def sweeps(packets: list[bytes], model: str, least_m: float = 0.4) -> list[Sweep]:
    """Turns of a sensor, ``"VLP-16"`` or ``"VLP-32C"``, with the returns beyond ``least_m``."""
    azimuth, counts = firings(packets)
    step = np.diff(azimuth, append=2 * azimuth[-1] - azimuth[-2])
    step = np.where((step > 0) & (step < WIDEST_BLOCK_DEG), step, np.median(step))
    laser = np.arange(RETURNS)
    if model == "VLP-16":
        elevation, offset = np.array(VLP16_DEG * 2, float), np.zeros(RETURNS)
        seconds, whole = laser // 16 * CYCLE_S + laser % 16 * STEP_S, 2 * CYCLE_S
        height, unit = VLP16_HEIGHT_M * elevation, 0.002
    else:
        elevation, offset = np.array(VLP32C_DEG), np.array(VLP32C_OFFSET)
        seconds, whole = laser // 2 * STEP_S, CYCLE_S
        height, unit = np.zeros(RETURNS), 0.004
    turn = azimuth[:, None] + step[:, None] * seconds / whole
    r = _points(np.radians(turn + offset), np.radians(elevation), counts * unit, height)
    rank = np.searchsorted(np.unique(elevation), elevation)
    ring = np.broadcast_to(rank, counts.shape)
    number = np.floor((turn - azimuth[0]) / 360.0)
    there = counts * unit > least_m
    return [
        Sweep(r[there & (number == k)], ring[there & (number == k)].astype(np.int64))
        for k in range(int(number.max()) + 1)
    ]


def _points(turn: F64, elevation: F64, length: F64, height: F64) -> F64:
    """Points (b, 32, 3) from azimuth clockwise from y, elevation, range and height of the laser."""
    out: npt.NDArray[np.float64] = np.stack(
        [
            length * np.cos(elevation) * np.sin(turn),
            length * np.cos(elevation) * np.cos(turn),
            length * np.sin(elevation) + height,
        ],
        axis=-1,
    )
    return out
