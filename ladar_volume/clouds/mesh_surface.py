"""A mesh as the surface of a cloud: its faces as they are, or fewer of its vertices."""

from __future__ import annotations

import dataclasses

import numpy as np

from ladar_volume.clouds.cloud_surface import CloudSurface, noise
from ladar_volume.clouds.given_faces import doubts_of, given_surface, total_area
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I32, Tin
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.model.verdict import Doubt
from ladar_volume.tin.boundary import edit_boundary
from ladar_volume.tin.locate import locate, triangle_index
from ladar_volume.tin.relevant import with_relevant
from ladar_volume.tin.represent import RepresentedSurface, represent
from ladar_volume.volume.overlay import volumes_between

#: What a mesh's sigma is where no one gives it.
UNKNOWN = "unknown: a mesh has no noise of its own"


def surface_of_faces(tin: Tin, options: SurfaceParameters) -> RepresentedSurface:
    """The faces as they are, with the limits of the options on which of them count. Their heights
    are those of the vertices, which nothing is adjusted to.
    """
    by = options.relevant if options.relevant in ("edge", "circumcircle") else "all"
    tin = with_relevant(tin, by, options.max_edge_m, options.max_circumdiameter_m)
    limits = options.max_ear_edge_m, options.min_island_m2, options.max_hole_m2
    if limits != (np.inf, 0.0, 0.0):
        tin = edit_boundary(tin, *limits).tin
    n = len(tin.vertices)
    return RepresentedSurface(tin, None, "none", True, 0, 0, 0, 0.0, 0.0, n, 0.0, 0.0)


def reduce_vertices(
    given: Tin, options: SurfaceParameters, sigma_m: F64 | None
) -> tuple[RepresentedSurface, tuple[Doubt, ...]]:
    """A TIN through fewer of the vertices, over the same footprint, and what it misses the faces
    by.

    Triangles whose middle is over no face do not count. Raises :class:`SurfaceError` where none is
    left.
    """
    made = represent(given.vertices, options, sigma_m)
    tin = made.tin
    middle = tin.vertices[tin.triangles][:, :, :2].mean(axis=1)
    over = locate(triangle_index(given, given.relevant), middle) >= 0
    if not (tin.relevant & over).any():
        raise SurfaceError(
            "too few vertices are left for a surface; give more (--vertices)",
            reason="surface_no_relevant",
        )
    tin = dataclasses.replace(tin, relevant=tin.relevant & over)
    apart, area = volumes_between(tin, given, gradients=False), total_area(given)
    lost, more = area - apart.area_m2, total_area(tin) - apart.area_m2
    depth = (apart.cut_m3 + apart.fill_m3) / apart.area_m2
    text = (
        f"thinned from {len(given.vertices):,} to {len(tin.vertices):,} vertices: {depth:.3g} m "
        f"from the given faces on the mean (net {apart.cut_m3 - apart.fill_m3:+.4g} m³), "
        f"{lost:.4g} m² of their footprint lost and {more:.4g} m² added; keep more vertices where "
        "that matters"
    )
    made = dataclasses.replace(made, tin=tin)
    return made, (Doubt("mesh_thinned", text, apart.cut_m3 - apart.fill_m3),)


def mesh_surface(
    vertices: F64,
    triangles: I32,
    options: SurfaceParameters | None = None,
    sigma_m: F64 | float | None = None,
    sigma_from: str = "",
    thin: bool = False,
) -> CloudSurface:
    """The surface of a mesh (n, 3), (m, 3), in the frame its vertices are given in.

    sigma_m : standard deviation of the heights, one for all or (n,), None where it is not known:
    then it stays so · thin : fewer vertices, as the options say, in place of the faces. Raises
    :class:`SurfaceError` as :func:`~ladar_volume.clouds.given_faces.given_surface`.
    """
    o = options or SurfaceParameters(ratio=1.0)
    found = given_surface(np.asarray(vertices, dtype=np.float64), triangles)
    sigma: F64 | None = None
    words = UNKNOWN
    if sigma_m is not None:
        own = sigma_m[found.index] if isinstance(sigma_m, np.ndarray) and sigma_m.ndim else sigma_m
        sigma, words = noise(found.tin.vertices, own, sigma_from)
    made, more = (
        reduce_vertices(found.tin, o, sigma) if thin else (surface_of_faces(found.tin, o), ())
    )
    return CloudSurface(
        found.tin.vertices,
        found.index,
        sigma,
        words,
        np.zeros(0, np.int64),
        made,
        given_faces=found,
        doubts=doubts_of(found) + more,
    )
