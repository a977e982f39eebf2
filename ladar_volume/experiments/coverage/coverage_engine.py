"""Surveys of ``ladar_volume study coverage`` through the whole engine: rays cast at the scene's
mesh, written as PointCloud2, fixes and attitudes to a recording, and replayed as the command line
replays one.
"""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from ladar_volume.change.epoch_change import epoch_difference
from ladar_volume.experiments.coverage.coverage_box import BOX, closed_box, one_per_cube
from ladar_volume.experiments.coverage.coverage_cases import (
    CLOSED,
    DEFAULT,
    EPOCHS,
    GROUND,
    LEVEL,
    SITES,
    Row,
    believed_parameters,
    closed_row,
    level_half,
    row_of,
)
from ladar_volume.experiments.coverage.coverage_scene import SLOPE, Site
from ladar_volume.io.bags import BagReader
from ladar_volume.io.config import read_config
from ladar_volume.model.choices import CALIBRATION_GROUPS
from ladar_volume.model.records import select
from ladar_volume.model.survey_parameters import SurveyParameters
from ladar_volume.replay import Replay
from ladar_volume.simulation.bag import write_bag
from ladar_volume.simulation.platforms import Platform, platform_for, uav
from ladar_volume.simulation.scenes import Ground, Scene, box_scene, make_scene, polar_mesh
from ladar_volume.simulation.suited_parameters import suited_settings
from ladar_volume.simulation.survey import Survey

#: Scenes of stockpiles, by scenario.
SCENES = {"stockpile_100": "cone_100", "stockpile_5000": "stockpile_5000"}
DURATION_S = 36.0
#: Every so many firing cycles are simulated; returns do not mix then, since the neighbour of a
#: pulse is degrees away.
THIN = 15
#: So many times more for a box; cubes of which one filtered point each is meshed, and the longest
#: edge of the mesh, m.
BOX_MORE, BOX_CELL_M, BOX_EDGE_M = 3, 0.2, 1.0
#: Settings of the filter for a box of this size.
BOX_SETTINGS: dict[str, dict[str, Any]] = {
    "filter": {"radius_m": 0.2, "degree": 1, "min_points": 8, "cap_per_voxel": 12},
    "volume": {"base": "level", "outline": "all"},
    "georeference": {"region_m": [-6.0, -4.5, -2.0, 6.0, 4.5, 5.0]},
}


def measure_by_engine(scenario: str, seed: int, thin: int = THIN) -> dict[str, Row]:
    """One survey, or two for a difference, from messages to the volume: by base its error and what
    the result says of it.
    """
    site = SITES[scenario]
    if not isinstance(site, Site):
        return {CLOSED: box_by_engine(seed, thin)}
    return (
        {EPOCHS: pit_by_engine(site, seed, thin)}
        if site.height_m < 0
        else stockpile_by_engine(site, seed, thin)
    )


def fly_and_replay(
    scene: Scene, platform: Platform, settings: dict[str, dict[str, Any]], seed: int, thin: int
) -> Replay:
    """A flight with all errors, recorded and replayed."""
    flown = Survey(
        scene, platform, DEFAULT, SurveyParameters(DURATION_S, thin, mixed_share=0.0, seed=seed)
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flight"
        write_bag(flown, path, settings, lambda share: None)
        with BagReader(path) as bag:
            replay = Replay(bag, read_config(path / "config.yaml"), bag.roles({}))
            replay.run()
    return replay


def stockpile_by_engine(site: Site, seed: int, thin: int) -> dict[str, Row]:
    """One flight over a stockpile, above its own ground and above a level."""
    scene = make_scene(SCENES[site.name], seed)
    replay = fly_and_replay(
        scene, platform_for(scene, "uav", DURATION_S), suited_settings(scene), seed, thin
    )
    estimator = replay.engine.estimator
    own = estimator.estimate().volume
    above = believed_parameters(DEFAULT, site, LEVEL).volume
    estimator.set_parameters(
        dataclasses.replace(
            replay.parameters,
            volume=dataclasses.replace(
                replay.parameters.volume,
                base=above.base,
                level_m=above.level_m,
                outline=above.outline,
                polygon_m=above.polygon_m,
            ),
        )
    )
    x, y = level_half(site)
    ground = Ground(
        slope=SLOPE, rough_m=site.rough_m, length_m=site.length_m, seed=seed
    ).mean_over_box(-x, x, -y, y)
    level = scene.volume_m3 + 4.0 * x * y * ground
    return {GROUND: row_of(own, scene.volume_m3), LEVEL: row_of(estimator.estimate().volume, level)}


def pit_scene(site: Site, seed: int, dug: bool) -> Scene:
    """The ground of one survey, with the pit or without."""
    depth = site.height_m if dug else 0.0
    inner = np.linspace(0.0, 1.0, 41)[1:]
    rho = np.unique(
        np.concatenate([inner, [site.top], 1.0 + np.geomspace(0.02, 30.0 / site.a, 60)])
    )
    ground = Ground(slope=SLOPE, rough_m=site.rough_m, length_m=site.length_m, seed=seed)
    vertices, triangles = polar_mesh(
        rho,
        site.a,
        site.b,
        lambda r: depth * np.clip((1.0 - r) / (1.0 - site.top), 0.0, 1.0),
        ground,
    )
    return Scene(
        site.name, vertices, triangles, site.volume_m3 if dug else 0.0, np.zeros((0, 2)), 30.0
    )


def pit_by_engine(site: Site, seed: int, thin: int) -> Row:
    """Two flights, each with an instrument calibrated anew, and the difference of both surfaces
    over the site's rectangle.
    """
    x, y = site.half_m
    settings: dict[str, dict[str, Any]] = {
        "filter": {"radius_m": 0.5, "degree": 2, "cap_per_voxel": 20},
        "volume": {"base": "level", "outline": "all"},
        "georeference": {"region_m": [-x - 1.0, -y - 1.0, -10.0, x + 1.0, y + 1.0, 10.0]},
    }
    platform = uav(*site.flight_m, DURATION_S)
    before, after = (
        fly_and_replay(
            pit_scene(site, seed, dug), platform, settings, 2 * seed + dug, thin
        ).engine.estimator.epoch()
        for dug in (False, True)
    )
    rectangle = np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
    return row_of(
        epoch_difference(after, before, CALIBRATION_GROUPS, rectangle)[0].volume, site.volume_m3
    )


def box_by_engine(seed: int, thin: int) -> Row:
    """One flight over a box, as a closed body. The walls, seen at a glance, need more pulses; of
    the filtered points, which lie in clusters where scan lines cross, one of each cube is meshed.
    """
    ground = Ground(slope=SLOPE, rough_m=BOX.rough_m, length_m=BOX.length_m, seed=seed)
    replay = fly_and_replay(
        box_scene("box", BOX.size_m, ground),
        uav(*BOX.flight_m, DURATION_S),
        BOX_SETTINGS,
        seed,
        max(1, thin // BOX_MORE),
    )
    sources = replay.engine.estimator.epoch().sources
    points = select(sources.points, one_per_cube(sources.points.r_map, BOX_CELL_M))
    found = closed_box(points, sources.patches, sources.navigation, replay.parameters, BOX_EDGE_M)
    return closed_row(found, BOX.volume_m3)
