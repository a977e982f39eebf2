"""Volumes within a polygon that is fixed in the map: triangles are clipped exactly.

The polygon, convex or not, is clipped by each triangle's three half planes and by the side of the
base (Sutherland & Hodgman 1974; the window is convex, and the bridges it leaves in a non-convex
polygon enclose no area). Volume and gradient need only the integrals of the three barycentric
coordinates over what is left: ``V = Σ h_i ∫λ_i`` and ``g_i = ∫λ_i (−grad s, 1)``.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.ground.polynomial import (
    base_gradient,
    base_height,
    degree_of,
    design,
)
from ladar_volume.math.kernels import kernel
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64, I32, I64, Bool, Plane, Tin
from ladar_volume.volume.prismoids import Prismoids, gather

#: Where a triangle lies to a polygon.
OUTSIDE, WITHIN, ACROSS = 0, 1, 2


def check_polygon(polygon: F64) -> F64:
    """The polygon (k, 2) counter-clockwise. Raises :class:`VolumeError` for fewer than three
    corners, no area, or crossing edges.
    """
    p = np.asarray(polygon, dtype=np.float64)
    if p.ndim != 2 or p.shape[1] != 2 or len(p) < 3 or not np.isfinite(p).all():
        raise VolumeError(
            f"an outline needs at least three finite corners x, y; got an array {p.shape}",
            reason="volume_polygon",
            value=p,
        )
    if np.array_equal(p[0], p[-1]):
        return check_polygon(p[:-1])
    e, area = np.roll(p, -1, axis=0) - p, signed_area(p)
    if area == 0.0:
        raise VolumeError("the outline has no area", reason="volume_polygon", value=p)
    i, j = first_crossing(p, e)
    if i >= 0:
        raise VolumeError(
            f"edges {i} and {j} of the outline cross", reason="volume_polygon", value=p
        )
    return p if area > 0 else p[::-1].copy()


def signed_area(ring: F64) -> float:
    """Area in plan, m², positive counter-clockwise, of a ring (k, 2 or 3)."""
    x, y = (ring[:, :2] - ring[0, :2]).T
    return 0.5 * float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())


@kernel
def first_crossing(p: F64, e: F64) -> tuple[int, int]:
    """The first two edges of a ring (k, 2), from its corners p with vectors e (k, 2), that cross
    one another; −1, −1 for none.
    """
    k = len(p)
    for i in range(k):
        for j in range(i + 2, k - (1 if i == 0 else 0)):
            if side(p, e, i, j) * side(p, e, i, (j + 1) % k) < 0.0 and (
                side(p, e, j, i) * side(p, e, j, (i + 1) % k) < 0.0
            ):
                return i, j
    return -1, -1


@kernel
def side(p: F64, e: F64, edge: int, corner: int) -> float:
    """On which side of the line of an edge a corner lies: positive on the left."""
    x, y = p[corner, 0] - p[edge, 0], p[corner, 1] - p[edge, 1]
    out: float = e[edge, 0] * y - e[edge, 1] * x
    return out


@kernel
def clip(source: F64, n: int, a: float, bx: float, by: float, target: F64) -> int:
    """The part of a ring (n, 2) where ``a + bx x + by y >= 0`` into ``target``; returns its
    length.
    """
    m = 0
    for i in range(n):
        j = (i + 1) % n
        fi = a + bx * source[i, 0] + by * source[i, 1]
        fj = a + bx * source[j, 0] + by * source[j, 1]
        if fi >= 0.0:
            target[m] = source[i]
            m += 1
        if (fi > 0.0 and fj < 0.0) or (fi < 0.0 and fj > 0.0):
            s = fi / (fi - fj)
            target[m, 0] = source[i, 0] + s * (source[j, 0] - source[i, 0])
            target[m, 1] = source[i, 1] + s * (source[j, 1] - source[i, 1])
            m += 1
    return m


@kernel
def moments(ring: F64, n: int) -> tuple[float, float, float]:
    """Area, ∫x and ∫y over a ring (n, 2), by the shoelace formula."""
    s = sx = sy = 0.0
    for i in range(n):
        j = (i + 1) % n
        c = ring[i, 0] * ring[j, 1] - ring[j, 0] * ring[i, 1]
        s += c
        sx += c * (ring[i, 0] + ring[j, 0])
        sy += c * (ring[i, 1] + ring[j, 1])
    return s / 2.0, sx / 6.0, sy / 6.0


@kernel
def leftward(a: F64, b: F64, p: F64) -> bool:
    """Whether p (2,) lies on the left of the line from a to b, or on it."""
    left: bool = (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) >= 0.0
    return left


@kernel
def is_convex(polygon: F64) -> bool:
    """Whether a simple polygon (k, 2), counter-clockwise, is convex."""
    k = len(polygon)
    for i in range(k):
        if not leftward(polygon[i], polygon[(i + 1) % k], polygon[(i + 2) % k]):
            return False
    return True


@kernel
def holds(polygon: F64, points: F64) -> bool:
    """Whether all points (n, 2) lie in a convex polygon (k, 2), counter-clockwise."""
    k = len(polygon)
    for i in range(k):
        for p in points:
            if not leftward(polygon[i], polygon[(i + 1) % k], p):
                return False
    return True


@kernel
def rows_of_edges(polygon: F64, count: int) -> tuple[I64, I64, float, float]:
    """The edges of a polygon (k, 2) by ``count`` rows of equal height: where each row starts
    (count + 1,) among the numbers of edges that reach into it; the lowest y, and rows per metre.
    """
    k = len(polygon)
    south, north = polygon[:, 1].min(), polygon[:, 1].max()
    scale = count / (north - south) if north > south else 0.0
    start = np.zeros(count + 1, np.int64)
    for filling in range(2):
        found = np.empty(start[count], np.int64)
        used = start[:-1].copy()
        for i in range(k):
            a, b = polygon[i, 1], polygon[(i + 1) % k, 1]
            low = row_of(min(a, b), south, scale, count)
            for row in range(low, row_of(max(a, b), south, scale, count) + 1):
                if filling:
                    found[used[row]] = i
                    used[row] += 1
                else:
                    start[row + 1] += 1
        if not filling:
            start = np.cumsum(start)
    return start, found, south, scale


@kernel
def row_of(y: float, south: float, scale: float, count: int) -> int:
    """The row in which a y lies, the first or the last beyond them."""
    return min(max(int((y - south) * scale), 0), count - 1)


@kernel
def edges_meet(polygon: F64, p: F64, start: I64, edges: I64, south: float, scale: float) -> bool:
    """Whether the box around any edge of a polygon meets that around a triangle (3, 2)."""
    count = len(start) - 1
    west, east = min(p[0, 0], p[1, 0], p[2, 0]), max(p[0, 0], p[1, 0], p[2, 0])
    low, high = min(p[0, 1], p[1, 1], p[2, 1]), max(p[0, 1], p[1, 1], p[2, 1])
    first, last = row_of(low, south, scale, count), row_of(high, south, scale, count)
    for at in range(start[first], start[last + 1]):
        a, b = polygon[edges[at]], polygon[(edges[at] + 1) % len(polygon)]
        if (
            max(a[0], b[0]) >= west
            and min(a[0], b[0]) <= east
            and max(a[1], b[1]) >= low
            and min(a[1], b[1]) <= high
        ):
            return True
    return False


@kernel
def contains(polygon: F64, x: float, y: float, start: I64, edges: I64, row: int) -> bool:
    """Whether a polygon holds a place that lies in ``row`` and on none of its edges: by the number
    of edges to the west of it.
    """
    inside = False
    for at in range(start[row], start[row + 1]):
        a, b = polygon[edges[at]], polygon[(edges[at] + 1) % len(polygon)]
        if (a[1] > y) != (b[1] > y) and x > a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]):
            inside = not inside
    return inside


@kernel
def barycentric_lines(p: F64, line: F64) -> None:
    """The barycentric coordinates of a triangle (3, 2) as linear functions about its corner 0, to
    line (3, 3): constant, slope along x, slope along y.
    """
    area2 = (p[1, 0] - p[0, 0]) * (p[2, 1] - p[0, 1]) - (p[1, 1] - p[0, 1]) * (p[2, 0] - p[0, 0])
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        line[i, 1], line[i, 2] = (p[j, 1] - p[k, 1]) / area2, (p[k, 0] - p[j, 0]) / area2
        line[i, 0] = 1.0 if i == 0 else 0.0


@kernel
def place_of(polygon: F64, p: F64, convex: bool, rows: tuple[I64, I64, float, float]) -> int:
    """Where a triangle (3, 2) lies to a polygon (k, 2): :data:`OUTSIDE`, :data:`WITHIN`, or
    :data:`ACROSS`. rows : of :func:`rows_of_edges`.
    """
    if convex:
        return WITHIN if holds(polygon, p) else ACROSS
    start, edges, low, scale = rows
    if edges_meet(polygon, p, start, edges, low, scale):
        return ACROSS
    row = row_of(p[0, 1], low, scale, len(polygon))
    return WITHIN if contains(polygon, p[0, 0], p[0, 1], start, edges, row) else OUTSIDE


@kernel
def ring_within(
    polygon: F64, p: F64, whole: bool, leftwards: bool, line: F64, one: F64, two: F64
) -> int:
    """The part of a polygon in a triangle (3, 2) with barycentric coordinates ``line``, about the
    triangle's corner 0, into ``two``; returns its length. whole : the polygon holds the triangle ·
    leftwards : the polygon turns counter-clockwise · one : room.
    """
    if whole:
        for i in range(3):
            at = i if leftwards else 2 - i  # as the polygon turns
            two[i, 0], two[i, 1] = p[at, 0] - p[0, 0], p[at, 1] - p[0, 1]
        return 3
    for i in range(len(polygon)):
        one[i, 0], one[i, 1] = polygon[i, 0] - p[0, 0], polygon[i, 1] - p[0, 1]
    n = clip(one, len(polygon), line[0, 0], line[0, 1], line[0, 2], two)
    n = clip(two, n, line[1, 0], line[1, 1], line[1, 2], one)
    return clip(one, n, line[2, 0], line[2, 1], line[2, 2], two)


@kernel
def clipped_weights(corners: F64, heights: F64, polygon: F64) -> F64:
    """Integrals of the barycentric coordinates over each triangle inside the polygon: above and
    below the base.

    corners : (m, 3, 2) counter-clockwise · heights : (m, 3) above the base · polygon : (k, 2).
    Returns (m, 2, 3) m².
    """
    out, size = np.zeros((len(corners), 2, 3)), 8 * len(polygon) + 64
    one, two, three = np.empty((size, 2)), np.empty((size, 2)), np.empty((size, 2))
    line, convex = np.empty((3, 3)), is_convex(polygon)
    rows = rows_of_edges(polygon, len(polygon))
    leftwards = convex or moments(polygon - polygon[0], len(polygon))[0] > 0.0
    west, east = polygon[:, 0].min(), polygon[:, 0].max()
    south, north = polygon[:, 1].min(), polygon[:, 1].max()
    for t in range(len(corners)):
        p = corners[t]
        if max(p[0, 0], p[1, 0], p[2, 0]) < west or min(p[0, 0], p[1, 0], p[2, 0]) > east:
            continue
        if max(p[0, 1], p[1, 1], p[2, 1]) < south or min(p[0, 1], p[1, 1], p[2, 1]) > north:
            continue
        place = place_of(polygon, p, convex, rows)
        if place == OUTSIDE:
            continue
        barycentric_lines(p, line)
        n = ring_within(polygon, p, place == WITHIN, leftwards, line, one, two)
        for side in range(2):
            sign = 1.0 - 2.0 * side
            h = sign * heights[t]
            a = h[0] * line[0, 0] + h[1] * line[1, 0] + h[2] * line[2, 0]
            bx = h[0] * line[0, 1] + h[1] * line[1, 1] + h[2] * line[2, 1]
            by = h[0] * line[0, 2] + h[1] * line[1, 2] + h[2] * line[2, 2]
            m = clip(two, n, a, bx, by, three)
            s, sx, sy = moments(three, m)
            for i in range(3):
                out[t, side, i] = line[i, 0] * s + line[i, 1] * sx + line[i, 2] * sy
    return out


def clipped_prismoids(tin: Tin, base: Plane, polygon: F64, mask: Bool | None = None) -> Prismoids:
    """Volumes of the triangles in ``mask`` (default: the relevant ones) above ``base`` within a
    polygon (k, 2) of the map.

    As :func:`prismoids.prismoids`, with the outline fixed in the map. Raises :class:`VolumeError`
    where no surface lies inside.
    """
    ring = check_polygon(polygon)
    chosen = tin.relevant if mask is None else mask
    triangles = tin.triangles[chosen]
    v, xy = tin.vertices, tin.vertices[:, :2]
    height = v[:, 2] - base_height(base, xy)
    slope_base = base_gradient(base, xy)
    X = design(xy, base.origin_xy, degree_of(base))
    corners, h = np.ascontiguousarray(xy[triangles]), np.ascontiguousarray(height[triangles])
    weights = clipped_weights(corners, h, np.ascontiguousarray(ring))
    # where the surface is exactly at the base both sides hold it: the area is taken from the signed
    # parts once
    flat = (h == 0).all(axis=1)
    weights[flat, 1] = 0.0
    area = float(weights.sum())
    if area <= 0.0:
        raise VolumeError(
            "no part of the surface lies inside the outline", reason="volume_no_triangle"
        )
    slope_h = height_slopes(corners, h)
    parts = []
    for side, sign in ((0, 1.0), (1, -1.0)):
        w = sign * weights[:, side]
        corner = np.empty((len(triangles), 3, 3))
        corner[..., :2] = -w[..., None] * slope_h[:, None]
        corner[..., 2] = w
        gradient = gather(corner, triangles, len(v))
        gradient[:, :2] -= gradient[:, 2:] * slope_base
        parts.append((float((w * h).sum()), gradient, -(X.T @ gradient[:, 2])))
    (cut, g_cut, b_cut), (fill, g_fill, b_fill) = parts
    return Prismoids(cut, fill, area, g_cut, g_fill, b_cut, b_fill)


@kernel
def rows_that_meet(vertices: F64, triangles: I32, mask: Bool, polygon: F64) -> I64:
    """Rows (k,) of the triangles (m,) in ``mask`` whose box meets that of a polygon (n, 2)."""
    rows, count = np.empty(len(triangles), np.int64), 0
    west, east = polygon[:, 0].min(), polygon[:, 0].max()
    south, north = polygon[:, 1].min(), polygon[:, 1].max()
    for t in range(len(triangles)):
        if not mask[t]:
            continue
        a, b, c = vertices[triangles[t, 0]], vertices[triangles[t, 1]], vertices[triangles[t, 2]]
        if max(a[0], b[0], c[0]) < west or min(a[0], b[0], c[0]) > east:
            continue
        if max(a[1], b[1], c[1]) < south or min(a[1], b[1], c[1]) > north:
            continue
        rows[count] = t
        count += 1
    return rows[:count].copy()


def weights_of_rows(tin: Tin, polygon: F64) -> tuple[I64, F64]:
    """Rows (k,) of relevant triangles, and integrals (k, 3) m² of their barycentric coordinates
    over what lies within a counter-clockwise polygon (n, 2); 0 for the others.
    """
    ring = np.ascontiguousarray(polygon)
    rows = np.asarray(rows_that_meet(tin.vertices, tin.triangles, tin.relevant, ring))
    corners = np.ascontiguousarray(tin.vertices[tin.triangles[rows], :2])
    return rows, np.asarray(clipped_weights(corners, np.ones((len(rows), 3)), ring)[:, 0])


def overlap_of(one: F64, two: F64) -> float:
    """Area, m², that two rings (k, 2), (m, 2) share: of fans of triangles of the one, signed,
    within the other.
    """
    ring, other = check_polygon(one), check_polygon(two)
    ahead = np.roll(ring, -1, axis=0)
    fans = np.stack([np.broadcast_to(ring[0], ring.shape), ring, ahead], axis=1)[1:-1]
    u, v = fans[:, 1] - fans[:, 0], fans[:, 2] - fans[:, 0]
    turn = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    fans = np.where((turn < 0.0)[:, None, None], fans[:, [0, 2, 1]], fans)[turn != 0.0]
    heights = np.ones((len(fans), 3))
    shared = clipped_weights(np.ascontiguousarray(fans), heights, other)[:, 0].sum(axis=1)
    return float((np.sign(turn[turn != 0.0]) * shared).sum())


def areas_inside(tin: Tin, polygon: F64) -> F64:
    """Area (m,) m² of each relevant triangle within a counter-clockwise polygon (k, 2); 0 for the
    others.
    """
    out = np.zeros(len(tin.triangles))
    rows, weights = weights_of_rows(tin, polygon)
    out[rows] = np.maximum(weights.sum(axis=1), 0.0)
    return out


def height_slopes(corners: F64, h: F64) -> F64:
    """Slopes (m, 2) of the linear functions with values h (m, 3) at corners (m, 3, 2)."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p, q = h[:, 1] - h[:, 0], h[:, 2] - h[:, 0]
    det = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    out: F64 = np.stack(
        [(p * b[:, 1] - q * a[:, 1]) / det, (q * a[:, 0] - p * b[:, 0]) / det], axis=1
    )
    return out
