"""Messages of an autopilot: a real peer, real logs, and everything that should not be in them."""

import itertools
import math
import os
import random
import socket
import struct
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import all as dialect

from ladar_volume.io.mavlink.mavlink_dataflash import DataFlashLog
from ladar_volume.io.mavlink.mavlink_heights import geoid_undulation
from ladar_volume.io.mavlink.mavlink_links import (
    Peers,
    SerialLink,
    TcpLink,
    UdpLink,
    open_link,
)
from ladar_volume.io.mavlink.mavlink_log import MavlinkLog, log_file
from ladar_volume.io.mavlink.mavlink_records import STATUS
from ladar_volume.io.mavlink.mavlink_session import MavlinkSession
from ladar_volume.io.mavlink.mavlink_stream import MavlinkStream
from ladar_volume.io.mavlink.mavlink_tlog import tlog_frames
from ladar_volume.model.errors import BagError, ConfigurationError
from ladar_volume.model.losses import Losses
from ladar_volume.model.mavlink_parameters import MavlinkParameters
from ladar_volume.model.records import Fix, ImuSample, OdometrySample

REPO = Path(__file__).parents[2]
LOGS = Path(os.environ.get("LADAR_SHARED_DATA", REPO.parent / "shared" / "data")) / "autopilot_logs"
S = 10**9
START = 1_700_000_000 * S
NAN21 = [math.nan] * 21


class Vehicle:
    """Packs messages as an autopilot would; boot time in ms is its clock."""

    def __init__(self, system=1, component=1):
        self.frames = []
        self.mav = dialect.MAVLink(self, srcSystem=system, srcComponent=component)

    def write(self, data):
        self.frames.append(bytes(data))

    def take(self):
        frames, self.frames = self.frames, []
        return frames

    def heartbeat(self, autopilot=dialect.MAV_AUTOPILOT_ARDUPILOTMEGA):
        self.mav.heartbeat_send(2, autopilot, 0, 0, 4)

    def gps(self, ms, **changes):
        values = dict(
            time_usec=ms * 1000,
            fix_type=6,
            lat=501234567,
            lon=141234567,
            alt=250_000,
            eph=80,
            epv=90,
            vel=0,
            cog=0,
            satellites_visible=17,
            alt_ellipsoid=295_000,
            h_acc=14,
            v_acc=20,
            vel_acc=50,
            hdg_acc=0,
            yaw=0,
        )
        self.mav.gps_raw_int_send(**(values | changes))

    def attitude(self, ms, roll=0.1, pitch=-0.2, yaw=1.0):
        self.mav.attitude_send(ms, roll, pitch, yaw, 0.01, 0.02, 0.03)

    def odometry(self, ms, **changes):
        values = dict(
            time_usec=ms * 1000,
            frame_id=1,
            child_frame_id=12,
            x=1.0,
            y=2.0,
            z=-3.0,
            q=[1.0, 0.0, 0.0, 0.0],
            vx=4.0,
            vy=5.0,
            vz=6.0,
            rollspeed=0.1,
            pitchspeed=0.2,
            yawspeed=0.3,
            pose_covariance=NAN21,
            velocity_covariance=NAN21,
        )
        self.mav.odometry_send(**(values | changes))


def settled(**changes):
    """A session whose clocks agree, at boot time 5 s, and its vehicle."""
    session, vehicle = MavlinkSession(MavlinkParameters(**changes)), Vehicle()
    for ms in range(1000, 5001, 100):
        if ms % 1000 == 0:
            vehicle.heartbeat()
        vehicle.mav.system_time_send((START + ms * 10**6) // 1000 + 7 * 10**6, ms)
        for frame in vehicle.take():
            session.feed(frame, START + ms * 10**6)
    return session, vehicle


def fed(session, vehicle, ms):
    return [r for frame in vehicle.take() for r in session.feed(frame, START + ms * 10**6)]


def one(ms=5100, session_changes=None, **changes):
    session, vehicle = settled(**(session_changes or {}))
    vehicle.gps(ms, **changes)
    records = fed(session, vehicle, ms)
    return (records[0] if records else None), session.losses().as_dict()


def test_a_fix_has_its_height_accuracy_status_and_time():
    fix, losses = one()
    assert (fix.latitude_deg, fix.longitude_deg) == (
        pytest.approx(50.1234567),
        pytest.approx(14.1234567),
    ) and not losses
    assert fix.height_m == 295.0 and fix.status == 2 and fix.t_ns == START + 5100 * 10**6
    np.testing.assert_allclose(np.diag(fix.C_enu), [1.96e-4, 1.96e-4, 4e-4])
    assert one(h_acc=0)[0].C_enu is None and one(v_acc=2**32 - 1)[0].C_enu is None
    assert one(session_changes={"gnss_delay_s": 0.15})[0].t_ns == START + 4950 * 10**6
    assert one(session_changes={"height": "msl", "geoid_undulation_m": 44.5})[0].height_m == 294.5
    # stamps in UTC: those of SYSTEM_TIME, whose clock here is seven seconds ahead
    assert one(session_changes={"clock": "utc"})[0].t_ns == START + 12_100 * 10**6
    utc_us = (START + 12_100 * 10**6) // 1000
    assert one(time_usec=utc_us)[0].t_ns == START + 5100 * 10**6


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"fix_type": 1}, "fix_no_fix"),
        ({"fix_type": 2}, "fix_no_fix"),
        ({"fix_type": 77}, "fix_no_fix"),
        ({"alt_ellipsoid": 0}, "fix_no_ellipsoidal_height"),
        ({"lat": 910_000_000}, "fix_range"),
        ({"lat": 0, "lon": 0}, "fix_range"),
        ({"time_usec": 0}, "fix_no_time"),
        ({"time_usec": 2**64 - 1}, "fix_time_range"),
    ],
)
def test_bad_fixes_are_refused_by_name(changes, reason):
    record, losses = one(session_changes={"height": "ellipsoidal"}, **changes)
    assert record is None and losses == {reason: 1}


def test_mean_sea_level_without_the_geoid_is_refused_at_the_start():
    with pytest.raises(ConfigurationError, match="geoid_undulation_m"):
        MavlinkSession(MavlinkParameters(height="msl"))


def test_the_fused_position_takes_the_receivers_undulation():
    session, vehicle = settled(position="GLOBAL_POSITION_INT", height="ellipsoidal")
    vehicle.mav.global_position_int_send(5050, 501234567, 141234567, 251_000, 0, 0, 0, 0, 0)
    assert fed(session, vehicle, 5050) == [] and session.losses().as_dict() == {
        "fix_no_ellipsoidal_height": 1
    }
    vehicle.gps(5060)
    vehicle.mav.global_position_int_send(5100, 501234567, 141234567, 251_000, 0, 0, 0, 0, 0)
    (fix,) = fed(session, vehicle, 5100)
    assert fix.height_m == 296.0 and fix.C_enu is None


def test_heights_have_one_reference_for_a_survey_and_it_is_named():
    session, vehicle = settled()
    vehicle.gps(5100, alt_ellipsoid=0)
    (fix,) = fed(session, vehicle, 5100)
    assert fix.height_m == 250.0
    if geoid_undulation(50.1, 14.1) is None:  # a grid of PROJ would give some 44 m more
        assert "above mean sea level" in session.status()["height"]
    vehicle.gps(5200)  # a step of 45 m in the trajectory, were this one taken now
    assert fed(session, vehicle, 5200)[0].height_m == fix.height_m
    assert one(session_changes={"geoid_undulation_m": 44.5}, alt_ellipsoid=0)[0].height_m == 294.5
    session, vehicle = settled()
    vehicle.gps(5100)
    vehicle.gps(5200, alt_ellipsoid=0, alt=251_000)
    assert [f.height_m for f in fed(session, vehicle, 5200)] == [295.0, 296.0]
    assert session.status()["height"] == "ellipsoidal, the receiver's own"


def test_a_fix_of_a_restarted_autopilot_is_never_published_in_the_past():
    session, vehicle = settled()
    vehicle.attitude(1_248_000)
    vehicle.gps(1_248_000)
    fed(session, vehicle, 1_248_000)
    boot, records = Vehicle(), []
    for ms in range(0, 6000, 200):  # receivers first: attitudes come later
        boot.gps(900 + ms)
        if ms > 3000:
            boot.attitude(900 + ms)
        records += fed(session, boot, 1_250_000 + ms)
    assert session.decoder.restarts == 1 and records
    assert all(r.t_ns > START + 1_250_000 * 10**6 for r in records)
    # a receiver that lost its fix repeats the last one: no restart
    session, vehicle = settled()
    for ms in range(5100, 9000, 100):
        vehicle.attitude(ms)
        vehicle.gps(min(ms, 5500))
        fed(session, vehicle, ms)
    assert session.decoder.restarts == 0 and session.decoder.repeated > 30


def test_the_second_receiver_and_repeated_fixes():
    session, vehicle = settled(position="GPS2_RAW")
    vehicle.gps(5100)
    for _ in range(3):
        vehicle.mav.gps2_raw_send(
            5_100_000,
            5,
            501234567,
            141234567,
            250_000,
            80,
            90,
            0,
            0,
            12,
            0,
            0,
            0,
            296_000,
            20,
            30,
            0,
            0,
        )
    (fix,) = fed(session, vehicle, 5100)
    assert (
        fix.height_m == 296.0
        and session.decoder.repeated == 2
        and session.status()["fix_type"] == "RTK float"
    )


def test_attitudes_and_their_covariance():
    session, vehicle = settled(roll_pitch_sigma_rad=0.01)
    vehicle.attitude(5100, 0.0, 0.0, math.pi / 2)
    (imu,) = fed(session, vehicle, 5100)
    assert (
        imu.C_axes is None and imu.t_ns == START + 5100 * 10**6
    )  # the heading's accuracy is not known
    np.testing.assert_allclose(
        np.abs(imu.q_map_body), [0, 0, 0, 1], atol=1e-7
    )  # east is where x points
    np.testing.assert_allclose(imu.omega_body, [0.01, -0.02, -0.03], rtol=1e-6)
    vehicle.gps(5150, yaw=9000, hdg_acc=50_000)  # half a degree
    vehicle.attitude(5200)
    _, imu = fed(session, vehicle, 5200)
    np.testing.assert_allclose(np.diag(imu.C_axes), [1e-4, 1e-4, math.radians(0.5) ** 2])
    vehicle.mav.attitude_quaternion_send(5300, 1.0, 0.0, 0.0, 0.0, 0.01, 0.02, 0.03)
    vehicle.attitude(5310)  # the quaternion is preferred while it comes
    assert len(fed(session, vehicle, 5310)) == 1
    vehicle.attitude(8000)
    assert len(fed(session, vehicle, 8000)) == 1
    vehicle.mav.attitude_quaternion_send(8010, 2.0, 0.0, 0.0, 0.0, 0, 0, 0)
    vehicle.mav.attitude_quaternion_send(8020, math.nan, 0.0, 0.0, 0.0, 0, 0, 0)
    vehicle.attitude(11000, roll=math.nan)
    assert fed(session, vehicle, 11000) == []
    lost = session.losses().as_dict()
    assert lost["imu_not_unit"] == 1 and lost["imu_nan"] == 2


def test_odometry_in_both_frames_and_its_refusals():
    session, vehicle = settled()
    vehicle.odometry(5100)
    (o,) = fed(session, vehicle, 5100)
    assert (
        o.p_map_body.tolist() == [2.0, 1.0, 3.0]
        and o.v_body.tolist() == [4.0, -5.0, -6.0]
        and o.C_pose is None
    )
    np.testing.assert_allclose(o.omega_body, [0.1, -0.2, -0.3], rtol=1e-6)
    upper = np.zeros((6, 6))
    np.fill_diagonal(upper, [1, 2, 3, 4e-4, 5e-4, 6e-4])
    vehicle.odometry(5200, frame_id=20, pose_covariance=upper[np.triu_indices(6)].tolist())
    (o,) = fed(session, vehicle, 5200)
    assert o.p_map_body.tolist() == [1.0, -2.0, 3.0] and np.abs(o.q_map_body).tolist() == [
        0,
        0,
        0,
        1,
    ]
    np.testing.assert_allclose(np.diag(o.C_pose), [1, 2, 3, 4e-4, 5e-4, 6e-4], rtol=1e-6)
    vehicle.odometry(5300, reset_counter=1)
    assert len(fed(session, vehicle, 5300)) == 1
    bad = (
        {"frame_id": 0},
        {"child_frame_id": 1},
        {"quality": -1},
        {"q": [0.0] * 4},
        {"x": math.inf},
        {"pose_covariance": [-1.0] * 21},
    )
    for i, changes in enumerate(bad):
        vehicle.odometry(5400 + i, reset_counter=1, **changes)
    assert fed(session, vehicle, 5500) == []
    assert session.losses().as_dict() == {
        "odometry_frame": 2,
        "odometry_failed": 1,
        "odometry_not_unit": 1,
        "odometry_nan": 1,
        "odometry_covariance": 1,
        "odometry_estimator_reset": 1,
    }


def test_raw_inertial_data_in_its_units():
    session, vehicle = settled()
    vehicle.mav.highres_imu_send(
        5_100_000, 1.0, 2.0, -9.8, 0.1, 0.2, 0.3, 0, 0, 0, 0, 0, 0, 0, 0x3F
    )
    vehicle.mav.raw_imu_send(5_150_000, 100, 200, -1000, 10, 20, 30, 0, 0, 0)
    vehicle.mav.highres_imu_send(
        5_200_000, 1.0, 2.0, -9.8, 0.1, 0.2, 0.3, 0, 0, 0, 0, 0, 0, 0, 0x07
    )
    a, b = fed(session, vehicle, 5200)
    np.testing.assert_allclose(a.acceleration_body, [1.0, -2.0, 9.8], rtol=1e-6)
    np.testing.assert_allclose(b.acceleration_body, [0.980665, -1.96133, 9.80665])
    np.testing.assert_allclose(b.omega_body, [0.01, -0.02, -0.03])
    vehicle.heartbeat(dialect.MAV_AUTOPILOT_PX4)
    vehicle.mav.raw_imu_send(5_250_000, 100, 200, -1000, 10, 20, 30, 0, 0, 0)
    assert fed(session, vehicle, 5250) == []
    assert session.losses().as_dict() == {"inertial_incomplete": 1, "inertial_unscaled": 1}


def test_before_the_clocks_agree_nothing_is_stamped():
    session, vehicle = MavlinkSession(MavlinkParameters()), Vehicle()
    vehicle.attitude(1000)
    vehicle.gps(1000)
    vehicle.odometry(1000)
    assert fed(session, vehicle, 1000) == []
    assert session.losses().as_dict() == {
        "fix_clock_unsettled": 1,
        "imu_clock_unsettled": 1,
        "odometry_clock_unsettled": 1,
    }


def test_a_restart_is_told_from_late_packets():
    session, vehicle = settled()
    for ms in range(5100, 9000, 100):
        vehicle.attitude(ms)
        fed(session, vehicle, ms)
    vehicle.attitude(6000)  # one packet that took another way
    fed(session, vehicle, 9000)
    assert session.decoder.restarts == 0 and session.losses()["mavlink_message_late"] == 1
    boot = Vehicle()
    records = []
    for ms in range(0, 5000, 100):
        boot.attitude(200 + ms)
        records += fed(session, boot, 10_000 + ms)
    assert session.decoder.restarts == 1 and session.losses()["mavlink_restart"] == 1
    # the clocks are compared anew, and the stamps go on in the receiver's time
    assert (
        abs(records[-1].t_ns - (START + 14_900 * 10**6)) < 10**7
        and records[0].t_ns > START + 12 * S
    )
    assert session.losses()["mavlink_packet_late"] < 20


def test_heartbeat_loss_other_senders_and_gaps_are_counted():
    session, vehicle = settled()
    stranger, other = Vehicle(system=255, component=190), Vehicle(component=100)
    stranger.heartbeat()
    other.heartbeat()
    for frame in stranger.take() + other.take():
        session.feed(frame, START + 5 * S)
    for _ in range(5):
        vehicle.attitude(5100)
    frames = vehicle.take()
    session.feed(frames[0] + frames[3] + frames[4] + frames[4], START + 5100 * 10**6)
    assert session.alive
    session.due(START + 9 * S)
    assert not session.alive
    assert session.losses().as_dict() == {
        "mavlink_other_sender": 2,
        "mavlink_packet_lost": 2,
        "mavlink_packet_twice": 1,
        "mavlink_heartbeat_lost": 1,
    }
    vehicle.heartbeat()
    fed(session, vehicle, 9500)
    assert session.alive


def test_any_system_means_the_first_autopilot():
    session, one_vehicle, other = (
        MavlinkSession(MavlinkParameters(system=0)),
        Vehicle(system=7),
        Vehicle(system=8),
    )
    one_vehicle.heartbeat()
    other.heartbeat()
    for frame in one_vehicle.take() + other.take():
        session.feed(frame, START)
    assert session.decoder.system == 7 and session.losses().as_dict() == {"mavlink_other_sender": 1}


def sent(data):
    parser = dialect.MAVLink(None)
    parser.robust_parsing = True
    return parser.parse_buffer(data) or []


def test_rates_are_asked_for_until_they_come():
    session, vehicle = settled(attitude_hz=50.0, imu_hz=200.0)
    asked = [m for m in sent(session.due(START + 5 * S)) if m.get_type() == "COMMAND_LONG"]
    assert {int(m.param1): m.param2 for m in asked} == {24: 1e5, 31: 2e4, 2: 1e6, 27: 5e3}
    assert all(m.command == 511 and (m.target_system, m.target_component) == (1, 1) for m in asked)
    vehicle.gps(5100)
    vehicle.heartbeat()
    vehicle.mav.command_ack_send(511, 0)
    vehicle.mav.command_ack_send(511, 3)
    fed(session, vehicle, 8000)
    assert [m.get_type() for m in sent(session.due(START + 8 * S))] == ["HEARTBEAT", "TIMESYNC"]
    again = [m for m in sent(session.due(START + 10 * S)) if m.get_type() == "COMMAND_LONG"]
    assert 24 not in {int(m.param1) for m in again} and 31 in {int(m.param1) for m in again}
    assert session.losses().as_dict() == {"mavlink_rate_refused": 1}


# noise
# --------------------------------------------------------------------------------------------------
def stream_of(n, seed=1):
    vehicle = Vehicle()
    r = random.Random(seed)
    for i in range(n):
        (vehicle.attitude if r.random() < 0.7 else vehicle.gps)(1000 + 20 * i)
    return vehicle.take()


def test_noise_between_packets_is_counted_and_costs_no_packet():
    r, frames = random.Random(4), stream_of(400)
    session, noise = MavlinkSession(MavlinkParameters()), 0
    for frame in frames:
        junk = bytes(
            r.choice([0x00, 0x55, 0xFE, 0xFD, r.randrange(256)]) for _ in range(r.randrange(12))
        )
        noise += len(junk)
        session.feed(junk + frame, START)
    session.feed(b"\x00" * 300, START)  # push out what a false marker still waits for
    assert (
        session.stream.packets == len(frames)
        and "mavlink_packet_lost" not in session.losses().as_dict()
    )
    assert abs(session.losses()["mavlink_noise_byte"] - noise - 300) <= 300


def test_bytes_in_any_portions_give_the_same_packets_and_the_buffer_stays_small():
    data, r = b"".join(stream_of(300)), random.Random(2)
    session, at = MavlinkSession(MavlinkParameters()), 0
    while at < len(data):
        n = r.randrange(1, 40)
        session.feed(data[at : at + n], START)
        at += n
        assert len(session.stream.incoming.buf) < 600
    assert session.stream.packets == 300


def test_five_thousand_mutated_packets_crash_nothing_and_noise_is_counted():
    frames, r = stream_of(200), random.Random(6)
    session = MavlinkSession(MavlinkParameters())
    for i in range(5000):
        data = bytearray(r.choice(frames))
        for _ in range(r.randrange(1, 6)):
            data[r.randrange(len(data))] = r.randrange(256)
        session.feed(bytes(data[: r.randrange(len(data) + 1)]), START + i * 10**7)
    assert (
        session.losses()["mavlink_noise_byte"] > 1000
        and session.losses()["mavlink_parser_error"] == 0
    )


class Booked(MavlinkStream):
    """Counts the bytes of what is taken for a message."""

    taken = 0

    def is_noise(self, message):
        unknown = self.losses["mavlink_unknown_message"]
        noise = super().is_noise(message)
        if not noise or self.losses["mavlink_unknown_message"] > unknown:
            self.taken += len(message.get_msgbuf())
        return noise


@pytest.mark.parametrize("seed", [1, 2])
def test_of_five_thousand_mutated_packets_every_byte_is_part_of_a_message_or_noise_or_waits(seed):
    frames, r, fed_bytes = stream_of(200, seed), random.Random(seed), 0
    stream = Booked(lambda system, component: True, 255, 190)
    for _ in range(5000):
        data = bytearray(r.choice(frames))
        for _ in range(r.randrange(6)):
            data[r.randrange(len(data))] = r.randrange(256)
        data = data[: r.randrange(len(data) + 1)] if r.random() < 0.2 else data
        stream.feed(bytes(data))
        fed_bytes += len(data)
        assert (
            stream.taken + stream.losses["mavlink_noise_byte"] + len(stream.incoming.buf)
            == fed_bytes
        )
    assert (
        stream.packets > 200
        and stream.losses["mavlink_noise_byte"] > 1000
        and stream.losses["mavlink_parser_error"] == 0
    )


def wild(r, cls, vehicle):
    """A message of a kind the decoder reads with any values its fields can hold."""
    values = {}
    for name, kind, array in zip(
        cls.fieldnames,
        cls.fieldtypes,
        [cls.array_lengths[cls.ordered_fieldnames.index(n)] for n in cls.fieldnames],
        strict=True,
    ):

        def value(kind=kind):
            if kind in ("float", "double"):
                return r.choice(
                    [0.0, 1.0, -1.0, math.nan, math.inf, -math.inf, 3e38, 1e-40, r.gauss(0, 1)]
                )
            bits = (
                {"8": 8, "1": 16, "3": 32, "6": 64}[kind.lstrip("uint_")[0]]
                if kind != "char"
                else 8
            )
            low, high = (
                (0, 2**bits - 1)
                if kind.startswith("uint")
                else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
            )
            return r.choice(
                [low, high, 0, 1, r.randrange(low, high + 1)]
                if low == 0
                else [low, high, 0, 1, -1, r.randrange(low, high + 1)]
            )

        values[name] = [value() for _ in range(array)] if array else value()
    vehicle.mav.send(cls(**values))


def test_five_thousand_wild_but_valid_messages_each_give_a_record_or_a_reason():
    session, vehicle = settled(roll_pitch_sigma_rad=0.01)
    r = random.Random(8)
    names = {
        "GPS_RAW_INT",
        "ATTITUDE",
        "ATTITUDE_QUATERNION",
        "ODOMETRY",
        "HIGHRES_IMU",
        "RAW_IMU",
        "SYSTEM_TIME",
        "TIMESYNC",
        "HEARTBEAT",
    }
    kinds = sorted(
        (c for c in dialect.mavlink_map.values() if c.msgname in names), key=lambda c: c.id
    )
    assert len(kinds) == len(names)
    records = 0
    silent = ("HEARTBEAT", "SYSTEM_TIME", "TIMESYNC")
    for i in range(5000):
        cls = r.choice(kinds)
        wild(r, cls, vehicle)
        before, repeated = session.losses().total(), session.decoder.repeated
        found = fed(session, vehicle, 5000 + i)
        for record in found:
            assert 0 <= record.t_ns < 2**31 * S
            if isinstance(record, Fix):
                assert abs(record.latitude_deg) <= 90 and (
                    record.C_enu is None or np.all(np.diag(record.C_enu) > 0)
                )
            if isinstance(record, ImuSample):
                assert np.linalg.norm(record.q_map_body) == pytest.approx(1.0)
            if isinstance(record, OdometrySample):
                assert record.C_pose is None or np.all(np.diag(record.C_pose) > 0)
        records += len(found)
        preferred = cls.msgname == "ATTITUDE"  # given way to the quaternion
        assert (
            found
            or session.losses().total() > before
            or session.decoder.repeated > repeated
            or cls.msgname in silent
            or preferred
        )
    assert records > 0


# logs
# --------------------------------------------------------------------------------------------------
def tlog(frames, path, noise=b""):
    path.write_bytes(
        b"".join(
            struct.pack(">Q", (START // 1000) + 20_000 * i) + f + noise
            for i, f in enumerate(frames)
        )
    )
    return path


def test_a_tlog_gives_its_frames_and_counts_what_is_between(tmp_path):
    frames = stream_of(50)
    losses = Losses()
    found = list(tlog_frames(tlog(frames, tmp_path / "a.tlog"), losses))
    assert (
        [f for _, f in found] == frames
        and [t for t, _ in found] == [START + 20_000_000 * i for i in range(50)]
        and not losses
    )
    found = list(tlog_frames(tlog(frames, tmp_path / "b.tlog", b"\xfejunk"), losses))
    assert [f for _, f in found] == frames and losses["mavlink_noise_byte"] == 250
    whole = (tmp_path / "a.tlog").read_bytes()
    for cut in (0, 5, 9, 30, len(whole) - 1):
        (tmp_path / "c.tlog").write_bytes(whole[:cut])
        assert len(list(tlog_frames(tmp_path / "c.tlog", Losses()))) <= 50
    r = random.Random(1)
    for _ in range(300):
        data = bytearray(whole)
        for _ in range(5):
            data[r.randrange(len(data))] = r.randrange(256)
        (tmp_path / "c.tlog").write_bytes(data)
        assert len(list(tlog_frames(tmp_path / "c.tlog", Losses()))) >= 30
    with pytest.raises(BagError):
        list(tlog_frames(tmp_path / "absent.tlog", losses))


def dataflash(latency=0.12, und=-44.0):
    """A small log: GPS and GPA at 5 Hz, ATT at 10 Hz; boot clock against GPS time by hand."""

    def fmt(number, name, letters, columns, size):
        return b"\xa3\x95\x80" + struct.pack(
            "<BB4s16s64s", number, size + 3, name, letters, columns
        )

    gps, gpa, att = (
        struct.Struct("<QBBIHBhLLef".replace("L", "i").replace("e", "i")),
        struct.Struct("<QBHHf"),
        struct.Struct("<Qhhh"),
    )
    out = fmt(128, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns", 86)
    out += fmt(
        130, b"GPS", b"QBBIHBcLLef", b"TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd", gps.size
    )
    out += fmt(131, b"GPA", b"QBCCf", b"TimeUS,I,HAcc,VAcc,Und", gpa.size)
    out += fmt(132, b"ATT", b"Qccc", b"TimeUS,Roll,Pitch,Yaw", att.size)
    for i in range(100):
        boot_us = 2_000_000 + 100_000 * i
        if i % 2 == 0:
            logged = boot_us + int(latency * 1e6) + (i % 6) * 3000
            for instance in (0, 1):
                out += b"\xa3\x95\x82" + gps.pack(
                    logged,
                    instance,
                    6,
                    100_000 * 1000 + 100 * i,
                    2300,
                    17,
                    80,
                    501234567,
                    141234567 + instance,
                    25_000,
                    0.0,
                )
                out += b"\xa3\x95\x83" + gpa.pack(logged, instance, 2, 3, und)
        out += b"\xa3\x95\x84" + att.pack(boot_us, 0, 0, 9000)
    return out


def test_a_dataflash_log_is_related_to_utc_by_its_fixes(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(dataflash())
    log = DataFlashLog(path, MavlinkParameters(gnss_delay_s=0.12))
    records = list(log.records())
    fixes, imus = (
        [r for r in records if isinstance(r, Fix)],
        [r for r in records if isinstance(r, ImuSample)],
    )
    epoch = (315_964_800 - 18 + 2300 * 604_800 + 100_000) * S
    assert [f.t_ns for f in fixes] == [
        epoch + 200_000_000 * i for i in range(50)
    ] and not log.losses
    assert fixes[0].height_m == 250.0 + 44.0 and fixes[0].status == 2
    np.testing.assert_allclose(np.diag(fixes[0].C_enu), [4e-4, 4e-4, 9e-4])
    assert len(imus) == 100 and all(
        abs(m.t_ns - epoch - 100_000_000 * i) < 2_000_000 for i, m in enumerate(imus)
    )
    np.testing.assert_allclose(np.abs(imus[0].q_map_body), [0, 0, 0, 1], atol=1e-9)
    second = [
        r
        for r in DataFlashLog(path, MavlinkParameters(position="GPS2_RAW")).records()
        if isinstance(r, Fix)
    ]
    assert len(second) == 50 and second[0].longitude_deg == pytest.approx(14.1234568)
    path.write_bytes(dataflash(und=0.0))
    log = DataFlashLog(path, MavlinkParameters(height="ellipsoidal"))
    assert not [r for r in log.records() if isinstance(r, Fix)] and log.losses.as_dict() == {
        "fix_no_ellipsoidal_height": 50
    }


def old_dataflash(week):
    """A log as ArduPilot wrote them before 2015: milliseconds, and GPS time of the week in GPS."""
    columns = b"Status,TimeMS,Week,NSats,HDop,Lat,Lng,RelAlt,Alt,Spd,GCrs,VZ,T"
    out = b""
    for number, name, letters, named, size in (
        (130, b"GPS", b"BIHBcLLeeEefI", columns, 42),
        (
            132,
            b"ATT",
            b"IccccCCCC",
            b"TimeMS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,ErrRP,ErrYaw",
            20,
        ),
    ):
        out += b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", number, size + 3, name, letters, named)
    for i in range(60):
        boot, place = 20_000 + 200 * i, (-353_633_000, 1_491_652_000 + i, 1000, 58_400)
        out += b"\xa3\x95\x82" + struct.pack(
            "<BIHBhiiiiIifI", 3, 100_000_000 + 200 * i, week, 9, 150, *place, 0, 0, 0.0, boot + 30
        )
        out += b"\xa3\x95\x84" + struct.pack("<IhhhhHHHH", boot, 0, 100, 0, 0, 0, 9000, 0, 0)
    return out


@pytest.mark.parametrize(("week", "leap"), [(1690, 15), (1840, 16), (1900, 17), (2300, 18)])
def test_an_old_dataflash_log_has_the_leap_seconds_of_its_day(tmp_path, week, leap):
    path = tmp_path / "old.bin"
    path.write_bytes(old_dataflash(week))
    log = DataFlashLog(path, MavlinkParameters(gnss_delay_s=0.03))
    records = list(log.records())
    fixes = [r for r in records if isinstance(r, Fix)]
    imus = [r for r in records if isinstance(r, ImuSample)]
    epoch = (315_964_800 - leap + week * 604_800 + 100_000) * S
    assert [f.t_ns - epoch for f in fixes] == [200_000_000 * i for i in range(60)]
    assert fixes[0].latitude_deg == pytest.approx(-35.3633) and fixes[0].height_m == 584.0
    assert [i.t_ns - epoch for i in imus] == pytest.approx([2e8 * i for i in range(60)], abs=2e6)
    assert not log.losses.as_dict()


def test_both_kinds_of_log_are_read_alike(tmp_path):
    vehicle = Vehicle()
    for ms in range(1000, 9000, 100):
        vehicle.gps(ms)
        vehicle.attitude(ms)
    frames = vehicle.take()
    path = tmp_path / "a.tlog"
    path.write_bytes(
        b"".join(
            struct.pack(">Q", START // 1000 + 1_000_000 + 50_000 * i) + f
            for i, f in enumerate(frames)
        )
        + b"\x00"
    )
    log = MavlinkLog(path, MavlinkParameters())
    kinds = [type(r) for r in log.records()]
    assert (kinds.count(Fix), kinds.count(ImuSample)) == (
        59,
        60,
    )  # the first two seconds compare the clocks
    assert log.losses().as_dict() == {
        "fix_clock_unsettled": 21,
        "imu_clock_unsettled": 20,
        "mavlink_noise_byte": 1,
    }
    (tmp_path / "a.BIN").write_bytes(dataflash())
    log = MavlinkLog(tmp_path / "a.BIN", MavlinkParameters())
    assert (
        len(list(log.records())) == 150
        and not log.losses()
        and log.status()["clock"] == "UTC by GPS time"
        and len(log.digest()) == 64
    )


def test_damaged_dataflash_logs_never_crash_and_always_end(tmp_path):
    whole, r, path = dataflash(), random.Random(3), tmp_path / "a.bin"
    read = 0
    for i in range(120):
        data = bytearray(whole[: r.randrange(len(whole))] if i % 3 == 0 else whole)
        for _ in range(r.randrange(12)):
            if data:
                data[r.randrange(min(len(data), 500 if i % 2 else len(data)))] = r.randrange(256)
        path.write_bytes(data)
        try:
            read += len(list(DataFlashLog(path, MavlinkParameters()).records()))
        except BagError as error:
            assert error.reason == "bag_clock"
    assert read > 2000
    for name, content in (("absent.bin", None), ("empty.bin", b""), ("notes.txt", b"hello")):
        if content is not None:
            (tmp_path / name).write_bytes(content)
        with pytest.raises(BagError):
            MavlinkLog(tmp_path / name, MavlinkParameters())


@pytest.mark.skipif(not LOGS.is_dir(), reason=f"no autopilot logs at {LOGS}")
def test_the_real_tlog():
    losses = Losses()
    for clock, jitter in (("utc", 5e-3), ("ros", 2.0)):
        session = MavlinkSession(
            MavlinkParameters(height="msl", geoid_undulation_m=19.0, clock=clock)
        )
        records = [
            r for t, f in tlog_frames(LOGS / "vtol.tlog", losses) for r in session.feed(f, t)
        ]
        fixes, imus = (
            [r for r in records if isinstance(r, Fix)],
            [r for r in records if isinstance(r, ImuSample)],
        )
        assert (
            session.stream.packets == 23894 and len(imus) > 860 and len(fixes) > 780 and not losses
        )
        assert all(f.C_enu is None for f in fixes) and {f.status for f in fixes} <= set(
            STATUS.values()
        )  # it sends no accuracies
        east = [
            (f.longitude_deg - fixes[0].longitude_deg)
            * math.cos(math.radians(fixes[0].latitude_deg))
            * 111_320
            for f in fixes
        ]
        assert 100 < max(east) - min(east) < 5000 and all(550 < f.height_m < 800 for f in fixes)
        # nothing is silent: every attitude and fix that came is a record or has a reason
        seen, lost = session.decoder.counts, session.losses().as_dict()
        late = lost.get("mavlink_message_late", 0)
        assert len(imus) + lost["imu_clock_unsettled"] + late >= seen["ATTITUDE"] >= len(imus)
        assert (
            len(fixes) + lost["fix_clock_unsettled"] + session.decoder.repeated
            == seen["GPS_RAW_INT"]
        )
        assert (
            lost["mavlink_packet_lost"] > 500
            and "mavlink_restart" not in lost
            and "mavlink_noise_byte" not in lost
        )
        assert session.decoder.clock.line.sigma_ns * 1e-9 < jitter


@pytest.mark.skipif(not LOGS.is_dir(), reason=f"no autopilot logs at {LOGS}")
def test_the_real_truncated_dataflash_log():
    log = DataFlashLog(LOGS / "test.BIN", MavlinkParameters(height="msl", geoid_undulation_m=19.0))
    records = list(log.records())
    kinds = [type(r).__name__ for r in records]
    assert (kinds.count("Fix"), kinds.count("ImuSample"), kinds.count("InertialSample")) == (
        5,
        24,
        45,
    )
    assert log.losses["mavlink_noise_byte"] < 100  # the torn message at its end
    assert all(abs(r.t_ns - records[0].t_ns) < 5 * S for r in records)
    up = [r.acceleration_body[2] for r in records if type(r).__name__ == "InertialSample"]
    assert 9 < np.mean(up) < 10.5  # specific force of a vehicle at rest points up


# links
# --------------------------------------------------------------------------------------------------
def test_urls_are_read_or_refused():
    for url in (
        "udpin:127.0.0.1",
        "carrier:pigeon:1",
        "udpin:127.0.0.1:70000",
        "",
        "serial:/dev/null:12345",
    ):
        with pytest.raises(ConfigurationError):
            open_link(url)
    assert (
        log_file("file:/a/b.tlog") == Path("/a/b.tlog")
        and log_file("x.BIN") == Path("x.BIN")
        and log_file("udpin:1.2.3.4:5") is None
    )
    link = open_link("udpin::0")  # no host: loopback, and nothing else
    assert link.address[0] == "127.0.0.1"
    link.close()
    with pytest.raises(ConfigurationError):  # no address of this computer
        open_link("udpin:203.0.113.9:14550")


def test_a_busy_port_is_tried_again_and_counted(monkeypatch):
    monkeypatch.setattr("ladar_volume.io.mavlink.mavlink_links.RETRY_S", 0.05)
    other = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    other.bind(("127.0.0.1", 0))
    port = other.getsockname()[1]
    link = UdpLink(("127.0.0.1", port), True)
    assert link.read(0.01) == b"" and link.losses["mavlink_port_not_open"] >= 1
    other.close()
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    for _ in range(100):
        sender.sendto(b"here", ("127.0.0.1", port))
        if link.read(0.02) == b"here":
            break
    else:
        pytest.fail("the port was free and not opened")
    sender.close()
    link.close()


def test_udp_listens_to_one_peer_at_a_time():
    link = UdpLink(("127.0.0.1", 0), True)
    one_peer, other = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    link.write(b"nobody there")
    one_peer.sendto(b"first", link.address)
    assert link.read(1.0) == b"first"
    other.sendto(b"second", link.address)
    one_peer.sendto(b"third", link.address)
    assert link.read(1.0) + link.read(0.1) == b"third" and link.losses["mavlink_other_peer"] == 1
    link.write(b"answer")
    one_peer.settimeout(1.0)
    assert one_peer.recv(100) == b"answer" and link.read(0.0) == b""
    for end in (link, one_peer, other):
        end.close()


def test_a_stranger_takes_no_silent_peers_place():
    lost = Losses()
    peers, first, again, stranger = Peers(lost), ("10.0.0.5", 1), ("10.0.0.5", 2), ("10.0.0.9", 1)
    assert peers.admits(first, 0.0)
    assert not peers.admits(again, 1.0) and not peers.admits(stranger, 1.0)
    assert not peers.admits(stranger, 60.0)  # however long it waits
    assert peers.admits(again, 60.0)  # the autopilot started again
    assert peers.admits(first, 60.1) and peers.now == first  # the first is back, at once
    assert not peers.admits(again, 60.2)
    assert lost.as_dict() == {"mavlink_other_peer": 4, "mavlink_peer_changed": 2}
    server = TcpLink(("127.0.0.1", 0), True)
    server.host = "10.0.0.5"
    client = socket.create_connection(server.address)
    assert server.read(1.0) == b"" and server.losses["mavlink_other_peer"] == 1
    assert client.recv(10) == b""  # closed
    server.forget()
    other = socket.create_connection(server.address)
    other.send(b"ping")
    assert server.read(1.0) + server.read(1.0) == b"ping"
    for end in (server, client, other):
        end.close()


@pytest.mark.parametrize(
    "url",
    ["udpin:256.1.1.1:5", "tcpin:a..b:5", "udpout:a\0b:5", "udpin:h:²", "udpin:h:" + "9" * 5000],
)
def test_a_bad_address_is_refused_in_a_short_line(url):
    with pytest.raises(ConfigurationError) as refused:
        open_link(url)
    assert len(str(refused.value)) < 200


def test_tcp_both_ways_and_again_after_a_break():
    server = TcpLink(("127.0.0.1", 0), True)
    client = TcpLink(server.address, False)
    for _ in range(2):
        client.next_attempt = 0.0
        for _ in range(20):
            client.read(0.01), server.read(0.01)
            client.write(b"ping")
            if data := server.read(0.05):
                break
        assert data.startswith(b"ping")
        server.write(b"pong")
        assert client.read(1.0) == b"pong"
        server.drop()
        assert client.read(1.0) == b""
    assert client.losses["mavlink_link_lost"] == 2
    server.close()
    client.close()


def test_a_serial_port():
    try:
        ours, theirs = os.openpty()
    except OSError as error:  # a minimal root has no /dev/pts
        pytest.skip(f"there is no pseudo terminal here: {error}")
    link = SerialLink(os.ttyname(theirs), 57600)
    os.write(ours, bytes(range(256)))
    data = b""
    while len(data) < 256:
        data += link.read(0.5)
    assert data == bytes(range(256))  # raw: no newline, no control character is touched
    link.write(b"\r\n\x03")
    assert os.read(ours, 10) == b"\r\n\x03"
    os.close(ours)
    os.close(theirs)
    assert link.read(0.1) == b"" and link.losses["mavlink_link_lost"] == 1
    link.close()
    absent = SerialLink("/dev/absent", 57600)
    assert absent.read(0.0) == b"" and absent.losses["mavlink_port_not_open"] == 1
    with pytest.raises(ConfigurationError, match="baud"):
        SerialLink("/dev/absent", 123)


class Peer(threading.Thread):
    """A real pymavlink autopilot over UDP: answers TIMESYNC, obeys rates; its clock began some time
    ago.
    """

    def __init__(self, address):
        super().__init__(daemon=True)
        self.link = mavutil.mavlink_connection(
            f"udpout:{address[0]}:{address[1]}", source_system=1, source_component=1
        )
        self.boot = time.time_ns() - 100 * S
        self.rates, self.stop = {}, threading.Event()

    def run(self):
        last, last_beat, mav = 0.0, 0.0, self.link.mav
        while not self.stop.wait(0.002):
            now = time.time_ns() - self.boot
            if time.monotonic() - last_beat > 0.2:
                last_beat = time.monotonic()
                mav.heartbeat_send(2, 3, 0, 0, 4)
                mav.system_time_send(time.time_ns() // 1000, now // 10**6)
            if self.rates.get(31) and time.monotonic() - last > self.rates[31]:
                last = time.monotonic()
                mav.attitude_quaternion_send(now // 10**6, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
            while (m := self.link.recv_match(blocking=False)) is not None:
                if m.get_type() == "TIMESYNC" and m.tc1 == 0:
                    mav.timesync_send(time.time_ns() - self.boot, m.ts1)
                if m.get_type() == "COMMAND_LONG" and m.command == 511:
                    self.rates[int(m.param1)] = m.param2 * 1e-6
                    mav.command_ack_send(511, 0)
        self.link.close()


def test_a_real_peer_over_udp_is_asked_answers_and_is_timed():
    link = open_link("udpin:127.0.0.1:0")
    session = MavlinkSession(MavlinkParameters(clock_settle_s=1.0, link_delay_sigma_s=0.001))
    peer = Peer(link.address)
    peer.start()
    try:
        records, deadline = [], time.monotonic() + 60.0
        while time.monotonic() < deadline and not (
            session.decoder.round_trips.ready and len(records) > 30
        ):
            records += session.feed(link.read(0.02), time.time_ns())
            link.write(session.due(time.time_ns()))
        assert (
            session.decoder.round_trips.ready
            and session.status()["clock"] == "round trips of TIMESYNC"
        )
        line = session.decoder.clock.line
        error = line.offset(time.time_ns() - peer.boot) - peer.boot
        assert abs(error) < 5 * line.sigma_ns + 10**6 and line.sigma_ns < 5e7
        assert peer.rates[31] == pytest.approx(0.01) and len(records) > 30
        assert all(b.t_ns > a.t_ns for a, b in itertools.pairwise(records))
        assert session.losses().total("mavlink") == 0
    finally:
        peer.stop.set()
        peer.join()
        link.close()
