"""Options of ``ladar_volume up``."""

from __future__ import annotations

import argparse
from pathlib import Path

from ladar_volume.cli.arguments.lines import Verbs
from ladar_volume.cli.arguments.parameter_flags import add_parameter
from ladar_volume.cli.arguments.replay import add_common
from ladar_volume.cli.arguments.work import work
from ladar_volume.cli.help.summaries import SUMMARIES


def add_parser(subparsers: Verbs) -> None:
    """Declare the verb."""
    parser = subparsers.add_parser("up", help=SUMMARIES["up"])
    parser.add_argument(
        "--play",
        type=Path,
        metavar="BAG",
        help="recording to play through the nodes; without it they run until stopped",
    )
    parser.add_argument("--rate", type=float, default=1.0, help="times real time")
    parser.add_argument(
        "--separate", action="store_true", help="every node in a process of its own"
    )
    add_parameter(
        parser, "--mavlink", "mavlink.url", metavar="URL", more="poses then come from the autopilot"
    )
    parser.add_argument(
        "--warm",
        action="store_true",
        help="compile the kernels, which are kept, and end: the first start then takes seconds",
    )
    parser.add_argument("--log", type=Path, help="MCAP file to log inputs and results to")
    parser.add_argument("--log-all", action="store_true", help="log also what is derived: large")
    _add_viewers(parser)
    parser.add_argument(
        "--ros-args",
        nargs=argparse.REMAINDER,
        default=[],
        metavar="...",
        help="remappings and the like for all nodes; last on the line",
    )
    add_common(parser)
    parser.set_defaults(run=work("ladar_volume.cli.up"))


def _add_viewers(parser: argparse.ArgumentParser) -> None:
    """What shows the survey while it runs."""
    parser.add_argument(
        "--page",
        nargs="?",
        const="8080",
        metavar="[ADDRESS:]PORT",
        help="serve a page with volume, map and health (default 127.0.0.1:8080)",
    )
    parser.add_argument(
        "--page-token", metavar="TOKEN", help="needed where others can reach the page's address"
    )
    parser.add_argument(
        "--foxglove",
        nargs="?",
        const="8765",
        metavar="[ADDRESS:]PORT",
        help="hand mesh, volume, sigma and points to Foxglove (default 127.0.0.1:8765)",
    )
