"""Options of ``ladar_volume register``."""

from __future__ import annotations

import argparse
from pathlib import Path

from ladar_volume.cli.arguments.lines import Verbs
from ladar_volume.cli.arguments.strict import add_strict_option
from ladar_volume.cli.arguments.work import work
from ladar_volume.cli.help.summaries import SUMMARIES


def add_parser(subparsers: Verbs) -> None:
    """Declare the verb."""
    parser = subparsers.add_parser(
        "register",
        help=SUMMARIES["register"],
        description="A and B hold points on the spheres, at least 12 each, with a column 'sphere' "
        "that numbers them alike in both (wrong numbers are found by the distances between the "
        "centres), and optionally 't' (seconds), by which it is tested that each stood still. The "
        "transform takes A's frame to B's.",
    )
    _add_spheres(parser)
    parser.add_argument(
        "--levelled",
        action="store_true",
        help="both instruments are levelled: rotation about Z only",
    )
    parser.add_argument("--free-scale", action="store_true", help="find the scale too")
    parser.add_argument(
        "--apply", type=Path, metavar="CLOUD", help="a cloud in A's frame to transform"
    )
    parser.add_argument(
        "-o", "--output", type=Path, metavar="OUT", help="where the transformed cloud goes"
    )
    parser.add_argument(
        "--json", action="store_true", help="print the result as JSON to standard output"
    )
    add_strict_option(parser)
    parser.set_defaults(run=work("ladar_volume.cli.register"))


def _add_spheres(parser: argparse.ArgumentParser) -> None:
    """Points on the spheres, their radius and noise."""
    parser.add_argument(
        "a",
        type=Path,
        help=(
            "points on spheres, source frame (say, the scanner's): CSV or any point cloud "
            "with the column"
        ),
    )
    parser.add_argument(
        "b", type=Path, help="points on spheres, target frame (say, the tacheometer's)"
    )
    parser.add_argument(
        "--radius",
        type=float,
        metavar="R",
        help="radius of the spheres in m (default: found, which costs accuracy)",
    )
    parser.add_argument(
        "--noise-a",
        type=float,
        metavar="S",
        help="sigma of A's points in m (default: from the residuals)",
    )
    parser.add_argument("--noise-b", type=float, metavar="S", help="sigma of B's points in m")
