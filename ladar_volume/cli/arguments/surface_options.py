"""Options of the surface of a cloud, which several verbs share."""

from __future__ import annotations

import argparse
import re

from ladar_volume.cli.arguments.parameter_flags import add_parameter, number, spec_of
from ladar_volume.cli.arguments.reading import add_reading_options
from ladar_volume.model.choices import CLEAN

#: Ways to choose relevant triangles on the command line: those of the parameter, and where points
#: were measured.
RELEVANT = ("sampled", *(spec_of("volume.relevant").choices or ()))


def add_surface_options(parser: argparse.ArgumentParser, default_vertices: str) -> None:
    """Declare the options."""
    add_reading_options(parser)
    # argparse takes -1 for a number, but -1e-3 for an option
    parser._negative_number_matcher = re.compile(r"^-(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$")
    g = parser.add_argument_group("surface")
    _add_insertion(g, default_vertices)
    _add_heights(g)
    _add_relevant(g)
    _add_points(g)
    g.add_argument(
        "--sigma",
        type=number,
        metavar="M",
        help="standard deviation of the heights; else a column, else estimated",
    )
    g.add_argument(
        "--frame",
        choices=("level", "scan"),
        default="level",
        help="mesh over the horizontal plane, or against the scan direction",
    )
    g.add_argument(
        "--scanner",
        type=number,
        nargs=3,
        metavar=("X", "Y", "Z"),
        help="where it stood; else the direction is searched",
    )
    g.add_argument(
        "--direction",
        type=number,
        nargs=3,
        metavar=("X", "Y", "Z"),
        help="the scan direction itself",
    )


def _add_insertion(g: argparse._ArgumentGroup, default_vertices: str) -> None:
    """Which points become vertices."""
    g.add_argument(
        "--vertices",
        type=number,
        metavar="RATIO|COUNT",
        help=(
            "vertices of the TIN: up to 1 a part of the points (1: every point), above 1 a "
            f"number (default {default_vertices})"
        ),
    )
    add_parameter(g, "--tolerance", "surface.tolerance", metavar="M")
    add_parameter(g, "--criterion", "surface.criterion", own_default=True)


def _add_heights(g: argparse._ArgumentGroup) -> None:
    """How the heights of a partial TIN are fitted."""
    add_parameter(g, "--adjust", "surface.adjust", own_default=True)
    add_parameter(g, "--iterations", "surface.max_iterations", metavar="N", more="default 100")
    add_parameter(g, "--height-tolerance", "surface.height_tolerance_m", more="default 0.0001")
    add_parameter(g, "--exchange", "surface.exchange", own_default=True)
    g.add_argument(
        "--exchange-last",
        action="store_true",
        help="as published: heights are not adjusted again after the exchange",
    )


def _add_relevant(g: argparse._ArgumentGroup) -> None:
    """Which triangles count, and the boundary about them."""
    add_parameter(
        g,
        "--relevant",
        "volume.relevant",
        choices=RELEVANT,
        more="default sampled: where points were measured, open notches and gaps left out; "
        "corners: up to the convex hull",
    )
    add_parameter(g, "--max-edge", "volume.max_edge_m")
    add_parameter(g, "--max-circle", "volume.max_circumdiameter_m")
    add_parameter(g, "--max-ear", "surface.max_ear_edge_m")
    add_parameter(g, "--min-island", "surface.min_island_m2")
    add_parameter(g, "--max-hole", "surface.max_hole_m2")


def _add_points(g: argparse._ArgumentGroup) -> None:
    """Which points are used."""
    g.add_argument(
        "--clean",
        choices=CLEAN,
        default="auto",
        help=(
            "stray points: auto leaves out those off the surface (default), off none, filter "
            "those that the filter takes out"
        ),
    )
    add_parameter(g, "--screen", "tin.screen_m")
    add_parameter(g, "--median", "tin.median_m")
    add_parameter(g, "--window", "surface.window", metavar=("X0", "Y0", "X1", "Y1"))
    add_parameter(g, "--duplicates", "surface.duplicate_tolerance_m", own_default=True)
    add_parameter(g, "--bins", "surface.bins_per_row", metavar="N")
