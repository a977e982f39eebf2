"""The parameters of the surface of a cloud: TIN, relevant triangles, boundary and adjustment."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ladar_volume.model.choices import ADJUST, CRITERIA, MEASURES
from ladar_volume.model.errors import ConfigurationError
from ladar_volume.model.parameter import param

#: What a TIN of all points does not read.
FOR_PARTIAL = (
    "criterion",
    "adjust",
    "max_iterations",
    "height_tolerance_m",
    "exchange",
    "readjust",
    "bins_per_row",
)


@dataclass(frozen=True)
class RepresentationParameters:
    """What surfaces of clouds and of surveys have in common: which points become vertices, their
    heights, the diagonals and the boundary (seed 000 sections 2.4 to 3.3).
    """

    criterion: str = param("residual-area", "What the next vertex maximises.", choices=CRITERIA)
    adjust: str = param("rms", "Elevation adjustment of a partial TIN.", choices=ADJUST)
    max_iterations: int = param(
        100, "The adjustment rms-iterated ends after this many steps.", low=0
    )
    height_tolerance_m: float = param(
        1e-4, "rms-iterated ends when no height changes by as much in a step.", unit="m", low=0
    )
    exchange: str = param(
        "none", "Diagonals are exchanged for a better fit.", choices=(*MEASURES, "none")
    )
    readjust: bool = param(
        True, "Heights are adjusted again after the exchange; not: as published, it is last."
    )
    max_ear_edge_m: float = param(
        math.inf, "Boundary: ears with an open edge longer than this (m) are cut.", unit="m", low=0
    )
    min_island_m2: float = param(
        0.0, "Boundary: islands smaller than this (m2) are dropped.", unit="m2", low=0
    )
    max_hole_m2: float = param(
        0.0, "Boundary: holes up to this size (m2) are filled.", unit="m2", low=0
    )


@dataclass(frozen=True)
class TinParameters(RepresentationParameters):
    """The surface of a survey, in replay and live, beside ``volume.vertex_ratio`` and
    ``volume.relevant``. All but the screens and the boundary is for partial TINs.
    """

    bins_per_row: int = param(
        0,
        "Bins per row of the initial triangulation; 0: about a tenth of the vertices are initial.",
        low=0,
        high=10000,
    )
    screen_m: float = param(
        0.0,
        "Median screen: points farther than this from the median of their neighbours are "
        "left out (TINscreen); 0: none.",
        unit="m",
        low=0,
        high=100,
    )
    median_m: float = param(
        0.0,
        "Median filter: points farther than this from the median of their neighbours get "
        "it as height (TINfilter), after the screen; 0: none.",
        unit="m",
        low=0,
        high=100,
    )

    def check(self, vertex_ratio: float, relevant: str) -> None:
        """Raise :class:`ConfigurationError` for what has no effect, or no standard deviation,
        beside the others.
        """
        own = TinParameters()
        if vertex_ratio < 1.0 and relevant == "all":
            raise ConfigurationError(
                "volume.relevant all counts the corners of the map, which nobody measured, as "
                "surface where volume.vertex_ratio is below 1: take corners, edge or circumcircle",
                value=relevant,
            )
        if vertex_ratio == 1.0:
            for name in FOR_PARTIAL:
                if getattr(self, name) != getattr(own, name):
                    raise ConfigurationError(
                        f"tin.{name} is for a partial TIN: give volume.vertex_ratio below 1 too",
                        value=vertex_ratio,
                    )
        steps = (self.max_iterations, self.height_tolerance_m)
        if self.adjust != "rms-iterated" and steps != (own.max_iterations, own.height_tolerance_m):
            raise ConfigurationError(
                "tin.max_iterations and tin.height_tolerance_m belong to tin.adjust rms-iterated",
                value=self.adjust,
            )
        if not self.readjust and "none" in (self.exchange, self.adjust):
            raise ConfigurationError(
                "tin.readjust false is for heights that are adjusted and diagonals that are "
                "exchanged: give tin.exchange asd or rms, and a tin.adjust",
                value=self.exchange,
            )


@dataclass(frozen=True)
class SurfaceParameters(RepresentationParameters):
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
    relevant: str = param(
        "corners",
        "Which triangles count; sampled: where the points sampled, not their hull.",
        choices=("sampled", "all", "corners", "edge", "circumcircle"),
    )
    max_edge_m: float = param(math.inf, "Longest edge of a relevant triangle.", unit="m", low=0.001)
    max_circumdiameter_m: float = param(
        math.inf, "Largest circumcircle diameter of a relevant triangle.", unit="m", low=0.001
    )
    window: tuple[float, float, float, float] | None = param(
        None, "Map to which the points are cropped: low x, low y, high x, high y, m.", vector=4
    )
    duplicate_tolerance_m: float = param(
        0.0, "Points this near an earlier one become no vertices.", unit="m"
    )
    bins_per_row: int | None = param(None, "Bins per row of the initial triangulation.")

    @property
    def full(self) -> bool:
        """Whether every point is a vertex, without artificial corners."""
        return (
            self.ratio == 1.0
            and self.vertices is None
            and self.tolerance is None
            and self.duplicate_tolerance_m == 0.0
        )
