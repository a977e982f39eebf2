"""Parameters of the volume: what it stands on, where it counts, what is known of the place."""

from __future__ import annotations

from dataclasses import dataclass

from ladar_volume.model.errors import ParameterValueError
from ladar_volume.model.parameter import param


@dataclass(frozen=True)
class VolumeParameters:
    """Surface, base and volume."""

    kind: str = param(
        "surface",
        "What is measured: the surface above its base; or closed bodies on the ground too, walls "
        "and overhangs with them.",
        choices=("surface", "bodies"),
    )
    base: str = param(
        "ground",
        "What the volume stands on: ground of the same survey, a level, or a given plane.",
        choices=("ground", "level", "plane"),
    )
    level_m: float = param(
        0.0, "Height of the level in the map frame.", unit="m", low=-10000, high=10000
    )
    plane: tuple[float, ...] = param(
        (0.0, 0.0, 0.0),
        "The given plane z = c0 + c1 x + c2 y in the map frame.",
        low=-1e9,
        high=1e9,
        vector=3,
    )
    outline: str = param(
        "auto",
        "Where the volume counts: the main body above the base, everything, or a polygon.",
        choices=("auto", "all", "polygon"),
    )
    polygon_m: tuple[float, ...] = param(
        (), "Outline x1, y1, x2, y2, ... in the map frame.", unit="m", vector=0
    )
    object_height_m: float = param(
        0.15,
        "Auto outline: least height above the base that belongs to the body.",
        unit="m",
        low=0.001,
        high=100,
    )
    bodies: int = param(
        1,
        "Auto outline: most bodies, the largest first; 1 for the main body alone, 0 for all.",
        low=0,
        high=10000,
    )
    min_body_m3: float = param(
        0.1, "Auto outline: smallest volume of a further body.", unit="m3", low=0, high=1e9
    )
    outline_margin_m: float = param(
        1.0,
        "Auto outline: margin around the body, so that the toe is inside.",
        unit="m",
        low=0,
        high=100,
    )
    ground_ring_m: float = param(
        10.0,
        "Ground is fitted to points within this distance outside the outline; 0 for all.",
        unit="m",
        low=0,
        high=10000,
    )
    vertex_ratio: float = param(
        1.0,
        "Part of the filtered points that become vertices: 1 for all; below it they are "
        "chosen by adaptive insertion, and their heights "
        "adjusted to all points (seed 000 chapters 2 and 3; a third is published as best).",
        low=0.01,
        high=1,
    )
    relevant: str = param(
        "edge",
        "Which triangles count (seed 000 section 3.1).",
        choices=("all", "corners", "edge", "circumcircle"),
    )
    max_edge_m: float = param(
        3.0, "Longest edge of a relevant triangle.", unit="m", low=0.001, high=10000
    )
    max_circumdiameter_m: float = param(
        3.0,
        "Largest circumcircle diameter of a relevant triangle.",
        unit="m",
        low=0.001,
        high=10000,
    )
    confidence: float = param(0.95, "Confidence of the printed interval.", low=0.5, high=0.9999)
    tolerance: float = param(0.05, "Wanted sigma / V, for diagnostics.", low=1e-6, high=1)
    objects: str = param(
        "remove",
        "What stands on the surface on steep faces (machines, walls, trees): taken out, and "
        "the surface below bridged; or counted, where it is of the body.",
        choices=("remove", "count"),
    )
    budget_check: str = param(
        "scale",
        "Where passes disagree by more than the budget says: scale its lines and doubt the "
        "result, doubt it only, or refuse it.",
        choices=("scale", "warn", "refuse"),
    )
    ground_cover_m: tuple[float, ...] = param(
        (),
        "How high above the soil returns see the ground, as on grass, and the standard deviation "
        "of that: 0.06, 0.02; 0, 0 for bare ground; empty: not known, and looked for.",
        unit="m",
        low=0,
        high=10,
        vector=0,
    )
    body_cover_m: tuple[float, ...] = param(
        (),
        "The same for plants on what is measured; 0, 0 for material that is rough, but bare.",
        unit="m",
        low=0,
        high=10,
        vector=0,
    )

    @property
    def names_plants(self) -> bool:
        """Whether a height of plants is given, be it 0."""
        return bool(self.ground_cover_m or self.body_cover_m)

    def check(self) -> None:
        """Whether each has its effect beside the others; raises a ConfigurationError."""
        for name in ("ground_cover_m", "body_cover_m"):
            given = getattr(self, name)
            if not given:
                continue
            if len(given) != 2:
                raise ParameterValueError(
                    f"volume.{name} is a height and its standard deviation, two numbers in m",
                    value=list(given),
                )
            if self.kind == "bodies":
                raise ParameterValueError(
                    f"volume.{name} is for volume.kind surface: closed bodies are measured as "
                    "they are seen",
                    value=list(given),
                )
