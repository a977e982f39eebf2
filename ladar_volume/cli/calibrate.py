"""``ladar_volume calibrate``: calibration constants and their sigmas, as a parameter file."""

from __future__ import annotations

import argparse
import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from ladar_volume.calibration.repeats import (
    Components,
    Spread,
    angles_of,
    boresight_vectors,
    budget_sigma,
    components,
    correction_of,
    spread,
)
from ladar_volume.cli.arguments.calibrate import ANGLES, COLUMNS
from ladar_volume.io.atomic_write import atomic_file
from ladar_volume.io.config import changed_config, read_config
from ladar_volume.io.measurements import Measurements, read_measurements
from ladar_volume.io.results import json_text
from ladar_volume.math.se3 import exp_so3, rotation_xyz
from ladar_volume.model.errors import CalibrationError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64
from ladar_volume.version import version

#: The constant that belongs to a sigma.
VALUES = {
    "boresight_sigma_deg": "boresight_correction_deg",
    "lever_laser_sigma_m": "lever_laser_m",
    "lever_antenna_sigma_m": "lever_antenna_m",
    "clock_sigma_s": "clock_offset_s",
}


@dataclasses.dataclass(frozen=True)
class Statistics:
    """Of one constant: the spread of its values, and that within and between mountings where the
    file tells these apart.
    """

    spread: Spread
    components: Components | None

    def budget_sigma(self, uses: str) -> float:
        """The standard deviation for the budget of a survey that uses the constant so."""
        return budget_sigma(self.components or self.spread, uses)

    def mean(self, uses: str) -> float:
        """The value that such a survey uses."""
        if self.components is None:
            return self.spread.mean
        return self.components.last_mean if uses == "mean" else self.components.mean


def run_repeats(arguments: argparse.Namespace) -> int:
    """Read, estimate, write, print."""
    base = read_config(arguments.config)
    if base.budget.calibration_correlation:
        raise CalibrationError(
            (
                f"{arguments.config} holds correlations of the calibration, which new sigmas "
                "would contradict"
            ),
            reason="calibration_base",
        )
    table = read_measurements(arguments.file, (*ANGLES, *COLUMNS))
    columns, mean = _columns(table, base)
    angles = _mean_angles(table, mean)
    found = {
        name: _statistics(name, values, table.mounting, arguments.confidence)
        for name, values in columns.items()
    }
    sections = _sections(found, arguments.uses, base, mean)
    if arguments.output is not None:
        words = (
            f"{arguments.file.name}: {len(next(iter(columns.values())))} values, {arguments.uses}"
        )
        write_config(
            arguments.output, base, sections, f"Sigmas from repeated measurements ({words})."
        )
    facts = {
        "file": str(arguments.file),
        "uses": arguments.uses,
        "confidence": arguments.confidence,
        "constants": {name: _facts(each, arguments.uses) for name, each in found.items()},
        "mean_angles_deg": angles,
        **sections,
        "version": version(),
    }
    if arguments.json:
        print(json_text(facts), end="")
    else:
        _show(Console(), found, arguments.uses, angles)
    return 0


def _mean_angles(table: Measurements, mean: F64) -> dict[str, float] | None:
    """The mean boresight (3, 3) as angles, deg, where angles were measured."""
    if not set(ANGLES) <= set(table.columns):
        return None
    return dict(zip(ANGLES, np.degrees(angles_of(mean)).tolist(), strict=True))


def _facts(found: Statistics, uses: str) -> dict[str, Any]:
    """What the JSON says of one constant."""
    return dataclasses.asdict(found.spread) | {
        "by_mounting": None if found.components is None else dataclasses.asdict(found.components),
        "budget_sigma": found.budget_sigma(uses),
    }


def _columns(table: Measurements, base: Parameters) -> tuple[dict[str, F64], F64]:
    """The columns to judge, and the rotation (3, 3) about which boresight vectors are counted."""
    c, columns = base.calibration, dict(table.columns)
    nominal = rotation_xyz(c.boresight_roll_rad, c.boresight_pitch_rad, c.boresight_yaw_rad)
    angles = [name for name in ANGLES if name in columns]
    if not angles:
        return columns, nominal
    if len(angles) < 3 or any(f"boresight_{axis}_deg" in columns for axis in "xyz"):
        raise CalibrationError(
            (
                f"{', '.join(ANGLES)} come together, and not beside boresight_x_deg, "
                "boresight_y_deg, boresight_z_deg"
            ),
            reason="calibration_columns",
            value=angles,
        )
    vectors, mean = boresight_vectors(
        np.radians(np.stack([columns.pop(name) for name in ANGLES], axis=1))
    )
    return {
        f"boresight_{axis}_deg": np.degrees(vectors[:, i]) for i, axis in enumerate("xyz")
    } | columns, mean


def _statistics(
    name: str, values: F64, mounting: list[str] | None, confidence: float
) -> Statistics:
    try:
        return Statistics(
            spread(values, confidence),
            None if mounting is None else components(values, mounting, confidence),
        )
    except CalibrationError as error:
        raise CalibrationError(
            f"{name}: {error}", reason=error.reason, value=error.value
        ) from error


def _sections(
    found: dict[str, Statistics], use: str, base: Parameters, boresight: F64
) -> dict[str, dict[str, Any]]:
    """What changes in the parameter file: the sigmas, and with a mean the constants themselves."""
    keys = base.write()
    budget: dict[str, Any] = {}
    constants: dict[str, Any] = {}
    for name, each in found.items():
        key, axis = COLUMNS[name]
        _set_component(budget, keys["budget"], key, axis, each.budget_sigma(use))
        _set_component(constants, keys["calibration"], VALUES[key], axis, each.mean(use))
    if "boresight_correction_deg" in constants:
        c = base.calibration
        turned = exp_so3(np.radians(constants["boresight_correction_deg"])) @ boresight
        correction = correction_of(
            turned, c.boresight_roll_rad, c.boresight_pitch_rad, c.boresight_yaw_rad
        )
        constants["boresight_correction_deg"] = [math.degrees(v) for v in correction]
    return {"budget": budget} if use == "single" else {"calibration": constants, "budget": budget}


def _set_component(
    into: dict[str, Any], base: dict[str, Any], key: str, axis: int, value: float
) -> None:
    if axis < 0:
        into[key] = value
    else:
        into.setdefault(key, list(base[key]))[axis] = value


def write_config(
    path: Path, base: Parameters, sections: dict[str, dict[str, Any]], comment: str
) -> None:
    """The base with the changed sections as a parameter file; a value out of range is refused
    before anything is written.
    """
    text = changed_config(Parameters.read(sections, base), sections, comment)
    with atomic_file(path) as part:
        part.write_text(text, encoding="utf-8")


def _show(
    console: Console,
    found: dict[str, Statistics],
    use: str,
    angles: dict[str, float] | None,
) -> None:
    console.print(_spread_table(found, use))
    if angles is not None:
        words = ", ".join(f"{name} {value:.4f}" for name, value in angles.items())
        console.print(f"mean angles: {words}; boresight_x to _z are turns about that mean")
    grouped = {name: each.components for name, each in found.items() if each.components is not None}
    if not grouped:
        console.print(
            "no column 'mounting': re-mountings, if there were any, are part of the "
            "spread and cannot be told apart"
        )
        return
    console.print(_mounting_table(grouped))


def _interval(interval: tuple[float, float]) -> str:
    return f"{interval[0]:.3g} - {interval[1]:.3g}"


def _spread_table(found: dict[str, Statistics], use: str) -> Table:
    """The spread of each constant, and what goes into the budget."""
    table = Table(
        "constant",
        "n",
        "mean",
        "one value",
        "interval",
        "the mean",
        "budget",
        box=None,
        pad_edge=False,
        title_justify="left",
        title=f"Standard deviations; into the budget goes that of: {use}",
    )
    for name, each in found.items():
        s = each.spread
        table.add_row(
            name,
            str(s.count),
            f"{s.mean:.4g}" if abs(s.mean) > 1e-6 * s.sigma_single else "0",
            f"{s.sigma_single:.4g}",
            _interval(s.single_interval),
            f"{s.sigma_mean:.4g}",
            f"{each.budget_sigma(use):.4g}",
        )
    return table


def _mounting_table(grouped: dict[str, Components]) -> Table:
    """The spread within and between mountings."""
    table = Table(
        "constant",
        "n",
        "within",
        "interval",
        "between",
        "interval",
        "p",
        box=None,
        pad_edge=False,
        title_justify="left",
        title="By mounting: within one, between them, and p of none between",
    )
    for name, c in grouped.items():
        table.add_row(
            name,
            str(c.mountings),
            f"{c.sigma_within:.4g}",
            _interval(c.within_interval),
            f"{c.sigma_between:.4g}",
            _interval(c.between_interval),
            f"{c.p_value:.2g}",
        )
    return table
