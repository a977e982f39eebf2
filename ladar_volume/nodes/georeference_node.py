"""georeference_node: clouds, fixes and attitudes in; mapped points, platform states and the datum
out.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from nav_msgs.msg import Odometry
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Imu, NavSatFix, PointCloud2
from std_msgs.msg import UInt8MultiArray
from std_srvs.srv import Trigger

from ladar_volume.georeference.georeferencer import Georeferencer
from ladar_volume.georeference.mounting_check import mounting_doubts
from ladar_volume.georeference.point_jacobian import total_covariance
from ladar_volume.georeference.turn_check import Turns
from ladar_volume.io.cloud_messages import returns_from_cloud, stamp_ns
from ladar_volume.io.drivers.point_layouts import RING_FIELDS
from ladar_volume.io.drivers.velodyne_scan import KIND, TOPIC
from ladar_volume.io.frames.moving_frames import TransformPoses
from ladar_volume.io.frames.static_frames import KIND as TF_KIND
from ladar_volume.io.message_tables import mapped_columns
from ladar_volume.io.sensor_messages import (
    fix_from_message,
    imu_from_message,
    poses_from_message,
)
from ladar_volume.model.errors import CloudError, ParameterValueError
from ladar_volume.model.records import Returns
from ladar_volume.nodes.base import STEADY, StageNode
from ladar_volume.nodes.convert import datum_message, platform_messages, table_message
from ladar_volume.nodes.frames.published_frames import MOVING, PublishedFrames
from ladar_volume.nodes.inputs.first_listeners import FirstListeners
from ladar_volume.nodes.inputs.heard_inputs import TOPIC as TOPIC_OF_COPIES
from ladar_volume.nodes.inputs.heard_inputs import HeardInputs
from ladar_volume.nodes.message_classes import needed_class, type_name
from ladar_volume.nodes.qos import HANDED_ON, LATCHED, STREAM, sensor_qos
from ladar_volume.nodes.running import spin
from ladar_volume.nodes.watch.clock_words import clock_state, clock_words
from ladar_volume.nodes.watch.fix_step_lines import step_lines
from ladar_volume.nodes.watch.sensor_checks import SensorChecks

#: An outage: sensors at 10 Hz and more do not pause this long.
SILENT_S = 2.0
#: How often copies for the log are looked after, s.
HAND_ON_S = 0.2
#: What NavSatFix.status says, as drivers use it.
FIX_TYPES = {-1: "none", 0: "autonomous or float", 1: "augmented", 2: "RTK fixed"}


class GeoreferenceNode(StageNode):
    """Wraps one Georeferencer."""

    sections = ("calibration", "budget", "georeference", "node")
    kernels = "georeference"
    runtime_sections = ("node",)

    def __init__(self, **options: Any) -> None:
        super().__init__("georeference_node", **options)

    def build(self) -> None:
        """Stage, topics."""
        self.stage = Georeferencer(self.parameters)
        self._turns = Turns(self.stage.mount.R_body_laser)
        self._checks, self._returns = SensorChecks(self.parameters), 0
        self._segment: int | None = None
        self._datum_sent = False
        self._fix_status: int | None = None
        self._fix_changes = self._restarts = 0
        self._newest_ns = self._sent_ns = 0
        self.sent = {"points": 0, "parts": 0, "states": 0}
        node = self.parameters.node
        self._map, self._names = node.map_frame, (node.map_frame, node.imu_frame or node.base_frame)
        self._frames = PublishedFrames(self, node)
        self._first = FirstListeners(self)
        self._transforms = TransformPoses(node.map_frame, node.base_frame)
        self._points = self.create_publisher(PointCloud2, "points_mapped", STREAM)
        self._platform = self.create_publisher(Odometry, "platform", STREAM)
        self._datum_out = self.create_publisher(NavSatFix, "datum", LATCHED)
        answers = MutuallyExclusiveCallbackGroup()
        self.create_service(Trigger, "~/flush", self._flush, callback_group=answers)
        self._heard = HeardInputs(self.publishers_of)
        self._copies = self.create_publisher(UInt8MultiArray, TOPIC_OF_COPIES, HANDED_ON)
        self.create_timer(HAND_ON_S, self._hand_on, self._group, Clock(clock_type=STEADY))
        self._listen()

    def _listen(self) -> None:
        """Subscribe to the inputs."""
        p, qos = self.parameters, sensor_qos(self.parameters)
        if p.node.cloud_message == "VelodyneScan":
            self._hear("cloud", needed_class(KIND), TOPIC, qos)
        else:
            self._hear("cloud", PointCloud2, "velodyne_points", qos)
        if p.georeference.pose_source == "odometry" and p.node.odometry_message == "TFMessage":
            self._hear("odometry", needed_class(TF_KIND), "/tf", MOVING)
        elif p.georeference.pose_source == "odometry":
            self._hear("odometry", Odometry, "odometry", qos)
        else:
            self._hear("fix", NavSatFix, "gnss/fix", qos)
            self._hear("imu", Imu, "imu/data", qos)

    def _hear(self, role: str, message_type: type[Any], topic: str, qos: QoSProfile) -> None:
        """Subscribe to an input; copies of its first messages go to the log."""
        name, kind = self.resolve_topic_name(topic), type_name(message_type)

        def used(data: bytes, info: Mapping[str, Any]) -> None:
            received_ns = int(self.get_clock().now().nanoseconds)
            self._heard.take(name, kind, data, info, received_ns, time.monotonic())
            self._hand_on()

        self.listen(role, message_type, topic, qos, SILENT_S, used)

    def _hand_on(self) -> None:
        """Publish copies of first inputs."""
        listened = self._heard.waits and self._copies.get_subscription_count() > 0
        for copy in self._heard.due(listened, time.monotonic()):
            self._copies.publish(copy.message())

    async def _flush(
        self, request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        """Once all that came was worked off: the stamp (ns) of the last part sent, and how many
        returns wait for poses.
        """
        self.take_all()  # what the middleware holds came before the call, too
        return await self.flush(request, response)

    def work(self, kind: str, item: Any) -> None:
        """One message: decode, hand to the stage, publish what became ready."""
        if kind == "flush":
            self._first.there = True
            self._publish()
            item.set_result(f"{self._sent_ns} {self.stage.pending}")
            return self.wake()
        if kind == "reset":
            self.losses.merge(self.stage.losses)
            self.stage = Georeferencer(self.parameters)
            self._restarts = 0
            self._start_over()
            return None
        stage = self.stage
        decode: dict[str, Callable[[Any], None]] = {
            "fix": lambda m: stage.add_fix(fix_from_message(m)),
            "imu": self._add_imu,
            "odometry": self._add_odometry,
            "cloud": lambda m: stage.add_returns(self._returns_of(m)),
        }
        if kind == "fix":
            self._fix_changes += self._fix_status not in (None, int(item.status.status))
            self._fix_status = int(item.status.status)
        if hasattr(item, "header"):
            self._newest_ns = stamp_ns(item)
            self._checks.message(kind, item)
        if kind == "imu":
            self._checks.imu(item)
        decode[kind](item)
        if stage.restarts != self._restarts:
            self._restarts = stage.restarts
            self.get_logger().warning(
                "the time of the data began again: a new trajectory, a new surface"
            )
            self._start_over()
        self._publish()
        return None

    def _add_imu(self, message: Imu) -> None:
        sample = imu_from_message(message)
        self._turns.add_attitude(sample.t_ns, sample.q_map_body)
        self.stage.add_imu(sample)

    def _add_odometry(self, message: object) -> None:
        """Poses of an Odometry or of transforms."""
        for sample in poses_from_message(message, self._transforms, self.losses):
            self._newest_ns = sample.t_ns
            self._turns.add_attitude(sample.t_ns, sample.q_map_body)
            self.stage.add_odometry(sample)

    def _returns_of(self, cloud: PointCloud2) -> Returns:
        dual = self.losses["point_dual_return"]
        try:
            returns = returns_from_cloud(cloud, self.parameters.georeference, self.losses)
        except ParameterValueError as error:  # of another scanner: every cloud is refused
            self._checks.other_scanner = str(error)
            raise CloudError(str(error), reason="cloud_beams") from error
        if hasattr(cloud, "packets"):
            self._returns += len(returns) + self.losses["point_dual_return"] - dual
            self._checks.returns(returns, set(RING_FIELDS))
        else:
            self._returns += cloud.width * cloud.height
            self._checks.returns(returns, {field.name for field in cloud.fields})
        if self.stage.cloud_lead.state in ("offset", "unsteady"):  # latency, or a clock?
            self._turns.add_sweep(returns)
        return returns

    def received_counts(self) -> dict[str, int]:
        """Messages by input, and returns."""
        return super().received_counts() | {"point": self._returns}

    def _start_over(self) -> None:
        self._segment, self._datum_sent = None, False
        self._sent_ns = 0
        self._turns = Turns(self.stage.mount.R_body_laser)

    def idle(self) -> None:
        """Send what has waited for listeners."""
        if not self._first.there and self.stage.mapped:
            self._publish()

    def finish(self) -> None:
        """What still waits for a pose is lost, and counted."""
        self._first.there = True
        self.stage.finish()
        self._publish()

    def _publish(self) -> None:
        if not self._first.all_there(self.stage.mapped, time.monotonic()):
            return
        if self.stage.datum is not None and not self._datum_sent:
            self._datum_out.publish(datum_message(self.stage.datum, self._newest_ns, self._map))
            self._datum_sent = True
        states = self.stage.take_platform()
        if states is not None and len(states):
            for message in platform_messages(states, self._segment, self._names):
                self._platform.publish(message)
            self._frames.publish(states)
            self._segment = int(states.segment[-1])
            self.sent["states"] += len(states)
        for points in self.stage.take_points():
            if not len(points):
                continue
            if self.parameters.georeference.covariance_output == "total" and states is not None:
                points = dataclasses.replace(
                    points, C_ind=total_covariance(points, states, self.parameters)
                )
            stamp, columns = mapped_columns(points)
            self._points.publish(table_message(columns, stamp, self._map))
            self._sent_ns = stamp
            self.sent["points"] += len(points)
            self.sent["parts"] += 1

    def status(self) -> dict[str, Any]:
        """Fix type, clocks, waiting returns, what was sent. ``clock_offset_estimate_s`` is the
        whole offset, the declared one included.
        """
        offset, lead, fix = (
            self.parameters.calibration.clock_offset_s,
            self.stage.cloud_lead,
            self.stage.fix_lead,
        )
        status = -1 if self._fix_status is None else self._fix_status
        lines: dict[str, Any] = {
            "fix_status": status,
            "fix_type": FIX_TYPES.get(status, "unknown"),
            "fix_changes": self._fix_changes,
            "mounting": self.mounting,
            "tf": self._frames.words,
            "clock_offset_s": offset,
            "clock_state": clock_state(lead, self._turns.found, offset),
            "fix_clock_state": fix.state,
            "sweeps_overlapping": self.stage.sweeps.overlapping,
            "restarts": self.stage.restarts,
            "received_returns": self._returns,
            "returns_waiting": self.stage.pending,
            **{f"sent_{k}": v for k, v in self.sent.items()},
            **self._checks.lines(),
            **step_lines(self.stage.fix_steps),
        }
        if lead.estimate_s is not None:
            lines |= {
                "clock_offset_estimate_s": f"{offset + lead.estimate_s[0]:.4f}",
                "clock_offset_sigma_s": f"{lead.estimate_s[1]:.4f}",
            }
        if (turns := self._turns.found) is not None:
            lines |= {
                "clock_offset_by_turns_s": f"{turns.lag_s:.3f}",
                "clock_offset_by_turns_sigma_s": f"{turns.sigma_s:.3f}",
            }
        if fix.estimate_s is not None:
            lines["fix_behind_s"] = f"{fix.estimate_s[0]:.4f}"
        return lines

    def warnings(self) -> list[str]:
        """A LiDAR clock, or a receiver's, that does not tell the attitudes' time; a receiver
        without RTK fix.
        """
        out = [*self._checks.warnings(), *self._frames.warnings()]
        declared = self.parameters.calibration.clock_offset_s
        stage = self.stage
        out += clock_words(stage.cloud_lead, stage.fix_lead, self._turns.found, declared)
        if self._fix_status is not None and self._fix_status < 0:
            out.append("the receiver has no fix")
        return out

    def errors(self) -> list[str]:
        """What contradicts the configuration or another sensor."""
        turned = mounting_doubts(self.stage.mounting_check.found(), self.stage.mount.R_body_laser)
        words = [doubt.text for doubt in (turned + self.stage.rate_check.doubts()).doubts]
        return [*self._checks.errors(), *self._frames.errors(), *words]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the node alone."""
    return spin(GeoreferenceNode, argv)
