"""logger_node over DDS: everything published is in the file, latched topics in every file, and what
is not is accounted for.
"""

import json
import re
from pathlib import Path

import pytest
from mcap.reader import make_reader
from own_process import result_of
from rosbags.highlevel import AnyReader
from rosbags.typesys import get_types_from_msg

from ladar_volume.io.bags import TYPESTORE
from ladar_volume.io.recorder import log_files
from ladar_volume.nodes.logger_node import installed_definition

ROOT = Path(__file__).parents[2]

SCRIPT = """
import json, sys, time
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import TransitionEvent
from rclpy.parameter import Parameter
from rclpy.qos import HistoryPolicy, QoSProfile
from sensor_msgs.msg import NavSatFix
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger
from ladar_volume.nodes.logger_node import LoggerNode
from ladar_volume.nodes.qos import LATCHED, STREAM
from ladar_volume.nodes.running import Spinner

rclpy.init(args=[])
settings = {
    "logger.path": sys.argv[1],
    "logger.disk_reserve_bytes": 0,
    "node.diagnostics_period_s": 0.2,
    "logger.topics": ["chat", "datum", "number", "burst", "diagnostics"],
}
tester = rclpy.create_node("tester")
datum = tester.create_publisher(NavSatFix, "datum", LATCHED)
datum.publish(NavSatFix(latitude=50.0))
early = tester.create_publisher(Float64, "number", STREAM)
for i in range(7):
    early.publish(Float64(data=float(i)))  # before anybody listens
node = LoggerNode(parameter_overrides=[Parameter(k, value=v) for k, v in settings.items()])
node.autostart()
lines = {}
tester.create_subscription(
    DiagnosticArray,
    "/diagnostics",
    lambda m: lines.update({s.name: {v.key: v.value for v in s.values} for s in m.status}),
    50,
)
chat = tester.create_publisher(String, "chat", STREAM)
spinners = [Spinner(n) for n in (node, tester)]
until = lambda done, s=60.0: [time.sleep(0.02) for _ in range(int(s / 0.02)) if not done()]
until(lambda: chat.get_subscription_count() and early.get_subscription_count())
for i in range(500):
    chat.publish(String(data=f"line {i}"))
    time.sleep(0.0005)
early.publish(Float64(data=7.0))
until(lambda: lines.get("logger_node", {}).get("written_chat") == "500")
split = tester.create_client(Trigger, "logger_node/split")
split.wait_for_service(timeout_sec=60.0)
future = split.call_async(Trigger.Request())
until(future.done)
until(lambda: lines["logger_node"]["file"].endswith("_1.mcap"))
chat.publish(String(data="last"))
until(lambda: lines["logger_node"].get("written_chat") == "501")
for s in spinners:
    s.close()
rclpy.try_shutdown()
print(json.dumps({"answer": json.loads(future.result().message), "lines": lines["logger_node"]}))
"""


def test_everything_published_is_in_the_files(tmp_path):
    log = tmp_path / "log.mcap"
    seen = result_of(SCRIPT, log, timeout_s=300)
    assert seen["answer"]["finishing"].endswith("log.mcap") and not [
        k for k in seen["lines"] if k.startswith("lost_")
    ]
    assert seen["lines"]["before_number"] == "7" and seen["lines"]["disk"] == "good"
    files = log_files(log)
    assert len(files) == 2
    texts, sequences = [], []
    for file in files:
        with AnyReader([file]) as bag:
            datum = [
                bag.deserialize(data, c.msgtype)
                for c, _, data in bag.messages()
                if c.topic == "/datum"
            ]
            assert [m.latitude for m in datum] == [50.0]  # in every file
            texts += [
                bag.deserialize(data, c.msgtype).data
                for c, _, data in bag.messages()
                if c.topic == "/chat"
            ]
            assert {
                c.topic: c.ext.offered_qos_profiles[0].durability.name for c in bag.connections
            }["/datum"] == "TRANSIENT_LOCAL"
        with file.open("rb") as stream:
            reader = make_reader(stream)
            sequences += [m.sequence for _, c, m in reader.iter_messages(topics=["/chat"])]
            assert "filter" in json.loads(
                {m.name: m.metadata for m in reader.iter_metadata()}["ladar_volume"]["parameters"]
            )
            assert [a.name for a in reader.iter_attachments()] == ["parameters.yaml"]
    assert texts == [*(f"line {i}" for i in range(500)), "last"]
    assert sequences == list(
        range(sequences[0], sequences[0] + 501)
    )  # the publisher's own numbers: a gap would be a loss


@pytest.mark.parametrize(
    "kind",
    [
        "sensor_msgs/msg/PointCloud2",
        "sensor_msgs/msg/Imu",
        "diagnostic_msgs/msg/DiagnosticArray",
        "rcl_interfaces/msg/ParameterEvent",
        "visualization_msgs/msg/Marker",
        "lifecycle_msgs/msg/TransitionEvent",
        "shape_msgs/msg/SolidPrimitive",
    ],
)
def test_a_definition_made_from_an_installed_type_says_what_the_published_one_does(
    kind, monkeypatch
):
    monkeypatch.setattr("ladar_volume.nodes.logger_node.usual_definition", lambda kind: "")
    made = get_types_from_msg(installed_definition(kind), kind)
    for name, (_, fields) in made.items():
        if name in TYPESTORE.fielddefs:
            assert fields == TYPESTORE.fielddefs[name][1], name
    assert kind in made and installed_definition("nobody_msgs/msg/Nothing") == ""


def test_the_foxglove_layout_shows_topics_that_the_nodes_publish():
    layout = json.loads((ROOT / "config" / "foxglove_layout.json").read_text())
    text = json.dumps(layout["configById"])
    published = "".join(p.read_text() for p in (ROOT / "ladar_volume" / "nodes").glob("*.py"))
    topics = set(re.findall(r'"/([a-z_/]+)', text))
    assert {"volume", "volume_sigma", "points_filtered", "gnss/fix", "diagnostics"} <= topics
    assert all(f'"{t}"' in published or f'"/{t}"' in published for t in topics)
    panels = re.findall(r'"((?:\w+)!\w+)"', json.dumps(layout["layout"]))
    assert sorted(panels) == sorted(layout["configById"])
