"""The parameters of bodies in a cloud: objects on the ground, local meshes, edges and closing."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from ladar_volume.model.choices import REPAIRS
from ladar_volume.model.errors import ObjectError, SurfaceError
from ladar_volume.model.parameter import param
from ladar_volume.model.records import F64

#: Normals that enclose more than this are of two faces, radians.
SHARP_RAD = math.radians(30.0)


@dataclass(frozen=True)
class ObjectParameters:
    """What an object on the ground is. A point is above the ground by more than ``min_height_m``
    and by more than ``sigmas``. Raises :class:`ObjectError`.
    """

    min_height_m: float = param(0.15, "Least height (m) of an object above the ground.", unit="m")
    sigmas: float = param(3.5, "Least height in standard deviations of the ground.")
    distance_m: float = param(0.3, "Longest step (m) between points of one object.", unit="m")
    min_points: int = param(30, "Fewest points of an object.")
    split_m: float = param(
        0.0,
        "Objects that rise this far above the saddle between them are parted; 0 for none.",
        unit="m",
    )
    step_m: float = param(0.3, "Horizontal reach of a terrace's edge.", unit="m")
    pick_reach_m: float = param(1.0, "An object is within this of a picked point.", unit="m")
    pits: bool = param(False, "Clusters below the ground are listed too, after the objects.")

    def __post_init__(self) -> None:
        if not (
            min(self.distance_m, self.step_m) > 0
            and self.min_points >= 1
            and min(self.min_height_m, self.sigmas, self.split_m) >= 0
        ):
            raise ObjectError(
                (
                    "objects need distance_m > 0, step_m > 0, min_points >= 1, and no "
                    "negative height or sigmas"
                ),
                reason="object_parameters",
            )


@dataclass(frozen=True)
class LocalMeshParameters:
    """A mesh of any orientation. Method ``published`` is Algorithm 2; it needs a radius, and it
    alone reads ``longest_m`` and ``repair``. ``signed`` : otherwise only the lines of the normals
    count, and signs are found from the cloud, which bodies that touch can mislead. Raises
    :class:`SurfaceError` (mesh_settings).
    """

    radius_m: float = param(
        0.0,
        "Longest edge of the mesh, and reach of a point's neighbourhood; 0: from the spacing.",
        unit="m",
    )
    hole_m: float = param(
        0.0,
        "Diameter of the largest hole that is closed; 0: 1.5 times the longest edge.",
        unit="m",
    )
    signed: bool = param(False, "Given normals point outward as they are.")
    method: str = param(
        "agreement", "How triangles are chosen.", choices=("agreement", "published")
    )
    longest_m: float = param(0.0, "Longest edge of the published method; 0: its radius.", unit="m")
    repair: str = param(
        "both", "What is done about false and empty triangles of Algorithm 2.", choices=REPAIRS
    )

    def __post_init__(self) -> None:
        for length in (self.radius_m, self.hole_m, self.longest_m):
            if not (math.isfinite(length) and length >= 0.0):
                raise SurfaceError(f"a length of {length} m", reason="mesh_settings", value=length)
        if self.method not in ("agreement", "published") or self.repair not in REPAIRS:
            raise SurfaceError(
                f"no method {self.method!r} or repair {self.repair!r}",
                reason="mesh_settings",
                value=self.method,
            )
        if self.method == "published" and self.radius_m == 0.0:
            raise SurfaceError(
                "the published method needs a radius", reason="mesh_settings", value=self.radius_m
            )


@dataclass(frozen=True)
class BodyParameters:
    """mesh : of the local meshes · pole_map : (3,) m, common corner of the tetrahedra"""

    mesh: LocalMeshParameters = field(default_factory=LocalMeshParameters)
    close_m: float = param(
        0.0,
        "Widest gap, and distance of a rim to the ground, to close; 0: two longest edges.",
        unit="m",
    )
    sharp_rad: float = param(
        SHARP_RAD,
        "Faces at more than this meet in an edge; 0: no edges are completed.",
        low=0,
        high=180,
    )
    pole_map: F64 | None = None
