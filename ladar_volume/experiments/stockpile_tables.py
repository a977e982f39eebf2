"""Tables and the figure of ``ladar_volume study stockpile``: seed 004 as printed, and as corrected,
side by side.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from ladar_volume.experiments.nist.nist_figures import panels
from ladar_volume.experiments.nist.nist_tables import markdown
from ladar_volume.experiments.stockpile import (
    COAL,
    HEIGHTS_M,
    INTERPOLATED,
    PRINTED,
    PRINTED_POSITION_M,
    PRINTED_TABLE_2,
    READINGS,
    SHARE,
    SOURCES,
    ToleranceRule,
    budget_of_source,
    position_sigmas,
)
from ladar_volume.georeference.error_budget import PRESETS
from ladar_volume.report.plates import save_figure

FIGURE = "precision.png"


def metres(values: object, form: str = ".4f") -> list[str]:
    """Numbers as table cells."""
    return [format(float(v), form) for v in np.atleast_1d(np.asarray(values, dtype=np.float64))]


def position_table(_: ToleranceRule) -> str:
    """Section 5.1.1: an error vector of 0.05 m split into axes."""
    rows = [
        ["printed", *metres(PRINTED_POSITION_M, ".5f")],
        ["recomputed: 0.05 / (1 + 1 + 1.5)", *metres(position_sigmas(False), ".5f")],
        ["in quadrature: 0.05 / √(1 + 1 + 1.5²)", *metres(position_sigmas(True), ".5f")],
    ]
    return markdown(["", "sigma_X / m", "sigma_Y / m", "sigma_Z / m"], rows)


def point_table(_: ToleranceRule) -> str:
    """Section 5.2: precision of one point."""
    head = ["", *(f"{axis} at {h:.0f} m" for h in HEIGHTS_M for axis in "XYZ")]
    rows = [["printed", *(c for row in PRINTED for c in metres(row))]]
    rows += [[r.title, *(c for h in HEIGHTS_M for c in metres(r.sigmas(h)))] for r in READINGS]
    return markdown(head, rows)


def source_table(_: ToleranceRule) -> str:
    """What each source alone gives in the printed geometry."""
    head = ["source alone", *(f"{axis} at {h:.0f} m" for h in HEIGHTS_M for axis in "XYZ")]
    one = READINGS[0]
    rows = [
        [
            s,
            *(
                c
                for h in HEIGHTS_M
                for c in metres(one.sigmas(h, budget_of_source(PRESETS[one.preset], s)))
            ),
        ]
        for s in SOURCES
    ]
    return markdown(head, rows)


def cone_table(pile: ToleranceRule) -> str:
    """Section 5.2 (stockpile volumes): a cone that changes by a share, equations 5 and 6."""
    cone, c = pile.cone, pile.cone.changes(pile.share)
    printed = ("0.086", "0.060") if pile == ToleranceRule() else ("", "")
    rows = [
        ["radius", "", f"{c['radius']:.4f}", f"{c['radius_exact']:.4f}"],
        ["width", printed[0], f"{c['width']:.4f}", f"{c['width_exact']:.4f}"],
        ["height", printed[1], f"{c['height']:.4f}", f"{c['height_exact']:.4f}"],
        [
            "shift of the whole surface above a fixed base",
            "",
            f"{c['common_shift']:.4f}",
            f"{c['common_shift']:.4f}",
        ],
    ]
    text = (
        f"V = π D³ tan({math.degrees(cone.repose_rad):g}°) / 24 = {cone.volume_m3:g} m³: width "
        f"D = {cone.width_m:.3f} m, height {cone.height_m:.3f} m.\n\n"
    )
    change = f"change for {100.0 * pile.share:g} %"
    return text + markdown([change, "printed / m", "first order / m", "exact / m"], rows)


def table_2(pile: ToleranceRule) -> str:
    """Table 2: obtainable against required, as printed and as corrected."""
    c, first, last = pile.cone.changes(pile.share), READINGS[0], READINGS[-1]
    rows = []
    for k, (axis, row) in enumerate(zip("XYZ", PRINTED_TABLE_2, strict=True)):
        own = [first.sigmas(h)[k] for h in HEIGHTS_M]
        between = [v * INTERPOLATED for v in own] if k == 2 else own
        right = [last.sigmas(h)[k] for h in HEIGHTS_M]
        need = f"{c['height']:.4f}" if k == 2 else "none"
        rows.append(
            [axis, *(f"{v:.3f}" for v in row), *metres(between, ".3f"), *metres(right, ".3f"), need]
        )
    head = [
        "",
        "150 m, printed",
        "200 m, printed",
        "required, printed",
        "150 m, with the interpolation formula",
        "200 m, with it",
        "150 m, corrected, one point",
        "200 m, corrected, one point",
        "required, corrected",
    ]
    return markdown(head, rows)


def rule_table(pile: ToleranceRule) -> str:
    """The rule that a point's sigma_Z be no more than the change of height, by reading."""
    rows = []
    for reading in READINGS:
        for height in HEIGHTS_M:
            sigma = float(reading.sigmas(height)[2])
            verdict = "holds" if pile.within(sigma) else "does not hold"
            smallest = f"{pile.smallest_m3(sigma):.0f}"
            rows.append([reading.title, f"{height:.0f}", f"{sigma:.4f}", verdict, smallest])
    head = ["reading", "flying height, m", "sigma_Z of one point, m"]
    limit = f"within {pile.needed_m[1]:.4f} m"
    return markdown([*head, limit, "smallest pile for which it holds, m³"], rows)


TABLES = {
    "Position of the platform (5.1.1)": position_table,
    "Precision of one point (5.2)": point_table,
    "Which source it comes from, printed geometry": source_table,
    "A cone that changes (equations 5 and 6)": cone_table,
    "Table 2": table_2,
    "The rule for one point": rule_table,
}


def tables(pile: ToleranceRule | None = None) -> str:
    """All tables as Markdown, of a pile of coal by default."""
    pile = pile or ToleranceRule()
    return "\n".join(f"## {title}\n\n{make(pile)}" for title, make in TABLES.items())


def write_figure(folder: Path) -> str:
    """sigma_Z of one point over the range, by source, and for every published budget; returns the
    file's name. Raises :class:`OutputError` where it cannot be written.
    """
    figure, axes = panels(1, 2, 5.6, 4.2)
    reach, one = np.linspace(20.0, 250.0, 47), READINGS[0]
    for source in SOURCES:
        budget = budget_of_source(PRESETS[one.preset], source)
        axes[0, 0].plot(reach, [one.sigmas(r, budget)[2] for r in reach], lw=1.2, label=source)
    axes[0, 0].plot(reach, [one.sigmas(r)[2] for r in reach], color="black", lw=1.6, label="all")
    axes[0, 0].plot(HEIGHTS_M, [p[2] for p in PRINTED], "kx", label="printed")
    for name, budget in PRESETS.items():
        axes[0, 1].plot(
            reach, [one.sigmas(r, budget)[2] for r in reach], lw=1.2, label=name.replace("_", " ")
        )
    axes[0, 1].axhline(COAL.changes(SHARE)["height"], color="black", lw=0.6)
    axes[0, 1].annotate(
        "5 % of 100 m³", (25.0, COAL.changes(SHARE)["height"]), va="bottom", fontsize=8
    )
    for ax, title in zip(
        axes[0], ("the printed survey, by source", "published budgets"), strict=True
    ):
        ax.set(
            xlabel="range / m",
            ylabel="sigma_Z of one point / m",
            title=title,
            yscale="log",
            ylim=(5e-4, 2.0),
        )
        ax.legend(fontsize=7, ncols=2)
    return save_figure(figure, folder / FIGURE)
