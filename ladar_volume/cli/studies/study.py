"""``ladar_volume study``: published experiments repeated on simulated data."""

from __future__ import annotations

import argparse
import math
from functools import partial
from typing import Any

from rich.console import Console
from rich.table import Table

from ladar_volume.cli.arguments.lines import Verbs
from ladar_volume.cli.help.summaries import SUMMARIES
from ladar_volume.cli.studies.study_bodies import add_studies
from ladar_volume.cli.studies.study_coverage import add_coverage
from ladar_volume.cli.studies.study_record import add_outputs, run_study
from ladar_volume.cli.studies.study_wild import add_wild


def add_parser(subparsers: Verbs) -> None:
    """Declare the verb and its studies."""
    parser = subparsers.add_parser("study", help=SUMMARIES["study"])
    studies = parser.add_subparsers(dest="study", required=True, metavar="STUDY")
    nist = studies.add_parser(
        "nist",
        help="the plywood box in the corner of two screens (TINvolume, Experiments 1 to 4)",
        description="Simulates the box experiment of Witzgall and Cheok, runs Experiments 1 to 4 "
        "as "
        "published and the package's own way, "
        "and writes every table and figure beside the published values. About ten "
        "seconds per seed, and ten more for Experiment 1 "
        "on each of the first eight.",
    )
    nist.add_argument(
        "--seeds", type=int, default=24, metavar="N", help="simulated pairs of scans (default 24)"
    )
    add_outputs(nist, "the figures")
    nist.set_defaults(run=run_nist)
    stockpile = studies.add_parser(
        "stockpile",
        help="precision of a surveyed point and a coal stockpile of 100 m³ (its Table 2)",
        description="Recomputes the precision of an airborne LiDAR point and what a stockpile of "
        "100 "
        "m³ asks for, published and "
        "corrected, side by side.",
    )
    for option, default, metavar, words in (
        ("--volume", 100.0, "M3", "of the pile (default 100)"),
        ("--repose", 35.0, "DEG", "its angle of repose (default 35, coal)"),
        ("--share", 0.05, "SHARE", "of the volume that is tolerated (default 0.05)"),
    ):
        stockpile.add_argument(option, type=float, default=default, metavar=metavar, help=words)
    add_outputs(stockpile, "precision.png")
    stockpile.set_defaults(run=run_stockpile)
    add_studies(studies)
    add_coverage(studies)
    add_wild(studies)


def run_nist(arguments: argparse.Namespace) -> int:
    """Simulate, measure, write, print."""
    from ladar_volume.experiments.nist.nist import run, summary
    from ladar_volume.experiments.nist.nist_figures import write_figures
    from ladar_volume.experiments.nist.nist_tables import tables

    return run_study(
        arguments, partial(run, arguments.seeds), summary, tables, write_figures, show_nist
    )


def run_stockpile(arguments: argparse.Namespace) -> int:
    """Compute, write, print."""
    from ladar_volume.experiments.stockpile import Cone, ToleranceRule, summary
    from ladar_volume.experiments.stockpile_tables import TABLES, tables, write_figure

    cone = Cone(arguments.volume, math.radians(arguments.repose))
    pile = ToleranceRule(cone, arguments.share)

    def show(console: Console, _: dict[str, Any]) -> None:
        for title, make in TABLES.items():
            console.print(f"\n[bold]{title}[/bold]\n")
            console.print(make(pile), end="", markup=False, highlight=False, soft_wrap=True)

    # nothing is simulated: all of it is computed from the printed figures
    return run_study(
        arguments,
        lambda _: None,
        lambda _: summary(pile),
        lambda _: tables(pile),
        lambda _, folder: [write_figure(folder)],
        show,
    )


def show_nist(console: Console, facts: dict[str, Any]) -> None:
    """Print the errors of every procedure as a table."""
    own = facts["own"]
    table = Table(
        "procedure",
        "mean error",
        "spread",
        title=f"Box of 1.6990 m³, {facts['seeds']} seeds",
        title_justify="left",
    )
    names = ("no filter, RMS", "no filter", "filter, RMS", "filter")
    table.add_row(
        "all points, scan direction, common footprint",
        f"{own['bias_pct']:.3f} %",
        f"{own['spread_pct']:.3f} %",
    )
    table.add_row("  predicted sigma", "", f"{own['predicted_sigma_pct']:.3f} %")
    for k, name in enumerate(names):
        table.add_row(f"Experiment 3, {name}", f"{facts['experiment_3_pct']['mean'][k]:.2f} %", "")
    for k, name in enumerate(("Method 1", "Method 2", "Method 1, RMS", "Method 2, RMS")):
        table.add_row(f"Experiment 4, {name}", f"{facts['experiment_4_pct']['mean'][k]:.2f} %", "")
    console.print(table)
