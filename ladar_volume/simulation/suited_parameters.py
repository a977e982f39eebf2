"""Filter and outline parameters that a surveyor would choose for each scene."""

from __future__ import annotations

from typing import Any

from ladar_volume.simulation.scenes import Scene

#: Filter and outline that suit a kind of scene; everything else keeps its default.
SUITED: dict[str, dict[str, dict[str, Any]]] = {
    "box": {
        "filter": {"radius_m": 0.08, "degree": 1, "min_points": 8, "cap_per_voxel": 12},
        "volume": {
            "object_height_m": 0.1,
            "outline_margin_m": 0.3,
            "ground_ring_m": 2.5,
            "max_edge_m": 1.5,
        },
        "georeference": {"region_m": [-4.5, -4.0, -2.0, 4.5, 4.0, 5.0]},
    },
    "pile": {
        "filter": {"radius_m": 0.6, "degree": 2, "cap_per_voxel": 20},
        "volume": {"object_height_m": 0.25, "outline_margin_m": 1.0, "ground_ring_m": 8.0},
    },
    "small": {
        "filter": {"radius_m": 0.15, "degree": 1, "min_points": 8, "cap_per_voxel": 12},
        "volume": {"outline": "polygon", "ground_ring_m": 3.0, "max_edge_m": 1.5},
    },
}
KINDS = {
    name: "small" for name in ("nist_box", "kern_before", "kern_after", "sphere", "square")
} | {"box": "box"}


def suited_settings(scene: Scene) -> dict[str, dict[str, Any]]:
    """Settings a surveyor would choose for the scene: sections and keys. The region holds the
    outline and its ring of ground.
    """
    chosen = {
        section: dict(values) for section, values in SUITED[KINDS.get(scene.name, "pile")].items()
    }
    volume = chosen["volume"]
    if volume.get("outline") == "polygon":
        volume["polygon_m"] = [float(round(v, 3)) for v in scene.outline.ravel()]
    if "georeference" not in chosen:
        ring = volume["ground_ring_m"]
        (x0, y0), (x1, y1) = scene.outline.min(axis=0) - ring, scene.outline.max(axis=0) + ring
        chosen["georeference"] = {
            "region_m": [float(round(v, 3)) for v in (x0, y0, -10.0, x1, y1, 30.0)]
        }
    return chosen
