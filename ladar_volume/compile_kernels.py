"""Compile the kernels, or load them from their cache, before data arrives that would have to wait
for it.

A made-up survey of a mound from a platform that stands still above it, four seconds long, goes
through the stage that is asked for, or through the volume the surface that a filter would make of
it. Only the modules of that stage are loaded: each node holds no more than it runs.

``python -m ladar_volume.compile_kernels [STAGE ...]`` compiles what the caches lack, and ends.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import sys
from collections.abc import Iterator, Sequence
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ladar_volume.model.errors import LadarVolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import (
    F64,
    I64,
    FilteredPoints,
    FilterUpdate,
    Fix,
    ImuSample,
    MappedPoints,
    Patches,
    PlatformStates,
    Returns,
    select,
)
from ladar_volume.process.compile_apart import compiled_apart
from ladar_volume.process.compile_progress import COMPILE_PROGRESS

if TYPE_CHECKING:
    from ladar_volume.rmls.surface_filter import SurfaceFilter
    from ladar_volume.volume.estimator import VolumeEstimator

HEIGHT_M, SECONDS, RETURNS_PER_CLOUD = 5.0, 4, 600
STAGES = ("georeference", "filter", "volume", "epochs")
#: What no node needs: filter and closed bodies of point-cloud files, and their volumes.
CLOUDS, CLOUD_VOLUMES = "clouds", "cloud_volumes"
#: Asks for a dot on stdout for each kernel, in place of lines on stderr.
TICKS = "--ticks"
START_NS, BIN_NS = 1_000_000_000_000, round(Parameters().filter.nav_bin_s * 1e9)
#: Numba's compiler makes millions of objects that live as long as their kernel. Looking for cycles
#: among them as often as Python does by default takes a sixth of the time (gc.set_threshold).
RARE_COLLECTIONS = (200_000, 20, 100)
SQUARE = [-1.5, -1.5, 1.5, -1.5, 1.5, 1.5, -1.5, 1.5]


@cache
def warm_up(stage: str) -> None:
    """Run one of :data:`STAGES` on the made-up survey, or :data:`CLOUDS` or :data:`CLOUD_VOLUMES`;
    the second call for it in a process does nothing.
    """
    parameters = Parameters.read({"filter": {"radius_m": 0.15}, "volume": {"object_height_m": 0.1}})
    if stage == "georeference":
        _georeference(parameters)
    elif stage == "filter":
        _filter(parameters)
    elif stage == "volume":
        _volume(parameters)
    elif stage == CLOUDS:
        _clouds_and_bodies()
    elif stage == CLOUD_VOLUMES:
        _cloud_volumes()
    else:
        _epochs(parameters)


def load_kernels(stage: str) -> None:
    """As :func:`warm_up`, for a process that stays: another one compiles what the cache lacks."""
    program = [sys.executable, "-m", "ladar_volume.compile_kernels", TICKS, stage]
    with compiled_apart(program):
        warm_up(stage)


def _clouds() -> Iterator[tuple[int, I64, F64, Returns]]:
    """Stamp, times (n,), points in the map (n, 3) and the same as returns, ten clouds a second."""
    rng = np.random.default_rng(1)
    for step in range(SECONDS * 10):
        stamp = START_NS + step * 100_000_000
        xy = rng.uniform(-3.0, 3.0, (RETURNS_PER_CLOUD, 2))
        mound = np.maximum(0.0, 0.6 - 0.5 * np.hypot(xy[:, 0], xy[:, 1]))
        xyz = np.column_stack([xy, mound + rng.normal(0.0, 0.005, len(xy))])
        t = stamp + np.arange(len(xy), dtype=np.int64) * 100_000
        ring = rng.integers(0, 16, len(xy)).astype(np.uint16)
        yield (
            stamp,
            t,
            xyz,
            Returns(t, xyz - [0.0, 0.0, HEIGHT_M], ring, np.ones(len(xy), np.float32)),
        )


def _georeference(parameters: Parameters) -> None:
    stage = importlib.import_module("ladar_volume.georeference.georeferencer").Georeferencer(
        parameters
    )
    for stamp, _, _, returns in _clouds():
        stage.add_fix(Fix(stamp, 50.0, 14.0, HEIGHT_M, np.eye(3) * 1e-4))
        stage.add_imu(
            ImuSample(stamp, np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), np.eye(3) * 1e-6)
        )
        stage.add_returns(returns)


def _platform_at_rest(t: I64) -> PlatformStates:
    n, zero = len(t), np.zeros((len(t), 3))
    q = np.tile([0.0, 0.0, 0.0, 1.0], (n, 1))
    C = np.tile(np.diag([1e-4] * 3 + [1e-6] * 3), (n, 1, 1))
    return PlatformStates(
        t, np.tile([0.0, 0.0, HEIGHT_M], (n, 1)), q, zero, zero, C, np.zeros(n, np.int64)
    )


def _filter(parameters: Parameters) -> None:
    surface: SurfaceFilter = importlib.import_module(
        "ladar_volume.rmls.surface_filter"
    ).SurfaceFilter(parameters, deferring=True)
    C_ind = np.tile(np.array([1e-4, 0, 0, 1e-4, 0, 1e-4], np.float32), (RETURNS_PER_CLOUD, 1))
    for step, (stamp, t, xyz, returns) in enumerate(_clouds()):
        surface.add_platform(_platform_at_rest(np.array([stamp, stamp + 99_999_999], np.int64)))
        surface.add(MappedPoints(t, xyz, C_ind, returns.ring, returns.intensity))
        if step in (SECONDS * 5, SECONDS * 10 - 1):
            surface.update(50)
    surface.finish()


def _made_up_surface(side: int, beams: int, seed: int = 1, hole: bool = False) -> FilterUpdate:
    """The mound as a filter would send it: (side, side) patches of 15 cm, each with four points and
    a block with the next. hole : whether a place on its slope was not seen
    """
    rng, edge, m, p = np.random.default_rng(seed), 0.15, side * side, 6
    key, ones = np.arange(m, dtype=np.int64), np.ones(m)
    xy = (
        np.stack(np.meshgrid(np.arange(side), np.arange(side), indexing="ij"), axis=-1).reshape(
            -1, 2
        )
        - side / 2
    ) * edge
    axes = np.eye(3)[[2, 0]]
    next_one = np.minimum(key + 1, m - 1)[:, None]
    cross_key = np.hstack([key[:, None], next_one]).ravel()[:-1]
    blocks = np.tile(1e-6 * np.eye(p, dtype=np.float32), (len(cross_key), 1, 1))
    patches = Patches(
        key,
        np.c_[xy, 0.0 * ones],
        np.tile(axes[0], (m, 1)),
        np.tile(axes[1], (m, 1)),
        np.zeros((m, p)),
        0.005 * ones,
        np.full(m, 40, np.int32),
        np.full(m, START_NS),
        np.append(2 * key, 2 * m - 1),
        cross_key,
        blocks,
        np.full((m, p + 2, 11 + 2 * beams), 0.1, np.float32),
        2 * np.arange(m + 1),
        START_NS // BIN_NS + np.arange(2 * m) % 2,
        np.full((2 * m, p + 2, 4), 0.1, np.float32),
    )
    points = _made_up_points(key, xy, axes, rng)
    if hole:
        points = select(points, np.abs(points.r_map[:, :2] - [0.5, 0.0]).max(axis=1) > 0.25)
    return FilterUpdate(START_NS, key[:0], points, patches)


def _made_up_points(
    key: I64, xy: npt.NDArray[np.floating], axes: F64, rng: np.random.Generator
) -> FilteredPoints:
    """Four points on each of the m patches at xy (m, 2) m, on the mound."""
    m = len(key)
    local = np.tile(
        [[-0.04, -0.04], [0.04, -0.04], [-0.04, 0.04], [0.04, 0.04]], (m, 1)
    ) + rng.uniform(-0.02, 0.02, (4 * m, 2))
    at = np.repeat(xy, 4, axis=0) + local
    z = np.maximum(0.0, 0.6 - 0.5 * np.hypot(at[:, 0], at[:, 1])) + rng.normal(0.0, 0.002, 4 * m)
    return FilteredPoints(
        np.c_[at, z],
        np.tile(axes[0], (4 * m, 1)),
        np.full(4 * m, 1e-6),
        np.zeros((4 * m, 6), np.float32),
        np.full(4 * m, START_NS),
        np.repeat(key, 4),
        local,
    )


def _volume(parameters: Parameters) -> None:
    estimator: VolumeEstimator = importlib.import_module(
        "ladar_volume.volume.estimator"
    ).VolumeEstimator(parameters)
    estimator.add_platform(_platform_at_rest(np.array([START_NS, START_NS + BIN_NS], np.int64)))
    for hole in (False, True):  # the second update is merged with the first
        estimator.add(_made_up_surface(24, parameters.georeference.beams, hole=hole))
        _estimate(estimator)
    estimator.set_parameters(
        Parameters.read({"volume": {"outline": "polygon", "polygon_m": SQUARE}}, parameters)
    )
    _estimate(estimator)


def _epochs(parameters: Parameters) -> None:
    stage, epochs = (
        importlib.import_module(f"ladar_volume.{name}")
        for name in ("volume.estimator", "change.epoch_change")
    )
    kept = []
    for seed in (1, 2):
        estimator: VolumeEstimator = stage.VolumeEstimator(parameters)
        estimator.add_platform(_platform_at_rest(np.array([START_NS, START_NS + BIN_NS], np.int64)))
        estimator.add(_made_up_surface(24, parameters.georeference.beams, seed))
        kept.append(estimator.epoch())
    epochs.epoch_difference(kept[1], kept[0])


def _clouds_and_bodies() -> None:
    """A box on the ground seen along the rings of a scanner, one of points in no order, and one
    that is closed.
    """
    filtered = importlib.import_module("ladar_volume.clouds.filter_cloud").filter_cloud
    options = importlib.import_module("ladar_volume.model.cloud_filter_parameters")
    survey_bodies = importlib.import_module("ladar_volume.clouds.survey.survey_bodies")
    rng = np.random.default_rng(1)
    ring, turn = (
        np.deg2rad(np.repeat(np.arange(-30.0, -5.0, 2.0), 400)),
        np.linspace(0.0, 6.28, 400),
    )
    reach = 2.0 / np.tan(-ring)
    lines = reach[:, None] * np.c_[np.cos(np.tile(turn, 13)), np.sin(np.tile(turn, 13))]
    filtered(_box_from_above(lines, rng), options.FilterParameters(), auto=True)
    along, up = rng.uniform(-1.0, 1.0, (2, 1500))
    one, up = np.ones(1500), 0.3 + 0.3 * up
    walls = np.r_[
        np.c_[along, one, up], np.c_[along, -one, up], np.c_[one, along, up], np.c_[-one, along, up]
    ]
    walls += rng.normal(0.0, 0.005, walls.shape)
    above = _box_from_above(rng.uniform(-2.0, 2.0, (6000, 2)), rng)
    filtered(above, options.FilterParameters(), auto=True)
    seen = np.r_[above, walls]
    with contextlib.suppress(LadarVolumeError):  # whether it can be closed is not asked here
        survey_bodies.mesh_returns(seen, Parameters())


def _box_from_above(xy: F64, rng: np.random.Generator) -> F64:
    """Points (n, 3) m at places (n, 2) of a box of 2 by 2 by 0.6 m and the ground around it."""
    top = np.where(np.abs(xy).max(axis=1) < 1.0, 0.6, 0.0)
    return np.column_stack([xy, top + rng.normal(0.0, 0.005, len(xy))])


def _cloud_volumes() -> None:
    """A mound above its ground, and above a level with fewer vertices."""
    measured = importlib.import_module("ladar_volume.api.verbs").volume
    rng = np.random.default_rng(1)
    xy = rng.uniform(-2.0, 2.0, (6000, 2))
    z = np.maximum(0.0, 0.8 - np.hypot(xy[:, 0], xy[:, 1])) + rng.normal(0.0, 0.005, len(xy))
    mound = np.column_stack([xy, z])
    with contextlib.suppress(LadarVolumeError):
        measured(mound, "ground")
        measured(mound, 0.2, vertices=0.3, exchange="asd")


def _estimate(estimator: VolumeEstimator) -> None:
    # a volume is not what this is for: whatever the stage says of this little survey, its kernels
    # are ready
    with contextlib.suppress(LadarVolumeError):
        estimator.estimate()
        estimator.more_data()


def main(words: Sequence[str]) -> int:
    """Compile the named stages, or those of all nodes. Returns the exit code."""
    gc.set_threshold(*RARE_COLLECTIONS)
    COMPILE_PROGRESS.ticks = TICKS in words
    COMPILE_PROGRESS.to_stderr = not COMPILE_PROGRESS.ticks
    for stage in [w for w in words if w != TICKS] or STAGES:
        warm_up(stage)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
