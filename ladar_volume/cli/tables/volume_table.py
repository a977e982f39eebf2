"""What a person sees of cut and fill."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from ladar_volume.cli.inputs.mesh_source import mesh_words
from ladar_volume.cli.inputs.reading import add_reading_rows
from ladar_volume.cli.surface_options import add_surface_rows
from ladar_volume.cli.tables.pile_table import show_piles
from ladar_volume.cli.tables.result_table import object_rows
from ladar_volume.cli.verdict_lines import add_verdict_rows

#: Most bodies whose place is printed.
MOST_PLACES = 5


def show(console: Console, facts: Mapping[str, Any]) -> None:
    """Print the facts as short tables."""
    table = Table(show_header=False, box=None, pad_edge=False)
    _add_volume_rows(table, facts)
    _add_place_rows(table, facts)
    _add_base_rows(table, facts)
    for each in facts["surfaces"]:
        _add_source_rows(table, each)
    _add_stray_rows(table, facts["clean"])
    object_rows(table, facts)
    add_verdict_rows(table, facts["verdict"])
    console.print(table)
    if "piles" in facts:
        show_piles(console, facts)
    for each in facts.get("sequences", []):
        show_levels(console, each)
    if "pairs" in facts:
        show_pairs(console, facts["pairs"])
    if "offset" in facts and facts["offset"]["offset_m"] is not None:
        console.print(f"offset of the sequences {1e3 * facts['offset']['offset_m']:.2f} mm")


def _add_volume_rows(table: Table, facts: Mapping[str, Any]) -> None:
    """Net volume, interval, cut, fill, and what the sigma does not hold."""
    k, (low, high) = facts["coverage_factor"], facts["interval_m3"]
    known = bool(np.isfinite(facts["sigma_m3"]))
    shared = facts.get("shared_errors")
    flown = facts.get("trajectory")
    what = "noise and shared errors" if shared or flown else "noise only"
    if flown:
        what = "noise, calibration, navigation" + (", shared errors" if shared else "")
    spread = f" ± {facts['sigma_m3']:.4f} m³[/bold] (1 sigma, {what})" if known else " m³[/bold]"
    table.add_row("net volume", f"[bold]{facts['net_m3']:.4f}{spread}")
    if known:
        table.add_row(
            f"{100 * facts['confidence']:.0f} % interval",
            f"{low:.4f} to {high:.4f} m³ (k = {k:.2f})",
        )
    for name in ("cut", "fill"):
        table.add_row(
            name,
            f"{facts[f'{name}_m3']:.4f}"
            + (f" ± {facts[f'sigma_{name}_m3']:.4f} m³" if known else " m³"),
        )
    if "mass_t" in facts:
        words = f"{facts['mass_t']:.2f} ± {facts['sigma_mass_t']:.2f} t"
        table.add_row("mass", f"{words} (sigma of {facts['sigma_mass_holds']})")
    beyond = "what all points share" if not shared else f"beyond {', '.join(shared)}"
    if flown:
        _add_flight_rows(table, facts)
        return
    table.add_row("not in it", f"{beyond}; 1 cm of height is {facts['centimetre_m3']:.4g} m³")


def _add_flight_rows(table: Table, facts: Mapping[str, Any]) -> None:
    """The trajectory, and the largest errors of the budget."""
    flown, lines = facts["trajectory"], facts["budget_m6"]
    low, _, high = flown["range_m"]
    table.add_row(
        "trajectory",
        f"{flown['path']}: {flown['poses']:,} poses, ranges {low:.1f} to {high:.1f} m, times as "
        f"{flown['clock']}, attitude {flown['attitude']}, sigma of positions from the "
        f"{flown['position_sigma'].removeprefix('from the ')}",
    )
    first = sorted(lines.items(), key=lambda item: -item[1])[:4]
    words = ", ".join(f"{n.replace('_', ' ')} {np.sqrt(max(v, 0.0)):.4f}" for n, v in first)
    table.add_row("budget", f"{words} m³; 1 cm of height is {facts['centimetre_m3']:.4g} m³")


def _add_place_rows(table: Table, facts: Mapping[str, Any]) -> None:
    """The area, and where its largest parts are."""
    table.add_row("area", f"{facts['area_m2']:.3f} m²")
    for part in facts["outline_parts"][:MOST_PLACES]:
        x0, y0, x1, y1 = part["extent_m"]
        table.add_row(
            "  at",
            f"{part['x_m']:.2f} {part['y_m']:.2f}, {x1 - x0:.4g} m by {y1 - y0:.4g} m, heights "
            f"{part['bottom_m']:.3f} to {part['top_m']:.3f} m",
        )


def _add_base_rows(table: Table, facts: Mapping[str, Any]) -> None:
    """The base, and the correction near it."""
    fix = facts["correction"]
    table.add_row("above", facts["base"] + (" (same survey)" if facts["base_same_survey"] else ""))
    if fix["name"]:
        words = (
            f"{fix['m3']:.4f} m³ taken from cut and from fill over {fix['near_area_m2']:.2f} "
            "m² near the base"
        )
        table.add_row("corrected", f"{words} ({fix['name']})")
    if facts["cover_m3"]:
        table.add_row("plants", f"{facts['cover_m3']:+.4f} m³ added for their given height")


def _add_source_rows(table: Table, each: Mapping[str, Any]) -> None:
    """One surface: its points and vertices, its noise, and how it was read."""
    sigma = "" if each["sigma_point_m"] is None else f"{1e3 * each['sigma_point_m']:.2f} mm, "
    table.add_row(
        each["path"],
        (
            f"{each['used']:,} points, {each['vertices']:,} vertices; sigma "
            f"{sigma}{each['sigma_from']}"
        ),
    )
    mesh = each["mesh"]
    if mesh is not None:
        table.add_row("", mesh_words(mesh))
    if mesh is None or mesh["unit"] is None:  # most meshes do not say their unit
        add_reading_rows(table, each)
    if mesh is None:
        add_surface_rows(table, each)


def _add_stray_rows(table: Table, clean: Mapping[str, Any]) -> None:
    """What the points that were left out change."""
    if clean["effect_m3"] is not None:
        table.add_row(
            "without strays",
            f"{clean['effect_m3']:+.4f} m³ against all points, above the same base",
        )


def show_pairs(console: Console, pairs: Mapping[str, Any]) -> None:
    """Print the volumes by pairs of levels, and how they depend on the level."""
    part = pairs["part"]
    table = Table("level with / m", "without / m", f"{part} with / m³", "without / m³", "body / m³")
    names = ("level_with_m", "level_without_m", "with_m3", "without_m3", "volume_m3")
    for row in zip(*(pairs[name] for name in names), strict=True):
        table.add_row(*(f"{value:.4f}" for value in row))
    console.print(table)
    if pairs["slope_m2"] is not None:
        console.print(
            f"Method {pairs['method']}: the volume changes by {0.01 * pairs['slope_m2']:.4g} m³ "
            "per centimetre of level"
        )


def show_levels(console: Console, each: Mapping[str, Any], most: int = 20) -> None:
    """Print at most ``most`` levels, evenly spread, and the events."""
    table = Table("level / m", "cut / m³", "fill / m³", "area above / m²")
    count = len(each["level_m"])
    for i in np.unique(np.linspace(0, count - 1, min(count, most)).astype(int)).tolist():
        table.add_row(
            *(f"{each[name][i]:.4f}" for name in ("level_m", "cut_m3", "fill_m3", "above_m2"))
        )
    console.print(table)
    for event in each["events"]:
        sigma = event["sigma_m"]
        spread = f" ± {1e3 * sigma:.2f} mm" if np.isfinite(sigma) else ""
        console.print(f"flat part at {event['level_m']:.4f} m{spread}, {event['area_m2']:.3f} m²")
