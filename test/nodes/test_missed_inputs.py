"""A log that began after its drivers says what it lacks of what georeference_node had."""

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from ladar_volume.io.recorder import TopicAccount
from ladar_volume.nodes.watch.missed_inputs import MissedInputs

TOPICS = {"cloud": "rover/velodyne_points", "imu": "rover/imu/data"}


def report(cloud, imu, name="rover/georeference_node"):
    values = [
        KeyValue(key=f"received_{k}", value=str(v)) for k, v in (("cloud", cloud), ("imu", imu))
    ]
    return DiagnosticArray(status=[DiagnosticStatus(name=name, values=values)])


def accounts(cloud, imu, **lost):
    return {TOPICS["cloud"]: TopicAccount(cloud, **lost), TOPICS["imu"]: TopicAccount(imu)}


def test_what_came_before_the_log_is_said_at_the_next_report_and_at_the_end():
    missed = MissedInputs("/rover", TOPICS)
    missed.take(report(12, 130))
    assert missed.words(accounts(2, 30)) == ""  # may be on its way
    missed.take(report(22, 230))
    assert "10 of 12 clouds and 100 of 130" in missed.words(accounts(2, 30))
    assert "20 of 22 clouds and 200 of 230" in missed.words(accounts(2, 30), ended=True)
    assert "22 of 22 clouds" in missed.words({}, ended=True)


@pytest.mark.parametrize("lost", [{}, {"queue": 4}, {"disk": 4}, {"middleware": 4}])
def test_what_is_there_or_counted_as_lost_is_not_missed(lost):
    missed = MissedInputs("/rover", TOPICS)
    missed.take(report(22, 230))
    assert missed.words(accounts(22 - sum(lost.values()), 231, **lost), ended=True) == ""


def test_another_vehicles_node_does_not_count():
    missed = MissedInputs("/rover", TOPICS)
    missed.take(report(22, 230, "other/georeference_node"))
    assert missed.words({}, ended=True) == ""
