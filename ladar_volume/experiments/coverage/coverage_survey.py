"""One survey at vertex level: every return becomes a vertex of the surface, with all its
sensitivities; no filter in between.

What goes wrong is drawn by the simulation's own code (:mod:`ladar_volume.simulation`), each source
from a stream of its own, so that a source can be left out without changing the others. What is
believed of it is the product's: LiDAR equation, Jacobians and covariances of ``georeference/``,
records as the filter makes them, with one patch per return.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ladar_volume.experiments.coverage.coverage_box import BoxSite
from ladar_volume.experiments.coverage.coverage_flight import (
    ATTITUDE_HZ,
    BEAM_COUNT,
    DURATION_S,
    FIX_HZ,
    Aim,
    Path,
    hits_of,
    sample_times,
    states_of,
)
from ladar_volume.experiments.coverage.coverage_scene import Site
from ladar_volume.georeference.error_budget import independent_sigmas
from ladar_volume.georeference.lidar_equation import Mounting, laser_vector, map_point, mounting
from ladar_volume.georeference.point_jacobian import (
    PointGeometry,
    beam_jacobian,
    calibration_jacobian,
    independent_covariance,
    navigation_jacobian,
    point_geometry,
)
from ladar_volume.math.packed_covariance import pack
from ladar_volume.model.parameters import BudgetParameters, CalibrationParameters, Parameters
from ladar_volume.model.records import (
    CAL_COLUMNS,
    F32,
    F64,
    I64,
    FilteredPoints,
    FilterUpdate,
    MappedPoints,
    Patches,
    PlatformStates,
)
from ladar_volume.simulation import velodyne
from ladar_volume.simulation.drawn_errors import draw_errors
from ladar_volume.simulation.platforms import Platform, uav

#: Rows of a patch' sensitivities along its normal and both tangents.
ALONG = np.array([0, 3, 4])
#: Streams of random numbers: every survey has its own of each.
CALIBRATION, BEAMS, CLOCK, POSITION, ATTITUDE, NOISE = range(1, 7)


@dataclass(frozen=True)
class VertexSurvey:
    """update : vertices as the filter would hand them on · states : the platform as measured, with
    the believed C_nav
    """

    update: FilterUpdate
    states: PlatformStates


@dataclass(frozen=True)
class MappedSurvey:
    """points : what is mapped · measure_states : gives the platform as measured, with the believed
    C_nav: a volume without its sigma does not need it · mount : as known · normal : (n, 3) of the
    surface that each hit
    """

    points: MappedPoints
    measure_states: Callable[[], PlatformStates]
    mount: Mounting
    normal: F64

    @cached_property
    def states(self) -> PlatformStates:
        """The platform as measured."""
        return self.measure_states()


@dataclass(frozen=True)
class SurveyErrors:
    """What is wrong with one survey: boresight (3,) rad, lever arms (3,) m, clock s, beams, and
    errors of fixes and attitudes in time.
    """

    boresight: F64
    lever_laser: F64
    lever_antenna: F64
    clock_s: float
    beams: velodyne.BeamErrors
    fix_s: F64
    position: F64
    attitude_s: F64
    attitude: F64

    @classmethod
    def draw(cls, budget: BudgetParameters, instrument: int, flight: int) -> SurveyErrors:
        """Errors of this budget. Two surveys with one ``instrument`` share its calibration; each
        ``flight`` has its own clock offset and navigation.
        """
        b = budget
        calibration, clock = (
            np.random.default_rng([instrument, CALIBRATION]),
            np.random.default_rng([flight, CLOCK]),
        )
        fix_s, attitude_s = sample_times(FIX_HZ), sample_times(ATTITUDE_HZ)
        position = draw_errors(
            fix_s,
            np.array(b.position_sigma_m),
            b.position_bias_fraction,
            b.position_white_fraction,
            b.tau_position_s,
            np.random.default_rng([flight, POSITION]),
        )
        attitude = draw_errors(
            attitude_s,
            np.array(b.attitude_sigma_rad),
            b.attitude_bias_fraction,
            b.attitude_white_fraction,
            b.tau_attitude_s,
            np.random.default_rng([flight, ATTITUDE]),
        )
        return cls(
            calibration.normal(0, b.boresight_sigma_rad),
            calibration.normal(0, b.lever_laser_sigma_m),
            calibration.normal(0, b.lever_antenna_sigma_m),
            float(clock.normal(0, b.clock_sigma_s)),
            velodyne.BeamErrors.draw(b, np.random.default_rng([instrument, BEAMS])),
            fix_s,
            position.total,
            attitude_s,
            attitude.total,
        )

    def position_at(self, t: F64) -> F64:
        """Position errors (n, 3) m at times (n,) s, linear between fixes."""
        return np.stack([np.interp(t, self.fix_s, self.position[:, k]) for k in range(3)], axis=1)

    def attitude_at(self, t: F64) -> F64:
        """Errors (n, 3) rad of roll, pitch and yaw at times (n,) s."""
        return np.stack(
            [np.interp(t, self.attitude_s, self.attitude[:, k]) for k in range(3)], axis=1
        )


def nominal(platform: Platform) -> CalibrationParameters:
    """The mounting as the surveyor knows it."""
    roll, pitch, yaw = (math.radians(v) for v in platform.boresight_deg)
    return CalibrationParameters(
        boresight_roll_rad=roll,
        boresight_pitch_rad=pitch,
        boresight_yaw_rad=yaw,
        lever_laser_m=platform.lever_laser_m,
        lever_antenna_m=platform.lever_antenna_m,
    )


def survey(
    site: Site | BoxSite,
    drawn_with: BudgetParameters,
    believed: Parameters,
    seed: int,
    flight: int | None = None,
) -> VertexSurvey:
    """Fly over a site with errors drawn from one budget, and hand on what is measured as another
    budget believes it; the rest as in :func:`fly`.
    """
    flown = fly(site, drawn_with, believed.budget, seed, flight)
    return VertexSurvey(vertices(flown, believed), flown.states)


def fly(
    site: Site | BoxSite,
    drawn_with: BudgetParameters,
    believed: BudgetParameters,
    seed: int,
    flight: int | None = None,
    ground: int | None = None,
) -> MappedSurvey:
    """A flight over a site with errors drawn from one budget; the platform's covariance is that of
    another.

    ``flight`` numbers the flight where one instrument (``seed``) flies more than once; the
    roughness of the ground is that of ``seed`` unless ``ground`` names another.
    """
    flight, ground = (seed if number is None else number for number in (flight, ground))
    platform = uav(*site.flight_m, DURATION_S)
    mount = mounting(nominal(platform))
    drawn = SurveyErrors.draw(drawn_with, seed, flight)
    noise = np.random.default_rng([flight, NOISE])
    f, path, true, hit = hits_of(site, ground, flight, true_aim(drawn_with, drawn, mount))
    rho = velodyne.measured_ranges(true, f.ring, drawn.beams, drawn_with, 0.0, noise, 0.0)
    t = f.time_s - drawn.clock_s  # the stamp that the recording gives the pulse
    stamped = Path.at(platform, t) if drawn.clock_s else path
    antenna = (
        stamped.position
        + stamped.rotation.apply(mount.lever_antenna + drawn.lever_antenna)
        + drawn.position_at(t)
    )
    r = map_point(
        antenna,
        stamped.measured_rotation(drawn.attitude_at(t)).as_matrix(),
        laser_vector(rho, f.azimuth, f.elevation),
        mount,
    )
    points = MappedPoints(
        nanoseconds(t), r, np.zeros((len(r), 6), np.float32), f.ring, np.ones(len(r), np.float32)
    )
    return MappedSurvey(
        points, lambda: platform_states(site, drawn, mount, believed), mount, site.normals_at(hit)
    )


def true_aim(budget: BudgetParameters, drawn: SurveyErrors, mount: Mounting) -> Aim:
    """Where the beams truly point: the mounting as known with its drawn errors, and the noise of
    the angles.
    """
    boresight = Rotation.from_rotvec(drawn.boresight) * Rotation.from_matrix(mount.R_body_laser)
    return Aim(
        tuple(boresight.as_quat()),
        tuple(mount.lever_laser + drawn.lever_laser),
        tuple(drawn.beams.eps),
        budget.azimuth_noise_rad,
        budget.vertical_noise_rad,
        budget.beam_divergence_rad,
    )


def nanoseconds(t: F64) -> I64:
    """Seconds of the flight as nanoseconds; a minute is added so that none is negative."""
    return np.rint((t + 60.0) * 1e9).astype(np.int64)


def platform_states(
    site: Site | BoxSite, drawn: SurveyErrors, mount: Mounting, budget: BudgetParameters
) -> PlatformStates:
    """States at the rate of the attitudes, with the covariance that the budget claims."""
    path, velocity, rates = states_of(site)
    t, error = path.t_s, drawn.attitude_at(path.t_s)
    R = path.measured_rotation(error)
    roll, pitch, _ = (path.angles + error).T
    antenna = path.position + path.rotation.apply(mount.lever_antenna) + drawn.position_at(t)
    zero, one = np.zeros(len(t)), np.ones(len(t))
    E = np.moveaxis(
        np.array(
            [  # body rotation vector per roll, pitch, yaw: se3.euler_rate_matrix, stacked
                [one, zero, -np.sin(pitch)],
                [zero, np.cos(roll), np.sin(roll) * np.cos(pitch)],
                [zero, -np.sin(roll), np.cos(roll) * np.cos(pitch)],
            ]
        ),
        2,
        0,
    ) * np.array(budget.attitude_sigma_rad)
    C = np.zeros((len(t), 6, 6))
    C[:, :3, :3] = np.diag(np.array(budget.position_sigma_m) ** 2)
    C[:, 3:, 3:] = E @ np.swapaxes(E, 1, 2)
    position = antenna - R.apply(mount.lever_antenna)
    return PlatformStates(
        nanoseconds(t),
        position,
        R.as_quat(),
        R.inv().apply(velocity),
        rates,
        C,
        np.zeros(len(t), np.int64),
    )


def surface_points(
    flown: MappedSurvey, geometry: PointGeometry, believed: Parameters
) -> FilteredPoints:
    """Every return as a surface point, with its independent noise."""
    normal = flown.normal
    C = independent_covariance(geometry, independent_sigmas(believed.budget))
    across = np.eye(3) - normal[:, :, None] * normal[:, None, :]
    variance = (normal * (C @ normal[:, :, None])[:, :, 0]).sum(axis=1)
    tangential = pack(across @ C @ across).astype(np.float32)
    return dataclasses.replace(noiseless_surface(flown), variance=variance, C_tangent=tangential)


def noiseless_surface(flown: MappedSurvey) -> FilteredPoints:
    """Every return as a surface point without noise: enough for a volume without its sigma."""
    n = len(flown.points)
    return FilteredPoints(
        flown.points.r_map,
        flown.normal,
        np.zeros(n),
        np.zeros((n, 6), np.float32),
        flown.points.t_ns,
        np.arange(n, dtype=np.int64),
        np.zeros((n, 2)),
    )


def vertices(flown: MappedSurvey, believed: Parameters) -> FilterUpdate:
    """Every return as a surface point with a patch of its own: its noise and sensitivities along
    the surface's normal.
    """
    points, normal, n = flown.points, flown.normal, len(flown.points)
    geometry = point_geometry(points, flown.states, flown.mount)
    surface = surface_points(flown, geometry, believed)
    tangent = tangents(normal)
    axes = np.stack([normal, tangent, np.cross(normal, tangent)], axis=1)
    M_nav = np.zeros((n, 5, 4), np.float32)
    M_nav[:, ALONG, 0], M_nav[:, ALONG, 1:] = 1.0, axes @ navigation_jacobian(geometry)[..., 3:]
    cross = np.zeros((n, 3, 3), np.float32)
    cross[:, 0, 0] = surface.variance
    key, ends = np.arange(n, dtype=np.int64), np.arange(n + 1, dtype=np.int64)
    patches = Patches(
        key,
        points.r_map,
        normal,
        tangent,
        np.zeros((n, 3)),
        np.sqrt(surface.variance),
        np.ones(n, np.int32),
        points.t_ns,
        ends,
        key,
        cross,
        calibration_means(axes, geometry, points.ring.astype(np.int64)),
        ends,
        points.t_ns // round(believed.filter.nav_bin_s * 1e9),
        M_nav,
    )
    return FilterUpdate(
        int(points.t_ns[-1]), np.zeros(0, np.int64), surface, patches, complete=True
    )


def tangents(normal: F64) -> F64:
    """A unit tangent (n, 3) of each normal (n, 3)."""
    tangent = np.stack([normal[:, 2], np.zeros(len(normal)), -normal[:, 0]], axis=1)
    tangent[np.abs(normal[:, 1]) > 0.99] = [1.0, 0.0, 0.0]  # walls that face along y
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return tangent


def calibration_means(axes: F64, geometry: PointGeometry, ring: I64) -> F32:
    """Sensitivities (n, 5, c) of points along axes (n, 3, 3) to the calibration's columns: the
    shared ones, and range and vertical angle of the beams ring (n,).
    """
    n, shared = len(ring), len(CAL_COLUMNS)
    M_cal = np.zeros((n, 5, shared + 2 * BEAM_COUNT), np.float32)
    M_cal[:, ALONG, :shared] = axes @ calibration_jacobian(geometry)
    own, every = axes @ beam_jacobian(geometry), np.arange(n)
    for k in range(2):  # a beam's range and its vertical angle
        M_cal[every[:, None], ALONG, (shared + k * BEAM_COUNT + ring)[:, None]] = own[:, :, k]
    return M_cal


def budget_of_lines(budget: BudgetParameters, *kept: str) -> BudgetParameters:
    """The budget with every source at zero except the named lines."""
    changes: dict[str, Any] = {
        name: zero for line, fields in SOURCES.items() if line not in kept for name, zero in fields
    }
    return dataclasses.replace(budget, **changes)


def _zeros(*names: str) -> tuple[tuple[str, float | tuple[float, ...]], ...]:
    default = BudgetParameters()
    return tuple(
        (n, (0.0, 0.0, 0.0) if isinstance(getattr(default, n), tuple) else 0.0) for n in names
    )


#: The fields of the budget behind each printed line.
SOURCES = {
    "noise": _zeros(
        "range_noise_m", "azimuth_noise_rad", "vertical_noise_rad", "beam_divergence_rad"
    ),
    "range_bias": _zeros("range_bias_sigma_m"),
    "beam_range": _zeros("beam_range_sigma_m"),
    "beam_vertical": _zeros("beam_vertical_sigma_rad"),
    "boresight": _zeros("boresight_sigma_rad"),
    "lever_laser": _zeros("lever_laser_sigma_m"),
    "lever_antenna": _zeros("lever_antenna_sigma_m"),
    "clock": _zeros("clock_sigma_s"),
    "position": _zeros("position_sigma_m"),
    "attitude": _zeros("attitude_sigma_rad"),
}
