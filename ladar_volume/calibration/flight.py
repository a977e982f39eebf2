"""A flight as self-calibration needs it: returns in the laser frame, the platform's path, and the
path cut into strips.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ladar_volume.georeference.lidar_equation import Mounting
from ladar_volume.georeference.mapping import MAPPED, map_returns, region_box, vehicle_box
from ladar_volume.georeference.point_jacobian import PointGeometry, point_geometry
from ladar_volume.georeference.trajectory import PathWindow
from ladar_volume.math.se3 import exp_so3, matrix_from_quaternion
from ladar_volume.model.errors import CalibrationError
from ladar_volume.model.records import F64, I64, MappedPoints, PlatformStates, select

#: A strip ends where heading or course has turned by this much from its beginning (rad) ...
STRIP_TURN_RAD = np.radians(30.0)
#: ... or after this long (s): what drifts in time must be seen to drift.
STRIP_S = 30.0
#: Below this speed (m/s) the course says nothing.
_SLOW = 0.5
#: Half the time (s) over which positions are taken for one velocity.
_WINDOW_S = 0.5

U16 = npt.NDArray[np.uint16]


@dataclass(frozen=True)
class Flight:
    """t_ns : (n,) int64 ns, LiDAR time of the returns · r_laser : (n, 3) m · ring : (n,) · states :
    the path, built with ``mount`` · strip : (len(states),) number of the strip each state belongs
    to · mount : the constants the survey was read with · fix_hz : rate of the position fixes
    """

    t_ns: I64
    r_laser: F64
    ring: U16
    states: PlatformStates
    strip: I64
    mount: Mounting
    fix_hz: float


def flight(points: MappedPoints, states: PlatformStates, mount: Mounting, fix_hz: float) -> Flight:
    """A flight from points mapped with ``mount`` and the states at their times.

    Raises :class:`CalibrationError` (calibration_no_returns) where no point lies between two
    states.
    """
    geometry = point_geometry(points, states, mount)
    if not geometry.covered.any():
        raise CalibrationError(
            "no return lies within the trajectory",
            reason="calibration_no_returns",
            value=len(points),
        )
    kept = select(points, geometry.covered)
    r_laser = geometry.v_body[geometry.covered] @ mount.R_body_laser
    return Flight(
        kept.t_ns - mount.clock_ns,
        r_laser,
        kept.ring,
        smooth_velocity(states, mount),
        strips(states),
        mount,
        fix_hz,
    )


def smooth_velocity(states: PlatformStates, mount: Mounting) -> PlatformStates:
    """The states with the velocity of their antenna from the positions within half a second, by
    least squares.

    Between two fixes the path has their noise as velocity, 0.1 m/s and more. As sensitivity to the
    clock it would be taken for information: an offset would look better determined than it is, and
    be biased.
    """
    R = matrix_from_quaternion(states.q_map_body)
    antenna = states.p_map_body + R @ mount.lever_antenna
    t = (states.t_ns - states.t_ns[0]) * 1e-9
    # windows end where the segment does
    begin = np.searchsorted(states.segment, states.segment, side="left")
    end = np.searchsorted(states.segment, states.segment, side="right")
    first = np.maximum(np.searchsorted(t, t - _WINDOW_S), begin)
    last = np.minimum(np.searchsorted(t, t + _WINDOW_S, side="right"), end)
    velocity = np.einsum(
        "nij,nj->ni", R, states.v_body + np.cross(states.omega_body, mount.lever_antenna)
    )
    for i in np.flatnonzero(last - first >= 3):
        part = slice(first[i], last[i])
        s = t[part] - t[part].mean()
        velocity[i] = s @ antenna[part] / (s @ s)
    v_body = np.einsum("nji,nj->ni", R, velocity) - np.cross(states.omega_body, mount.lever_antenna)
    return dataclasses.replace(states, v_body=v_body)


def strips(states: PlatformStates) -> I64:
    """Number of the strip of every state (n,), ascending in time: a strip keeps heading and course
    within 30° and lasts 30 s at most.
    """
    R = matrix_from_quaternion(states.q_map_body)
    velocity = np.einsum("nij,nj->ni", R, states.v_body)
    slow = np.hypot(velocity[:, 0], velocity[:, 1]) < _SLOW
    heading = np.arctan2(R[:, 1, 0], R[:, 0, 0])
    course = np.where(slow, heading, np.arctan2(velocity[:, 1], velocity[:, 0]))
    out = np.zeros(len(states), np.int64)
    begin = 0
    for i in range(1, len(states)):
        turned = max(
            _angle_between(heading[i], heading[begin]), _angle_between(course[i], course[begin])
        )
        late = states.t_ns[i] - states.t_ns[begin] > STRIP_S * 1e9
        new = turned > STRIP_TURN_RAD or late or states.segment[i] != states.segment[begin]
        begin = i if new else begin
        out[i] = out[i - 1] + int(new)
    return out


def _angle_between(a: float, b: float) -> float:
    return float(abs((a - b + np.pi) % (2 * np.pi) - np.pi))


def apply_corrections(mount: Mounting, theta: F64) -> Mounting:
    """The constants corrected by theta (c,) in the order of CAL_COLUMNS; its range bias and beams
    have no constant and are left alone.
    """
    return Mounting(
        R_body_laser=exp_so3(theta[1:4]) @ mount.R_body_laser,
        lever_laser=mount.lever_laser + theta[4:7],
        lever_antenna=mount.lever_antenna + theta[7:10],
        clock_ns=mount.clock_ns + round(float(theta[10]) * 1e9),
    )


def remap_returns(
    flight: Flight, theta: F64, sigmas: F64
) -> tuple[MappedPoints, PointGeometry, I64]:
    """The returns georeferenced anew with constants corrected by theta (c,): points, geometry, and
    their index (n,) in the flight.

    Positions are linear between states, which are as dense as the attitudes. ``sigmas`` (3,) as
    ``error_budget.independent_sigmas``.
    """
    mount, states = apply_corrections(flight.mount, theta), flight.states
    R = matrix_from_quaternion(states.q_map_body)
    antenna = states.p_map_body + R @ flight.mount.lever_antenna
    moved = dataclasses.replace(states, p_map_body=antenna - R @ mount.lever_antenna)
    still = np.zeros_like(antenna)  # the velocities of linear positions are not asked
    path = PathWindow(
        states.t_ns,
        states.q_map_body,
        states.segment,
        states.t_ns,
        antenna,
        still,
        still,
        False,
    )
    t_ns = flight.t_ns + mount.clock_ns
    mapped = map_returns(t_ns, flight.r_laser, path, mount, sigmas, vehicle_box(()), region_box(()))
    everything = MappedPoints(
        t_ns, mapped.r_map, mapped.C_ind, flight.ring, np.zeros(len(t_ns), np.float32)
    )
    index = np.flatnonzero(mapped.status == MAPPED)
    points = select(everything, index)
    return points, point_geometry(points, moved, mount), index
