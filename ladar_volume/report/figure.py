"""The picture of a result: the surface seen from above with its outline, and where the uncertainty
comes from.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from ladar_volume.model.errors import OutputError
from ladar_volume.model.records import F64, Estimate, Tin


def draw(estimate: Estimate, title: str) -> Figure:
    """A figure with two panels; no window, no global state."""
    figure = Figure(figsize=(12, 5.4), layout="constrained")
    FigureCanvasAgg(figure)
    plan, bars = figure.subplots(1, 2, width_ratios=[1.7, 1.0])
    _plan(plan, figure, estimate)
    _budget(bars, estimate)
    v = estimate.volume
    figure.suptitle(
        f"{title}: V = {v.volume_m3:.2f} ± {v.sigma_m3:.2f} m³ (1 sigma), above the {v.base}"
    )
    return figure


def _plan(ax: Axes, figure: Figure, estimate: Estimate) -> None:
    tin = estimate.tin
    triangles = tin.triangles[tin.relevant]
    heights = tin.vertices[triangles, 2].mean(axis=1)
    corners = list(tin.vertices[triangles, :2])
    faces = PolyCollection(
        corners, array=heights, cmap="viridis", edgecolors="face", linewidths=0.2
    )
    colours = faces.to_rgba(heights)
    colours[:, :3] *= (0.45 + 0.55 * _shade(tin))[:, None]
    ax.add_collection(
        PolyCollection(corners, facecolors=colours, edgecolors=colours, linewidths=0.2)
    )
    outline = np.vstack([estimate.volume.outline, estimate.volume.outline[:1]])
    ax.plot(outline[:, 0], outline[:, 1], color="crimson", lw=1.4, label="outline")
    ax.set(aspect="equal", xlabel="east / m", ylabel="north / m")
    ax.autoscale_view()
    ax.legend(loc="upper right")
    figure.colorbar(faces, ax=ax, label="height / m", shrink=0.85)


def _shade(tin: Tin) -> F64:
    p = tin.vertices[tin.triangles[tin.relevant]]
    n = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-300)
    light = np.array([-0.5, 0.5, 0.7071])
    shade: F64 = np.clip(n @ light, 0.0, 1.0)
    return shade


def _budget(ax: Axes, estimate: Estimate) -> None:
    lines = sorted(estimate.volume.budget_m6.items(), key=lambda item: item[1])
    names = [name.replace("_", " ") for name, _ in lines]
    ax.barh(names, [np.sqrt(max(value, 0.0)) for _, value in lines], color="steelblue")
    v = estimate.volume
    halved = v.sigma_if_halved_m3.get(v.largest_source, v.sigma_m3)
    ax.set(xlabel="standard deviation of V by source / m³")
    ax.set_title(
        f"{v.largest_source.replace('_', ' ')} is the largest; half of it: ± {halved:.2f} m³",
        fontsize=9,
    )
    ax.grid(axis="x", alpha=0.3)


def save(estimate: Estimate, title: str, path: Path) -> None:
    """Write the figure as PNG. Raises OutputError."""
    try:
        draw(estimate, title).savefig(path, dpi=110)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error}", value=str(path)) from error
