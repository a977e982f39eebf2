"""Paths of a UAV and a rover: smooth functions of time, attitude following from motion."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from ladar_volume.model.errors import SimulationError
from ladar_volume.simulation.scenes import Scene

F64 = npt.NDArray[np.float64]
GRAVITY = 9.81


@dataclass(frozen=True)
class Platform:
    """A true path: position of the IMU (n, 3) and roll, pitch, yaw (n, 3) at times (n,), with the
    nominal mounting.
    """

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


def _banked_attitude(position: Callable[[F64], F64]) -> Callable[[F64], F64]:
    """Roll, pitch, yaw of a UAV along a path: heading along it, banking in the turns, swaying a
    little.
    """

    def angles(t: F64) -> F64:
        velocity, acceleration = _motion(position, t)
        yaw = np.arctan2(velocity[:, 1], velocity[:, 0])
        lateral = -np.sin(yaw) * acceleration[:, 0] + np.cos(yaw) * acceleration[:, 1]
        roll = -np.arctan2(lateral, GRAVITY) + np.radians(1.0) * np.sin(2.3 * t)
        return np.column_stack([roll, np.radians(2.0) + np.radians(0.8) * np.sin(1.7 * t), yaw])

    return angles


def uav(extent: float, height: float, duration: float) -> Platform:
    """A figure of eight over the scene, banking in the turns; the scanner spins about the direction
    of flight.
    """
    turn = 2 * np.pi / max(duration, 20.0)

    def position(t: F64) -> F64:
        bob = 0.3 * np.sin(0.9 * t)
        return np.column_stack(
            [
                extent * np.sin(turn * t + 0.4),
                0.6 * extent * np.sin(2 * turn * t + 0.8),
                height + bob,
            ]
        )

    return Platform(
        "uav",
        position,
        _banked_attitude(position),
        (0.0, 90.0, 0.0),
        (0.12, 0.0, -0.15),
        (-0.10, 0.05, 0.25),
    )


def lanes(extent: float, height: float, duration: float) -> Platform:
    """Straight lanes in two directions, each flown both ways, with rounded turns: a flight whose
    strips overlap at right angles.

    Three lanes east and west, then three north and south, 0.45 of the extent apart and 2 m higher;
    constant speed.
    """
    gap, out = 0.45 * extent, extent
    east = [(s * x, y, 0.0) for s, y in ((1, -gap), (-1, 0.0), (1, gap)) for x in (-out, 0.0, out)]
    north = [
        (x, s * y, 2.0) for s, x in ((-1, gap), (1, 0.0), (-1, -gap)) for y in (-out, 0.0, out)
    ]
    points = np.array(
        [*_path_with_turns(east), (1.25 * out, 1.25 * out, 1.0), *_path_with_turns(north)]
    )
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    times = np.concatenate([[0.0], np.cumsum(steps)]) * (duration / steps.sum())
    spline = CubicSpline(times, points)

    def position(t: F64) -> F64:
        inside = np.clip(t, 0.0, duration)
        path = (
            spline(inside) + spline(inside, 1) * (t - inside)[:, None]
        )  # straight on before and after
        path[:, 2] += height + 0.3 * np.sin(0.9 * t)
        return path

    return Platform(
        "lanes",
        position,
        _banked_attitude(position),
        (0.0, 90.0, 0.0),
        (0.12, 0.0, -0.15),
        (-0.10, 0.05, 0.25),
    )


def _path_with_turns(
    waypoints: list[tuple[float, float, float]],
) -> list[tuple[float, float, float]]:
    """Waypoints in threes, one lane each, with the apex of a half circle between one lane and the
    next.
    """
    out = waypoints[:3]
    for k in range(3, len(waypoints), 3):
        (ax, ay, z), (bx, by, _), (mx, my, _) = waypoints[k - 1], waypoints[k], waypoints[k - 2]
        length = math.hypot(ax - mx, ay - my)
        half = 0.5 * math.hypot(bx - ax, by - ay)
        out += [
            (
                0.5 * (ax + bx) + half * (ax - mx) / length,
                0.5 * (ay + by) + half * (ay - my) / length,
                z,
            ),
            *waypoints[k : k + 3],
        ]
    return out


def rover(
    extent: float, duration: float, centre: tuple[float, float] = (0.0, 0.0), sense: float = 1.0
) -> Platform:
    """Two loops around a centre on a level 2 m below the mast's head, the scanner tilted to the
    left and down: towards the loop's inside for ``sense`` +1 (counter-clockwise), its outside for
    −1.
    """
    turn = 2 * np.pi / max(duration / 2.0, 12.0)
    mast = 2.0

    def position(t: F64) -> F64:
        radius = extent * (1.0 + 0.12 * np.sin(1.5 * turn * t))
        x, y = 1.15 * radius * np.cos(turn * t), sense * radius * np.sin(turn * t)
        return np.column_stack([x + centre[0], y + centre[1], mast - 0.2 + 0.01 * np.sin(3.1 * t)])

    def angles(t: F64) -> F64:
        velocity, _ = _motion(position, t)
        yaw = np.arctan2(velocity[:, 1], velocity[:, 0])
        return np.column_stack(
            [np.radians(0.8) * np.sin(2.1 * t), np.radians(0.6) * np.sin(1.3 * t + 1.0), yaw]
        )

    return Platform(
        "rover", position, angles, (-20.0, 0.0, 0.0), (0.05, 0.0, 0.20), (-0.30, 0.0, 0.10)
    )


def make_platform(name: str, extent: float, duration: float) -> Platform:
    """A platform by name, sized to the scene. Raises SimulationError for an unknown name."""
    if name == "uav":
        return uav(0.5 * extent, 25.0, duration)
    if name == "lanes":
        return lanes(0.5 * extent, 25.0, duration)
    if name == "rover":
        return rover(0.25 * extent, duration)
    raise SimulationError(f"no platform {name!r}; there are uav, lanes and rover", value=name)


def platform_for(scene: Scene, name: str, duration: float) -> Platform:
    """The platform with a path that suits the scene. Raises SimulationError where it would not see
    the body, or for an unknown name.
    """
    needed = "uav" if name == "lanes" else name
    if needed in ("uav", "rover") and needed not in scene.platforms:
        raise SimulationError(
            f"a {name} does not see enough of {scene.name}; use {' or '.join(scene.platforms)}",
            value=name,
        )
    if needed == "uav" and scene.flight_m is not None:
        return (lanes if name == "lanes" else uav)(*scene.flight_m, duration)
    if name == "rover" and scene.loop_m is not None:
        radius, x, y, sense = scene.loop_m
        return rover(radius, duration, (x, y), sense)
    return make_platform(name, scene.extent_m, duration)
