"""Options of ``ladar_volume body``."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from ladar_volume.cli.arguments.diff_input import MOST
from ladar_volume.cli.arguments.lines import Verbs
from ladar_volume.cli.arguments.parameter_flags import add_ground_preset, add_parameter
from ladar_volume.cli.arguments.reading import add_reading_options
from ladar_volume.cli.arguments.strict import add_strict_option
from ladar_volume.cli.arguments.work import work
from ladar_volume.cli.help.summaries import SUMMARIES
from ladar_volume.io.endings import CLOUD_ENDINGS, ENDINGS, READ_ENDINGS


def numbers(*counts: int) -> Callable[[str], tuple[float, ...]]:
    """A parser of finite numbers with commas between, as many as one of the counts."""

    def parse(text: str) -> tuple[float, ...]:
        values = tuple(float(word) for word in text.split(","))
        if len(values) not in counts or not all(abs(v) < MOST for v in values):
            raise argparse.ArgumentTypeError(
                f"{text}: {' or '.join(map(str, counts))} numbers with commas between"
            )
        return values

    return parse


def ground_word(text: str) -> str | tuple[float, ...]:
    """``auto``, ``none``, a level Z, or a plane Z,SX,SY."""
    return text if text in ("auto", "none") else numbers(1, 3)(text)


def add_parser(subparsers: Verbs) -> None:
    """Declare the verb."""
    kinds = " ".join(dict.fromkeys([*CLOUD_ENDINGS, *READ_ENDINGS]))
    parser = subparsers.add_parser(
        "body",
        help=SUMMARIES["body"],
        description="A cloud is filtered, its ground found, each object on it meshed, its edges "
        "completed and its unseen bottom closed on "
        "the ground; a mesh file is taken as it is, and closed where it is open. Lengths "
        "in m.",
    )
    _add_files(parser, kinds)
    _add_objects(parser)
    _add_mesh(parser)
    _add_volume(parser)
    parser.add_argument(
        "--surface",
        metavar="NAME",
        help="which surface of a LandXML, or layer of a DXF, with several",
    )
    add_strict_option(parser)
    parser.add_argument(
        "--json", action="store_true", help="print the result as JSON to standard output"
    )
    add_reading_options(parser)
    parser.set_defaults(run=work("ladar_volume.cli.body"))


def _add_files(parser: argparse.ArgumentParser, kinds: str) -> None:
    """What is read and written, and what the bodies stand on."""
    parser.add_argument(
        "source", type=Path, metavar="CLOUD|MESH", help=f"point cloud or mesh ({kinds})"
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="MESH",
        help=f"the closed bodies ({' '.join(ENDINGS)})",
    )
    parser.add_argument(
        "--ground",
        type=ground_word,
        metavar="auto|none|Z|Z,SX,SY",
        help=(
            "found in the cloud (its default), none (a mesh's default: bodies seen from all "
            "sides), a level, or a plane Z + SX x + SY y"
        ),
    )
    add_ground_preset(parser)


def _add_objects(parser: argparse.ArgumentParser) -> None:
    """Which objects are bodies."""
    g = parser.add_argument_group("objects on the ground (by default all that are found)")
    g.add_argument(
        "--polygon",
        type=numbers(2),
        nargs="+",
        action="append",
        default=[],
        metavar="X,Y",
        help="one body in this outline",
    )
    g.add_argument(
        "--box",
        type=numbers(6),
        action="append",
        default=[],
        metavar="X0,Y0,Z0,X1,Y1,Z1",
        help="one body in this box",
    )
    g.add_argument(
        "--pick",
        type=numbers(3),
        action="append",
        default=[],
        metavar="X,Y,Z",
        help="one body at this point",
    )
    _add_clusters(g)


def _add_clusters(g: argparse._ArgumentGroup) -> None:
    """What is an object where none is named."""
    add_parameter(
        g,
        "--min-height",
        "objects.min_height_m",
        more="default: twice the cloud's noise",
    )
    add_parameter(g, "--min-points", "objects.min_points", metavar="N")
    add_parameter(g, "--distance", "objects.distance_m", more="default: from the spacing")
    add_parameter(g, "--split", "objects.split_m")


def _add_mesh(parser: argparse.ArgumentParser) -> None:
    """How the cloud is filtered, meshed and closed."""
    g = parser.add_argument_group("filter and mesh")
    g.add_argument(
        "--no-filter",
        action="store_true",
        help="the points lie on the surface already; a column 'normal' is used",
    )
    add_parameter(g, "--radius", "filter.radius_m", metavar="R", more="default: from the cloud")
    g.add_argument(
        "--seed",
        type=int,
        default=0,
        metavar="N",
        help="seed of the filter and of the search of the ground",
    )
    _add_edges(g)


def _add_edges(g: argparse._ArgumentGroup) -> None:
    """How the points are meshed and the mesh is closed."""
    add_parameter(g, "--mesh-radius", "mesh.radius_m", own_default=True)
    add_parameter(
        g,
        "--repair",
        "mesh.repair",
        more="makes the mesh by it, of bodies seen from all sides (needs --mesh-radius; the ground "
        "is none)",
    )
    add_parameter(g, "--close", "bodies.close_m", own_default=True)
    add_parameter(g, "--sharp", "bodies.sharp_deg", own_default=True)


def _add_volume(parser: argparse.ArgumentParser) -> None:
    """How the closed mesh is measured."""
    g = parser.add_argument_group("volume")
    g.add_argument(
        "--pole",
        type=numbers(3),
        metavar="X,Y,Z",
        help="common corner of the tetrahedra (any gives the same volume)",
    )
    g.add_argument(
        "--sigma",
        type=float,
        metavar="M",
        help="standard deviation of each vertex, of a mesh or with --no-filter",
    )
    g.add_argument(
        "--allow-crossings",
        action="store_true",
        help="do not refuse a mesh file whose triangles cross",
    )
