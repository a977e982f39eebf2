"""Which planes, and how many, a neighbourhood consists of: the shortest description of its
points.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ladar_volume.clouds.filter.plane_em import pieces_cost
from ladar_volume.clouds.filter.sharp_planes import (
    MOST,
    bounds,
    fit_plane,
    nearest_piece,
    nearest_pieces,
    nearest_planes,
    squares,
)
from ladar_volume.math.array_types import F64, I64
from ladar_volume.math.kernels import kernel, leaf_kernel

#: Least share of the points a plane needs: outliers give this much to any slab. Half of it where a
#: neighbour found the plane.
CHANCE = 0.03
#: Most points looked at to choose planes.
SEEN = 250
#: Mean truncated square over sigma² of a choice that needs no search: noise, and outliers of a few
#: per cent.
ENOUGH = 1.2
#: Share of the points that planes must explain, with no more than the noise left, to need no
#: comparison.
EXPLAINS = 0.85
#: Lent sets compared by all points: so many, none of them longer than the best by more than this
#: factor on a sample.
TIGHT, NEARLY = 5, 1.1
#: So many planes that still leave this mean truncated square over sigma² do not describe a surface:
#: leaves, grass, cables.
SEVERAL, CLUTTER = 3, 3.0
#: Mean square over sigma² of the points within the threshold of a plane that has none of its own;
#: evenly filled slabs give 3.
HOPELESS = 2.0
#: Planes nowhere in half the neighbourhood farther apart than this many sigma are one to start
#: from: refitting makes them the same.
REPEATED = 0.3
#: Most candidates tried, and how many of them in all combinations.
TRIED, TOGETHER = 10, 3


@leaf_kernel
def sum_of_less(a: F64, b: F64, n: int) -> Any:
    """Sum of the lesser of two numbers over n pairs; in eight sums, so that one addition need not
    wait for the last.
    """
    s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = 0.0
    whole = n - n % 8
    for i in range(0, whole, 8):
        s0 += min(a[i], b[i])
        s1 += min(a[i + 1], b[i + 1])
        s2 += min(a[i + 2], b[i + 2])
        s3 += min(a[i + 3], b[i + 3])
        s4 += min(a[i + 4], b[i + 4])
        s5 += min(a[i + 5], b[i + 5])
        s6 += min(a[i + 6], b[i + 6])
        s7 += min(a[i + 7], b[i + 7])
    for i in range(whole, n):
        s0 += min(a[i], b[i])
    return ((s0 + s1) + (s2 + s3)) + ((s4 + s5) + (s6 + s7))


@kernel
def distinct(
    y: F64, n: int, candidates: F64, offered: int, limit: float, worth: float, out: F64
) -> Any:
    """A few candidates, each the one that explains most of what those before it leave, to out (k,
    4); returns how many. One that lowers the sum of squares by no more than it is ``worth`` is no
    other plane, but one of those before as another cell found it.

    What a candidate explains becomes less with every one before it, so it is computed anew only
    where it was the most so far.
    """
    square, residual = np.empty((offered, n)), np.full(n, limit)
    squares(y, n, candidates, offered, square)
    gain, known, number = np.full(offered, np.inf), np.full(offered, -1), 0
    while number < min(len(out), offered):
        c, left = np.argmax(gain), residual.sum()
        while known[c] < number:
            gain[c], known[c] = left - sum_of_less(residual, square[c], n), number
            c = np.argmax(gain)
        if gain[c] <= worth:
            break
        out[number], gain[c] = candidates[c], -np.inf
        for i in range(n):
            residual[i] = min(residual[i], square[c, i])
        number += 1
    return number


@kernel
def description(
    y: F64,
    n: int,
    trial: F64,
    size: int,
    m: int,
    sigma: float,
    threshold: float,
    need: Any,
    most: float,
    side: I64,
    label: I64,
) -> Any:
    """Description length of m points, of which the n points y (n, 3) are a sample, with these
    planes; infinite where one of the planes has less than ``need`` points of the sample, or where
    it exceeds ``most``.
    """
    support = np.empty(MOST, np.int64)
    limit = threshold * threshold
    price = 3.0 * size * np.log(m) * sigma * sigma
    if nearest_planes(y, n, trial, size, limit, label) * m / n + price >= most:
        return np.inf
    bounds(y, n, label, trial, size, sigma, side)
    length, _ = pieces_cost(y, n, trial, size, side, limit, sigma, (most - price) * n / m, support)
    length = length * m / n + price
    return length if length < most and support[:size].min() >= need else np.inf


@leaf_kernel
def _cut_off(square: F64, tried: int, n: int, limit: float, sigma: float) -> Any:
    """Cut squares (tried, n) off at the limit; returns whether all planes are clutter's: no plane's
    own points scatter about it less than its slab's width lets them.
    """
    clutter = True
    for c in range(tried):
        near, inside = 0, 0.0
        for i in range(n):
            if square[c, i] < limit:
                near += 1
                inside += square[c, i]
            else:
                square[c, i] = limit
        clutter = clutter and inside > HOPELESS * near * sigma * sigma
    return clutter


@kernel
def _all_sets(
    square: F64, tried: int, m: int, price: float, most: int, sets: I64, least: F64
) -> Any:
    """All sets of up to ``most`` and ``TOGETHER`` candidates with squares (tried, n), to sets (k,
    TOGETHER), and lower bounds of their description of m points, to least (k,); returns how many.
    """
    n, number = square.shape[1], 0
    pair = np.empty(n)
    for a in range(tried):
        for b in range(a, tried):
            pair[:] = np.minimum(square[a], square[b])
            for c in range(b, tried):
                size = 1 + (b > a) + (c > b)
                if size > most or (a == b and c > b):  # every set once: a, ab as abb, abc
                    continue
                total = sum_of_less(pair, square[c], n)
                sets[number, 0], sets[number, 1], sets[number, 2] = a, b, c
                least[number] = total * m / n + size * price
                number += 1
    return number


@kernel
def few_planes(
    y: F64,
    n: int,
    few: F64,
    tried: int,
    m: int,
    sigma: float,
    threshold: float,
    need: int,
    most: int,
    planes: F64,
    side: I64,
    label: I64,
) -> Any:
    """The best set of up to ``TOGETHER`` candidates, all sets compared. Returns (number of planes,
    description length).

    The sum over the points of the square to the nearest of the unbounded planes is a lower bound;
    sets come in its order. Where not one is below what clutter leaves, and no plane's own points
    scatter about it less than its slab's width lets them, there is none.
    """
    limit = threshold * threshold
    square, room = np.empty((tried, n)), tried * (tried * tried + 5) // 6
    squares(y, n, few, tried, square)
    clutter = _cut_off(square, tried, n, limit, sigma)
    sets, least = np.empty((room, TOGETHER), np.int64), np.empty(room)
    number = _all_sets(square, tried, m, 3.0 * np.log(m) * sigma * sigma, most, sets, least)
    trial = np.empty((MOST, 4))
    count, cost = 0, limit * m
    if tried == 0 or (clutter and least[:number].min() > CLUTTER * m * sigma * sigma):
        return 0, np.inf
    for s in np.argsort(least[:number]):
        if least[s] >= cost:
            break
        a, b, c = sets[s]
        size = 1 + (b > a) + (c > b)
        trial[0], trial[1], trial[2] = few[a], few[b], few[c]
        length = description(y, n, trial, size, m, sigma, threshold, need, cost, side, label)
        if length < cost:
            count, cost = size, length
            planes[:size] = trial[:size]
    return count, cost


@kernel
def polish(
    y: F64,
    n: int,
    count: int,
    cost: float,
    m: int,
    sigma: float,
    threshold: float,
    need: int,
    planes: F64,
    side: I64,
    label: I64,
) -> Any:
    """Refit the planes to the points nearest to their pieces, where that shortens the description;
    returns its length.
    """
    trial, mean, inverse = np.empty((MOST, 4)), np.empty(3), np.empty((3, 3))
    limit = threshold * threshold
    nearest_planes(y, n, planes, count, limit, label)
    bounds(y, n, label, planes, count, sigma, side)
    nearest_pieces(y, n, planes, count, side, limit, label)
    trial[:count] = planes[:count]
    for k in range(count):
        fit_plane(y, n, label, k, trial[k], mean, inverse)
    length = description(y, n, trial, count, m, sigma, threshold, need, cost, side, label)
    if length < cost:
        planes[:count] = trial[:count]
        return length
    return cost


@kernel
def without(planes: F64, size: int, k: int | np.intp, out: F64) -> Any:
    """All of ``size`` planes but the one numbered k, to out, which may be ``planes``; returns how
    many.
    """
    for a in range(size - 1):
        out[a] = planes[a + (a >= k)]
    return size - 1


@kernel
def search(
    y: F64,
    n: int,
    few: F64,
    tried: int,
    m: int,
    sigma: float,
    threshold: float,
    need: int,
    most: int,
    planes: F64,
    side: I64,
    label: I64,
) -> Any:
    """At most ``most`` planes: the best few, then added, exchanged and dropped one at a time,
    whatever shortens the description most, and refitted after every such move; none for clutter.
    Returns (number of planes, description length).
    """
    trial, best_set = np.empty((MOST, 4)), np.empty((MOST, 4))
    count, cost = few_planes(y, n, few, tried, m, sigma, threshold, need, most, planes, side, label)
    if count == 0:
        return 0, np.inf
    for _ in range(2 * MOST):
        if count >= SEVERAL and cost > CLUTTER * m * sigma * sigma:
            return 0, np.inf
        cost = polish(y, n, count, cost, m, sigma, threshold, need, planes, side, label)
        best, best_count = cost, -1
        for c in range(-1, tried):
            # move k: plane k exchanged for candidate c, or dropped for c = −1; k = count: added
            for k in range(count + (c >= 0 and count < most)):
                if c >= 0:
                    trial[:count] = planes[:count]
                    trial[k], size = few[c], max(count, k + 1)
                else:
                    size = without(planes, count, k, trial)
                if size == 0:
                    continue
                length = description(
                    y, n, trial, size, m, sigma, threshold, need, best, side, label
                )
                if length < best:
                    best, best_count = length, size
                    best_set[:size] = trial[:size]
        if best_count < 0:
            break
        count, cost = best_count, best
        planes[:count] = best_set[:count]
    return count, cost


@kernel
def sample(x: F64, m: int, least: int) -> Any:
    """At most ``SEEN`` of the points x[:m], and how many of them a plane needs."""
    stride = (m + SEEN - 1) // SEEN
    y = x[:m:stride]
    return y, max(least // stride, np.int64(CHANCE * len(y)), 1)


@leaf_kernel
def same(a: F64, b: F64, reach: float, limit: float) -> Any:
    """Whether two planes about an origin are nowhere within ``reach`` of it farther apart than the
    limit.
    """
    s = 1.0 if a[0] * b[0] + a[1] * b[1] + a[2] * b[2] > 0.0 else -1.0
    turn = (a[0] - s * b[0]) ** 2 + (a[1] - s * b[1]) ** 2 + (a[2] - s * b[2]) ** 2
    return abs(a[3] - s * b[3]) + reach * np.sqrt(turn) < limit


@kernel
def among(plane: F64, planes: F64, count: int, reach: float, limit: float) -> Any:
    """Whether a plane is one of ``count`` planes (k, 4), as :func:`same`."""
    for a in range(count):
        if same(plane, planes[a], reach, limit):
            return True
    return False


@kernel
def repeated(lent: F64, sizes: I64, a: int, reach: float, limit: float) -> Any:
    """Whether set ``a`` has the same planes as one before it."""
    for b in range(a):
        if sizes[b] == sizes[a]:
            known = 0
            while known < sizes[a] and among(lent[a, known], lent[b], sizes[b], reach, limit):
                known += 1
            if known == sizes[a]:
                return True
    return False


@kernel
def best_lent(
    x: F64,
    m: int,
    reach: float,
    lent: F64,
    sizes: I64,
    sigma: float,
    threshold: float,
    least: int,
    planes: F64,
    side: I64,
    label: I64,
) -> Any:
    """Of the sets (k, MOST, 4) that neighbours chose, the one with the shortest description of the
    points (m, 3), of the ``TIGHT`` best different ones by a sample. Returns (number of planes,
    length); a plane that a neighbour found needs half as many points here.
    """
    y, need = sample(x, m, least)
    length, shortest = np.full(len(lent), np.inf), threshold * threshold * m
    for a in range(len(lent)):
        if not repeated(lent, sizes, a, reach, REPEATED * sigma):
            length[a] = description(
                y,
                len(y),
                lent[a],
                sizes[a],
                m,
                sigma,
                threshold,
                max(need // 2, 1),
                NEARLY * shortest,
                side,
                label,
            )
            shortest = min(shortest, length[a])
    count, cost, need = 0, threshold * threshold * m, max(least // 2, np.int64(0.5 * CHANCE * m))
    for a in np.argsort(length)[:TIGHT]:
        if length[a] < np.inf:
            total = description(
                x, m, lent[a], sizes[a], m, sigma, threshold, need, cost, side, label
            )
            if total < cost:
                count, cost = sizes[a], total
                planes[:count] = lent[a, :count]
    return count, cost


@kernel
def steady(
    x: F64,
    m: int,
    own: F64,
    planes: F64,
    count: int,
    sigma: float,
    threshold: float,
    side: I64,
    label: I64,
) -> Any:
    """How well the pieces explain the points (m, 3), and the cell's ``own`` (k, 3) in particular: 2
    where most lie on them and these scatter no more than the noise, 1 where they need no further
    search, 0 where they leave more than that.
    """
    nearest_planes(x, m, planes, count, threshold * threshold, label)
    bounds(x, m, label, planes, count, sigma, side)
    q, left, near, square = np.empty(3), 0, 0, 0.0
    for i in range(len(own)):
        left += nearest_piece(own[i], planes, count, side, q)[1] > threshold * threshold
    for i in range(m):
        d2 = nearest_piece(x[i], planes, count, side, q)[1]
        if d2 <= threshold * threshold:
            near += 1
            square += d2 / (sigma * sigma)
    if left > CHANCE * len(own):
        return 0
    if near > EXPLAINS * m and square < near * (1.0 + 2.0 / np.sqrt(near)):
        return 2
    return np.int64(square + (m - near) * (threshold / sigma) ** 2 <= ENOUGH * m)


@kernel
def found_planes(
    x: F64,
    m: int,
    candidates: F64,
    offered: int,
    sigma: float,
    threshold: float,
    least: int,
    most: int,
    planes: F64,
    side: I64,
    label: I64,
) -> Any:
    """At most ``most`` planes among the ``offered`` candidates whose pieces together describe the
    points (m, 3) best.

    Returns (their number, length). A plane costs its three parameters (BIC) and needs more support
    than outliers give any slab.
    """
    y, need = sample(x, m, least)
    few = np.empty((TRIED, 4))
    worth = (
        3.0 * np.log(m) * sigma * sigma * len(y) / m
    )  # its price: what is explained by less cannot be added
    tried = distinct(y, len(y), candidates, offered, threshold * threshold, worth, few)
    return search(y, len(y), few, tried, m, sigma, threshold, need, most, planes, side, label)
