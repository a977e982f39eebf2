"""One simulated survey: true path, drawn errors, ray-cast sweeps, and the sensor samples that come
of them.

Everything wrong with the survey is drawn here from the budget, by this room's own code; the
pipeline sees samples and nominal values only. ``Survey.truth`` names what was drawn.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.model.survey_parameters import SurveyParameters
from ladar_volume.simulation import velodyne
from ladar_volume.simulation.drawn_errors import draw_errors
from ladar_volume.simulation.platforms import Platform
from ladar_volume.simulation.scenes import Scene

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]
Fixes = tuple[I64, F64, F64, I64]
Attitudes = tuple[I64, F64, F64, F64]
#: Start of every simulated recording: 2026-05-01 08:00:00 UTC.
EPOCH_NS = 1_777_622_400_000_000_000
#: Origin of the scenes' coordinates.
LATITUDE_DEG, LONGITUDE_DEG, HEIGHT_M = 50.0755, 14.4378, 235.0


@dataclass(frozen=True)
class Sweep:
    """One cloud: stamp (ns), per-point offset (s), xyz (m), intensity, ring."""

    stamp_ns: int
    time_s: npt.NDArray[np.float32]
    xyz: npt.NDArray[np.float32]
    intensity: npt.NDArray[np.float32]
    ring: npt.NDArray[np.uint16]


class RayCaster:
    """Distances to a scene and its normals along rays. Open3D is loaded here, where rays are cast:
    half a second and 300 MB.
    """

    def __init__(self, scene: Scene) -> None:
        self._o3d = importlib.import_module("open3d")
        self._scene = self._o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(
            self._o3d.core.Tensor(scene.vertices.astype(np.float32)),
            self._o3d.core.Tensor(scene.triangles.astype(np.uint32)),
        )

    def cast(self, rays: npt.NDArray[np.float32]) -> tuple[F64, npt.NDArray[np.float32]]:
        """Distances (n,), m, infinite where nothing is met, and normals (n, 3) there, along rays
        (n, 6): origin and direction.
        """
        hit = self._scene.cast_rays(self._o3d.core.Tensor(rays), nthreads=2)
        return hit["t_hit"].numpy().astype(np.float64), hit["primitive_normals"].numpy()


@dataclass
class Survey:
    """Draws its errors on construction; then yields fixes, attitudes and sweeps.

    stated_budget : the budget whose sigmas receiver and IMU state; None for the one that is drawn
    from
    """

    scene: Scene
    platform: Platform
    budget: BudgetParameters
    options: SurveyParameters
    truth: dict[str, Any] = field(default_factory=dict)
    stated_budget: BudgetParameters | None = None

    def __post_init__(self) -> None:
        o, b = self.options, self.budget
        rng = np.random.default_rng([o.seed, 1])
        self._boresight = rng.normal(0, b.boresight_sigma_rad)
        self._lever_laser = np.array(self.platform.lever_laser_m) + rng.normal(
            0, b.lever_laser_sigma_m
        )
        self._lever_antenna = np.array(self.platform.lever_antenna_m) + rng.normal(
            0, b.lever_antenna_sigma_m
        )
        self._clock_s = float(rng.normal(0, b.clock_sigma_s))
        self._beams = velodyne.BeamErrors.draw(b, rng)
        self.truth = {
            "scene": self.scene.name,
            "volume_m3": self.scene.volume_m3,
            "seed": o.seed,
            "boresight_error_rad": self._boresight.tolist(),
            "lever_laser_m": self._lever_laser.tolist(),
            "lever_antenna_m": self._lever_antenna.tolist(),
            "clock_error_s": self._clock_s,
            "range_bias_m": self._beams.range_bias,
            "beam_range_m": self._beams.rho.tolist(),
            "beam_vertical_rad": self._beams.eps.tolist(),
            **self.scene.extra,
        }
        nav_rng = np.random.default_rng([o.seed, 2])
        self._fixes = self._draw_fixes(nav_rng)
        self._attitudes = self._draw_attitudes(nav_rng)

    def fixes(self) -> Fixes:
        """Times (ns), antenna positions in scene coordinates (n, 3), sigmas (n, 3) and status (−1
        outage, 0 float, 2 fix).
        """
        return self._fixes

    def attitudes(self) -> Attitudes:
        """Times (ns), quaternions xyzw (n, 4), body rates (n, 3), covariances about the map's axes
        (n, 3, 3).
        """
        return self._attitudes

    def _draw_fixes(self, rng: np.random.Generator) -> Fixes:
        o, b = self.options, self.budget
        t = np.arange(-0.5, o.duration_s + 0.6, 1.0 / o.gnss_hz)
        sigma = np.array(b.position_sigma_m)
        error, bias = draw_errors(
            t, sigma, b.position_bias_fraction, b.position_white_fraction, b.tau_position_s, rng
        )
        self.truth["position_bias_m"] = bias.tolist()
        status = np.full(len(t), 2)
        scale = np.ones(len(t))
        for first, last in o.float_spans_s:
            inside = (t >= first) & (t < last)
            status[inside], scale[inside] = 0, 10.0
        for first, last in o.outages_s:
            status[(t >= first) & (t < last)] = -1
        antenna = self.platform.position(t) + self.platform.rotation(t).apply(self._lever_antenna)
        stated = np.array((self.stated_budget or b).position_sigma_m)
        return _ns(t), antenna + error * scale[:, None], stated * scale[:, None], status

    def _draw_attitudes(self, rng: np.random.Generator) -> Attitudes:
        o, b = self.options, self.budget
        t = np.arange(-0.5, o.duration_s + 0.6, 1.0 / o.imu_hz)
        sigma = np.array(b.attitude_sigma_rad)
        error, bias = draw_errors(
            t, sigma, b.attitude_bias_fraction, b.attitude_white_fraction, b.tau_attitude_s, rng
        )
        self.truth["attitude_bias_rad"] = bias.tolist()
        angles = self.platform.angles(t)
        measured = angles + error
        q = Rotation.from_euler("ZYX", measured[:, ::-1]).as_quat()
        axes = np.zeros(
            (len(t), 3, 3)
        )  # map-axis rotation per small roll, pitch, yaw: columns of the gimbal
        cp, sp, cy, sy = (
            np.cos(angles[:, 1]),
            np.sin(angles[:, 1]),
            np.cos(angles[:, 2]),
            np.sin(angles[:, 2]),
        )
        axes[:, :, 0] = np.column_stack([cp * cy, cp * sy, -sp])
        axes[:, :, 1] = np.column_stack([-sy, cy, np.zeros(len(t))])
        axes[:, 2, 2] = 1.0
        stated = np.array((self.stated_budget or b).attitude_sigma_rad)
        covariance = axes @ np.diag(stated**2) @ axes.transpose(0, 2, 1)
        rates = self.platform.rates(t) + rng.normal(0, 1e-3, (len(t), 3))
        return _ns(t), q, rates, covariance

    def sweeps(self) -> Iterator[Sweep]:
        """Clouds of one turn each, in laser coordinates, returns only; every call gives the
        same.
        """
        rays = RayCaster(self.scene)
        nominal = Rotation.from_euler("ZYX", np.radians(self.platform.boresight_deg[::-1]))
        mounting = Rotation.from_rotvec(self._boresight) * nominal
        rng = np.random.default_rng(self.options.seed)
        for k in range(int(self.options.duration_s / velodyne.TURN_S)):
            sweep = self._sweep(k * velodyne.TURN_S, rays, mounting, rng)
            if len(sweep.time_s):
                yield sweep

    def _sweep(
        self, start_s: float, caster: RayCaster, mounting: Rotation, rng: np.random.Generator
    ) -> Sweep:
        o = self.options
        f = velodyne.sweep(start_s, o.thin)
        body = mounting.apply(velodyne.true_directions(f, self._beams, self.budget, rng))
        R = self.platform.rotation(f.time_s)
        origin = self.platform.position(f.time_s) + R.apply(self._lever_laser)
        rays = np.concatenate([origin, R.apply(body)], axis=1).astype(np.float32)
        true = np.full(len(rays), np.nan)
        down = rays[:, 5] < 0.35  # steeper up there is nothing to hit
        normals = np.zeros((len(rays), 3))
        true[down], normals[down] = caster.cast(rays[down])
        true[~np.isfinite(true) | (true > o.max_range_m)] = np.nan
        rho = velodyne.measured_ranges(
            true, f.ring, self._beams, self.budget, o.mixed_share, rng, o.range_step_m
        )
        keep = np.isfinite(rho) & (rho > 0.3) & (rng.random(len(rho)) >= o.dropout_share)
        xyz = rho[keep, None] * velodyne.directions(f.azimuth[keep], f.elevation[keep])
        facing = np.abs(np.sum(normals[keep] * rays[keep, 3:], axis=1))
        intensity = np.round(np.clip(90.0 * facing, 1, 255)).astype(np.float32)
        stamp = EPOCH_NS + round((start_s - self._clock_s) * 1e9)
        offset = (f.time_s[keep] - start_s).astype(np.float32)
        return Sweep(stamp, offset, xyz.astype(np.float32), intensity, f.ring[keep])


def _ns(t: F64) -> I64:
    return EPOCH_NS + np.rint(t * 1e9).astype(np.int64)
