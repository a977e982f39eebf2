"""What errors do not change of a flight in ``ladar_volume study coverage``: its true path, its
pulses and its ground, computed once for all surveys that share it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from ladar_volume.experiments.coverage.coverage_box import BoxSite
from ladar_volume.experiments.coverage.coverage_scene import RoughGround, Site
from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.model.records import F64, I64
from ladar_volume.simulation import velodyne
from ladar_volume.simulation.platforms import Platform, uav

DURATION_S, FIX_HZ, ATTITUDE_HZ = 36.0, 10.0, 50.0
BEAM_COUNT = 16
#: Pulses that come so near a site, m, may hit it: no error turns or shifts them farther.
NEAR_M = 2.0
#: The streams of random numbers for a flight's pulses and for where in their footprint they are
#: reflected.
PULSES, SPOT = 0, 7


def sample_times(hz: float) -> F64:
    """Times (n,) s of samples at this rate, from before the flight to after it."""
    return np.arange(-0.5, DURATION_S + 0.6, 1.0 / hz)


def pulses(
    platform: Platform, count: int, sector_rad: float, rng: np.random.Generator
) -> velodyne.Firings:
    """Random pulses of the flight within an angle about the scanner's axis from straight down, in
    order of time.
    """
    down = (
        Rotation.from_euler("ZYX", np.radians(platform.boresight_deg[::-1]))
        .inv()
        .apply([0.0, 0.0, -1.0])
    )
    straight = math.atan2(down[1], down[0])
    turn = rng.integers(0, int(DURATION_S / velodyne.TURN_S), count)
    azimuth = straight + rng.uniform(-sector_rad, sector_rad, count)
    t = np.sort((turn + np.mod(-azimuth / (2 * np.pi), 1.0)) * velodyne.TURN_S)
    ring = rng.integers(0, BEAM_COUNT, count)
    elevation = np.radians(np.sort(velodyne.FIRING_ORDER_DEG))[ring]
    return velodyne.Firings(t, -2 * np.pi * t / velodyne.TURN_S, elevation, ring.astype(np.uint16))


def rotation_of_angles(angles: F64) -> Rotation:
    """Body → map rotations of roll, pitch and yaw (n, 3) rad, ``Rz Ry Rx``: scipy's own take ten
    times as long on many.
    """
    (cr, cp, cy), (sr, sp, sy) = np.cos(0.5 * angles.T), np.sin(0.5 * angles.T)
    across, along = (cr * sp, sr * cp), (cr * cp, sr * sp)
    return Rotation.from_quat(
        np.stack(
            [
                across[1] * cy - across[0] * sy,
                across[0] * cy + across[1] * sy,
                along[0] * sy - along[1] * cy,
                along[0] * cy + along[1] * sy,
            ],
            axis=1,
        )
    )


@dataclass(frozen=True)
class Path:
    """Where the platform truly is at times t_s (n,): position (n, 3) m, roll, pitch and yaw (n, 3)
    rad, and the rotations they are.
    """

    t_s: F64
    position: F64
    angles: F64
    rotation: Rotation

    @classmethod
    def at(cls, platform: Platform, t_s: F64) -> Path:
        """The path at these times."""
        angles = platform.angles(t_s)
        return cls(t_s, platform.position(t_s), angles, rotation_of_angles(angles))

    def select(self, keep: I64) -> Path:
        """The path at some of the times."""
        return Path(self.t_s[keep], self.position[keep], self.angles[keep], self.rotation[keep])

    def measured_rotation(self, error: F64) -> Rotation:
        """Body → map rotations as measured with errors (n, 3) rad of roll, pitch and yaw."""
        return rotation_of_angles(self.angles + error)


@lru_cache(maxsize=2)
def pulses_of(site: Site | BoxSite, flight: int) -> tuple[velodyne.Firings, Path]:
    """The pulses of one flight that go near its site and the path at them: surveys with one source
    at a time share them.
    """
    platform = uav(*site.flight_m, DURATION_S)
    f = pulses(platform, site.pulses, site.sector_rad, np.random.default_rng([flight, PULSES]))
    near = aim_at(site, platform, f)
    f = velodyne.Firings(f.time_s[near], f.azimuth[near], f.elevation[near], f.ring[near])
    return f, Path.at(platform, f.time_s)


def aim_at(site: Site | BoxSite, platform: Platform, f: velodyne.Firings) -> I64:
    """The pulses (k,) that come within :data:`NEAR_M` of the surveyed rectangle on their way
    through the heights of the site, seen from the nearest sample of the path.
    """
    path, _, _ = states_of(site)
    row = np.rint((f.time_s - path.t_s[0]) * ATTITUDE_HZ).astype(np.int64)
    boresight = rotation_of_angles(np.radians(np.array(platform.boresight_deg))[None])[0]
    ray = path.rotation[row].apply(boresight.apply(velodyne.directions(f.azimuth, f.elevation)))
    ends = [
        path.position[row, :2] + ray[:, :2] * ((z - path.position[row, 2]) / ray[:, 2])[:, None]
        for z in site.heights_m
    ]
    reach = np.array(site.half_m) + NEAR_M
    return np.flatnonzero(
        ((np.minimum(*ends) <= reach) & (np.maximum(*ends) >= -reach)).all(axis=1)
        & (ray[:, 2] < 0.0)
    )


@lru_cache(maxsize=4)
def states_of(site: Site | BoxSite) -> tuple[Path, F64, F64]:
    """The path at the times of the attitudes, the antenna's velocity and the body rates (n, 3)
    there.
    """
    platform, h = uav(*site.flight_m, DURATION_S), 1e-3
    t = sample_times(ATTITUDE_HZ)
    return (
        Path.at(platform, t),
        (platform.position(t + h) - platform.position(t - h)) / (2 * h),
        platform.rates(t),
    )


@lru_cache(maxsize=2)
def ground_of(site: Site | BoxSite, seed: int) -> RoughGround:
    """The ground of one survey."""
    return site.ground(seed)


@dataclass(frozen=True)
class Aim:
    """What decides where pulses go: laser → body quaternion, lever arm (m), vertical offsets of the
    beams (rad), noise of angles and footprint (rad).
    """

    rotation: tuple[float, ...]
    lever: tuple[float, ...]
    vertical: tuple[float, ...]
    azimuth_noise_rad: float
    vertical_noise_rad: float
    beam_divergence_rad: float


@lru_cache(maxsize=8)
def hits_of(
    site: Site | BoxSite, ground: int, flight: int, aim: Aim
) -> tuple[velodyne.Firings, Path, F64, F64]:
    """The pulses that become vertices, the path at them, their true ranges (k,) and hits (k, 3) m:
    most sources leave them as they are.
    """
    f, path = pulses_of(site, flight)
    budget = BudgetParameters(
        azimuth_noise_rad=aim.azimuth_noise_rad,
        vertical_noise_rad=aim.vertical_noise_rad,
        beam_divergence_rad=aim.beam_divergence_rad,
    )
    beams = velodyne.BeamErrors(0.0, np.zeros(BEAM_COUNT), np.array(aim.vertical))
    local = velodyne.true_directions(f, beams, budget, np.random.default_rng([flight, SPOT]))
    ray = path.rotation.apply(Rotation.from_quat(aim.rotation).apply(local))
    origin = path.position + path.rotation.apply(aim.lever)
    true = site.ranges(origin, ray, ground_of(site, ground))
    hit = origin + true[:, None] * ray
    keep = site.sampled(hit)
    kept = velodyne.Firings(f.time_s[keep], f.azimuth[keep], f.elevation[keep], f.ring[keep])
    return kept, path.select(keep), true[keep], hit[keep]
