"""Figures of the box experiment: those of seed 000 chapter 5 (5.1 to 5.7), and the package's way
beside the published ones.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ladar_volume.experiments.nist import nist_published as published
from ladar_volume.experiments.nist.nist import Study
from ladar_volume.experiments.nist.nist_experiments import (
    COUNTS,
    LEVEL_STEP_M,
    error_pct,
    scan_frame,
)
from ladar_volume.experiments.nist.nist_scene import pair
from ladar_volume.experiments.nist.nist_uncropped import uncropped_scan
from ladar_volume.report.plates import save_figure
from ladar_volume.tin.full_tin import build_tin


def panels(rows: int, columns: int, width: float = 5.2, height: float = 3.8) -> tuple[Figure, Any]:
    """A figure and its axes (rows, columns); no window, no global state."""
    figure = Figure(figsize=(width * columns, height * rows), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False)


def uncropped(_: Study) -> Figure:
    """Fig. 5.1: footprint triangulation of all that the scanner returns, density 1, seed 0; phantom
    points of beams that met two surfaces apart.
    """
    found = uncropped_scan(1, 0)
    tin = build_tin(found.points)
    figure, axes = panels(1, 1, 8.0, 7.4)
    ax = axes[0, 0]
    ax.triplot(tin.vertices[:, 0], tin.vertices[:, 1], tin.triangles, lw=0.15, color="black")
    mixed = found.points[found.phantom]
    ax.plot(mixed[:, 0], mixed[:, 1], ".", ms=2.5, color="C3", label="phantom points")
    ax.set(aspect="equal", xlabel="x / m", ylabel="y / m", title="before cropping")
    ax.legend(fontsize=8)
    return figure


def footprints(_: Study) -> Figure:
    """Fig. 5.2: footprint triangulations, level and along the scan direction, density 3, seed 0."""
    a, b = pair(3, 0)
    figure, axes = panels(1, 2, 6.0, 5.6)
    frame = scan_frame(b)
    for ax, points, name in zip(
        axes[0],
        (a.points, frame.points(a.points)),
        ("over the floor", "along the scan direction"),
        strict=True,
    ):
        tin = build_tin(points)
        ax.triplot(tin.vertices[:, 0], tin.vertices[:, 1], tin.triangles, lw=0.25, color="black")
        ax.set(aspect="equal", xlabel="x / m", ylabel="y / m", title=name)
    return figure


def experiment_one(study: Study) -> Figure:
    """Fig. 5.3: error by vertices and bins."""
    figure, axes = panels(1, 2)
    error = error_pct(np.array(study.one).mean(axis=0))
    for ax, k, table, name in zip(
        axes[0],
        (1, 0),
        (published.TABLE_5_2_RMS, published.TABLE_5_2),
        ("with", "without"),
        strict=True,
    ):
        for j, bins in enumerate(published.BINS):
            line = ax.plot(COUNTS, error[k, :, j], lw=1.2, label=f"{bins} bins")[0]
            ax.plot(COUNTS, error_pct(table[:, 1 + j]), ".", ms=5, color=line.get_color())
        ax.axhline(0.0, color="black", lw=0.6)
        ax.set(
            xlabel="points in the mesh",
            ylabel="error of the volume / %",
            title=f"{name} RMS adjustment",
        )
    axes[0, 0].legend(fontsize=7, title="lines simulated, dots published", title_fontsize=7)
    return figure


def experiment_two(study: Study) -> Figure:
    """Fig. 5.4: error by density and option."""
    figure, axes = panels(1, 1, 6.4, 4.2)
    ax, error = axes[0, 0], error_pct(study.two)
    spread = error.std(axis=0, ddof=1) if len(error) > 1 else np.zeros(error.shape[1:])
    for k, name in enumerate(published.OPTIONS):
        at = np.arange(1, 6) + 0.12 * (k - 1.5)
        bars = ax.errorbar(
            at, error.mean(axis=0)[:, k], spread[:, k], fmt="o", ms=4, capsize=2, label=name
        )
        ax.plot(at, published.TABLE_5_3A[:, k], "x", color=bars[0].get_color())
    ax.axhline(0.0, color="black", lw=0.6)
    ax.set(xlabel="density setting", ylabel="error of the volume / %", xticks=range(1, 6))
    ax.legend(
        fontsize=8, title="dots: mean and spread, simulated; crosses: published", title_fontsize=8
    )
    return figure


def experiment_four(rms: int) -> Callable[[Study], Figure]:
    """Fig. 5.6 (without RMS adjustment) or 5.7 (with it): error by level, the full set and each
    subset of seed 0.
    """

    def make(study: Study) -> Figure:
        figure, axes = panels(2, 2)
        for m in range(2):
            _simulated_levels(axes[0, m], study, rms, m)
            _published_levels(axes[1, m], rms, m)
            for i, name in enumerate(("simulated, seed 0", "published")):
                axes[i, m].axhline(0.0, color="black", lw=0.6)
                axes[i, m].set(
                    xlabel="level, downwards / cm",
                    ylabel="error of the volume / %",
                    title=f"Method {m + 1}, {name}",
                )
        axes[1, 1].legend(fontsize=6, ncols=2)
        return figure

    return make


def _simulated_levels(ax: Axes, study: Study, rms: int, method: int) -> None:
    """Errors by level of the full set (black) and the subsets, of seed 0."""
    for j, cloud in enumerate(study.four[0]):
        pairs = (cloud[rms].one, cloud[rms].two)[method]
        steps = 100.0 * LEVEL_STEP_M * np.arange(len(pairs.volume_m3))
        ax.plot(
            steps,
            error_pct(pairs.volume_m3),
            lw=2.0 if j == 0 else 0.9,
            color="black" if j == 0 else f"C{j - 1}",
        )


def _published_levels(ax: Axes, rms: int, method: int) -> None:
    """The same as printed."""
    printed = published.box_volumes(published.TABLE_5_8A if rms else published.TABLE_5_8B)
    full = published.TABLE_5_7A if rms else published.TABLE_5_7B
    steps = 5.0 * np.arange(5)
    ax.plot(steps, error_pct(full[method]), lw=2.0, color="black", label="full set")
    for j in range(len(printed)):
        error = error_pct(printed[j, method])
        ax.plot(steps, error, lw=0.9, color=f"C{j}", label=f"{j + 1}")


def ways(study: Study) -> Figure:
    """Every procedure's errors over the seeds."""
    figure, axes = panels(1, 1, 7.6, 3.8)
    three, four = error_pct(study.three), error_pct(study.methods())[:, 1:]
    own = np.array([[float(error_pct(o.volume_m3))] for o in study.own])
    rows = {
        "Experiment 3, RMS": three[:, :, 0],
        "Experiment 3, filter, RMS": three[:, :, 2],
        "Experiment 4, Method 1, RMS": four[:, :, 2],
    }
    rows |= {
        "Experiment 4, Method 2, RMS": four[:, :, 3],
        "all points, scan direction,\ncommon footprint": own,
    }
    axes[0, 0].boxplot(
        [v.ravel() for v in rows.values()],
        orientation="horizontal",
        tick_labels=list(rows),
        whis=(0, 100),
    )
    axes[0, 0].axvline(0.0, color="black", lw=0.6)
    axes[0, 0].set(xlabel="error of the volume / %", ylim=(len(rows) + 0.6, 0.4))
    return figure


FIGURES: dict[str, Callable[[Study], Figure]] = {
    "figure_5_1": uncropped,
    "figure_5_2": footprints,
    "figure_5_3": experiment_one,
    "figure_5_4": experiment_two,
    "figure_5_6": experiment_four(0),
    "figure_5_7": experiment_four(1),
    "procedures": ways,
}


def write_figures(study: Study, folder: Path) -> list[str]:
    """All figures as PNG into ``folder``; returns their names. Raises :class:`OutputError` where
    one cannot be written.
    """
    names = []
    for name, make in FIGURES.items():
        names.append(save_figure(make(study), folder / f"{name}.png"))
    return names
