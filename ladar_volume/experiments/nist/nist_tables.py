"""Tables 5.1 to 5.9 and 6.1 of seed 000, simulated beside published, as Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from ladar_volume.experiments.nist import nist_published as published
from ladar_volume.experiments.nist.nist import Study, own_numbers
from ladar_volume.experiments.nist.nist_experiments import (
    COUNTS,
    FRONT_LEVELS_CM,
    difference_at,
    error_pct,
)
from ladar_volume.experiments.nist.nist_scene import DENSITIES, TRUE_BOUND_M3, TRUE_M3
from ladar_volume.model.records import F64
from ladar_volume.volume.floors import parabola_minimum


def number(value: float, form: str = ".4f") -> str:
    """A number as text; empty for NaN."""
    return "" if np.isnan(value) else format(value, form)


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    return (
        "\n".join(["| " + " | ".join(r) + " |" for r in [head, ["---"] * len(head), *rows]]) + "\n"
    )


def with_spread(values: F64, form: str = ".4f") -> str:
    """Mean and, of more than one value, the standard deviation."""
    good = values[~np.isnan(values)]
    if len(good) == 0:
        return ""
    return format(good.mean(), form) + (
        f" ± {format(good.std(ddof=1), form)}" if len(good) > 1 else ""
    )


def table_1(study: Study) -> str:
    """Sizes after cropping."""
    rows = []
    for k, (a, b) in enumerate(DENSITIES):
        mean = study.points[:, k].mean(axis=0)
        rows.append([str(k + 1), f"{mean[1]:.0f}", f"{b}", f"{mean[0]:.0f}", f"{a}"])
    return markdown(["density", "without box", "published", "with box", "published"], rows)


def table_2(study: Study) -> str:
    """Experiment 1."""
    text = ""
    for k, (name, table) in enumerate(
        (("without", published.TABLE_5_2), ("with", published.TABLE_5_2_RMS))
    ):
        text += (
            f"\n{name} RMS adjustment: mean error over {len(study.one)} seeds, % (published)\n\n"
        )
        error = error_pct(np.array(study.one)[:, k].mean(axis=0))
        rows = []
        for i, n in enumerate(COUNTS):
            cells = [
                f"{number(e, '.2f')} ({number(float(error_pct(p)), '.2f')})"
                for e, p in zip(error[i], table[i, 1:], strict=True)
            ]
            rows.append([f"{n:,}", *(c.replace(" ()", "").replace("()", "") for c in cells)])
        text += markdown(["vertices", *(f"{b} bins" for b in published.BINS)], rows)
    return text


def table_3(study: Study) -> str:
    """Experiment 2: errors of the volume, then measures of fit."""
    return (
        "a. Error of the volume, % (published)\n\n"
        + table_3_errors(study)
        + "\nb. Measures of fit, cm (published)\n\n"
        + table_3_fits(study)
    )


def table_3_errors(study: Study) -> str:
    """Errors of the volume by density and option."""
    error = error_pct(study.two)
    rows = [
        [str(d + 1), str(published.VERTICES_5_3[d])]
        + [
            f"{with_spread(error[:, d, k], '.2f')} ({published.TABLE_5_3A[d, k]:.2f})"
            for k in range(4)
        ]
        for d in range(error.shape[1])
    ]
    rows.append(
        [
            "5",
            "all",
            f"{with_spread(error_pct(study.full), '.2f')} ({published.TABLE_5_3A_FULL})",
            "",
            "",
            "",
        ]
    )
    return markdown(["density", "vertices", *published.OPTIONS], rows)


def table_3_fits(study: Study) -> str:
    """Measures of fit by density and option, with and without the box."""
    fits = 100.0 * study.fits.mean(axis=0)
    rows = []
    for d in range(fits.shape[0]):
        for s, name in enumerate(("with", "without")):
            printed = published.TABLE_5_3B[2 * d + s].reshape(2, 4)
            rows.append(
                [
                    f"{d + 1} {name}",
                    *(
                        f"{fits[d, s, m, k]:.1f} ({printed[m, k]:.1f})"
                        for m in range(2)
                        for k in range(4)
                    ),
                ]
            )
    head = ["density, box", *(f"{m} {o}" for m in ("ASD", "RMS") for o in published.OPTIONS)]
    return markdown(head, rows)


def ranges(values: F64) -> tuple[float, float]:
    """Middle and half width of a range."""
    return float(values.max() + values.min()) / 2.0, float(values.max() - values.min()) / 2.0


def table_4(study: Study) -> str:
    """Experiment 2: volumes and their range over the options, of seed 0."""
    rows = []
    for d, volumes in enumerate(study.two[0]):
        middle, half = ranges(volumes)
        p = published.TABLE_5_4[d]
        rows.append(
            [
                str(d + 1),
                *(f"{v:.3f} ({q:.3f})" for v, q in zip(volumes, p[:4], strict=True)),
                f"{middle:.4f} ± {half:.4f}",
                f"{p[4]} ± {p[5]}",
            ]
        )
    rows.append(["5, all", f"{study.full[0]:.3f} ({published.TABLE_5_4_FULL})", "", "", "", "", ""])
    return markdown(["density", *published.OPTIONS, "middle of the range, m³", "published"], rows)


def table_5(study: Study) -> str:
    """Experiment 3, of seed 0, then all seeds."""
    rows = []
    table = published.TABLE_5_5
    for k, volumes in enumerate(study.three[0]):
        rows.append(
            [str(k + 1), *(f"{v:.3f} ({p:.3f})" for v, p in zip(volumes, table[k], strict=True))]
        )
    for name, action in (
        ("average", np.mean),
        ("standard deviation", lambda x: np.std(x, ddof=1) if len(x) > 1 else np.nan),
    ):
        rows.append(
            [
                name,
                *(
                    (
                        f"{number(float(action(study.three[0][:, k])))} "
                        f"({float(action(table[:, k])):.4f})"
                    )
                    for k in range(4)
                ),
            ]
        )
    error = error_pct(study.three).mean(axis=1)
    rows.append(
        [f"error over {len(error)} seeds, %"]
        + [
            f"{with_spread(error[:, k], '.2f')} ({float(error_pct(table[:, k].mean())):.2f})"
            for k in range(4)
        ]
    )
    return markdown(["subset", "no filter, RMS", "no filter", "filter, RMS", "filter"], rows)


def table_6(study: Study) -> str:
    """Experiment 4: the offset of two sequences of cut volumes."""
    tried = published.OFFSETS_5_6
    best = parabola_minimum(tried[:, 0], tried[:, 1] ** 2)
    text = (
        "The least sum of squares of the four printed is at 0.6 cm, that of the parabola "
        f"through three of them at {best:.2f} cm.\n\n"
    )
    values = np.array([d.offset.offset_m for seed in study.four for cloud in seed for d in cloud])
    text += markdown(
        ["", "offset, mm"],
        [
            ["published", "6"],
            [
                "simulated, the screen not moved, all clouds",
                f"{1e3 * np.nanmean(values):.2f} ± {1e3 * np.nanstd(values, ddof=1):.2f}",
            ],
        ],
    )
    return text


def table_6_sequences(study: Study) -> str:
    """Cut volumes in front of the box, seed 0 beside the printed ones, and the root of the summed
    squares of their differences by offset.
    """
    level, cuts = study.front
    printed = published.TABLE_5_6
    chosen = np.flatnonzero(np.isin(FRONT_LEVELS_CM, printed[:, 0]))
    rows = [
        [f"{p[0]:.1f}", f"{1e6 * a:.0f}", f"{p[1]:.0f}", f"{1e6 * b:.0f}", f"{p[2]:.0f}"]
        for p, a, b in zip(printed, *cuts[:, chosen], strict=True)
    ]
    head = ["level, cm", "with box, cm³", "published", "without, cm³", "published"]
    offsets = [(0.0, np.nan), (0.2, np.nan), *published.OFFSETS_5_6]
    apart = [1e6 * difference_at(level, cuts, o / 100.0) for o, _ in offsets]
    text = markdown(head, rows) + "\n"
    return text + markdown(
        ["offset, cm", "root of the summed squares, cm³", "published"],
        [
            [f"{o:.1f}", f"{d:.0f}", number(p, ".0f")]
            for (o, p), d in zip(offsets, apart, strict=True)
        ],
    )


def table_7(study: Study) -> str:
    """Experiment 4: the full set, by level, of seed 0."""
    text = ""
    for k, (name, table) in enumerate(
        (("with", published.TABLE_5_7A), ("without", published.TABLE_5_7B))
    ):
        d = study.four[0][0][1 - k]
        rows = []
        for m, pairs in enumerate((d.one, d.two)):
            for i in range(len(pairs.volume_m3)):
                rows.append(
                    [
                        str(m + 1),
                        f"{100 * pairs.level_with_m[i]:.1f}",
                        f"{1e6 * pairs.with_m3[i]:.0f}",
                        f"{1e6 * pairs.without_m3[i]:.0f}",
                        f"{pairs.volume_m3[i]:.4f}",
                        f"{float(error_pct(pairs.volume_m3[i])):.2f}",
                        number(table[m, i]),
                        number(float(error_pct(table[m, i])), ".2f"),
                    ]
                )
        text += f"\n{'ab'[k]}. {name} RMS adjustment\n\n"
        text += markdown(
            [
                "method",
                "level, cm",
                "with box, cm³",
                "without, cm³",
                "volume, m³",
                "error, %",
                "published, m³",
                "error, %",
            ],
            rows,
        )
    return text


def table_8(study: Study) -> str:
    """Experiment 4: the subsets of seed 0, first and last level of each method."""
    text = ""
    for k, (name, table) in enumerate(
        (("with", published.TABLE_5_8A), ("without", published.TABLE_5_8B))
    ):
        printed, rows = published.box_volumes(table), []
        for j, cloud in enumerate(study.four[0][1:]):
            cells = [str(j + 1)]
            for m, pairs in enumerate((cloud[1 - k].one, cloud[1 - k].two)):
                cells += [f"{pairs.volume_m3[i]:.4f} ({printed[j, m, i]:.4f})" for i in (0, -1)]
                slope = np.polyfit(published.LEVELS_5_7[m] / 100.0, printed[j, m], 1)[0]
                cells.append(f"{1e4 * pairs.slope_m2:.0f} ({1e4 * slope:.0f})")
            rows.append(cells)
        text += f"\n{'ab'[k]}. {name} RMS adjustment, m³ and cm² (published)\n\n"
        text += markdown(
            [
                "subset",
                *(
                    f"Method {m} {w}"
                    for m in (1, 2)
                    for w in ("first level", "last level", "slope")
                ),
            ],
            rows,
        )
    return text


def table_8_columns(study: Study) -> str:
    """Experiment 4: every level of every subset of seed 0, with the volumes of both surfaces."""
    rows = []
    for k, table in enumerate((published.TABLE_5_8A, published.TABLE_5_8B)):
        printed = published.box_volumes(table)
        for j, cloud in enumerate(study.four[0][1:]):
            for m, pairs in enumerate((cloud[1 - k].one, cloud[1 - k].two)):
                for i, volume in enumerate(pairs.volume_m3):
                    rows.append(
                        [
                            "ab"[k],
                            str(j + 1),
                            str(m + 1),
                            f"{100 * pairs.level_with_m[i]:.1f}",
                            f"{1e6 * pairs.with_m3[i]:.0f}",
                            f"{100 * pairs.level_without_m[i]:.1f}",
                            f"{1e6 * pairs.without_m3[i]:.0f}",
                            f"{volume:.4f} ({printed[j, m, i]:.4f})",
                            f"{float(error_pct(volume)):.2f} "
                            f"({float(error_pct(printed[j, m, i])):.2f})",
                        ]
                    )
    head = ["table", "subset", "method", "level with box, cm", "fill or cut, cm³"]
    head += ["level without, cm", "fill or cut, cm³", "volume, m³ (published)", "error, %"]
    return markdown(head, rows)


def table_9(study: Study) -> str:
    """Experiment 4: summary."""
    volumes, table = study.methods()[:, 1:], published.TABLE_5_9
    rows = [
        [str(k + 1), *(f"{v:.3f} ({p:.3f})" for v, p in zip(row, table[k], strict=True))]
        for k, row in enumerate(volumes[0])
    ]
    rows.append(
        [
            "average",
            *(f"{volumes[0][:, k].mean():.4f} ({table[:, k].mean():.4f})" for k in range(4)),
        ]
    )
    if volumes.shape[1] > 1:
        rows.append(
            [
                "standard deviation",
                *(
                    f"{volumes[0][:, k].std(ddof=1):.4f} ({table[:, k].std(ddof=1):.4f})"
                    for k in range(4)
                ),
            ]
        )
    error = error_pct(volumes).mean(axis=1)
    rows.append(
        [
            f"error over {len(error)} seeds, %",
            *(
                f"{with_spread(error[:, k], '.2f')} ({float(error_pct(table[:, k].mean())):.2f})"
                for k in range(4)
            ),
        ]
    )
    return markdown(["subset", "Method 1", "Method 2", "Method 1, RMS", "Method 2, RMS"], rows)


def table_61(study: Study) -> str:
    """Summary of all experiments, of seed 0, and the package's way over all seeds."""
    rows = [
        summary_row(name, cell, p)
        for (name, cell), p in zip(summary_cells(study).items(), published.TABLE_6_1, strict=True)
    ]
    n = own_numbers(study.own)
    mean = np.mean([o.volume_m3 for o in study.own])
    rows.append(
        [
            f"all points, scan direction, common footprint, {len(study.own)} seeds",
            "",
            "",
            f"{mean:.4f} ± {n['spread_pct'] / 100 * TRUE_M3:.4f}",
            "",
        ]
    )
    rows.append(
        [
            "true",
            "",
            "",
            f"{TRUE_M3:.4f} ± {TRUE_BOUND_M3:.4f}",
            f"{published.TRUE_M3:.4f} ± {published.TRUE_BOUND_M3}",
        ]
    )
    return markdown(["experiment", "with RMS, m³", "published", "without, m³", "published"], rows)


def summary_row(name: str, cell: Sequence[tuple[float, float]], printed: F64) -> list[str]:
    """One experiment: value and half width, or mean and spread, m³, with RMS adjustment and
    without, each beside the published ones.
    """
    line = [name]
    for k in range(2):
        line.append(f"{cell[k][0]:.4f} ± {cell[k][1]:.4f}" if k < len(cell) else "")
        line.append(
            f"{number(printed[2 * k])} ± {number(printed[2 * k + 1], '.5f')}"
            if not np.isnan(printed[2 * k])
            else ""
        )
    return line


def summary_cells(study: Study) -> dict[str, list[tuple[float, float]]]:
    """Of each experiment of seed 0 the value and half width, or mean and spread, m³, with RMS
    adjustment and without.
    """
    one = study.one[0][:, COUNTS.index(5000)]
    values = [(ranges(one[k][~np.isnan(one[k])])) for k in (1, 0)]
    names = [
        "1: density 1, 5,000 vertices, range over bins",
        *(f"2: density {d}, range over options" for d in range(1, 6)),
    ]
    names += ["3: density 1, no filter, ten subsets", "4: density 1, Method 1, ten subsets"]
    cells = [values, *([ranges(v)] for v in study.two[0])]
    for volumes, columns in ((study.three[0], (0, 1)), (study.methods()[0, 1:], (2, 0))):
        cells.append(
            [
                (
                    float(volumes[:, c].mean()),
                    float(volumes[:, c].std(ddof=1)) if len(volumes) > 1 else np.nan,
                )
                for c in columns
            ]
        )
    return dict(zip(names, cells, strict=True))


TABLES = {
    "Table 5.1: points after cropping": table_1,
    "Table 5.2: Experiment 1": table_2,
    "Table 5.3: Experiment 2": table_3,
    "Table 5.4: volumes of Experiment 2": table_4,
    "Table 5.5: Experiment 3": table_5,
    "Table 5.6: the offset": table_6,
    "Table 5.6: the sequences": table_6_sequences,
    "Table 5.7: Experiment 4, full set": table_7,
    "Table 5.8: Experiment 4, subsets": table_8,
    "Table 5.8: all levels": table_8_columns,
    "Table 5.9: Experiment 4, summary": table_9,
    "Table 6.1: summary": table_61,
}


def tables(study: Study) -> str:
    """All tables. Where a table shows single volumes they are those of seed 0."""
    return "\n".join(f"## {title}\n\n{make(study)}" for title, make in TABLES.items())
