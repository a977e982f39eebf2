"""Options of how files are read: ``--crs``, ``--units``, ``--classes``; of meshes ``--no-faces``,
``--surface``.
"""

from __future__ import annotations

import argparse

from ladar_volume.io.pointfiles.units import WORDS


def add_reading_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    g = parser.add_argument_group("what the file holds (results are in metres)")
    g.add_argument(
        "--crs",
        metavar="EPSG:CODE",
        help="coordinate system, where the file names none: a code or WKT",
    )
    g.add_argument(
        "--units",
        metavar="UNIT[,UNIT]",
        help=f"{', '.join(WORDS)}, where the file does not say; with a comma: of x and y, of z",
    )
    g.add_argument(
        "--classes",
        metavar="N,N|all",
        help="classes that count (default: all but noise, 7 and 18, and withheld points)",
    )


def add_mesh_options(parser: argparse.ArgumentParser, second: bool = False) -> None:
    """Declare the options of mesh files; ``second``: of a second one too."""
    g = parser.add_argument_group("mesh files (PLY with faces, OBJ, STL, OFF, LandXML, DXF)")
    g.add_argument(
        "--no-faces",
        action="store_true",
        help="take the vertices for a point cloud; else the faces are the surface",
    )
    g.add_argument(
        "--surface",
        metavar="NAME",
        help="which surface of a LandXML, or layer of a DXF, with several",
    )
    if second:
        g.add_argument("--surface-b", metavar="NAME", help="the same for the second file")
