"""What a person sees of a result: the volume with its interval, the budget, and what was lost."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table

from ladar_volume.cli.verdict_lines import add_verdict_rows
from ladar_volume.model.choices import SOURCE_LINES

#: A component of less certainty than this, in units of the variance given, tells nothing.
TOLD = 10.0


def show_result(console: Console, result: Mapping[str, Any]) -> None:
    """Print a result dictionary as tables."""
    head = Table(show_header=False, box=None, pad_edge=False)
    _add_result_rows(head, result)
    gap_rows(head, result)
    object_rows(head, result)
    volume_rows(head, result)
    _add_body_rows(head, result)
    _add_place_rows(head, result)
    add_verdict_rows(head, result["verdict"])
    console.print(head)
    console.print(budget_table(result))
    if result["losses"]:
        lost = Table("not used", "count", title="Losses", title_justify="left")
        for reason, count in result["losses"].items():
            lost.add_row(reason.replace("_", " "), f"{count:,}")
        console.print(lost)


def _add_result_rows(head: Table, result: Mapping[str, Any]) -> None:
    """Volume, interval, cut and fill."""
    low, high = result["interval_m3"]
    share = (
        100.0 * result["sigma_m3"] / abs(result["volume_m3"])
        if result["volume_m3"]
        else float("inf")
    )
    head.add_row(
        "volume",
        (
            f"[bold]{result['volume_m3']:.3f} ± {result['sigma_m3']:.3f} m³[/bold] (1 sigma, "
            f"{share:.2f} %)"
        ),
    )
    head.add_row(
        f"{100 * result['confidence']:.0f} % interval",
        f"{low:.3f} to {high:.3f} m³ (k = {result['coverage_factor']:.2f})",
    )
    head.add_row(
        "cut, fill",
        f"{result['cut_m3']:.3f} m³, {result['fill_m3']:.3f} m³ over {result['area_m2']:.1f} m²",
    )
    _add_corrections(head, result)


def _add_corrections(head: Table, result: Mapping[str, Any]) -> None:
    """What was taken out of volume, cut and fill."""
    fix = result["correction"]
    if fix["name"]:
        words = (
            f"{fix['m3']:.3f} m³ taken from cut and from fill over {fix['near_area_m2']:.1f} "
            f"m² near the base ({fix['name']})"
        )
        head.add_row("corrected", words)
    v, chords, cover = (result[key] for key in ("volume_m3", "chord_m3", "cover_m3"))
    rounded = result["smoothing_m3"]
    mesh, fits = "of the mesh over hollows and under crests", "that fits of the filter round off"
    for name, m3, what, before in (
        ("chords", chords, f"{mesh}, taken out", f"{v + chords:.3f} m³ with them"),
        (
            "smoothing",
            rounded,
            f"{fits} at the toe, taken out",
            f"{v + rounded:.3f} m³ with it",
        ),
        ("plants", cover, "added for the plants' given height", f"{v - cover:.3f} m³ as seen"),
    ):
        if abs(m3) >= 5e-4:
            head.add_row(name, f"{m3:+.3f} m³ {what} ({before})")


def _add_body_rows(head: Table, result: Mapping[str, Any]) -> None:
    """The further bodies."""
    for number, body in enumerate(result["bodies"][1:], start=2):
        x, y, _ = body["centroid_map_m"]
        head.add_row(
            f"body {number}",
            f"{body['volume_m3']:.3f} ± {body['sigma_m3']:.3f} m³ at {x:.1f}, {y:.1f} m",
        )


def _add_place_rows(head: Table, result: Mapping[str, Any]) -> None:
    """Where another pass would lower the sigma."""
    places = result.get("where_more_data_helps", {}).get("places", [])
    for number, place in enumerate(places):
        words = (
            f"at {place['x_m']:.1f}, {place['y_m']:.1f} m: sigma falls by "
            f"{place['gain_m3']:.2g} m³ ({place['why']})"
        )
        head.add_row("" if number else "another pass helps", words)


def gap_rows(head: Table, result: Mapping[str, Any]) -> None:
    """How much of the area was seen, and the largest gap, as rows of a table of two columns."""
    if not result["gaps"]:
        return
    gap = result["gaps"][0]
    words = (
        f"{100 * result['seen_share']:.1f} % of the area; the largest gap, {gap['area_m2']:.3g} m² "
        f"at {gap['x_m']:.1f}, {gap['y_m']:.1f} m, is bridged"
    )
    head.add_row("seen", words)


def object_rows(head: Table, result: Mapping[str, Any]) -> None:
    """What stands in the outline and beside it and is not counted, as rows of a table of two
    columns.
    """
    for inside, name, where in (
        (True, "not counted", "on the surface"),
        (False, "beside it", "stand beside what counts"),
    ):
        own = [one for one in result["objects"] if one["inside"] == inside]
        if not own:
            continue
        one = own[0]
        words = (
            f"{sum(one['volume_m3'] for one in own):.3g} m³ {where}; the largest, "
            f"{one['size_m']:.2g} m wide, {one['high_m']:.2g} m high, at {one['x_m']:.1f}, "
            f"{one['y_m']:.1f} m"
        )
        head.add_row(name, words)


def volume_rows(head: Table, result: Mapping[str, Any]) -> None:
    """Base, largest source and the two sigmas printed beside, as rows of a table of two columns."""
    head.add_row(
        "above", f"{result['base']}{' (same survey)' if result['base_same_survey'] else ''}"
    )
    if source := result["largest_source"]:
        halved = result["sigma_if_halved_m3"][source]
        head.add_row(
            "largest source",
            f"{source.replace('_', ' ')}: half of it would make sigma {halved:.3f} m³",
        )
    if result["second_order"]["matters"]:
        sigma = (
            sum(line for name, line in result["budget_m6"].items() if "_second_order" in name)
            ** 0.5
        )
        shift = result["second_order"]["shift_m3"]
        words = (
            f"of boresight and attitude: {sigma:.2g} m³, in the budget; it moves V by "
            f"{shift:.2g} m³ on average, which is not corrected"
        )
        head.add_row("second order", words)
    tau = result["sigma_tau_range_m3"]
    head.add_row(
        "sigma if tau is off",
        f"{tau[0]:.3f} to {tau[1]:.3f} m³ (a third to three times the correlation times)",
    )
    head.add_row(
        "naive sigma", f"{result['sigma_naive_m3']:.3f} m³ (all points independent: not to be used)"
    )


def budget_table(result: Mapping[str, Any]) -> Table:
    """The budget: each source's own sigma and share, and the sigma of the volume if the source were
    halved; where the passes tell, how many times as large as given its sigma is.
    """
    total = sum(result["budget_m6"].values()) or 1.0
    title = "Where the uncertainty comes from"
    budget = Table(
        "source",
        "sigma / m³",
        "share of variance",
        "if halved / m³",
        title=title,
        title_justify="left",
    )
    told = told_by_passes(result)
    if told:
        budget.add_column("passes: times given")
    for source, variance in result["budget_m6"].items():
        if variance > 1e-4 * total:
            own, halved = max(variance, 0.0) ** 0.5, result["sigma_if_halved_m3"][source]
            budget.add_row(
                source.replace("_", " "),
                f"{own:.4f}",
                f"{100 * variance / total:.1f} %",
                f"{halved:.4f}",
                *([told.get(source, "")] if told else []),
            )
            within = result.get("budget_within_m6") or {}
            for part, marginal in within.items() if source == "calibration" else ():
                if marginal > 1e-4 * total:
                    budget.add_row(
                        f"  {part.replace('_', ' ')} alone",
                        f"{marginal**0.5:.4f}",
                        "correlated",
                        "",
                        *([told.get(part, "")] if told else []),
                    )
    return budget


def told_by_passes(result: Mapping[str, Any]) -> dict[str, str]:
    """By line of the budget: how many times as large as given its sigma is by what passes differ
    by, and whether the budget is refuted by it.
    """
    out: dict[str, str] = {}
    for group in (result.get("passes") or {}).get("sources", ()):
        factor, sigma = group["factor"], group.get("sigma")
        if sigma is None or not sigma < TOLD:
            continue
        times = math.sqrt(max(factor, 0.0))
        words = f"{times:.2g} ± {0.5 * sigma / max(times, math.sqrt(0.5 * sigma)):.1g}"
        words += ", refuted" if group["scale"] > 1.0 else ""
        out |= dict.fromkeys(SOURCE_LINES[group["name"]], words)
    return out
