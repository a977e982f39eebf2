"""The common boundary of two surfaces: a closed ring of sight lines, and where it meets each
surface.

Each line of the ring runs from its origin towards the surfaces: all from one apex (then the ring
cuts both by a cone, which serves walls and overhangs), or straight down over a polygon in plan
(pits with firm ground around). Between the two surfaces the ring is a wall.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.math.kernels import kernel
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64, I32, I64, Tin
from ladar_volume.tin.insertion_order import hilbert_order

#: How far outside a triangle, in barycentric coordinates, a line still meets it: lines through
#: shared edges must not slip between.
EDGE_TOLERANCE = 1e-9
#: Most vertices that a point of the ring depends on, and fewest.
FIT_POINTS, MIN_FIT = 48, 6
#: Triangles that rays pass over together.
GROUP = 64


@dataclass(frozen=True)
class Ring:
    """A closed ring of lines. origin : (k, 3) m · direction : (k, 3) unit; line k + 1 follows line
    k, the first the last.
    """

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
        return Ring(
            0.5 * (self.origin[rows] + self.origin[after]), d / np.linalg.norm(d, axis=1)[:, None]
        )

    def insert(self, rows: I64, more: Ring) -> Ring:
        """The ring with one line of ``more`` after each of ``rows``."""
        return Ring(
            np.insert(self.origin, rows + 1, more.origin, axis=0),
            np.insert(self.direction, rows + 1, more.direction, axis=0),
        )


def densify(corners: F64, spacing_m: float) -> F64:
    """Points (k, d) along a closed polygon (c, d) at steps of at most ``spacing_m``, its corners
    among them.
    """
    c = np.asarray(corners, dtype=np.float64)
    if c.ndim != 2 or len(c) < 3 or not np.isfinite(c).all():
        raise VolumeError(
            f"a ring needs at least three finite corners, not an array {c.shape}",
            reason="ring_corners",
            value=c.shape,
        )
    if not spacing_m > 0.0:
        raise VolumeError(
            f"a spacing of {spacing_m} m; it must be above zero",
            reason="ring_spacing",
            value=spacing_m,
        )
    after = np.roll(c, -1, axis=0)
    length = np.linalg.norm(after - c, axis=1)
    if (length == 0.0).any():
        keep = length > 0.0
        return densify(c[keep], spacing_m)
    parts = [
        a
        + (b - a)
        * np.linspace(0.0, 1.0, max(1, int(np.ceil(s / spacing_m))), endpoint=False)[:, None]
        for a, b, s in zip(c, after, length, strict=True)
    ]
    return np.concatenate(parts)


def ring_through(corners_map: F64, apex_map: F64, spacing_m: float) -> Ring:
    """Lines from an apex (3,) through a polygon of points (c, 3), m, map frame, at steps of at most
    ``spacing_m`` along it.
    """
    p, apex = densify(corners_map, spacing_m), np.asarray(apex_map, dtype=np.float64)
    d = p - apex
    length = np.linalg.norm(d, axis=1)
    if not (length > 0.0).all():
        raise VolumeError("the ring runs through its apex", reason="ring_corners", value=apex_map)
    return Ring(np.repeat(apex[None], len(p), axis=0), d / length[:, None])


def ring_over(polygon_xy: F64, top_m: float, spacing_m: float) -> Ring:
    """Lines straight down from the height ``top_m`` over a polygon (c, 2), m, map frame, at steps
    of at most ``spacing_m`` along it.
    """
    p = densify(polygon_xy, spacing_m)
    origin = np.concatenate([p, np.full((len(p), 1), float(top_m))], axis=1)
    return Ring(origin, np.repeat([[0.0, 0.0, -1.0]], len(p), axis=0))


@kernel
def crossing_kernel(
    corner: F64, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float
) -> tuple[float, float, float]:
    """Distance along a line and barycentric coordinates u, v where it meets the plane of a triangle
    (3, 3); distance 0 for a line within the plane (Moeller & Trumbore 1997).
    """
    a, b, c = corner[0], corner[1], corner[2]
    e1x, e1y, e1z = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    e2x, e2y, e2z = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    hx, hy, hz = dy * e2z - dz * e2y, dz * e2x - dx * e2z, dx * e2y - dy * e2x
    det = e1x * hx + e1y * hy + e1z * hz
    if det == 0.0:
        return 0.0, 0.0, 0.0
    sx, sy, sz = ox - a[0], oy - a[1], oz - a[2]
    u = (sx * hx + sy * hy + sz * hz) / det
    qx, qy, qz = sy * e1z - sz * e1y, sz * e1x - sx * e1z, sx * e1y - sy * e1x
    v = (dx * qx + dy * qy + dz * qz) / det
    return (e2x * qx + e2y * qy + e2z * qz) / det, u, v


@kernel
def cast_kernel(
    corners: F64, balls: F64, origin: F64, direction: F64, triangle: I64, weight: F64, reach: F64
) -> None:
    """First triangle (k,) along each line, barycentric coordinates there (k, 3) and distance (k,);
    −1 where there is none.

    corners : (m, 3, 3) · balls : (g, 4), centre and squared radius about each GROUP of triangles,
    by which most are passed over
    """
    for i in range(len(origin)):
        ox, oy, oz = origin[i, 0], origin[i, 1], origin[i, 2]
        dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
        best, found = np.inf, -1
        for g in range(len(balls)):
            px, py, pz = balls[g, 0] - ox, balls[g, 1] - oy, balls[g, 2] - oz
            along = px * dx + py * dy + pz * dz
            if px * px + py * py + pz * pz - along * along > balls[g, 3]:
                continue
            for t in range(g * GROUP, min((g + 1) * GROUP, len(corners))):
                s, u, v = crossing_kernel(corners[t], ox, oy, oz, dx, dy, dz)
                if (
                    u >= -EDGE_TOLERANCE
                    and v >= -EDGE_TOLERANCE
                    and u + v <= 1.0 + EDGE_TOLERANCE
                    and 0.0 < s < best
                ):
                    best, found = s, t
                    weight[i, 0], weight[i, 1], weight[i, 2] = 1.0 - u - v, u, v
        triangle[i], reach[i] = found, best


@dataclass(frozen=True)
class Target:
    """A surface made ready for rays: tin · triangles : (m, 3), the relevant ones, neighbours near
    one another · corners : (m, 3, 3) m · balls : see :func:`cast_kernel`
    """

    tin: Tin
    triangles: I32
    corners: F64
    balls: F64

    @cached_property
    def vertices(self) -> tuple[I64, cKDTree]:
        """The vertices of relevant triangles, and the tree of their positions."""
        used = np.unique(self.triangles).astype(np.int64)
        return used, cKDTree(self.tin.vertices[used])


def target(tin: Tin) -> Target:
    """The relevant triangles of a surface in groups along a Hilbert curve in plan, with a ball
    about each.
    """
    t = tin.triangles[tin.relevant]
    t = t[hilbert_order(tin.vertices[t].mean(axis=1)[:, :2])]
    corners = tin.vertices[t]
    start = np.arange(0, len(t), GROUP)
    low, high = (
        np.minimum.reduceat(corners.min(axis=1), start),
        np.maximum.reduceat(corners.max(axis=1), start),
    )
    radius2 = 0.25 * ((high - low) ** 2).sum(axis=1) * (1.0 + 1e-6)
    return Target(tin, t, corners, np.column_stack([0.5 * (low + high), radius2]))


@dataclass(frozen=True)
class Hits:
    """Where lines meet a surface. point : (k, 3) m · corner : (k, c) int32, vertices it depends on
    · weight : (k, c), together 1 · normal : (k, 3), of the plane there, of any length · distance :
    (k,) m along the line
    """

    point: F64
    corner: I32
    weight: F64
    normal: F64
    distance: F64

    def insert(self, rows: I64, more: Hits) -> Hits:
        """With one hit of ``more`` after each of ``rows``."""
        at = rows + 1
        return Hits(
            np.insert(self.point, at, more.point, axis=0),
            np.insert(self.corner, at, more.corner, axis=0),
            np.insert(self.weight, at, more.weight, axis=0),
            np.insert(self.normal, at, more.normal, axis=0),
            np.insert(self.distance, at, more.distance),
        )

    def reversed(self) -> Hits:
        """In the order of the reversed ring."""
        return Hits(
            self.point[::-1],
            self.corner[::-1],
            self.weight[::-1],
            self.normal[::-1],
            self.distance[::-1],
        )


def cast(ring: Ring, surface: Target, name: str, radius_m: float = 0.0) -> Hits:
    """Where the lines of a ring first meet the relevant triangles of a surface. ``name`` stands in
    the error.

    With a radius the point is that of a plane through the vertices around (:func:`settle`): where
    the noise of points is as large as their spacing, the surface has folds, between which the first
    hit jumps.

    Raises :class:`VolumeError` (ring_off_surface; value: the lines (k,) that miss).
    """
    t, corners = surface.triangles, surface.corners
    found, weight, reach = (
        np.empty(len(ring), np.int64),
        np.zeros((len(ring), 3)),
        np.empty(len(ring)),
    )
    cast_kernel(
        corners,
        surface.balls,
        np.ascontiguousarray(ring.origin),
        np.ascontiguousarray(ring.direction),
        found,
        weight,
        reach,
    )
    if (found < 0).any():
        raise VolumeError(
            (
                f"{int((found < 0).sum())} of {len(ring)} lines of the ring miss surface "
                f"{name}: select more of it around the ring (a margin)"
            ),
            reason="ring_off_surface",
            value=np.flatnonzero(found < 0),
        )
    normal = np.cross(corners[found, 1] - corners[found, 0], corners[found, 2] - corners[found, 0])
    hits = Hits(ring.origin + reach[:, None] * ring.direction, t[found], weight, normal, reach)
    return settle(ring, hits, surface, radius_m) if radius_m > 0.0 else hits


def settle(ring: Ring, hits: Hits, surface: Target, radius_m: float) -> Hits:
    """Hits on planes through the vertices within ``radius_m`` of each (at most 48), weights falling
    to zero there; as they were where there are fewer than six, or these are in a line, or the line
    runs along the plane.
    """
    used, tree = surface.vertices
    far, near = tree.query(hits.point, min(FIT_POINTS, len(used)), distance_upper_bound=radius_m)
    there = np.isfinite(far)
    corner = used[np.where(there, near, 0)]
    p = surface.tin.vertices[corner] - hits.point[:, None]
    along = (p * ring.direction[:, None]).sum(axis=2)
    across = p - along[..., None] * ring.direction[:, None]
    u, v = across_axes(ring.direction)
    plan = [(across * axis[:, None]).sum(axis=2) / radius_m for axis in (u, v)]
    X = np.stack([np.ones_like(along), *plan], axis=2)
    w = np.where(there, np.maximum(1.0 - (across**2).sum(axis=2) / radius_m**2, 0.0) ** 2, 0.0)
    N = np.einsum("kci,kc,kcj->kij", X, w, X)
    good = (there.sum(axis=1) >= MIN_FIT) & (
        np.linalg.eigvalsh(N)[:, 0] > 1e-3 * np.maximum(w.sum(axis=1), 1e-300)
    )
    N[~good] = np.eye(3)
    rows = np.linalg.solve(
        N, np.swapaxes(X * w[..., None], 1, 2)
    )  # (k, 3, c): height and slopes by the heights of the vertices
    height, slope_u, slope_v = np.moveaxis(np.einsum("kic,kc->ki", rows, along), 1, 0)
    normal = ring.direction - (slope_u[:, None] * u + slope_v[:, None] * v) / radius_m
    good &= np.abs(height) <= radius_m
    pad = corner.shape[1] - 3
    chosen = good[:, None]
    return Hits(
        np.where(chosen, hits.point + height[:, None] * ring.direction, hits.point),
        np.where(chosen, corner, np.pad(hits.corner, ((0, 0), (0, pad)), mode="edge")).astype(
            np.int32
        ),
        np.where(chosen, rows[:, 0], np.pad(hits.weight, ((0, 0), (0, pad)))),
        np.where(chosen, normal, hits.normal),
        hits.distance + np.where(good, height, 0.0),
    )


def across_axes(direction: F64) -> tuple[F64, F64]:
    """Two unit vectors (k, 3) square to directions (k, 3) and to each other."""
    helper = np.eye(3)[np.abs(direction).argmin(axis=1)]
    u = np.cross(direction, helper)
    u /= np.linalg.norm(u, axis=1)[:, None]
    v = np.cross(direction, u)
    return u, v


def slide(ring: Ring, hits: Hits) -> F64:
    """Derivatives (k, 3) of the distances along the lines by a displacement of the surface: ``n /
    (n·d)``.
    """
    along = (hits.normal * ring.direction).sum(axis=1)
    length = np.linalg.norm(hits.normal, axis=1)
    safe = np.where(np.abs(along) > 1e-9 * length, along, 1e-9 * np.maximum(length, 1e-300))
    out: F64 = hits.normal / safe[:, None]
    return out


def pull(gradient: F64, ring: Ring, hits: Hits, into: F64) -> None:
    """Add to ``into`` (n, 3) what a gradient (k, 3) by the ring's points on a surface means for the
    vertices (n, 3) they depend on.

    A vertex that moves by δ lifts the plane it belongs to, so the point slides along its line by
    ``w n·δ / (n·d)``.
    """
    slide = (gradient * ring.direction).sum(axis=1) / (hits.normal * ring.direction).sum(axis=1)
    np.add.at(into, hits.corner, (slide[:, None] * hits.weight)[..., None] * hits.normal[:, None])
