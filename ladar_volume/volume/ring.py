"""The common boundary of two surfaces: a closed ring of sight lines, and where it meets each surface.

Each line of the ring runs from its origin towards the surfaces: all from one apex (then the ring cuts both by a cone, which serves walls
and overhangs), or straight down over a polygon in plan (pits with firm ground around). Between the two surfaces the ring is a wall.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ladar_volume.model.errors import VolumeError
from ladar_volume.model.kernels import kernel
from ladar_volume.model.records import F64, I32, I64, Tin

#: How far outside a triangle, in barycentric coordinates, a line still meets it: lines through shared edges must not slip between.
EDGE_TOLERANCE = 1e-9


@dataclass(frozen=True)
class Ring:
    """A closed ring of lines. origin : (k, 3) m · direction : (k, 3) unit; line k + 1 follows line k, the first the last."""

    origin: F64
    direction: F64

    def __len__(self) -> int:
        return len(self.origin)

    def reversed(self) -> Ring:
        """The same ring the other way round."""
        return Ring(self.origin[::-1].copy(), self.direction[::-1].copy())

    def middles(self, rows: I64) -> Ring:
        """Lines midway between those of ``rows`` and the next ones."""
        after = (rows + 1) % len(self)
        d = self.direction[rows] + self.direction[after]
        return Ring(0.5 * (self.origin[rows] + self.origin[after]), d / np.linalg.norm(d, axis=1)[:, None])

    def insert(self, rows: I64, more: Ring) -> Ring:
        """The ring with one line of ``more`` after each of ``rows``."""
        return Ring(np.insert(self.origin, rows + 1, more.origin, axis=0), np.insert(self.direction, rows + 1, more.direction, axis=0))


def densify(corners: F64, spacing_m: float) -> F64:
    """Points (k, d) along a closed polygon (c, d) at steps of at most ``spacing_m``, its corners among them."""
    c = np.asarray(corners, dtype=np.float64)
    if c.ndim != 2 or len(c) < 3 or not np.isfinite(c).all():
        raise VolumeError(f"a ring needs at least three finite corners, not an array {c.shape}", reason="ring_corners", value=c.shape)
    if not spacing_m > 0.0:
        raise VolumeError(f"a spacing of {spacing_m} m; it must be above zero", reason="ring_spacing", value=spacing_m)
    after = np.roll(c, -1, axis=0)
    length = np.linalg.norm(after - c, axis=1)
    if (length == 0.0).any():
        keep = length > 0.0
        return densify(c[keep], spacing_m)
    parts = [
        a + (b - a) * np.linspace(0.0, 1.0, max(1, int(np.ceil(s / spacing_m))), endpoint=False)[:, None]
        for a, b, s in zip(c, after, length, strict=True)
    ]
    return np.concatenate(parts)


def ring_through(corners_map: F64, apex_map: F64, spacing_m: float) -> Ring:
    """Lines from an apex (3,) through a polygon of points (c, 3), m, map frame, at steps of at most ``spacing_m`` along it."""
    p, apex = densify(corners_map, spacing_m), np.asarray(apex_map, dtype=np.float64)
    d = p - apex
    length = np.linalg.norm(d, axis=1)
    if not (length > 0.0).all():
        raise VolumeError("the ring runs through its apex", reason="ring_corners", value=apex_map)
    return Ring(np.repeat(apex[None], len(p), axis=0), d / length[:, None])


def ring_over(polygon_xy: F64, top_m: float, spacing_m: float) -> Ring:
    """Lines straight down from the height ``top_m`` over a polygon (c, 2), m, map frame, at steps of at most ``spacing_m`` along it."""
    p = densify(polygon_xy, spacing_m)
    origin = np.concatenate([p, np.full((len(p), 1), float(top_m))], axis=1)
    return Ring(origin, np.repeat([[0.0, 0.0, -1.0]], len(p), axis=0))


@kernel
def cast_kernel(corners: F64, centre: F64, radius2: F64, origin: F64, direction: F64, triangle: I64, weight: F64, reach: F64) -> None:
    """First triangle (k,) along each line, barycentric coordinates there (k, 3) and distance (k,); −1 where there is none.

    corners : (m, 3, 3) · centre, radius2 : a ball about each triangle, by which most are passed over (Moeller & Trumbore 1997)
    """
    for i in range(len(origin)):
        ox, oy, oz, dx, dy, dz = origin[i, 0], origin[i, 1], origin[i, 2], direction[i, 0], direction[i, 1], direction[i, 2]
        best, found = np.inf, -1
        for t in range(len(corners)):
            px, py, pz = centre[t, 0] - ox, centre[t, 1] - oy, centre[t, 2] - oz
            along = px * dx + py * dy + pz * dz
            if px * px + py * py + pz * pz - along * along > radius2[t]:
                continue
            a = corners[t, 0]
            e1x, e1y, e1z = corners[t, 1, 0] - a[0], corners[t, 1, 1] - a[1], corners[t, 1, 2] - a[2]
            e2x, e2y, e2z = corners[t, 2, 0] - a[0], corners[t, 2, 1] - a[1], corners[t, 2, 2] - a[2]
            hx, hy, hz = dy * e2z - dz * e2y, dz * e2x - dx * e2z, dx * e2y - dy * e2x
            det = e1x * hx + e1y * hy + e1z * hz
            if det == 0.0:
                continue
            sx, sy, sz = ox - a[0], oy - a[1], oz - a[2]
            u = (sx * hx + sy * hy + sz * hz) / det
            qx, qy, qz = sy * e1z - sz * e1y, sz * e1x - sx * e1z, sx * e1y - sy * e1x
            v = (dx * qx + dy * qy + dz * qz) / det
            s = (e2x * qx + e2y * qy + e2z * qz) / det
            if u >= -EDGE_TOLERANCE and v >= -EDGE_TOLERANCE and u + v <= 1.0 + EDGE_TOLERANCE and 0.0 < s < best:
                best, found = s, t
                weight[i, 0], weight[i, 1], weight[i, 2] = 1.0 - u - v, u, v
        triangle[i], reach[i] = found, best


@dataclass(frozen=True)
class Hits:
    """Where lines meet a surface. point : (k, 3) m · corner : (k, 3) int32, vertices of the triangle met · weight : (k, 3) barycentric ·
    distance : (k,) m along the line"""

    point: F64
    corner: I32
    weight: F64
    distance: F64

    def insert(self, rows: I64, more: Hits) -> Hits:
        """With one hit of ``more`` after each of ``rows``."""
        at = rows + 1
        return Hits(
            np.insert(self.point, at, more.point, axis=0), np.insert(self.corner, at, more.corner, axis=0),
            np.insert(self.weight, at, more.weight, axis=0), np.insert(self.distance, at, more.distance),
        )  # fmt: skip

    def reversed(self) -> Hits:
        """In the order of the reversed ring."""
        return Hits(self.point[::-1], self.corner[::-1], self.weight[::-1], self.distance[::-1])


def cast(ring: Ring, tin: Tin, name: str) -> Hits:
    """Where the lines of a ring first meet the relevant triangles of a surface. ``name`` stands in the error.

    Raises :class:`VolumeError` (ring_off_surface; value: the lines (k,) that miss).
    """
    t = tin.triangles[tin.relevant]
    corners = tin.vertices[t]
    centre = corners.mean(axis=1)
    radius2 = ((corners - centre[:, None]) ** 2).sum(axis=2).max(axis=1) * (1.0 + 1e-6)
    found, weight, reach = np.empty(len(ring), np.int64), np.zeros((len(ring), 3)), np.empty(len(ring))
    cast_kernel(corners, centre, radius2, np.ascontiguousarray(ring.origin), np.ascontiguousarray(ring.direction), found, weight, reach)
    if (found < 0).any():
        raise VolumeError(
            f"{int((found < 0).sum())} of {len(ring)} lines of the ring miss surface {name}: select more of it around the ring (a margin)",
            reason="ring_off_surface", value=np.flatnonzero(found < 0),
        )  # fmt: skip
    return Hits(ring.origin + reach[:, None] * ring.direction, t[found], weight, reach)


def pull(gradient: F64, ring: Ring, hits: Hits, vertices: F64, into: F64) -> None:
    """Add to ``into`` (n, 3) what a gradient (k, 3) by the ring's points on a surface means for the vertices (n, 3) they hang on.

    A vertex that moves by δ lifts the plane of its triangle, so the point slides along its line by ``w n·δ / (n·d)``.
    """
    p = vertices[hits.corner]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    slide = (gradient * ring.direction).sum(axis=1) / (normal * ring.direction).sum(axis=1)
    for k in range(3):
        np.add.at(into, hits.corner[:, k], (slide * hits.weight[:, k])[:, None] * normal)
