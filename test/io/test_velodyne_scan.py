"""Packets of Velodyne's scanners: in recordings and captures, against a decoder of our own from the
manuals, and with the times, beams and echoes that they say.
"""

import os
import struct
from pathlib import Path

import numpy as np
import pytest

from benchmarks.velodyne_packets import VLP16_DEG, VLP16_HEIGHT_M
from benchmarks.velodyne_packets import sweeps as manual_sweeps
from ladar_volume.io.bags import TYPESTORE, BagReader, BagWriter
from ladar_volume.io.cloud_messages import returns_from_cloud
from ladar_volume.io.drivers import velodyne_scan
from ladar_volume.io.drivers.packet_capture import PacketCapture, open_recording
from ladar_volume.model.errors import BagError, CloudError, ParameterValueError
from ladar_volume.model.losses import Losses
from ladar_volume.model.parameters import GeoreferenceParameters

pytest.importorskip("velodyne_decoder")

SHARED = Path(os.environ.get("LADAR_SHARED_DATA", "/none")) / "velodyne_packets"
real = pytest.mark.skipif(not SHARED.is_dir(), reason="LADAR_SHARED_DATA has no real packets")
T0_US = 1_453_364_282 * 10**6 + 340_595
FIRING_US, LASER_US = 55.296, 2.304
STRONGEST, LAST, DUAL, VLP16, VLP32C = 0x37, 0x38, 0x39, 0x22, 0x28


def packet(number, ranges_mm, mode=STRONGEST, model=VLP16, clock_us=T0_US):
    """A data packet of a VLP-16 that turns by 0.4° a block: 12 blocks, two firings of 16 lasers
    each; in dual mode every second block repeats the azimuth. ranges_mm : (12, 32), 0 for nothing.
    """
    first = number * (6 if mode == DUAL else 12)
    out = bytearray()
    for block in range(12):
        turn = first + (block // 2 if mode == DUAL else block)
        out += struct.pack("<HH", 0xEEFF, turn * 40 % 36000)
        for laser in range(32):
            out += struct.pack("<HB", int(ranges_mm[block][laser]) // 2, 100)
    since = number * (12 if mode == DUAL else 24) * FIRING_US
    out += struct.pack("<IBB", round(clock_us + since) % velodyne_scan.HOUR_US, mode, model)
    return bytes(out)


def scan(packets, stamps_us, end_us=None):
    """A VelodyneScan as rosbags has it."""
    types = TYPESTORE.types
    time = types["builtin_interfaces/msg/Time"]
    at = [time(int(t) // 10**6, int(t) % 10**6 * 1000) for t in stamps_us]
    header = types["std_msgs/msg/Header"](stamp=at[-1], frame_id="velodyne")
    return types[velodyne_scan.KIND](
        header,
        [
            types["velodyne_msgs/msg/VelodynePacket"](t, np.frombuffer(p, np.uint8))
            for t, p in zip(at, packets, strict=True)
        ],
    )


def stamps_of(packets):
    return [
        T0_US // 10**6 // 3600 * 3600 * 10**6 + velodyne_scan.packet_clock_us(p) for p in packets
    ]


def read(message, **parameters):
    losses = Losses()
    return returns_from_cloud(message, GeoreferenceParameters(**parameters), losses), losses


def by_manual(packets_ranges_mm):
    """Points, rings and times (s) of strongest-mode packets, laser by laser from the manual."""
    places, rings, times = [], [], []
    order = np.argsort(np.argsort(VLP16_DEG))
    for number, ranges in enumerate(packets_ranges_mm):
        for block in range(12):
            for shot in range(32):
                if not ranges[block][shot]:
                    continue
                laser, firing = shot % 16, shot // 16
                since_us = firing * FIRING_US + laser * LASER_US
                turn = np.radians((number * 12 + block) * 0.4 + 0.4 * since_us / (2 * FIRING_US))
                up, r = np.radians(VLP16_DEG[laser]), int(ranges[block][shot]) // 2 * 0.002
                # the manual's y is ahead and x to the right: the message's x ahead, y to the left
                places.append(
                    (
                        r * np.cos(up) * np.cos(turn),
                        -r * np.cos(up) * np.sin(turn),
                        r * np.sin(up) + VLP16_HEIGHT_M * VLP16_DEG[laser],
                    )
                )
                rings.append(order[laser])
                times.append(((number * 12 + block) * 2) * FIRING_US * 1e-6 + since_us * 1e-6)
    return np.array(places), np.array(rings), np.array(times)


def test_a_scan_decodes_to_the_points_rings_and_times_of_the_manual():
    rng = np.random.default_rng(5)
    ranges = rng.integers(600, 60_000, (9, 12, 32)) * (rng.random((9, 12, 32)) > 0.2)
    packets = [packet(k, r) for k, r in enumerate(ranges)]
    found, losses = read(scan(packets, stamps_of(packets)))
    places, rings, times = by_manual(ranges)
    assert len(found) == len(places) and not losses.as_dict()
    a = np.lexsort((found.ring, found.t_ns))
    b = np.lexsort((rings, np.rint(times * 1e9)))
    # the clock in a packet counts whole microseconds
    assert np.abs(found.t_ns[a] - T0_US * 1000 - times[b] * 1e9).max() < 1100
    assert np.array_equal(found.ring[a], rings[b])
    # the decoder counts azimuths in the sensor's unit, 0.01 deg
    away = np.linalg.norm(found.r_laser[a] - places[b], axis=1)
    assert (away / np.linalg.norm(places[b], axis=1)).max() < np.radians(0.01)


def test_stamps_of_arrival_are_taken_back_by_a_packets_length_and_the_latest_do_not_count():
    ranges = np.full((6, 12, 32), 5000)
    packets = [packet(k, r) for k, r in enumerate(ranges)]
    length = 24 * FIRING_US
    late = np.array([700, 90, 400, 50, 900, 300]) + length + 123_456
    stamps = np.array(stamps_of(packets)) + late
    found, _ = read(scan(packets, stamps))
    assert found.t_ns.min() == pytest.approx((T0_US + 123_456 + 50) * 1000, abs=3000)


def test_the_clock_that_begins_its_hour_anew_within_a_scan_is_followed():
    ranges = np.full((6, 12, 32), 5000)
    clock = velodyne_scan.HOUR_US - 2000
    packets = [packet(k, r, clock_us=clock) for k, r in enumerate(ranges)]
    clocks = [velodyne_scan.packet_clock_us(p) for p in packets]
    assert min(clocks) < 10_000 < max(clocks)
    stamps = 1_453_363_200 * 10**6 + np.array(clocks) + (np.array(clocks) < 10**6) * 3600 * 10**6
    found, _ = read(scan(packets, stamps))
    assert 7e6 < found.t_ns.max() - found.t_ns.min() < 8.1e6


def test_another_scanner_than_configured_is_refused_with_both_numbers():
    message = scan([packet(0, np.full((12, 32), 5000), model=VLP32C)], [T0_US])
    with pytest.raises(ParameterValueError, match=r"VLP-32C with 32 beams .*beams is 16"):
        read(message)
    with pytest.raises(CloudError, match="0x63"):
        read(scan([packet(0, np.full((12, 32), 5000), model=0x63)], [T0_US]))
    with pytest.raises(CloudError, match="two scanners"):
        mixed = [packet(k, np.full((12, 32), 5000), model=m) for k, m in enumerate((VLP16, VLP32C))]
        read(scan(mixed, [T0_US, T0_US]))


def test_of_two_echoes_of_a_firing_the_farther_is_taken_and_the_other_counted():
    ranges = np.full((12, 32), 5000)
    ranges[1::2, :20] = 9000
    message = scan([packet(0, ranges, mode=DUAL)], [T0_US])
    found, losses = read(message)
    # 6 firings of 32: of 20 two echoes, 12 are alike and come once from the decoder
    assert len(found) == 6 * 32 and losses.as_dict() == {"point_dual_return": 6 * 20}
    reach = np.linalg.norm(found.r_laser, axis=1)
    assert np.count_nonzero(np.abs(reach - 9.0) < 0.02) == 6 * 20


def test_a_recording_of_packets_reads_as_clouds(tmp_path):
    packets = [packet(k, np.full((12, 32), 5000)) for k in range(4)]
    with BagWriter(tmp_path / "bag") as bag:
        bag.write("front/packets", scan(packets, stamps_of(packets)), T0_US * 1000)
    with BagReader(tmp_path / "bag") as bag:
        assert bag.roles() == {"cloud": "front/packets"}
        assert bag.roles({"cloud": "/front/packets"}) == {"cloud": "front/packets"}
        raw = next(bag.raw())
        assert len(read(bag.message(raw))[0]) == 4 * 12 * 32
        with pytest.raises(BagError, match="--poses LOG"):
            bag.require(bag.roles(), "gnss_imu")


def frame(data, port=2368, sender=201):
    """A datagram in its Ethernet frame."""
    udp = struct.pack("!HHHH", port, port, 8 + len(data), 0) + data
    head = struct.pack("!BBHHHBBH", 0x45, 0, 20 + len(udp), 0, 0, 64, 17, 0)
    return bytes(12) + b"\x08\x00" + head + bytes((192, 168, 1, sender)) + b"\xff" * 4 + udp


def capture(path, frames):
    """A classic pcap; frames : time (s) and bytes."""
    with path.open("wb") as file:
        file.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1))
        for seconds, data in frames:
            whole, micro = divmod(round(seconds * 1e6), 10**6)
            file.write(struct.pack("<IIII", whole, micro, len(data), len(data)) + data)
    return path


def test_a_capture_is_cut_into_turns_at_the_times_of_arrival(tmp_path):
    packets = [packet(k, np.full((12, 32), 5000)) for k in range(160)]  # 75 a turn
    arrivals = [1000.0 + k * 24 * FIRING_US * 1e-6 for k in range(160)]
    frames = [(t, frame(p)) for t, p in zip(arrivals, packets, strict=True)]
    with open_recording(capture(tmp_path / "a.pcap", [(999.0, b"\1\2"), *frames])) as found:
        assert isinstance(found, PacketCapture) and found.clock == "times of arrival"
        assert found.topics() == {"velodyne_packets": ("velodyne_msgs/msg/VelodyneScan", 3)}
        scans = [found.message(raw) for raw in found.raw()]
    assert [len(s.packets) for s in scans] == [75, 75, 10]
    assert read(scans[0])[0].t_ns.min() == pytest.approx(1000e9 - 24 * FIRING_US * 1e3, abs=3000)
    two = [(1.0, frame(packets[0])), (1.1, frame(packets[1], sender=202))]
    with pytest.raises(BagError, match=r"2 scanners, 192.168.1.201, 192.168.1.202"):
        open_recording(capture(tmp_path / "b.pcap", two))
    for name, content in (("c.pcap", b"no capture"), ("d.pcapng", b"")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(BagError, match="not a readable capture"):
            open_recording(tmp_path / name)
    late = capture(tmp_path / "f.pcap", [(2.0**31, frame(packets[0]))])
    with pytest.raises(BagError, match="before 1970 or after 2038"):
        open_recording(late)
    late.write_bytes(late.read_bytes()[:32] + b"\xff" * 3 + b"\x7f" + b"\xff" * 4 + bytes(50))
    with pytest.raises(BagError, match=r"not a readable capture|no packet of"):
        open_recording(late)
    with pytest.raises(BagError, match="no packet of 1206 bytes"):
        open_recording(capture(tmp_path / "e.pcap", [(1.0, frame(bytes(100)))]))


@real
def test_a_real_vlp16_locked_to_gps_has_its_own_times_and_the_points_of_the_manual():
    with open_recording(SHARED / "sample_velodyne_vlp16_gps.pcap") as found:
        assert found.clock == "the scanner's, locked to PPS"
        clouds = [read(found.message(raw))[0] for raw in found.raw()]
        packets = [bytes(p.data) for raw in found.raw() for p in found.message(raw).packets]
    t = np.concatenate([c.t_ns for c in clouds])
    # 2016-01-21 08:18:02 UTC by the receiver
    assert abs(t.min() * 1e-9 - 1_453_364_282.340595) < 1e-4 and len(packets) == 293
    r = np.concatenate([c.r_laser for c in clouds])
    mine = np.concatenate([s.r for s in manual_sweeps(packets, "VLP-16", 0.0)])
    assert len(r) == len(mine)
    mine = np.column_stack([mine[:, 1], -mine[:, 0], mine[:, 2]])
    order, other = (np.lexsort(np.round(x, 1).T[::-1]) for x in (r, mine))
    assert np.median(np.linalg.norm(r[order] - mine[other], axis=1)) < 0.02


@real
def test_a_real_vlp32c_bag_gives_the_cloud_of_another_decoder():
    from scipy.spatial import cKDTree

    header, _, body = (SHARED / "vlp32_expected.pcd").read_bytes().partition(b"DATA binary\n")
    expected = np.frombuffer(body, "<f4", 3 * 26216).reshape(-1, 3)
    best = []
    with BagReader(SHARED / "vlp32_bag") as bag:
        (topic,) = bag.roles().values()
        for raw in bag.raw({topic}):
            found, _ = read(bag.message(raw), beams=32)
            distance, _ = cKDTree(found.r_laser).query(expected)
            best.append(np.median(distance))
            with pytest.raises(ParameterValueError, match="32 beams"):
                read(bag.message(raw))
    assert b"POINTS 26216" in header and min(best) < 0.01
