"""The picture of a result: heights with the toe, cut and fill, and where the uncertainty comes
from.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from ladar_volume.ground.heights import height_above
from ladar_volume.model.records import Estimate
from ladar_volume.report.plates import (
    STYLE,
    draw_budget,
    draw_cut_fill,
    draw_heights,
    new_figure,
    save_figure,
)
from ladar_volume.report.scene import Scene, base_of_plane


def draw(estimate: Estimate, title: str, system: str = "") -> Figure:
    """A figure with three panels; no window. ``system`` : the coordinate system in words."""
    v, tin = estimate.volume, estimate.tin
    scene = Scene(
        tin=tin,
        counted=np.asarray(tin.relevant, dtype=bool),
        above_m=height_above(tin.vertices, estimate.base),
        sigma_m=None,
        outlines=[body.outline for body in estimate.bodies or (v,)],
        base_at=base_of_plane(estimate.base),
        base=v.base,
        where=system,
    )
    with mpl.rc_context(STYLE):
        figure = new_figure(15.0, 5.2)
        heights, cut, bars = figure.subplots(1, 3, width_ratios=[1.15, 1.15, 1.0])
        draw_heights(heights, scene)
        draw_cut_fill(cut, scene)
        draw_budget(bars, v.budget_m6)
        words = f"V = {v.volume_m3:.2f} ± {v.sigma_m3:.2f} m³ (1 sigma), above the {v.base}"
        figure.suptitle(f"{title}: {words}", fontsize=12)
        figure.supxlabel(system, fontsize=8)
    return figure


def save(estimate: Estimate, title: str, path: Path, system: str = "") -> None:
    """Write the figure as PNG. Raises OutputError."""
    with mpl.rc_context(STYLE):
        save_figure(draw(estimate, title, system), path)
