"""Triangles inside a closed loop: of least area in space, or by ears in a plane with holes. No
vertex is added.

Least area: Barequet & Sharir 1995, by dynamic programming over the chords of the loop. Ears: a
corner whose triangle holds no other vertex is cut off until three are left; holes are joined to
their outer loop by a bridge passed twice. A loop that crosses itself still gets a triangulation,
whose signed area is the loop's own.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.math.kernels import kernel
from ladar_volume.model.records import F64, I64, Bool

#: Share of a chord's square that counts as area: of fills of one area, as in a flat loop, the one
#: with short chords is taken.
SHORTER = 1e-3


@kernel
def least_area_kernel(p: F64, taken: Bool, split: I64) -> float:
    """Split of every chord i, j (n, n) of a loop (n, 3) for the least area, −1 where a chord is
    taken; returns the area, inf for none.
    """
    n = len(p)
    cost = np.full((n, n), np.inf)
    for i in range(n - 1):
        cost[i, i + 1] = 0.0
    for span in range(2, n):
        for i in range(n - span):
            j = i + span
            if taken[i, j] and span < n - 1:
                continue
            for k in range(i + 1, j):
                below = cost[i, k] + cost[k, j]
                if below >= cost[i, j]:
                    continue
                ax, ay, az = p[k, 0] - p[i, 0], p[k, 1] - p[i, 1], p[k, 2] - p[i, 2]
                bx, by, bz = p[j, 0] - p[i, 0], p[j, 1] - p[i, 1], p[j, 2] - p[i, 2]
                x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
                chord = bx * bx + by * by + bz * bz
                area = below + 0.5 * np.sqrt(x * x + y * y + z * z) + SHORTER * chord
                if area < cost[i, j]:
                    cost[i, j], split[i, j] = area, k
    return float(cost[0, n - 1])


def least_area(p: F64, taken: Bool) -> I64:
    """Triangles (n − 2, 3) of a loop (n, 3) with the least area, none of whose chords is ``taken``
    (n, n), that is, an edge of the mesh already; none (0, 3) where that cannot be.
    """
    n = len(p)
    split = np.full((n, n), -1, np.int64)
    if not np.isfinite(least_area_kernel(p, taken, split)):
        return np.zeros((0, 3), np.int64)
    out, stack = [], [(0, n - 1)]
    while stack:
        i, j = stack.pop()
        if j - i >= 2:
            k = int(split[i, j])
            out.append((i, k, j))
            stack += [(i, k), (k, j)]
    return np.array(out, np.int64)


@kernel
def twice_signed_area(p: F64, a: int, b: int, c: int) -> float:
    """Twice the signed area of a triangle in the plane."""
    return float(
        (p[b, 0] - p[a, 0]) * (p[c, 1] - p[a, 1]) - (p[b, 1] - p[a, 1]) * (p[c, 0] - p[a, 0])
    )


@kernel
def ear_is_blocked(p: F64, ring: I64, n: int, a: int, b: int, c: int) -> bool:
    """Whether a vertex of the ring lies in the triangle a, b, c, other than at its corners."""
    for i in range(n):
        v = ring[i]
        at_corner = False
        for w in (a, b, c):
            at_corner = at_corner or (p[v, 0] == p[w, 0] and p[v, 1] == p[w, 1])
        if (
            not at_corner
            and twice_signed_area(p, a, b, v) >= 0.0
            and twice_signed_area(p, b, c, v) >= 0.0
            and twice_signed_area(p, c, a, v) >= 0.0
        ):
            return True
    return False


@kernel
def ears_kernel(p: F64, ring: I64, out: I64) -> int:
    """Triangles (n − 2, 3) of a ring (n,) of points in the plane, counter-clockwise; returns how
    many were cut although blocked or turned.
    """
    n, made, forced = len(ring), 0, 0
    while n > 3:
        best, width = -1, -np.inf
        for i in range(n):
            a, b, c = ring[(i + n - 1) % n], ring[i], ring[(i + 1) % n]
            area = twice_signed_area(p, a, b, c)
            if area < 0.0:
                continue
            side = (p[c, 0] - p[a, 0]) ** 2 + (p[c, 1] - p[a, 1]) ** 2
            one = (p[b, 0] - p[a, 0]) ** 2 + (p[b, 1] - p[a, 1]) ** 2
            two = (p[c, 0] - p[b, 0]) ** 2 + (p[c, 1] - p[b, 1]) ** 2
            shape = area / max(side + one + two, 1e-300)
            if shape > width and not ear_is_blocked(p, ring, n, a, b, c):
                best, width = i, shape
        if best < 0:  # the ring crosses itself: the corner that covers least
            least, forced = np.inf, forced + 1
            for i in range(n):
                area = abs(twice_signed_area(p, ring[(i + n - 1) % n], ring[i], ring[(i + 1) % n]))
                if area < least:
                    best, least = i, area
        out[made, 0], out[made, 1], out[made, 2] = (
            ring[(best + n - 1) % n],
            ring[best],
            ring[(best + 1) % n],
        )
        made += 1
        for i in range(best, n - 1):
            ring[i] = ring[i + 1]
        n -= 1
    out[made, 0], out[made, 1], out[made, 2] = ring[0], ring[1], ring[2]
    return forced


def loop_area(p: F64) -> float:
    """Signed area of a loop (n, 2), counter-clockwise positive."""
    x, y = (p - p[0]).T
    return 0.5 * float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())


def inside_loop(p: F64, at: F64) -> bool:
    """Whether a loop (n, 2) encloses a point (2,), by the number of edges to its right."""
    q = np.roll(p, -1, axis=0)
    spans = (p[:, 1] > at[1]) != (q[:, 1] > at[1])
    a, b = p[spans], q[spans]
    x = a[:, 0] + (at[1] - a[:, 1]) * (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1])
    return bool(np.count_nonzero(x > at[0]) % 2)


def bridge_holes(p: F64, outer: I64, holes: list[I64]) -> I64:
    """One ring of an outer loop and its holes, indices into p (n, 2), each hole joined by the
    shortest bridge that crosses nothing.
    """
    ring = outer
    for hole in sorted(holes, key=lambda h: -float(p[h, 0].max())):
        distance = np.linalg.norm(p[ring][:, None] - p[hole][None], axis=2)
        for flat in np.argsort(distance, axis=None, kind="stable"):
            i, j = divmod(int(flat), len(hole))
            if not _crosses(p, ring[i], hole[j], [ring, *holes]):
                break
        ring = np.concatenate([ring[: i + 1], np.roll(hole, -j), hole[j : j + 1], ring[i:]])
    return ring


def _crosses(p: F64, a: int, b: int, rings: list[I64]) -> bool:
    """Whether the segment a b properly crosses an edge of any ring."""
    u, v = p[a], p[b]
    for ring in rings:
        s, e = p[ring], p[np.roll(ring, -1)]
        d = v - u
        one = d[0] * (s[:, 1] - u[1]) - d[1] * (s[:, 0] - u[0])
        two = d[0] * (e[:, 1] - u[1]) - d[1] * (e[:, 0] - u[0])
        f = e - s
        three = f[:, 0] * (u[1] - s[:, 1]) - f[:, 1] * (u[0] - s[:, 0])
        four = f[:, 0] * (v[1] - s[:, 1]) - f[:, 1] * (v[0] - s[:, 0])
        if ((one * two < 0) & (three * four < 0)).any():
            return True
    return False


def ears(p: F64, outer: I64, holes: list[I64]) -> tuple[I64, int]:
    """Triangles (k, 3), indices into p (n, 2) m, of the area between a counter-clockwise loop and
    its clockwise holes; and how many overlap because loops cross.
    """
    ring = bridge_holes(p, outer, holes)
    out = np.empty((len(ring) - 2, 3), np.int64)
    forced = int(ears_kernel(np.ascontiguousarray(p), ring.copy(), out))
    return out, forced
