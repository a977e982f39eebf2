"""Options that say how work on tiles is shared."""

from __future__ import annotations

import argparse
from pathlib import Path

from ladar_volume.cli.arguments.parameter_flags import number

#: Side of a tile of a recording, m, where none is given.
TILE_M = 50.0
#: That of a cloud, in words.
BY_POINTS = "by its points, some 10⁵ in each"


def add_work_options(
    parser: argparse.ArgumentParser, store: str, side: str, always: bool = True
) -> None:
    """Tiles, where they are at rest, and who works on them. store : its usual name · side : the
    usual one of a tile, in words · always : the work is done by tiles in any case
    """
    g = parser.add_argument_group("work")
    g.add_argument(
        "--tile",
        type=number,
        metavar="M",
        help=f"side of a tile (default: {side}"
        + (")" if always else " with --dask; without both there are no tiles)"),
    )
    g.add_argument(
        "--store",
        type=Path,
        metavar="FOLDER",
        help=f"where tiles are at rest (default {store}); may be deleted afterwards",
    )
    g.add_argument(
        "--dask",
        nargs="?",
        const="",
        metavar="ADDRESS",
        help="on the workers of a Dask scheduler; without an address on some of this machine, "
        "which end with the run; without --dask in this process",
    )
    g.add_argument(
        "--workers", type=int, metavar="N", help="workers on this machine (default: one a core)"
    )
