"""Closed bodies of whole surveys: simulated boxes of random size and orientation, flown and driven
round, recorded, replayed with ``volume.kind: bodies``. Error of each against its printed sigma.

``python -m benchmarks survey_bodies``: bias and spread in per cent, 95 % intervals that
hold, refused and doubtful surveys; the surface's volume of the same replay beside it.
"""

from __future__ import annotations

import dataclasses
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ladar_volume.io.bags import BagReader
from ladar_volume.io.config import read_config
from ladar_volume.model.errors import LadarVolumeError
from ladar_volume.model.survey_parameters import SurveyParameters
from ladar_volume.replay import Replay
from ladar_volume.simulation.bag import write_bag
from ladar_volume.simulation.platforms import platform_for
from ladar_volume.simulation.scenes import Ground, Scene, box_scene
from ladar_volume.simulation.suited_parameters import suited
from ladar_volume.simulation.survey import Survey

#: Every so many firing cycles; seconds of a survey; surveys.
THIN, DURATION_S, SURVEYS = 1, 24.0, 12


class BoxError(NamedTuple):
    """Of one survey, m³: the truth, the body's volume and sigma, the surface's; doubts, or why it
    was refused.
    """

    truth: float
    body: float
    sigma: float
    surface: float
    surface_sigma: float
    words: str


def turned(scene: Scene, angle: float) -> Scene:
    """The scene turned about the vertical."""
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, s], [-s, c]])
    vertices = scene.vertices.copy()
    vertices[:, :2] = vertices[:, :2] @ R
    return dataclasses.replace(scene, vertices=vertices, outline=scene.outline @ R)


def box(seed: int) -> BoxError:
    """One survey of a box."""
    rng = np.random.default_rng([seed, 24])
    size = (rng.uniform(1.5, 3.5), rng.uniform(1.0, 2.2), rng.uniform(0.6, 1.6))
    ground = Ground(slope=(0.01, 0.005), rough_m=0.003, length_m=0.7, seed=seed)
    scene = turned(box_scene("box", size, ground), rng.uniform(0.0, 2.0 * np.pi))
    settings = suited(scene)
    settings["filter"] |= {"radius_m": 0.1}
    settings["volume"] |= {"kind": "bodies"}
    platform = platform_for(scene, ("uav", "rover")[seed % 2], DURATION_S)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "bag"
        start = read_config(None)
        settings["budget"] = start.write()["budget"]
        options = SurveyParameters(DURATION_S, THIN, 10.0, 100.0, mixed_share=0.0, seed=seed)
        write_bag(
            Survey(scene, platform, start.budget, options), folder, settings, lambda share: None
        )
        with BagReader(folder) as bag:
            replay = Replay(bag, read_config(folder / "config.yaml"), bag.roles({}))
            estimate = replay.run()
            v = estimate.volume
            surface = v.volume_m3, v.sigma_m3
            try:
                found = replay.closed_bodies(estimate)
            except LadarVolumeError as error:
                return BoxError(scene.volume_m3, np.nan, np.nan, *surface, str(error))
    words = "; ".join(d.text for d in found.verdict.doubts)
    one = found.bodies[0]
    return BoxError(scene.volume_m3, one.volume_m3, one.sigma_m3, *surface, words)


def run(surveys: int = SURVEYS, first: int = 0) -> dict[str, float | int | str]:
    """The figures of docs/bodies.md."""
    rows = []
    for seed in range(first, first + surveys):
        rows.append(box(seed))
        print(seed, rows[-1], file=sys.stderr, flush=True)
    made = [r for r in rows if np.isfinite(r.body)]
    error = np.array([100.0 * (r.body / r.truth - 1.0) for r in made])
    z = np.array([(r.body - r.truth) / r.sigma for r in made])
    surface = np.array([100.0 * (r.surface / r.truth - 1.0) for r in rows])
    return {
        "surveys": surveys,
        "refused": len(rows) - len(made),
        "doubtful": sum(bool(r.words) for r in made),
        "body, bias %": round(float(error.mean()), 3),
        "body, spread %": round(float(error.std(ddof=1)), 3),
        "body, mean sigma %": round(float(np.mean([100.0 * r.sigma / r.truth for r in made])), 3),
        "body, mean and spread of z": f"{z.mean():+.2f} ± {z.std(ddof=1):.2f}",
        "body, 95 % intervals that hold": f"{int((np.abs(z) < 1.96).sum())} of {len(z)}",
        "surface, bias %": round(float(surface.mean()), 3),
        "surface, spread %": round(float(surface.std(ddof=1)), 3),
    }


if __name__ == "__main__":
    for key, value in run().items():
        print(f"{key} : {value}")
