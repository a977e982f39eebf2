"""Sharp features: several planes in one neighbourhood, where they meet, and the piece of each that
is surface.

Seed 002 section 4.2 handles edges of two planes and corners of three; here any number of planes may
meet, convex and concave, in any orientation. Planes are ``n·x = o`` in rows (n, o); all kernels
work on points (m, 3) about a local origin.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ladar_volume.math.array_types import F64, I64, U64
from ladar_volume.math.kernels import inlined, kernel, leaf_kernel
from ladar_volume.math.normal_equations import eigen
from ladar_volume.rmls.patch_fit import random_below

#: Most planes in one neighbourhood.
MOST = 8
#: A point scores for a plane within this many sigma: uniform noise ends at 1.73, a third of a plane
#: tilted across an edge lies beyond.
SCORE_SIGMAS = 2.2
#: A plane bounds another where no more of its points than this share, and this many besides, lie on
#: the far side: outliers do.
STRAY, STRAYS = 0.03, 2
#: Fewest points from which sides are told.
CLEAR = 12


@leaf_kernel
def distance(x: F64, plane: F64) -> Any:
    """Signed distance of a point (3,) to a plane (4,)."""
    return x[0] * plane[0] + x[1] * plane[1] + x[2] * plane[2] - plane[3]


@leaf_kernel
def plane_through(a: F64, b: F64, c: F64, plane: F64) -> Any:
    """The plane through three points; False where they are nearly in line."""
    u0, u1, u2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    v0, v1, v2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    n0, n1, n2 = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
    length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    sides = np.sqrt((u0 * u0 + u1 * u1 + u2 * u2) * (v0 * v0 + v1 * v1 + v2 * v2))
    if not length > 0.2 * sides:
        return False
    plane[0], plane[1], plane[2] = n0 / length, n1 / length, n2 / length
    plane[3] = plane[0] * a[0] + plane[1] * a[1] + plane[2] * a[2]
    return True


@kernel
def _draw_two_neighbours(x: F64, free: I64, m: int, a: int, reach: float, state: U64) -> Any:
    """Two random points of ``free[:m]`` within ``reach`` of point a; returns (first, second, how
    many were found).
    """
    found = 0
    b = c = a
    for _ in range(12):
        k = free[random_below(state, m)]
        d = (x[k, 0] - x[a, 0]) ** 2 + (x[k, 1] - x[a, 1]) ** 2 + (x[k, 2] - x[a, 2]) ** 2
        if k == a or k == b or d > reach * reach:
            continue
        if found == 0:
            b = k
        else:
            c = k
        found += 1
        if found == 2:
            break
    return b, c, found


@leaf_kernel
def _score(x: F64, free: I64, m: int, trial: F64, limit: float, best: float) -> Any:
    """Truncated score of a plane by the points ``free[:m]``; less where it cannot exceed the
    best.
    """
    score = 0.0
    for i in range(m):
        d = distance(x[free[i]], trial)
        if d * d < limit:
            score += limit - d * d
        if score + (m - i) * limit <= best:
            break
    return score


@inlined
def best_plane(
    x: F64, free: I64, m: int, reach: float, threshold: float, trials: int, state: U64, plane: F64
) -> Any:
    """The plane through three of the points ``free[:m]`` within ``reach`` of each other with the
    best truncated score (MSAC).

    Samples are local: where five planes meet, three random points lie on one of them once in
    twenty-five times, three neighbours far more often. Returns the score, 0 where no sample was
    usable.
    """
    trial = np.empty(4)
    limit = threshold * threshold
    best = 0.0
    for _ in range(trials):
        a = free[random_below(state, m)]
        b, c, found = _draw_two_neighbours(x, free, m, a, reach, state)
        if found < 2 or not plane_through(x[a], x[b], x[c], trial):
            continue
        score = _score(x, free, m, trial, limit, best)
        if score > best:
            best = score
            plane[:] = trial
    return best


@leaf_kernel
def _weighted_scatter(x: F64, m: int, share: F64, mean: F64, S: F64) -> None:
    """Scatter (3, 3) of points (m, 3) about their mean, by their shares, to S."""
    s00 = s01 = s02 = s11 = s12 = s22 = 0.0
    for i in range(m):
        if share[i] > 0.0:
            d0, d1, d2 = x[i, 0] - mean[0], x[i, 1] - mean[1], x[i, 2] - mean[2]
            e0, e1, e2 = share[i] * d0, share[i] * d1, share[i] * d2
            s00 += e0 * d0
            s01 += e0 * d1
            s02 += e0 * d2
            s11 += e1 * d1
            s12 += e1 * d2
            s22 += e2 * d2
    S[0, 0], S[1, 1], S[2, 2] = s00, s11, s22
    S[0, 1] = S[1, 0] = s01
    S[0, 2] = S[2, 0] = s02
    S[1, 2] = S[2, 1] = s12


@kernel
def fit_shares(x: F64, m: int, share: F64, plane: F64, mean: F64, inverse: F64) -> Any:
    """Orthogonal least squares of points (m, 3) that count by their shares (m,); returns the sum of
    the shares, 0 where they determine no plane.

    The inverse (3, 3) is that of the scatter about the mean with the normal's own direction set
    aside: the covariance of the plane's two tilts is sigma² times its projection.
    """
    total = 0.0
    mean[:] = 0.0
    for i in range(m):
        total += share[i]
        for k in range(3):
            mean[k] += share[i] * x[i, k]
    if total < 3.0:
        return 0.0
    for k in range(3):
        mean[k] /= total
    S, value, vector = np.empty((3, 3)), np.empty(3), np.empty((3, 3))
    _weighted_scatter(x, m, share, mean, S)
    eigen(S, value, vector)
    if not value[1] > 1e-12 * max(value[2], 1e-300):
        return 0.0
    n0, n1, n2 = vector[0, 0], vector[1, 0], vector[2, 0]
    if n0 * plane[0] + n1 * plane[1] + n2 * plane[2] < 0.0:
        n0, n1, n2 = -n0, -n1, -n2
    plane[0], plane[1], plane[2] = n0, n1, n2
    plane[3] = n0 * mean[0] + n1 * mean[1] + n2 * mean[2]
    for i in range(3):
        for j in range(3):
            inverse[i, j] = (
                vector[i, 1] * vector[j, 1] / value[1] + vector[i, 2] * vector[j, 2] / value[2]
            )
    return total


@kernel
def fit_plane(x: F64, m: int, label: I64, own: int, plane: F64, mean: F64, inverse: F64) -> Any:
    """Orthogonal least squares of the points labelled ``own``, as :func:`fit_shares`; returns their
    number, 0 for less than four.
    """
    share, n = np.zeros(m), 0
    for i in range(m):
        if label[i] == own:
            share[i] = 1.0
            n += 1
    if n < 4 or fit_shares(x, m, share, plane, mean, inverse) == 0.0:
        return 0
    return n


@leaf_kernel
def on_line(used: float, inverse: F64, across: float) -> Any:
    """Whether the points of a plane, ``used`` in number, lie on a line: their second extent is
    below ``across`` (with equal extents, 1.4 times that). One ring of a rotating scanner is such a
    line, and its cone a plane that any noise of the ranges fits.
    """
    return used * (inverse[0, 0] + inverse[1, 1] + inverse[2, 2]) * across * across > 1.0


@leaf_kernel
def plane_share(x: F64, used: float, mean: F64, inverse: F64) -> Any:
    """Variance of a plane at x (3,) on it over the noise's, from what :func:`fit_plane` gave."""
    share = 1.0 / used
    for k in range(3):
        for l in range(3):
            share += (x[k] - mean[k]) * inverse[k, l] * (x[l] - mean[l])
    return share


@leaf_kernel
def squared_distances(x: F64, m: int, planes: F64, count: int, out: F64) -> None:
    """Squared distances of points (m, 3) to planes, to out (count, m)."""
    for a in range(count):
        for i in range(m):
            d = distance(x[i], planes[a])
            out[a, i] = d * d


@kernel
def nearest_pieces(
    x: F64, m: int, planes: F64, count: int, side: I64, limit: float, label: I64
) -> None:
    """Label every point with the plane of its nearest piece, −1 beyond the limit of squared
    distance.
    """
    q = np.empty(3)
    for i in range(m):
        a, square, _ = nearest_piece(x[i], planes, count, side, q)
        label[i] = a if square <= limit else -1


@leaf_kernel
def nearest_planes(x: F64, m: int, planes: F64, count: int, limit: float, label: I64) -> Any:
    """Label every point with its nearest plane, −1 beyond the limit of squared distance; returns
    the sum of squares, each at most the limit: never more than that of the distances to the pieces.
    """
    square = 0.0
    for i in range(m):
        nearest = limit
        label[i] = -1
        for k in range(count):
            d = distance(x[i], planes[k])
            if d * d < nearest:
                nearest = d * d
                label[i] = k
        square += nearest
    return square


@kernel
def bounding_sides(
    x: F64, m: int, label: I64, planes: F64, count: int, sigma: float, side: I64
) -> None:
    """side (k, k): +1 or −1 where a plane's support lies on that side of another plane, 0 where it
    lies on both.

    Points within the noise of the other plane do not tell.
    """
    above, total = np.zeros((MOST, MOST), np.int64), np.zeros((MOST, MOST), np.int64)
    _count_sides(x, m, label, planes, count, 2.0 * sigma, above, total)
    for a in range(count):
        for b in range(count):
            side[a, b] = 0
            if a == b or total[a, b] < CLEAR:
                continue
            below = total[a, b] - above[a, b]
            if min(above[a, b], below) <= STRAY * total[a, b] + STRAYS:
                side[a, b] = 1 if above[a, b] > below else -1


@leaf_kernel
def _count_sides(
    x: F64, m: int, label: I64, planes: F64, count: int, doubt: float, above: I64, total: I64
) -> None:
    """Of the points of each plane that lie farther than ``doubt`` from each other plane: all of
    them, and those above it.
    """
    for i in range(m):
        a = label[i]
        if a < 0:
            continue
        for b in range(count):
            d = distance(x[i], planes[b])
            if abs(d) > doubt:
                total[a, b] += 1
                above[a, b] += d > 0.0


@leaf_kernel
def _farthest_bounding_plane(
    q0: float, q1: float, q2: float, a: int, planes: F64, count: int, side: I64, skip: int
) -> Any:
    """Of the planes that bound plane a, the one q lies farthest beyond; −1 where it lies beyond
    none.
    """
    worst, depth = -1, 1e-9
    for b in range(count):
        if b == skip or side[a, b] == 0:
            continue
        d = -side[a, b] * (q0 * planes[b, 0] + q1 * planes[b, 1] + q2 * planes[b, 2] - planes[b, 3])
        if d > depth:
            worst, depth = b, d
    return worst


@leaf_kernel
def nearest_on_piece(x: F64, a: int, planes: F64, count: int, side: I64) -> Any:
    """The nearest point of the bounded piece of plane a, as (q0, q1, q2, on): on = 0 inside it, 1
    on an edge, 2 in a vertex.
    """
    n0, n1, n2 = planes[a, 0], planes[a, 1], planes[a, 2]
    d = distance(x, planes[a])
    q0, q1, q2 = x[0] - d * n0, x[1] - d * n1, x[2] - d * n2
    b = _farthest_bounding_plane(q0, q1, q2, a, planes, count, side, -1)
    if b < 0:
        return q0, q1, q2, 0
    b0, b1, b2 = planes[b, 0], planes[b, 1], planes[b, 2]
    c = n0 * b0 + n1 * b1 + n2 * b2
    square = 1.0 - c * c
    if square < 1e-4:
        return q0, q1, q2, 0
    g = (q0 * b0 + q1 * b1 + q2 * b2 - planes[b, 3]) / square
    q0, q1, q2 = q0 - g * (b0 - c * n0), q1 - g * (b1 - c * n1), q2 - g * (b2 - c * n2)
    e = _farthest_bounding_plane(q0, q1, q2, a, planes, count, side, b)
    if e < 0:
        return q0, q1, q2, 1
    l0, l1, l2 = n1 * b2 - n2 * b1, n2 * b0 - n0 * b2, n0 * b1 - n1 * b0
    along = l0 * planes[e, 0] + l1 * planes[e, 1] + l2 * planes[e, 2]
    if abs(along) < 1e-2 * np.sqrt(square):
        return q0, q1, q2, 1
    h = (q0 * planes[e, 0] + q1 * planes[e, 1] + q2 * planes[e, 2] - planes[e, 3]) / along
    return q0 - h * l0, q1 - h * l1, q2 - h * l2, 2


@leaf_kernel
def nearest_piece(x: F64, planes: F64, count: int, side: I64, q: F64) -> Any:
    """(plane, squared distance, 0 | 1 | 2 as :func:`nearest_on_piece`) of the piece nearest to x,
    with the point q on it.
    """
    best, which, kind = np.inf, -1, 0
    for a in range(count):
        if distance(x, planes[a]) ** 2 >= best:  # no piece is nearer than its plane
            continue
        q0, q1, q2, on = nearest_on_piece(x, a, planes, count, side)
        square = (x[0] - q0) ** 2 + (x[1] - q1) ** 2 + (x[2] - q2) ** 2
        if square < best:
            best, which, kind = square, a, on
            q[0], q[1], q[2] = q0, q1, q2
    return which, best, kind
