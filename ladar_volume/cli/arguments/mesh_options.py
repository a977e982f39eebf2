"""Options of mesh files as surfaces."""

from __future__ import annotations

import argparse


def add_mesh_options(parser: argparse.ArgumentParser, second: bool = False) -> None:
    """Declare the options of mesh files; ``second``: of a second one too."""
    g = parser.add_argument_group("mesh files (PLY with faces, OBJ, STL, OFF, LandXML)")
    g.add_argument(
        "--no-faces",
        action="store_true",
        help="take the vertices for a point cloud; else the faces are the surface",
    )
    g.add_argument("--surface", metavar="NAME", help="which surface of a LandXML with several")
    if second:
        g.add_argument("--surface-b", metavar="NAME", help="the same for the second file")
