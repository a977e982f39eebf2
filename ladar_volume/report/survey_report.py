"""The report of a replayed survey."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ladar_volume.model.records import Estimate
from ladar_volume.report.report_page import Report, changed_parameters, write_report
from ladar_volume.report.scene import scene_of_survey
from ladar_volume.uncertainty.epoch_budget import Epoch


def write_survey_report(
    page: Path,
    estimate: Estimate,
    epoch: Epoch,
    result: Mapping[str, Any],
    fixes: Sequence[tuple[int, int]],
) -> None:
    """The page and its JSON twin. ``result`` : as in result.json · ``fixes`` : t_ns and status of
    every fix. Raises OutputError.
    """
    given = result["input"]
    inputs = {given["path"]: given["sha256"]}
    if "poses" in given:
        inputs[given["poses"]] = given["poses_sha256"]
    tables: dict[str, list[tuple[str, ...]]] = {
        "Budget": budget_rows(result),
        "Bodies": _bodies(result),
        "Where to measure again": _reproduction_lines(result),
        "Convergence": _convergence(result),
        "Coverage": _coverage(result),
        "Returns": [(name.replace("_", " "), f"{n:,}") for name, n in result["points"].items()],
        "Not used": [(name.replace("_", " "), f"{n:,}") for name, n in result["losses"].items()],
        "Calibration": calibration_rows(result["parameters"]["calibration"]),
        "Parameters that differ from their defaults": changed_parameters(result["parameters"]),
    }
    scene = scene_of_survey(estimate, epoch, result, fixes)
    lead = lead_of(result, result["volume_m3"])
    write_report(Report(str(given["path"]), result, lead, tables, scene, inputs), page)


def lead_of(result: Mapping[str, Any], net_m3: float) -> dict[str, str]:
    """Volume, interval, cut and fill, area and base in words; what is not known is a dash."""
    low, high = result["interval_m3"]
    return {
        "Volume": f"{cubic(net_m3)} ± {cubic(result['sigma_m3'])} m³ (1 sigma)",
        f"{100 * result['confidence']:g} % interval": f"{cubic(low)} to {cubic(high)} m³",
        "Cut": f"{cubic(result['cut_m3'])} m³",
        "Fill": f"{cubic(result['fill_m3'])} m³",
        "Area": f"{result['area_m2']:,.2f} m²",
        "Base": str(result["base"]),
    }


def cubic(value: float | None) -> str:
    """A number of m³; a dash for one that is not known."""
    return f"{value:,.3f}" if value is not None and math.isfinite(value) else "–"


def budget_rows(result: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Source, sigma and share of the variance, the largest first."""
    lines = {name: max(v, 0.0) for name, v in result["budget_m6"].items() if math.isfinite(v)}
    total = sum(lines.values()) or 1.0
    order = sorted(lines.items(), key=lambda item: -item[1])
    return [
        (name.replace("_", " "), f"± {math.sqrt(v):.4f} m³", f"{100 * v / total:.1f} %")
        for name, v in order
    ]


def _bodies(result: Mapping[str, Any]) -> list[tuple[str, ...]]:
    return [
        (
            f"body {number}",
            f"{cubic(body['volume_m3'])} ± {cubic(body['sigma_m3'])} m³",
            "at {:.2f}, {:.2f} m".format(*body["centroid_map_m"][:2]),
        )
        for number, body in enumerate(result["bodies"], 1)
    ]


def _reproduction_lines(result: Mapping[str, Any]) -> list[tuple[str, ...]]:
    return [
        (
            f"{place['x_m']:.2f}, {place['y_m']:.2f} m",
            f"sigma falls by {place['gain_m3']:.2g} m³",
            str(place["why"]),
        )
        for place in result["where_more_data_helps"]["places"]
    ]


def _convergence(result: Mapping[str, Any]) -> list[tuple[str, ...]]:
    return [
        (
            f"after {100 * each['share']:.0f} % of the recording",
            f"{cubic(each['volume_m3'])} ± {cubic(each['sigma_m3'])} m³",
        )
        for each in result.get("convergence", ())
    ]


def calibration_rows(calibration: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Names and values of the mounting and the clock, as in a parameter file."""
    return [
        (
            name,
            ", ".join(f"{v:g}" for v in value) if isinstance(value, list | tuple) else f"{value:g}",
        )
        for name, value in calibration.items()
    ]


def _coverage(result: Mapping[str, Any]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = [("area seen", f"{100 * result['seen_share']:.1f} %")]
    for gap in result["gaps"]:
        where = f"not seen at {gap['x_m']:.2f}, {gap['y_m']:.2f} m"
        rows.append((where, f"{gap['area_m2']:.2f} m², ± {cubic(gap['sigma_m3'])} m³ in sigma"))
    for one in result["objects"]:
        where = f"not counted, at {one['x_m']:.2f}, {one['y_m']:.2f} m"
        rows.append((where, f"{one['high_m']:.2f} m high, {cubic(one['volume_m3'])} m³"))
    passes = result["passes"]
    if passes is not None:
        words = (
            f"{1e3 * passes['residual_m']:.1f} mm, {1e3 * passes['predicted_m']:.1f} mm expected"
        )
        rows.append(("passes differ by", words))
    return rows
