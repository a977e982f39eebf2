"""The tree of static transforms, as ``/tf_static`` tells it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from ladar_volume.georeference.sample_admission import unit_quaternion
from ladar_volume.math.se3 import matrix_from_quaternion
from ladar_volume.model.errors import AttitudeError, InputError
from ladar_volume.model.records import F64

#: The topic, and its type.
TOPIC, KIND = "tf_static", "tf2_msgs/msg/TFMessage"


class Vector(Protocol):
    """geometry_msgs/Vector3."""

    x: float
    y: float
    z: float


class Quaternion(Vector, Protocol):
    """geometry_msgs/Quaternion."""

    w: float


class Transform(Protocol):
    """geometry_msgs/Transform."""

    translation: Vector
    rotation: Quaternion


class Header(Protocol):
    """std_msgs/Header."""

    frame_id: str


class TransformStamped(Protocol):
    """geometry_msgs/TransformStamped."""

    header: Header
    child_frame_id: str
    transform: Transform


class TFMessage(Protocol):
    """tf2_msgs/TFMessage."""

    transforms: Sequence[TransformStamped]


Pose = tuple[F64, F64]


class StaticFrames:
    """Fed with messages; asked for the pose of one frame in another."""

    def __init__(self) -> None:
        #: By frame: its parent, and its pose there: rotation (3, 3) and place (3,) m.
        self._parents: dict[str, tuple[str, Pose]] = {}

    def __len__(self) -> int:
        return len(self._parents)

    def add(self, message: TFMessage) -> None:
        """Take over all transforms; of one frame the last counts, as tf2 has it. Raises InputError
        (tf_transform) for one that is none.
        """
        for one in message.transforms:
            t, q = one.transform.translation, one.transform.rotation
            place, child = np.array([t.x, t.y, t.z]), one.child_frame_id.lstrip("/")
            try:
                turn = unit_quaternion((q.x, q.y, q.z, q.w), f"static transform to {child!r}")
            except AttitudeError as error:
                raise InputError(str(error), reason="tf_transform", value=child) from error
            if not np.isfinite(place).all():
                raise InputError(
                    f"static transform to {child!r}: place {place.tolist()}",
                    reason="tf_transform",
                    value=child,
                )
            pose = matrix_from_quaternion(turn), place
            self._parents[child] = (one.header.frame_id.lstrip("/"), pose)

    def _to_root(self, frame: str) -> dict[str, Pose]:
        """The frame's pose in itself and in each frame above it."""
        poses = {frame: (np.eye(3), np.zeros(3))}
        R, t = poses[frame]
        while frame in self._parents:
            frame, (R_up, t_up) = self._parents[frame]
            if frame in poses:  # a circle
                break
            R, t = R_up @ R, R_up @ t + t_up
            poses[frame] = R, t
        return poses

    def pose(self, frame: str, of: str) -> Pose | None:
        """Rotation (3, 3) and origin (3,) m of the frame ``of`` in ``frame``; None where no static
        transforms lead from one to the other.
        """
        here, there = self._to_root(frame.lstrip("/")), self._to_root(of.lstrip("/"))
        common = next((name for name in here if name in there), None)
        if common is None:
            return None
        (R_a, t_a), (R_b, t_b) = here[common], there[common]
        return R_a.T @ R_b, R_a.T @ (t_b - t_a)


def roll_pitch_yaw(R: F64) -> F64:
    """Angles (3,) rad of R (3, 3) = Rz(yaw) Ry(pitch) Rx(roll)."""
    pitch = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0]))
    if abs(math.cos(pitch)) < 1e-9:  # roll and yaw turn about one axis: all is yaw
        return np.array([0.0, pitch, math.atan2(-R[0, 1], R[1, 1])])
    return np.array([math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])])


def angle_between(A: F64, B: F64) -> float:
    """Angle (rad) of the rotation from A to B, (3, 3) each."""
    return float(np.arccos(np.clip((np.trace(A.T @ B) - 1.0) / 2.0, -1.0, 1.0)))
