"""Options of ``ladar_volume filter``."""

from __future__ import annotations

import argparse
from pathlib import Path

from ladar_volume.cli.arguments.lines import Verbs
from ladar_volume.cli.arguments.parameter_flags import add_parameter
from ladar_volume.cli.arguments.reading import add_reading_options
from ladar_volume.cli.arguments.strict import add_strict_option
from ladar_volume.cli.arguments.work import work
from ladar_volume.cli.help.summaries import SUMMARIES
from ladar_volume.clouds.published.filter_presets import PRESETS
from ladar_volume.io.endings import CLOUD_ENDINGS
from ladar_volume.model.choices import KEEPABLE


def add_parser(subparsers: Verbs) -> None:
    """Declare the verb."""
    kinds = " ".join(CLOUD_ENDINGS)
    parser = subparsers.add_parser(
        "filter",
        help=SUMMARIES["filter"],
        description="Robust moving least squares on a point cloud file. Without --radius, --preset "
        "or --set filter.radius_m=..., radius, "
        "degree and threshold are estimated from the cloud (--auto).",
    )
    parser.add_argument("cloud", type=Path, help=f"point cloud ({kinds})")
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="OUT",
        help="filtered points with normal, sigma and input index",
    )
    _add_settings(parser)
    parser.add_argument(
        "--outliers",
        type=Path,
        metavar="FILE",
        help="points taken out, with input index and reason",
    )
    parser.add_argument(
        "--json", action="store_true", help="print the result as JSON to standard output"
    )
    parser.add_argument(
        "--keep",
        action="append",
        default=[],
        choices=KEEPABLE,
        help="keep these points as they are although they lie on no surface",
    )
    add_reading_options(parser)
    add_strict_option(parser)
    parser.set_defaults(run=work("ladar_volume.cli.filter"))


def _add_settings(parser: argparse.ArgumentParser) -> None:
    """Radius, degree and the other parameters of the filter."""
    add_parameter(parser, "--radius", "filter.radius_m", metavar="R", more="fits reach over 2 r")
    add_parameter(parser, "--degree", "filter.degree", metavar="{1,2}")
    parser.add_argument("--preset", choices=sorted(PRESETS), help="published settings")
    parser.add_argument(
        "--auto",
        action="store_true",
        help="estimate radius, degree and threshold from the cloud (the default)",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="filter.KEY=VALUE",
        help="override one parameter",
    )
