"""The parameters of the surface of a cloud: TIN, relevant triangles, boundary and adjustment."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ladar_volume.model.choices import ADJUST, CRITERIA, MEASURES
from ladar_volume.model.parameter import param


@dataclass(frozen=True)
class SurfaceParameters:
    """How a cloud becomes a surface (see the functions of ``adaptive``, ``relevant`` and
    ``boundary`` in :mod:`ladar_volume.tin`).

    Insertion stops at ``vertices``, ``ratio`` or ``tolerance``; with none of them at a third of the
    points. Lengths and areas are in the frame the points are given in.
    """

    vertices: int | None = param(None, "Number of vertices at which insertion stops.", low=3)
    ratio: float | None = param(
        None, "Vertices per point at which insertion stops; 1: every point.", low=0, high=1
    )
    tolerance: float | None = param(
        None, "Points are inserted until no residual is larger (m; sigmas for residual-sigma)."
    )
    criterion: str = param("residual-area", "What the next vertex maximises.", choices=CRITERIA)
    adjust: str = param("rms", "Elevation adjustment of a partial TIN.", choices=ADJUST)
    exchange: str = param(
        "none", "Diagonals are exchanged for a better fit.", choices=(*MEASURES, "none")
    )
    readjust: bool = param(
        True, "Heights are adjusted again after the exchange; not: as published, it is last."
    )
    relevant: str = param(
        "corners",
        "Which triangles count; sampled: where the points sampled, not their hull.",
        choices=("sampled", "all", "corners", "edge", "circumcircle"),
    )
    max_edge_m: float = param(math.inf, "Longest edge of a relevant triangle.", unit="m", low=0.001)
    max_circumdiameter_m: float = param(
        math.inf, "Largest circumcircle diameter of a relevant triangle.", unit="m", low=0.001
    )
    max_ear_edge_m: float = param(
        math.inf, "Boundary: ears with an open edge longer than this (m) are cut.", unit="m"
    )
    min_island_m2: float = param(
        0.0, "Boundary: islands smaller than this (m2) are dropped.", unit="m2"
    )
    max_hole_m2: float = param(0.0, "Boundary: holes up to this size (m2) are filled.", unit="m2")
    window: tuple[float, float, float, float] | None = param(
        None, "Map to which the points are cropped: low x, low y, high x, high y, m.", vector=4
    )
    duplicate_tolerance_m: float = param(
        0.0, "Points this near an earlier one become no vertices.", unit="m"
    )
    bins_per_row: int | None = param(None, "Bins per row of the initial triangulation.")
    max_iterations: int = param(100, "The adjustment rms-iterated ends after this many steps.")
    height_tolerance_m: float = param(
        1e-4, "rms-iterated ends when no height changes by as much in a step.", unit="m"
    )

    @property
    def full(self) -> bool:
        """Whether every point is a vertex, without artificial corners."""
        return (
            self.ratio == 1.0
            and self.vertices is None
            and self.tolerance is None
            and self.duplicate_tolerance_m == 0.0
        )
