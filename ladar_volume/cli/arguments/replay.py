"""Options of ``ladar_volume replay``."""

from __future__ import annotations

import argparse
from pathlib import Path

from ladar_volume.cli.arguments.lines import Verbs
from ladar_volume.cli.arguments.scale.work_options import TILE_M, add_work_options
from ladar_volume.cli.arguments.strict import add_strict_option
from ladar_volume.cli.arguments.work import work
from ladar_volume.cli.help.summaries import SUMMARIES

#: Most estimates on the way of a replay.
MOST_STATIONS = 100


def add_parser(subparsers: Verbs) -> None:
    """Declare the verb."""
    parser = subparsers.add_parser("replay", help=SUMMARIES["replay"])
    parser.add_argument("bag", type=Path, help="rosbag2 folder, .mcap, ROS 1 .bag, or .pcap")
    parser.add_argument(
        "more",
        type=Path,
        nargs="*",
        help="further recordings of the same survey: one after another, or of other sensors",
    )
    add_common(parser)
    parser.add_argument(
        "--poses",
        type=Path,
        metavar="LOG",
        help="autopilot's .tlog or .bin to take the poses from (section mavlink)",
    )
    parser.add_argument("--start", type=float, default=0.0, help="seconds into the recording")
    parser.add_argument("--duration", type=float, default=float("inf"), help="seconds")
    parser.add_argument(
        "--convergence",
        type=stations,
        default=0,
        metavar="N",
        help="also the volume at N moments of the recording, in result and report",
    )
    parser.add_argument(
        "--all-messages",
        action="store_true",
        help="of a log also what it had heard before georeference_node heard the driver",
    )
    add_work_options(parser, "BAG.tiles", f"{TILE_M:g}", always=False)
    parser.set_defaults(run=work("ladar_volume.cli.replay"))


def stations(word: str) -> int:
    """How many estimates on the way."""
    count = int(word)
    if not 0 <= count <= MOST_STATIONS:
        raise argparse.ArgumentTypeError(f"{word}: from 0 to {MOST_STATIONS}")
    return count


def add_overrides(parser: argparse.ArgumentParser) -> None:
    """Parameters and topics other than those of the configuration."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="SECTION.KEY=VALUE",
        help="override one parameter",
    )
    parser.add_argument(
        "--topic",
        action="append",
        default=[],
        metavar="ROLE=TOPIC",
        help="cloud, fix, imu or odometry topic",
    )


def add_common(parser: argparse.ArgumentParser) -> None:
    """Options that replay and the nodes share."""
    parser.add_argument(
        "--config",
        type=Path,
        help="parameter file; default: config.yaml in the recording's folder, if any",
    )
    add_overrides(parser)
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path("out"),
        help="folder for result.json, result.mcap, mesh.ply, figure.png, report.html",
    )
    parser.add_argument("--no-figure", action="store_true", help="skip picture and report")
    parser.add_argument("--json", action="store_true", help="print result.json to standard output")
    add_strict_option(parser)
