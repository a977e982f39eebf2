"""Surveys of ``ladar_volume study coverage`` through the whole engine: rays cast at the scene's mesh, written as PointCloud2, fixes and
attitudes to a recording, and replayed as the command line replays one."""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path

from ladar_volume.cli.replay import Replay
from ladar_volume.cli.simulate import suited
from ladar_volume.io.bags import BagReader
from ladar_volume.io.config import read_config
from ladar_volume.simulation.bag import write_bag
from ladar_volume.simulation.platforms import platform_for
from ladar_volume.simulation.scenes import Ground, make_scene
from ladar_volume.simulation.survey import Survey, SurveyOptions
from ladar_volume.studies.coverage_cases import DEFAULT, GROUND, LEVEL, Row, believed_parameters, level_half, row_of
from ladar_volume.studies.coverage_scene import SITES, SLOPE

#: Scenes that are cast, by scenario.
SCENES = {"stockpile_100": "cone_100", "stockpile_5000": "stockpile_5000"}
DURATION_S = 36.0
#: Every so many firing cycles are simulated; returns do not mix then, since the neighbour of a pulse is degrees away.
THIN = 15


def measured_by_engine(scenario: str, seed: int, thin: int = THIN) -> dict[str, Row]:
    """One flight over a stockpile, from messages to the volume: by base its error and what the result says of it."""
    scene = make_scene(SCENES[scenario], seed)
    options = SurveyOptions(DURATION_S, thin, mixed_share=0.0, seed=seed)
    flown = Survey(scene, platform_for(scene, "uav", DURATION_S), DEFAULT, options)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flight"
        write_bag(flown, path, suited(scene), lambda share: None)
        with BagReader(path) as bag:
            replay = Replay(bag, read_config(path / "config.yaml"), bag.roles({}))
            own = replay.run().volume
    site, estimator = SITES[scenario], replay.engine.estimator
    above = believed_parameters(DEFAULT, site, LEVEL).volume
    estimator.set_parameters(dataclasses.replace(replay.parameters, volume=dataclasses.replace(
        replay.parameters.volume, base=above.base, level_m=above.level_m, outline=above.outline, polygon_m=above.polygon_m)))  # fmt: skip
    x, y = level_half(site)
    ground = Ground(slope=SLOPE, rough_m=site.rough_m, length_m=site.length_m, seed=seed).mean_over_box(-x, x, -y, y)
    level = scene.volume_m3 + 4.0 * x * y * ground
    return {GROUND: row_of(own, scene.volume_m3), LEVEL: row_of(estimator.estimate().volume, level)}
