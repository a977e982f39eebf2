"""A volume whose poses come from an autopilot's log instead of the recording."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as dialect
from scipy.spatial.transform import Rotation

from ladar_volume.cli.main import main
from ladar_volume.io.bags import BagReader
from ladar_volume.io.cloud_messages import stamp_ns
from ladar_volume.replay import Replay

BAG = Path(__file__).parents[2] / "bags" / "stockpile"
SECONDS = 14.0


def tlog_of(bag_path, path):
    """The recording's fixes and attitudes as an autopilot would have sent them: whole units, single
    precision, boot time.
    """
    frames = []

    class Wire:
        @staticmethod
        def write(data):
            frames.append(struct.pack(">Q", now // 1000) + bytes(data))

    mav = dialect.MAVLink(Wire, srcSystem=1, srcComponent=1)
    ned, frd = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]]), np.diag([1, -1, -1])
    with BagReader(bag_path) as bag:
        boot = bag.start_ns - 100 * 10**9
        for i in range(30):
            now = bag.start_ns - 3 * 10**9 + i * 10**8
            mav.system_time_send(now // 1000, (now - boot) // 10**6)
        for raw in bag.raw({"gnss/fix", "imu/data"}):
            m, now = bag.message(raw), raw.t_ns
            t = stamp_ns(m) - boot
            if raw.topic == "gnss/fix":
                h, v = np.sqrt(m.position_covariance[[0, 8]]) * 1e3
                lat, lon, up = (
                    round(m.latitude * 1e7),
                    round(m.longitude * 1e7),
                    round(m.altitude * 1e3),
                )
                mav.gps_raw_int_send(
                    t // 1000,
                    6,
                    lat,
                    lon,
                    up - 45_000,
                    80,
                    90,
                    0,
                    0,
                    17,
                    up,
                    round(h),
                    round(v),
                    0,
                    0,
                    0,
                )
            else:
                q = m.orientation
                R = ned @ Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix() @ frd
                x, y, z, w = Rotation.from_matrix(R).as_quat()
                a = m.angular_velocity
                mav.attitude_quaternion_send(t // 10**6, w, x, y, z, a.x, -a.y, -a.z)
    path.write_bytes(b"".join(frames))


def test_poses_of_a_tlog_give_the_recordings_volume(tmp_path, capsys):
    tlog_of(BAG, tmp_path / "flight.tlog")

    def replayed(*words):
        coarse = ["--set", "filter.radius_m=1.0", "--set", "filter.trials=10"]
        common = [
            "--json",
            "--no-figure",
            "--duration",
            str(SECONDS),
            "-o",
            str(tmp_path / "out"),
            *coarse,
        ]
        assert main(["replay", str(BAG), *common, *words]) == 0
        return json.loads(capsys.readouterr().out)

    sigmas = [
        "--set",
        "mavlink.roll_pitch_sigma_deg=0.02",
        "--set",
        "mavlink.heading_sigma_deg=0.05",
    ]
    own, logged = replayed(), replayed("--poses", str(tmp_path / "flight.tlog"), *sigmas)
    # the log's latitudes are whole 1e-7 degrees, 11 mm: a little noise, and nothing else
    assert abs(logged["volume_m3"] - own["volume_m3"]) < 0.3 * own["sigma_m3"]
    # the ground's roughness and what is read of it are told from the mapped ground, which has that
    # noise too
    of_ground = ("base_surface", "base_model", "vegetation", "unseen")
    rest = [
        f["sigma_m3"] ** 2 - sum(f["budget_m6"].get(name, 0.0) for name in of_ground)
        for f in (logged, own)
    ]
    assert rest[0] ** 0.5 == pytest.approx(rest[1] ** 0.5, rel=0.05)
    assert logged["points"]["mapped"] > 0.95 * own["points"]["mapped"]
    assert logged["input"]["poses"] == "flight.tlog" and len(logged["input"]["poses_sha256"]) == 64
    assert not [k for k in logged["losses"] if k.startswith(("fix", "imu", "mavlink"))]


def test_a_missing_or_foreign_log_is_an_error_in_one_line(tmp_path, capsys):
    (tmp_path / "notes.txt").write_text("hello")
    for name in ("absent.tlog", "notes.txt"):
        assert (
            main(["replay", str(BAG), "--poses", str(tmp_path / name), "-o", str(tmp_path / "out")])
            == 2
        )
        assert name in capsys.readouterr().err


@pytest.mark.parametrize("ellipsoidal", [True, False])
def test_heights_above_the_sea_and_a_datum_above_the_ellipsoid_are_doubted(ellipsoidal):
    from types import SimpleNamespace

    from ladar_volume.model.parameters import Parameters

    log = SimpleNamespace(ellipsoidal=ellipsoidal)
    for base, doubted in (("level", not ellipsoidal), ("ground", False)):
        sections = {"volume": {"base": base}, "georeference": {"datum_height_m": 80.0}}
        some = SimpleNamespace(poses=log, parameters=Parameters.read(sections))
        assert bool(Replay.height_doubts(some).doubts) == doubted
