"""georeference_node: clouds, fixes and attitudes in; mapped points, platform states and the datum out."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable, Sequence
from typing import Any

from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu, NavSatFix, PointCloud2

from ladar_volume.georeference.georeferencer import Georeferencer
from ladar_volume.georeference.sensitivity import total_covariance
from ladar_volume.io.clouds import returns_from_cloud, stamp_ns
from ladar_volume.io.messages import fix_from_message, imu_from_message, odometry_from_message
from ladar_volume.io.wire import mapped_columns
from ladar_volume.nodes.base import LATCHED, STREAM, StageNode, sensor_qos, spin
from ladar_volume.nodes.convert import datum_message, platform_messages, table_message


class GeoreferenceNode(StageNode):
    """Wraps one Georeferencer."""

    sections = ("calibration", "budget", "georeference", "node")
    runtime_sections = ("node",)

    def __init__(self, **options: Any) -> None:
        super().__init__("georeference_node", **options)

    def build(self) -> None:
        """Stage, topics."""
        self.stage = Georeferencer(self.parameters)
        self._segment: int | None = None
        self._datum_sent = False
        self._fix_status = "none"
        self._newest_ns = 0
        self.sent = {"points": 0, "clouds": 0, "states": 0}
        self._points = self.create_publisher(PointCloud2, "points_mapped", STREAM)
        self._platform = self.create_publisher(Odometry, "platform", STREAM)
        self._datum = self.create_publisher(NavSatFix, "datum", LATCHED)
        qos = sensor_qos(self.parameters)
        self.listen("cloud", PointCloud2, "velodyne_points", qos)
        if self.parameters.georeference.pose_source == "odometry":
            self.listen("odometry", Odometry, "odometry", qos)
        else:
            self.listen("fix", NavSatFix, "gnss/fix", qos)
            self.listen("imu", Imu, "imu/data", qos)

    def work(self, kind: str, item: Any) -> None:
        """One message: decode, hand to the stage, publish what became ready."""
        if kind == "reset":
            self.losses.merge(self.stage.losses)
            self.stage = Georeferencer(self.parameters)
            self._segment, self._datum_sent = None, False
            return
        stage = self.stage
        decode: dict[str, Callable[[Any], None]] = {
            "fix": lambda m: stage.add_fix(fix_from_message(m)),
            "imu": lambda m: stage.add_imu(imu_from_message(m)),
            "odometry": lambda m: stage.add_odometry(odometry_from_message(m)),
            "cloud": lambda m: stage.add_returns(returns_from_cloud(m, self.parameters.georeference, self.losses)),
        }
        if kind == "fix":
            self._fix_status = str(item.status.status)
        self._newest_ns = max(self._newest_ns, stamp_ns(item))
        decode[kind](item)
        self._publish()

    def _publish(self) -> None:
        if self.stage.datum is not None and not self._datum_sent:
            self._datum.publish(datum_message(self.stage.datum, self._newest_ns))
            self._datum_sent = True
        states = self.stage.take_platform()
        if states is not None and len(states):
            for message in platform_messages(states, self._segment):
                self._platform.publish(message)
            self._segment = int(states.segment[-1])
            self.sent["states"] += len(states)
        for points in self.stage.take_points():
            if not len(points):
                continue
            if self.parameters.georeference.covariance_output == "total" and states is not None:
                points = dataclasses.replace(points, C_ind=total_covariance(points, states, self.parameters))
            stamp, columns = mapped_columns(points)
            self._points.publish(table_message(columns, stamp))
            self.sent["points"] += len(points)
            self.sent["clouds"] += 1

    def status(self) -> dict[str, Any]:
        """Fix type, clock offset, waiting returns, what was sent."""
        offset = self.parameters.calibration.clock_offset_s
        return {
            "fix_status": self._fix_status, "clock_offset_s": offset, "returns_waiting": self.stage.pending,
            **{f"sent_{k}": v for k, v in self.sent.items()},
        }  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    """Run the node alone."""
    return spin(GeoreferenceNode, argv)


if __name__ == "__main__":
    sys.exit(main())
