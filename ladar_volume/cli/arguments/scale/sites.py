"""Options of ``ladar_volume sites``."""

from __future__ import annotations

from pathlib import Path

from ladar_volume.cli.arguments.lines import Verbs
from ladar_volume.cli.arguments.reading import add_mesh_options
from ladar_volume.cli.arguments.strict import add_strict_option
from ladar_volume.cli.arguments.volume import add_volume_options
from ladar_volume.cli.arguments.work import work
from ladar_volume.cli.help.summaries import SUMMARIES


def add_parser(subparsers: Verbs) -> None:
    """Declare the verb."""
    parser = subparsers.add_parser(
        "sites",
        help=SUMMARIES["sites"],
        description=(
            "The volume of every point cloud and mesh below a folder, as 'volume' computes it, in "
            "one table with the change since the survey before. A date in a name (2026-05-31 or "
            "20260531, with or without T0930) is the epoch. The site is the folder of a file and "
            "what the date leaves of its name. What was computed before from the same file with "
            "the same options is kept. Lengths in m."
        ),
    )
    parser.add_argument("folder", type=Path, help="folder of the surveys")
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="OUT",
        help="folder of the table (sites.csv, sites.json) and of the results",
    )
    parser.add_argument(
        "--workers", type=int, default=1, metavar="N", help="processes that share the surveys"
    )
    parser.add_argument(
        "--json", action="store_true", help="print the table as JSON to standard output"
    )
    add_volume_options(parser)
    add_mesh_options(parser)
    add_strict_option(parser)
    parser.set_defaults(run=work("ladar_volume.cli.scale.sites"))
