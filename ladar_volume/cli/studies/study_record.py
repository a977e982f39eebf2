"""What all studies share: their outputs, and the way from the simulation to tables, figures, JSON
and the screen.
"""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from rich.console import Console

from ladar_volume.version import version

S = TypeVar("S")


def add_outputs(study: argparse.ArgumentParser, pictures: str) -> None:
    """Declare where the results go; ``pictures`` names the figures."""
    study.add_argument(
        "-o", "--output", type=Path, metavar="FOLDER", help=f"tables.md, study.json and {pictures}"
    )
    study.add_argument(
        "--json", action="store_true", help="print the numbers as JSON to standard output"
    )


def run_study(
    arguments: argparse.Namespace,
    simulate: Callable[[Callable[[str], None]], S],
    summary: Callable[[S], dict[str, Any]],
    tables: Callable[[S], str],
    figures: Callable[[S, Path], list[str]],
    show: Callable[[Console, dict[str, Any]], None],
) -> int:
    """Simulate, measure, write where an output folder is given, print as JSON or by ``show``;
    returns the exit code.
    """
    from ladar_volume.io.output_set import output_set
    from ladar_volume.io.results import json_text, write_text

    console = Console(stderr=arguments.json)
    with contextlib.ExitStack() as outputs, console.status("simulating") as status:
        folder = None
        if arguments.output is not None:
            folder = outputs.enter_context(
                output_set(arguments.output, ("study.json", "tables.md"))
            )
        study = simulate(status.update)
        facts = study_facts(arguments, summary(study))
        if folder is not None:
            status.update("writing")
            facts["figures"] = figures(study, folder)
            write_text(folder / "tables.md", tables(study))
            write_text(folder / "study.json", json_text(facts))
    if arguments.json:
        print(json_text(facts), end="")
        return 0
    show(console, facts)
    if arguments.output is not None:
        console.print(f"written to {arguments.output}")
    return 0


def study_facts(arguments: argparse.Namespace, found: dict[str, Any]) -> dict[str, Any]:
    """What a study found, with what was asked for."""
    given = {"seeds": arguments.seeds} if hasattr(arguments, "seeds") else {}
    return {"study": arguments.study, **given, **found, "version": version()}
