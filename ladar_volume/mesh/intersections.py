"""Triangles of a mesh that pierce each other. A mesh that crosses itself is closed and orientable,
but counts some space twice or negative.

Found are proper crossings: an edge of one triangle passes through the inside of another, or through
an edge of it into the body. Triangles that only touch (bodies standing on each other, a fold of no
width) are not crossings. Signs within rounding count as touching, and so does an edge of which one
end lies no deeper behind the other triangle than coordinates round: vertices that were computed to
lie in one plane do so within their last digits only.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.math.kernels import kernel
from ladar_volume.mesh.topology import edge_table
from ladar_volume.model.records import F64, I32, I64

#: Relative rounding of a 3 x 3 determinant, generously.
ROUNDING = 1e-13
#: An end of an edge lies in a plane where it is no farther than so many roundings of the
#: coordinates.
TOUCH = 16.0
#: Where an edge passes through a triangle, beside the numbers of its edges.
NOWHERE, INSIDE = -1, 3


@kernel
def side(p: F64, a: F64, b: F64, c: F64) -> int:
    """On which side of the plane a, b, c the point p lies: −1, 0 (within rounding), 1."""
    ax, ay, az = a[0] - p[0], a[1] - p[1], a[2] - p[2]
    bx, by, bz = b[0] - p[0], b[1] - p[1], b[2] - p[2]
    cx, cy, cz = c[0] - p[0], c[1] - p[1], c[2] - p[2]
    x, y, z = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    det = ax * x + ay * y + az * z
    size = (
        abs(ax) * (abs(by * cz) + abs(bz * cy))
        + abs(ay) * (abs(bz * cx) + abs(bx * cz))
        + abs(az) * (abs(bx * cy) + abs(by * cx))
    )
    if abs(det) <= ROUNDING * size:
        return 0
    return 1 if det > 0.0 else -1


@kernel
def pierces(p: F64, q: F64, a: F64, b: F64, c: F64) -> int:
    """Where the segment p q passes through the triangle a, b, c: INSIDE, 0, 1 or 2 on the edge
    after that corner, or NOWHERE.
    """
    if side(p, a, b, c) * side(q, a, b, c) >= 0:
        return NOWHERE
    s, t, u = side(p, q, a, b), side(p, q, b, c), side(p, q, c, a)
    if s == t and t == u:
        return INSIDE if s != 0 else NOWHERE
    if s == 0 and t == u:
        return 0
    if t == 0 and s == u:
        return 1
    return 2 if u == 0 and s == t else NOWHERE


@kernel
def side_of_two_faces(p: F64, a: F64, b: F64, c: F64, d: F64) -> int:
    """Whether p lies behind the triangles a, b, c and b, a, d (1), before them (−1), or on one of
    them (0), near their common edge.
    """
    one, other = side(p, a, b, c), side(p, b, a, d)
    if side(d, a, b, c) < 0:  # concave: behind one of them is behind both
        return 1 if one > 0 or other > 0 else min(one + other + 1, 0)
    return -1 if one < 0 or other < 0 else max(one + other - 1, 0)


@kernel
def shallow(p: F64, q: F64, a: F64, b: F64, c: F64, touch_m: float) -> bool:
    """Whether p or q lies within ``touch_m`` of the plane a, b, c."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    length = np.sqrt(x * x + y * y + z * z)
    one = abs((p[0] - a[0]) * x + (p[1] - a[1]) * y + (p[2] - a[2]) * z)
    two = abs((q[0] - a[0]) * x + (q[1] - a[1]) * y + (q[2] - a[2]) * z)
    return bool(min(one, two) <= touch_m * length)


@kernel
def cross(v: F64, triangles: I32, beyond: I32, s: int, t: int, touch_m: float = 0.0) -> bool:
    """Whether an edge of triangle s pierces triangle t, or the other way; edges that end in a
    common vertex only touch.

    beyond : (m, 3), the third corner of the triangle across the edge after each corner, −1 for
    none. An edge that meets an edge pierces the surface where its ends lie on different sides of
    both triangles there.
    """
    for one, other in ((s, t), (t, s)):
        a, b, c = triangles[other, 0], triangles[other, 1], triangles[other, 2]
        for k in range(3):
            i, j = triangles[one, k], triangles[one, (k + 1) % 3]
            if i == a or i == b or i == c or j == a or j == b or j == c:
                continue
            where = pierces(v[i], v[j], v[a], v[b], v[c])
            if where == NOWHERE or shallow(v[i], v[j], v[a], v[b], v[c], touch_m):
                continue
            if where == INSIDE:
                return True
            if beyond[other, where] >= 0:
                e, f, g = (
                    triangles[other, where],
                    triangles[other, (where + 1) % 3],
                    triangles[other, (where + 2) % 3],
                )
                d = v[beyond[other, where]]
                if (
                    side_of_two_faces(v[i], v[e], v[f], v[g], d)
                    * side_of_two_faces(v[j], v[e], v[f], v[g], d)
                    < 0
                ):
                    return True
    return False


def corners_beyond(triangles: I32) -> I32:
    """The third corner (m, 3) of the triangle across the edge after each corner, −1 where there is
    not exactly one.
    """
    order, start, _ = edge_table(triangles)
    pair = start[:-1][np.diff(start) == 2]
    i, j = order[pair], order[pair + 1]
    out = np.full(3 * len(triangles), -1, np.int32)
    third = triangles[:, [2, 0, 1]].ravel()
    out[i], out[j] = third[j], third[i]
    return out.reshape(-1, 3)


@kernel
def sweep_kernel(
    v: F64,
    triangles: I32,
    beyond: I32,
    boxes: tuple[F64, F64],
    order: I64,
    axis: int,
    touch_m: float,
    found: I64,
) -> int:
    """Crossing pairs into ``found`` (k, 2), boxes sorted by their low side on one axis; returns how
    many there are at least.
    """
    count, u, w = 0, (axis + 1) % 3, (axis + 2) % 3
    low, high = boxes
    for i in range(len(order)):
        s = order[i]
        for j in range(i + 1, len(order)):
            t = order[j]
            if low[t, axis] > high[s, axis]:
                break
            if (
                low[t, u] > high[s, u]
                or low[s, u] > high[t, u]
                or low[t, w] > high[s, w]
                or low[s, w] > high[t, w]
            ):
                continue
            if cross(v, triangles, beyond, s, t, touch_m):
                found[count, 0], found[count, 1] = s, t
                count += 1
                if count == len(found):
                    return count
    return count


def crossings(vertices: F64, triangles: I32, most: int = 1000) -> I64:
    """Pairs (k, 2) of triangles that cross, at most ``most`` of them. vertices : (n, 3) m ·
    triangles : (m, 3).
    """
    v, t = (
        np.ascontiguousarray(vertices, dtype=np.float64),
        np.ascontiguousarray(triangles, dtype=np.int32),
    )
    low, high = v[t].min(axis=1), v[t].max(axis=1)
    axis = int(
        np.argmax(
            (high.max(axis=0) - low.min(axis=0)) / np.maximum((high - low).mean(axis=0), 1e-300)
        )
    )
    found = np.empty((most, 2), np.int64)
    count = int(
        sweep_kernel(
            v,
            t,
            corners_beyond(t),
            (low, high),
            np.argsort(low[:, axis], kind="stable").astype(np.int64),
            axis,
            TOUCH * float(np.spacing(np.abs(v[t]).max())),
            found,
        )
    )
    return np.sort(found[:count], axis=1)
