"""Options of ``ladar_volume volume``."""

from __future__ import annotations

import argparse
from pathlib import Path

from ladar_volume.cli.arguments.lines import Verbs
from ladar_volume.cli.arguments.outputs.export import add_file_options, add_unit_option
from ladar_volume.cli.arguments.parameter_flags import (
    add_ground_preset,
    add_parameter,
    number,
    spec_of,
)
from ladar_volume.cli.arguments.reading import add_mesh_options
from ladar_volume.cli.arguments.scale.work_options import BY_POINTS, add_work_options
from ladar_volume.cli.arguments.strict import add_strict_option
from ladar_volume.cli.arguments.surface_options import add_surface_options
from ladar_volume.cli.arguments.work import work
from ladar_volume.cli.help.summaries import SUMMARIES
from ladar_volume.io.endings import CLOUD_ENDINGS, READ_ENDINGS
from ladar_volume.model.piles import PILE_BASES

#: Bases on the command line: those of the parameter, the floor of a sequence of levels, and those
#: of piles.
BASES = tuple(dict.fromkeys((*(spec_of("volume.base").choices or ()), "floor", *PILE_BASES)))


BASE_WORDS = (
    "one cloud with nothing else said: ground; "
    "floor: the one --levels shows; with --piles also site_ground (around all piles), and from the "
    "heights along each outline toe_plane, toe_quadratic, toe_tin (triangulated), toe_lowest, "
    "toe_mean, toe_highest"
)


def add_parser(subparsers: Verbs) -> None:
    """Declare the verb."""
    parser = subparsers.add_parser(
        "volume",
        help=SUMMARIES["volume"],
        description=(
            "Cut, fill and net volume with their standard deviations from the noise of the "
            "points. Lengths in m."
        ),
    )
    kinds = " ".join(dict.fromkeys([*CLOUD_ENDINGS, *READ_ENDINGS]))
    parser.add_argument("cloud", type=Path, help=f"point cloud, or mesh with faces ({kinds})")
    parser.add_argument(
        "cloud_b", type=Path, nargs="?", help="second one: cut is where the first lies above it"
    )
    _add_pairs(add_volume_options(parser))
    _add_trajectory(parser.add_argument_group("trajectory beside the cloud"))
    parser.add_argument(
        "--json", action="store_true", help="print the result as JSON to standard output"
    )
    parser.add_argument(
        "--report",
        type=report_page,
        metavar="FILE.html",
        help="write a report: one page for browser and printer, and the same as FILE.json",
    )
    add_file_options(parser)
    add_unit_option(parser)
    add_mesh_options(parser, second=True)
    add_work_options(parser, "CLOUD.tiles", BY_POINTS, always=False)
    add_strict_option(parser)
    parser.set_defaults(run=work("ladar_volume.cli.volume"))


def add_volume_options(parser: argparse.ArgumentParser) -> argparse._ArgumentGroup:
    """Declare what one survey or many take; returns the group of the base."""
    g = parser.add_argument_group("base")
    _add_bases(g)
    _add_counting(g)
    _add_piles(parser.add_argument_group("piles"))
    _add_shared_errors(parser.add_argument_group("errors that neighbouring heights share"))
    add_surface_options(parser, "1: every point")
    # of one cloud alone
    parser.set_defaults(trajectory=None, trajectory_accuracy=None, undulation=None)
    return g


def report_page(word: str) -> Path:
    """A path that ends in .html."""
    path = Path(word)
    if path.suffix.lower() not in (".html", ".htm"):
        raise argparse.ArgumentTypeError(f"{word}: a report ends in .html")
    return path


def _add_bases(g: argparse._ArgumentGroup) -> None:
    """Above what the volume is."""
    add_parameter(g, "--level", "volume.level_m", metavar="Z")
    add_parameter(g, "--base", "volume.base", choices=BASES, more=BASE_WORDS)
    add_parameter(g, "--plane", "volume.plane", metavar=("C0", "C1", "C2"))
    add_ground_preset(g)
    g.add_argument(
        "--levels",
        type=number,
        nargs=3,
        metavar=("START", "STOP", "STEP"),
        help="cut and fill at levels, and their floors",
    )


def _add_counting(g: argparse._ArgumentGroup) -> None:
    """Where the volume counts, how accurate it is, and other parameters."""
    add_parameter(
        g,
        "--outline",
        "volume.outline",
        choices=("auto", "all"),
        more="default auto above the ground, else all; a polygon with --set volume.outline=polygon",
    )
    g.add_argument(
        "--no-correction", action="store_true", help="leave cut and fill as they are near the base"
    )
    g.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="SECTION.KEY=VALUE",
        help="override a parameter of volume or ground; with --trajectory also of calibration, "
        "budget or georeference",
    )


def _add_piles(g: argparse._ArgumentGroup) -> None:
    """Several piles, and their tonnes."""
    g.add_argument(
        "--piles",
        metavar="FILE",
        help="one volume for each outline of a file (GeoJSON, Shapefile, GeoPackage, KML, DXF, "
        "WKT), or with the word found for each body that rises above the ground; each above every "
        "base that the heights around it make",
    )
    add_parameter(g, "--density", "piles.density_t_m3", more="a column density counts first")
    add_parameter(g, "--density-sigma", "piles.density_sigma_t_m3")


def _add_shared_errors(g: argparse._ArgumentGroup) -> None:
    """What noise alone does not hold."""
    add_parameter(
        g, "--height-sigma", "piles.height_sigma_m", more="without --correlation all share it"
    )
    add_parameter(g, "--correlation", "piles.correlation_m")
    g.add_argument(
        "--budget",
        type=Path,
        metavar="FILE",
        help="several such errors: a YAML list height_errors of name, sigma_m, correlation_m; with "
        "--trajectory a parameter file, whose calibration, budget and georeference count",
    )


def _add_trajectory(g: argparse._ArgumentGroup) -> None:
    """The flight that the points were measured from."""
    g.add_argument(
        "--trajectory",
        type=Path,
        metavar="FILE",
        help="SBET (.sbet .out) or text (.pos .txt .csv): errors of calibration and navigation by "
        "the pose at each point's GPS time; without --budget those of the default parameters",
    )
    g.add_argument(
        "--trajectory-accuracy",
        type=Path,
        metavar="FILE",
        help="standard deviations of the poses (smrmsg), in place of the budget's",
    )
    add_parameter(g, "--undulation", "piles.undulation_m")


def _add_pairs(g: argparse._ArgumentGroup) -> None:
    """How two clouds are compared."""
    g.add_argument(
        "--sigma-b",
        type=number,
        metavar="M",
        help="standard deviation of the second cloud's heights, where it differs",
    )
    g.add_argument(
        "--footprint",
        choices=("common", "own"),
        default="common",
        help="two clouds: over their common footprint, or as published each over its own",
    )
    g.add_argument(
        "--method",
        type=int,
        choices=(1, 2),
        help="two clouds, --footprint own: by fill in front of the body (1), or by cut above a "
        "level beyond everything (2); at --levels, or at the level that is found",
    )
    g.add_argument(
        "--offset",
        type=number,
        metavar="M",
        help="by which the first cloud lies above the second where nothing changed: the second's "
        "levels are lower by it (what --levels prints as offset)",
    )
