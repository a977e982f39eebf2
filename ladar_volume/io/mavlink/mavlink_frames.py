"""North-east-down and forward-right-down, as MAVLink has them, to east-north-up and
forward-left-up. Nothing else converts them.

With S : NED → ENU (swap of x and y, z reversed) and D : FRD → FLU (y and z reversed), both half
turns and their own inverses, ``R_enu_flu = S R_ned_frd D``. Quaternions xyzw here; MAVLink sends
wxyz.
"""

from __future__ import annotations

import math

import numpy as np

from ladar_volume.math.se3 import euler_rate_matrix, multiply_quaternions
from ladar_volume.model.records import F64

S = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
D = np.diag([1.0, -1.0, -1.0])
_Q_S = np.array([math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0])
_Q_D = np.array([1.0, 0.0, 0.0, 0.0])
_UPPER = np.triu_indices(6)


def quaternion_from_euler(roll: float, pitch: float, yaw: float) -> F64:
    """Quaternion (4,) xyzw of ``Rz(yaw) Ry(pitch) Rx(roll)``, angles in rad."""
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return np.array(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ]
    )


def enu_flu_from_ned_frd(q_ned_frd: F64) -> F64:
    """Attitude forward-right-down → north-east-down to forward-left-up → east-north-up, (4,)
    xyzw.
    """
    return multiply_quaternions(_Q_S, multiply_quaternions(q_ned_frd, _Q_D))


def flu_from_frd(v: F64) -> F64:
    """A vector (3,) of the body, or of a local forward-right-down frame."""
    return D @ v


def local_from_frd(q_frd: F64) -> F64:
    """Attitude in a local forward-right-down frame to one in its forward-left-up twin, (4,)
    xyzw.
    """
    return multiply_quaternions(_Q_D, multiply_quaternions(q_frd, _Q_D))


def pose_covariance(upper: F64, roll: float, pitch: float, R_parent_body: F64, parent: F64) -> F64:
    """ODOMETRY's covariance of (x, y, z, roll, pitch, yaw) as that of position and rotation about
    the parent's fixed axes, (6, 6).

    upper : (21,) upper triangle by rows · R_parent_body : (3, 3), both frames as MAVLink has them ·
    parent : ``S`` for a north-east-down parent, ``D`` for forward-right-down. A small change of the
    three angles turns the body by ``euler_rate_matrix`` times it, and the parent's axes see that
    through ``R_parent_body``.
    """
    C = np.zeros((6, 6))
    C[_UPPER] = upper
    C = C + np.triu(C, 1).T
    T = np.zeros((6, 6))
    T[:3, :3] = parent
    T[3:, 3:] = parent @ R_parent_body @ euler_rate_matrix(roll, pitch)
    result: F64 = T @ C @ T.T
    return result


def euler_from_matrix(R: F64) -> tuple[float, float, float]:
    """Roll, pitch, yaw in rad of ``Rz(yaw) Ry(pitch) Rx(roll)``."""
    pitch = math.asin(min(1.0, max(-1.0, -float(R[2, 0]))))
    return math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])
