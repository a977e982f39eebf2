"""The figures of a report: maps, sections, budget and path, on white, as self-contained SVG.

Faces of the maps are pixels inside the SVG, lines and letters are curves: what is printed looks the
same everywhere.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from ladar_volume.model.errors import OutputError
from ladar_volume.model.records import F64
from ladar_volume.report.scene import Scene, Section, sections_of

#: Lines of the budget that are shown.
LINES = 10
#: Coordinates from here on, m, have so many digits that their labels are turned.
FAR_M = 1e4
#: Share of the values that the colours of sigma span.
SPAN = (2.0, 98.0)
INK, TOE, CUT, BASE = "#22303c", "#b3122b", "#1f6fb4", "#8a6d3b"
#: Triangles that meet show no gap with whole pixels, without strokes, in a third of the time.
WHOLE_PIXELS: dict[str, Any] = {"linewidths": 0.0, "antialiaseds": False}
#: What a NavSatStatus is called, and its colour.
STATUS = {
    -1: ("no fix", "#c0392b"),
    0: ("single fix", "#e08a1e"),
    1: ("with SBAS", "#c9b800"),
    2: ("with a ground station (DGNSS, RTK)", "#2e8b57"),
}
#: Style of every figure.
STYLE: dict[Any, Any] = {
    "figure.facecolor": "white",
    "axes.facecolor": "#fbfcfd",
    "axes.edgecolor": "#9aa5ae",
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e3e8ec",
    "grid.linewidth": 0.6,
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "svg.fonttype": "path",
}


def new_figure(width_in: float, height_in: float) -> Figure:
    """A figure without window or global state; to be drawn within :data:`STYLE`."""
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Figure, path: Path, dpi: int = 110) -> str:
    """Write a figure as PNG; returns the file's name. Raises OutputError."""
    try:
        figure.savefig(path, dpi=dpi)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error}", value=str(path)) from error
    return path.name


def svg(name: str, draw: Callable[[Axes], None], width_in: float, height_in: float) -> str:
    """A figure of one panel as an SVG element for a page; its ids begin with ``name``."""
    with mpl.rc_context({**STYLE, "svg.hashsalt": name}):
        figure = new_figure(width_in, height_in)
        draw(figure.subplots())
        text = io.StringIO()
        none = dict.fromkeys(("Date", "Creator", "Format", "Type"))
        figure.savefig(text, format="svg", dpi=160, metadata=none)
    out = text.getvalue()
    out = out[out.index("<svg") :]
    out = re.sub(r"\sxmlns(:xlink)?=\"[^\"]*\"", "", out)
    out = re.sub(r"\bid=\"", f'id="{name}-', out)
    out = re.sub(r"(href=\"|url\()#", rf"\1#{name}-", out)
    return re.sub(r"<metadata>.*?</metadata>", "", out, flags=re.DOTALL).strip()


def polygons(corners: F64, **style: Any) -> PolyCollection:
    """Polygons of corners (n, k, 2); ``style`` as of PolyCollection. Of an array matplotlib makes
    them in half the time that a list takes, which its type stubs do not know.
    """
    at: Any = corners
    return PolyCollection(at, **style)


def faces(ax: Axes, scene: Scene, values: F64, **more: Any) -> AxesImage:
    """The triangles that are drawn from above, by their values (t,) or colours (t, 4); ``more`` as
    of imshow.
    """
    pixels, shown = scene.pixels, scene.pixels.shown
    image = np.full((*shown.shape, *values.shape[1:]), np.nan if values.ndim == 1 else 0.0)
    image[shown] = values[pixels.at[shown]]
    # on the grid of the axes, and with a margin around it
    drawn = ax.imshow(image, origin="lower", extent=pixels.extent, zorder=1.0, **more)
    drawn.sticky_edges.x.clear()
    drawn.sticky_edges.y.clear()
    return drawn


def finish_map(ax: Axes, scene: Scene, title: str, lines: bool = True) -> None:
    """Outline, axes and title of a map; axes in metres, as the points are."""
    for at, outline in enumerate(scene.outlines if lines else ()):
        closed = np.vstack([outline, outline[:1]])
        label = "toe (outline)" if at == 0 else None
        ax.plot(closed[:, 0], closed[:, 1], color=TOE, lw=1.3, label=label)
    ax.set(aspect="equal", xlabel="east / m", ylabel="north / m")
    ax.autoscale_view()
    ax.ticklabel_format(useOffset=False, style="plain")
    ax.locator_params(nbins=6)
    ax.tick_params(axis="x", labelrotation=30 if np.abs(ax.get_xlim()).max() >= FAR_M else 0)
    ax.set_title(title, loc="left")
    if ax.get_legend_handles_labels()[0]:
        below = -0.26 if np.abs(ax.get_xlim()).max() >= FAR_M else -0.16
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, below), ncols=2, frameon=False)


def draw_heights(ax: Axes, scene: Scene) -> None:
    """Heights with shaded relief."""
    z = scene.of_triangles(scene.tin.vertices[:, 2])
    scale = PolyCollection([], array=z, cmap="YlGnBu_r")
    colours = scale.to_rgba(z)
    colours[:, :3] *= (0.62 + 0.38 * shade(scene))[:, None]
    faces(ax, scene, colours)
    ax.figure.colorbar(scale, ax=ax, label="height / m", shrink=0.8)
    finish_map(ax, scene, "Heights and toe")


def shade(scene: Scene) -> F64:
    """(t,) light from the north-west, 0 to 1."""
    p = scene.corners()
    n = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-300)
    out: F64 = np.clip(n @ np.array([-0.5, 0.5, 0.7071]), 0.0, 1.0)
    return out


def draw_cut_fill(ax: Axes, scene: Scene) -> None:
    """Height above the base, blue, and below it, red."""
    above = scene.of_triangles(scene.above_m)
    known = above[np.isfinite(above)]
    reach = max(float(np.max(np.abs(known))) if len(known) else 0.0, 1e-6)
    low, high = (
        min(float(known.min(initial=0.0)), -0.05 * reach),
        max(float(known.max(initial=0.0)), 0.05 * reach),
    )
    norm = TwoSlopeNorm(0.0, low, high)
    drawn = faces(ax, scene, above, cmap="RdBu", norm=norm)
    bar = ax.figure.colorbar(drawn, ax=ax, label="above the base (cut +, fill −) / m", shrink=0.8)
    bar.set_ticks([t for t in (low, 0.0, high) if t == 0.0 or abs(t) > 0.06 * reach])
    bar.ax.yaxis.set_major_formatter("{x:.2f}")
    finish_map(ax, scene, "Cut and fill")


def draw_sigma(ax: Axes, scene: Scene) -> None:
    """Standard deviation of the heights, gaps, and where another pass helps most."""
    sigma = scene.sigma_m if scene.sigma_m is not None else np.full(len(scene.above_m), np.nan)
    mm = 1e3 * scene.of_triangles(sigma)
    known = mm[np.isfinite(mm)]
    limits = np.percentile(known, SPAN) if len(known) else np.array([0.0, 1.0])
    limits[1] = max(limits[1], 1.1 * limits[0], 1e-3)  # what hardly differs has one colour
    drawn = faces(ax, scene, mm, cmap="YlOrRd", vmin=limits[0], vmax=limits[1])
    bar = ax.figure.colorbar(drawn, ax=ax, label="sigma of height / mm", shrink=0.8)
    bar.ax.ticklabel_format(useOffset=False)
    for at, (x, y, _) in enumerate(scene.gaps):
        label = "not seen" if at == 0 else None
        ax.plot([x], [y], "o", ms=9, mfc="none", mec="#5b2c83", mew=1.6, label=label)
    for at, (x, y, _) in enumerate(scene.objects):
        label = "not counted" if at == 0 else None
        ax.plot([x], [y], "s", ms=9, mfc="none", mec="#1b6e3c", mew=1.6, label=label)
    for at, place in enumerate(scene.again):
        label = "another pass helps most" if at == 0 else None
        ax.plot([place["x_m"]], [place["y_m"]], "+", ms=11, mew=2.0, color=CUT, label=label)
    finish_map(ax, scene, "Sigma of heights, and where to measure again")


def draw_residuals(ax: Axes, scene: Scene) -> None:
    """How far the passes lie apart, patch by patch."""
    if scene.residuals is None:
        return
    found = scene.residuals
    mm = 1e3 * found.apart_m
    half = 0.55 * found.edge_m * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    squares = polygons(
        found.xy_m[:, None] + half,
        array=mm,
        cmap="magma_r",
        clim=(0.0, max(float(np.percentile(mm, SPAN[1])), 1e-3)),
        linewidths=0.0,
        rasterized=True,
    )
    ax.add_collection(squares)
    ax.figure.colorbar(squares, ax=ax, label="passes lie apart by / mm", shrink=0.8, extend="max")
    middle = float(np.sqrt(np.mean(found.apart_m**2)))
    finish_map(ax, scene, f"Residuals of the passes, {1e3 * middle:.1f} mm RMS")


def draw_path(ax: Axes, scene: Scene) -> None:
    """The path of the scanner by the status of its fixes, over the outline."""
    if scene.path is None:
        return
    xyz, status = scene.path.xyz_m, scene.path.status
    if status is None:
        ax.plot(xyz[:, 0], xyz[:, 1], ".", ms=4, color=CUT, label="poses (odometry)")
    else:
        for value in np.unique(status).tolist():
            words, colour = STATUS.get(value, (f"status {value}", INK))
            rows = status == value
            label = f"{words}: {100 * rows.mean():.0f} %"
            ax.plot(xyz[rows, 0], xyz[rows, 1], ".", ms=5, color=colour, label=label)
    finish_map(ax, scene, "Path of the scanner")


def draw_section(ax: Axes, s: Section) -> None:
    """A section: surface and base."""
    ax.fill_between(s.along_m, s.base_m, s.surface_m, color="#cfe0ef", lw=0)
    ax.plot(s.along_m, s.surface_m, color=CUT, lw=1.4, label="surface")
    ax.plot(s.along_m, s.base_m, color=BASE, lw=1.2, ls="--", label="base")
    (x0, y0), (x1, y1) = s.ends
    words = f"from {x0:.2f}, {y0:.2f} to {x1:.2f}, {y1:.2f} m"
    ax.set_title(f"Section {s.name}, {words}", loc="left")
    ax.set(xlabel="along / m", ylabel="height / m")
    ax.ticklabel_format(useOffset=False)
    ax.margins(y=0.12)
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)


def draw_convergence(ax: Axes, scene: Scene) -> None:
    """Volume with one standard deviation over the recording."""
    share, volume, sigma = np.array(scene.convergence, dtype=np.float64).T
    good = np.isfinite(volume) & np.isfinite(sigma)
    percent = 100.0 * share[good]
    ax.errorbar(percent, volume[good], sigma[good], fmt="o-", color=CUT, ms=4, lw=1.2, capsize=3)
    ax.axhline(volume[-1], color=BASE, lw=1.0, ls="--")
    ax.set(xlabel="share of the recording / %", ylabel="V ± sigma / m³")
    ax.set_xlim(0.0, 103.0)
    ax.ticklabel_format(useOffset=False)
    ax.margins(y=0.15)
    ax.set_title("How the volume came about", loc="left")


def draw_budget(ax: Axes, budget_m6: Mapping[str, float]) -> None:
    """Standard deviations of the volume by source, the largest on top."""
    lines = sorted(budget_m6.items(), key=lambda item: item[1])[-LINES:]
    sigma = [float(np.sqrt(max(value, 0.0))) for _, value in lines]
    names = [name.replace("_", " ") for name, _ in lines]
    bars = ax.barh(names, sigma, color="#4a86b8", height=0.65)
    ax.bar_label(bars, [f"{value:.3g}" for value in sigma], padding=3, fontsize=8)
    ax.set(xlabel="standard deviation of the volume by source / m³")
    ax.set_xlim(0.0, 1.2 * max([*sigma, 1e-12]))
    ax.locator_params(axis="x", nbins=5)
    ax.grid(axis="y", visible=False)
    ax.set_title("Where the uncertainty comes from", loc="left")


def plates(scene: Scene, budget_m6: Mapping[str, float]) -> dict[str, str]:
    """All figures that the scene has data for, by name, as SVG."""
    maps: dict[str, Callable[..., None]] = {
        "heights": draw_heights,
        "cut-fill": draw_cut_fill,
    }
    if scene.sigma_m is not None:
        maps["sigma"] = draw_sigma
    if scene.residuals is not None:
        maps["residuals"] = draw_residuals
    if scene.path is not None:
        maps["path"] = draw_path
    out = {name: svg(name, partial(draw, scene=scene), 5.6, 4.9) for name, draw in maps.items()}
    for number, section in enumerate(sections_of(scene), 1):
        name = f"section-{number}"
        out[name] = svg(name, partial(draw_section, s=section), 7.6, 2.6)
    if len(scene.convergence) > 1:
        out["convergence"] = svg("convergence", partial(draw_convergence, scene=scene), 7.6, 2.6)
    if any(value > 0.0 for value in budget_m6.values()):
        out["budget"] = svg("budget", partial(draw_budget, budget_m6=budget_m6), 7.6, 3.4)
    return out
