"""``ladar_volume simulate``: a survey of a scene with a known volume, as a recording."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress

from ladar_volume.io.config import read_config
from ladar_volume.simulation.bag import write_bag
from ladar_volume.simulation.platforms import make_platform
from ladar_volume.simulation.scenes import make_scene
from ladar_volume.simulation.survey import Survey, SurveyOptions

#: Filter and outline that suit a scene; everything else keeps its default.
SUITED: dict[str, dict[str, dict[str, Any]]] = {
    "box": {
        "filter": {"radius_m": 0.08, "degree": 1, "min_points": 8, "cap_per_voxel": 12},
        "volume": {"object_height_m": 0.1, "outline_margin_m": 0.3, "ground_ring_m": 2.5, "max_edge_m": 1.5},
        "georeference": {"region_m": [-4.5, -4.0, -2.0, 4.5, 4.0, 5.0]},
    },
    "pile": {
        "filter": {"radius_m": 0.6, "degree": 2, "cap_per_voxel": 20},
        "volume": {"object_height_m": 0.25, "outline_margin_m": 1.0, "ground_ring_m": 8.0},
        "georeference": {"region_m": [-20.0, -18.0, -10.0, 20.0, 18.0, 30.0]},
    },
}


def add_parser(subparsers: Any) -> None:
    """Declare the verb."""
    parser = subparsers.add_parser("simulate", help="simulate a survey of a scene with a known volume")
    parser.add_argument(
        "scene", help="stockpile, cone, cone_100, frustum, stockpile_5000, box, nist_box, kern_before, kern_after, sphere, square"
    )
    parser.add_argument("--platform", choices=("uav", "rover"), default="uav")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--duration", type=float, default=36.0, help="seconds")
    parser.add_argument("--thin", type=int, default=1, help="keep every N-th firing cycle (1: the full rate)")
    parser.add_argument("--gnss-hz", type=float, default=10.0)
    parser.add_argument("--imu-hz", type=float, default=100.0)
    parser.add_argument("--config", type=Path, help="budget and parameters, written into the recording's config.yaml")
    parser.add_argument("-o", "--output", type=Path, required=True, help="recording folder to create")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Simulate and write; prints the true volume."""
    console = Console(stderr=True)
    scene = make_scene(arguments.scene, arguments.seed)
    platform = make_platform(arguments.platform, scene.extent_m, arguments.duration)
    options = SurveyOptions(arguments.duration, max(1, arguments.thin), arguments.gnss_hz, arguments.imu_hz, seed=arguments.seed)
    parameters = read_config(arguments.config)
    survey = Survey(scene, platform, parameters.budget, options)
    suited = {s: dict(v) for s, v in SUITED["box" if arguments.scene == "box" else "pile"].items()}
    suited["budget"] = parameters.write()["budget"]
    with Progress(console=console, transient=True) as bar:
        task = bar.add_task("simulating", total=1.0)
        write_bag(survey, arguments.output, suited, lambda share: bar.update(task, completed=share))
    console.print(f"{arguments.output}: {scene.name}, true volume {scene.volume_m3:.3f} m³")
    return 0
