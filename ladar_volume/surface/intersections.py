"""Triangles of a mesh that pierce each other. A mesh that crosses itself is closed and orientable, but counts some space twice or negative.

Found are proper crossings: an edge of one triangle passes through the inside of another. Triangles that only touch (bodies standing on each
other, a fold of no width) are not crossings. Signs within rounding count as touching.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.kernels import kernel
from ladar_volume.model.records import F64, I32, I64

#: Relative rounding of a 3 x 3 determinant, generously.
ROUNDING = 1e-13


@kernel
def side(p: F64, a: F64, b: F64, c: F64) -> int:
    """On which side of the plane a, b, c the point p lies: −1, 0 (within rounding), 1."""
    ax, ay, az = a[0] - p[0], a[1] - p[1], a[2] - p[2]
    bx, by, bz = b[0] - p[0], b[1] - p[1], b[2] - p[2]
    cx, cy, cz = c[0] - p[0], c[1] - p[1], c[2] - p[2]
    x, y, z = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    det = ax * x + ay * y + az * z
    size = abs(ax) * (abs(by * cz) + abs(bz * cy)) + abs(ay) * (abs(bz * cx) + abs(bx * cz)) + abs(az) * (abs(bx * cy) + abs(by * cx))
    if abs(det) <= ROUNDING * size:
        return 0
    return 1 if det > 0.0 else -1


@kernel
def pierces(p: F64, q: F64, a: F64, b: F64, c: F64) -> bool:
    """Whether the segment p q passes through the inside of the triangle a, b, c."""
    if side(p, a, b, c) * side(q, a, b, c) >= 0:
        return False
    s = side(p, q, a, b)
    return s != 0 and side(p, q, b, c) == s and side(p, q, c, a) == s


@kernel
def cross(v: F64, s: I32, t: I32) -> bool:
    """Whether an edge of one triangle pierces the other; edges that end in a common vertex only touch."""
    for one, other in ((s, t), (t, s)):
        for k in range(3):
            i, j = one[k], one[(k + 1) % 3]
            shared = False
            for m in range(3):
                shared = shared or other[m] == i or other[m] == j
            if not shared and pierces(v[i], v[j], v[other[0]], v[other[1]], v[other[2]]):
                return True
    return False


@kernel
def sweep_kernel(v: F64, triangles: I32, low: F64, high: F64, order: I64, axis: int, found: I64) -> int:
    """Crossing pairs into ``found`` (k, 2), boxes sorted by their low side on one axis; returns how many there are at least."""
    count, u, w = 0, (axis + 1) % 3, (axis + 2) % 3
    for i in range(len(order)):
        s = order[i]
        for j in range(i + 1, len(order)):
            t = order[j]
            if low[t, axis] > high[s, axis]:
                break
            if low[t, u] > high[s, u] or low[s, u] > high[t, u] or low[t, w] > high[s, w] or low[s, w] > high[t, w]:
                continue
            if cross(v, triangles[s], triangles[t]):
                found[count, 0], found[count, 1] = s, t
                count += 1
                if count == len(found):
                    return count
    return count


def crossings(vertices: F64, triangles: I32, most: int = 1000) -> I64:
    """Pairs (k, 2) of triangles that cross, at most ``most`` of them. vertices : (n, 3) m · triangles : (m, 3)."""
    v, t = np.ascontiguousarray(vertices, dtype=np.float64), np.ascontiguousarray(triangles, dtype=np.int32)
    low, high = v[t].min(axis=1), v[t].max(axis=1)
    axis = int(np.argmax((high.max(axis=0) - low.min(axis=0)) / np.maximum((high - low).mean(axis=0), 1e-300)))
    found = np.empty((most, 2), np.int64)
    count = int(sweep_kernel(v, t, low, high, np.argsort(low[:, axis], kind="stable").astype(np.int64), axis, found))
    return np.sort(found[:count], axis=1)


def check_simple(vertices: F64, triangles: I32) -> None:
    """Raises :class:`SurfaceError` (mesh_self_intersecting; value: up to 1,000 pairs (k, 2) of triangles) where a mesh crosses itself."""
    pairs = crossings(vertices, triangles)
    if len(pairs):
        many = f"{len(pairs)}" if len(pairs) < 1000 else "1,000 or more"
        raise SurfaceError(
            f"{many} pairs of triangles cross, first {pairs[0].tolist()}: the mesh counts space twice; repair it, or join the bodies",
            reason="mesh_self_intersecting", value=pairs,
        )  # fmt: skip
