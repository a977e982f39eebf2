"""``ladar_volume study landfill`` and what else repeats experiments on closed bodies."""

from __future__ import annotations

import argparse
from functools import partial
from typing import Any

from rich.console import Console
from rich.table import Table

from ladar_volume.cli.arguments.lines import Verbs
from ladar_volume.cli.studies.study_record import add_outputs, run_study


def add_studies(studies: Verbs) -> None:
    """Declare the studies."""
    _add_landfill(studies)
    _add_thesis(studies)


def _add_landfill(studies: Verbs) -> None:
    landfill = studies.add_parser(
        "landfill",
        help="the landfill excavation: layers of 2 m and 16 m³, six spheres, densities (Kern)",
        description="Simulates the excavation of a landfill in three layers, each scanned before "
        "and "
        "after at 0.25° with 1 cm of noise, "
        "registered by four of six reference spheres, and measures volumes and "
        "densities. Some 20 seconds per seed.",
    )
    landfill.add_argument(
        "--seeds",
        type=int,
        default=4,
        metavar="N",
        help="simulated excavations of three bodies each (default 4)",
    )
    add_outputs(landfill, "the figures")
    landfill.set_defaults(run=run_landfill)


def _add_thesis(studies: Verbs) -> None:
    thesis = studies.add_parser(
        "thesis",
        help=(
            "filter, mesh, ground and volume of a thesis's box, sphere, bench and square "
            "(its Tables 9.1 to 9.4)"
        ),
        description="Simulates the clouds of the thesis, filters and meshes them as published, "
        "with "
        "its five ways to repair, and in the "
        "package's own way, and prints volumes and times beside the published ones. Some "
        "ten seconds, and five per seed.",
    )
    thesis.add_argument(
        "--seeds",
        type=int,
        default=5,
        metavar="N",
        help="clouds of box and sphere each (default 5)",
    )
    thesis.add_argument(
        "--large",
        type=int,
        default=300_000,
        metavar="POINTS",
        help="points of the square; 2700000 as published; 0: none",
    )
    add_outputs(thesis, "the figures, 9.2 to 9.16 and volumes.png")
    thesis.set_defaults(run=run_thesis)


def run_landfill(arguments: argparse.Namespace) -> int:
    """Simulate, measure, write, print."""
    from ladar_volume.experiments.landfill import run, summary
    from ladar_volume.experiments.landfill_tables import tables, write_figures

    return run_study(
        arguments, partial(run, arguments.seeds), summary, tables, write_figures, show_landfill
    )


def show_landfill(console: Console, facts: dict[str, Any]) -> None:
    """Print errors and predicted sigma as a table."""
    table = Table(
        "", "mean error", "spread", title=f"{facts['bodies']} bodies of 16 m³", title_justify="left"
    )
    table.add_row(
        "volume, common boundary ring",
        f"{facts['bias_pct']:+.3f} %",
        f"{facts['spread_pct']:.3f} %",
    )
    table.add_row("  predicted sigma", "", f"{facts['predicted_sigma_pct']:.3f} %")
    own = "volume, each surface over its own boundary"
    table.add_row(
        own, f"{facts['published_bias_pct']:+.2f} %", f"{facts['published_spread_pct']:.2f} %"
    )
    table.add_row(
        "density", f"{facts['density_bias_pct']:+.3f} %", f"{facts['density_spread_pct']:.3f} %"
    )
    console.print(table)


def run_thesis(arguments: argparse.Namespace) -> int:
    """Simulate, measure, write, print."""
    from ladar_volume.experiments.thesis import run, summary
    from ladar_volume.experiments.thesis_figures import write_figures
    from ladar_volume.experiments.thesis_tables import tables, write_figure

    simulate = partial(run, arguments.seeds, arguments.large)
    return run_study(
        arguments,
        simulate,
        summary,
        tables,
        lambda study, folder: [
            write_figure(study, folder),
            *write_figures(folder, arguments.large),
        ],
        show_thesis,
    )


def show_thesis(console: Console, facts: dict[str, Any]) -> None:
    """Print errors of the volumes and the times of the clouds."""
    table = Table(
        "error of the volume",
        "cube",
        "sphere",
        title=f"{facts['seeds']} clouds each",
        title_justify="left",
    )
    for way in facts["box"]["error_pct"]:
        cells = (facts[body]["error_pct"][way] for body in ("box", "sphere"))
        table.add_row(way, *(f"{c['mean']:+.2f} % ± {c['spread']:.2f} %" for c in cells))
    console.print(table)
    for name, f in facts["fields"].items():
        filtering, meshing, ground = f["seconds"]
        console.print(
            f"{name}: {f['filtered']:,} of {f['raw']:,} points, {f['triangles']:,} triangles; "
            f"filter {filtering:.3g} s, mesh {meshing:.3g} s, ground {ground:.2g} s"
        )
