"""The picture of a change between two surveys: the difference of heights, the level of detection,
and the budget.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ladar_volume.change.change_detection import ChangeMap
from ladar_volume.model.records import F64
from ladar_volume.report.plates import WHOLE_PIXELS, polygons, save_figure

#: Colour of what does not exceed the level of detection, and lines of the budget that are shown.
GREY, LINES = "0.85", 9


class ChangeTotals(NamedTuple):
    """The change as a whole: volume_m3 ± sigma_m3 over area_m2, and its budget, m⁶ by source."""

    volume_m3: float
    sigma_m3: float
    area_m2: float
    budget_m6: dict[str, float]


def draw(volume: ChangeTotals, change: ChangeMap, title: str) -> Figure:
    """A figure with three panels; no window, no global state."""
    figure = Figure(figsize=(16, 5.4), layout="constrained")
    FigureCanvasAgg(figure)
    plan, level, bars = figure.subplots(1, 3, width_ratios=[1.0, 1.0, 0.75])
    _difference(plan, change)
    _level(level, change)
    _budget(bars, volume)
    figure.suptitle(
        f"{title}: {volume.volume_m3:+.2f} ± {volume.sigma_m3:.2f} m³ (1 sigma) over "
        f"{volume.area_m2:.0f} m²"
    )
    return figure


@dataclass(frozen=True)
class Colours:
    """How values become colours: the map's name, its limits, and what the bar says."""

    name: str
    limits: tuple[float, float]
    label: str


def _difference(ax: Axes, change: ChangeMap) -> None:
    """Panel of the difference of heights where it exceeds the level of detection."""
    t = change.tin.triangles[change.tin.relevant]
    dz, above = change.difference_m[t].mean(axis=1), change.significant[t].sum(axis=1) >= 2
    reach = float(np.max(np.abs(dz))) if len(dz) else 1.0
    colours = Colours("RdBu", (-reach, reach), "new minus previous / m")
    _map(ax, change, np.where(above, dz, np.nan), colours)
    ax.set_title(
        (
            "change beyond the level of detection (grey: below it), "
            f"{change.area_m2[change.significant].sum():.1f} m²"
        ),
        fontsize=9,
    )


def _level(ax: Axes, change: ChangeMap) -> None:
    """Panel of the level of detection."""
    t = change.tin.triangles[change.tin.relevant]
    limits = float(np.percentile(change.level_m[t], 2)), float(np.percentile(change.level_m[t], 98))
    colours = Colours("viridis", limits, "level of detection / m")
    _map(ax, change, change.level_m[t].mean(axis=1), colours)


def _budget(ax: Axes, volume: ChangeTotals) -> None:
    """Panel of the largest lines of the budget."""
    lines = sorted(volume.budget_m6.items(), key=lambda item: item[1])[-LINES:]
    ax.barh(
        [name.replace("_", " ") for name, _ in lines],
        [np.sqrt(max(v, 0.0)) for _, v in lines],
        color="steelblue",
    )
    ax.set(xlabel="sigma of the change by source / m³")
    ax.grid(axis="x", alpha=0.3)


def _map(ax: Axes, change: ChangeMap, values: F64, colours: Colours) -> None:
    """The triangles from above in the colours of their values (t,); grey where there is none."""
    corners = change.tin.vertices[change.tin.triangles[change.tin.relevant], :2]
    unknown = ~np.isfinite(values)
    ax.add_collection(polygons(corners[unknown], facecolors=GREY, **WHOLE_PIXELS))
    faces = polygons(
        corners[~unknown],
        array=values[~unknown],
        cmap=colours.name,
        clim=colours.limits,
        **WHOLE_PIXELS,
    )
    ax.add_collection(faces)
    ax.set(aspect="equal", xlabel="east / m", ylabel="north / m")
    ax.autoscale_view()
    ax.figure.colorbar(faces, ax=ax, label=colours.label, shrink=0.85)


def save(volume: ChangeTotals, change: ChangeMap, title: str, path: Path) -> None:
    """Write the figure as PNG. Raises OutputError."""
    save_figure(draw(volume, change, title), path)
