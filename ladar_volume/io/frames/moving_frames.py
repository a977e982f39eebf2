"""Transforms that move, as ``/tf`` tells them: one frame in another at a time, and the pose of the
platform in the map, straight or through ``odom`` (REP-105).
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from ladar_volume.georeference.sample_admission import unit_quaternion
from ladar_volume.io.cloud_messages import stamp_ns
from ladar_volume.io.frames.static_frames import Pose, TFMessage, TransformStamped, angle_between
from ladar_volume.math.se3 import matrix_from_quaternion, quaternion_from_matrix, slerp
from ladar_volume.model.errors import AttitudeError
from ladar_volume.model.records import F64, OdometrySample

#: The topic; its type is that of the static transforms.
TOPIC = "tf"
#: How many poses of a moving frame are remembered: ten seconds at 100 Hz.
REMEMBERED = 1000
#: Poses further apart than this do not tell what was between them, ns.
LONGEST_GAP_NS = 500_000_000
#: A map that moves by more than this against odom was corrected, m and rad.
MOVED_M, MOVED_RAD = 0.05, math.radians(0.5)


def pose_of(one: TransformStamped) -> tuple[F64, F64]:
    """Quaternion (4,) and place (3,) m of a transform. Raises AttitudeError: odometry_nan,
    odometry_not_unit.
    """
    t, q = one.transform.translation, one.transform.rotation
    place = np.array([t.x, t.y, t.z])
    if not np.isfinite(place).all():
        raise AttitudeError("a transform is not finite", reason="odometry_nan", value=place)
    return unit_quaternion((q.x, q.y, q.z, q.w), "odometry"), place


def product(a: Pose, b: Pose) -> Pose:
    """The pose b in the frame in which a is given."""
    return a[0] @ b[0], a[0] @ b[1] + a[1]


def inverse(a: Pose) -> Pose:
    """The pose of a's parent in a."""
    return a[0].T, -a[0].T @ a[1]


class MovingFrame:
    """The poses of one frame in its parent, in the order of their times."""

    def __init__(self) -> None:
        self._poses: deque[tuple[int, F64, F64]] = deque(maxlen=REMEMBERED)

    def add(self, t_ns: int, q: F64, place: F64) -> None:
        """A pose: quaternion (4,), place (3,) m. One that is no later than the last is left out."""
        if not self._poses or t_ns > self._poses[-1][0]:
            self._poses.append((t_ns, q, place))

    def at(self, t_ns: int) -> Pose | None:
        """Rotation (3, 3) and place (3,) m at a time, between the two poses around it; None where
        they are missing or too far apart.
        """
        after = None
        for before in reversed(self._poses):
            if before[0] == t_ns:
                return matrix_from_quaternion(before[1]), before[2]
            if before[0] < t_ns:
                if after is None or after[0] - before[0] > LONGEST_GAP_NS:
                    return None
                share = (t_ns - before[0]) / (after[0] - before[0])
                q = slerp(before[1][None], after[1][None], np.array([share]))[0]
                return matrix_from_quaternion(q), before[2] + share * (after[2] - before[2])
            after = before
        return None


class TransformPoses:
    """The pose of a base frame in a map frame from the messages of ``/tf`` and ``/tf_static``, in
    their order. Transforms have no covariance: the budget's counts.
    """

    def __init__(self, map_frame: str, base_frame: str) -> None:
        self._map, self._base = map_frame, base_frame
        #: By frame between the two: its pose in the map, as last heard.
        self._between: dict[str, Pose] = {}

    def add(self, message: TFMessage) -> tuple[list[OdometrySample], list[str]]:
        """The poses that a message gives, and reasons of what it lacks: odometry_no_map (the parent
        of the base has no pose in the map yet), odometry_map_moved (the map was corrected against
        that parent), odometry_nan, odometry_not_unit.
        """
        samples: list[OdometrySample] = []
        reasons: list[str] = []
        for one in message.transforms:
            parent, child = one.header.frame_id.lstrip("/"), one.child_frame_id.lstrip("/")
            if child != self._base and parent != self._map:
                continue
            try:
                q, place = pose_of(one)
            except AttitudeError as error:
                reasons.append(error.reason)
                continue
            pose = matrix_from_quaternion(q), place
            if child != self._base:
                reasons += self._moved(child, pose)
            elif parent == self._map:
                samples.append(_sample(stamp_ns(one), pose))
            elif parent in self._between:
                samples.append(_sample(stamp_ns(one), product(self._between[parent], pose)))
            else:
                reasons.append("odometry_no_map")
        return samples, reasons

    def _moved(self, frame: str, pose: Pose) -> list[str]:
        """Take over the pose of a frame in the map."""
        before, self._between[frame] = self._between.get(frame), pose
        if before is None:
            return []
        apart = float(np.linalg.norm(pose[1] - before[1]))
        if apart <= MOVED_M and angle_between(before[0], pose[0]) <= MOVED_RAD:
            return []
        return ["odometry_map_moved"]


def _sample(t_ns: int, pose: Pose) -> OdometrySample:
    unknown = np.full(3, np.nan)  # the trajectory takes rates from the attitudes
    return OdometrySample(t_ns, pose[1], quaternion_from_matrix(pose[0]), unknown, unknown, None)
