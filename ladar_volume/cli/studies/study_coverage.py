"""``ladar_volume study coverage``: Monte Carlo of whole surveys against the printed sigma."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from ladar_volume.cli.arguments.lines import Verbs
from ladar_volume.version import version

if TYPE_CHECKING:  # the study is loaded to run it
    from ladar_volume.experiments.coverage.coverage import Task

#: Surveys through the whole engine where no number is given.
ENGINE_SURVEYS = 200


def add_coverage(studies: Verbs) -> None:
    """Declare the study."""
    parser = studies.add_parser(
        "coverage",
        help=(
            "do the error bars hold the truth? Monte Carlo of whole surveys, all sources on "
            "and each alone"
        ),
        description="Simulates surveys with every error source drawn anew and compares the "
        "spread of "
        "the volumes with the printed sigma: "
        "2000 surveys per scenario, 1000 with each source alone, 500 with each kind of "
        "wrong budget; an hour on two cores. One "
        "line per survey is appended to a file; a run that was stopped goes on.",
    )
    _add_surveys(parser)
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path("coverage"),
        metavar="FOLDER",
        help="surveys.jsonl, tables.md and study.json",
    )
    parser.add_argument(
        "--json", action="store_true", help="print the numbers as JSON to standard output"
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Simulate what is missing, summarise, write, print."""
    from ladar_volume.experiments.coverage import coverage
    from ladar_volume.experiments.coverage.coverage_cases import SCENARIOS
    from ladar_volume.experiments.coverage.coverage_tables import tables
    from ladar_volume.io.results import json_text, output_folder, write_text

    counts = coverage.REDUCED if arguments.reduced else coverage.FULL
    if arguments.surveys is not None:
        counts = (arguments.surveys,) * 3
    scenarios = arguments.scenario or list(SCENARIOS)
    todo = coverage.tasks(scenarios, counts, arguments.engine)
    folder = output_folder(arguments.output)
    console = Console(stderr=arguments.json)
    _simulate(todo, folder / coverage.FILE, arguments.workers, console)
    found = coverage.summary(_known_rows(todo, folder / coverage.FILE), scenarios)
    facts = {
        "study": "coverage",
        "limits": coverage.limits(max(counts)),
        "scenarios": found,
        "version": version(),
    }
    write_text(folder / "tables.md", tables(found))
    write_text(folder / "study.json", json_text(facts))
    if arguments.json:
        print(json_text(facts), end="")
        return 0
    console.print(tables(found), markup=False, highlight=False, soft_wrap=True)
    console.print(f"written to {folder}")
    return 0


def _simulate(todo: list[Task], file: Path, workers: int, console: Console) -> None:
    """Simulate what the file has not yet, with a bar of the progress."""
    from ladar_volume.experiments.coverage import coverage

    bar = Progress(
        TextColumn("surveys"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
    )
    with bar:
        task = bar.add_task("surveys", total=len(todo))
        coverage.run(todo, file, workers, lambda count: bar.update(task, completed=count))


def _known_rows(todo: list[Task], file: Path) -> list[dict[str, Any]]:
    """The surveys of the file that were asked for."""
    from ladar_volume.experiments.coverage import coverage

    wanted = set(todo)
    known, others = coverage.sorted_rows(file)
    if others:
        Console(stderr=True).print(
            f"{others} surveys of another version of the study in {file} are left out"
        )
    return [r for r in known if coverage.finished_tasks([r]) <= wanted]


def _add_surveys(parser: argparse.ArgumentParser) -> None:
    """Which surveys are simulated, and how many."""
    parser.add_argument(
        "--scenario",
        action="append",
        default=[],
        metavar="NAME",
        help="stockpile_100, stockpile_5000, pit, box (default: all)",
    )
    parser.add_argument(
        "--reduced",
        action="store_true",
        help="200 surveys, 200 per source, 50 per wrong budget; some seven minutes on two cores",
    )
    parser.add_argument(
        "--engine",
        type=int,
        nargs="?",
        const=ENGINE_SURVEYS,
        default=0,
        metavar="N",
        help=(
            f"and N ({ENGINE_SURVEYS}) surveys of each scenario from PointCloud2 messages "
            "through the whole engine: ten seconds each"
        ),
    )
    parser.add_argument("--surveys", type=int, metavar="N", help="surveys of each kind, instead")
    parser.add_argument(
        "--workers",
        type=int,
        default=os.cpu_count() or 1,
        metavar="N",
        help="processes (default: all cores)",
    )
