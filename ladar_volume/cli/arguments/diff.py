"""Options of ``ladar_volume diff``."""

from __future__ import annotations

import argparse
import re
from pathlib import Path

import numpy as np

from ladar_volume.cli.arguments.diff_input import point
from ladar_volume.cli.arguments.lines import Verbs
from ladar_volume.cli.arguments.parameter_flags import number
from ladar_volume.cli.arguments.reading import add_reading_options
from ladar_volume.cli.arguments.strict import add_strict_option
from ladar_volume.cli.arguments.work import work
from ladar_volume.cli.help.summaries import SUMMARIES
from ladar_volume.model.choices import CORRECTIONS


def add_parser(subparsers: Verbs) -> None:
    """Declare the verb."""
    parser = subparsers.add_parser(
        "diff",
        help=SUMMARIES["diff"],
        description="What was taken away from A (before) to B (after), as Kern does it: both scans "
        "are triangulated about their scanners "
        "and cut by one common ring; the tetrahedra of both and a pole are summed. "
        "Closed meshes are compared as bodies. Lengths in m.",
    )
    parser._negative_number_matcher = re.compile(
        r"^-(\d|\.\d)[\d.,eE+-]*$"
    )  # argparse takes -1,2,3 for an option
    _add_scans(parser)
    _add_registration(parser)
    _add_region(parser)
    _add_accuracy(parser)
    parser.add_argument(
        "-o", "--output", type=Path, metavar="MESH", help="the closed body between both"
    )
    parser.add_argument(
        "--allow-crossings",
        action="store_true",
        help="closed meshes may pierce themselves: such space counts twice",
    )
    add_strict_option(parser)
    parser.add_argument(
        "--json", action="store_true", help="print the result as JSON to standard output"
    )
    add_reading_options(parser)
    parser.set_defaults(run=work("ladar_volume.cli.diff"))


def _add_scans(parser: argparse.ArgumentParser) -> None:
    """What is compared, and from where it was scanned."""
    parser.add_argument(
        "a", type=Path, help="scan or mesh before: PLY XYZ CSV NPY PCD LAS OBJ STL OFF ..."
    )
    parser.add_argument("b", type=Path, help="scan or mesh after")
    for option, which in (("--surface", "A"), ("--surface-b", "B")):
        words = f"which surface of {which}, a LandXML or DXF with several"
        parser.add_argument(option, metavar="NAME", help=words)
    parser.add_argument(
        "--pole",
        type=point,
        metavar="X,Y,Z",
        help="pole, map frame (default: scanner B); it also stands for a scanner",
    )
    parser.add_argument(
        "--scanner",
        type=point,
        metavar="X,Y,Z",
        help="where A was scanned from, in the file's own frame",
    )
    parser.add_argument(
        "--scanner-b", type=point, metavar="X,Y,Z", help="the same for B (default: as A)"
    )


def _add_registration(parser: argparse.ArgumentParser) -> None:
    """How both come into one frame."""
    g = parser.add_argument_group("registration")
    g.add_argument(
        "--transform",
        type=Path,
        metavar="JSON",
        help="brings A into the map frame: what 'register A B --json' printed",
    )
    g.add_argument("--transform-b", type=Path, metavar="JSON", help="the same for B")
    g.add_argument(
        "--icp",
        type=number,
        metavar="REACH",
        help="refine B by the ground around the region, partners up to this far",
    )
    g.add_argument(
        "--icp-cell",
        type=number,
        metavar="M",
        help="its errors may be correlated within so much (default: a twelfth of A)",
    )
    g.add_argument(
        "--ring-correction",
        choices=list(CORRECTIONS),
        default="none",
        help="move B so that the ring, the unchanged boundary, lies on A: by its offset or rigidly "
        "(default none: what the ring differs by enters sigma and the verdict)",
    )


def _add_region(parser: argparse.ArgumentParser) -> None:
    """Where the volume counts, and the ring around it."""
    g = parser.add_argument_group("region")
    g.add_argument(
        "--polygon",
        nargs="+",
        metavar="X,Y|FILE",
        help="corners x,y in plan, x,y,z of a polygon on a wall, or a file of them",
    )
    g.add_argument(
        "--selection",
        type=Path,
        metavar="CLOUD",
        help="points picked from A: their hull in plan is the polygon",
    )
    g.add_argument(
        "--margin",
        type=number,
        metavar="M",
        help="ground around the polygon that is used (default: a tenth of its width)",
    )
    g.add_argument(
        "--spacing",
        type=number,
        metavar="M",
        help="of the boundary ring (default: twice that of A's points)",
    )
    g.add_argument(
        "--max-edge",
        type=number,
        metavar="M",
        default=np.inf,
        help="wider triangles count as closed, not as seen",
    )
    g.add_argument(
        "--keep-isolated",
        action="store_true",
        help="keep returns that stand alone, off every surface (default: left out and counted)",
    )


def _add_accuracy(parser: argparse.ArgumentParser) -> None:
    """Noise of the scans, weighed mass, and studies of the accuracy."""
    g = parser.add_argument_group("accuracy")
    g.add_argument(
        "--sigma",
        type=number,
        metavar="M",
        help="standard deviation of a point of A (default: estimated from its ranges)",
    )
    g.add_argument(
        "--sigma-b", type=number, metavar="M", help="the same for B (default: as given for A)"
    )
    g.add_argument(
        "--beam",
        action="store_true",
        help="that sigma is along the beam only; otherwise in every direction",
    )
    g.add_argument(
        "--offset",
        type=number,
        metavar="M",
        default=0.01,
        help="offset of the whole surface for the size rule (default 0.01)",
    )
    g.add_argument("--mass", type=number, metavar="KG", help="weighed mass, for the density")
    g.add_argument("--mass-sigma", type=number, metavar="KG", help="its standard deviation")
    g.add_argument(
        "--published",
        action="store_true",
        help="print the published value too: each surface over its own boundary",
    )
    g.add_argument(
        "--resolution",
        type=number,
        nargs="+",
        metavar="M",
        help="volume and surface of clouds thinned to these cells",
    )
