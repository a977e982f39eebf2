"""The pose on /tf after REP-105. The message type is of a package that need not be here: a stand-in
for the middleware takes what is published and hands over what comes.
"""

import dataclasses
from types import SimpleNamespace as Message

import numpy as np
import pytest

from ladar_volume.math.se3 import matrix_from_quaternion, quaternion_from_matrix, rotation_xyz
from ladar_volume.model.errors import ConfigurationError
from ladar_volume.model.parameters import NodeParameters
from ladar_volume.model.records import PlatformStates

published_frames = pytest.importorskip("ladar_volume.nodes.frames.published_frames")


class TFMessage:
    """tf2_msgs/TFMessage."""

    def __init__(self, transforms):
        self.transforms = transforms


class Node:
    """What is asked of a node."""

    def __init__(self):
        self.out = {}

    def create_publisher(self, kind, topic, qos):
        said = self.out.setdefault(topic, [])
        return Message(publish=lambda m: said.extend(m.transforms))

    def create_subscription(self, kind, topic, callback, qos):
        self.hear = callback

    def get_clock(self):
        return Message(now=lambda: Message(nanoseconds=5))


def states(n=3):
    q = [quaternion_from_matrix(rotation_xyz(0.1, -0.2, 0.3 * i)) for i in range(n)]
    p = np.array([[i, 2.0, 3.0] for i in range(n)])
    t = 10**9 + 10**8 * np.arange(n)
    z = np.zeros((n, 3))
    return PlatformStates(t, p, np.array(q), z, z, np.zeros((n, 6, 6)), np.zeros(n, np.int64))


def frames(monkeypatch, **given):
    monkeypatch.setattr(published_frames, "message_class", lambda kind: TFMessage)
    node = Node()
    return published_frames.PublishedFrames(node, NodeParameters(**given)), node


def pose(one):
    t, q = one.transform.translation, one.transform.rotation
    M = np.eye(4)
    M[:3, :3], M[:3, 3] = matrix_from_quaternion(np.array([q.x, q.y, q.z, q.w])), (t.x, t.y, t.z)
    return M


def test_the_pose_goes_through_odom_that_is_fixed_in_the_map(monkeypatch):
    found, node = frames(monkeypatch, map_frame="rover1/map")
    found.publish(states())
    (fixed,) = node.out["/tf_static"]
    assert (fixed.header.frame_id, fixed.child_frame_id) == ("rover1/map", "odom")
    np.testing.assert_allclose(pose(fixed), np.eye(4))
    sent = node.out["/tf"]
    assert [(o.header.frame_id, o.child_frame_id) for o in sent] == [("odom", "base_link")] * 3
    np.testing.assert_allclose(pose(sent[2])[:3, 3], [2.0, 2.0, 3.0])
    np.testing.assert_allclose(pose(sent[2])[:3, :3], rotation_xyz(0.1, -0.2, 0.6), atol=1e-12)
    node.hear(TFMessage(sent))  # its own come back
    assert found.errors() == [] and found.words == "rover1/map -> odom -> base_link"


def test_without_odom_the_map_is_the_parent(monkeypatch):
    found, node = frames(monkeypatch, odom_frame="")
    found.publish(states(1))
    assert list(node.out) == ["/tf"] and node.out["/tf"][0].header.frame_id == "map"


def test_another_parent_of_the_same_frame_is_an_error_with_both(monkeypatch):
    found, node = frames(monkeypatch)
    found.publish(states(1))
    stamp = Message(sec=9, nanosec=0)
    other = Message(header=Message(frame_id="odom", stamp=stamp), child_frame_id="base_link")
    node.hear(TFMessage([other]))
    found.publish(states(2))
    assert len(node.out["/tf"]) == 1  # silent from then on
    (error,) = found.errors()
    assert "'base_link' in 'odom', this node in 'odom'" in error and "correction" in error


def test_a_correction_leads_another_nodes_odometry_to_the_pose(monkeypatch):
    found, node = frames(monkeypatch, publish_tf="correction")
    found.publish(states())
    assert "comes on /tf" in found.warnings()[0]
    drifted = states()
    drifted.p_map_body[:] += [0.5, -0.2, 0.1]
    other, source = frames(monkeypatch)
    other.publish(drifted)
    node.hear(TFMessage(source.out["/tf"]))
    found.publish(states())
    (sent,) = node.out["/tf"]
    assert (sent.header.frame_id, sent.child_frame_id) == ("map", "odom")
    whole = pose(sent) @ pose(source.out["/tf"][-1])
    np.testing.assert_allclose(whole[:3, 3], [2.0, 2.0, 3.0], atol=1e-12)
    assert found.warnings() == found.errors() == []


@pytest.mark.parametrize(
    "given",
    [{"map_frame": "base_link"}, {"odom_frame": "map"}, {"base_frame": ""}],
)
def test_frames_that_make_no_tree_are_refused(monkeypatch, given):
    with pytest.raises(ConfigurationError, match="each be another one"):
        frames(monkeypatch, **given)


def test_without_the_package_it_says_so(monkeypatch):
    monkeypatch.setattr(published_frames, "message_class", lambda kind: None)
    found = published_frames.PublishedFrames(Node(), NodeParameters())
    found.publish(states())
    assert "tf2_msgs is not installed" in found.words
    off = dataclasses.replace(NodeParameters(), publish_tf="off")
    assert published_frames.PublishedFrames(Node(), off).words == "off"
