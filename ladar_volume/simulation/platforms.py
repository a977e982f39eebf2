"""Paths of a UAV and a rover: smooth functions of time, attitude following from motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from ladar_volume.model.errors import SimulationError

F64 = npt.NDArray[np.float64]
GRAVITY = 9.81


@dataclass(frozen=True)
class Platform:
    """A true path: position of the IMU (n, 3) and roll, pitch, yaw (n, 3) at times (n,), with the nominal mounting."""

    name: str
    position: Callable[[F64], F64]
    angles: Callable[[F64], F64]
    boresight_deg: tuple[float, float, float]
    lever_laser_m: tuple[float, float, float]
    lever_antenna_m: tuple[float, float, float]

    def rotation(self, t: F64) -> Rotation:
        """True body → map rotations."""
        roll, pitch, yaw = self.angles(t).T
        return Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll]))

    def rates(self, t: F64) -> F64:
        """True body rates (n, 3) rad/s, by central differences over 2 ms."""
        h = 1e-3
        before, after = self.rotation(t - h), self.rotation(t + h)
        rates: F64 = (before.inv() * after).as_rotvec() / (2 * h)
        return rates


def _motion(position: Callable[[F64], F64], t: F64) -> tuple[F64, F64]:
    h = 1e-3
    velocity = (position(t + h) - position(t - h)) / (2 * h)
    acceleration = (position(t + h) - 2 * position(t) + position(t - h)) / (h * h)
    return velocity, acceleration


def uav(extent: float, height: float, duration: float) -> Platform:
    """A figure of eight over the scene, banking in the turns; the scanner spins about the direction of flight."""
    turn = 2 * np.pi / max(duration, 20.0)

    def position(t: F64) -> F64:
        bob = 0.3 * np.sin(0.9 * t)
        return np.column_stack([extent * np.sin(turn * t + 0.4), 0.6 * extent * np.sin(2 * turn * t + 0.8), height + bob])

    def angles(t: F64) -> F64:
        velocity, acceleration = _motion(position, t)
        yaw = np.arctan2(velocity[:, 1], velocity[:, 0])
        lateral = -np.sin(yaw) * acceleration[:, 0] + np.cos(yaw) * acceleration[:, 1]
        roll = -np.arctan2(lateral, GRAVITY) + np.radians(1.0) * np.sin(2.3 * t)
        return np.column_stack([roll, np.radians(2.0) + np.radians(0.8) * np.sin(1.7 * t), yaw])

    return Platform("uav", position, angles, (0.0, 90.0, 0.0), (0.12, 0.0, -0.15), (-0.10, 0.05, 0.25))


def rover(extent: float, duration: float) -> Platform:
    """Loops around the scene's centre, the centre on the left; the scanner on a mast, tilted to the left and down."""
    turn = 2 * np.pi / max(duration / 2.0, 12.0)
    mast = 2.0

    def position(t: F64) -> F64:
        radius = extent * (1.0 + 0.12 * np.sin(1.5 * turn * t))
        return np.column_stack([1.15 * radius * np.cos(turn * t), radius * np.sin(turn * t), mast - 0.2 + 0.01 * np.sin(3.1 * t)])

    def angles(t: F64) -> F64:
        velocity, _ = _motion(position, t)
        yaw = np.arctan2(velocity[:, 1], velocity[:, 0])
        return np.column_stack([np.radians(0.8) * np.sin(2.1 * t), np.radians(0.6) * np.sin(1.3 * t + 1.0), yaw])

    return Platform("rover", position, angles, (-20.0, 0.0, 0.0), (0.05, 0.0, 0.20), (-0.30, 0.0, 0.10))


def make_platform(name: str, extent: float, duration: float) -> Platform:
    """A platform by name, sized to the scene. Raises SimulationError for an unknown name."""
    if name == "uav":
        return uav(0.5 * extent, 25.0, duration)
    if name == "rover":
        return rover(0.25 * extent, duration)
    raise SimulationError(f"no platform {name!r}; there are uav and rover", value=name)
