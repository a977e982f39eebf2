"""NavSatFix, Imu and Odometry → records; what cannot be used is refused with a reason."""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from ladar_volume.georeference.sample_admission import unit_quaternion
from ladar_volume.io.cloud_messages import stamp_ns
from ladar_volume.io.frames.moving_frames import TransformPoses
from ladar_volume.io.frames.static_frames import TFMessage
from ladar_volume.model.errors import AttitudeError, FixError
from ladar_volume.model.losses import Losses
from ladar_volume.model.records import F64, Fix, ImuSample, OdometrySample


def _covariance(values: Any, size: int) -> F64 | None:
    """Covariance (size, size); all zeros mean unknown (REP-145, NavSatFix), never zero variance."""
    matrix = np.asarray(values, dtype=np.float64).reshape(size, size)
    return None if not np.any(matrix) else matrix.copy()


def fix_from_message(message: Any) -> Fix:
    """A NavSatFix. Raises FixError: fix_no_fix, fix_nan, fix_range, fix_zero, fix_covariance."""
    if int(message.status.status) < 0:
        raise FixError("receiver has no fix", reason="fix_no_fix", value=int(message.status.status))
    position = (float(message.latitude), float(message.longitude), float(message.altitude))
    if not np.all(np.isfinite(position)):
        raise FixError(f"fix is not finite: {position}", reason="fix_nan", value=position)
    if abs(position[0]) > 90 or abs(position[1]) > 180:
        raise FixError(
            f"latitude or longitude out of range: {position}", reason="fix_range", value=position
        )
    if position[:2] == (0.0, 0.0):
        raise FixError("latitude and longitude are 0: not set by the driver", reason="fix_zero")
    C = None
    if int(message.position_covariance_type) != 0:
        C = _covariance(message.position_covariance, 3)
        if C is not None and (not np.all(np.isfinite(C)) or np.any(np.diag(C) <= 0)):
            raise FixError(
                "position covariance is not positive",
                reason="fix_covariance",
                value=np.diag(C).tolist(),
            )
    return Fix(stamp_ns(message), *position, C, int(message.status.status))


def _quaternion(q: Any, unit: str) -> F64:
    return unit_quaternion((q.x, q.y, q.z, q.w), unit)


def _vector(v: Any) -> F64:
    return np.array([v.x, v.y, v.z], dtype=np.float64)


def imu_from_message(message: Any) -> ImuSample:
    """An Imu with orientation body → ENU. Raises AttitudeError: imu_no_orientation, imu_nan,
    imu_not_unit, imu_covariance.
    """
    if float(message.orientation_covariance[0]) == -1.0:
        raise AttitudeError(
            "orientation_covariance[0] is -1: no orientation", reason="imu_no_orientation"
        )
    q = _quaternion(message.orientation, "imu")
    omega = _vector(message.angular_velocity)
    if float(message.angular_velocity_covariance[0]) == -1.0 or not np.all(np.isfinite(omega)):
        omega = np.full(3, np.nan)  # the trajectory then takes the rate from the attitudes
    C = _covariance(message.orientation_covariance, 3)
    if C is not None and (not np.all(np.isfinite(C)) or np.any(np.diag(C) <= 0)):
        raise AttitudeError(
            "orientation covariance is not positive",
            reason="imu_covariance",
            value=np.diag(C).tolist(),
        )
    return ImuSample(stamp_ns(message), q, omega, C)


def odometry_from_message(message: Any) -> OdometrySample:
    """A nav_msgs/Odometry; a twist of zeros alone is unknown. Raises AttitudeError: odometry_nan,
    odometry_not_unit, odometry_covariance.
    """
    q = _quaternion(message.pose.pose.orientation, "odometry")
    p, v, omega = (
        _vector(message.pose.pose.position),
        _vector(message.twist.twist.linear),
        _vector(message.twist.twist.angular),
    )
    if not np.all(np.isfinite(np.concatenate([p, v, omega]))):
        raise AttitudeError("odometry is not finite", reason="odometry_nan", value=p)
    if not v.any() and not omega.any():  # a twist that the driver does not fill, or a stand
        omega = np.full(3, np.nan)
    C = _covariance(message.pose.covariance, 6)
    if C is not None and (not np.all(np.isfinite(C)) or np.any(np.diag(C) < 0)):
        raise AttitudeError(
            "pose covariance is not positive",
            reason="odometry_covariance",
            value=np.diag(C).tolist(),
        )
    return OdometrySample(stamp_ns(message), p, q, v, omega, C)


def poses_from_message(
    message: object, transforms: TransformPoses, losses: Losses
) -> list[OdometrySample]:
    """The poses of a nav_msgs/Odometry, or of a tf2_msgs/TFMessage by those before it
    (:class:`TransformPoses`, whose reasons are counted). Raises as :func:`odometry_from_message`.
    """
    if not hasattr(message, "transforms"):
        return [odometry_from_message(message)]
    samples, reasons = transforms.add(cast(TFMessage, message))
    for reason in reasons:
        losses.add(reason)
    return samples
