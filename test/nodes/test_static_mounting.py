"""Nodes take the mounting of the frames they name from /tf_static while they are configured. The
message type is of a package that need not be here: a stand-in for the middleware hands it over.
"""

import contextlib
import dataclasses
import math
from types import SimpleNamespace as Message

import pytest

from ladar_volume.model.errors import ConfigurationError
from ladar_volume.model.parameters import Parameters

static_mounting = pytest.importorskip("ladar_volume.nodes.frames.static_mounting")


def static(parent, child, x, yaw=0.0):
    place, turn = Message(x=x, y=0.0, z=0.0), (math.sin(yaw / 2), math.cos(yaw / 2))
    rotation = Message(x=0.0, y=0.0, z=turn[0], w=turn[1])
    transform = Message(translation=place, rotation=rotation)
    header = Message(frame_id=parent)
    return Message(transforms=[Message(header=header, child_frame_id=child, transform=transform)])


class Node:
    """What is asked of a node: a subscription whose messages are taken by hand."""

    def __init__(self, messages):
        self.waiting, self.open = list(messages), 0

    def create_subscription(self, kind, topic, callback, qos):
        assert topic == "/tf_static"
        self.open += 1
        handle = contextlib.nullcontext()
        handle.take_message = lambda *_: (self.waiting.pop(0), {}) if self.waiting else None
        return Message(handle=handle)

    def destroy_subscription(self, subscription):
        self.open -= 1


def parameters(**frames):
    p = Parameters()
    return dataclasses.replace(p, node=dataclasses.replace(p.node, **frames))


NAMED = {"lidar_frame": "velodyne", "imu_frame": "imu_link"}


@pytest.fixture
def installed(monkeypatch):
    monkeypatch.setattr(static_mounting, "message_class", lambda kind: object)
    monkeypatch.setattr(static_mounting, "WAIT_S", 0.1)


def test_named_frames_are_mounted_by_the_transforms(installed):
    tree = [static("base_link", "imu_link", 0.5), static("base_link", "velodyne", 2.0, yaw=0.3)]
    node = Node(tree)
    found = static_mounting.mounting_from_frames(node, parameters(**NAMED))
    c = found.parameters.calibration
    assert c.lever_laser_m == pytest.approx((1.5, 0.0, 0.0)) and node.open == 0
    assert c.boresight_yaw_rad == pytest.approx(0.3)
    assert found.words == ("mounting of 'velodyne' on 'imu_link' from /tf_static",)


def test_frames_that_do_not_come_are_refused_where_nothing_else_mounts(installed):
    with pytest.raises(ConfigurationError, match="did not lead from 'imu_link' to 'velodyne'"):
        static_mounting.mounting_from_frames(Node([]), parameters(**NAMED))
    p = parameters(**NAMED)
    given = dataclasses.replace(p.calibration, lever_laser_m=(1.0, 0.0, 0.0))
    p = dataclasses.replace(p, calibration=given)
    assert repr(static_mounting.mounting_from_frames(Node([]), p).parameters) == repr(p)
    with pytest.raises(ConfigurationError, match=r"lever_laser_m is 1\.000"):
        static_mounting.mounting_from_frames(Node([static("imu_link", "velodyne", 2.0)]), p)


def test_without_names_or_without_the_package_the_configuration_counts(installed, monkeypatch):
    assert "node.imu_frame" in static_mounting.mounting_from_frames(None, parameters()).words[0]
    monkeypatch.setattr(static_mounting, "message_class", lambda kind: None)
    found = static_mounting.mounting_from_frames(None, parameters(**NAMED))
    assert "tf2_msgs is not installed" in found.words[0]
    assert repr(found.parameters) == repr(parameters(**NAMED))
