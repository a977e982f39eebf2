"""What a person sees of a volume between two scans."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from ladar_volume.cli.verdict_lines import add_verdict_rows


def show(console: Console, facts: Mapping[str, Any]) -> None:
    """Print the facts as short tables."""
    table = Table(show_header=False, box=None, pad_edge=False)
    _add_volume_rows(table, facts)
    if "surfaces" in facts:
        surface_rows(table, facts)
    if "density" in facts:
        _add_density_row(table, facts["density"])
    add_verdict_rows(table, facts["verdict"])
    console.print(table)
    budget(console, facts)
    if "resolution" in facts:
        resolution(console, facts["resolution"])
    for line in facts["size_rule"]:
        console.print(line)


def _add_volume_rows(table: Table, facts: Mapping[str, Any]) -> None:
    """The volume with its interval, and how it was found."""
    known = bool(np.isfinite(facts["sigma_m3"]))
    volume, sigma = facts["volume_m3"], facts["sigma_m3"]
    share = f", {100 * sigma / abs(volume):.2f} %" if known and volume else ""
    table.add_row(
        "taken away",
        f"[bold]{volume:.4f}"
        + (f" ± {sigma:.4f} m³[/bold] (1 sigma{share})" if known else " m³[/bold]"),
    )
    if known:
        low, high = facts["interval_m3"]
        table.add_row("95 % interval", f"{low:.4f} to {high:.4f} m³ (k = 1.96)")
    table.add_row("method", facts["method"])
    table.add_row(
        "any pole", f"{facts['pole_spread_m3']:.1e} m³ is the largest change over nine other poles"
    )
    table.add_row(
        "closed", f"{facts['closed_m3']:.4f} m³ depend on what no scan saw; the body is watertight"
    )
    for each in facts.get("bodies", []):
        table.add_row(each["path"], f"{each['volume_m3']:.4f} m³, {each['parts']} parts")


def _add_density_row(table: Table, rho: Mapping[str, Any]) -> None:
    """The density of what was taken away."""
    low, high = rho["interval_kg_m3"]
    shares = rho["variance_shares"]
    table.add_row(
        "density",
        f"{rho['density_kg_m3']:.1f} ± {rho['sigma_kg_m3']:.1f} kg/m³, 95 % {low:.1f} "
        f"to {high:.1f} kg/m³; "
        f"{100 * shares['volume']:.0f} % of the variance from the volume",
    )


def surface_rows(table: Table, facts: Mapping[str, Any]) -> None:
    """Rows of two open surfaces."""
    ring = facts["ring"]
    if "published_m3" in facts:
        off = facts["published_m3"] - facts["volume_m3"]
        share = f" ({100 * off / facts['volume_m3']:+.2f} %)" if facts["volume_m3"] else ""
        table.add_row(
            "published way",
            f"{facts['published_m3']:.4f} m³{share}: each surface over its own boundary",
        )
    table.add_row(
        "boundary ring",
        f"{ring['points']} points; from A to B {1e3 * ring['mean_gap_m']:.1f} mm in the mean, "
        f"{1e3 * ring['rms_gap_m']:.1f} mm RMS, {1e3 * ring['largest_gap_m']:.1f} mm at most",
    )
    words = "" if ring["correction"] == "none" else f"; taken out ({ring['correction']})"
    table.add_row(
        "registration by it",
        f"{1e3 * ring['offset_m']:+.1f} ± {1e3 * ring['offset_sigma_m']:.1f} mm, tilt "
        f"{1e3 * ring['tilt_rad']:.2f} mrad: {ring['effect_m3']:+.4f} ± "
        f"{ring['effect_sigma_m3']:.4f} m³{words}",
    )
    for each in facts["surfaces"]:
        spread = f"sigma {1e3 * each['sigma_m']:.2f} mm, {each['sigma_from']}"
        table.add_row(
            each["path"],
            f"{each['in_region']:,} of {each['points']:,} points in the region; {spread}"
            + (f"; {each['isolated']:,} that stood alone left out" if each["isolated"] else ""),
        )
    if "icp" in facts:
        icp = facts["icp"]
        shift = " ".join(f"{1e3 * v:.2f}" for v in icp["sigma_shift_m"])
        table.add_row(
            "refined",
            f"{icp['pairs']:,} pairs, {1e3 * icp['sigma_m']:.1f} mm; shift known to {shift} mm",
        )


def budget(console: Console, facts: Mapping[str, Any]) -> None:
    """Where the uncertainty comes from, and each class of error as a share of this volume."""
    total = sum(facts["budget_m6"].values())
    if np.isfinite(total) and total > 0.0:
        rows = Table("source", "sigma / m³", "share of variance", title_justify="left")
        for source, variance in facts["budget_m6"].items():
            rows.add_row(
                source.replace("_", " "), f"{variance**0.5:.5f}", f"{100 * variance / total:.1f} %"
            )
        console.print(rows)
    if facts.get("size_classes"):
        words = ", ".join(
            f"{name} {100 * share:.3g} %"
            for name, share in facts["size_classes"].items()
            if share > 0.0
        )
        console.print(
            f"this body (S / V = {facts['area_m2'] / abs(facts['volume_m3']):.2f} per m): {words}"
        )


def resolution(console: Console, series: Mapping[str, Any]) -> None:
    """Volume and surface by cell."""
    table = Table("cell / m", "points", "volume / m³", "surface of B / m²")
    for row in zip(
        series["cell_m"], series["points"], series["volume_m3"], series["area_m2"], strict=True
    ):
        table.add_row(f"{row[0]:g}", f"{row[1]:,}", f"{row[2]:.4f}", f"{row[3]:.3f}")
    console.print(table)
    change = series["volume_change_m3"]
    console.print(
        f"dimension of the surface {series['dimension']:.3f}; the volume changes by "
        f"{change:.4f} m³ over the series"
    )
