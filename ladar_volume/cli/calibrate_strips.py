"""``ladar_volume calibrate strips``: boresight, lever arms and clock offset from the overlapping
strips of a recording.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from ladar_volume.calibration.flight import Flight, apply_corrections, flight
from ladar_volume.calibration.repeats import correction_of
from ladar_volume.calibration.selfcal import CORRECTED, StripCalibration, calibrate
from ladar_volume.cli.arguments.work import config_for
from ladar_volume.cli.replay import topics_by_role
from ladar_volume.georeference.error_budget import calibration_covariance, correlation_triangle
from ladar_volume.georeference.lidar_equation import mounting
from ladar_volume.io.bags import wanted_topics
from ladar_volume.io.config import changed_config, read_config
from ladar_volume.io.drivers.packet_capture import open_recording
from ladar_volume.io.results import json_text, write_text
from ladar_volume.model.errors import CalibrationError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import CAL_COLUMNS, F64, MappedPoints, concatenate, select
from ladar_volume.model.survey_parameters import StripParameters
from ladar_volume.replay import Replay
from ladar_volume.version import version


def run(arguments: argparse.Namespace) -> int:
    """Read, adjust, write, print."""
    if arguments.returns < 1000 or not 0.05 <= arguments.edge <= 100.0:
        raise CalibrationError(
            "--returns must be 1000 or more and --edge 0.05 to 100 m", reason="calibration_options"
        )
    parameters = read_config(config_for(arguments.bag, arguments.config), arguments.set)
    console = Console(stderr=arguments.json)
    recorded, parameters = recorded_flight(arguments, parameters, console)
    g = parameters.georeference
    with console.status("adjusting"):
        prior = calibration_covariance(parameters.budget, g.beams, g.pose_source)
        found = calibrate(
            recorded, parameters.budget, prior, StripParameters(edge_m=arguments.edge)
        )
    corrected = calibrated_parameters(found, parameters)
    if arguments.output is not None:
        write_calibration(arguments.output, corrected, arguments.bag.name)
    if arguments.json:
        print(json_text(facts_of(found, corrected)), end="")
    else:
        show(console, found)
        if arguments.output is not None:
            console.print(f"written to {arguments.output}")
    return 0


def recorded_flight(
    arguments: argparse.Namespace, parameters: Parameters, console: Console
) -> tuple[Flight, Parameters]:
    """The recording as a flight, with a bar of the progress, and the parameters that it was
    georeferenced with: the mounting may come from /tf_static.
    """
    with open_recording(arguments.bag) as bag:
        replay = Replay(
            bag,
            parameters,
            bag.roles(wanted_topics(topics_by_role(arguments.topic), parameters)),
            arguments.start,
            arguments.duration,
        )
        with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
            task = bar.add_task(f"reading {arguments.bag.name}", total=1.0)
            recorded = read_flight(
                replay, arguments.returns, lambda share: bar.update(task, completed=share)
            )
        return recorded, replay.parameters


def write_calibration(path: Path, corrected: Parameters, recording: str) -> None:
    """Write calibration and budget as a parameter file."""
    sections = {name: corrected.write()[name] for name in ("calibration", "budget")}
    comment = f"Self-calibration from the strips of {recording}."
    write_text(path, changed_config(corrected, sections, comment))


def read_flight(
    replay: Replay, most: int, progress: Callable[[float], None] = lambda share: None
) -> Flight:
    """The recording as a flight of at most ``most`` returns, an even random choice from every
    cloud.
    """
    stage = replay.engine.georeferencer
    add: dict[str, Callable[[Any], None]] = {
        "fix": stage.add_fix,
        "imu": stage.add_imu,
        "odometry": stage.add_odometry,
        "cloud": stage.add_returns,
    }
    each = max(1, most // max(1, replay.bag.topics()[replay.topics["cloud"]][1]))
    rng, kept, fixes = np.random.default_rng(1), list[MappedPoints](), 0
    for share, role, record in replay.records():
        add[role](record)
        fixes += role in ("fix", "odometry")
        if role == "cloud":
            kept += [_random_subset(points, each, rng) for points in stage.take_points()]
            progress(share)
    stage.finish()
    kept += [_random_subset(points, each, rng) for points in stage.take_points()]
    states = stage.take_platform()
    if states is None or len(states) < 2 or not kept:
        lost = ", ".join(f"{reason} {count}" for reason, count in stage.losses.items())
        raise CalibrationError(
            f"no return could be georeferenced; not used: {lost or 'nothing'}",
            reason="calibration_no_returns",
        )
    seconds = float(states.t_ns[-1] - states.t_ns[0]) * 1e-9
    return flight(concatenate(kept), states, stage.mount, fixes / seconds)


def _random_subset(points: MappedPoints, most: int, rng: np.random.Generator) -> MappedPoints:
    return (
        points
        if len(points) <= most
        else select(points, np.sort(rng.choice(len(points), most, replace=False)))
    )


def calibrated_parameters(found: StripCalibration, parameters: Parameters) -> Parameters:
    """The parameters with corrected constants, their sigmas and all correlations."""
    c, sigma = parameters.calibration, np.sqrt(np.diag(found.C_cal))
    mount = apply_corrections(mounting(c), found.theta)

    def numbers(values: F64) -> tuple[float, ...]:
        return tuple(float(v) for v in values)

    calibration = dataclasses.replace(
        c,
        boresight_correction_rad=numbers(
            correction_of(
                mount.R_body_laser, c.boresight_roll_rad, c.boresight_pitch_rad, c.boresight_yaw_rad
            )
        ),
        lever_laser_m=numbers(mount.lever_laser),
        lever_antenna_m=numbers(mount.lever_antenna),
        clock_offset_s=c.clock_offset_s + float(found.theta[10]),
    )
    budget = dataclasses.replace(
        parameters.budget,
        boresight_sigma_rad=numbers(sigma[1:4]),
        lever_laser_sigma_m=numbers(sigma[4:7]),
        lever_antenna_sigma_m=parameters.budget.lever_antenna_sigma_m
        if not sigma[7:10].any()
        else numbers(sigma[7:10]),
        clock_sigma_s=float(sigma[10]),
        calibration_correlation=correlation_triangle(found.C_cal),
    )
    # through the door once, so that what is written can be read
    return Parameters.read(
        dataclasses.replace(parameters, calibration=calibration, budget=budget).write()
    )


def display_unit(k: int) -> tuple[float, str]:
    """Factor and unit in which column k is shown: degrees, millimetres, milliseconds."""
    name = CAL_COLUMNS[k]
    return (
        (float(np.degrees(1.0)), "deg")
        if name.startswith("boresight")
        else (1e3, "ms")
        if name == "clock"
        else (1e3, "mm")
    )


def facts_of(found: StripCalibration, corrected: Parameters) -> dict[str, Any]:
    """The result as plain values in m, rad, s, and the corrected parameters."""
    constants = {
        found.names[k]: {
            "correction": float(found.theta[k]),
            "sigma": float(np.sqrt(found.posterior[k, k])),
            "prior_sigma": float(np.sqrt(found.prior[k, k])),
            "status": found.status(int(k)),
            "weakest": float(found.weakest[k]),
        }
        for k in CORRECTED
    }
    names = (
        "condition",
        "noise",
        "chi2",
        "freedom",
        "agree",
        "beyond_prior",
        "before_m",
        "after_m",
        "patches",
        "strips",
        "returns",
        "steps",
    )
    part = np.ix_(CORRECTED, CORRECTED)
    return {
        "constants": constants,
        "columns": [found.names[k] for k in CORRECTED],
        "covariance": found.posterior[part].tolist(),
        **{name: getattr(found, name) for name in names},
        "moved": found.moved_patches,
        "calibration": corrected.write()["calibration"],
        "version": version(),
    }


def show(console: Console, found: StripCalibration) -> None:
    """Print the result as a table with what it rests on."""
    console.print(constant_table(found))
    console.print(
        f"{found.returns:,} returns of {found.strips} strips on {found.patches} patches "
        f"({found.moved_patches} left out: something moved), "
        f"{found.steps} steps; strips {1e3 * found.before_m:.1f} mm off their planes "
        f"before, {1e3 * found.after_m:.1f} mm after"
    )
    verdict = "agree" if found.agree else "[bold]do not agree[/bold]"
    console.print(
        f"corrected strips {verdict} within the budget: chi-square {found.chi2:.0f} with "
        f"{found.freedom} degrees of freedom; noise of a "
        f"return {found.noise:.2f} times the budget's"
    )
    if found.beyond_prior:
        names = ", ".join(name.replace("_", " ") for name in found.beyond_prior)
        console.print(
            f"[bold]beyond 3.5 sigma of the prior: {names}[/bold]; the budget, or the "
            "recording, is not what it was taken for"
        )
    worst = ", ".join(
        f"{found.weakest[k]:+.2f} {found.names[k].replace('_', ' ')}"
        for k in CORRECTED
        if abs(found.weakest[k]) > 0.2
    )
    console.print(f"worst determined: {worst} (in prior sigmas); condition {found.condition:.0f}")


def constant_table(found: StripCalibration) -> Table:
    """The corrections of the constants, with their standard deviations before and after."""
    table = Table(
        "constant", "correction", "sigma", "prior sigma", "unit", "", box=None, pad_edge=False
    )
    for k in CORRECTED:
        factor, unit = display_unit(int(k))
        after, before = (float(np.sqrt(C[k, k])) * factor for C in (found.posterior, found.prior))
        table.add_row(
            found.names[k].replace("_", " "),
            f"{found.theta[k] * factor:.4f}",
            f"{after:.4f}",
            f"{before:.4f}",
            unit,
            found.status(int(k)),
        )
    return table
