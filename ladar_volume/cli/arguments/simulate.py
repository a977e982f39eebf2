"""Options of ``ladar_volume simulate``."""

from __future__ import annotations

import argparse
from pathlib import Path

from ladar_volume.cli.arguments.lines import Verbs
from ladar_volume.cli.arguments.parameter_flags import add_parameter
from ladar_volume.cli.arguments.work import work
from ladar_volume.cli.help.summaries import SUMMARIES


def _span(text: str) -> tuple[float, float]:
    first, _, last = text.partition(":")
    try:
        return float(first), float(last)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not FROM:TO in seconds") from None


def add_parser(subparsers: Verbs) -> None:
    """Declare the verb."""
    parser = subparsers.add_parser("simulate", help=SUMMARIES["simulate"])
    parser.add_argument(
        "scene",
        help=(
            "stockpile, cone, cone_100, frustum, stockpile_5000, box, nist_box, kern_before, "
            "kern_after, sphere, square"
        ),
    )
    parser.add_argument(
        "--platform",
        choices=("uav", "lanes", "rover"),
        default="uav",
        help=(
            "uav: a figure of eight; lanes: both ways in two directions, for calibrate "
            "strips (72 s or more); rover: two loops"
        ),
    )
    _add_measurements(parser)
    parser.add_argument(
        "--config",
        type=Path,
        help="budget and parameters, written into the recording's config.yaml",
    )
    parser.add_argument(
        "-o", "--output", type=Path, required=True, help="recording folder to create"
    )
    parser.set_defaults(run=work("ladar_volume.cli.simulate"))


def _add_measurements(parser: argparse.ArgumentParser) -> None:
    """What is measured along the path, and what goes wrong."""
    add_parameter(parser, "--seed", "survey.seed", own_default=True)
    add_parameter(parser, "--duration", "survey.duration_s", own_default=True)
    add_parameter(parser, "--thin", "survey.thin", own_default=True)
    add_parameter(parser, "--gnss-hz", "survey.gnss_hz", own_default=True)
    add_parameter(parser, "--imu-hz", "survey.imu_hz", own_default=True)
    parser.add_argument(
        "--outage",
        type=_span,
        action="append",
        default=[],
        metavar="FROM:TO",
        help="seconds without a fix; repeatable",
    )
    parser.add_argument(
        "--float",
        type=_span,
        action="append",
        default=[],
        metavar="FROM:TO",
        help="seconds with a float fix; repeatable",
    )
    add_parameter(
        parser,
        "--mixed",
        "survey.mixed_share",
        metavar="SHARE",
        own_default=True,
        more="default 0.1; 0 with --thin: a neighbour is then many degrees away",
    )
