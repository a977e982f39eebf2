"""The mounting from /tf_static when a node is configured, for the frames that ``node`` names."""

from __future__ import annotations

import time
from typing import Any

from rclpy.lifecycle import LifecycleNode
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from ladar_volume.io.frames.frame_mounting import FrameMounting, from_frames
from ladar_volume.io.frames.static_frames import KIND, TOPIC, StaticFrames
from ladar_volume.model.errors import ConfigurationError
from ladar_volume.model.parameters import Parameters
from ladar_volume.nodes.message_classes import message_class

#: How long the transforms are waited for, and how often they are looked for, s.
WAIT_S, LOOK_S = 3.0, 0.05
#: As tf2 publishes them.
STATIC = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=100,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)


def mounting_from_frames(node: LifecycleNode, parameters: Parameters) -> FrameMounting:
    """The parameters with boresight and lever arms of the frames ``node.lidar_frame``,
    ``node.imu_frame`` (the body) and ``node.gnss_frame``, or why there are none.

    Raises ConfigurationError where frames and configuration contradict each other, and where
    neither has a mounting: frames are named and no transform comes.
    """
    names = parameters.node
    if not parameters.georeference.mounting_from_tf:
        return FrameMounting(parameters, ("from the configuration",))
    message_type = message_class(KIND)
    if message_type is None:
        words = "from the configuration; tf2_msgs is not installed, so /tf_static is not read"
        return FrameMounting(parameters, (words,))
    body_frame = names.imu_frame
    if parameters.georeference.pose_source == "odometry" and names.odometry_message == "TFMessage":
        body_frame = names.base_frame
    if not names.lidar_frame or not body_frame:
        words = (
            "from the configuration; with node.lidar_frame and node.imu_frame /tf_static is read"
        )
        return FrameMounting(parameters, (words,))
    body = "odometry" if parameters.georeference.pose_source == "odometry" else "imu"
    sensors = {"cloud": names.lidar_frame, body: body_frame, "fix": names.gnss_frame}
    frames = receive_static_frames(
        node, message_type, [(body_frame, f) for f in sensors.values() if f]
    )
    c = parameters.calibration
    silent = not any((c.boresight_roll_rad, c.boresight_pitch_rad, c.boresight_yaw_rad))
    if silent and not any(c.lever_laser_m) and not frames.pose(body_frame, names.lidar_frame):
        raise ConfigurationError(
            f"no mounting: calibration has none, and /tf_static did not lead from "
            f"'{body_frame}' to '{names.lidar_frame}' within {WAIT_S:g} s; start "
            "robot_state_publisher first, or set georeference.mounting_from_tf to false"
        )
    return from_frames(parameters, frames, sensors)


def receive_static_frames(
    node: LifecycleNode, message_type: type[Any], wanted: list[tuple[str, str]]
) -> StaticFrames:
    """The static transforms, once they lead from one frame to the other of every pair, or after
    :data:`WAIT_S`. Messages are taken here: the executor does not run while a node is configured.
    """
    frames, deadline = StaticFrames(), time.monotonic() + WAIT_S
    subscription = node.create_subscription(message_type, f"/{TOPIC}", lambda message: None, STATIC)
    try:
        while any(frames.pose(a, b) is None for a, b in wanted):
            with subscription.handle:
                taken = subscription.handle.take_message(message_type, False)
            if taken is not None:
                frames.add(taken[0])
            elif time.monotonic() > deadline:
                break
            else:
                time.sleep(LOOK_S)
    finally:
        node.destroy_subscription(subscription)
    return frames
