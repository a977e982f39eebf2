"""``ladar_volume replay``: a recording through the engine, offline."""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from ladar_volume.cli.arguments.work import config_for
from ladar_volume.cli.scale.workers import check_workers
from ladar_volume.cli.tables.result_table import show_result
from ladar_volume.cli.verdict_lines import exit_code
from ladar_volume.io import results
from ladar_volume.io.bags import wanted_topics
from ladar_volume.io.config import read_config
from ladar_volume.io.drivers.recording_series import open_recordings
from ladar_volume.io.logs.heard_live import in_words
from ladar_volume.io.meshfiles.body_mesh import write_bodies
from ladar_volume.io.output_set import output_set
from ladar_volume.io.surveys import FILE, write_survey
from ladar_volume.model.errors import ConfigurationError, short_repr
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import Estimate
from ladar_volume.replay import Replay
from ladar_volume.uncertainty.epoch_budget import Epoch

if TYPE_CHECKING:
    from ladar_volume.io.mavlink.mavlink_log import MavlinkLog


def topics_by_role(words: list[str]) -> dict[str, str]:
    """``role=topic`` words as a dictionary. Raises :class:`ConfigurationError` for other words."""
    pairs = [word.partition("=") for word in words]
    for word, (role, _, topic) in zip(words, pairs, strict=True):
        if not (role and topic):
            raise ConfigurationError(f"--topic {short_repr(word)}: give role=topic", value=word)
    return {role: topic for role, _, topic in pairs}


def run(arguments: argparse.Namespace) -> int:
    """Replay, print, write the output folder."""
    console = Console(stderr=arguments.json)
    parameters = read_config(config_for(arguments.bag, arguments.config), arguments.set)
    check_workers(arguments)
    if arguments.convergence and (arguments.dask is not None or arguments.tile is not None):
        raise ConfigurationError("--convergence is for one process: leave --tile and --dask out")
    if arguments.all_messages and (arguments.dask is not None or arguments.tile is not None):
        raise ConfigurationError("--all-messages is for one process: leave --tile and --dask out")
    with output_set(arguments.output, results.SURVEY_FILES) as folder:
        result, seconds = _replay_and_write(arguments, parameters, folder, console)
    if arguments.json:
        print(results.json_text(result), end="")
    else:
        show_result(console, result)
        show_bodies(console, result.get("closed_bodies", []))
        if unheard := result["input"].get("unheard_live"):
            console.print(
                f"{in_words(unheard)} that the log had heard before georeference_node did are left "
                "out, so that this is the live volume (--all-messages takes them)"
            )
        if more := result["input"].get("more_than_live"):
            console.print(
                f"the log has {in_words(more)} more than georeference_node had heard: this volume "
                "is of more data than the live one"
            )
        console.print(
            f"{min(arguments.duration, result['input']['duration_s']) / seconds:.1f} x "
            f"real time; written to {arguments.output}/"
        )
    return exit_code(arguments, result["verdict"])


def show_bodies(console: Console, bodies: Sequence[Mapping[str, Any]]) -> None:
    """Print the closed bodies, one a row."""
    if not bodies:
        return
    table = Table("closed body", "volume", "sigma", "height", "at", "largest source")
    for k, b in enumerate(bodies, 1):
        x, y, _ = b["centroid_map_m"]
        largest = max(b["budget_m6"], key=lambda source: b["budget_m6"][source])
        numbers = f"{b['volume_m3']:.3f} m³", f"{b['sigma_m3']:.3f} m³", f"{b['height_m']:.2f} m"
        table.add_row(str(k), *numbers, f"{x:.2f}, {y:.2f}", largest)
    console.print(table)


def _replay_and_write(
    arguments: argparse.Namespace, parameters: Parameters, folder: Path, console: Console
) -> tuple[dict[str, Any], float]:
    """Replay and write; returns the result and the seconds the replay took."""
    paths = [arguments.bag, *arguments.more]
    with open_recordings(paths, arguments.all_messages) as bag:
        poses = poses_of(arguments, parameters)
        roles = bag.roles(wanted_topics(topics_by_role(arguments.topic), parameters))
        part = (arguments.start, arguments.duration)
        replay = Replay(bag, parameters, roles, *part, poses, arguments.convergence)
        began = time.perf_counter()
        tiles: dict[str, Any] = {}
        if arguments.dask is None and arguments.tile is None:
            estimate = run_here(replay, console)
        else:
            from ladar_volume.cli.scale.tiled import run_by_tiles  # with Dask and Arrow

            estimate, tiles = run_by_tiles(replay, arguments)
        result = replay.result(estimate) | tiles
        if parameters.volume.kind == "bodies":
            add_closed_bodies(replay, estimate, result, folder)
        seconds = time.perf_counter() - began
    write_outputs(
        folder,
        estimate,
        replay.engine.estimator.epoch(),
        result,
        replay.bag.path.name,
        figure=not arguments.no_figure,
    )
    if not arguments.no_figure:
        from ladar_volume.report.survey_report import write_survey_report

        epoch = replay.engine.estimator.epoch()
        write_survey_report(folder / "report.html", estimate, epoch, result, replay.fixes)
    return result, seconds


def run_here(replay: Replay, console: Console) -> Estimate:
    """Replay in this process."""
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(f"replaying {replay.bag.path.name}", total=1.0)
        return replay.run(lambda share: bar.update(task, completed=share))


def poses_of(arguments: argparse.Namespace, parameters: Parameters) -> MavlinkLog | None:
    """The autopilot's log that stands in for the recording's own poses, where one is given."""
    if arguments.poses is None:
        return None
    from ladar_volume.io.mavlink.mavlink_log import MavlinkLog  # with pymavlink

    return MavlinkLog(arguments.poses, parameters.mavlink)


def add_closed_bodies(
    replay: Replay, estimate: Estimate, result: dict[str, Any], folder: Path
) -> None:
    """Closed bodies of the survey: into the result, and their meshes into the folder."""
    found = replay.closed_bodies(estimate)
    result["closed_bodies"] = results.closed_bodies_dict(found)
    result["verdict"] = results.with_doubts(result["verdict"], found.verdict)
    write_bodies(folder / "bodies.ply", [b.body for b in found.bodies])


def write_outputs(
    folder: Path,
    estimate: Estimate,
    epoch: Epoch,
    result: dict[str, Any],
    title: str,
    figure: bool = True,
) -> None:
    """result.json, mesh.ply, result.mcap and, where wanted, figure.png."""
    results.write_text(folder / "result.json", results.json_text(result))
    results.write_ply(folder / "mesh.ply", estimate.tin, epoch.sigma_z(estimate.tin))
    write_survey(folder / FILE, estimate, epoch, result)
    if figure:
        from ladar_volume.report.figure import save  # matplotlib takes a second to load
        from ladar_volume.report.scene import where_of

        save(estimate, title, folder / "figure.png", where_of(result["datum"]))
