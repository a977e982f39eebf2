"""Stars: the triangles of a local Delaunay triangulation about one point, and how far the stars of
neighbours agree.

Inversion about the point turns circles through it into lines: the neighbours that make its star are
the corners of the convex hull of the inverted neighbours, and the star is open where the point
itself is a corner. A triangle that all three of its corners have in their star has three votes
(star splaying, Shewchuk 2005; localized triangulation with voting, Gopi et al. 2000).
"""

from __future__ import annotations

import numba
import numpy as np

from ladar_volume.math.kernels import kernel, parallel_kernel
from ladar_volume.mesh.local_frames import tangent_coordinates
from ladar_volume.model.records import F64, I32, I64

#: Most neighbours in a star that is kept.
DEGREE = 32


@kernel
def star(x: F64, y: F64, count: int, out: I32) -> tuple[int, bool]:
    """Local Delaunay star of the origin among ``count`` points: writes the points round the origin
    counter-clockwise into ``out``; their number and whether the star is closed. An open star begins
    where the gap ends.
    """
    if count < 2:
        return 0, False
    first, least = 0, np.inf
    u, v = np.empty(count), np.empty(count)
    for k in range(count):
        d = x[k] * x[k] + y[k] * y[k]
        u[k], v[k] = x[k] / d, y[k] / d
        if d < least:
            first, least = k, d
    ahead, n = np.empty(DEGREE, np.int64), 0
    closed = wrap_hull(u, v, count, first, 1.0, ahead)
    while n < DEGREE and ahead[n] >= 0:
        n += 1
    if closed:
        out[:n] = ahead[:n]
        return n, True
    behind, b = np.empty(DEGREE, np.int64), 0
    wrap_hull(u, v, count, first, -1.0, behind)
    while b < DEGREE and behind[b] >= 0:
        b += 1
    total = min(b - 1 + n, DEGREE)
    for k in range(total):
        out[k] = behind[b - 1 - k] if k < b else ahead[k - b + 1]
    return total, False


@kernel
def wrap_hull(u: F64, v: F64, count: int, first: int, side: float, out: I64) -> bool:
    """Corners of the convex hull of the points and the origin from ``first`` on, counter-clockwise
    for side 1; ends with -1. True where it comes back to the first without meeting the origin.
    """
    at, n = first, 1
    out[:] = -1
    out[0] = first
    while n < DEGREE:
        best, bu, bv = -1, -u[at], -v[at]  # the origin
        for k in range(count):
            if k == at:
                continue
            du, dv = u[k] - u[at], v[k] - v[at]
            turn = side * (bu * dv - bv * du)
            if turn < 0.0 or (turn == 0.0 and best >= 0 and du * du + dv * dv > bu * bu + bv * bv):
                best, bu, bv = k, du, dv
        if best == first:
            return True
        if best < 0:
            return False
        out[n], at, n = best, best, n + 1
    return False


@parallel_kernel
def stars(
    points: F64,
    normals: F64,
    index: I64,
    at: I64,
    reach: float,
    slack: float,
    out: I32,
    closed: I32,
) -> None:
    """The stars of points ``at`` among their neighbours (m, k), nearest first: rows of ``out`` (n,
    DEGREE), -1 at the end, and ``closed`` (n,), 1 where the triangles go all round. No side is
    longer than ``reach``.
    """
    for a in numba.prange(len(at)):
        i = at[a]
        x, y, name = (
            np.empty(index.shape[1]),
            np.empty(index.shape[1]),
            np.empty(index.shape[1], np.int32),
        )
        count = 0
        for j in index[a]:
            px, py, same = tangent_coordinates(points, normals, i, j, slack)
            if same and 0.0 < px * px + py * py <= reach * reach:
                x[count], y[count], name[count] = px, py, j
                count += 1
        row = np.empty(DEGREE, np.int32)
        size, full = star(x, y, count, row)
        out[i] = -1
        for k in range(size):
            out[i, k] = name[row[k]]
        closed[i] = full


@kernel
def star_has_edge(ring: I32, closed: I32, i: int, a: int, b: int) -> bool:
    """Whether b follows a in the star of i."""
    for k in range(DEGREE):
        if ring[i, k] < 0:
            return False
        if ring[i, k] == a:
            return next_in_star(ring, closed, i, k) == b
    return False


@kernel
def next_in_star(ring: I32, closed: I32, i: int, k: int) -> int:
    """The point that follows the one at place k in the star of i, or -1."""
    following: int = ring[i, k + 1] if k + 1 < DEGREE else -1
    if following < 0 and closed[i] > 0 and k > 1:
        following = ring[i, 0]
    return following


@kernel
def count_votes(
    points: F64, ring: I32, closed: I32, reach: float, triangles: I32, votes: I32
) -> int:
    """Write every triangle that is in a star and has no side longer than ``reach`` once, from the
    lowest corner that names it, and by how many of its corners it is named; how many triangles.
    """
    n = 0
    for i in range(len(ring)):
        for k in range(DEGREE):
            a = ring[i, k]
            b = next_in_star(ring, closed, i, k) if a >= 0 else -1
            if b < 0:
                break
            x, y, z = (
                points[a, 0] - points[b, 0],
                points[a, 1] - points[b, 1],
                points[a, 2] - points[b, 2],
            )
            by_a, by_b = star_has_edge(ring, closed, a, b, i), star_has_edge(ring, closed, b, i, a)
            if x * x + y * y + z * z > reach * reach or (by_a and a < i) or (by_b and b < i):
                continue
            triangles[n, 0], triangles[n, 1], triangles[n, 2] = i, a, b
            votes[n] = 1 + by_a + by_b
            n += 1
    return n


def count_star_triangles(points: F64, ring: I32, closed: I32, reach: float) -> tuple[I32, I32]:
    """Every triangle that is in a star (m, 3), once, and by how many of its corners it is named
    (m,): 1 to 3.
    """
    most = int(np.sum(ring >= 0))
    triangles, votes = np.empty((most, 3), np.int32), np.empty(most, np.int32)
    n = count_votes(points, ring, closed, reach, triangles, votes)
    return triangles[:n], votes[:n]
