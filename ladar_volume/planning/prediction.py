"""The accuracy of a volume before the flight: the survey's own propagation on a planned scene.

Along the planned path returns are sampled where the beams meet the scene, at random times and
azimuths, with their noise. Filter, surface, base and budget are then the survey's own
(:class:`SurfaceFilter`, :class:`VolumeEstimator`): what is predicted and what the survey will print
come from one code. Calibration and navigation enter through their sensitivities; their errors need
not be drawn.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ladar_volume.georeference.error_budget import independent_sigmas, navigation_covariance
from ladar_volume.georeference.lidar_equation import Mounting, laser_vector, map_point, mounting
from ladar_volume.georeference.point_jacobian import (
    bracket,
    independent_covariance,
    interpolate_poses,
    point_geometry,
)
from ladar_volume.math.packed_covariance import pack
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.parameters import Parameters, VolumeParameters
from ladar_volume.model.records import (
    F64,
    I64,
    Bool,
    Estimate,
    MappedPoints,
    PlatformStates,
    Volume,
)
from ladar_volume.planning.planned_scene import Pile
from ladar_volume.rmls.surface_filter import SurfaceFilter
from ladar_volume.volume.base import area_inside
from ladar_volume.volume.estimator import VolumeEstimator
from ladar_volume.volume.prismoids import prismoids
from ladar_volume.volume.volume_loads import ground_field

#: Rays of the pilot that finds what share of the pulses meets the region.
PILOT = 20_000
#: More returns than this many times the filter's cap per voxel change nothing.
CAPS = 1.5


@dataclass(frozen=True)
class Scanner:
    """A rotating scanner: beams evenly spread over vertical angles low_rad to high_rad, pulse rate
    (1/s) and longest range (m).
    """

    beams: int = 16
    low_rad: float = math.radians(-15.0)
    high_rad: float = math.radians(15.0)
    rate_hz: float = 300_000.0
    max_range_m: float = 100.0


@dataclass(frozen=True)
class Plan:
    """A survey to be: the scene, the path (``C_nav`` of the states is not used: the budget's stands
    in), the scanner and all parameters.
    """

    pile: Pile
    path: PlatformStates
    scanner: Scanner
    parameters: Parameters
    seed: int = 1


@dataclass(frozen=True)
class Prediction:
    """What the survey will give. volume : as it will be printed, with its budget · true_m3 : of the
    scene · returns_per_m2 : on the region that the volume needs · duration_s : flying time with the
    scanner on
    """

    volume: Volume
    true_m3: float
    returns_per_m2: float
    duration_s: float

    @property
    def share(self) -> float:
        """sigma over the scene's volume."""
        return self.volume.sigma_m3 / abs(self.true_m3)


def scanning_spans(path: PlatformStates) -> tuple[F64, F64]:
    """Begin and length (k,) s of the spans between neighbouring states of one segment."""
    t = path.t_ns * 1e-9
    one = (path.segment[1:] == path.segment[:-1]) & (path.segment[1:] >= 0)
    return t[:-1][one], np.diff(t)[one]


@dataclass(frozen=True)
class Pulses:
    """Pulses at random times and azimuths.

    t_ns : (n,) · origin : (n, 3) m, of the body · R : (n, 3, 3), body to map · ring : (n,) ·
    azimuth, elevation : (n,) rad, of the laser · start : (n, 3) m, laser origin · ray : (n, 3)
    unit; map frame
    """

    t_ns: I64
    origin: F64
    R: F64
    ring: npt.NDArray[np.uint16]
    azimuth: F64
    elevation: F64
    start: F64
    ray: F64

    def select(self, keep: Bool) -> Pulses:
        """The pulses where keep (n,) is set."""
        return Pulses(*(getattr(self, f.name)[keep] for f in dataclasses.fields(self)))


def cast_rays(plan: Plan, count: int, rng: np.random.Generator) -> tuple[MappedPoints, F64]:
    """Mapped points of ``count`` pulses at random times and azimuths, with independent noise; those
    that return from the region, and the ranges (n,) m.
    """
    p = plan.parameters
    mount = mounting(p.calibration, p.georeference.pose_source)
    pulses, distance = trace_returns(plan, fire_pulses(plan, mount, count, rng))
    noise = rng.standard_normal((len(distance), 3)) * independent_sigmas(p.budget)
    spread = np.maximum(np.cos(pulses.elevation), 0.05)
    r_laser = laser_vector(
        distance + noise[:, 0],
        pulses.azimuth + noise[:, 1] / spread,
        pulses.elevation + noise[:, 2],
    )
    antenna = pulses.origin + np.einsum("nij,j->ni", pulses.R, mount.lever_antenna)
    points = MappedPoints(
        pulses.t_ns,
        map_point(antenna, pulses.R, r_laser, mount),
        np.zeros((len(distance), 6), np.float32),
        pulses.ring,
        np.ones(len(distance), np.float32),
    )
    geometry = point_geometry(points, plan.path, mount)
    C = independent_covariance(geometry, independent_sigmas(p.budget))
    return dataclasses.replace(points, C_ind=pack(C).astype(np.float32)), distance


def fire_pulses(plan: Plan, mount: Mounting, count: int, rng: np.random.Generator) -> Pulses:
    """Pulses along the path. Raises :class:`VolumeError` for a path of single states."""
    path, scanner = plan.path, plan.scanner
    begin, length = scanning_spans(path)
    if len(begin) == 0:
        raise VolumeError("the path has no two states of one segment", reason="plan_path")
    at = np.sort(rng.uniform(0.0, length.sum(), count))
    ends = np.cumsum(length)
    span = np.minimum(np.searchsorted(ends, at, side="right"), len(ends) - 1)
    t_ns = np.floor((begin[span] + at - (ends - length)[span]) * 1e9).astype(np.int64)
    _, k, f = bracket(t_ns, path.t_ns, path.segment)
    R, origin = interpolate_poses(path, k, f)
    ring = rng.integers(0, scanner.beams, count).astype(np.uint16)
    elevation = (
        np.linspace(scanner.low_rad, scanner.high_rad, scanner.beams)[ring]
        if scanner.beams > 1
        else np.zeros(count)
    )
    azimuth = rng.uniform(-math.pi, math.pi, count)
    ray = np.einsum(
        "nij,nj->ni", R, laser_vector(np.ones(count), azimuth, elevation) @ mount.R_body_laser.T
    )
    start = origin + np.einsum("nij,j->ni", R, mount.lever_laser)
    return Pulses(t_ns, origin, R, ring, azimuth, elevation, start, ray)


def trace_returns(plan: Plan, pulses: Pulses) -> tuple[Pulses, F64]:
    """The pulses that return from the region, and their ranges (n,) m on the rough scene."""
    g = plan.parameters.georeference
    distance = plan.pile.ranges(pulses.start, pulses.ray)
    limit = min(plan.scanner.max_range_m, g.range_max_m)
    keep = (distance <= limit) & (distance >= g.range_min_m)
    hit = pulses.start[keep] + distance[keep, None] * pulses.ray[keep]
    keep[keep] = inside_region(plan, hit)
    distance, pulses = distance[keep], pulses.select(keep)
    hit = pulses.start + distance[:, None] * pulses.ray
    # the roughness lifts the ground; the beam meets it that much earlier
    lift = plan.pile.roughness(hit[:, :2], plan.seed)
    return pulses, distance + lift / np.minimum(pulses.ray[:, 2], -0.05)


def with_outline(plan: Plan) -> VolumeParameters:
    """The volume's parameters; for a pit, which no automatic outline finds, with a polygon around
    its rim.
    """
    v = plan.parameters.volume
    if plan.pile.height_m > 0 or v.outline != "auto":
        return v
    angle, half = (
        2.0 * math.pi * np.arange(48) / 48.0,
        np.array([plan.pile.length_m, plan.pile.width_m]) / 2.0 + v.outline_margin_m,
    )
    ring = half * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return dataclasses.replace(
        v, outline="polygon", polygon_m=tuple(float(c) for c in ring.ravel())
    )


def inside_region(plan: Plan, hit: F64) -> Bool:
    """Whether hits (n, 3) lie where the volume needs them: the foot with margin and ring of ground
    around it.
    """
    half = region_half(plan)
    out: Bool = (np.abs(hit[:, 0]) <= half[0]) & (np.abs(hit[:, 1]) <= half[1])
    return out


def region_half(plan: Plan) -> tuple[float, float]:
    """Half length and width (m) of that region."""
    v = plan.parameters.volume
    around = v.outline_margin_m + v.ground_ring_m
    return plan.pile.length_m / 2.0 + around, plan.pile.width_m / 2.0 + around


def with_budget(path: PlatformStates, parameters: Parameters) -> PlatformStates:
    """The path with the navigation covariance of the budget."""
    unique, index = np.unique(path.q_map_body, axis=0, return_inverse=True)
    C = np.stack([navigation_covariance(parameters.budget, q) for q in unique])
    return dataclasses.replace(path, C_nav=C[index.ravel()])


def predict(plan: Plan) -> Prediction:
    """The predicted volume, its sigma and its budget.

    Raises :class:`VolumeError` where no pulse meets the region or nothing rises above the ground,
    and what the survey itself would raise: :class:`SurfaceError` or :class:`GroundError`.
    """
    geo = dataclasses.replace(plan.parameters.georeference, beams=plan.scanner.beams)
    parameters = dataclasses.replace(plan.parameters, georeference=geo, volume=with_outline(plan))
    plan = dataclasses.replace(plan, parameters=parameters)
    plan = dataclasses.replace(plan, path=with_budget(plan.path, plan.parameters))
    p, rng = plan.parameters, np.random.default_rng([plan.seed, 4])
    duration = float(scanning_spans(plan.path)[1].sum())
    fired = plan.scanner.rate_hz * duration
    share = len(cast_rays(plan, PILOT, rng)[0]) / PILOT
    if share == 0.0:
        raise VolumeError(
            "no pulse of the planned path meets the pile and its surroundings",
            reason="plan_no_returns",
        )
    half = region_half(plan)
    area = 4.0 * half[0] * half[1]
    enough = CAPS * p.filter.cap_per_voxel * area / p.filter.radius_m**2
    points, _ = cast_rays(plan, int(min(fired, math.ceil(enough / share))), rng)
    surface, estimator = SurfaceFilter(p), VolumeEstimator(p)
    surface.add_platform(plan.path)
    estimator.add_platform(plan.path)
    surface.add(points)
    update = surface.finish()
    if update is not None:
        estimator.add(update)
    volume = with_roughness(estimator.estimate(), plan.pile, p)
    return Prediction(volume, plan.pile.volume_m3, share * fired / area, duration)


def with_roughness(estimate: Estimate, pile: Pile, parameters: Parameters) -> Volume:
    """The predicted volume with the planned roughness of the ground in its budget, not that of the
    one sample drawn for the scene: an estimate of a correlation length from one patch of ground
    scatters by a factor of two.
    """
    v, tin, base = estimate.volume, estimate.tin, estimate.base
    inside = area_inside(tin, base, parameters.volume)
    field = ground_field(
        tin, base, prismoids(tin, base, inside > 0).base_net, inside, np.zeros(len(tin.vertices))
    )
    if field is None:
        return v
    planned = dataclasses.replace(
        field.rough, variance_m2=pile.rough_m**2, length_m=pile.rough_length_m, gaussian=0.0
    )
    line = dataclasses.replace(field, rough=planned).variance_m6
    change = line - v.budget_m6["base_surface"]
    low, high = (math.sqrt(s * s + change) for s in v.sigma_tau_range_m3)
    return dataclasses.replace(
        v,
        budget_m6={**v.budget_m6, "base_surface": line},
        sigma_m3=math.sqrt(v.sigma_m3**2 + change),
        sigma_tau_range_m3=(low, high),
    )
