"""Tables of ``ladar_volume study coverage``."""

from __future__ import annotations

import math
from typing import Any

from ladar_volume.experiments.coverage.coverage import ENGINE, LIMITS, limits
from ladar_volume.experiments.coverage.coverage_cases import ALL
from ladar_volume.experiments.nist.nist_tables import markdown

#: A source below this share of the whole sigma is not judged: that the triangulation and the choice
#: of ground points change with the points, which the propagation holds fixed, is as large.
SLIGHT = 0.02
WORDS = {
    "stockpile_100": "stockpile of 100 m³",
    "stockpile_5000": "stockpile of 5,200 m³",
    "pit": "pit",
    "box": "box of 37.5 m³",
    "own ground": "above its own ground",
    "design level": "above a design level",
    "two epochs": "between two epochs",
    "closed": "as a closed body",
}


def title(scenario: str, base: str) -> str:
    """Scenario and base in words."""
    return f"{WORDS.get(scenario, scenario)} {WORDS.get(base, base)}"


def mark(value: float, low: float, high: float, form: str) -> str:
    """A number as a cell, with a star outside its limits."""
    return format(value, form) + ("" if low <= value <= high else " *")


def statistics_cells(s: dict[str, Any]) -> list[str]:
    """Ratio and coverages of one row of statistics as cells."""
    low = limits(s["surveys"])
    return [
        mark(s["ratio"], *low["ratio"], ".3f"),
        mark(100 * s["holds_68"], *low["holds_68_pct"], ".1f"),
        mark(100 * s["holds_95"], *low["holds_95_pct"], ".1f"),
    ]


def main_cells(s: dict[str, Any]) -> list[str]:
    """One row of statistics as cells."""
    return [
        f"{s['surveys']}",
        f"{s['true_m3']:.1f}",
        f"{s['bias_m3']:+.3f} ± {s['bias_sigma_m3']:.3f}",
        f"{s['spread_m3']:.3f}",
        f"{s['sigma_m3']:.3f}",
        *statistics_cells(s),
        f"{s['ratio_naive']:.3f}",
        f"{s['tau_m3'][0]:.3f} to {s['tau_m3'][1]:.3f}",
    ]


def main_table(found: dict[str, Any]) -> str:
    """All sources on: bias, spread, sigma and coverage per scenario and base."""
    rows = []
    for scenario, by_base in found.items():
        for base, parts in by_base.items():
            for variant, s in parts["variants"].items():
                if variant in (ALL, ENGINE):
                    words = ("" if variant == ALL else f", {variant}") + (
                        f" ({s['refused']} refused)" if s["refused"] else ""
                    )
                    rows.append([title(scenario, base) + words, *main_cells(s)])
    head = [
        "",
        "surveys",
        "V / m³",
        "bias / m³",
        "empirical sigma / m³",
        "predicted sigma / m³",
        "predicted / empirical",
        "68 % holds / %",
        "95 % holds / %",
        "naive / empirical",
        "sigma for tau / 3 to 3 tau, m³",
    ]
    return markdown(head, rows)


def line_cell(line: dict[str, float] | None, total_m3: float) -> str:
    """Ratio of one source alone with its own standard error, its empirical sigma, and that with
    what it does over one ground; no star for a source without weight.
    """
    if line is None:
        return ""
    low, high = (
        limits(int(line["surveys"]))["ratio"]
        if line["empirical_m3"] > SLIGHT * total_m3
        else (0.0, math.inf)
    )
    more = (
        ""
        if line["with_ground_m3"] < 1.005 * line["empirical_m3"]
        else f"; {line['with_ground_m3']:.3g}"
    )
    return (
        f"{mark(line['ratio'], low, high, '.2f')} ± {line['ratio_sigma']:.2f} "
        f"({line['empirical_m3']:.3g}{more} m³)"
    )


def line_table(found: dict[str, Any]) -> str:
    """Each source alone: predicted over empirical sigma."""
    columns = {
        title(s, b): (parts["lines"], parts["variants"].get(ALL, {}).get("sigma_m3", 0.0))
        for s, by_base in found.items()
        for b, parts in by_base.items()
        if parts["lines"]
    }
    names = list(dict.fromkeys(line for lines, _ in columns.values() for line in lines))
    rows = [
        [
            name.replace("_", " "),
            *(line_cell(lines.get(name), total) for lines, total in columns.values()),
        ]
        for name in names
    ]
    return markdown(["source alone", *columns], rows)


def robustness_table(found: dict[str, Any]) -> str:
    """Errors that are not those believed: predicted over empirical sigma and the coverage of the 95
    % interval.
    """
    rows = []
    for scenario, by_base in found.items():
        for base, parts in by_base.items():
            for variant, s in parts["variants"].items():
                if variant not in (ALL, ENGINE):
                    cells = [
                        f"{s['ratio']:.3f}",
                        f"{100 * s['holds_68']:.1f}",
                        f"{100 * s['holds_95']:.1f}",
                    ]
                    rows.append([title(scenario, base), variant, f"{s['surveys']}", *cells])
    return markdown(
        ["", "true errors", "surveys", "predicted / empirical", "68 % holds / %", "95 % holds / %"],
        rows,
    )


def tables(found: dict[str, Any]) -> str:
    """All tables as Markdown."""
    few, many = (LIMITS[n] for n in (0, 1000))
    words = (
        f"Limits with 2,000 surveys (1,000 per source): ratio {many['ratio'][0]} to "
        f"{many['ratio'][1]}, 68 % interval holds "
        f"{many['holds_68_pct'][0]} to {many['holds_68_pct'][1]} %, 95 % interval "
        f"{many['holds_95_pct'][0]} to "
        f"{many['holds_95_pct'][1]} %; "
        f"with fewer {few['ratio'][0]} to {few['ratio'][1]}, {few['holds_68_pct'][0]} to "
        f"{few['holds_68_pct'][1]} %, "
        f"{few['holds_95_pct'][0]} to {few['holds_95_pct'][1]} %. A star is outside. "
        "Sources below 2 % of the whole sigma are not judged.\n"
    )
    return "\n".join(
        [
            f"## All sources on\n\n{main_table(found)}",
            words,
            f"## Each source alone: predicted / empirical sigma\n\n{line_table(found)}",
            f"## True errors other than believed\n\n{robustness_table(found)}",
        ]
    )
