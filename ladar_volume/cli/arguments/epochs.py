"""Options of ``ladar_volume epochs``."""

from __future__ import annotations

import argparse
import re
from pathlib import Path

from ladar_volume.cli.arguments.lines import Verbs
from ladar_volume.cli.arguments.strict import add_strict_option
from ladar_volume.cli.arguments.work import work
from ladar_volume.model.choices import CALIBRATION_GROUPS


def add_parser(subparsers: Verbs) -> None:
    """Declare the verb."""
    parser = subparsers.add_parser(
        "epochs",
        help="change between two surveys, with level of detection",
        description="NEW minus PREVIOUS over the common footprint. Both are folders that "
        "'replay' or "
        "volume_node's ~/save wrote. The "
        "calibration counts as common to both, but for the clock offset.",
    )
    parser._negative_number_matcher = re.compile(
        r"^-(\d|\.\d)[\d.,eE+-]*$"
    )  # argparse takes -1,2 for an option
    _add_surveys(parser)
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path("change"),
        help="folder for epochs.json, change.ply, change.png",
    )
    parser.add_argument("--json", action="store_true", help="print epochs.json to standard output")
    parser.add_argument("--no-figure", action="store_true", help="skip the picture")
    add_strict_option(parser)
    parser.set_defaults(run=work("ladar_volume.cli.epochs"))


def _add_surveys(parser: argparse.ArgumentParser) -> None:
    """The two surveys, what they share, and where they are compared."""
    parser.add_argument(
        "previous", type=Path, help="results of the earlier survey: a folder, or its result.mcap"
    )
    parser.add_argument("new", type=Path, help="results of the later survey")
    parser.add_argument(
        "--separate",
        action="append",
        default=[],
        metavar="GROUP",
        choices=[*CALIBRATION_GROUPS, "all"],
        help=(
            "calibrated anew between the two, may be given again: "
            f"{', '.join(CALIBRATION_GROUPS)}, or all"
        ),
    )
    parser.add_argument(
        "--transform",
        type=Path,
        metavar="FILE",
        help=(
            "JSON of 'register NEW PREVIOUS': lays the new survey on the previous one, with "
            "its covariance"
        ),
    )
    parser.add_argument(
        "--polygon",
        nargs="+",
        metavar="X,Y",
        help="only within these corners, or a file of rows x y",
    )
    parser.add_argument(
        "--stable",
        nargs="+",
        metavar="X,Y",
        help="ground within these corners (or a file of them) did not change: the surveys must "
        "agree there (default: the ground that does not differ by more than its noise)",
    )
