"""Rotations and rigid transforms. Quaternions are xyzw; every function works on stacks (leading
axes).

Perturbations are right (body-side): ``R_perturbed = R @ exp([delta]x)``.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def skew(v: Array) -> Array:
    """Cross-product matrices ``[v]x``. v : (..., 3) -> (..., 3, 3), with ``skew(a) @ b == cross(a,
    b)``.
    """
    v = np.asarray(v)
    out = np.zeros((*v.shape[:-1], 3, 3), dtype=v.dtype)
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def rotation_xyz(roll: float, pitch: float, yaw: float) -> Array:
    """``Rz(yaw) @ Ry(pitch) @ Rx(roll)``, angles in rad -> (3, 3)."""
    cr, sr, cp, sp, cy, sy = (
        np.cos(roll),
        np.sin(roll),
        np.cos(pitch),
        np.sin(pitch),
        np.cos(yaw),
        np.sin(yaw),
    )
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def exp_so3(rotvec: Array) -> Array:
    """Rotation matrices of rotation vectors (rad). rotvec : (..., 3) -> (..., 3, 3)."""
    rotvec = np.asarray(rotvec, dtype=np.float64)
    angle2 = np.sum(rotvec * rotvec, axis=-1)[..., None, None]
    angle = np.sqrt(angle2)
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 1.0 - angle2 / 6.0 + angle2 * angle2 / 120.0, np.sin(safe) / safe)
    b = np.where(
        small, 0.5 - angle2 / 24.0 + angle2 * angle2 / 720.0, (1.0 - np.cos(safe)) / (safe * safe)
    )
    k = skew(rotvec)
    result: Array = np.eye(3) + a * k + b * (k @ k)
    return result


def matrix_from_quaternion(q: Array) -> Array:
    """Rotation matrices of unit quaternions xyzw. q : (..., 4) -> (..., 3, 3)."""
    x, y, z, w = np.moveaxis(np.asarray(q, dtype=np.float64), -1, 0)
    out = np.empty((*np.shape(x), 3, 3))
    out[..., 0, 0] = 1 - 2 * (y * y + z * z)
    out[..., 0, 1] = 2 * (x * y - z * w)
    out[..., 0, 2] = 2 * (x * z + y * w)
    out[..., 1, 0] = 2 * (x * y + z * w)
    out[..., 1, 1] = 1 - 2 * (x * x + z * z)
    out[..., 1, 2] = 2 * (y * z - x * w)
    out[..., 2, 0] = 2 * (x * z - y * w)
    out[..., 2, 1] = 2 * (y * z + x * w)
    out[..., 2, 2] = 1 - 2 * (x * x + y * y)
    return out


def quaternion_from_matrix(R: Array) -> Array:
    """Unit quaternion xyzw with w >= 0 of one rotation matrix (3, 3) -> (4,)."""
    k = np.array(
        [
            [R[0, 0] - R[1, 1] - R[2, 2], 0, 0, 0],
            [R[0, 1] + R[1, 0], R[1, 1] - R[0, 0] - R[2, 2], 0, 0],
            [R[0, 2] + R[2, 0], R[1, 2] + R[2, 1], R[2, 2] - R[0, 0] - R[1, 1], 0],
            [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], R[0, 0] + R[1, 1] + R[2, 2]],
        ]
    )
    # Bar-Itzhack's symmetric matrix: its dominant eigenvector is the quaternion, stable at every
    # angle.
    q: Array = np.linalg.eigh(k / 3.0)[1][:, -1]
    return -q if q[3] < 0 else q


def multiply_quaternions(a: Array, b: Array) -> Array:
    """Hamilton product of xyzw quaternions: the rotation ``R(a) @ R(b)``. (..., 4), (..., 4) ->
    (..., 4).
    """
    ax, ay, az, aw = np.moveaxis(np.asarray(a, dtype=np.float64), -1, 0)
    bx, by, bz, bw = np.moveaxis(np.asarray(b, dtype=np.float64), -1, 0)
    return np.stack(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ],
        axis=-1,
    )


def slerp(q0: Array, q1: Array, fraction: Array) -> Array:
    """Spherical linear interpolation on the shorter arc. q0, q1 : (..., 4) xyzw; fraction : (...)
    in [0, 1].
    """
    q0, q1 = np.asarray(q0, dtype=np.float64), np.asarray(q1, dtype=np.float64)
    f = np.asarray(fraction, dtype=np.float64)[..., None]
    dot = np.sum(q0 * q1, axis=-1, keepdims=True)
    q1 = np.where(dot < 0, -q1, q1)
    dot = np.clip(np.abs(dot), 0.0, 1.0)
    angle = np.arccos(dot)
    near = dot > 1.0 - 1e-9  # there the sines cancel; linear interpolation is exact to 1e-14
    sine = np.where(near, 1.0, np.sin(angle))
    w0 = np.where(near, 1.0 - f, np.sin((1.0 - f) * angle) / sine)
    w1 = np.where(near, f, np.sin(f * angle) / sine)
    q = w0 * q0 + w1 * q1
    result: Array = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return result


def euler_rate_matrix(roll: float, pitch: float) -> Array:
    """Body rotation vector per small change of (roll, pitch, yaw) for ``Rz Ry Rx``: (3, 3).

    ``delta_body = E @ (d_roll, d_pitch, d_yaw)``; used to map Euler-angle sigmas to the body
    rotation vector.
    """
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    return np.array([[1.0, 0.0, -sp], [0.0, cr, sr * cp], [0.0, -sr, cr * cp]])
