"""Options of ``ladar_volume tiles``."""

from __future__ import annotations

import argparse
from pathlib import Path

from ladar_volume.cli.arguments.lines import Verbs
from ladar_volume.cli.arguments.parameter_flags import (
    add_ground_preset,
    add_parameter,
    number,
)
from ladar_volume.cli.arguments.reading import add_reading_options
from ladar_volume.cli.arguments.scale.work_options import BY_POINTS, add_work_options
from ladar_volume.cli.arguments.strict import add_strict_option
from ladar_volume.cli.arguments.work import work
from ladar_volume.cli.help.summaries import SUMMARIES


def add_parser(subparsers: Verbs) -> None:
    """Declare the verb."""
    parser = subparsers.add_parser(
        "tiles",
        help=SUMMARIES["tiles"],
        description=(
            "Cut, fill and net volume of a LAS, LAZ or COPC file above a level, a plane or its own "
            "ground, by square tiles at rest on disk: what one triangulation of all points gives. "
            "A run that was interrupted goes on where it was. Lengths in m."
        ),
    )
    parser.add_argument("cloud", type=Path, help="point cloud (.las .laz)")
    _add_bases(parser.add_argument_group("base"))
    _add_surface(parser)
    add_work_options(parser, "CLOUD.tiles", BY_POINTS)
    parser.add_argument(
        "--json", action="store_true", help="print the result as JSON to standard output"
    )
    add_reading_options(parser)
    add_strict_option(parser)
    # of ``volume`` alone
    parser.set_defaults(cloud_b=None, piles=None, levels=None, method=None, offset=None)
    parser.set_defaults(
        no_correction=False, footprint="common", sigma_b=None, frame="level", trajectory=None
    )
    parser.set_defaults(run=work("ladar_volume.cli.scale.tiles"))


def _add_bases(g: argparse._ArgumentGroup) -> None:
    """Above what the volume is, and where it counts."""
    add_parameter(g, "--level", "volume.level_m", metavar="Z")
    add_parameter(g, "--plane", "volume.plane", metavar=("C0", "C1", "C2"))
    add_parameter(g, "--base", "volume.base")
    add_parameter(
        g,
        "--outline",
        "volume.outline",
        choices=("auto", "all"),
        more="default auto above the ground, else all",
    )
    add_ground_preset(g)
    g.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="SECTION.KEY=VALUE",
        help="override a parameter of volume or ground",
    )


def _add_surface(parser: argparse.ArgumentParser) -> None:
    """Which triangles count, and the noise."""
    g = parser.add_argument_group("surface")
    g.add_argument(
        "--clean",
        choices=("auto", "off"),
        default="auto",
        help="stray points: auto leaves out those off the surface (default), off none",
    )
    add_parameter(
        g,
        "--relevant",
        "volume.relevant",
        choices=("sampled", "all"),
        more="default sampled: where points were measured, open notches and gaps left out",
    )
    limit = g.add_mutually_exclusive_group()
    add_parameter(limit, "--max-edge", "volume.max_edge_m")
    add_parameter(limit, "--max-circle", "volume.max_circumdiameter_m")
    g.add_argument(
        "--sigma",
        type=number,
        metavar="M",
        help="standard deviation of the heights; else estimated from the points",
    )
