"""The mounting of laser and antenna from static transforms: boresight and lever arms where the
configuration says none (zeros). Where both say one, they must agree.

The body of the LiDAR equation is the frame of the attitudes: that of the IMU's messages, or the
child frame of the odometry.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ladar_volume.georeference.lidar_equation import mounting
from ladar_volume.io.frames.static_frames import (
    TOPIC,
    StaticFrames,
    angle_between,
    roll_pitch_yaw,
)
from ladar_volume.math.se3 import rotation_xyz
from ladar_volume.model.errors import ConfigurationError
from ladar_volume.model.parameters import CalibrationParameters, Parameters
from ladar_volume.model.records import F64

if TYPE_CHECKING:  # rosbags is no part of a node
    from ladar_volume.io.bags import Recording

#: Frames and configuration agree within so many sigma of the budget, and within this much.
SIGMAS, LEVER_M, BORESIGHT_RAD = 5.0, 0.02, math.radians(1.0)
#: The frame of an autopilot's attitudes.
AUTOPILOT = "base_link"


@dataclass(frozen=True)
class FrameMounting:
    """parameters : with the mounting that counts · words : what was taken from the frames, and what
    the frames do not tell, a sentence each
    """

    parameters: Parameters
    words: tuple[str, ...] = ()


def from_frames(
    parameters: Parameters, frames: StaticFrames, sensors: Mapping[str, str]
) -> FrameMounting:
    """The parameters with what the frames say. sensors : frame by role (cloud, fix, imu, odometry).

    Raises ConfigurationError where frames and configuration contradict each other, with both
    values.
    """
    odometry = parameters.georeference.pose_source == "odometry"
    body, laser = sensors.get("odometry" if odometry else "imu", ""), sensors.get("cloud", "")
    if not parameters.georeference.mounting_from_tf or not len(frames) or not body or not laser:
        return FrameMounting(parameters)
    words: list[str] = []
    calibration, budget = parameters.calibration, parameters.budget
    found = frames.pose(body, laser)
    if found is None:
        words.append(f"no static transforms lead from '{body}' to '{laser}'")
    else:
        calibration = _boresight(calibration, budget.boresight_sigma_rad, found[0], laser)
        sigmas = budget.lever_laser_sigma_m
        calibration = _lever(calibration, "lever_laser_m", sigmas, found[1], laser)
        words.append(f"mounting of '{laser}' on '{body}' from /tf_static")
    antenna = sensors.get("fix", "")
    found = frames.pose(body, antenna) if antenna and not odometry else None
    if found is not None:
        sigmas = budget.lever_antenna_sigma_m
        calibration = _lever(calibration, "lever_antenna_m", sigmas, found[1], antenna)
        words.append(f"place of '{antenna}' on '{body}' from /tf_static")
    return FrameMounting(dataclasses.replace(parameters, calibration=calibration), tuple(words))


def _lever(
    given: CalibrationParameters, key: str, sigmas: tuple[float, ...], place: F64, frame: str
) -> CalibrationParameters:
    """The lever arm ``key`` by the frames, (3,) m, where none is given."""
    own = np.array(getattr(given, key))
    if not own.any():
        found: tuple[float, ...] = tuple(place.tolist())
        if key == "lever_laser_m":
            return dataclasses.replace(given, lever_laser_m=found)
        return dataclasses.replace(given, lever_antenna_m=found)
    most = max(LEVER_M, SIGMAS * max(sigmas))
    if np.abs(own - place).max() > most:
        raise ConfigurationError(
            f"calibration.{key} is {_numbers(own)} m and /tf_static has '{frame}' at "
            f"{_numbers(place)} m: mend one of them, or set georeference.mounting_from_tf to false",
            value=own.tolist(),
        )
    return given


def _boresight(
    given: CalibrationParameters, sigmas: tuple[float, ...], R: F64, frame: str
) -> CalibrationParameters:
    """The boresight angles by the frames, R_body_laser (3, 3), where none are given."""
    own = np.array([given.boresight_roll_rad, given.boresight_pitch_rad, given.boresight_yaw_rad])
    angles = roll_pitch_yaw(R)
    if not own.any():
        roll, pitch, yaw = angles.tolist()
        return dataclasses.replace(
            given, boresight_roll_rad=roll, boresight_pitch_rad=pitch, boresight_yaw_rad=yaw
        )
    nominal = rotation_xyz(*own.tolist())
    # frames may hold the calibrated boresight, correction included
    apart = min(angle_between(R, B) for B in (nominal, mounting(given).R_body_laser))
    if apart > max(BORESIGHT_RAD, SIGMAS * max(sigmas)):
        raise ConfigurationError(
            f"calibration.boresight (roll, pitch, yaw) is {_numbers(np.degrees(own))} deg and "
            f"/tf_static turns '{frame}' by {_numbers(np.degrees(angles))} deg, "
            f"{math.degrees(apart):.1f} deg apart: mend one of them, or set "
            "georeference.mounting_from_tf to false",
            value=own.tolist(),
        )
    return given


def _numbers(values: F64) -> str:
    return ", ".join(f"{v + 0.0:.3f}" for v in values)


def mounting_of_recording(
    bag: Recording, topics: Mapping[str, str], parameters: Parameters, autopilot: bool
) -> FrameMounting:
    """The same of a recording: all its static transforms, and the frames of the first message of
    each topic by role. autopilot : attitudes come from its log, in :data:`AUTOPILOT`.
    """
    frames = StaticFrames()
    there = [t for t in bag.topics() if t.rpartition("/")[2] == TOPIC]
    if not there or not parameters.georeference.mounting_from_tf:
        return FrameMounting(parameters)
    for raw in bag.raw(set(there)):
        frames.add(bag.message(raw))
    sensors = {"imu": AUTOPILOT, "odometry": AUTOPILOT} if autopilot else {}
    for role, topic in topics.items():
        first = next(bag.raw({topic}), None)
        if first is not None:
            sensors[role] = sensor_frame(role, bag.message(first), parameters.node.base_frame)
    return from_frames(parameters, frames, sensors)


def sensor_frame(role: str, message: object, base: str = "") -> str:
    """The frame that a message of a role is of, without leading slash; ``base`` for transforms."""
    if role == "odometry":
        return str(getattr(message, "child_frame_id", base)).lstrip("/")
    return str(getattr(getattr(message, "header", None), "frame_id", "")).lstrip("/")
