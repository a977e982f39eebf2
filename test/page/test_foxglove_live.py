"""What Foxglove gets over a WebSocket on loopback: the messages as they are, and no way to change
anything.
"""

import json
import struct

import pytest

pytest.importorskip("foxglove", reason="the extra 'foxglove' is not installed")
pytest.importorskip("websockets", reason="websockets is not installed")

from own_process import result_of
from rosbags.typesys import Stores, get_typestore
from websockets.sync import client

from ladar_volume.model.errors import ConfigurationError, OutputError
from ladar_volume.page import foxglove_live
from ladar_volume.page.foxglove_live import LiveTopics, serve_topics
from ladar_volume.page.place import place_of

TYPES = get_typestore(Stores.ROS2_JAZZY)
FLOAT = "std_msgs/msg/Float64"


def cdr(value):
    return bytes(TYPES.serialize_cdr(TYPES.types[FLOAT](value), FLOAT))


def connected(port):
    return client.connect(
        f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"], open_timeout=30
    )


class Viewer:
    """What a Foxglove window does: it hears of the topics, asks for some, reads messages."""

    def __init__(self, socket):
        self.socket = socket
        self.server = json.loads(self.socket.recv(timeout=30))
        self.channels = {}

    def hear(self, topics):
        """Until these topics are known."""
        while not set(topics) <= set(self.channels):
            heard = self.socket.recv(timeout=30)
            if isinstance(heard, str) and json.loads(heard)["op"] == "advertise":
                self.channels |= {c["topic"]: c for c in json.loads(heard)["channels"]}

    def ask(self, *topics):
        self.hear(topics)
        wanted = [{"id": k, "channelId": self.channels[t]["id"]} for k, t in enumerate(topics)]
        self.socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def message(self):
        """Number of the subscription, time and bytes of the next message."""
        while True:
            heard = self.socket.recv(timeout=30)
            if isinstance(heard, bytes) and heard[0] == 1:
                number, t_ns = struct.unpack_from("<IQ", heard, 1)
                return number, t_ns, heard[13:]


def test_messages_come_as_they_are_and_the_last_one_again_for_who_comes_late():
    live = LiveTopics()
    with serve_topics(live, place_of("0", "--foxglove")) as port:
        live.keep("/tin", FLOAT, cdr(643.1), 17)
        with connected(port) as socket:
            look(live, Viewer(socket))


def look(live, viewer):
    assert viewer.server["op"] == "serverInfo" and viewer.server["capabilities"] == []
    viewer.ask("/tin")
    number, t_ns, data = viewer.message()
    assert (number, t_ns) == (0, 17) and data == cdr(643.1)
    assert TYPES.deserialize_cdr(data, FLOAT).data == 643.1
    channel = viewer.channels["/tin"]
    assert channel["encoding"] == "cdr" and channel["schemaEncoding"] == "ros2msg"
    assert channel["schemaName"] == FLOAT and "float64 data" in channel["schema"]
    live.keep("/tin", FLOAT, cdr(644.0), 18)
    assert viewer.message()[1:] == (18, cdr(644.0))


def test_points_are_handed_on_at_a_low_rate(monkeypatch):
    now = iter([0.0, 0.4, 0.9, 1.0, 1.5, 2.1])
    monkeypatch.setattr(foxglove_live.time, "monotonic", lambda: next(now))
    live, written = LiveTopics(), []
    monkeypatch.setattr(live, "write", lambda *what: written.append(what[3]))
    for k in range(6):
        live.thin("/points", FLOAT, cdr(0.0), k)
    assert written == [0, 3, 5]


def test_it_listens_on_loopback_unless_told_otherwise():
    assert place_of("8765", "--foxglove").own and place_of("[::1]:1", "--foxglove").own
    assert not place_of("0.0.0.0:8765", "--foxglove").own
    with pytest.raises(ConfigurationError, match="--foxglove"):
        place_of("somewhere:8765", "--foxglove")
    with serve_topics(LiveTopics(), place_of("0", "--foxglove")) as port:
        with pytest.raises(OutputError, match="cannot be used"):
            with serve_topics(LiveTopics(), place_of(str(port), "--foxglove")):
                pass


NODE = """
import json, struct, sys, time
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float64
from visualization_msgs.msg import Marker
from websockets.sync.client import connect
from ladar_volume.nodes.viewers.foxglove_node import FoxgloveNode
from ladar_volume.nodes.qos import LATCHED, STREAM
from ladar_volume.nodes.running import Spinner
from ladar_volume.page.foxglove_live import LiveTopics, serve_topics
from ladar_volume.page.place import place_of

rclpy.init()
live, source = LiveTopics(), Node("source")
tin = source.create_publisher(Marker, "tin", LATCHED)
volume = source.create_publisher(Float64, "volume", 10)
points = source.create_publisher(PointCloud2, "points_filtered", STREAM)
tin.publish(Marker(ns="tin", id=7))
wanted, found = {"/tin", "/volume", "/points_filtered"}, {}
spinner = Spinner(FoxgloveNode(live))
with serve_topics(live, place_of("0", "--foxglove")) as port:
    with connect(f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"]) as socket:
        topics, deadline = {}, time.monotonic() + 90.0
        while wanted - set(found) and time.monotonic() < deadline:
            volume.publish(Float64(data=643.1))
            points.publish(PointCloud2(width=3))
            try:
                heard = socket.recv(timeout=0.2)
            except TimeoutError:
                continue
            if isinstance(heard, bytes):
                topic = topics[struct.unpack_from("<I", heard, 1)[0]]
                found[topic] = len(heard)
            elif json.loads(heard)["op"] == "advertise":
                new = {c["id"]: c["topic"] for c in json.loads(heard)["channels"]}
                topics |= new
                asked = [{"id": k, "channelId": k} for k in new]
                socket.send(json.dumps({"op": "subscribe", "subscriptions": asked}))
spinner.close()
source.destroy_node()
rclpy.shutdown()
print(json.dumps(sorted(set(found) & wanted)))
"""


def test_topics_of_the_nodes_arrive_whoever_came_first():
    pytest.importorskip("rclpy", reason="ROS is not installed")
    assert result_of(NODE) == ["/points_filtered", "/tin", "/volume"]
