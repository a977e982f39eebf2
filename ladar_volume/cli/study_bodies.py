"""``ladar_volume study landfill`` and what else repeats experiments on closed bodies."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from ladar_volume.io.results import json_text, output_folder, write_text
from ladar_volume.version import version


def add_studies(studies: Any) -> None:
    """Declare the studies."""
    landfill = studies.add_parser(
        "landfill", help="the landfill excavation: layers of 2 m and 16 m³, six spheres, densities (Kern)",
        description="Simulates the excavation of a landfill in three layers, each scanned before and after at 0.25° with 1 cm of noise, "
        "registered by four of six reference spheres, and measures volumes and densities. Some 20 seconds per seed.",
    )  # fmt: skip
    landfill.add_argument("--seeds", type=int, default=4, metavar="N", help="simulated excavations of three bodies each (default 4)")
    landfill.add_argument("-o", "--output", type=Path, metavar="FOLDER", help="tables.md, study.json and the figures")
    landfill.add_argument("--json", action="store_true", help="print the numbers as JSON to standard output")
    landfill.set_defaults(run=run_landfill)


def run_landfill(arguments: argparse.Namespace) -> int:
    """Simulate, measure, write, print."""
    from ladar_volume.studies.landfill import run, summary
    from ladar_volume.studies.landfill_tables import tables, write_figures

    if arguments.output is not None:
        output_folder(arguments.output)
    console = Console(stderr=arguments.json)
    with console.status("simulating") as status:
        study = run(arguments.seeds, status.update)
        facts: dict[str, Any] = {"study": "landfill", "seeds": arguments.seeds, **summary(study), "version": version()}
        if arguments.output is not None:
            status.update("writing")
            facts["figures"] = write_figures(study, arguments.output)
            write_text(arguments.output / "tables.md", tables(study))
            write_text(arguments.output / "study.json", json_text(facts))
    if arguments.json:
        print(json_text(facts), end="")
        return 0
    table = Table("", "mean error", "spread", title=f"{facts['bodies']} bodies of 16 m³", title_justify="left")
    table.add_row("volume, common boundary ring", f"{facts['bias_pct']:+.3f} %", f"{facts['spread_pct']:.3f} %")
    table.add_row("  predicted sigma", "", f"{facts['predicted_sigma_pct']:.3f} %")
    own = "volume, each surface over its own boundary"
    table.add_row(own, f"{facts['published_bias_pct']:+.2f} %", f"{facts['published_spread_pct']:.2f} %")
    table.add_row("density", f"{facts['density_bias_pct']:+.3f} %", f"{facts['density_spread_pct']:.3f} %")
    console.print(table)
    if arguments.output is not None:
        console.print(f"written to {arguments.output}")
    return 0
