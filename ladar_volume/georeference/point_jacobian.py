"""How one mapped point moves with every error source: the Jacobians of UNCERTAINTY's list, and the
point covariance.

With ``v = B r_laser`` and body-side perturbations: position I, attitude ``-R [v + b - a]x``,
boresight ``-R [v]x``, b ``R``, a ``-R``, range ``R B u``, angles through r_laser, clock ``antenna
velocity + R (omega x (v + b - a))``. Every array is stacked over points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ladar_volume.georeference.error_budget import calibration_covariance
from ladar_volume.georeference.lidar_equation import Mounting, angle_derivatives, mounting
from ladar_volume.math.packed_covariance import pack, unpack
from ladar_volume.math.se3 import matrix_from_quaternion, skew, slerp
from ladar_volume.model.parameters import CalibrationParameters, Parameters
from ladar_volume.model.records import (
    CAL_COLUMNS,
    F32,
    F64,
    I64,
    Bool,
    MappedPoints,
    PlatformStates,
    select,
)


@dataclass(frozen=True)
class PointGeometry:
    """What the Jacobians need, per point.

    covered : (n,) bool, whether two platform states of one segment enclose the point; the other
    rows hold NaN · R_map_body : (n, 3, 3) · v_body : (n, 3) m, ``B r_laser``, laser to target in
    the body frame · velocity_map : (n, 3) m/s, velocity of the antenna · omega_body : (n, 3) rad/s
    · state : (n,) int64, index of the platform state before the point · fraction : (n,) share of
    the way to the next · mount : the LiDAR equation's constants
    """

    covered: Bool
    R_map_body: F64
    v_body: F64
    velocity_map: F64
    omega_body: F64
    state: I64
    fraction: F64
    mount: Mounting

    def __len__(self) -> int:
        return len(self.covered)


def bracket(t_ns: I64, knots_ns: I64, segment: I64) -> tuple[Bool, I64, F64]:
    """Where times lie between states: covered (n,), index of the state before (n,), fraction (n,)
    in [0, 1).

    A time is covered between two states of one segment, or exactly at a state. Segments < 0 are no
    states.
    """
    n = len(knots_ns)
    if n == 0:
        return np.zeros(len(t_ns), bool), np.zeros(len(t_ns), np.int64), np.full(len(t_ns), np.nan)
    before = np.searchsorted(knots_ns, t_ns, side="right") - 1
    k = np.clip(before, 0, n - 1)
    after = np.minimum(k + 1, n - 1)
    exact = knots_ns[k] == t_ns
    between = (before >= 0) & (before < n - 1) & (segment[k] == segment[after])
    covered = (exact | between) & (segment[k] >= 0)
    span = np.maximum(knots_ns[after] - knots_ns[k], 1)
    fraction = np.where(covered & ~exact, (t_ns - knots_ns[k]) / span, 0.0)
    return covered, k, fraction


def interpolate_poses(states: PlatformStates, k: I64, f: F64) -> tuple[F64, F64]:
    """Rotations (n, 3, 3), map from body, and places (n, 3) m a share f (n,) of the way from states
    k (n,) to those after them.
    """
    after = np.minimum(k + 1, len(states) - 1)
    R = matrix_from_quaternion(slerp(states.q_map_body[k], states.q_map_body[after], f))
    p = states.p_map_body
    return R, p[k] + f[:, None] * (p[after] - p[k])


def point_geometry(
    points: MappedPoints, states: PlatformStates, calibration: CalibrationParameters | Mounting
) -> PointGeometry:
    """The geometry of mapped points, recovered from their positions and the platform states at
    their times.

    Pass a :class:`Mounting` (from ``mounting(calibration, pose_source)``) where odometry is the
    pose source, so that a = 0. Position and velocity are linear between states, attitude is
    slerped.
    """
    mount = calibration if isinstance(calibration, Mounting) else mounting(calibration)
    covered, k, f = bracket(points.t_ns, states.t_ns, states.segment)
    n = len(points)
    if len(states) == 0:
        nan3 = np.full((n, 3), np.nan)
        return PointGeometry(
            covered, np.full((n, 3, 3), np.nan), nan3, nan3.copy(), nan3.copy(), k, f, mount
        )
    nxt = np.minimum(k + 1, len(states) - 1)

    def linear(values: F64) -> F64:
        out: F64 = values[k] + f[:, None] * (values[nxt] - values[k])
        return out

    R, place = interpolate_poses(states, k, f)
    omega = linear(states.omega_body)
    v_body = np.einsum("nji,nj->ni", R, points.r_map - place) - mount.lever_laser
    # the antenna moves with the IMU origin and turns about it
    velocity = np.einsum(
        "nij,nj->ni", R, linear(states.v_body) + np.cross(omega, mount.lever_antenna)
    )
    for array in (R, v_body, velocity, omega):
        array[~covered] = np.nan
    return PointGeometry(covered, R, v_body, velocity, omega, k, f, mount)


def navigation_jacobian(geometry: PointGeometry) -> F64:
    """``d r_map / d (antenna position, attitude)`` in NAV_COLUMNS order: (n, 3, 6); 1 and m/rad."""
    out = np.empty((len(geometry), 3, 6))
    out[:, :, :3] = np.eye(3)
    arm = geometry.v_body + (geometry.mount.lever_laser - geometry.mount.lever_antenna)
    out[:, :, 3:] = -geometry.R_map_body @ skew(arm)
    return out


def measurement_jacobian(geometry: PointGeometry) -> F64:
    """``d r_map / d (range, azimuth, vertical angle)``: (n, 3, 3); 1, m/rad, m/rad."""
    B = geometry.mount.R_body_laser
    d_laser = angle_derivatives(geometry.v_body @ B)  # v Bᵀ-transposed: r_laser = Bᵀ v
    out: F64 = geometry.R_map_body @ (B @ d_laser)
    return out


def calibration_jacobian(geometry: PointGeometry) -> F64:
    """``d r_map / d theta`` for the columns shared by all beams, CAL_COLUMNS order: (n, 3, 11); 1,
    m/rad, m/s.
    """
    R, mount = geometry.R_map_body, geometry.mount
    arm = geometry.v_body + (mount.lever_laser - mount.lever_antenna)
    out = np.empty((len(geometry), 3, len(CAL_COLUMNS)))
    out[:, :, 0] = np.einsum(
        "nij,nj->ni", R, geometry.v_body / np.linalg.norm(geometry.v_body, axis=1, keepdims=True)
    )
    out[:, :, 1:4] = -R @ skew(geometry.v_body)
    out[:, :, 4:7] = R
    out[:, :, 7:10] = -R
    out[:, :, 10] = geometry.velocity_map + np.einsum(
        "nij,nj->ni", R, np.cross(geometry.omega_body, arm)
    )
    return out


def beam_jacobian(geometry: PointGeometry) -> F64:
    """``d r_map / d (rho_k, eps_k)`` of the point's own beam: (n, 3, 2); 1 and m/rad. All other
    beams' columns are zero.
    """
    return measurement_jacobian(geometry)[:, :, [0, 2]]


def full_calibration_jacobian(
    geometry: PointGeometry, ring: npt.NDArray[np.uint16], beams: int
) -> F64:
    """All calibration columns, beams included, in the order of
    ``error_budget.calibration_columns``: (n, 3, 11 + 2 beams).
    """
    shared, own = len(CAL_COLUMNS), beam_jacobian(geometry)
    rows, k = np.arange(len(geometry)), ring.astype(np.int64)
    out = np.zeros((len(geometry), 3, shared + 2 * beams))
    out[:, :, :shared] = calibration_jacobian(geometry)
    out[rows, :, shared + k] = own[:, :, 0]
    out[rows, :, shared + beams + k] = own[:, :, 1]
    return out


def navigation_covariance_at(geometry: PointGeometry, states: PlatformStates) -> F64:
    """C_nav (n, 6, 6) at the points' times, linear between the states around."""
    nxt = np.minimum(geometry.state + 1, len(states) - 1)
    f = geometry.fraction[:, None, None]
    out: F64 = states.C_nav[geometry.state] * (1.0 - f) + states.C_nav[nxt] * f
    return out


def independent_covariance(geometry: PointGeometry, sigmas: F64) -> F64:
    """C_ind (n, 3, 3) m² of range, azimuth and vertical noise ``sigmas`` (3,) (from
    ``error_budget.independent_sigmas``).
    """
    J = measurement_jacobian(geometry) * sigmas
    out: F64 = J @ np.swapaxes(J, 1, 2)
    return out


def point_covariance(
    geometry: PointGeometry,
    ring: npt.NDArray[np.uint16],
    C_ind: F64,
    C_nav: F64,
    C_cal: F64,
    chunk: int = 4096,
) -> F64:
    """C_point (n, 3, 3) m²: one point, all sources, ``C_ind + J_nav C_nav J_navᵀ + J_cal C_cal
    J_calᵀ``.

    C_ind (n, 3, 3), C_nav (n, 6, 6), C_cal (c, c) with c = 11 + 2 beams. For one point only: points
    share the last two terms.
    """
    beams = (len(C_cal) - len(CAL_COLUMNS)) // 2
    J_nav = navigation_jacobian(geometry)
    out: F64 = C_ind + J_nav @ C_nav @ np.swapaxes(J_nav, 1, 2)
    for start in range(0, len(geometry), chunk):  # the full Jacobian takes a kilobyte per point
        part = slice(start, start + chunk)
        J = full_calibration_jacobian(select(geometry, part), ring[part], beams)
        out[part] += J @ C_cal @ np.swapaxes(J, 1, 2)
    return out


def total_covariance(points: MappedPoints, states: PlatformStates, parameters: Parameters) -> F32:
    """C_point packed (n, 6) float32 m² of mapped points, for consumers that look at one point at a
    time; NaN where no states enclose it.

    ``states`` must reach from before the first to after the last point. Never feed this to the
    filter as C_ind: neighbouring points share most of it.
    """
    p = parameters.georeference
    geometry = point_geometry(points, states, mounting(parameters.calibration, p.pose_source))
    if not geometry.covered.any():
        return np.full((len(points), 6), np.nan, np.float32)
    C_cal = calibration_covariance(parameters.budget, p.beams, p.pose_source)
    C = point_covariance(
        geometry,
        points.ring,
        unpack(points.C_ind),
        navigation_covariance_at(geometry, states),
        C_cal,
    )
    return pack(C).astype(np.float32)
