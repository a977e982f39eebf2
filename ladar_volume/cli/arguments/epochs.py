"""Options of ``ladar_volume epochs``."""

from __future__ import annotations

import argparse
import re
from pathlib import Path

from ladar_volume.cli.arguments.lines import Verbs
from ladar_volume.cli.arguments.parameter_flags import number
from ladar_volume.cli.arguments.reading import add_reading_options
from ladar_volume.cli.arguments.strict import add_strict_option
from ladar_volume.cli.arguments.surface_options import add_surface_options
from ladar_volume.cli.arguments.work import work
from ladar_volume.cli.help.summaries import SUMMARIES
from ladar_volume.model.choices import CALIBRATION_GROUPS, CLEAN

#: Options of a surface that the verb has itself.
PUBLIC = ("crs", "units", "classes", "sigma", "clean")


def add_parser(subparsers: Verbs) -> None:
    """Declare the verb."""
    parser = subparsers.add_parser(
        "epochs",
        help=SUMMARIES["epochs"],
        description="NEW minus PREVIOUS over the common footprint. Both are results (folders that "
        "'replay' or volume_node's ~/save wrote), recordings, which are replayed first, or point "
        "clouds and meshes. The calibration of surveys counts as common to both, but for the clock "
        "offset; point clouds tell the noise of their points alone.",
    )
    parser._negative_number_matcher = re.compile(
        r"^-(\d|\.\d)[\d.,eE+-]*$"
    )  # argparse takes -1,2 for an option
    _add_surveys(parser)
    _add_places(parser)
    _add_clouds(parser)
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
    parser.set_defaults(run=work("ladar_volume.cli.epochs.verb"))


def _add_surveys(parser: argparse.ArgumentParser) -> None:
    """The two surveys, what they share, and how one is laid on the other."""
    parser.add_argument(
        "previous",
        type=Path,
        help="the earlier survey: results (a folder, or its result.mcap), a recording, or a cloud",
    )
    parser.add_argument("new", type=Path, help="the later survey, of the same kind")
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


def _add_places(parser: argparse.ArgumentParser) -> None:
    """Where the surveys are compared, and where nothing changed."""
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


def _add_clouds(parser: argparse.ArgumentParser) -> None:
    """What point clouds need besides. What else a surface is made with stays as it is."""
    add_reading_options(parser)
    g = parser.add_argument_group("point clouds")
    g.add_argument(
        "--register",
        choices=("icp", "height"),
        help="lay the new cloud on the earlier one by what did not change: turned and shifted "
        "(point to plane), or lifted alone, which is all that level ground can tell",
    )
    g.add_argument(
        "--reach",
        type=number,
        metavar="M",
        help="how far --register icp looks for partners (default 20 spacings)",
    )
    g.add_argument(
        "--sigma",
        type=number,
        metavar="M",
        help="standard deviation of the heights of the new cloud; else a column, else estimated",
    )
    g.add_argument("--sigma-b", type=number, metavar="M", help="of the earlier one, if another")
    g.add_argument(
        "--clean",
        choices=CLEAN,
        default="auto",
        help="auto: leave stray points out; filter: smooth as 'filter' does; off: every point",
    )
    usual = argparse.ArgumentParser()
    add_surface_options(usual, "every point")
    parser.set_defaults(
        **{n: v for n, v in vars(usual.parse_args([])).items() if n not in PUBLIC},
        no_faces=False,
        surface=None,
    )
