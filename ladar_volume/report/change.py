"""The picture of a change between two surveys: the difference of heights, the level of detection,
and the budget.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from ladar_volume.change.change_detection import ChangeMap
from ladar_volume.model.errors import OutputError
from ladar_volume.model.records import F64, Volume

#: Colour of what does not exceed the level of detection, and lines of the budget that are shown.
GREY, LINES = "0.85", 9


def draw(volume: Volume, change: ChangeMap, title: str) -> Figure:
    """A figure with three panels; no window, no global state."""
    figure = Figure(figsize=(16, 5.4), layout="constrained")
    FigureCanvasAgg(figure)
    plan, level, bars = figure.subplots(1, 3, width_ratios=[1.0, 1.0, 0.75])
    t = change.tin.triangles[change.tin.relevant]
    dz, above = change.difference_m[t].mean(axis=1), change.significant[t].sum(axis=1) >= 2
    reach = float(np.max(np.abs(dz))) if len(dz) else 1.0
    _map(
        plan,
        figure,
        change,
        np.where(above, dz, np.nan),
        "RdBu",
        (-reach, reach),
        "new minus previous / m",
    )
    plan.set_title(
        (
            "change beyond the level of detection (grey: below it), "
            f"{change.area_m2[change.significant].sum():.1f} m²"
        ),
        fontsize=9,
    )
    limits = float(np.percentile(change.level_m[t], 2)), float(np.percentile(change.level_m[t], 98))
    _map(
        level,
        figure,
        change,
        change.level_m[t].mean(axis=1),
        "viridis",
        limits,
        "level of detection / m",
    )
    lines = sorted(volume.budget_m6.items(), key=lambda item: item[1])[-LINES:]
    bars.barh(
        [name.replace("_", " ") for name, _ in lines],
        [np.sqrt(max(v, 0.0)) for _, v in lines],
        color="steelblue",
    )
    bars.set(xlabel="sigma of the change by source / m³")
    bars.grid(axis="x", alpha=0.3)
    figure.suptitle(
        f"{title}: {volume.volume_m3:+.2f} ± {volume.sigma_m3:.2f} m³ (1 sigma) over "
        f"{volume.area_m2:.0f} m²"
    )
    return figure


def _map(
    ax: Any,
    figure: Figure,
    change: ChangeMap,
    values: F64,
    colours: str,
    limits: tuple[float, float],
    label: str,
) -> None:
    corners = change.tin.vertices[change.tin.triangles[change.tin.relevant], :2]
    unknown = ~np.isfinite(values)
    ax.add_collection(
        PolyCollection(list(corners[unknown]), facecolors=GREY, edgecolors=GREY, linewidths=0.2)
    )
    known = list(corners[~unknown])
    faces = PolyCollection(
        known, array=values[~unknown], cmap=colours, clim=limits, edgecolors="face", linewidths=0.2
    )
    ax.add_collection(faces)
    ax.set(aspect="equal", xlabel="east / m", ylabel="north / m")
    ax.autoscale_view()
    figure.colorbar(faces, ax=ax, label=label, shrink=0.85)


def save(volume: Volume, change: ChangeMap, title: str, path: Path) -> None:
    """Write the figure as PNG. Raises OutputError."""
    try:
        draw(volume, change, title).savefig(path, dpi=110)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error}", value=str(path)) from error
