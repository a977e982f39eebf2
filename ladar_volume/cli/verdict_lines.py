"""The verdict on the command line: rows of the table and the exit code."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

from rich.table import Table

from ladar_volume.cli.arguments.strict import DOUBTFUL
from ladar_volume.model.verdict import Doubt

#: A volume whose noise nobody knows.
NO_SIGMA = Doubt(
    "no_sigma", "the volume has no standard deviation: give --sigma, the points' noise"
)


def add_verdict_rows(table: Table, verdict: Mapping[str, Any]) -> None:
    """One row for the status, and one for each reason (``Verdict.as_dict``)."""
    sound = verdict["status"] == "sound"
    table.add_row("verdict", f"[bold {'green' if sound else 'yellow'}]{verdict['status']}[/]")
    for reason in verdict["reasons"]:
        table.add_row("", reason["text"].replace("[", r"\["))


def exit_code(arguments: argparse.Namespace, verdict: Mapping[str, Any]) -> int:
    """0, or :data:`DOUBTFUL` with ``--strict`` where there are doubts."""
    return DOUBTFUL if arguments.strict and verdict["status"] != "sound" else 0
