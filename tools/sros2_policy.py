"""What each node publishes, hears, answers and asks, as a policy of SROS2.

``python tools/sros2_policy.py`` starts the nodes on the loopback, looks, and writes
config/sros2_policy.xml; ``ros2 security create_permission`` makes permissions of it.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

from ladar_volume.process.private_graph import join_private_graph

FILE = Path(__file__).parents[1] / "config" / "sros2_policy.xml"
SETTLE_S = 2.0
#: A simulated clock is heard where use_sim_time is set.
CLOCK = "/clock"
Names = dict[tuple[str, str], set[str]]


def nodes_of(folder: Path) -> list[tuple[str, Any]]:
    """A node of each kind, of georeference_node one for either source of poses."""
    from rclpy.parameter import Parameter

    from ladar_volume.nodes.graph import FACTORIES

    settings: dict[str, list[dict[str, str]]] = {
        "georeference_node": [{}, {"georeference.pose_source": "odometry"}],
        "logger_node": [{"logger.path": str(folder / "log.mcap")}],
        "mavlink_node": [{"mavlink.url": "udpin::0"}],
    }
    out = []
    for name, factory in FACTORIES.items():
        for given in settings.get(name, [{}]):
            node = factory(parameter_overrides=[Parameter(k, value=v) for k, v in given.items()])
            node.kernels = None  # nothing is computed
            node.trigger_configure()
            out.append((name, node))
    return out


def seen() -> dict[str, Names]:
    """By node: topics and services, by kind and by what is allowed."""
    import rclpy

    rclpy.init(args=[])
    found: dict[str, Names] = {}
    with tempfile.TemporaryDirectory() as folder:
        nodes = nodes_of(Path(folder))
        time.sleep(SETTLE_S)
        for name, node in nodes:
            ask = name, "/"
            ways = {
                ("topics", "publish"): node.get_publisher_names_and_types_by_node,
                ("topics", "subscribe"): node.get_subscriber_names_and_types_by_node,
                ("services", "reply"): node.get_service_names_and_types_by_node,
                ("services", "request"): node.get_client_names_and_types_by_node,
            }
            names = found.setdefault(name, {})
            for way, look in ways.items():
                names.setdefault(way, set()).update(topic for topic, _ in look(*ask))
            names["topics", "subscribe"].add(CLOCK)
            names["topics", "publish"].add(f"/{name}/ending")  # once it ends
            if name == "volume_node":  # once the filter has begun for it
                names["topics", "publish"].add("/volume_node/joined")
            if "calibration" in node.sections:  # while it is configured
                names["topics", "subscribe"].add("/tf_static")
            if name == "georeference_node":  # where tf2_msgs is installed
                names["topics", "publish"] |= {"/tf", "/tf_static"}
                names["topics", "subscribe"].add("/tf")
            if name == "logger_node":
                names["topics", "subscribe"] = {"*"}  # all that logger.topics may name
        for _, node in nodes:
            node.stop()
            node.destroy_node()
    rclpy.try_shutdown()
    return found


def policy(found: dict[str, Names]) -> str:
    """The XML."""
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        "<!-- Made by tools/sros2_policy.py: an enclave for each node, and what it may do. -->",
        '<policy version="0.2.0">',
        "  <enclaves>",
    ]
    for name, names in sorted(found.items()):
        lines.append(f'    <enclave path="/ladar_volume/{name}">')
        lines.append(f'      <profiles>\n        <profile ns="/" node="{name}">')
        for (kind, way), those in sorted(names.items()):
            if those:
                lines.append(f'          <{kind} {way}="ALLOW">')
                lines += [
                    f"            <{kind[:-1]}>{escape(t)}</{kind[:-1]}>" for t in sorted(those)
                ]
                lines.append(f"          </{kind}>")
        lines.append("        </profile>\n      </profiles>\n    </enclave>")
    return "\n".join([*lines, "  </enclaves>", "</policy>", ""])


def main() -> int:
    """Write the policy, or with --print print it."""
    join_private_graph()
    text = policy(seen())
    if "--print" in sys.argv:
        sys.stdout.write(text)
    else:
        FILE.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
