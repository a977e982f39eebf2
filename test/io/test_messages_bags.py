"""Fixes, attitudes and recordings: what is bad is refused by name."""

import os
import re
from pathlib import Path
from types import SimpleNamespace as Message

import numpy as np
import pytest

from ladar_volume.io.bags import TYPESTORE, BagReader, BagWriter
from ladar_volume.io.mcap_log import McapLog
from ladar_volume.io.results import output_folder
from ladar_volume.io.sensor_messages import (
    fix_from_message,
    imu_from_message,
    odometry_from_message,
)
from ladar_volume.model.errors import AttitudeError, BagError, FixError, OutputError
from ladar_volume.model.parameters import LoggerParameters

REPO = Path(__file__).parents[2]
SHARED = Path(os.environ.get("LADAR_SHARED_DATA", REPO.parent / "shared" / "data"))
STAMP = Message(stamp=Message(sec=1, nanosec=5))


def fix(**changes):
    m = Message(
        header=STAMP,
        status=Message(status=2),
        latitude=50.0,
        longitude=14.0,
        altitude=200.0,
        position_covariance=np.diag([1e-4, 1e-4, 4e-4]).ravel(),
        position_covariance_type=2,
    )
    vars(m).update(changes)
    return m


def imu(**changes):
    m = Message(
        header=STAMP,
        orientation=Message(x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=np.diag([1e-6] * 3).ravel(),
        angular_velocity=Message(x=0.0, y=0.0, z=0.1),
        angular_velocity_covariance=np.zeros(9),
    )
    vars(m).update(changes)
    return m


def test_good_samples_are_read_whole():
    assert fix_from_message(fix()).t_ns == 1_000_000_005
    np.testing.assert_allclose(np.diag(fix_from_message(fix()).C_enu), [1e-4, 1e-4, 4e-4])
    assert imu_from_message(imu()).omega_body.tolist() == [0.0, 0.0, 0.1]


@pytest.mark.parametrize(
    ("linear", "angular", "known"), [(0.0, 0.0, False), (0.4, 0.0, True), (0.0, 0.3, True)]
)
def test_a_twist_of_zeros_alone_has_no_known_rates(linear, angular, known):
    def vector(x):
        return Message(x=x, y=0.0, z=0.0)

    place = Message(position=vector(1.0), orientation=Message(x=0.0, y=0.0, z=0.0, w=1.0))
    found = odometry_from_message(
        Message(
            header=Message(stamp=Message(sec=7, nanosec=0), frame_id="odom"),
            pose=Message(pose=place, covariance=np.eye(6).ravel()),
            twist=Message(twist=Message(linear=vector(linear), angular=vector(angular))),
        )
    )
    wanted = [angular, 0.0, 0.0] if known else [np.nan] * 3
    np.testing.assert_array_equal(found.omega_body, wanted)


def test_unknown_covariance_is_none_and_never_zero():
    assert fix_from_message(fix(position_covariance_type=0)).C_enu is None
    assert fix_from_message(fix(position_covariance=np.zeros(9))).C_enu is None
    assert imu_from_message(imu(orientation_covariance=np.zeros(9))).C_axes is None


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"status": Message(status=-1)}, "fix_no_fix"),
        ({"latitude": float("nan")}, "fix_nan"),
        ({"latitude": 95.0}, "fix_range"),
        ({"position_covariance": -np.eye(3).ravel()}, "fix_covariance"),
    ],
)
def test_bad_fixes_are_refused_by_name(changes, reason):
    with pytest.raises(FixError) as caught:
        fix_from_message(fix(**changes))
    assert caught.value.reason == reason


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"orientation_covariance": np.array([-1.0] + [0.0] * 8)}, "imu_no_orientation"),
        ({"orientation": Message(x=0.0, y=0.0, z=0.0, w=2.0)}, "imu_not_unit"),
        ({"orientation": Message(x=float("nan"), y=0.0, z=0.0, w=1.0)}, "imu_nan"),
    ],
)
def test_bad_attitudes_are_refused_by_name(changes, reason):
    with pytest.raises(AttitudeError) as caught:
        imu_from_message(imu(**changes))
    assert caught.value.reason == reason


def text(words):
    return TYPESTORE.types["std_msgs/msg/String"](data=words)


def test_recordings_round_trip_and_a_topic_of_the_wrong_kind_is_named(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        for i in range(10):
            bag.write("chat", text(f"line {i}"), i * 10**9)
    with BagReader(tmp_path / "bag") as bag:
        assert bag.topics() == {
            "chat": ("std_msgs/msg/String", 10)
        } and bag.duration_s == pytest.approx(9.0)
        assert [bag.message(r).data for r in bag.raw()] == [f"line {i}" for i in range(10)]
        with pytest.raises(BagError, match="no topic for cloud"):
            bag.require(bag.roles(), "gnss_imu")
        with pytest.raises(BagError, match="no topic 'chat' of type"):
            bag.roles({"cloud": "chat"})
    (single,) = (tmp_path / "bag").glob("*.mcap")
    with BagReader(single) as bag:
        assert bag.topics()["chat"][1] == 10
    with pytest.raises(OutputError, match="exists already"):
        BagWriter(tmp_path / "bag")


@pytest.mark.parametrize("key", ["message_count", "nanoseconds", "nanoseconds_since_epoch"])
@pytest.mark.parametrize("word", ["'12x'", "null", "1.5", "[]"])
def test_a_number_of_the_metadata_that_is_none_is_refused(tmp_path, key, word):
    with BagWriter(tmp_path / "bag") as bag:
        bag.write("chat", text("line"), 10**9)
    metadata = tmp_path / "bag" / "metadata.yaml"
    lines = re.sub(rf"\b{key}: \d+", f"{key}: {word}", metadata.read_text())
    assert lines != metadata.read_text()
    metadata.write_text(lines)
    with pytest.raises(BagError, match="damaged or not a recording") as caught:
        BagReader(tmp_path / "bag")
    assert caught.value.reason == "bag_format"


def test_what_is_no_recording_is_refused(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "noise.mcap").write_bytes(b"not a recording at all" * 100)
    (tmp_path / "noise.bag").write_bytes(b"#ROSBAG V2.0\n" + b"\0" * 50)
    whole = (REPO / "bags" / "leo_cut" / "leo_cut.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 3])
    for name in ("absent", "empty", "noise.mcap", "noise.bag", "cut.mcap"):
        with pytest.raises(BagError) as caught:
            BagReader(tmp_path / name)
        assert name in str(caught.value)


@pytest.mark.skipif(not SHARED.is_dir(), reason=f"no shared recordings at {SHARED}")
def test_the_odd_recordings():
    odd = SHARED / "odd_bags"
    for storage in ("mcap", "sqlite3"):  # split over five files
        with BagReader(odd / f"rosbag2_py/test/resources/{storage}/wbag") as bag:
            assert sum(1 for _ in bag.raw()) == sum(n for _, n in bag.topics().values()) > 3000
    # its topic table does not fit its messages: saying nothing would lose all of them in silence
    with (
        BagReader(odd / "rosbag2_py/test/resources/sqlite3/talker") as bag,
        pytest.raises(BagError, match="20 announced messages"),
    ):
        list(bag.raw())
    with pytest.raises(BagError, match="holds no message"):
        BagReader(odd / "ros2bag/test/resources/empty_bag")
    with pytest.raises(BagError, match="wrong_format"):
        BagReader(odd / "rosbag2_tests/resources/mcap/wrong_rmw_test")
    with BagReader(SHARED / "husky_gnss_imu" / "test1.bag") as bag:
        assert bag.roles()["fix"] == "fix" and bag.topics()["imu/data"][1] == 11865


def test_unwritable_output_is_an_error_not_a_traceback(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("")
    for action in (
        lambda: BagWriter(blocked / "bag"),
        lambda: output_folder(blocked / "out"),
        lambda: McapLog(LoggerParameters(), blocked / "a.mcap"),
    ):
        with pytest.raises(OutputError):
            action()
