"""What errors do not change of a flight in ``ladar_volume study coverage``: its true path, its pulses and its ground, computed once for
all surveys that share it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from ladar_volume.model.records import F64, I64
from ladar_volume.simulation import velodyne
from ladar_volume.simulation.platforms import Platform, uav
from ladar_volume.studies.coverage_box import BoxSite
from ladar_volume.studies.coverage_scene import RoughGround, Site

DURATION_S, FIX_HZ, ATTITUDE_HZ = 36.0, 10.0, 50.0
BEAM_COUNT = 16
#: The stream of random numbers for a flight's pulses.
PULSES = 0


def sample_times(hz: float) -> F64:
    """Times (n,) s of samples at this rate, from before the flight to after it."""
    return np.arange(-0.5, DURATION_S + 0.6, 1.0 / hz)


def pulses(platform: Platform, count: int, sector_rad: float, rng: np.random.Generator) -> velodyne.Firings:
    """Random pulses of the flight within an angle about the scanner's axis from straight down, in order of time."""
    down = Rotation.from_euler("ZYX", np.radians(platform.boresight_deg[::-1])).inv().apply([0.0, 0.0, -1.0])
    straight = math.atan2(down[1], down[0])
    turn = rng.integers(0, int(DURATION_S / velodyne.TURN_S), count)
    azimuth = straight + rng.uniform(-sector_rad, sector_rad, count)
    t = np.sort((turn + np.mod(-azimuth / (2 * np.pi), 1.0)) * velodyne.TURN_S)
    ring = rng.integers(0, BEAM_COUNT, count)
    elevation = np.radians(np.sort(velodyne.FIRING_ORDER_DEG))[ring]
    return velodyne.Firings(t, -2 * np.pi * t / velodyne.TURN_S, elevation, ring.astype(np.uint16))


@dataclass(frozen=True)
class Path:
    """Where the platform truly is at times t_s (n,): position (n, 3) m, roll, pitch and yaw (n, 3) rad, and the rotations they are."""

    t_s: F64
    position: F64
    angles: F64
    rotation: Rotation

    @classmethod
    def at(cls, platform: Platform, t_s: F64) -> Path:
        """The path at these times."""
        angles = platform.angles(t_s)
        return cls(t_s, platform.position(t_s), angles, Rotation.from_euler("ZYX", angles[:, ::-1]))

    def select(self, keep: I64) -> Path:
        """The path at some of the times."""
        return Path(self.t_s[keep], self.position[keep], self.angles[keep], self.rotation[keep])

    def measured_rotation(self, error: F64) -> Rotation:
        """Body → map rotations as measured with errors (n, 3) rad of roll, pitch and yaw."""
        return Rotation.from_euler("ZYX", (self.angles + error)[:, ::-1])


@lru_cache(maxsize=2)
def pulses_of(site: Site | BoxSite, flight: int) -> tuple[velodyne.Firings, Path]:
    """The pulses of one flight and the path at them: surveys with one source at a time share them."""
    platform = uav(*site.flight_m, DURATION_S)
    f = pulses(platform, site.pulses, site.sector_rad, np.random.default_rng([flight, PULSES]))
    return f, Path.at(platform, f.time_s)


@lru_cache(maxsize=4)
def states_of(site: Site | BoxSite) -> tuple[Path, F64, F64]:
    """The path at the times of the attitudes, the antenna's velocity and the body rates (n, 3) there."""
    platform, h = uav(*site.flight_m, DURATION_S), 1e-3
    t = sample_times(ATTITUDE_HZ)
    return Path.at(platform, t), (platform.position(t + h) - platform.position(t - h)) / (2 * h), platform.rates(t)


@lru_cache(maxsize=2)
def ground_of(site: Site | BoxSite, seed: int) -> RoughGround:
    """The ground of one survey."""
    return site.ground(seed)
