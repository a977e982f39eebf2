"""The LiDAR equation (seed 004 equation 1; May & Toth 2007; Glennie 2007).

``r_map = p_antenna - R a + R (B r_laser + b)`` with ``R = R_map_body`` at the time of the return,
``a`` and ``b`` the lever arms of antenna and laser in the body frame, and the boresight ``B =
exp([correction]x) Rz(yaw) Ry(pitch) Rx(roll)``.

Angles of a return: ``x = r cos(w) cos(az)``, ``y = r cos(w) sin(az)``, ``z = r sin(w)``, so azimuth
counts from x towards y and the vertical angle w up from the x-y plane. Only increments of azimuth
enter a covariance, so a driver's own zero does not matter.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ladar_volume.math.se3 import exp_so3, rotation_xyz
from ladar_volume.model.parameters import CalibrationParameters
from ladar_volume.model.records import F64

#: Real or complex arrays.
Numbers: TypeAlias = npt.NDArray[np.inexact[Any]]


@dataclass(frozen=True)
class Mounting:
    """The LiDAR equation's constants: ``R_body_laser`` (3, 3), ``lever_laser`` b (3,) m,
    ``lever_antenna`` a (3,) m, ``clock_ns`` the clock offset dt in nanoseconds.
    """

    R_body_laser: F64
    lever_laser: F64
    lever_antenna: F64
    clock_ns: int


def mounting(calibration: CalibrationParameters, pose_source: str = "gnss_imu") -> Mounting:
    """The constants from the parameters. With ``odometry`` as pose source its own point takes the
    antenna's place: a = 0.
    """
    nominal = rotation_xyz(
        calibration.boresight_roll_rad,
        calibration.boresight_pitch_rad,
        calibration.boresight_yaw_rad,
    )
    lever_antenna = (
        np.zeros(3)
        if pose_source == "odometry"
        else np.array(calibration.lever_antenna_m, dtype=np.float64)
    )
    return Mounting(
        R_body_laser=exp_so3(np.array(calibration.boresight_correction_rad)) @ nominal,
        lever_laser=np.array(calibration.lever_laser_m, dtype=np.float64),
        lever_antenna=lever_antenna,
        clock_ns=round(calibration.clock_offset_s * 1e9),
    )


def laser_vector(range_m: Numbers, azimuth_rad: Numbers, vertical_rad: Numbers) -> Any:
    """Range (m) and angles (rad), shapes (...), real or complex -> r_laser (..., 3), m."""
    horizontal = range_m * np.cos(vertical_rad)
    return np.stack(
        [
            horizontal * np.cos(azimuth_rad),
            horizontal * np.sin(azimuth_rad),
            range_m * np.sin(vertical_rad),
        ],
        axis=-1,
    )


def angle_derivatives(r_laser: Numbers) -> Any:
    """``d r_laser / d (range, azimuth, vertical)``: (..., 3) -> (..., 3, 3), one column per
    measurement.

    On the z axis, where azimuth is undefined, it is taken as zero. A return of zero range has no
    direction: its column is NaN.
    """
    x, y, z = np.moveaxis(np.asarray(r_laser), -1, 0)
    horizontal = np.sqrt(x * x + y * y)
    axis = horizontal == 0
    safe = np.where(axis, 1.0, horizontal)
    cos_az, sin_az = np.where(axis, 1.0, x / safe), np.where(axis, 0.0, y / safe)
    distance = np.sqrt(x * x + y * y + z * z)
    with np.errstate(invalid="ignore", divide="ignore"):
        unit = np.stack([x / distance, y / distance, z / distance], axis=-1)
    d_azimuth = np.stack([-y, x, np.zeros_like(x)], axis=-1)
    d_vertical = np.stack([-z * cos_az, -z * sin_az, horizontal], axis=-1)
    return np.stack([unit, d_azimuth, d_vertical], axis=-1)


def map_point(p_antenna: Numbers, R_map_body: Numbers, r_laser: Numbers, mount: Mounting) -> Any:
    """The LiDAR equation. p_antenna (..., 3) m map frame, R_map_body (..., 3, 3), r_laser (..., 3)
    m -> r_map (..., 3), m.

    Works on complex numbers too, so a derivative can be taken by a complex step.
    """
    body = np.einsum("ij,...j->...i", mount.R_body_laser, r_laser) + (
        mount.lever_laser - mount.lever_antenna
    )
    return p_antenna + np.einsum("...ij,...j->...i", R_map_body, body)
