"""Fields of MAVLink messages → records, one message at a time, without clocks or state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ladar_volume.georeference.sample_admission import unit_quaternion
from ladar_volume.io.mavlink.mavlink_frames import (
    D,
    S,
    enu_flu_from_ned_frd,
    euler_from_matrix,
    flu_from_frd,
    local_from_frd,
    pose_covariance,
)
from ladar_volume.math.se3 import matrix_from_quaternion
from ladar_volume.model.errors import AttitudeError, InputError
from ladar_volume.model.records import F64, OdometrySample

UNKNOWN_U32 = 2**32 - 1


@dataclass(frozen=True)
class InertialSample:
    """Raw rates (rad/s) and specific force (m/s²) in the body frame, without an attitude."""

    t_ns: int
    omega_body: F64
    acceleration_body: F64


def accuracy_covariance(h_mm: int, v_mm: int, radial: bool) -> F64 | None:
    """East, north, up covariance (3, 3) m² from h_acc and v_acc in mm; None where either is unknown
    (0 or all ones).
    """
    if not (0 < h_mm < UNKNOWN_U32 and 0 < v_mm < UNKNOWN_U32):
        return None
    axis = (h_mm * 1e-3) ** 2 * (0.5 if radial else 1.0)
    return np.diag([axis, axis, (v_mm * 1e-3) ** 2])


def odometry_sample(t_ns: int, m: Any, north: bool) -> OdometrySample:
    """ODOMETRY in a local north-east-down frame (``north``) or a local forward-right-down frame,
    twist forward-right-down.

    Raises AttitudeError: odometry_nan, odometry_not_unit, odometry_covariance.
    """
    q = unit_quaternion((m.q[1], m.q[2], m.q[3], m.q[0]), "odometry")
    p, v = np.array([m.x, m.y, m.z]), np.array([m.vx, m.vy, m.vz])
    w = np.array([m.rollspeed, m.pitchspeed, m.yawspeed])
    if not np.all(np.isfinite(np.concatenate([p, v, w]))):
        raise AttitudeError("odometry is not finite", reason="odometry_nan")
    parent, R = (S if north else D), matrix_from_quaternion(q)
    C, upper = None, np.array(m.pose_covariance, dtype=np.float64)
    if np.all(np.isfinite(upper)) and np.any(upper):
        roll, pitch, _ = euler_from_matrix(R)
        C = pose_covariance(upper, roll, pitch, R, parent)
        if np.any(np.diag(C) <= 0):
            raise AttitudeError(
                "pose covariance is not positive",
                reason="odometry_covariance",
                value=np.diag(C).tolist(),
            )
    turned = enu_flu_from_ned_frd(q) if north else local_from_frd(q)
    return OdometrySample(t_ns, parent @ p, turned, flu_from_frd(v), flu_from_frd(w), C)


def inertial_sample(t_ns: int, m: Any, rate_unit: float, force_unit: float) -> InertialSample:
    """HIGHRES_IMU or RAW_IMU in the units of the message. Raises InputError (inertial_nan)."""
    omega = np.array([m.xgyro, m.ygyro, m.zgyro], dtype=np.float64) * rate_unit
    force = np.array([m.xacc, m.yacc, m.zacc], dtype=np.float64) * force_unit
    if not np.all(np.isfinite(np.concatenate([omega, force]))):
        raise InputError("inertial data is not finite", reason="inertial_nan")
    return InertialSample(t_ns, flu_from_frd(omega), flu_from_frd(force))
