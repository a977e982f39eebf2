"""Hands the topics that the other nodes publish anyway on to Foxglove, as raw CDR."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node
from rclpy.qos import QoSProfile

from ladar_volume.nodes.message_classes import needed_class
from ladar_volume.nodes.qos import LATCHED, STREAM
from ladar_volume.page.foxglove_live import LiveTopics

#: Topic, its type, and whether the last message holds until the next.
KEPT = {
    "tin": "visualization_msgs/msg/Marker",
    "ground_plane": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "volumes": "sensor_msgs/msg/PointCloud2",
    "more_data": "sensor_msgs/msg/PointCloud2",
    "datum": "sensor_msgs/msg/NavSatFix",
}
WRITTEN = {
    "volume": "std_msgs/msg/Float64",
    "volume_sigma": "std_msgs/msg/Float64",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
THINNED = {
    "points_filtered": "sensor_msgs/msg/PointCloud2",
    "platform": "nav_msgs/msg/Odometry",
}


class FoxgloveNode(Node):
    """Subscribes to mesh, volume, sigma, map, health, and at a low rate to points and pose."""

    def __init__(self, live: LiveTopics) -> None:
        super().__init__("foxglove")
        for topics, write, qos in (
            (KEPT, live.keep, LATCHED),
            (WRITTEN, live.write, QoSProfile(depth=10)),
            (THINNED, live.thin, STREAM),
        ):
            for topic, kind in topics.items():
                self._hand_on(topic, kind, write, qos)

    def _hand_on(
        self,
        topic: str,
        kind: str,
        write: Callable[[str, str, bytes, int], None],
        qos: QoSProfile,
    ) -> None:
        name = self.resolve_topic_name(topic)

        def take(data: bytes) -> None:
            write(name, kind, data, int(self.get_clock().now().nanoseconds))

        self.create_subscription(needed_class(kind), topic, take, qos, raw=True)
