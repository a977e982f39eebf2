"""Compile the kernels, or load them from their cache, before data arrives that would have to wait for it."""

from __future__ import annotations

import contextlib
from functools import cache

import numpy as np

from ladar_volume.engine import Engine
from ladar_volume.model.errors import LadarVolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import Fix, ImuSample, Returns

HEIGHT_M, SECONDS, RETURNS_PER_CLOUD = 5.0, 4, 600


@cache
def warm_up() -> None:
    """Carry a made-up survey of a mound, four seconds long, through every stage; the second call in a process does nothing."""
    square = [-1.5, -1.5, 1.5, -1.5, 1.5, 1.5, -1.5, 1.5]
    parameters = Parameters.read({"filter": {"radius_m": 0.15}, "volume": {"object_height_m": 0.1}})
    engine = Engine(parameters)
    rng = np.random.default_rng(1)
    for step in range(SECONDS * 10):
        t_ns = 1_000_000_000_000 + step * 100_000_000
        engine.add_fix(Fix(t_ns, 50.0, 14.0, HEIGHT_M, np.eye(3) * 1e-4))
        engine.add_imu(ImuSample(t_ns, np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), np.eye(3) * 1e-6))
        xy = rng.uniform(-3.0, 3.0, (RETURNS_PER_CLOUD, 2))
        mound = np.maximum(0.0, 0.6 - 0.5 * np.hypot(xy[:, 0], xy[:, 1]))
        xyz = np.column_stack([xy, mound - HEIGHT_M + rng.normal(0.0, 0.005, len(xy))])
        t = t_ns + np.arange(len(xy), dtype=np.int64) * 100_000
        engine.add_returns(Returns(t, xyz, rng.integers(0, 16, len(xy)).astype(np.uint16), np.ones(len(xy), np.float32)))
        engine.step()
        if step == SECONDS * 5:
            _estimate(engine)
    _estimate(engine)
    engine.estimator.set_parameters(Parameters.read({"volume": {"outline": "polygon", "polygon_m": square}}, parameters))
    _estimate(engine)


def _estimate(engine: Engine) -> None:
    # a volume is not what this is for: whatever a stage says of this little survey, its kernels are ready
    with contextlib.suppress(LadarVolumeError):
        engine.estimate()
