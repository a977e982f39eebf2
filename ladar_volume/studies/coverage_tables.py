"""Tables of ``ladar_volume study coverage``."""

from __future__ import annotations

from typing import Any

from ladar_volume.studies.coverage import LIMITS, limits
from ladar_volume.studies.coverage_cases import ALL
from ladar_volume.studies.nist_tables import markdown

WORDS = {
    "stockpile_100": "stockpile of 100 m³", "stockpile_5000": "stockpile of 5,200 m³", "pit": "pit",
    "own ground": "above its own ground", "design level": "above a design level", "two epochs": "between two epochs",
}  # fmt: skip


def title(scenario: str, base: str) -> str:
    """Scenario and base in words."""
    return f"{WORDS.get(scenario, scenario)} {WORDS.get(base, base)}"


def mark(value: float, low: float, high: float, form: str) -> str:
    """A number as a cell, with a star outside its limits."""
    return format(value, form) + ("" if low <= value <= high else " *")


def judged(s: dict[str, Any]) -> list[str]:
    """Ratio and coverages of one row of statistics as cells."""
    low = limits(s["surveys"])
    return [
        mark(s["ratio"], *low["ratio"], ".3f"), mark(100 * s["holds_68"], *low["holds_68_pct"], ".1f"),
        mark(100 * s["holds_95"], *low["holds_95_pct"], ".1f"),
    ]  # fmt: skip


def main_table(found: dict[str, Any]) -> str:
    """All sources on: bias, spread, sigma and coverage per scenario and base."""
    rows = []
    for scenario, by_base in found.items():
        for base, parts in by_base.items():
            s = parts["variants"].get(ALL)
            if s is not None:
                rows.append([
                    title(scenario, base), f"{s['surveys']}", f"{s['true_m3']:.1f}", f"{s['bias_m3']:+.3f} ± {s['bias_sigma_m3']:.3f}",
                    f"{s['spread_m3']:.3f}", f"{s['sigma_m3']:.3f}", *judged(s), f"{s['ratio_naive']:.3f}",
                    f"{s['tau_m3'][0]:.3f} to {s['tau_m3'][1]:.3f}",
                ])  # fmt: skip
    head = [
        "", "surveys", "V / m³", "bias / m³", "empirical sigma / m³", "predicted sigma / m³", "predicted / empirical", "68 % holds / %",
        "95 % holds / %", "naive / empirical", "sigma for tau / 3 to 3 tau, m³",
    ]  # fmt: skip
    return markdown(head, rows)


def line_table(found: dict[str, Any]) -> str:
    """Each source alone: predicted over empirical sigma."""
    columns = {title(s, b): parts["lines"] for s, by_base in found.items() for b, parts in by_base.items() if parts["lines"]}
    names = list(dict.fromkeys(line for lines in columns.values() for line in lines))
    rows = []
    for name in names:
        cells = []
        for lines in columns.values():
            found_line = lines.get(name)
            if found_line is None:
                cells.append("")
                continue
            low, high = limits(int(found_line["surveys"]))["ratio"]
            cells.append(f"{mark(found_line['ratio'], low, high, '.3f')} ({found_line['empirical_m3']:.3g} m³)")
        rows.append([name.replace("_", " "), *cells])
    return markdown(["source alone", *columns], rows)


def robustness_table(found: dict[str, Any]) -> str:
    """Errors that are not those believed: predicted over empirical sigma and the coverage of the 95 % interval."""
    rows = []
    for scenario, by_base in found.items():
        for base, parts in by_base.items():
            for variant, s in parts["variants"].items():
                if variant != ALL:
                    cells = [f"{s['ratio']:.3f}", f"{100 * s['holds_68']:.1f}", f"{100 * s['holds_95']:.1f}"]
                    rows.append([title(scenario, base), variant, f"{s['surveys']}", *cells])
    return markdown(["", "true errors", "surveys", "predicted / empirical", "68 % holds / %", "95 % holds / %"], rows)


def tables(found: dict[str, Any]) -> str:
    """All tables as Markdown."""
    few, many = (LIMITS[n] for n in (0, 1000))
    words = (
        f"Limits with 2,000 surveys (1,000 per source): ratio {many['ratio'][0]} to {many['ratio'][1]}, 68 % interval holds "
        f"{many['holds_68_pct'][0]} to {many['holds_68_pct'][1]} %, 95 % interval {many['holds_95_pct'][0]} to "
        f"{many['holds_95_pct'][1]} %; "
        f"with fewer {few['ratio'][0]} to {few['ratio'][1]}, {few['holds_68_pct'][0]} to {few['holds_68_pct'][1]} %, "
        f"{few['holds_95_pct'][0]} to {few['holds_95_pct'][1]} %. A star is outside.\n"
    )
    return "\n".join([
        f"## All sources on\n\n{main_table(found)}", words, f"## Each source alone: predicted / empirical sigma\n\n{line_table(found)}",
        f"## True errors other than believed\n\n{robustness_table(found)}",
    ])  # fmt: skip
