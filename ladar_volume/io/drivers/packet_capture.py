"""A capture (pcap, pcapng) of a Velodyne's UDP packets, read as a recording of one topic of
``velodyne_msgs/VelodyneScan``: a message for every turn.

Where the sensor's position packets say that it is locked to a receiver's pulse (PPS), the times are
its own, in UTC; else they are those at which the packets came, of the computer that captured.
"""

from __future__ import annotations

import datetime
import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ladar_volume.io.bags import TYPESTORE, BagReader, Raw, Recording
from ladar_volume.io.drivers.velodyne_scan import HOUR_US, KIND, PACKET, TOPIC, packet_clock_us
from ladar_volume.model.errors import BagError, short_repr

#: Endings of captures, and the bytes of a position packet.
ENDINGS, POSITION = (".pcap", ".pcapng", ".cap"), 512
#: PPS status of a position packet: locked.
LOCKED = 2
#: A turn backwards by more than this (hundredths of a degree) is a new one.
WRAP = 18_000


@dataclass(frozen=True)
class Packet:
    """t_ns : when it came, by the capturing computer · sender : address · data : payload"""

    t_ns: int
    sender: bytes
    data: bytes


class PacketCapture(Recording):
    """Opened on construction. Raises :class:`BagError`: bag_missing, bag_format, bag_empty, and
    bag_topic where two scanners are in one capture.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        if not self.path.is_file():
            raise BagError(f"{self.path}: no such capture", reason="bag_missing", value=str(path))
        packets = list(self._packets())
        data = [p for p in packets if len(p.data) == PACKET]
        if not data:
            raise BagError(
                f"{self.path}: no packet of {PACKET} bytes, as Velodyne's scanners send them",
                reason="bag_empty",
                value=str(path),
            )
        senders = sorted({".".join(map(str, p.sender)) for p in data})
        if len(senders) > 1:
            raise BagError(
                f"{self.path}: packets of {len(senders)} scanners, {', '.join(senders)}: cut the "
                f"capture, tcpdump -r FILE -w ONE 'src {senders[0]}'",
                reason="bag_topic",
                value=senders,
            )
        utc = utc_of([p for p in packets if len(p.data) == POSITION])
        self.clock = "times of arrival" if utc is None else "the scanner's, locked to PPS"
        self._scans = [[data[i] for i in turn] for turn in turns([p.data for p in data])]
        self._stamps = [[stamp_of(p, utc) for p in scan] for scan in self._scans]
        times = [t for scan in self._stamps for t in scan]
        if min(times) < 0 or max(times) >= 2**31 * 10**9:
            raise BagError(f"{self.path}: times before 1970 or after 2038", reason="bag_format")

    def _packets(self) -> Iterator[Packet]:
        """Payloads of all UDP packets over IPv4."""
        import dpkt  # with captures alone; comes with velodyne-decoder

        try:
            with self.path.open("rb") as stream:
                reader = dpkt.pcap.UniversalReader(stream)
                for seconds, frame in reader:
                    ip = network_layer(frame, reader.datalink())
                    udp = getattr(ip, "data", None)
                    if isinstance(ip, dpkt.ip.IP) and isinstance(udp, dpkt.udp.UDP):
                        yield Packet(round(seconds * 10**9), bytes(ip.src), bytes(udp.data))
        except Exception as error:  # a damaged file fails anywhere inside dpkt
            raise BagError(
                f"{self.path}: not a readable capture: {short_repr(error)}", reason="bag_format"
            ) from error

    def __enter__(self) -> PacketCapture:
        return self

    def __exit__(self, *error: object) -> None:
        """Nothing is open."""

    @property
    def start_ns(self) -> int:
        """Time of the first packet."""
        return self._stamps[0][0]

    @property
    def duration_s(self) -> float:
        """From first to last packet."""
        return (self._stamps[-1][-1] - self._stamps[0][0]) * 1e-9

    def topics(self) -> dict[str, tuple[str, int]]:
        """The one topic, its type and number of turns."""
        return {TOPIC: (KIND, len(self._scans))}

    def raw(
        self, topics: set[str] | None = None, span: tuple[int, int] | None = None
    ) -> Iterator[Raw]:
        """Turns in their order, each when its last packet had come."""
        types = TYPESTORE.types
        time = types["builtin_interfaces/msg/Time"]
        for scan, stamps in zip(self._scans, self._stamps, strict=True):
            if span is not None and not span[0] <= stamps[-1] <= span[1]:
                continue
            at = [time(*divmod(t, 10**9)) for t in stamps]
            packets = [
                types["velodyne_msgs/msg/VelodynePacket"](t, np.frombuffer(p.data, np.uint8))
                for t, p in zip(at, scan, strict=True)
            ]
            header = types["std_msgs/msg/Header"](stamp=at[-1], frame_id="velodyne")
            message = types[KIND](header, packets)
            yield Raw(stamps[-1], TOPIC, KIND, bytes(TYPESTORE.serialize_cdr(message, KIND)))

    def message(self, raw: Raw) -> Any:
        """Deserialise."""
        return TYPESTORE.deserialize_cdr(raw.data, raw.kind)

    def digest(self) -> str:
        """sha256 of the file."""
        with self.path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()


def network_layer(frame: bytes, link: int) -> object:
    """The network packet in a frame of Ethernet, Linux cooked capture, or none (raw IP)."""
    import dpkt

    try:
        if link == dpkt.pcap.DLT_EN10MB:
            return dpkt.ethernet.Ethernet(frame).data
        if link == dpkt.pcap.DLT_LINUX_SLL:
            return dpkt.sll.SLL(frame).data
        return dpkt.ip.IP(frame)
    except (dpkt.dpkt.Error, ValueError, IndexError):  # a torn frame, or another protocol
        return None


def utc_of(positions: list[Packet]) -> tuple[int, int] | None:
    """Arrival (ns) and UTC (ns) of a position packet that is locked to a receiver's pulse and holds
    its time with a date; None where there is none.
    """
    import velodyne_decoder as velodyne

    for packet in positions:
        said = velodyne.TelemetryPacket(bytearray(packet.data))
        if packet.data[202] != LOCKED or not isinstance(said.pps_time, datetime.datetime):
            continue
        utc = said.pps_time.replace(tzinfo=datetime.UTC)
        whole = int(utc.replace(microsecond=0).timestamp()) * 10**9
        return packet.t_ns, whole + utc.microsecond * 1000
    return None


def stamp_of(packet: Packet, utc: tuple[int, int] | None) -> int:
    """Time of a data packet, ns: its sensor's clock in the hour that the receiver tells, else its
    arrival.
    """
    if utc is None:
        return packet.t_ns
    about_us = (utc[1] + packet.t_ns - utc[0]) // 1000
    clock = packet_clock_us(packet.data)
    ahead = (clock - about_us + HOUR_US // 2) % HOUR_US - HOUR_US // 2
    return (about_us + ahead) * 1000


def turns(payloads: list[bytes]) -> list[list[int]]:
    """Numbers of the packets of each turn of the scanner, by the azimuth of their first block."""
    azimuth = np.array([int.from_bytes(p[2:4], "little") for p in payloads])
    begins = np.flatnonzero(np.diff(azimuth) < -WRAP) + 1
    return [part.tolist() for part in np.split(np.arange(len(payloads)), begins)]


def open_recording(path: str | Path, all_messages: bool = False) -> Recording:
    """A recording of any kind. all_messages : of a log also what the nodes had not heard. Raises
    :class:`BagError` as :class:`BagReader` and :class:`PacketCapture`.
    """
    path = Path(path)
    if path.suffix.lower() in ENDINGS:
        return PacketCapture(path)
    return BagReader(path, all_messages)
