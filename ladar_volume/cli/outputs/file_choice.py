"""Which files are asked for, checked before anything is computed."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console

from ladar_volume.cli.arguments.lines import shown_name
from ladar_volume.io.export.export_set import ExportedFiles, ExportRequest, check_packages
from ladar_volume.io.export.formats import formats_of
from ladar_volume.io.results import SURVEY_FILES
from ladar_volume.model.errors import ConfigurationError, OutputError

#: What a replay leaves behind beside its result: the survey itself, which would be lost.
RECORDED = SURVEY_FILES[1]


def checked_choice(arguments: argparse.Namespace) -> ExportRequest:
    """The files of the options. Raises :class:`ConfigurationError` for options that contradict one
    another, ModuleNotFoundError for a package that is missing, and :class:`OutputError` for a
    folder that holds a replayed survey, which would be lost.
    """
    a = arguments
    formats = formats_of(a.formats)
    for option, value, kind in (
        ("--cell", a.cell, "tif"),
        ("--contour-interval", a.contour_interval, "contours"),
    ):
        if value is not None and kind not in formats:
            raise ConfigurationError(f"{option} is for --as {kind}, which is not asked for")
    check_packages(formats)
    folder: Path = a.output
    if (folder / RECORDED).exists():
        raise OutputError(
            f"{folder}: holds the result of a replay: give another folder",
            reason="output_exists",
            value=str(folder),
        )
    return ExportRequest(formats, a.cell, a.contour_interval)


def show_written(console: Console, folder: Path, written: ExportedFiles) -> None:
    """Print which files there are now."""
    for note in written.notes:
        console.print(note, markup=False)
    console.print(f"written to {shown_name(folder)}/: {', '.join(written.names)}")


def check_no_files(arguments: argparse.Namespace) -> None:
    """Refuse options of files where none are written. Raises :class:`ConfigurationError`."""
    a = arguments
    given = {
        "--as": a.formats,
        "--cell": a.cell,
        "--contour-interval": a.contour_interval,
        "--file-units": a.file_units or None,
    }
    for option, value in given.items():
        if value is not None:
            raise ConfigurationError(f"{option} goes with -o OUT, the folder of the files")
