"""The landfill study as Markdown and figures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ladar_volume.change.density import size_rule
from ladar_volume.experiments.landfill import Study, registered_scans, size_shares, summary
from ladar_volume.experiments.landfill_scene import LAYER_M, make_layer
from ladar_volume.experiments.nist.nist_figures import panels
from ladar_volume.experiments.nist.nist_tables import markdown, with_spread
from ladar_volume.report.plates import save_figure


def volumes(study: Study) -> str:
    """Volumes by body."""
    rows = []
    for k in range(len(study.bodies[0])):
        b = [row[k] for row in study.bodies]
        printed = "16 (body #2)" if k == 1 else "not printed"
        predicted_pct = np.array([100 * x.excavation.sigma_m3 / x.true_m3 for x in b])
        rows.append(
            [
                str(k + 1),
                f"{np.mean([x.true_m3 for x in b]):.3f}",
                printed,
                f"{np.mean([x.excavation.removed_m3 for x in b]):.3f}",
                with_spread(np.array([x.error_pct for x in b]), ".3f"),
                f"{np.sqrt(np.mean(predicted_pct**2)):.3f}",
                with_spread(
                    np.array([100 * (x.excavation.published_m3 / x.true_m3 - 1) for x in b]), ".2f"
                ),
            ]
        )
    head = [
        "body",
        "true, mean, m³",
        "printed, m³",
        "measured, mean, m³",
        "error, %",
        "predicted sigma, %",
        "own boundaries, error, %",
    ]
    return markdown(head, rows)


def densities(study: Study) -> str:
    """Densities by body."""
    rows = []
    for k in range(len(study.bodies[0])):
        b = [row[k] for row in study.bodies]
        rho = np.array([x.rho.density_kg_m3 for x in b])
        sigma = float(np.sqrt(np.mean([x.rho.sigma_kg_m3**2 for x in b])))
        share = float(np.mean([x.rho.variance_shares[1] for x in b]))
        rows.append(
            [
                str(k + 1),
                f"{b[0].true_kg_m3:.0f}",
                with_spread(rho, ".1f"),
                f"{sigma:.1f}",
                f"{100 * share:.0f} %",
                "not printed",
            ]
        )
    return markdown(
        [
            "body",
            "true, kg/m³",
            "measured",
            "predicted sigma",
            "variance from the volume",
            "published",
        ],
        rows,
    )


def budget(study: Study) -> str:
    """Where the uncertainty of the volume comes from."""
    every = [b.excavation for row in study.bodies for b in row]
    total = sum(b.sigma_m3**2 for b in every)
    rows = []
    for name in every[0].budget_m6:
        part = sum(b.budget_m6[name] for b in every)
        rows.append(
            [
                name.replace("_", " "),
                f"{1e3 * np.sqrt(part / len(every)):.2f}",
                f"{100 * part / total:.1f} %",
            ]
        )
    return markdown(["source", "sigma, dm³", "share of the variance"], rows)


def sizes(study: Study) -> str:
    """Each class of error with 1 cm, for the second body, and the published rule."""
    rows = [
        [name, f"{100 * share:.3f}"]
        for name, share in size_shares(study.bodies[0][1]).items()
        if share > 0.0
    ]
    return (
        markdown(["1 cm as", "share of the volume, %"], rows)
        + "\n"
        + "".join(f"- {line}\n" for line in size_rule())
    )


def resolutions(study: Study) -> str:
    """Volume and surface over the series of cells."""
    s, truth = study.resolution, study.bodies[0][1].true_m3
    rows = [
        [f"{100 * c:g}", f"{n:,}", f"{v:.3f}", f"{100 * (v / truth - 1):+.3f}", f"{a:.2f}"]
        for c, n, v, a in zip(s.cell_m, s.points, s.volume_m3, s.area_m2, strict=True)
    ]
    text = markdown(["cell, cm", "points of B", "volume, m³", "error, %", "surface of B, m²"], rows)
    return text + f"\nDimension of the surface, from the slope over all cells: {s.dimension:.3f}.\n"


TABLES: dict[str, Callable[[Study], str]] = {
    "Volumes": volumes,
    "Densities": densities,
    "Budget of the volume": budget,
    "How much 1 cm is": sizes,
    "Volume and surface against resolution (body 2, seed 0)": resolutions,
}


def tables(study: Study) -> str:
    """All tables as one Markdown page."""
    facts = summary(study)
    head = (
        f"# The landfill excavation, {len(study.bodies)} seeds\n\nError of the volume "
        f"{facts['bias_pct']:+.3f} %, spread "
        f"{facts['spread_pct']:.3f} %, predicted sigma {facts['predicted_sigma_pct']:.3f} "
        f"%; {100 * facts['coverage_95']:.0f} % of the "
        "95 % intervals hold the truth. Largest change over nine poles "
        f"{facts['pole_spread']:.1e} of the volume.\n"
    )
    return head + "".join(f"\n## {name}\n\n{make(study)}" for name, make in TABLES.items())


def profiles(_: Study) -> Figure:
    """The second layer of seed 0 cut along x: the surfaces, and the scans' points within 2 cm of
    the cut.
    """
    layer = make_layer(1, 0)
    a, b = registered_scans(1, 0)[:2]
    figure, axes = panels(1, 1, 9.0, 5.0)
    ax = axes[0, 0]
    for scan, (vertices, _t), color, name in (
        (a, layer.before, "C0", "before"),
        (b, layer.after, "C3", "after"),
    ):
        near = np.abs(scan.points[:, 1]) < 0.02
        ax.plot(*scan.points[near][:, [0, 2]].T, ".", ms=1, color=color, alpha=0.5)
        rows = vertices[:-1].reshape(-1, 360, 3)
        ax.plot(
            *np.concatenate([rows[:, 0], rows[::-1, 180]])[:, [0, 2]].T,
            lw=0.8,
            color=color,
            label=name,
        )
        ax.plot(*scan.scanner[[0, 2]], "^", color=color)
    ax.set(aspect="equal", xlabel="x / m", ylabel="z / m", xlim=(-5, 5), ylim=(-LAYER_M * 2.3, 1.0))
    ax.legend(title="lines: surface; triangles: scanner")
    return figure


def errors(study: Study) -> Figure:
    """Errors of all bodies with their intervals, and the published way beside."""
    figure, axes = panels(1, 2, 6.0, 4.0)
    n = len(study.bodies)
    for k in range(len(study.bodies[0])):
        b = [row[k] for row in study.bodies]
        at = np.arange(n) + 0.2 * (k - 1)
        half = [196.0 * x.excavation.sigma_m3 / x.true_m3 for x in b]
        axes[0, 0].errorbar(
            at, [x.error_pct for x in b], half, fmt="o", ms=3, capsize=2, label=f"body {k + 1}"
        )
        axes[0, 1].plot(
            at, [100 * (x.excavation.published_m3 / x.true_m3 - 1) for x in b], "x", color=f"C{k}"
        )
    for ax, name in zip(
        axes[0],
        ("common boundary ring, 95 % intervals", "each surface over its own boundary"),
        strict=True,
    ):
        ax.axhline(0.0, color="black", lw=0.6)
        ax.set(xlabel="seed", ylabel="error of the volume / %", title=name)
    axes[0, 0].legend(fontsize=8)
    return figure


def coastline(study: Study) -> Figure:
    """Surface and volume against the cell."""
    s = study.resolution
    figure, axes = panels(1, 2, 5.0, 3.6)
    axes[0, 0].loglog(s.cell_m, s.area_m2, "o-")
    axes[0, 1].semilogx(s.cell_m, s.volume_m3, "o-")
    axes[0, 1].axhline(study.bodies[0][1].true_m3, color="black", lw=0.6)
    for ax, name in zip(axes[0], ("surface of B / m²", "volume / m³ (line: true)"), strict=True):
        ax.set(xlabel="cell / m", ylabel=name)
    return figure


def write_figures(study: Study, folder: Path) -> list[str]:
    """The figures as PNG; returns their names. Raises :class:`OutputError`."""
    names = []
    for name, make in (("section", profiles), ("errors", errors), ("resolution", coastline)):
        names.append(save_figure(make(study), folder / f"{name}.png"))
    return names
