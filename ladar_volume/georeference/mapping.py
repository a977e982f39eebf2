"""One pass over a cloud: pose at each return, LiDAR equation, own-vehicle and region masks, C_ind.

:func:`map_returns` is the compiled kernel, :func:`map_returns_numpy` its plain twin.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from ladar_volume.georeference.lidar import Mounting, angle_derivatives
from ladar_volume.georeference.sensitivity import bracket, pack
from ladar_volume.georeference.trajectory import PathWindow, interpolate_position
from ladar_volume.model.kernels import kernel, parallel_kernel
from ladar_volume.model.records import F32, F64, I64
from ladar_volume.model.se3 import matrix_from_quaternion, slerp

#: What became of a return.
MAPPED, NO_POSE, IN_VEHICLE, OUTSIDE_REGION = 0, 1, 2, 3
#: Points per parallel chunk: each chunk walks along the knots with a hint instead of searching.
_CHUNK = 1024
_NEAR = 1.0 - 1e-9  # there the sines cancel; linear interpolation is exact to 1e-14


@dataclass(frozen=True)
class Mapped:
    """r_map : (n, 3) m · C_ind : (n, 6) float32 m² · status : (n,) uint8, rows other than MAPPED hold NaN or are to be dropped."""

    r_map: F64
    C_ind: F32
    status: npt.NDArray[np.uint8]


@kernel
def _at(t: Any, value: Any, hint: Any) -> Any:
    """Index of the last knot not after ``value``, −1 where all are later; ``hint`` is tried first."""
    n = len(t)
    if hint >= 0 and t[hint] <= value:
        if hint + 1 >= n or value < t[hint + 1]:
            return hint
        if hint + 2 >= n or value < t[hint + 2]:
            return hint + 1
    lo, hi = 0, n
    while lo < hi:
        mid = (lo + hi) >> 1
        if t[mid] <= value:
            lo = mid + 1
        else:
            hi = mid
    return lo - 1


@parallel_kernel
def _map(
    t_ns: Any, r_laser: Any, st: Any, sq: Any, sg: Any, pt: Any, pp: Any, pm: Any, hermite: Any, B: Any, arm: Any, b: Any, sigmas: Any,
    vehicle: Any, region: Any, r_map: Any, C_ind: Any, status: Any,
) -> None:  # fmt: skip
    # one long function: it is one pass over scalars, and pieces of it would hand two dozen of them to each other
    n, ns = len(t_ns), len(st)
    for chunk in numba.prange((n + _CHUNK - 1) // _CHUNK):
        k = j = -1
        theta, inv_sine, sign, near = 0.0, 1.0, 1.0, True
        for i in range(chunk * _CHUNK, min(n, (chunk + 1) * _CHUNK)):
            t = t_ns[i]
            k_new = _at(st, t, k)
            covered = k_new >= 0 and sg[k_new] >= 0
            if covered and st[k_new] != t:
                covered = k_new + 1 < ns and sg[k_new] == sg[k_new + 1]
            if not covered:
                status[i] = NO_POSE
                r_map[i, :] = np.nan
                C_ind[i, :] = np.nan
                continue
            if k_new != k and k_new + 1 < ns:  # constants of the slerp, once per interval
                dot = 0.0
                for c in range(4):
                    dot += sq[k_new, c] * sq[k_new + 1, c]
                sign = -1.0 if dot < 0.0 else 1.0
                dot = min(abs(dot), 1.0)
                near = dot > _NEAR
                theta = np.arccos(dot)
                inv_sine = 1.0 if near else 1.0 / np.sin(theta)
            k = k_new
            # attitude
            if st[k] == t:
                qx, qy, qz, qw = sq[k, 0], sq[k, 1], sq[k, 2], sq[k, 3]
            else:
                f = (t - st[k]) / (st[k + 1] - st[k])
                if near:
                    w0, w1 = 1.0 - f, sign * f
                else:
                    w0, w1 = np.sin((1.0 - f) * theta) * inv_sine, sign * np.sin(f * theta) * inv_sine
                qx = w0 * sq[k, 0] + w1 * sq[k + 1, 0]
                qy = w0 * sq[k, 1] + w1 * sq[k + 1, 1]
                qz = w0 * sq[k, 2] + w1 * sq[k + 1, 2]
                qw = w0 * sq[k, 3] + w1 * sq[k + 1, 3]
                s = 1.0 / np.sqrt(qx * qx + qy * qy + qz * qz + qw * qw)
                qx, qy, qz, qw = qx * s, qy * s, qz * s, qw * s
            R00, R01, R02 = 1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qz * qw), 2 * (qx * qz + qy * qw)
            R10, R11, R12 = 2 * (qx * qy + qz * qw), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qx * qw)
            R20, R21, R22 = 2 * (qx * qz - qy * qw), 2 * (qy * qz + qx * qw), 1 - 2 * (qx * qx + qy * qy)
            # body
            x, y, z = r_laser[i, 0], r_laser[i, 1], r_laser[i, 2]
            vx = B[0, 0] * x + B[0, 1] * y + B[0, 2] * z
            vy = B[1, 0] * x + B[1, 1] * y + B[1, 2] * z
            vz = B[2, 0] * x + B[2, 1] * y + B[2, 2] * z
            bx, by, bz = vx + b[0], vy + b[1], vz + b[2]
            inside = vehicle[0] <= bx <= vehicle[3] and vehicle[1] <= by <= vehicle[4] and vehicle[2] <= bz <= vehicle[5]
            # antenna
            j = _at(pt, t, j)
            ax, ay, az = pp[j, 0], pp[j, 1], pp[j, 2]
            if pt[j] != t:
                h = (pt[j + 1] - pt[j]) * 1e-9
                f = (t - pt[j]) / (pt[j + 1] - pt[j])
                g = f * f * (3.0 - 2.0 * f) if hermite else f
                ax += g * (pp[j + 1, 0] - pp[j, 0])
                ay += g * (pp[j + 1, 1] - pp[j, 1])
                az += g * (pp[j + 1, 2] - pp[j, 2])
                if hermite:
                    g0, g1 = h * f * (1.0 - f) * (1.0 - f), h * f * f * (f - 1.0)
                    ax += g0 * pm[j, 0] + g1 * pm[j + 1, 0]
                    ay += g0 * pm[j, 1] + g1 * pm[j + 1, 1]
                    az += g0 * pm[j, 2] + g1 * pm[j + 1, 2]
            # LiDAR equation
            bx, by, bz = vx + arm[0], vy + arm[1], vz + arm[2]
            mx = ax + R00 * bx + R01 * by + R02 * bz
            my = ay + R10 * bx + R11 * by + R12 * bz
            mz = az + R20 * bx + R21 * by + R22 * bz
            r_map[i, 0], r_map[i, 1], r_map[i, 2] = mx, my, mz
            within = region[0] <= mx <= region[3] and region[1] <= my <= region[4] and region[2] <= mz <= region[5]
            status[i] = IN_VEHICLE if inside else (MAPPED if within else OUTSIDE_REGION)
            # covariance: the noise of range, azimuth and vertical angle as three arrows in the laser frame, turned into the map
            hor = np.sqrt(x * x + y * y)
            rho = np.sqrt(x * x + y * y + z * z)
            ca, sa = (x / hor, y / hor) if hor > 0.0 else (1.0, 0.0)
            s0, s1, s2 = sigmas[0] / rho, sigmas[1], sigmas[2]
            cxx = cxy = cxz = cyy = cyz = czz = 0.0
            for c in range(3):
                if c == 0:
                    lx, ly, lz = x * s0, y * s0, z * s0
                elif c == 1:
                    lx, ly, lz = -y * s1, x * s1, 0.0
                else:
                    lx, ly, lz = -z * ca * s2, -z * sa * s2, hor * s2
                ux = B[0, 0] * lx + B[0, 1] * ly + B[0, 2] * lz
                uy = B[1, 0] * lx + B[1, 1] * ly + B[1, 2] * lz
                uz = B[2, 0] * lx + B[2, 1] * ly + B[2, 2] * lz
                ex = R00 * ux + R01 * uy + R02 * uz
                ey = R10 * ux + R11 * uy + R12 * uz
                ez = R20 * ux + R21 * uy + R22 * uz
                cxx += ex * ex
                cxy += ex * ey
                cxz += ex * ez
                cyy += ey * ey
                cyz += ey * ez
                czz += ez * ez
            C_ind[i, 0], C_ind[i, 1], C_ind[i, 2] = cxx, cxy, cxz
            C_ind[i, 3], C_ind[i, 4], C_ind[i, 5] = cyy, cyz, czz


def vehicle_box(values: tuple[float, ...]) -> F64:
    """The own-vehicle box (6,): NaN, which holds nothing, where none is given."""
    return np.array(values if values else (np.nan,) * 6, dtype=np.float64)


def region_box(values: tuple[float, ...]) -> F64:
    """The region of interest (6,): everything, where none is given."""
    return np.array(values if values else (-np.inf,) * 3 + (np.inf,) * 3, dtype=np.float64)


def map_returns(t_ns: I64, r_laser: F64, path: PathWindow, mount: Mounting, sigmas: F64, vehicle: F64, region: F64) -> Mapped:
    """Georeference returns.

    t_ns : (n,) ns, navigation time · r_laser : (n, 3) m · path : the knots around · sigmas : (3,) range m, azimuth and vertical angle rad ·
    vehicle : (6,) m, body frame, region : (6,) m, map frame: lower corner, upper corner
    """
    n = len(t_ns)
    out = Mapped(np.zeros((n, 3)), np.zeros((n, 6), np.float32), np.zeros(n, np.uint8))
    arm = mount.lever_laser - mount.lever_antenna
    _map(
        t_ns, np.ascontiguousarray(r_laser), path.state_t, path.state_q, path.state_segment, path.position_t, path.position, path.tangent,
        path.hermite, np.ascontiguousarray(mount.R_body_laser), arm, mount.lever_laser, sigmas, vehicle, region,
        out.r_map, out.C_ind, out.status,
    )  # fmt: skip
    return out


def map_returns_numpy(t_ns: I64, r_laser: F64, path: PathWindow, mount: Mounting, sigmas: F64, vehicle: F64, region: F64) -> Mapped:
    """The plain twin of :func:`map_returns`."""
    n = len(t_ns)
    out = Mapped(np.full((n, 3), np.nan), np.full((n, 6), np.nan, np.float32), np.full(n, NO_POSE, np.uint8))
    covered, k, f = bracket(t_ns, path.state_t, path.state_segment)
    if not covered.any():
        return out
    k, f, t, r = k[covered], f[covered], t_ns[covered], r_laser[covered]
    R = matrix_from_quaternion(slerp(path.state_q[k], path.state_q[np.minimum(k + 1, len(path.state_t) - 1)], f))
    j = np.searchsorted(path.position_t, t, side="right") - 1
    last = j == len(path.position_t) - 1  # only where the time is that of the last knot
    j = np.minimum(j, len(path.position_t) - 2)
    p_antenna, _ = interpolate_position(path, t, j)
    p_antenna = np.where(last[:, None], path.position[-1], p_antenna)
    body = r @ mount.R_body_laser.T + mount.lever_laser
    out.r_map[covered] = p_antenna + np.einsum("nij,nj->ni", R, body - mount.lever_antenna)
    J = R @ (mount.R_body_laser @ angle_derivatives(r)) * sigmas
    out.C_ind[covered] = pack(J @ np.swapaxes(J, 1, 2))
    r_map = out.r_map[covered]
    in_vehicle = ((body >= vehicle[:3]) & (body <= vehicle[3:])).all(axis=1)
    in_region = ((r_map >= region[:3]) & (r_map <= region[3:])).all(axis=1)
    out.status[covered] = np.where(in_vehicle, IN_VEHICLE, np.where(in_region, MAPPED, OUTSIDE_REGION))
    return out
