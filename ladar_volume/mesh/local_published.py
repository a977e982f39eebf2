"""Algorithm 2 as published (seed 002 section 5.3), with its check for false and empty triangles
(Figures 5.5 and 5.6, Tables 9.3, 9.4).

Point by point, the neighbours within a radius are turned into the plane through them, and every
triangle of them that has no long side and no other of them in its circumcircle is stored. A point
round which stored triangles fill 360 degrees is final and leaves the search. The circumcircles of
one ball know nothing of points beyond it, nor of those that have left, so triangles overlap: the
checks find some.
"""

from __future__ import annotations

import math

import numpy as np

from ladar_volume.math.kernels import inlined, kernel
from ladar_volume.mesh.local_frames import neighbours_within
from ladar_volume.mesh.topology import edge_table
from ladar_volume.model.records import F64, I32, I64, Bool

#: Part of the radius by which points are moved at random, so that no four lie on a circle.
JITTER = 1e-4
#: Stored triangles at a point that count for its angle; a point with more is final.
AROUND = 96


def published_triangles(points: F64, radius: float, longest: float) -> I32:
    """Triangles (m, 3) of points (n, 3) by Algorithm 2: neighbours within ``radius``, no side above
    ``longest``, m; in no orientation.
    """
    moved = points + np.random.default_rng(0).uniform(
        -JITTER * radius, JITTER * radius, points.shape
    )
    start, near = neighbours_within(moved, radius)
    normals = ball_normals(moved, start, near)
    table = np.full(1 << int(64 * len(points)).bit_length(), -1, np.int64)
    out = np.empty((len(table) // 2, 3), np.int32)
    m = search_triangles(moved, normals, start, near, longest, table, out)
    return out[:m].copy()


def ball_normals(points: F64, start: I64, near: I64) -> F64:
    """Normals (n, 3) of the planes through all points of each ball."""
    own = np.repeat(np.arange(len(points)), np.diff(start))
    size = np.maximum(np.diff(start), 1)
    arm = points[near] - points[own]
    mean = (
        np.stack([np.bincount(own, arm[:, k], len(points)) for k in range(3)], axis=1)
        / size[:, None]
    )
    arm -= mean[own]
    scatter = np.empty((len(points), 3, 3))
    for i in range(3):
        for j in range(3):
            scatter[:, i, j] = np.bincount(own, arm[:, i] * arm[:, j], len(points))
    return np.ascontiguousarray(np.linalg.eigh(scatter)[1][:, :, 0])


@kernel
def search_triangles(
    points: F64, normals: F64, start: I64, near: I64, longest: float, table: I64, out: I32
) -> int:
    """The loop over all points: triangles into ``out``, each once; how many. It ends early where
    ``out`` is full.
    """
    final, many, m = np.zeros(len(points), np.bool_), np.zeros(len(points), np.int64), 0
    around = np.empty((len(points), AROUND, 2), np.int32)
    for i in range(len(points)):
        ball = near[start[i] : start[i + 1]]
        if final[i] or len(ball) <= 2:
            continue
        name = ball[~final[ball]]
        x, y = flatten(points, normals[i], name)
        found = empty_circles(x, y, longest)
        for t in range(len(found)):
            corner = np.sort(name[found[t]])
            if m == len(out) or not insert_triangle(table, corner):
                continue
            out[m, 0], out[m, 1], out[m, 2] = corner[0], corner[1], corner[2]
            m += 1
            for k in range(3):
                v = corner[k]
                if many[v] < AROUND:
                    around[v, many[v], 0], around[v, many[v], 1] = (
                        corner[(k + 1) % 3],
                        corner[(k + 2) % 3],
                    )
                many[v] += 1
        for v in name:
            final[v] = many[v] > AROUND or is_surrounded(
                points, normals[i], v, around[v, : min(many[v], AROUND)]
            )
    return m


@kernel
def flatten(points: F64, n: F64, name: I64) -> tuple[F64, F64]:
    """Coordinates of the named points in a plane with normal n, from the first of them (frame: Duff
    et al. 2017).
    """
    g = math.copysign(1.0, n[2])
    h = -1.0 / (g + n[2])
    x, y = np.empty(len(name)), np.empty(len(name))
    for k in range(len(name)):
        dx, dy = points[name[k], 0] - points[name[0], 0], points[name[k], 1] - points[name[0], 1]
        dz = points[name[k], 2] - points[name[0], 2]
        x[k] = dx * (1.0 + g * n[0] * n[0] * h) + dy * g * n[0] * n[1] * h - dz * g * n[0]
        y[k] = dx * n[0] * n[1] * h + dy * (g + n[1] * n[1] * h) - dz * n[1]
    return x, y


@kernel
def empty_circles(x: F64, y: F64, longest: float) -> I64:
    """All triangles (m, 3) of the points without a long side whose circumcircle holds no other
    point.
    """
    k = len(x)
    out, m = np.empty((4 * k + 8, 3), np.int64), 0
    far = longest * longest
    for a in range(k):
        for b in range(a + 1, k):
            if (x[a] - x[b]) ** 2 + (y[a] - y[b]) ** 2 > far:
                continue
            for c in range(b + 1, k):
                if (x[a] - x[c]) ** 2 + (y[a] - y[c]) ** 2 > far or (x[b] - x[c]) ** 2 + (
                    y[b] - y[c]
                ) ** 2 > far:
                    continue
                if m < len(out) and empty_circle(x, y, a, b, c):
                    out[m, 0], out[m, 1], out[m, 2] = a, b, c
                    m += 1
    return out[:m]


@kernel
def empty_circle(x: F64, y: F64, a: int, b: int, c: int) -> bool:
    """Whether a, b, c are no line and no other point lies in their circle, by the sign of the
    determinant of section 5.1.
    """
    turn = (x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a])
    if turn == 0.0:
        return False
    for d in range(len(x)):
        if d == a or d == b or d == c:
            continue
        ax, ay, bx, by, cx, cy = (
            x[a] - x[d],
            y[a] - y[d],
            x[b] - x[d],
            y[b] - y[d],
            x[c] - x[d],
            y[c] - y[d],
        )
        aa, bb, cc = ax * ax + ay * ay, bx * bx + by * by, cx * cx + cy * cy
        if (
            turn * (ax * (by * cc - bb * cy) - ay * (bx * cc - bb * cx) + aa * (bx * cy - by * cx))
            > 0.0
        ):
            return False
    return True


@inlined
def insert_triangle(table: I64, corner: I64) -> bool:
    """Put a triangle, corners ascending, into the hash table; False where it is there already."""
    key = (corner[0] << 42) | (corner[1] << 21) | corner[2]
    mask = len(table) - 1
    at = (corner[0] * 73856093 + corner[1] * 19349663 + corner[2] * 83492791) & mask
    while table[at] >= 0:
        if table[at] == key:
            return False
        at = (at + 1) & mask
    table[at] = key
    return True


@inlined
def is_surrounded(points: F64, n: F64, v: int, around: I32) -> bool:
    """Whether the angles at v of its triangles, seen along n, add up to 360 degrees (or more, where
    they overlap).
    """
    total = 0.0
    name = np.empty(3, np.int64)
    for t in range(len(around)):
        name[0], name[1], name[2] = v, around[t, 0], around[t, 1]
        x, y = flatten(points, n, name)
        total += abs(math.atan2(x[1] * y[2] - y[1] * x[2], x[1] * x[2] + y[1] * y[2]))
    return total >= 2.0 * math.pi * (1.0 - 1e-9)


def remove_false(triangles: I32) -> I32:
    """Take out the triangle with the most neighbours, again and again, until none has more than
    three.
    """
    order, start, _ = edge_table(triangles)
    edge = np.empty(len(order), np.int64)
    edge[order] = np.repeat(np.arange(len(start) - 1), np.diff(start))
    alive = np.ones(len(triangles), bool)
    remove_most_neighbours(edge.reshape(-1, 3), np.diff(start), order // 3, start, alive)
    return triangles[alive]


@kernel
def remove_most_neighbours(edge: I64, uses: I64, of: I64, start: I64, remaining: Bool) -> None:
    """The loop of :func:`remove_false`: edges (m, 3) of triangles, triangles ``of`` each edge from
    ``start`` on.
    """
    near = np.empty(len(edge), np.int64)
    for t in range(len(edge)):
        near[t] = uses[edge[t, 0]] + uses[edge[t, 1]] + uses[edge[t, 2]] - 3
    while True:
        t = int(np.argmax(near))
        if near[t] <= 3:
            return
        remaining[t], near[t] = False, -1
        for k in range(3):
            e = edge[t, k]
            uses[e] -= 1
            for o in of[start[e] : start[e + 1]]:
                if remaining[o]:
                    near[o] -= 1


def remove_suspicious(triangles: I32) -> I32:
    """Take out every triangle that has more than three neighbours, at once."""
    order, start, _ = edge_table(triangles)
    uses = np.empty(len(order), np.int64)
    uses[order] = np.repeat(np.diff(start), np.diff(start))
    kept: I32 = triangles[uses.reshape(-1, 3).sum(axis=1) - 3 <= 3]
    return kept


def add_empty(triangles: I32) -> I32:
    """Add a triangle wherever three edges that have one triangle each join three vertices."""
    order, start, key = edge_table(triangles)
    single = key[order[start[:-1][np.diff(start) == 1]]]
    ends = np.stack([single >> 32, single & 0xFFFFFFFF], axis=1)
    beyond: dict[int, set[int]] = {}
    for a, b in ends.tolist():
        beyond.setdefault(a, set()).add(b)
    empty = [(a, b, c) for a, b in ends.tolist() for c in sorted(beyond[a] & beyond.get(b, set()))]
    there = set(map(tuple, np.sort(triangles, axis=1).tolist()))
    added = np.array([t for t in empty if t not in there], np.int32).reshape(-1, 3)
    return np.concatenate([triangles, added])


def repair_triangles(triangles: I32, repair: str) -> I32:
    """The five modes of Tables 9.3 and 9.4: none, empty, false, both (false, then empty), remove
    (all that are suspicious).
    """
    if repair == "remove":
        return remove_suspicious(triangles)
    if repair in ("false", "both"):
        triangles = remove_false(triangles)
    return add_empty(triangles) if repair in ("empty", "both") else triangles
