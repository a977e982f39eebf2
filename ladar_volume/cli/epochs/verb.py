"""``ladar_volume epochs``: what changed between two surveys of one place, with its standard
deviation and the level of detection.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console

from ladar_volume.cli.arguments.work import of_known_kind
from ladar_volume.cli.epochs.clouds import compare_clouds
from ladar_volume.cli.epochs.rows import show_clouds, show_surveys
from ladar_volume.cli.verdict_lines import exit_code
from ladar_volume.io import results
from ladar_volume.io.output_set import output_set
from ladar_volume.model.errors import ConfigurationError

#: What the verb writes.
FILES = ("epochs.json", "change.ply", "change.png")
#: Options that only one kind of input has, and what they are where no one gives them.
OF_CLOUDS = {"register": None, "reach": None, "sigma": None, "sigma_b": None, "clean": "auto",
             "crs": None, "units": None, "classes": None}  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Read both surveys, compare, print, write the output folder."""
    console = Console(stderr=arguments.json)
    by_clouds = is_of_clouds(arguments)
    with output_set(arguments.output, FILES) as folder:
        if by_clouds:
            facts = compare_clouds(arguments, folder, console)
        else:
            from ladar_volume.cli.epochs.surveys import compare_surveys  # with ROS

            facts = compare_surveys(arguments, folder, console)
    if arguments.json:
        print(results.json_text(facts), end="")
    else:
        (show_clouds if by_clouds else show_surveys)(console, facts)
        console.print(f"written to {arguments.output}/")
    return exit_code(arguments, facts["verdict"])


def is_of_clouds(arguments: argparse.Namespace) -> bool:
    """Whether two point clouds are compared. Raises :class:`ConfigurationError` for a cloud beside
    a survey, and for options that the inputs have no use for.
    """
    paths: list[Path] = [arguments.previous, arguments.new]
    clouds = [path for path in paths if path.is_file() and of_known_kind(path)]
    if len(clouds) == 1:
        other = next(path for path in paths if path not in clouds)
        raise ConfigurationError(
            f"{clouds[0]} is a point cloud and {other} is none: compare two of a kind; the surface "
            "of a replayed survey is mesh.ply in its folder",
            value=str(clouds[0]),
        )
    if clouds and arguments.separate:
        raise ConfigurationError("--separate is for surveys: a point cloud tells no calibration")
    if not clouds:
        given = [n for n, usual in OF_CLOUDS.items() if getattr(arguments, n) != usual]
        if given:
            option = f"--{given[0].replace('_', '-')}"
            words = f"{option} is for point clouds, and these are surveys: --transform moves one"
            raise ConfigurationError(words, value=given[0])
    return bool(clouds)
