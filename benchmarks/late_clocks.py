"""Late messages and clocks that are off, told apart: the bundled box survey goes through
georeference_node's worker with stamps or arrivals of IMU or LiDAR moved; printed is what the
diagnostics say at the end.

``python -m benchmarks.late_clocks``
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import rclpy
from rclpy.parameter import Parameter

from ladar_volume.io.bags import BagReader
from ladar_volume.nodes.georeference_node import GeoreferenceNode
from ladar_volume.process.private_graph import join_private_graph

BAG = Path(__file__).parents[1] / "bags" / "box"
S, SECONDS = 1_000_000_000, 25


class Fault(NamedTuple):
    """role : whose messages · stamp_s : their stamps are off by · late_s : they come late by ·
    words : what the diagnostics must say; nothing about clocks where empty
    """

    role: str
    stamp_s: float
    late_s: float
    words: str


FAULTS = {
    "nothing": Fault("imu", 0.0, 0.0, ""),
    "IMU's stamps 2 s behind": Fault("imu", -2.0, 0.0, "stamps of the attitudes are 2.00"),
    "IMU's messages 2 s late": Fault("imu", 0.0, 2.0, ""),
    "LiDAR's stamps 0.4 s behind": Fault("cloud", -0.4, 0.0, "stamps of the clouds are 0.40"),
    "LiDAR's messages 0.4 s late": Fault("cloud", 0.0, 0.4, ""),
    "LiDAR 0.3 s behind and 0.3 s late": Fault("cloud", -0.3, 0.3, "more are the way of"),
    "LiDAR's stamps 1.5 s ahead": Fault("cloud", 1.5, 0.0, "stamps of the clouds are 1.50"),
}


def messages(fault: Fault) -> list[tuple[str, Any]]:
    """Role and message in the order of arrival."""
    found: list[tuple[float, int, str, Any]] = []
    with BagReader(BAG) as bag:
        roles = {topic: role for role, topic in bag.roles().items()}
        for raw in bag.raw(set(roles)):
            if raw.t_ns > bag.start_ns + SECONDS * S:
                break
            role, message, arrival = roles[raw.topic], bag.message(raw), float(raw.t_ns)
            if role == fault.role:
                stamp = message.header.stamp
                moved = stamp.sec * S + stamp.nanosec + round(fault.stamp_s * S)
                stamp.sec, stamp.nanosec = divmod(moved, S)
                arrival += fault.late_s * S
            found.append((arrival, len(found), role, message))
    return [(role, message) for _, _, role, message in sorted(found, key=lambda f: f[:2])]


def said(fault: Fault) -> tuple[list[str], dict[str, Any]]:
    """Warnings and status at the end."""
    given = {"config_file": str(BAG / "config.yaml"), "node.input_reliability": "reliable"}
    node = GeoreferenceNode(parameter_overrides=[Parameter(k, value=v) for k, v in given.items()])
    try:
        if not node.autostart():
            raise RuntimeError(node.failure)
        for role, message in messages(fault):
            node.work(role, message)
        return node.warnings(), node.status()
    finally:
        node.stop()
        node.destroy_node()


def run() -> dict[str, float]:
    """How many of the faults are told as they are."""
    right = 0
    for name, fault in FAULTS.items():
        words, lines = said(fault)
        about = [w for w in words if "stamps of" in w or "than attitudes" in w]
        good = any(fault.words in w for w in about) if fault.words else not about
        right += good
        turns = lines.get("clock_offset_by_turns_s", "-")
        print(
            f"{name}: {lines['clock_state']}, by arrival {lines.get('clock_offset_estimate_s')} s, "
            f"by turns {turns} s{'' if good else ' WRONG'}"
        )
        for word in about:
            print(f"    {word}")
    return {"faults": len(FAULTS), "told as they are": right}


if __name__ == "__main__":
    join_private_graph()
    rclpy.init(args=[])
    print(run())
    rclpy.try_shutdown()
