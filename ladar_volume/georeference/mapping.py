"""One pass over a cloud: pose at each return, LiDAR equation, own-vehicle and region masks, C_ind.

:func:`map_returns` is the compiled kernel, :func:`map_returns_numpy` its plain twin.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from ladar_volume.georeference.lidar_equation import Mounting, angle_derivatives
from ladar_volume.georeference.point_jacobian import bracket
from ladar_volume.georeference.trajectory import PathWindow, interpolate_position
from ladar_volume.math.array_types import F32, F64, I64
from ladar_volume.math.interpolation import (
    Rows,
    Vector,
    arc_between,
    knot_before,
    on_arc,
    rotation_rows,
)
from ladar_volume.math.kernels import leaf_kernel, parallel_kernel
from ladar_volume.math.packed_covariance import pack
from ladar_volume.math.se3 import matrix_from_quaternion, slerp

#: What became of a return.
MAPPED, NO_POSE, IN_VEHICLE, OUTSIDE_REGION = 0, 1, 2, 3
#: Points per parallel chunk: each chunk walks along the knots with a hint instead of searching.
_CHUNK = 1024
_ZERO = (0.0, 0.0, 0.0)


class MappingResult(NamedTuple):
    """r_map : (n, 3) m · C_ind : (n, 6) float32 m² · status : (n,) uint8, rows other than MAPPED
    hold NaN or are to be dropped.
    """

    r_map: F64
    C_ind: F32
    status: npt.NDArray[np.uint8]


class Device(NamedTuple):
    """boresight : (3, 3), body from laser · arm : (3,) m from antenna to laser · lever : (3,) m of
    the laser · sigmas : (3,) range m, azimuth and vertical angle rad. All in the body frame.
    """

    boresight: F64
    arm: F64
    lever: F64
    sigmas: F64


class Boxes(NamedTuple):
    """vehicle : (6,) m, body frame, region : (6,) m, map frame: lower corner, upper corner."""

    vehicle: F64
    region: F64


@leaf_kernel
def _transform(a: Vector, R: Rows, v: Vector) -> Vector:
    """``a + R v``. Vectors and rows of matrices are numbers, not arrays: they stay in registers."""
    return (
        a[0] + R[0][0] * v[0] + R[0][1] * v[1] + R[0][2] * v[2],
        a[1] + R[1][0] * v[0] + R[1][1] * v[1] + R[1][2] * v[2],
        a[2] + R[2][0] * v[0] + R[2][1] * v[1] + R[2][2] * v[2],
    )


@leaf_kernel
def _antenna(path: PathWindow, j: int, t: int) -> Vector:
    """The antenna at a time from position j on, not after the next."""
    pt, pp, cubic = path.position_t, path.position, path.cubic
    x, y, z = pp[j, 0], pp[j, 1], pp[j, 2]
    if pt[j] != t:
        h = (pt[j + 1] - pt[j]) * 1e-9
        f = (t - pt[j]) / (pt[j + 1] - pt[j])
        g = f * f * (3.0 - 2.0 * f) if cubic else f
        x += g * (pp[j + 1, 0] - pp[j, 0])
        y += g * (pp[j + 1, 1] - pp[j, 1])
        z += g * (pp[j + 1, 2] - pp[j, 2])
        if cubic:
            m0, m1 = path.leaving, path.arriving
            g0, g1 = h * f * (1.0 - f) * (1.0 - f), h * f * f * (f - 1.0)
            x += g0 * m0[j, 0] + g1 * m1[j, 0]
            y += g0 * m0[j, 1] + g1 * m1[j, 1]
            z += g0 * m0[j, 2] + g1 * m1[j, 2]
    return x, y, z


@leaf_kernel
def _in_box(box: F64, v: Vector) -> Any:
    """Whether a box (6,) holds a place."""
    return box[0] <= v[0] <= box[3] and box[1] <= v[1] <= box[4] and box[2] <= v[2] <= box[5]


@leaf_kernel
def _noise(r: Vector, sigmas: F64, B: Rows, R: Rows, out: F32) -> None:
    """Packed covariance (6,) in the map of a return r in the laser frame: the noise of range,
    azimuth and vertical angle as three arrows, turned into the map.
    """
    x, y, z = r
    hor = np.sqrt(x * x + y * y)
    rho = np.sqrt(x * x + y * y + z * z)
    ca, sa = (x / hor, y / hor) if hor > 0.0 else (1.0, 0.0)
    s0, s1, s2 = sigmas[0] / rho, sigmas[1], sigmas[2]
    d = _transform(_ZERO, R, _transform(_ZERO, B, (x * s0, y * s0, z * s0)))
    e = _transform(_ZERO, R, _transform(_ZERO, B, (-y * s1, x * s1, 0.0)))
    f = _transform(_ZERO, R, _transform(_ZERO, B, (-z * ca * s2, -z * sa * s2, hor * s2)))
    out[0] = d[0] * d[0] + e[0] * e[0] + f[0] * f[0]
    out[1] = d[0] * d[1] + e[0] * e[1] + f[0] * f[1]
    out[2] = d[0] * d[2] + e[0] * e[2] + f[0] * f[2]
    out[3] = d[1] * d[1] + e[1] * e[1] + f[1] * f[1]
    out[4] = d[1] * d[2] + e[1] * e[2] + f[1] * f[2]
    out[5] = d[2] * d[2] + e[2] * e[2] + f[2] * f[2]


@leaf_kernel
def _rows(M: F64) -> Rows:
    """Rows of a matrix (3, 3)."""
    return (
        (M[0, 0], M[0, 1], M[0, 2]),
        (M[1, 0], M[1, 1], M[1, 2]),
        (M[2, 0], M[2, 1], M[2, 2]),
    )


@leaf_kernel
def _in_one_segment(knots: I64, segment: I64, k: int, t: int) -> bool:
    """Whether a pose can be had at t, of which k is the knot before."""
    covered = k >= 0 and segment[k] >= 0
    if covered and knots[k] != t:
        covered = k + 1 < len(knots) and segment[k] == segment[k + 1]
    return bool(covered)


@leaf_kernel
def _map_part(
    part: tuple[int, int],
    t_ns: I64,
    r_laser: F64,
    path: PathWindow,
    device: Device,
    boxes: Boxes,
    out: MappingResult,
) -> None:
    """Returns part[0] to before part[1]: along the knots, with a hint instead of a search."""
    st, sq, sg, pt = path.state_t, path.state_q, path.state_segment, path.position_t
    arm, b, B = device.arm, device.lever, _rows(device.boresight)
    r_map, C_ind, status, ns = out.r_map, out.C_ind, out.status, len(st)
    k, j, arc = -1, -1, (0.0, 1.0, 1.0, True)
    for i in range(part[0], part[1]):
        t, before = t_ns[i], k
        k = knot_before(st, t, k)
        if not _in_one_segment(st, sg, k, t):
            status[i], k = NO_POSE, before
            r_map[i, :] = np.nan
            C_ind[i, :] = np.nan
            continue
        if k != before and k + 1 < ns:  # once per interval
            arc = arc_between(sq, k, k + 1)
        q = (sq[k, 0], sq[k, 1], sq[k, 2], sq[k, 3])
        R = rotation_rows(
            q if st[k] == t else on_arc(sq, k, k + 1, (t - st[k]) / (st[k + 1] - st[k]), arc)
        )
        r = (r_laser[i, 0], r_laser[i, 1], r_laser[i, 2])
        v = _transform(_ZERO, B, r)
        inside = _in_box(boxes.vehicle, (v[0] + b[0], v[1] + b[1], v[2] + b[2]))
        j = knot_before(pt, t, j)
        # LiDAR equation
        m = _transform(_antenna(path, j, t), R, (v[0] + arm[0], v[1] + arm[1], v[2] + arm[2]))
        r_map[i, 0], r_map[i, 1], r_map[i, 2] = m
        place = MAPPED if _in_box(boxes.region, m) else OUTSIDE_REGION
        status[i] = IN_VEHICLE if inside else place
        _noise(r, device.sigmas, B, R, C_ind[i])


@parallel_kernel
def _map(
    t_ns: I64, r_laser: F64, path: PathWindow, device: Device, boxes: Boxes, out: MappingResult
) -> None:
    n = len(t_ns)
    for chunk in numba.prange((n + _CHUNK - 1) // _CHUNK):
        part = (chunk * _CHUNK, min(n, (chunk + 1) * _CHUNK))
        _map_part(part, t_ns, r_laser, path, device, boxes, out)


def vehicle_box(values: tuple[float, ...]) -> F64:
    """The own-vehicle box (6,): NaN, which holds nothing, where none is given."""
    return np.array(values if values else (np.nan,) * 6, dtype=np.float64)


def region_box(values: tuple[float, ...]) -> F64:
    """The region of interest (6,): everything, where none is given."""
    return np.array(values if values else (-np.inf,) * 3 + (np.inf,) * 3, dtype=np.float64)


def map_returns(
    t_ns: I64,
    r_laser: F64,
    path: PathWindow,
    mount: Mounting,
    sigmas: F64,
    vehicle: F64,
    region: F64,
) -> MappingResult:
    """Georeference returns.

    t_ns : (n,) ns, navigation time · r_laser : (n, 3) m · path : the knots around · sigmas : (3,)
    range m, azimuth and vertical angle rad · vehicle : (6,) m, body frame, region : (6,) m, map
    frame: lower corner, upper corner
    """
    n = len(t_ns)
    out = MappingResult(np.zeros((n, 3)), np.zeros((n, 6), np.float32), np.zeros(n, np.uint8))
    arm = mount.lever_laser - mount.lever_antenna
    device = Device(
        np.ascontiguousarray(mount.R_body_laser), arm, mount.lever_laser, np.asarray(sigmas)
    )
    _map(t_ns, np.ascontiguousarray(r_laser), path, device, Boxes(vehicle, region), out)
    return out


def map_returns_numpy(
    t_ns: I64,
    r_laser: F64,
    path: PathWindow,
    mount: Mounting,
    sigmas: F64,
    vehicle: F64,
    region: F64,
) -> MappingResult:
    """The plain twin of :func:`map_returns`."""
    n = len(t_ns)
    out = MappingResult(
        np.full((n, 3), np.nan), np.full((n, 6), np.nan, np.float32), np.full(n, NO_POSE, np.uint8)
    )
    covered, k, f = bracket(t_ns, path.state_t, path.state_segment)
    if not covered.any():
        return out
    k, f, t, r = k[covered], f[covered], t_ns[covered], r_laser[covered]
    R = matrix_from_quaternion(
        slerp(path.state_q[k], path.state_q[np.minimum(k + 1, len(path.state_t) - 1)], f)
    )
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
    out.status[covered] = np.where(
        in_vehicle, IN_VEHICLE, np.where(in_region, MAPPED, OUTSIDE_REGION)
    )
    return out
