"""Options of how point clouds are read: ``--crs``, ``--units``, ``--classes``."""

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
