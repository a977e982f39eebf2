"""A log that lacks what the nodes had heard live says so when it is replayed."""

import pytest

from ladar_volume.io.bags import TYPESTORE, BagReader, BagWriter
from ladar_volume.io.logs.heard_live import (
    absent_words,
    heard_and_logged,
    in_words,
    missing_messages,
    more_than_live,
)
from ladar_volume.model.errors import BagError
from ladar_volume.model.parameters import Parameters
from ladar_volume.replay import Replay

T = TYPESTORE.types
NANO = 10**9


def report(t_ns, **received):
    """Diagnostics of nodes by name (``__`` for a slash), with the counts of each."""
    status = []
    for name, counts in received.items():
        lines = {f"received_{role}": n for role, n in counts.items()} | {"clock_state": "steady"}
        values = [T["diagnostic_msgs/msg/KeyValue"](k, str(v)) for k, v in lines.items()]
        kind = T["diagnostic_msgs/msg/DiagnosticStatus"]
        status.append(kind(0, name.replace("__", "/"), "good", "rover", values))
    stamp = T["builtin_interfaces/msg/Time"](*divmod(t_ns, NANO))
    header = T["std_msgs/msg/Header"](stamp=stamp, frame_id="")
    return T["diagnostic_msgs/msg/DiagnosticArray"](header, status)


def log(path, reports, topics):
    """A log with so many (empty) messages of each topic, and the reports."""
    with BagWriter(path) as bag:
        for k, message in enumerate(reports):
            bag.write("diagnostics", message, k * NANO)
        for topic, (kind, count) in topics.items():
            for k in range(count):
                bag.write_raw(topic, kind, bytes(4), k * NANO)
    return path


CLOUD, IMU = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/Imu"
TOPICS = {"cloud": "velodyne_points", "imu": "imu/data"}


@pytest.mark.parametrize(("clouds", "imus"), [(10, 100), (12, 100), (7, 95)])
def test_a_log_is_compared_with_the_last_report_of_the_node_that_heard(tmp_path, clouds, imus):
    reports = [
        report(0, georeference_node={"cloud": 3, "imu": 30}, filter_node={"cloud": 999}),
        report(NANO, georeference_node={"cloud": 10, "imu": 100}),
    ]
    path = log(
        tmp_path / "log", reports, {"velodyne_points": (CLOUD, clouds), "imu/data": (IMU, imus)}
    )
    with BagReader(path) as bag:
        counted = heard_and_logged(bag, TOPICS)
    found, more = missing_messages(counted), more_than_live(counted)
    if clouds < 10:
        (doubt,) = found.doubts
        assert "3 of 10 clouds and 5 of 100 attitudes" in doubt.text and doubt.value == 5.0
    else:
        assert found.sound
    assert more == ({"cloud": 2} if clouds == 12 else {})
    assert in_words({"cloud": 2, "imu": 5}) == "2 clouds and 5 attitudes"


def test_of_several_vehicles_the_one_of_the_namespace_counts(tmp_path):
    reports = [report(0, rover1__georeference_node={"cloud": 5}, georeference_node={"cloud": 50})]
    topics = {"rover1/velodyne_points": (CLOUD, 4), "other/points": (CLOUD, 4)}
    with BagReader(log(tmp_path / "log", reports, topics)) as bag:
        counted = heard_and_logged(bag, {"cloud": "rover1/velodyne_points"})
        assert "1 of 5 clouds" in missing_messages(counted).doubts[0].text
        assert missing_messages(heard_and_logged(bag, {"cloud": "other/points"})).sound  # nobody's
    with BagReader(log(tmp_path / "none", [], topics)) as bag:
        assert missing_messages(heard_and_logged(bag, {"cloud": "rover1/velodyne_points"})).sound


def test_a_log_without_a_sensors_topic_says_what_was_there_live(tmp_path):
    path = log(tmp_path / "log", [report(0, georeference_node={"cloud": 2, "imu": 73})], {})
    with BagReader(path) as bag:
        assert "2 clouds and 73 attitudes live" in absent_words(bag)
        with pytest.raises(BagError, match=r"no topic for cloud.*2 clouds and 73 attitudes live"):
            Replay(bag, Parameters(), {})


def test_messages_that_found_no_room_live_are_more_than_live(tmp_path):
    counts = {"cloud": 10, "imu": 100}
    full = report(0, georeference_node=counts)
    values = full.status[0].values
    values.append(T["diagnostic_msgs/msg/KeyValue"]("lost_message_queue_full_cloud", "4"))
    path = log(tmp_path / "log", [full], {"velodyne_points": (CLOUD, 10), "imu/data": (IMU, 100)})
    with BagReader(path) as bag:
        assert more_than_live(heard_and_logged(bag, TOPICS)) == {"cloud": 4}


def test_a_node_that_was_started_again_has_heard_what_it_had_before(tmp_path):
    reports = [
        report(0, georeference_node={"cloud": 4, "imu": 40}),
        report(NANO, georeference_node={"cloud": 7, "imu": 70}),
        report(2 * NANO, georeference_node={}),
        report(3 * NANO, georeference_node={"cloud": 1}),
        report(4 * NANO, georeference_node={"cloud": 2, "imu": 21}),
    ]
    path = log(tmp_path / "log", reports, {"velodyne_points": (CLOUD, 12), "imu/data": (IMU, 91)})
    with BagReader(path) as bag:
        assert heard_and_logged(bag, TOPICS) == {"cloud": (9, 12), "imu": (91, 91)}
