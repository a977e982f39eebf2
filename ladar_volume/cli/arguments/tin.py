"""Options of ``ladar_volume tin``."""

from __future__ import annotations

import argparse
from pathlib import Path

from ladar_volume.cli.arguments.lines import Verbs
from ladar_volume.cli.arguments.reading import add_mesh_options
from ladar_volume.cli.arguments.strict import add_strict_option
from ladar_volume.cli.arguments.surface_options import add_surface_options
from ladar_volume.cli.arguments.work import work
from ladar_volume.cli.help.summaries import SUMMARIES
from ladar_volume.io.endings import CLOUD_ENDINGS, READ_ENDINGS


def add_parser(subparsers: Verbs) -> None:
    """Declare the verb."""
    parser = subparsers.add_parser(
        "tin",
        help=SUMMARIES["tin"],
        description=(
            "A TIN over a point cloud by adaptive insertion, its heights adjusted to all "
            "points. Lengths in m."
        ),
    )
    kinds = " ".join(dict.fromkeys([*CLOUD_ENDINGS, *READ_ENDINGS]))
    parser.add_argument("cloud", type=Path, help=f"point cloud, or mesh with faces ({kinds})")
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="TIN",
        help=(
            "relevant triangles by ending: .ply (vertices with sigma_z), .xml (LandXML), .dxf, "
            ".obj, .stl, .glb, .tif (heights and sigma), .geojson (contours)"
        ),
    )
    parser.add_argument(
        "--all-triangles", action="store_true", help="write irrelevant triangles too, marked"
    )
    _add_more_outputs(parser)
    parser.add_argument(
        "--json", action="store_true", help="print the result as JSON to standard output"
    )
    add_surface_options(parser, "0.333; of a mesh the faces as they are")
    add_mesh_options(parser)
    add_strict_option(parser)
    parser.set_defaults(run=work("ladar_volume.cli.tin"))


def _add_more_outputs(parser: argparse.ArgumentParser) -> None:
    """What is made besides the surface."""
    parser.add_argument(
        "--at",
        type=Path,
        metavar="PLACES",
        help="a file of places x y, m: their heights on the surface, with sigma, are printed",
    )
    parser.add_argument(
        "--cleaned",
        type=Path,
        metavar="CLOUD",
        help="write the points that the surface is made from: without strays and copies, "
        "screened (--screen), or given their medians (--median)",
    )
