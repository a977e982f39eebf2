"""``ladar_volume simulate``: a survey of a scene with a known volume, as a recording."""

from __future__ import annotations

import argparse

from rich.console import Console
from rich.progress import Progress

from ladar_volume.io.atomic_write import new_folder
from ladar_volume.io.config import read_config
from ladar_volume.model.survey_parameters import SurveyParameters
from ladar_volume.simulation.bag import write_bag
from ladar_volume.simulation.platforms import platform_for
from ladar_volume.simulation.scenes import make_scene
from ladar_volume.simulation.suited_parameters import suited_settings
from ladar_volume.simulation.survey import Survey


def run(arguments: argparse.Namespace) -> int:
    """Simulate and write; prints the true volume."""
    console = Console(stderr=True)
    options = SurveyParameters(
        arguments.duration,
        arguments.thin,
        arguments.gnss_hz,
        arguments.imu_hz,
        mixed_share=arguments.mixed,
        outages_s=tuple(arguments.outage),
        float_spans_s=tuple(arguments.float),
        seed=arguments.seed,
    )
    scene = make_scene(arguments.scene, arguments.seed)
    platform = platform_for(scene, arguments.platform, arguments.duration)
    parameters = read_config(arguments.config)
    survey = Survey(scene, platform, parameters.budget, options)
    settings = suited_settings(scene)
    settings["budget"] = parameters.write()["budget"]
    with (
        new_folder(arguments.output) as part,
        Progress(console=console, transient=True, disable=not console.is_terminal) as bar,
    ):
        task = bar.add_task("simulating", total=1.0)
        write_bag(survey, part, settings, lambda share: bar.update(task, completed=share))
    console.print(f"{arguments.output}: {scene.name}, true volume {scene.volume_m3:.3f} m³")
    return 0
