"""Meshing in any direction (seed 000 section 5.4): a TIN needs one height per footprint, which a
frame along the scan provides.

In a scan frame the z axis points back at the instrument, against the general scan direction;
vertical walls then have a footprint and heights. Volumes do not depend on the frame, gradients turn
with it.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, Tin
from ladar_volume.tin.delaunay import finite_points
from ladar_volume.tin.full_tin import build_tin

#: Points and first directions of a search, and the rounds by which it is narrowed.
SEARCH_POINTS, SEARCH_DIRECTIONS, SEARCH_ROUNDS = 20_000, 96, 4


@dataclass(frozen=True)
class Frame:
    """A turned frame: ``r_frame = R_frame_map (r_map − origin_map)``. R_frame_map : (3, 3) rotation
    · origin_map : (3,) m
    """

    R_frame_map: F64
    origin_map: F64

    def points(self, r_map: F64) -> F64:
        """Points (n, 3) of the map in this frame, m."""
        out: F64 = (np.asarray(r_map, dtype=np.float64) - self.origin_map) @ self.R_frame_map.T
        return out

    def points_to_map(self, r_frame: F64) -> F64:
        """Points (n, 3) of this frame in the map, m."""
        out: F64 = np.asarray(r_frame, dtype=np.float64) @ self.R_frame_map + self.origin_map
        return out

    def gradients_to_map(self, gradient: F64) -> F64:
        """Gradients (n, 3) by positions in this frame, turned into the map."""
        out: F64 = np.asarray(gradient, dtype=np.float64) @ self.R_frame_map
        return out

    def covariances(self, C_map: F64) -> F64:
        """Covariances (n, 3, 3) of the map in this frame."""
        out: F64 = self.R_frame_map @ C_map @ self.R_frame_map.T
        return out

    def plane(self, beta: F64) -> F64:
        """The plane ``z = c0 + c1 x + c2 y`` of the map, beta (3,), in this frame, (3,). Raises
        :class:`SurfaceError` where it stands upright in it.
        """
        c0, c1, c2 = (float(c) for c in beta)
        upright = np.array([-c1, -c2, 1.0])
        a: F64 = self.R_frame_map @ upright
        if abs(a[2]) < 1e-6 * float(np.linalg.norm(a)):
            words = "the plane runs along the scan direction: no surface lies above it"
            raise SurfaceError(words, reason="surface_direction", value=(c0, c1, c2))
        return np.array(
            [float(c0 - upright @ self.origin_map), -a[0], -a[1]], dtype=np.float64
        ) / float(a[2])

    def tin_to_map(self, tin: Tin) -> Tin:
        """A TIN built in this frame with its vertices in the map: a mesh for export, no TIN over
        the map's plane.
        """
        return dataclasses.replace(tin, vertices=self.points_to_map(tin.vertices))


def frame_along(direction: F64, origin_map: F64 | None = None) -> Frame:
    """The frame whose z axis points against ``direction`` (3,), its x axis horizontal in the map
    (east for a vertical direction).

    Raises :class:`SurfaceError` for a direction of length zero or not finite.
    """
    d = np.asarray(direction, dtype=np.float64)
    length = float(np.linalg.norm(d)) if d.shape == (3,) and np.isfinite(d).all() else 0.0
    if length == 0.0:
        raise SurfaceError(
            "a scan direction is three finite numbers, not all zero",
            reason="surface_direction",
            value=direction,
        )
    z = -d / length
    x = np.array([-z[1], z[0], 0.0])
    steep = float(np.hypot(z[0], z[1]))
    x = x / steep if steep > 1e-12 else np.array([1.0, 0.0, 0.0])
    return Frame(
        np.stack([x, np.cross(z, x), z]),
        np.zeros(3) if origin_map is None else np.asarray(origin_map, dtype=np.float64),
    )


def mean_direction(points_map: F64, scanner_map: F64) -> F64:
    """General scan direction (3,), unit: the mean of the directions from the scanner (3,) to the
    points (n, 3), all m, map frame.

    Raises :class:`SurfaceError` where it is not defined: no points, or points all around.
    """
    ray = check_cloud(points_map, 1) - np.asarray(scanner_map, dtype=np.float64)
    length = np.linalg.norm(ray, axis=1)
    ray = ray[length > 0] / length[length > 0, None]
    mean = ray.mean(axis=0) if len(ray) else np.zeros(3)
    size = float(np.linalg.norm(mean))
    if size < 0.1:
        raise SurfaceError(
            "the points lie all around the scanner: there is no general direction",
            reason="surface_direction",
            value=size,
        )
    out: F64 = mean / size
    return out


def search_direction(points_map: F64, guess: F64 | None = None) -> F64:
    """General scan direction (3,), unit, of points (n, 3) whose scanner is not known: the one along
    which they mesh best.

    Seen from the scanner neighbours in the picture are neighbours in space; from elsewhere near and
    far surfaces interlace. The measure is the mean log length in space of the edges of the Delaunay
    triangulation, over a hemisphere about ``guess`` (default: straight down, as scanners mostly
    look down) and then ever closer; an even spread of at most 20,000 points is used. Where little
    is hidden, many directions serve: the one found lies among them, not always near the mean
    direction. Some seconds for 10,000 points.
    """
    points = check_cloud(points_map, 4)
    points = points[
        np.linspace(0, len(points) - 1, min(len(points), SEARCH_POINTS)).astype(np.int64)
    ]
    best = (
        np.array([0.0, 0.0, -1.0])
        if guess is None
        else np.asarray(guess, dtype=np.float64) / np.linalg.norm(guess)
    )
    lowest, width, count = np.inf, 1.0, SEARCH_DIRECTIONS
    for _ in range(SEARCH_ROUNDS):
        # a sunflower on the cap about the best direction so far; width 1 is the hemisphere
        k = np.arange(count)
        c, turn = 1.0 - width * (k + 0.5) / count, k * 2.399963229728653
        s = np.sqrt(1.0 - c * c)
        cap = (
            np.stack([s * np.cos(turn), s * np.sin(turn), c], axis=1)
            @ frame_along(-best).R_frame_map
        )
        cost = [mesh_cost(points, d) for d in cap]
        if min(cost) < lowest:
            lowest, best = min(cost), cap[int(np.argmin(cost))]
        width, count = width * 0.2, 32
    return best


def mesh_cost(points_map: F64, direction: F64) -> float:
    """Mean log length in space of the edges of the Delaunay triangulation of points (n, 3) seen
    along a direction (3,).
    """
    turned = frame_along(direction).points(points_map)
    try:
        tin = build_tin(turned)
    except SurfaceError:  # all in one line as seen from there
        return float("inf")
    inner = (tin.neighbours >= 0).all(axis=1)
    corners = tin.vertices[tin.triangles[inner] if inner.any() else tin.triangles]
    length = np.linalg.norm(corners - corners[:, [1, 2, 0]], axis=2)
    return float(np.log(np.maximum(length, 1e-300)).mean())


def check_cloud(points_map: F64, least: int) -> F64:
    """Points as (n, 3) float64. Raises :class:`SurfaceError` for another shape, too few, or a value
    that is not finite.
    """
    points = finite_points(points_map)
    if len(points) < least:
        raise SurfaceError(
            f"a direction needs {least} points, there are {len(points)}",
            reason="surface_too_few_points",
            value=len(points),
        )
    return points
