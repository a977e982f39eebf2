"""Triangulation in spherical projection about the scanner, so that steep and overhanging walls work
(seed 003 section 3).

Seen from its scanner a surface never covers itself: direction is a coordinate pair that every scan
has. Directions are projected stereographically, which keeps circles: the plane Delaunay
triangulation of the projected directions is the Delaunay triangulation on the sphere, free of the
seams and crowded poles of an azimuth and elevation grid. The one point that has no image is put
where the scan has its widest gap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, Bool, Tin
from ladar_volume.tin.delaunay import triangulate
from ladar_volume.tin.full_tin import places_in
from ladar_volume.tin.scan_frame import check_cloud, frame_along

#: Directions that are tried for the widest gap.
GAP_DIRECTIONS = 400


@dataclass(frozen=True)
class SphericalTin:
    """A surface over the directions of a scanner.

    tin : vertices in the map, triangles counter-clockwise as seen from the scanner, their normals
    towards it · projected : (n, 2), stereographic image of each vertex, in which the triangulation
    is Delaunay · scanner_map : (3,) m · gap_map : (3,) unit, the direction without image
    """

    tin: Tin
    projected: F64
    scanner_map: F64
    gap_map: F64


def unit_directions(points_map: F64, scanner_map: F64) -> tuple[F64, F64]:
    """Directions (n, 3), unit, and ranges (n,), m, of points as seen from the scanner (3,).

    Raises :class:`SurfaceError` for points that are no finite (n, 3) array, or one at the scanner.
    """
    points, scanner = check_cloud(points_map, 3), np.asarray(scanner_map, dtype=np.float64)
    if scanner.shape != (3,) or not np.isfinite(scanner).all():
        raise SurfaceError(
            "the scanner's position is three finite numbers",
            reason="surface_scanner",
            value=scanner_map,
        )
    ray = points - scanner
    distance = np.linalg.norm(ray, axis=1)
    if float(distance.min()) <= 1e-9 * float(distance.max()):
        raise SurfaceError(
            f"point {int(distance.argmin())} lies at the scanner",
            reason="surface_scanner",
            value=int(distance.argmin()),
        )
    return ray / distance[:, None], distance


def widest_gap(directions: F64) -> F64:
    """The direction (3,), unit, among an even spread and the one opposite the mean, that is
    farthest from all directions (n, 3).
    """
    k = np.arange(GAP_DIRECTIONS)
    z, turn = 1.0 - 2.0 * (k + 0.5) / GAP_DIRECTIONS, k * 2.399963229728653
    s = np.sqrt(1.0 - z * z)
    tried = np.stack([s * np.cos(turn), s * np.sin(turn), z], axis=1)
    mean = directions.mean(axis=0)
    size = float(np.linalg.norm(mean))
    if size > 1e-6:
        tried = np.concatenate([-mean[None] / size, tried])
    nearest = np.full(len(tried), -1.0)
    for start in range(0, len(directions), 10_000):  # in pieces, for the memory
        nearest = np.maximum(nearest, (directions[start : start + 10_000] @ tried.T).max(axis=0))
    out: F64 = tried[int(np.argmin(nearest))]
    return out


def stereographic(directions: F64, gap: F64) -> F64:
    """Images (n, 2) of unit directions (n, 3), projected from ``gap`` (3,); counter-clockwise as
    seen from the scanner.
    """
    d = directions @ frame_along(-gap).R_frame_map.T
    out: F64 = d[:, :2] / (1.0 - d[:, 2:])
    return out


def build_spherical(
    points_map: F64,
    scanner_map: F64,
    max_angle_rad: float = np.inf,
    max_edge_m: float = np.inf,
    gap_map: F64 | None = None,
) -> SphericalTin:
    """Delaunay triangulation of points (n, 3), m, map frame, over their directions from the scanner
    (3,).

    Of points in exactly one direction the first is kept; ``tin.duplicates`` counts the others.
    Triangles with an edge seen under more than ``max_angle_rad`` or longer than ``max_edge_m`` are
    not relevant: those across the gap, and where asked, those that jump from a front edge to what
    is behind. Raises :class:`SurfaceError` for fewer than three directions, all in one plane with
    the scanner's gap, points not finite or at the scanner, or where no triangle is relevant.
    """
    direction, _ = unit_directions(points_map, scanner_map)
    gap = (
        widest_gap(direction)
        if gap_map is None
        else np.asarray(gap_map, dtype=np.float64) / np.linalg.norm(gap_map)
    )
    flat = stereographic(direction, gap)
    out = triangulate(flat)
    points = np.asarray(points_map, dtype=np.float64)
    source, triangles = out.vertices, out.triangles
    if len(source) < len(points):
        triangles = places_in(source, len(points))[triangles]
    vertices = points[source]
    relevant = short_edges(direction[source], triangles, max_angle_rad) & short_edges(
        vertices, triangles, max_edge_m, angle=False
    )
    if not relevant.any():
        raise SurfaceError(
            "no triangle is within the limits of angle and edge", reason="surface_no_relevant"
        )
    tin = Tin(vertices, triangles, out.neighbours, relevant, source, len(points) - len(source))
    return SphericalTin(tin, flat[source], np.asarray(scanner_map, dtype=np.float64), gap)


def short_edges(vertices: F64, triangles: np.ndarray, limit: float, angle: bool = True) -> Bool:
    """Triangles (m,) whose three edges are within a limit: an angle, rad, between unit directions
    (n, 3), or a length, m, of points.
    """
    if limit == np.inf:
        return np.ones(len(triangles), bool)
    chord = 2.0 * np.sin(0.5 * min(limit, np.pi)) if angle else limit
    corner = vertices[triangles]
    out: Bool = (np.linalg.norm(corner - corner[:, [1, 2, 0]], axis=2) <= chord).all(axis=1)
    return out


def normals_towards(tin: Tin) -> F64:
    """Unit normals (n, 3) of the vertices, towards the scanner: the mean of their relevant
    triangles' by area.
    """
    p = tin.vertices[tin.triangles[tin.relevant]]
    face = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    index = tin.triangles[tin.relevant]
    out = np.stack(
        [np.bincount(index.ravel(), np.repeat(face[:, k], 3), len(tin.vertices)) for k in range(3)],
        axis=1,
    )
    size = np.linalg.norm(out, axis=1)
    out[size == 0.0] = [0.0, 0.0, 1.0]  # a vertex of no relevant triangle
    unit: F64 = out / np.where(size > 0.0, size, 1.0)[:, None]
    return unit
