"""A surface that grows triangle by triangle and is a manifold at every step.

Every point keeps the triangles round it as pairs of its neighbours, counter-clockwise about its
normal. A triangle is taken only if at each of its corners its sector overlaps no other, seen in the
unfolded tangent plane of that corner: then every edge has at most two triangles, which run along it
in opposite directions, and no corner is covered twice.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.math.kernels import kernel
from ladar_volume.mesh.local_frames import tangent_coordinates
from ladar_volume.model.records import F64, I32, I64

#: Most triangles round a point.
FAN = 32


@kernel
def add_to_fans(fan: I32, size: I32, a: int, b: int, c: int, kind: int) -> None:
    """Put a triangle into the fans (n, FAN, 3) of its corners: the next and the last corner, and
    what kind of triangle it is.
    """
    p, q, r = np.int64(a), np.int64(b), np.int64(c)  # of one type, as a compiled tuple must be
    for i, j, k in ((p, q, r), (q, r, p), (r, p, q)):
        s = size[i]
        fan[i, s, 0], fan[i, s, 1], fan[i, s, 2] = j, k, kind
        size[i] = s + 1


@kernel
def remove_from_fans(fan: I32, size: I32, a: int, b: int, c: int) -> None:
    """Take a triangle out of the fans of its corners."""
    p, q, r = np.int64(a), np.int64(b), np.int64(c)  # of one type, as a compiled tuple must be
    for i, j, k in ((p, q, r), (q, r, p), (r, p, q)):
        for s in range(size[i]):
            if fan[i, s, 0] == j and fan[i, s, 1] == k:
                size[i] -= 1
                fan[i, s] = fan[i, size[i]]
                break


@kernel
def row_to_left(fan: I32, size: I32, i: int, j: int) -> int:
    """Where the fan of i has the triangle to the left of the edge from i to j, or -1."""
    for s in range(size[i]):
        if fan[i, s, 0] == j:
            return s
    return -1


@kernel
def row_to_right(fan: I32, size: I32, i: int, j: int) -> int:
    """Where the fan of i has the triangle to the right of the edge from i to j, or -1."""
    for s in range(size[i]):
        if fan[i, s, 1] == j:
            return s
    return -1


@kernel
def is_in_sector(ax: float, ay: float, bx: float, by: float, qx: float, qy: float) -> bool:
    """Whether direction q lies strictly inside the sector from a to b, less than half a turn."""
    return ax * qy - ay * qx > 0.0 and qx * by - qy * bx > 0.0


@kernel
def sector_is_free(
    points: F64, normals: F64, fan: I32, size: I32, i: int, a: int, b: int, slack: float
) -> bool:
    """Whether the sector of the triangle (i, a, b) is free at i."""
    if size[i] >= FAN:
        return False
    ax, ay, on_a = tangent_coordinates(points, normals, i, a, slack)
    bx, by, on_b = tangent_coordinates(points, normals, i, b, slack)
    if not (on_a and on_b) or ax * by - ay * bx <= 0.0:
        return False
    for s in range(size[i]):
        c, d = fan[i, s, 0], fan[i, s, 1]
        if c == a or d == b:
            return False
        cx, cy, _ = tangent_coordinates(points, normals, i, c, slack)
        dx, dy, _ = tangent_coordinates(points, normals, i, d, slack)
        if (c != b and is_in_sector(ax, ay, bx, by, cx, cy)) or (
            d != a and is_in_sector(ax, ay, bx, by, dx, dy)
        ):
            return False
        if (a != d and is_in_sector(cx, cy, dx, dy, ax, ay)) or (
            b != c and is_in_sector(cx, cy, dx, dy, bx, by)
        ):
            return False
    return True


@kernel
def grow(
    points: F64, normals: F64, triangles: I32, votes: I32, slack: float, fan: I32, size: I32
) -> int:
    """Take triangles (m, 3) in their order where they fit; how many. Those with three votes fit
    each other: stars do not overlap.
    """
    taken = 0
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        if votes[t] < 3 and not (
            sector_is_free(points, normals, fan, size, a, b, c, slack)
            and sector_is_free(points, normals, fan, size, b, c, a, slack)
            and sector_is_free(points, normals, fan, size, c, a, b, slack)
        ):
            continue
        add_to_fans(fan, size, a, b, c, votes[t])
        taken += 1
    return taken


@kernel
def list_triangles(fan: I32, size: I32, out: I32) -> int:
    """Write every triangle once, lowest corner first, with its kind in the fourth column; how many
    there are.
    """
    m = 0
    for i in range(len(size)):
        for s in range(size[i]):
            a, b = fan[i, s, 0], fan[i, s, 1]
            if i < a and i < b:
                out[m, 0], out[m, 1], out[m, 2], out[m, 3] = i, a, b, fan[i, s, 2]
                m += 1
    return m


@kernel
def drop_fans(fan: I32, size: I32) -> int:
    """Where the triangles round a point form several fans, keep the one with most triangles; how
    many triangles went.
    """
    gone, again = 0, True
    label = np.empty(FAN, np.int64)
    while again:
        again = False
        for i in range(len(size)):
            parts = label_fans(fan, size, i, label)
            if parts < 2:
                continue
            again = True
            count = np.zeros(parts, np.int64)
            for s in range(size[i]):
                count[label[s]] += 1
            best = np.argmax(count)
            old = fan[i, : size[i]].copy()
            for s in range(len(old)):
                if label[s] != best:
                    remove_from_fans(fan, size, i, old[s, 0], old[s, 1])
                    gone += 1
    return gone


@kernel
def label_fans(fan: I32, size: I32, i: int, label: I64) -> int:
    """Number the fans at i: label of each of its triangles; how many fans."""
    label[: size[i]] = -1
    parts = 0
    for turn in range(2):  # open fans from their beginning, then what is closed
        for s in range(size[i]):
            if label[s] >= 0 or (turn == 0 and row_to_right(fan, size, i, fan[i, s, 0]) >= 0):
                continue
            at = s
            while at >= 0 and label[at] < 0:
                label[at] = parts
                at = row_to_left(fan, size, i, fan[i, at, 1])
            parts += 1
    return parts
