"""``ladar_volume study wild``: surveys with troubles that the model does not know."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from rich.console import Console

from ladar_volume.cli.arguments.lines import Verbs


def number_of_surveys(text: str) -> int:
    """One survey or more."""
    if not text.isdecimal() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"{text} is no number of surveys")
    return int(text)


def add_wild(studies: Verbs) -> None:
    """Declare the study."""
    parser = studies.add_parser(
        "wild",
        help="surveys with holes, cuts, walls, bent ground, wrong budgets: does the result say so?",
        description="Simulates random surveys of 50 kinds of trouble through the whole engine, "
        "ten seconds each or twenty, and counts errors beyond three printed sigmas that no doubt "
        "names.",
    )
    which = parser.add_mutually_exclusive_group()
    which.add_argument(
        "--kind",
        action="append",
        default=[],
        metavar="NAME",
        help="a kind (default: all), or several joined by +",
    )
    which.add_argument(
        "--mixed",
        type=number_of_surveys,
        metavar="N",
        help="N surveys with two or three random kinds each",
    )
    parser.add_argument(
        "--seeds",
        type=number_of_surveys,
        metavar="N",
        help="surveys of each kind (default 20)",
    )
    parser.add_argument("--first", type=int, default=1, metavar="SEED", help="first seed (1)")
    parser.add_argument("--reduced", action="store_true", help="two surveys of each kind")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/wild"), help="folder")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Simulate, print, and write wild.md and a line per survey to wild.jsonl."""
    from dataclasses import asdict

    from ladar_volume.experiments.wild import (
        REDUCED,
        SEEDS,
        mixed_surveys,
        wild_surveys,
        wild_table,
    )
    from ladar_volume.io import results

    console, rows, lines = Console(), [], []
    seeds = arguments.seeds or (REDUCED if arguments.reduced else SEEDS)
    folder = results.output_folder(arguments.output)
    surveys = (
        mixed_surveys(arguments.mixed, arguments.first)
        if arguments.mixed is not None
        else wild_surveys(arguments.kind, seeds, arguments.first)
    )
    for row in surveys:
        rows.append(row)
        lines.append(json.dumps(results.finite(asdict(row))))
        results.write_text(folder / "wild.jsonl", "\n".join(lines) + "\n")
        said = row.refused or ", ".join(row.doubts) or "sound"
        console.print(
            f"{row.kind} {row.seed}: {row.error_m3:+.2f} ± {row.sigma_m3:.2f} of "
            f"{row.true_m3:.1f} m³, {said}",
            highlight=False,
        )
    table = wild_table(rows)
    results.write_text(folder / "wild.md", table)
    console.print(table, markup=False, highlight=False, soft_wrap=True)
    return 0
