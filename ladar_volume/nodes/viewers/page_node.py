"""Feeds the page in the field from the topics that the other nodes publish anyway."""

from __future__ import annotations

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

from ladar_volume.io.tables import decode
from ladar_volume.nodes.qos import LATCHED
from ladar_volume.nodes.watch.upstream_nodes import own_name
from ladar_volume.page.feed import Cell, Feed, NodeHealth

LEVELS = {
    DiagnosticStatus.OK: "ok",
    DiagnosticStatus.WARN: "warning",
    DiagnosticStatus.ERROR: "error",
    DiagnosticStatus.STALE: "stale",
}


class PageNode(Node):
    """Reads diagnostics and ``more_data``."""

    def __init__(self, feed: Feed) -> None:
        super().__init__("page")
        self._feed = feed
        self.create_subscription(DiagnosticArray, "/diagnostics", self._take, 50)
        self.create_subscription(PointCloud2, "more_data", self._take_map, LATCHED)

    def _take(self, message: DiagnosticArray) -> None:
        for status in message.status:
            name = own_name(status.name, self.get_namespace())
            if name is None:
                continue
            level = LEVELS.get(status.level, "stale")
            self._feed.node(name, NodeHealth(level, status.message))
            if name == "volume_node":
                self._feed.volume({v.key: v.value for v in status.values})

    def _take_map(self, message: PointCloud2) -> None:
        table = decode(message)
        falls = np.column_stack([c for n, c in table.items() if n.startswith("fall_")])
        names = [n for n in table if n.startswith("fall_")]
        gap = falls.argmax(axis=1) == names.index("fall_gap")
        gap &= falls.max(axis=1) > 0.0
        columns = [table[name].tolist() for name in ("x", "y", "z", "sigma", "gain")]
        rows = zip(*columns, gap.tolist(), strict=True)
        side = float(table["side"][0]) if len(gap) else 0.0
        self._feed.cells([Cell(*row) for row in rows], side)
