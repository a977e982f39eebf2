"""What comparisons of all kinds of surveys read and write alike."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ladar_volume.change.change_detection import ChangeMap
from ladar_volume.cli.diff_input import given_corners
from ladar_volume.io import results
from ladar_volume.io.meshfiles.tin_files import write_columns
from ladar_volume.model.records import F64


def plan_of(corners: list[str] | None) -> F64 | None:
    """Corners (c, 2) m in plan from the command line or a file; None without."""
    given = given_corners(corners, None)
    return None if given is None else given[:, :2]


def write_change(folder: Path, change: ChangeMap) -> None:
    """Write the map of change as a mesh with columns."""
    columns = (
        "difference_m",
        "sigma_noise_m",
        "sigma_shared_m",
        "sigma_m",
        "level_m",
        "significant",
    )
    values = {name: np.asarray(getattr(change, name), np.float32) for name in columns}
    write_columns(folder / "change.ply", change.tin, values)


def write_comparison(
    arguments: argparse.Namespace, facts: Mapping[str, Any], change: ChangeMap, folder: Path
) -> None:
    """Write epochs.json, change.ply and, where wanted, change.png."""
    results.write_text(folder / "epochs.json", results.json_text(facts))
    write_change(folder, change)
    if not arguments.no_figure:
        write_picture(arguments, facts, change, folder)


def write_picture(
    arguments: argparse.Namespace, facts: Mapping[str, Any], change: ChangeMap, folder: Path
) -> None:
    """Write change.png."""
    from ladar_volume.report.change import ChangeTotals, save  # matplotlib takes a second to load

    title = f"{arguments.new.name} against {arguments.previous.name}"
    names = ("volume_m3", "sigma_m3", "area_m2", "budget_m6")
    save(ChangeTotals(*(facts[name] for name in names)), change, title, folder / "change.png")
