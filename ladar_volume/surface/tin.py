"""A full TIN: every point is a vertex (seed 000 section 2, "full triangulation")."""

from __future__ import annotations

import numpy as np

from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I32, Bool, Tin
from ladar_volume.surface.delaunay import delaunay, first_copies


def build_tin(points_map: F64) -> Tin:
    """Delaunay TIN over the horizontal plane of points (n, 3), m, map frame; all triangles relevant.

    Of points with exactly equal x and y the first is kept; ``duplicates`` counts the others. Raises :class:`SurfaceError` for
    NaN, fewer than three distinct points, or collinear ones.
    """
    points = np.asarray(points_map, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise SurfaceError(f"points are (n, 3), not {points.shape}", reason="surface_shape", value=points.shape)
    if not np.isfinite(points).all():
        raise SurfaceError("a point with a coordinate that is not finite", reason="surface_not_finite")
    source = first_copies(points[:, :2])
    vertices = np.ascontiguousarray(points[source])
    triangles, neighbours = delaunay(vertices[:, :2])
    relevant = np.ones(len(triangles), bool)
    return Tin(vertices, triangles, neighbours, relevant, source, len(points) - len(source))


def footprint_areas(vertices: F64, triangles: I32) -> F64:
    """Signed horizontal areas (m,) m² of triangles (m, 3) over vertices (n, 3); positive counter-clockwise from above."""
    a, b, c = (vertices[triangles[:, k], :2] for k in range(3))
    out: F64 = 0.5 * ((b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0]))
    return out


def vertex_mask(tin: Tin, mask: Bool) -> Bool:
    """Vertices (n,) of the triangles chosen by ``mask`` (m,)."""
    out = np.zeros(len(tin.vertices), bool)
    out[tin.triangles[mask]] = True
    return out
