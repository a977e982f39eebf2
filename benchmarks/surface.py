"""The Delaunay kernel against Qhull, and one estimate of the bundled stockpile's volume."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial import Delaunay

from ladar_volume.io.bags import BagReader
from ladar_volume.io.config import read_config
from ladar_volume.replay import Replay
from ladar_volume.tin.full_tin import build_tin

BAG = Path(__file__).parents[1] / "bags" / "stockpile"


def median_s(action: Callable[[], object], times: int = 3) -> float:
    """Median wall seconds."""
    walls = []
    for _ in range(times):
        began = time.perf_counter()
        action()
        walls.append(time.perf_counter() - began)
    return statistics.median(walls)


def run() -> dict[str, float | int | str]:
    """Medians of three, compilation done before."""
    rng = np.random.default_rng(5)
    build_tin(rng.random((1000, 3)))
    points = rng.random((200_000, 3)) * [1000.0, 1000.0, 1.0]
    own = median_s(lambda: build_tin(points))
    qhull = median_s(lambda: Delaunay(points[:, :2]))
    with BagReader(BAG) as bag:
        replay = Replay(bag, read_config(BAG / "config.yaml"), bag.roles())
        estimate = replay.run()
    return {
        "TIN of 200,000 random points / s": own,
        "million points / s": 0.2 / own,
        "Qhull / s": qhull,
        "Qhull time / own time": qhull / own,
        "vertices of the stockpile's TIN": len(estimate.tin.vertices),
        "one estimate with its budget / s": median_s(replay.engine.estimator.estimate),
    }


if __name__ == "__main__":
    print(run())
