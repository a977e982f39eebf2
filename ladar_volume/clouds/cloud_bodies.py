"""From a filtered cloud to its bodies: ground, objects, mesh, edges, closing, volume, uncertainty
(seed 002 chapters 5 to 7 in one line).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ladar_volume.clouds.body_volume import Body, body_of, published_body
from ladar_volume.mesh.local_mesh import LocalMesh, mesh_cloud
from ladar_volume.mesh.topology import orient
from ladar_volume.model.body_parameters import BodyParameters
from ladar_volume.model.errors import SurfaceError, VolumeError
from ladar_volume.model.records import F64, I32, I64, Bool, Plane

#: A gap is closed, and a rim drawn on to the ground, over this many longest edges where no size is
#: given.
CLOSE = 2.0
#: Least height of an object's points in sigmas of the raw noise: ground points within it can come
#: to lie on a wall drawn on beyond its end.
CLEAR = 2.0
#: Fewest points at different places that are a body.
FEWEST = 4
#: A part of the mesh that has fewer triangles than this share of all, and is open or tiny, is a
#: stray piece.
STRAY = 0.02
NO_BODY = (
    "no body: no point stands above the ground; give the ground, or ask for less "
    "height or fewer points of an object"
)


@dataclass(frozen=True)
class FailedBody:
    """number : its label · points : how many · middle_m, low_m, high_m : (3,) mean and corners of
    its points · reason : one sentence
    """

    number: int
    points: int
    middle_m: F64
    low_m: F64
    high_m: F64
    reason: str


@dataclass(frozen=True)
class CloudBodies:
    """bodies · sources : (k,) of each, the point of each measured vertex · meshes : as built,
    before edges and closing · stray : triangles left out, per body · ground : where they stand,
    None for bodies seen from all sides · numbers : label of each body · failed : labels of which
    no body came
    """

    bodies: tuple[Body, ...]
    sources: tuple[I64, ...]
    meshes: tuple[LocalMesh, ...]
    stray: tuple[int, ...]
    ground: Plane | None
    numbers: tuple[int, ...] = ()
    failed: tuple[FailedBody, ...] = ()


def cloud_bodies(
    points: F64,
    normals: F64 | None,
    curved: Bool | None,
    label: I64,
    ground: Plane | None,
    options: BodyParameters | None = None,
    step: Callable[[int, int], None] = lambda number, many: None,
) -> CloudBodies:
    """The bodies of a filtered cloud.

    points : (n, 3) m · normals : (n, 3), of either sign, or None · curved : (n,) whether the
    surface there is curved, None where normals tell · label : (n,) body of each point, −1 for none
    · ground : None where bodies are seen from all sides · step : called with the number of each
    body and how many there are, before it is made. Raises :class:`VolumeError` (volume_no_body)
    where no point is in a body and :class:`SurfaceError` where none can be meshed and closed; the
    others are ``failed``.
    """
    o = options or BodyParameters()
    many = int(label.max(initial=-1)) + 1
    if many == 0:
        raise VolumeError(NO_BODY, reason="volume_no_body")
    made, numbers, failed, errors = [], [], [], []
    for number in range(many):
        step(number, many)
        rows = np.flatnonzero(label == number).astype(np.int64)
        try:
            made.append((*body_at(points, normals, curved, rows, ground, o), rows))
            numbers.append(number)
        except SurfaceError as error:
            errors.append(error)
            failed.append(failed_body(number, points[rows], str(error)))
    if not made:
        name = f"none of {many} bodies can be made; body 1: " if many > 1 else ""
        first = errors[0]
        raise SurfaceError(f"{name}{first}", reason=first.reason, value=first.value) from first
    bodies, meshes, stray, sources = zip(*made, strict=True)
    return CloudBodies(bodies, sources, meshes, stray, ground, tuple(numbers), tuple(failed))


def failed_body(number: int, at: F64, reason: str) -> FailedBody:
    """An object of points (k, 3) m of which no body came."""
    place = (at.mean(axis=0), at.min(axis=0), at.max(axis=0))
    return FailedBody(number, len(at), *place, reason)


def body_at(
    points: F64,
    normals: F64 | None,
    curved: Bool | None,
    rows: I64,
    ground: Plane | None,
    o: BodyParameters,
) -> tuple[Body, LocalMesh, int]:
    """The body of some of the points, its mesh, and how many triangles were left out."""
    mesh = mesh_cloud(points[rows], None if normals is None else normals[rows], o.mesh)
    _check_points(len(rows) - int(mesh.report["duplicates"]))
    if o.mesh.method == "published":
        if ground is not None:
            raise SurfaceError(
                "the published mesh is not closed on a ground: --ground none, or no --repair",
                reason="mesh_settings",
            )
        return published_body(mesh, o.pole_map), mesh, 0
    close_m = o.close_m or CLOSE * float(mesh.report["radius_m"])
    triangles, left = remove_stray_parts(mesh)
    body = body_of(
        mesh.vertices,
        triangles,
        None if normals is None else mesh.normals,
        None if curved is None else curved[rows],
        close_m,
        ground,
        o.sharp_rad or None,
        o.pole_map,
        allow_crossings=True,
    )
    _check_size(body, mesh)
    return body, mesh, left


def _check_points(places: int) -> None:
    """Refuses fewer points at different places than a body has."""
    if places < FEWEST:
        raise SurfaceError(
            f"{places} points at different places are no body: scan it more densely, or "
            "ask for more points of an object (--min-points)",
            reason="mesh_points",
            value=places,
        )


def _check_size(body: Body, mesh: LocalMesh) -> None:
    """Refuses a body smaller than the spacing of its points."""
    size_m, spacing_m = float(np.cbrt(abs(body.volume_m3))), float(mesh.report["spacing_m"])
    if size_m < spacing_m:
        raise SurfaceError(
            f"its size of {size_m:.2g} m (cube root of the volume) is less than the spacing of its "
            f"points, {spacing_m:.2g} m: scan it more densely",
            reason="body_small",
            value=size_m,
        )


def remove_stray_parts(mesh: LocalMesh) -> tuple[I32, int]:
    """The triangles of a mesh without parts too small to be bodies: open ones of few triangles,
    closed ones that would fit through the largest hole that is closed. And how many were left out.
    """
    found = orient(mesh.vertices, mesh.triangles)
    size = np.bincount(found.part)
    is_open = np.zeros(len(size), bool)
    is_open[found.part[np.isin(mesh.triangles, found.boundary).any(axis=1)]] = True
    small = size < STRAY * len(mesh.triangles)
    rows = np.flatnonzero(small[found.part])
    at, part = mesh.vertices[mesh.triangles[rows]], found.part[rows]
    low, high = np.full((len(size), 3), np.inf), np.full((len(size), 3), -np.inf)
    np.minimum.at(low, part, at.min(axis=1))
    np.maximum.at(high, part, at.max(axis=1))
    narrow = np.linalg.norm(high - low, axis=1) < float(mesh.report["hole_m"])
    few = small & (is_open | narrow)
    keep = ~few[found.part]
    return mesh.triangles[keep], int(np.count_nonzero(~keep))
