"""Piles as a person sees them: a row for each, and what other bases would make of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table

#: Most piles whose volumes above every base are printed.
MOST = 6


def plain_text(text: object) -> str:
    """Text of a file, printed as it is."""
    return str(text).replace("[", r"\[")


def value_with_sigma(value: float | None, sigma: float | None) -> str:
    """A number with its standard deviation, as far as they are known."""
    if value is None:
        return "–"
    digits = 3 if abs(value) < 10.0 else 2
    return f"{value:.{digits}f}" + ("" if sigma is None else f" ± {sigma:.{digits}f}")


def show_piles(console: Console, facts: Mapping[str, Any]) -> None:
    """Print the piles, and above every base those that have a volume."""
    rows, known = facts["piles"], [row for row in facts["piles"] if row["net_m3"] is not None]
    mass = any("mass_t" in row for row in known)
    table = Table("pile", "V / m³", *(["mass / t"] if mass else []), "area / m²", "high / m", "")
    for row in rows:
        table.add_row(*_cells(row, mass))
    console.print(table)
    if not known:
        return
    others = Table(
        "above", *(plain_text(row["name"]) for row in known[:MOST]), title="V / m³ by base"
    )
    for name in known[0]["bases"]:
        found = [row["bases"][name] for row in known[:MOST]]
        others.add_row(name, *(value_with_sigma(b["net_m3"], b["sigma_m3"]) for b in found))
    console.print(others)
    if len(known) > MOST:
        console.print(f"{len(known) - MOST} more piles by base with --json")


def _cells(row: Mapping[str, Any], mass: bool) -> list[str]:
    """One row of the table."""
    name = plain_text(row["name"] + (f", {row['material']}" if row.get("material") else ""))
    if row["net_m3"] is None:
        why = plain_text(row["verdict"]["reasons"][0]["text"])
        return [name, "–", *(["–"] if mass else []), "–", "–", f"refused: {why}"]
    tonnes = [value_with_sigma(row.get("mass_t"), row.get("sigma_mass_t"))] if mass else []
    return [
        name,
        value_with_sigma(row["net_m3"], row["sigma_m3"]),
        *tonnes,
        f"{row['area_m2']:.2f}",
        f"{row['height_m']:.2f}",
        row["verdict"]["status"],
    ]
