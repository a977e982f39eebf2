"""``ladar_volume filter``: the robust moving least squares filter on a point cloud file."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.table import Table

from ladar_volume.cli.inputs.filter_settings import order_of, settings
from ladar_volume.cli.inputs.reading import (
    add_reading_rows,
    carried_columns,
    cloud_facts_of,
    left_out_words,
    read_source,
    reading_doubts,
)
from ladar_volume.cli.verdict_lines import add_verdict_rows, exit_code
from ladar_volume.clouds.filter.filter_result import FLAGS
from ladar_volume.clouds.filter_cloud import REASONS, CloudResult, filter_cloud
from ladar_volume.io.pointfiles.cloud_files import check_output, write_cloud
from ladar_volume.io.pointfiles.point_file import NORMALS, PointFile
from ladar_volume.io.results import json_text
from ladar_volume.model.errors import FilterError, OutputError
from ladar_volume.model.parameter import write_section
from ladar_volume.model.records import F64, I64
from ladar_volume.model.verdict import Verdict
from ladar_volume.version import version


def run(arguments: argparse.Namespace) -> int:
    """Read, filter, write, print."""
    settings(arguments)  # refused before anything is read
    _check_outputs(arguments)
    console = Console(stderr=arguments.json)
    with console.status(f"reading {arguments.cloud.name}") as status:
        cloud = read_source(arguments.cloud, arguments).cloud
        status.update(f"filtering {len(cloud.r):,} points")
        result, facts = filter_with_options(arguments, cloud)
        status.update("writing")
        lost = _write(arguments, cloud, result)
    output = {"path": arguments.output.name, "points": len(result.index)}
    facts |= {"output": output, "columns_lost": lost}
    if arguments.json:
        print(json_text(facts), end="")
    else:
        show(console, facts, set(REASONS))
    return exit_code(arguments, facts["verdict"])


def filter_with_options(
    arguments: argparse.Namespace, cloud: PointFile
) -> tuple[CloudResult, dict[str, Any]]:
    """A cloud filtered as the options say, and what the JSON says of it."""
    parameters, auto = settings(arguments)
    result = filter_cloud(cloud.r, parameters, auto, frozenset(arguments.keep))
    return result, {
        "input": {"path": arguments.cloud.name, "points": len(cloud.r)},
        "output": None,
        "columns_lost": [],
        "reading": cloud_facts_of(cloud),
        "outliers": _outliers(arguments.cloud, cloud, result),
        **_facts(result, len(cloud.r), auto),
        "parameters": {"order": order_of(parameters), **write_section(parameters)},
        "verdict": (Verdict(reading_doubts([cloud])) + result.verdict).as_dict(),
    }


def _outliers(source: Path, cloud: PointFile, result: CloudResult) -> dict[str, int]:
    """How many points were taken out, by reason; refused where none is left."""
    counts = np.bincount(result.reason, minlength=len(REASONS))
    outliers = {name: int(count) for name, count in zip(REASONS, counts, strict=True) if count}
    if not len(result.index):
        why = ", ".join(f"{name} {count}" for name, count in outliers.items())
        raise FilterError(
            f"{source}: no point is left of {len(cloud.r)} ({why}){left_out_words(cloud)}",
            reason="filter_nothing_left",
            value=outliers,
        )
    return outliers


def _write(arguments: argparse.Namespace, cloud: PointFile, result: CloudResult) -> list[str]:
    """Write what is kept, and what was taken out where asked; the columns that were lost."""
    index = cloud.rows[result.index]
    flag = np.zeros(len(index), np.int64) if result.flag is None else result.flag
    columns = {"normal": result.normal, "sigma": result.sigma, "index": index, "flag": flag}
    if result.count is not None:
        columns["count"] = result.count
    lost = write_points(arguments.output, cloud, result.index, result.r, columns)
    if arguments.outliers is not None:
        taken = {"index": cloud.rows[result.outliers], "reason": result.reason}
        write_points(arguments.outliers, cloud, result.outliers, cloud.r[result.outliers], taken)
    return lost


def write_points(
    path: Path, cloud: PointFile, index: I64, r: F64, columns: dict[str, npt.NDArray[Any]]
) -> list[str]:
    """Write points (k, 3) that come of the points ``index`` of a cloud, with its attributes; the
    names of those that the file cannot hold.
    """
    kept, lost = carried_columns(cloud, path, [*columns, *NORMALS[0], *NORMALS[1], *NORMALS[2]])
    words = {"reason": REASONS, "flag": FLAGS}
    names = {name: words[name] for name in words if name in columns}
    write_cloud(
        path,
        r,
        {**{name: c[index] for name, c in kept.items()}, **columns},
        names or None,
        template=cloud,
    )
    return lost


def _facts(result: CloudResult, points: int, auto: bool) -> dict[str, Any]:
    return {
        "reduction": 1.0 - len(result.index) / points,
        "sigma_median_m": float(np.median(result.sigma)),
        "auto": auto,
        "report": dict(result.report),
        "version": version(),
    }


def _check_outputs(arguments: argparse.Namespace) -> None:
    paths = [arguments.cloud] + [
        check_output(p) for p in (arguments.output, arguments.outliers) if p is not None
    ]
    if len({p.resolve() for p in paths}) < len(paths):
        raise OutputError(
            "the cloud, the output and the outliers must be different files",
            value=[str(p) for p in paths],
        )


def show(console: Console, facts: Mapping[str, Any], reasons: set[str]) -> None:
    """Print the facts as a short table."""
    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_row("points in", f"{facts['input']['points']:,}")
    add_reading_rows(table, facts["reading"])
    table.add_row(
        "points out",
        f"[bold]{facts['output']['points']:,}[/bold] ({100 * facts['reduction']:.1f} % fewer)",
    )
    for reason, count in facts["outliers"].items():
        table.add_row(
            f"  {reason.replace('_', ' ')}",
            f"{count:,} ({100 * count / facts['input']['points']:.2f} %)",
        )
    table.add_row("sigma along the normal", f"{1e3 * facts['sigma_median_m']:.2f} mm (median)")
    for name, value in facts["report"].items():
        if name not in reasons | {"points", "kept"}:  # said above
            table.add_row(*_line(name, value, facts["auto"]))
    if facts["columns_lost"]:
        table.add_row("columns not kept", ", ".join(facts["columns_lost"]))
    add_verdict_rows(table, facts["verdict"])
    console.print(table)
    console.print(f"written to {facts['output']['path']}")


def _line(name: str, value: float | str, auto: bool) -> tuple[str, str]:
    estimated = " (estimated)" if auto and name in ("radius_m", "degree", "threshold_m") else ""
    if isinstance(value, int | float) and name.endswith("_m"):
        text = f"{value:.3f} m" if abs(value) >= 0.1 else f"{1e3 * value:.2f} mm"
        return name.removesuffix("_m").replace("_", " "), text + estimated
    return name.replace("_", " "), (
        f"{value:,}"
        if isinstance(value, int)
        else f"{value:.4g}"
        if isinstance(value, float)
        else str(value)
    ) + estimated
