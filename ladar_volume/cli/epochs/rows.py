"""What a person sees of a change between two surveys."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table

from ladar_volume.cli.tables.result_table import budget_table, volume_rows
from ladar_volume.cli.verdict_lines import add_verdict_rows


def show_surveys(console: Console, facts: Mapping[str, Any]) -> None:
    """Print the comparison as tables."""
    head = Table(show_header=False, box=None, pad_edge=False)
    _add_change_rows(head, facts)
    _add_detection_rows(head, facts["level_of_detection"])
    _add_ground_rows(head, facts["stable_ground"], "the budgets allow")
    head.add_row("if nothing were shared", f"sigma {facts['sigma_if_nothing_shared_m3']:.3f} m³")
    volume_rows(head, facts)
    add_verdict_rows(head, facts["verdict"])
    console.print(head)
    console.print(budget_table(facts))


def show_clouds(console: Console, facts: Mapping[str, Any]) -> None:
    """Print the comparison of two clouds as a table."""
    head = Table(show_header=False, box=None, pad_edge=False)
    _add_change_rows(head, facts)
    _add_detection_rows(head, facts["level_of_detection"])
    _add_ground_rows(head, facts["stable_ground"], "known to")
    lines = sorted(facts["budget_m6"].items(), key=lambda item: -item[1])
    words = ", ".join(f"{n.replace('_', ' ')} {math.sqrt(v):.3g}" for n, v in lines if v > 0.0)
    head.add_row("sigma by source", f"{words} m³")
    head.add_row("not in it", f"what all points share; 1 cm is {facts['centimetre_m3']:.4g} m³")
    for name in ("previous", "new"):
        sigma = facts[name]["sigma_point_m"]
        noise = "noise not known" if sigma is None else f"sigma {1e3 * sigma:.2f} mm"
        head.add_row(name, f"{facts[name]['path']}: {facts[name]['used']:,} points, {noise}")
    head.add_row("frame", registration_words(facts))
    add_verdict_rows(head, facts["verdict"])
    console.print(head)


def registration_words(facts: Mapping[str, Any]) -> str:
    """How the new cloud was moved, and how well that is known."""
    found = facts["registration"]
    if found is None or "lift_m" not in found:
        return str(facts["frame"])
    shift = " ".join(f"{1e3 * v:.2f}" for v in found["sigma_shift_m"])
    return (
        f"{facts['frame']}: by {1e3 * found['moved_m']:.1f} mm, {1e3 * found['lift_m']:+.1f} mm "
        f"of it up; sigma of the shift {shift} mm"
    )


def _add_change_rows(head: Table, facts: Mapping[str, Any]) -> None:
    """The change with its interval, its significance, and its parts."""
    low, high = facts["interval_m3"]
    head.add_row(
        "change", f"[bold]{facts['volume_m3']:+.3f} ± {facts['sigma_m3']:.3f} m³[/bold] (1 sigma)"
    )
    head.add_row(
        f"{100 * facts['confidence']:.0f} % interval",
        f"{low:+.3f} to {high:+.3f} m³ (k = {facts['coverage_factor']:.2f})",
    )
    words = "significant" if facts["significant"] else "not significant"
    head.add_row("significance", f"{words}: z = {facts['z']:.2f}, p = {facts['p_value']:.2g}")
    head.add_row(
        "raised, lowered",
        (
            f"{facts['cut_m3']:.3f} ± {facts['sigma_cut_m3']:.3f} m³, {facts['fill_m3']:.3f} ± "
            f"{facts['sigma_fill_m3']:.3f} m³ over {facts['area_m2']:.1f} m²"
        ),
    )


def _add_detection_rows(head: Table, lod: Mapping[str, Any]) -> None:
    """The level of detection, and the volume above it alone."""
    share = 100.0 * lod["area_m2"] / lod["map_area_m2"]
    head.add_row(
        "level of detection",
        (
            f"{100.0 * lod['level_m']:.1f} cm (median), exceeded on {lod['area_m2']:.1f} m² "
            f"({share:.1f} %)"
        ),
    )
    parts = f"raised {lod['raised_m3']:.3f}, lowered {lod['lowered_m3']:.3f} m³"
    head.add_row("above it alone", f"{lod['net_m3']:+.3f} ± {lod['sigma_m3']:.3f} m³: {parts}")
    head.add_row(
        "threshold's bias",
        f"{lod['bias_m3']:+.3f} ± {lod['bias_sigma_m3']:.3f} m³ of the net volume",
    )


def _add_ground_rows(head: Table, ground: Mapping[str, Any], words: str) -> None:
    """What unchanged ground says; in words, what the offset is held against."""
    head.add_row(
        "stable ground",
        f"{100.0 * ground['share']:.0f} % of the common area, "
        f"{'named' if ground['named'] else 'found'}: {1e3 * ground['offset_m']:+.1f} mm in the "
        f"mean, {words} {1e3 * ground['sigma_m']:.1f} mm (1 sigma)",
    )
