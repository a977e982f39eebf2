"""``ladar_volume plan``: the accuracy of a volume before the flight."""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.table import Table

from ladar_volume.cli.tables.result_table import budget_table, volume_rows
from ladar_volume.io.config import read_config
from ladar_volume.io.results import json_text, volume_dict
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import PlatformStates
from ladar_volume.version import version

if TYPE_CHECKING:  # loaded where they are used
    from ladar_volume.planning.planned_scene import Pile
    from ladar_volume.planning.prediction import Plan, Prediction, Scanner
    from ladar_volume.planning.sensor_choice import Choice


def parameters_of(arguments: argparse.Namespace) -> Parameters:
    """The parameters: what suits a pile, the file, a published budget, sensors by name, single
    values; later ones win.
    """
    from ladar_volume.georeference.error_budget import PRESETS
    from ladar_volume.model.errors import ParameterValueError
    from ladar_volume.planning.sensor_choice import with_sensors
    from ladar_volume.simulation.suited_parameters import SUITED

    if arguments.config is None:
        # a scanner that spins about the direction of flight
        parameters = Parameters.read(
            {**SUITED["pile"], "calibration": {"boresight_pitch_deg": 90.0}}
        )
    else:
        parameters = read_config(arguments.config)
    if arguments.budget is not None:
        if arguments.budget not in PRESETS:
            raise ParameterValueError(
                f"no budget {arguments.budget!r}; there are {', '.join(PRESETS)}",
                value=arguments.budget,
            )
        parameters = dataclasses.replace(parameters, budget=PRESETS[arguments.budget])
    return read_config(
        None, arguments.set, start=with_sensors(parameters, arguments.scanner, arguments.imu)
    )


def planned_path(
    arguments: argparse.Namespace, length_m: float, width_m: float, longest_s: float
) -> Callable[[float], PlatformStates]:
    """The path for a height, with its fixes, no more than ``longest_s`` apart."""
    from ladar_volume.planning.planned_path import Lanes, with_fixes

    fixes = arguments.fix_rate, longest_s
    length = length_m + 20.0 if arguments.length is None else arguments.length
    if arguments.eight is not None:
        eight_s = arguments.eight
        return lambda height: with_fixes(figure_eight(length / 2.0, height, eight_s), *fixes)
    spacing = width_m / max(arguments.lanes, 1) if arguments.spacing is None else arguments.spacing
    lanes = Lanes(
        0.0,
        arguments.lanes,
        spacing,
        length,
        arguments.speed,
        arguments.turn,
        arguments.cross,
        aside_m=arguments.aside,
    )
    return lambda height: with_fixes(dataclasses.replace(lanes, height_m=height).states(), *fixes)


def figure_eight(
    extent_m: float, height_m: float, duration_s: float, rate_hz: float = 100.0
) -> PlatformStates:
    """States of the simulation's figure of eight, which banks in its turns."""
    from ladar_volume.simulation.platforms import uav

    platform = uav(extent_m, height_m, duration_s)
    t, h = np.arange(0.0, duration_s + 0.5 / rate_hz, 1.0 / rate_hz), 1e-3
    rotation, n = platform.rotation(t), len(t)
    velocity = rotation.inv().apply(
        (platform.position(t + h) - platform.position(t - h)) / (2.0 * h)
    )
    t_ns = np.rint(t * 1e9).astype(np.int64)
    return PlatformStates(
        t_ns,
        platform.position(t),
        rotation.as_quat(),
        velocity,
        platform.rates(t),
        np.zeros((n, 6, 6)),
        np.zeros(n, np.int64),
    )


def run(arguments: argparse.Namespace) -> int:
    """Predict, compare, print."""
    from ladar_volume.planning.prediction import Plan, predict

    console = Console(stderr=arguments.json)
    parameters = parameters_of(arguments)
    pile, scanner = pile_of(arguments), scanner_of(arguments)
    longest_s = parameters.georeference.max_position_gap_s
    path = planned_path(arguments, pile.length_m, pile.width_m, longest_s)
    plan = Plan(pile, path(arguments.height), scanner, parameters, arguments.seed)
    with console.status("sampling the planned flight") as status:
        facts = prediction_facts(plan, predict(plan), arguments.height)
        if arguments.compare:
            facts["sensors"] = compare_sensors(plan, status.update)
        if arguments.wanted is not None:
            facts |= compare_heights(plan, path, arguments.wanted, status.update)
    if arguments.json:
        print(json_text(facts), end="")
    else:
        show(console, facts)
    return 0


def pile_of(arguments: argparse.Namespace) -> Pile:
    """The elliptic pile or pit that is asked for, or a cone at its angle of repose."""
    from ladar_volume.planning.planned_scene import Pile

    a = arguments
    if a.pile is not None:
        length, width, height = a.pile
        return Pile(length, width, height, a.top, a.rough, a.rough_length)
    volume = 100.0 if a.volume is None else a.volume
    return Pile.cone(volume, math.radians(a.repose), a.rough, a.rough_length)


def scanner_of(arguments: argparse.Namespace) -> Scanner:
    """The scanner by name, with a pulse rate of its own where one is given."""
    from ladar_volume.planning.sensor_choice import SCANNERS

    scanner = SCANNERS[arguments.scanner or "vlp16"][0]
    if arguments.rate is not None:
        scanner = dataclasses.replace(scanner, rate_hz=arguments.rate)
    return scanner


def prediction_facts(plan: Plan, prediction: Prediction, height_m: float) -> dict[str, Any]:
    """What the JSON says of the prediction for a flight at that height."""
    return {
        "plan": {
            **dataclasses.asdict(plan.pile),
            "flight_height_m": height_m,
            "scanner": dataclasses.asdict(plan.scanner),
        },
        **volume_dict(prediction.volume),
        "true_volume_m3": prediction.true_m3,
        "sigma_share": prediction.share,
        "returns_per_m2": prediction.returns_per_m2,
        "duration_s": prediction.duration_s,
        "version": version(),
    }


def compare_sensors(plan: Plan, progress: Callable[[str], None]) -> list[dict[str, Any]]:
    """Every scanner with every IMU."""
    from ladar_volume.planning.sensor_choice import compare

    rows = []
    for choice in compare(plan):
        progress(f"compared: {choice.name}")
        rows.append(choice_facts(choice))
    return rows


def compare_heights(
    plan: Plan,
    path: Callable[[float], PlatformStates],
    wanted: float,
    progress: Callable[[str], None],
) -> dict[str, Any]:
    """Heights of the flight, and the highest at which sigma / V is no more than wanted."""
    from ladar_volume.planning.sensor_choice import height_steps, highest, over_heights

    heights, rows = height_steps(plan), []
    for choice in over_heights(plan, path, heights):
        progress(f"height: {choice.name} m")
        rows.append(choice_facts(choice))
    shares = np.array([math.nan if r["sigma_share"] is None else r["sigma_share"] for r in rows])
    return {
        "heights": rows,
        "wanted_share": wanted,
        "maximum_height_m": highest(heights, shares, wanted),
    }


def choice_facts(choice: Choice) -> dict[str, Any]:
    """One alternative as plain values."""
    p = choice.prediction
    return {
        "name": choice.name,
        "sigma_m3": None if p is None else p.volume.sigma_m3,
        "sigma_share": None if p is None else p.share,
        "largest_source": None if p is None else p.volume.largest_source,
        "reason": choice.reason if p is None else "",
    }


def show(console: Console, facts: Mapping[str, Any]) -> None:
    """Print a prediction."""
    head = Table(show_header=False, box=None, pad_edge=False)
    head.add_row("planned volume", f"{facts['true_volume_m3']:.1f} m³ on {facts['area_m2']:.0f} m²")
    head.add_row(
        "predicted sigma",
        f"[bold]{facts['sigma_m3']:.3f} m³[/bold] ({100 * facts['sigma_share']:.2f} %)",
    )
    head.add_row(
        "scanning", f"{facts['duration_s']:.0f} s, {facts['returns_per_m2']:.0f} returns per m²"
    )
    volume_rows(head, facts)
    console.print(head)
    console.print(budget_table(facts))
    if "sensors" in facts:
        console.print(choice_table(facts["sensors"], "Scanner and IMU", "sensors"))
    if "heights" in facts:
        console.print(choice_table(facts["heights"], "Height of the flight", "height / m"))
    if "wanted_share" in facts:
        console.print(wanted_words(facts))


def choice_table(rows: Sequence[Mapping[str, Any]], title: str, first: str) -> Table:
    """Alternatives side by side."""
    table = Table(
        first, "sigma / m³", "sigma / V", "largest source", title=title, title_justify="left"
    )
    for row in rows:
        if row["sigma_m3"] is None:
            table.add_row(row["name"], "", "", row["reason"])
        else:
            table.add_row(
                row["name"],
                f"{row['sigma_m3']:.3f}",
                f"{100 * row['sigma_share']:.2f} %",
                row["largest_source"].replace("_", " "),
            )
    return table


def wanted_words(facts: Mapping[str, Any]) -> str:
    """Up to which height the wanted share is reached."""
    height, wanted = facts["maximum_height_m"], f"{100 * facts['wanted_share']:g} %"
    tried = float(facts["heights"][-1]["name"])
    reached = (
        f"up to {height:.0f} m" + (" or more" if height >= tried else "")
        if math.isfinite(height)
        else "at no height tried"
    )
    return f"{wanted} is reached {reached}"
