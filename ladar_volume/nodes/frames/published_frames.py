"""The platform's pose on ``/tf`` after REP-105, where the package ``tf2_msgs`` is installed."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from geometry_msgs.msg import TransformStamped
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import QoSProfile

from ladar_volume.io.cloud_messages import stamp_ns
from ladar_volume.io.frames import moving_frames, static_frames
from ladar_volume.io.frames.moving_frames import MovingFrame, inverse, pose_of, product
from ladar_volume.io.frames.static_frames import KIND, Pose, TFMessage
from ladar_volume.math.se3 import matrix_from_quaternion, quaternion_from_matrix
from ladar_volume.model.errors import AttitudeError, ConfigurationError
from ladar_volume.model.parameters import NodeParameters
from ladar_volume.model.records import F64, PlatformStates
from ladar_volume.nodes.convert import header
from ladar_volume.nodes.frames.static_mounting import STATIC, receive_static_frames
from ladar_volume.nodes.message_classes import message_class

#: Own transforms that are recognised when they come back.
OWN = 5000
#: As tf2 publishes and hears what moves.
MOVING = QoSProfile(depth=100)


class PublishedFrames:
    """Publishes ``odom → base_link`` with a fixed ``map → odom`` (``node.publish_tf: pose``), or
    ``map → odom`` such that another node's ``odom → base_link`` leads to the pose (``correction``).
    Falls silent where another node publishes the same frame: two parents would tear the tree.
    """

    def __init__(self, node: LifecycleNode, parameters: NodeParameters) -> None:
        """Raises ConfigurationError where frames are the same, or the body has no place in the base
        frame.
        """
        self._p, self._node = parameters, node
        self._own: deque[tuple[str, str, int]] = deque(maxlen=OWN)
        self._odometry, self._rival, self.sent = MovingFrame(), "", 0
        self._asked = False
        self._body_base: Pose = np.eye(3), np.zeros(3)
        self._type: Any = message_class(KIND) if parameters.publish_tf != "off" else None
        if parameters.publish_tf == "off":
            self.words = "off"
        elif self._type is None:
            self.words = "none: tf2_msgs is not installed; the pose is on platform"
        else:
            self.words = " -> ".join(self._names())
            self._begin()

    def _names(self) -> list[str]:
        p = self._p
        names = [f for f in (p.map_frame, p.odom_frame, p.base_frame) if f]
        if len(set(names)) < len(names) or not p.map_frame or not p.base_frame:
            raise ConfigurationError(
                f"frames for /tf are map '{p.map_frame}', odom '{p.odom_frame}', base "
                f"'{p.base_frame}': map and base must be named, and each be another one"
            )
        if p.publish_tf == "correction" and not p.odom_frame:
            raise ConfigurationError("node.publish_tf correction needs node.odom_frame")
        return names

    def _begin(self) -> None:
        p, node = self._p, self._node
        self._body_base = self._base_in_body()
        self._out = node.create_publisher(self._type, f"/{moving_frames.TOPIC}", MOVING)
        node.create_subscription(self._type, f"/{moving_frames.TOPIC}", self.hear, MOVING)
        if p.odom_frame and p.publish_tf == "pose":
            fixed = node.create_publisher(self._type, f"/{static_frames.TOPIC}", STATIC)
            at_origin = np.eye(3), np.zeros(3)
            now_ns = int(node.get_clock().now().nanoseconds)
            one = self._transform(p.map_frame, p.odom_frame, now_ns, at_origin)
            fixed.publish(self._type(transforms=[one]))

    def _base_in_body(self) -> Pose:
        """The base frame in that of the poses, by the static transforms."""
        p = self._p
        if p.imu_frame in ("", p.base_frame):
            return np.eye(3), np.zeros(3)
        found = receive_static_frames(self._node, self._type, [(p.imu_frame, p.base_frame)])
        pose = found.pose(p.imu_frame, p.base_frame)
        if pose is None:
            raise ConfigurationError(
                f"/tf_static does not lead from node.imu_frame '{p.imu_frame}' to node.base_frame "
                f"'{p.base_frame}': start robot_state_publisher first, or set node.publish_tf off"
            )
        return pose

    def hear(self, message: TFMessage) -> None:
        """What comes on /tf, own transforms among it."""
        p = self._p
        for one in message.transforms:
            parent, child = one.header.frame_id.lstrip("/"), one.child_frame_id.lstrip("/")
            if (parent, child, stamp_ns(one)) in self._own:
                continue
            if p.publish_tf == "correction" and (parent, child) == (p.odom_frame, p.base_frame):
                try:
                    self._odometry.add(stamp_ns(one), *pose_of(one))
                except AttitudeError as error:
                    self._node.get_logger().warning(f"/tf, '{parent}' to '{child}': {error}")
            elif child == (p.base_frame if p.publish_tf == "pose" else p.odom_frame):
                self._rival = parent

    def publish(self, states: PlatformStates) -> None:
        """Transforms of the states; of ``map → odom`` that of the newest that odometry covers."""
        if self._type is None or self._rival:
            return
        p, out = self._p, []
        R = matrix_from_quaternion(states.q_map_body)
        poses = [product((R[i], states.p_map_body[i]), self._body_base) for i in range(len(states))]
        if p.publish_tf == "pose":
            parent = p.odom_frame or p.map_frame
            for t_ns, pose in zip(states.t_ns.tolist(), poses, strict=True):
                out.append(self._transform(parent, p.base_frame, t_ns, pose))
        else:
            self._asked = True
            for t_ns, pose in zip(reversed(states.t_ns.tolist()), reversed(poses), strict=True):
                odometry = self._odometry.at(t_ns)
                if odometry is not None:
                    corrected = product(pose, inverse(odometry))
                    out.append(self._transform(p.map_frame, p.odom_frame, t_ns, corrected))
                    break
        if out:
            self.sent += len(out)
            self._out.publish(self._type(transforms=out))

    def _transform(self, parent: str, child: str, t_ns: int, pose: Pose) -> TransformStamped:
        one = TransformStamped(header=header(t_ns, parent), child_frame_id=child)
        place, turn = one.transform.translation, one.transform.rotation
        place.x, place.y, place.z = pose[1].tolist()
        q: F64 = quaternion_from_matrix(pose[0])
        turn.x, turn.y, turn.z, turn.w = q.tolist()
        self._own.append((parent, child, t_ns))
        return one

    def errors(self) -> list[str]:
        """Contradictions with other nodes' transforms."""
        p = self._p
        if self._rival:
            own = p.odom_frame or p.map_frame if p.publish_tf == "pose" else p.map_frame
            child = p.base_frame if p.publish_tf == "pose" else p.odom_frame
            hint = (
                "node.publish_tf correction publishes map -> odom alone"
                if p.publish_tf == "pose" and self._rival == p.odom_frame
                else "name other frames, or set node.publish_tf to off"
            )
            return [
                f"/tf: another node has '{child}' in '{self._rival}', this node in '{own}'; it has "
                f"stopped to publish: {hint}"
            ]
        return []

    def warnings(self) -> list[str]:
        """What is waited for."""
        if self._asked and not self.sent:
            p = self._p
            return [
                f"node.publish_tf is correction, and no '{p.odom_frame}' -> '{p.base_frame}' at "
                "the times of the poses comes on /tf"
            ]
        return []
