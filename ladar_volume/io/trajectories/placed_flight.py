"""A trajectory laid beside a point cloud: the same axes, heights and clock, and the beam of each
point.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ladar_volume.clouds.survey.flight_errors import LARGE_RAD, FlightErrors, is_covered
from ladar_volume.georeference.lidar_equation import mounting
from ladar_volume.georeference.trajectory import rates_from_attitudes, tangents
from ladar_volume.io.pointfiles.crs import parts_of
from ladar_volume.io.pointfiles.point_file import PointFile
from ladar_volume.io.trajectories.flown_path import FlownPath, attitudes, rows_of
from ladar_volume.io.trajectories.point_times import on_clock, time_column
from ladar_volume.math.se3 import matrix_from_quaternion, multiply_quaternions
from ladar_volume.model.errors import InputError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, I64, U16, PlatformStates
from ladar_volume.model.verdict import Doubt
from ladar_volume.uncertainty.navigation_sum import NavigationBins

if TYPE_CHECKING:
    from pyproj import CRS

#: Longest pause of a finished trajectory that is bridged, s; what is kept before and after the
#: points, s; largest share of points outside that is left out.
GAP_S, MARGIN_S, MOST_OUTSIDE = 2.0, 5.0, 0.01
#: Farthest that a point can be from its scanner, m.
FARTHEST_M = 10_000.0
#: Columns that name the beam, in lower case; most beams; and how far the direction of north is
#: measured, degrees.
BEAMS, MOST_BEAMS, NORTH_DEG = ("ring", "laser_id", "beam", "channel"), 128, 1e-3
#: A course is told at this speed, m/s.
MOVING = 0.5


@dataclass(frozen=True)
class PlacedFlight:
    """errors : of the points · facts : for the JSON · doubts"""

    errors: FlightErrors
    facts: dict[str, Any]
    doubts: tuple[Doubt, ...]


def place_flight(
    flown: FlownPath, cloud: PointFile, parameters: Parameters, undulation_m: float | None
) -> PlacedFlight:
    """The trajectory beside a cloud. undulation_m : height of the cloud's zero above the ellipsoid,
    None where it is not known.

    Raises :class:`InputError` for points without CRS (input_crs) or times (input_times), and for a
    trajectory that is not of these points (input_trajectory).
    """
    mount = mounting(parameters.calibration, parameters.georeference.pose_source)
    time, words = on_clock(time_column(cloud.columns), flown)
    time += mount.clock_ns * 1e-9
    flown = path_between(flown, float(time.min()), float(time.max()))
    xyz, turn, doubts = in_axes(flown, cloud, undulation_m)
    whole = np.floor(flown.time_s[0])  # times as whole numbers keep their nanoseconds
    t_pose, t_ns = (np.rint((t - whole) * 1e9).astype(np.int64) for t in (flown.time_s, time))
    segment = np.concatenate([[0], np.cumsum(np.diff(t_pose) > GAP_S * 1e9)]).astype(np.int64)
    q, level = body_attitudes(flown, xyz, t_pose, segment, turn)
    doubts += level
    states = states_of(flown, t_pose, xyz, q, segment, parameters)
    outside = share_outside(states, t_ns, flown)
    ring, beams = beam_of(cloud, parameters.georeference.beams)
    navigation = NavigationBins(parameters.filter.nav_bin_s)
    navigation.add(states)
    errors = FlightErrors(states, parameters, mount, t_ns, ring, navigation)
    far = ranges(errors, cloud.r, flown)
    doubts += first_order(flown, parameters)
    given = flown.position_sigma_m is not None
    facts = {
        "path": flown.path.name,
        "poses": len(flown),
        "clock": words,
        "outside": outside,
        "range_m": far,
        "attitude": "from the file" if flown.attitude is not None else "level along the track",
        "position_sigma": "from the file" if given else "budget",
        "attitude_sigma": "from the file" if flown.attitude_sigma_rad is not None else "budget",
        "beams": beams,
    }
    return PlacedFlight(errors, facts, tuple(doubts))


def path_between(flown: FlownPath, first_s: float, last_s: float) -> FlownPath:
    """The path from a little before to a little after; the whole one where nothing is left."""
    inside = (flown.time_s >= first_s - MARGIN_S) & (flown.time_s <= last_s + MARGIN_S)
    return rows_of(flown, np.flatnonzero(inside)) if np.count_nonzero(inside) >= 2 else flown


def share_outside(states: PlatformStates, t_ns: I64, flown: FlownPath) -> float:
    """Share of times (n,) that no states enclose. Raises :class:`InputError` (input_trajectory)
    where it is more than :data:`MOST_OUTSIDE`.
    """
    outside = 1.0 - float(np.mean(is_covered(states, t_ns)))
    if outside > MOST_OUTSIDE:
        raise InputError(
            f"{flown.path.name} covers {100 * (1 - outside):.1f} % of the points: give the "
            "trajectory of all of them, or cut the points to it",
            reason="input_trajectory",
            value=outside,
        )
    return outside


def first_order(flown: FlownPath, parameters: Parameters) -> list[Doubt]:
    """Angles so uncertain that their first order may not be enough."""
    budget = parameters.budget
    largest = max(*budget.attitude_sigma_rad, *budget.boresight_sigma_rad)
    if flown.attitude_sigma_rad is not None:
        usual = float(np.median(flown.attitude_sigma_rad, axis=0).max())
        largest = max(usual, *budget.boresight_sigma_rad)
    if largest <= LARGE_RAD:
        return []
    text = (
        f"attitude or boresight has a standard deviation of {np.degrees(largest):.2g}°: sigma "
        "holds their first order alone; replay the recording, or calibrate the boresight"
    )
    return [Doubt("first_order", text, float(np.degrees(largest)))]


def in_axes(
    flown: FlownPath, cloud: PointFile, undulation_m: float | None
) -> tuple[F64, F64, list[Doubt]]:
    """Positions (n, 3) m in the axes of the cloud, the quaternion (4,) from local east, north, up
    to these axes, and what is doubtful about heights.
    """
    from pyproj import Transformer

    crs = cloud.coordinates.crs
    if crs is None:
        raise InputError(
            "--trajectory: the points name no CRS, so nothing says where they lie beside it: give "
            "--crs",
            reason="input_crs",
        )
    flat, _ = parts_of(crs)
    if flat is None or not flat.is_projected:
        raise InputError(
            f"--trajectory: {crs.name} is no map projection: give the points in UTM or the local "
            "grid",
            reason="input_crs",
        )
    plane = Transformer.from_crs("EPSG:4326", flat.to_2d(), always_xy=True)
    lat, lon, _ = flown.place.T
    x, y = plane.transform(lon, lat)
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise InputError(f"{flown.path.name} lies nowhere in {flat.name}", reason="input_crs")
    middle = float(np.median(lon)), float(np.median(lat))
    east, north = plane.transform([middle[0]] * 2, [middle[1], middle[1] + NORTH_DEG])
    angle = np.arctan2(east[1] - east[0], north[1] - north[0])  # of true north, clockwise
    turn = np.array([0.0, 0.0, -np.sin(0.5 * angle), np.cos(0.5 * angle)])
    z, doubts = heights_of(flown, crs, undulation_m)
    return np.column_stack([x, y, z]), turn, doubts


def heights_of(flown: FlownPath, crs: CRS, undulation_m: float | None) -> tuple[F64, list[Doubt]]:
    """Heights (n,) m of the poses as the points' are counted, and what is doubtful about them."""
    height = flown.place[:, 2]
    flat, vertical = parts_of(crs)
    if undulation_m is not None:
        return height - undulation_m, []
    if vertical is not None:
        return heights_above(crs, vertical, flown), []
    if flat is not None and len(flat.axis_info) > 2:
        return height.copy(), []
    text = (
        "nothing says what the heights of the points are counted from: they are taken above the "
        "ellipsoid, as the trajectory's; above sea level they are up to 107 m apart: give "
        "--undulation"
    )
    return height.copy(), [Doubt("trajectory_heights", text, None)]


def heights_above(crs: CRS, vertical: CRS, flown: FlownPath) -> F64:
    """Heights (n,) m in a system with a vertical datum. Raises :class:`InputError` (input_crs)
    where its geoid is not on this machine.
    """
    from pyproj import Transformer
    from pyproj.exceptions import ProjError

    lat, lon, height = flown.place.T
    try:
        change = Transformer.from_crs(
            "EPSG:4979", crs, always_xy=True, allow_ballpark=False, only_best=True
        )
        z = np.asarray(change.transform(lon, lat, height, errcheck=True)[2])
    except ProjError:
        z = np.full(len(lat), np.nan)
    if not np.isfinite(z).all():
        raise InputError(
            f"the heights of the points are above {vertical.name}, those of {flown.path.name} "
            "above the ellipsoid, and the grid between them is not on this machine: give "
            "--undulation, the height of the one above the other there",
            reason="input_crs",
            value=vertical.name,
        )
    return z


def body_attitudes(
    flown: FlownPath, xyz: F64, t_ns: I64, segment: I64, turn: F64
) -> tuple[F64, list[Doubt]]:
    """Attitudes (n, 4) in the axes of the cloud; where the file has none, level along the track,
    which is doubtful.
    """
    if flown.attitude is not None:
        spread = np.broadcast_to(turn, flown.attitude.shape)
        return multiply_quaternions(spread, flown.attitude), []
    v = tangents(t_ns, xyz, segment)
    speed = np.hypot(v[:, 0], v[:, 1])
    moving = np.flatnonzero(speed > MOVING)
    if not len(moving):
        raise InputError(
            f"{flown.path.name} has no attitudes and does not move", reason="input_trajectory"
        )
    rows = np.arange(len(v))
    last = moving[np.clip(np.searchsorted(moving, rows, side="right") - 1, 0, len(moving) - 1)]
    heading = np.arctan2(v[last, 0], v[last, 1])
    zero = np.zeros(len(v))
    text = (
        f"{flown.path.name} has no attitudes: the body is taken level along the track; give a "
        "trajectory with roll, pitch and heading"
    )
    return attitudes(zero, zero, heading), [Doubt("trajectory_level", text, None)]


def states_of(
    flown: FlownPath, t_ns: I64, xyz: F64, q: F64, segment: I64, parameters: Parameters
) -> PlatformStates:
    """The poses with rates, velocities and covariances."""
    budget = parameters.budget
    omega = np.nan_to_num(rates_from_attitudes(t_ns, q, round(GAP_S * 1e9)))
    v_body = np.einsum("nji,nj->ni", matrix_from_quaternion(q), tangents(t_ns, xyz, segment))
    position, attitude = flown.position_sigma_m, flown.attitude_sigma_rad
    C = np.zeros((len(q), 6, 6))
    index = np.arange(3)
    C[:, index, index] = np.square(budget.position_sigma_m if position is None else position)
    rph = np.broadcast_to(np.asarray(budget.attitude_sigma_rad), (len(q), 3))
    if attitude is not None:
        rph = attitude
    E = euler_rates(q)
    C[:, 3:, 3:] = (E * np.square(rph)[:, None, :]) @ np.swapaxes(E, 1, 2)
    return PlatformStates(t_ns, xyz, q, v_body, omega, C, segment)


def euler_rates(q: F64) -> F64:
    """Body rotation vectors (n, 3, 3) per small change of roll, pitch, yaw at attitudes q (n, 4):
    :func:`~ladar_volume.math.se3.euler_rate_matrix` of many.
    """
    R = matrix_from_quaternion(q)
    roll = np.arctan2(R[:, 2, 1], R[:, 2, 2])
    sp = np.clip(-R[:, 2, 0], -1.0, 1.0)
    cr, sr, cp = np.cos(roll), np.sin(roll), np.sqrt(1.0 - sp**2)
    out = np.zeros((len(q), 3, 3))
    out[:, 0, 0], out[:, 0, 2] = 1.0, -sp
    out[:, 1, 1], out[:, 1, 2] = cr, sr * cp
    out[:, 2, 1], out[:, 2, 2] = -sr, cr * cp
    return out


def beam_of(cloud: PointFile, beams: int) -> tuple[U16 | None, str]:
    """The beam (n,) of each point, None where nothing names it, and which column that is from."""
    lower = {name.lower(): name for name in cloud.columns}
    name = next((lower[n] for n in BEAMS if n in lower), None)
    if name is None:
        return None, "not named: all points as of one"
    ring = np.asarray(cloud.columns[name])
    if ring.dtype.kind not in "iuf" or ring.ndim != 1:
        return None, "not named: all points as of one"
    low, high = float(ring.min()), float(ring.max())
    if not 0 <= low <= high < min(beams, MOST_BEAMS):
        raise InputError(
            f"--trajectory: beams {low:g} to {high:g} in the column {name}, georeference.beams is "
            f"{beams}: set it with --set georeference.beams=N",
            reason="input_trajectory",
            value=high,
        )
    return ring.astype(np.uint16), f"column {name!r}"


def ranges(errors: FlightErrors, points: F64, flown: FlownPath) -> list[float]:
    """5, 50 and 95 % of the ranges, m. Raises :class:`InputError` (input_trajectory) where no
    scanner reaches so far.
    """
    rows = np.arange(0, len(points), max(1, len(points) // 20_000))
    v = errors.geometry(points, rows).v_body
    r = np.linalg.norm(v, axis=1)
    low, mid, high = np.percentile(r[np.isfinite(r)], (5.0, 50.0, 95.0)).tolist()
    if not mid <= FARTHEST_M:
        raise InputError(
            f"{flown.path.name} passes {mid / 1e3:.0f} km from the points: their CRS is wrong, or "
            "it is of another place",
            reason="input_trajectory",
            value=mid,
        )
    return [low, mid, high]
