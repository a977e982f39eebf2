"""Options of the files that a result is written as, and of ``ladar_volume export``."""

from __future__ import annotations

import argparse
from pathlib import Path

from ladar_volume.cli.arguments.lines import Verbs
from ladar_volume.cli.arguments.parameter_flags import number
from ladar_volume.cli.arguments.work import work
from ladar_volume.cli.help.summaries import SUMMARIES
from ladar_volume.io.export.formats import FORMATS, USUAL


def add_parser(subparsers: Verbs) -> None:
    """Declare the verb."""
    parser = subparsers.add_parser(
        "export",
        help=SUMMARIES["export"],
        description=(
            "Surface, base, outline, contours and points of a replayed survey as files for other "
            "programs. Without --crs in the survey's own east, north, up: true lengths in m."
        ),
    )
    parser.add_argument("result", type=Path, help="folder that replay wrote, or its result.mcap")
    add_file_options(parser, required=True)
    parser.add_argument(
        "--crs",
        metavar="EPSG:CODE",
        help="project to this system, in metres, on the receiver's datum, as a UTM zone; V is "
        "not changed, and how much larger the map is stands in result.json",
    )
    parser.set_defaults(run=work("ladar_volume.cli.outputs.export"))


def add_file_options(parser: argparse.ArgumentParser, required: bool = False) -> None:
    """Declare the options that say which files are written, and where."""
    g = parser.add_argument_group("files for other programs")
    g.add_argument(
        "-o",
        "--output",
        type=Path,
        required=required,
        metavar="OUT",
        help="folder to write them to",
    )
    g.add_argument(
        "--as",
        dest="formats",
        metavar="KIND,KIND|all",
        help=f"{', '.join(FORMATS)} (default: {','.join(USUAL)})",
    )
    g.add_argument(
        "--cell",
        type=positive,
        metavar="LENGTH",
        help="cells of the GeoTIFF, in the units of the files (default: about the spacing)",
    )
    g.add_argument(
        "--contour-interval",
        type=positive,
        metavar="LENGTH",
        help="between contours, in the units of the files (default: about twelve heights)",
    )


def add_unit_option(parser: argparse.ArgumentParser) -> None:
    """Declare ``--file-units``."""
    parser.add_argument(
        "--file-units",
        action="store_true",
        help="with -o: files in the units and the system of the input, as feet (default: metres)",
    )


def positive(text: str) -> float:
    """A finite number above 0 from the command line."""
    value = number(text)
    if not value > 0.0:
        raise argparse.ArgumentTypeError(f"{text} is not above 0")
    return value
