"""Georeferencing: pose interpolation, LiDAR equation and 3x3 covariance, points per second.

The compiled pass against its plain numpy twin on the same clouds, and the whole stage as a node
feeds it. Compilation is done before.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numba
import numpy as np

from ladar_volume.georeference.error_budget import independent_sigmas
from ladar_volume.georeference.georeferencer import Georeferencer
from ladar_volume.georeference.lidar_equation import mounting
from ladar_volume.georeference.mapping import (
    MappingResult,
    map_returns,
    map_returns_numpy,
    region_box,
    vehicle_box,
)
from ladar_volume.georeference.trajectory import PathWindow, interval_velocities
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import Fix, ImuSample, Returns

CLOUDS, PER_CLOUD, REPEATS = 60, 30_000, 7
PARAMETERS = Parameters.read({"georeference": {"range_max_m": 1000.0}})


def _quaternions(seconds: np.ndarray) -> np.ndarray:
    half = 0.05 * np.sin(seconds)
    return np.stack([np.sin(half), np.zeros_like(half), np.zeros_like(half), np.cos(half)], axis=-1)


def _clouds() -> list[Returns]:
    rng = np.random.default_rng(1)
    out = []
    for i in range(CLOUDS):
        t = round((0.2 + 0.1 * i) * 1e9) + np.sort(rng.integers(0, 100_000_000, PER_CLOUD))
        direction = rng.normal(size=(PER_CLOUD, 3))
        r = (
            direction
            / np.linalg.norm(direction, axis=1, keepdims=True)
            * rng.uniform(2, 60, (PER_CLOUD, 1))
        )
        out.append(
            Returns(
                t,
                r,
                rng.integers(0, 16, PER_CLOUD).astype(np.uint16),
                np.ones(PER_CLOUD, np.float32),
            )
        )
    return out


def _window(cloud: Returns) -> PathWindow:
    """Attitudes at 200 Hz and fixes at 10 Hz around one cloud."""
    t0 = int(cloud.t_ns[0])
    state_t = t0 - 5_000_000 + 5_000_000 * np.arange(24)
    position_t = t0 - 200_000_000 + 100_000_000 * np.arange(6)
    p = position_t[:, None] * 1e-9 * np.array([5.0, 0.1, 0.0])
    return PathWindow(
        state_t,
        _quaternions(state_t * 1e-9),
        np.zeros(24, np.int64),
        position_t,
        p,
        *interval_velocities(position_t, p, np.zeros(6, np.int64), "parabola"),
        True,
    )


def _best(function: Callable[[], object]) -> float:
    function()
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return min(times)


def _stage(clouds: list[Returns]) -> None:
    stage = Georeferencer(PARAMETERS)
    kept, fixes, imus = 0, 0, 0
    for i, cloud in enumerate(clouds):
        until = 0.4 + 0.1 * i
        while fixes * 0.1 <= until:
            stage.add_fix(
                Fix(round(fixes * 1e8), 50.0 + 1e-6 * fixes, 14.0, 200.0, np.eye(3) * 1e-4)
            )
            fixes += 1
        while imus * 0.005 <= until:
            q = _quaternions(np.array(imus * 0.005))
            stage.add_imu(ImuSample(imus * 5_000_000, q, np.zeros(3), np.eye(3) * 1e-8))
            imus += 1
        stage.add_returns(cloud)
        kept += sum(len(p) for p in stage.take_points())
        stage.take_platform()
    if kept < (CLOUDS - 2) * PER_CLOUD:
        raise RuntimeError(f"only {kept} returns were mapped: {stage.losses}")


def run() -> dict[str, float | int | str]:
    """Best of seven passes over 1.8 million returns."""
    clouds = _clouds()
    windows = [_window(c) for c in clouds]
    mount, sigmas = mounting(PARAMETERS.calibration), independent_sigmas(PARAMETERS.budget)
    vehicle, region = vehicle_box(()), region_box(())

    def all_clouds(pass_: Callable[..., MappingResult]) -> Callable[[], list[MappingResult]]:
        return lambda: [
            pass_(c.t_ns, c.r_laser, w, mount, sigmas, vehicle, region)
            for c, w in zip(clouds, windows, strict=True)
        ]

    n = CLOUDS * PER_CLOUD
    fast, plain = _best(all_clouds(map_returns)), _best(all_clouds(map_returns_numpy))
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    single = _best(all_clouds(map_returns))
    numba.set_num_threads(threads)
    stage = _best(lambda: _stage(clouds))
    return {
        "threads": threads,
        "compiled, million points / s": n / fast / 1e6,
        "compiled on one thread, million points / s": n / single / 1e6,
        "numpy twin, million points / s": n / plain / 1e6,
        "compiled / numpy": plain / fast,
        "whole stage with 10 Hz fixes and 200 Hz attitudes, million points / s": n / stage / 1e6,
    }


if __name__ == "__main__":
    for key, value in run().items():
        print(f"{key}: {value:.4g}" if isinstance(value, float) else f"{key}: {value}")
