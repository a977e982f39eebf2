"""Options of ``ladar_volume calibrate strips``."""

from __future__ import annotations

import argparse
from pathlib import Path

from ladar_volume.cli.arguments.lines import Verbs
from ladar_volume.cli.arguments.parameter_flags import add_parameter
from ladar_volume.cli.arguments.replay import add_overrides
from ladar_volume.cli.arguments.work import work


def add_parser(modes: Verbs) -> None:
    """Declare the mode."""
    parser = modes.add_parser(
        "strips",
        help="self-calibration from overlapping strips of a recording",
        description="Estimates boresight, lever arms and clock offset from surfaces that several "
        "strips saw. Every prior is the budget's: "
        "what the strips cannot tell stays there. Fly lanes in two directions, both "
        "ways, over ground with slopes.",
    )
    _add_recording(parser)
    parser.add_argument(
        "--config",
        type=Path,
        help="parameter file; default: config.yaml in the recording's folder, if any",
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FILE.yaml",
        help="parameter file to write: the one read, recalibrated",
    )
    parser.add_argument(
        "--json", action="store_true", help="print the result as JSON to standard output"
    )
    parser.set_defaults(run=work("ladar_volume.cli.calibrate_strips"))


def _add_recording(parser: argparse.ArgumentParser) -> None:
    """The recording, and what of it is used."""
    parser.add_argument("bag", type=Path, help="rosbag2 folder, .mcap, or ROS 1 .bag")
    add_overrides(parser)
    parser.add_argument("--start", type=float, default=0.0, help="seconds into the recording")
    parser.add_argument("--duration", type=float, default=float("inf"), help="seconds")
    parser.add_argument(
        "--returns",
        type=int,
        default=300_000,
        help="most returns used, chosen evenly (default 300000)",
    )
    add_parameter(parser, "--edge", "strips.edge_m", own_default=True)
