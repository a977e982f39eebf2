"""``ladar_volume export``: a replayed survey as files for other programs."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console

from ladar_volume.cli.arguments.lines import shown_name
from ladar_volume.cli.outputs.file_choice import checked_choice, show_written
from ladar_volume.io.export.export_set import write_export
from ladar_volume.io.export.survey_surface import survey_deliverable
from ladar_volume.io.surveys import read_survey
from ladar_volume.volume.estimator import VolumeEstimator


def run(arguments: argparse.Namespace) -> int:
    """Read, compute the surface again, write."""
    wanted = checked_choice(arguments)
    folder: Path = arguments.result
    console = Console()
    with console.status(f"reading {shown_name(folder.name)}") as status:
        saved = read_survey(folder)
        estimator = VolumeEstimator.from_updates(saved.parameters, saved.navigation, saved.updates)
        survey = survey_deliverable(saved, estimator, arguments.crs)
        status.update("writing")
        written = write_export(arguments.output, survey, wanted)
    scale = survey.system.scale
    if scale != 1.0:
        console.print(
            f"{shown_name(survey.system.name)}: lengths on the map are {scale:.6f} of the true "
            f"ones, volumes between the faces {scale**2:.6f}; V in result.json is the true one"
        )
    show_written(console, arguments.output, written)
    return 0
