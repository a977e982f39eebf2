"""Options of ``ladar_volume plan``."""

from __future__ import annotations

import argparse
from pathlib import Path

from ladar_volume.cli.arguments.lines import Verbs
from ladar_volume.cli.arguments.work import work
from ladar_volume.cli.help.summaries import SUMMARIES


def add_parser(subparsers: Verbs) -> None:
    """Declare the verb."""
    parser = subparsers.add_parser(
        "plan",
        help=SUMMARIES["plan"],
        description="Predicts sigma and budget of a stockpile's volume from its size, the flight, "
        "the scanner and the error budget, with "
        "the survey's own filter, surface and propagation on sampled returns.",
    )
    _add_scene(parser)
    _add_flight(parser)
    _add_sensors(parser)
    parser.add_argument("--compare", action="store_true", help="every scanner with every IMU")
    parser.add_argument(
        "--wanted",
        type=float,
        metavar="SHARE",
        help="sigma / V to be reached: the maximum height for it",
    )
    parser.add_argument("--seed", type=int, default=1, help="of the sampled returns")
    parser.add_argument(
        "--json", action="store_true", help="print the numbers as JSON to standard output"
    )
    parser.set_defaults(run=work("ladar_volume.cli.plan"))


def _add_scene(parser: argparse.ArgumentParser) -> None:
    """The pile or pit, and the roughness of its ground."""
    scene = parser.add_argument_group("scene")
    scene.add_argument(
        "--volume", type=float, metavar="M3", help="a cone of this volume at its angle of repose"
    )
    scene.add_argument(
        "--repose",
        type=float,
        default=35.0,
        metavar="DEG",
        help="angle of repose (default 35, coal)",
    )
    scene.add_argument(
        "--pile",
        type=float,
        nargs=3,
        metavar=("LENGTH", "WIDTH", "HEIGHT"),
        help="an elliptic pile; HEIGHT < 0: a pit",
    )
    scene.add_argument(
        "--top",
        type=float,
        default=0.0,
        metavar="SHARE",
        help="size of the flat top over that of the foot (default 0)",
    )
    _add_roughness(scene)


def _add_flight(parser: argparse.ArgumentParser) -> None:
    """The path of the scanner."""
    flight = parser.add_argument_group("flight")
    flight.add_argument(
        "--height", type=float, default=25.0, metavar="M", help="above the ground (default 25)"
    )
    flight.add_argument("--lanes", type=int, default=3, help="number of parallel lanes (default 3)")
    flight.add_argument(
        "--spacing",
        type=float,
        metavar="M",
        help="between lanes (default: the foot's width over the lanes)",
    )
    flight.add_argument(
        "--aside",
        type=float,
        default=0.0,
        metavar="M",
        help="of the lanes' middle from the pile's (default 0)",
    )
    flight.add_argument(
        "--length",
        type=float,
        metavar="M",
        help="of a lane or of the eight (default: the foot's length and 20 m)",
    )
    flight.add_argument("--speed", type=float, default=4.0, metavar="M/S", help="default 4")
    flight.add_argument(
        "--turn", type=float, default=6.0, metavar="S", help="time of a turn (default 6)"
    )
    flight.add_argument("--cross", action="store_true", help="the lanes once more, across")
    flight.add_argument(
        "--eight",
        type=float,
        metavar="S",
        help="a figure of eight of so many seconds instead, as `simulate` flies it",
    )


def _add_sensors(parser: argparse.ArgumentParser) -> None:
    """Scanner, attitude source and error budget."""
    sensors = parser.add_argument_group("sensors and error budget")
    sensors.add_argument(
        "--budget",
        metavar="NAME",
        help="a published budget: table1_low, table1_high, survey, survey_corrected, thesis",
    )
    sensors.add_argument("--scanner", metavar="NAME", help="vlp16 (default) or line")
    sensors.add_argument(
        "--imu", metavar="NAME", help="survey, tactical or mems; default: the budget's own"
    )
    sensors.add_argument("--rate", type=float, metavar="HZ", help="pulses per second")
    sensors.add_argument(
        "--fix-rate",
        type=float,
        default=10.0,
        metavar="HZ",
        help="fixes of the position per second (default 10)",
    )
    sensors.add_argument(
        "--config", type=Path, help="parameter file: budget, calibration, filter, volume"
    )
    sensors.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="SECTION.KEY=VALUE",
        help="override one parameter",
    )


def _add_roughness(scene: argparse._ArgumentGroup) -> None:
    """The roughness of the ground."""
    scene.add_argument(
        "--rough",
        type=float,
        default=0.01,
        metavar="M",
        help="roughness of the ground (default 0.01)",
    )
    scene.add_argument(
        "--rough-length",
        type=float,
        default=1.0,
        metavar="M",
        help="its correlation length (default 1)",
    )
