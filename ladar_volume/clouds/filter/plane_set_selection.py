"""Which planes, and how many, a neighbourhood consists of: the shortest description of its
points.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ladar_volume.clouds.filter.cell_records import NeighbourSets, PieceBounds, PointSample
from ladar_volume.clouds.filter.plane_em import pieces_cost
from ladar_volume.clouds.filter.sharp_planes import (
    MOST,
    bounding_sides,
    fit_plane,
    nearest_piece,
    nearest_pieces,
    nearest_planes,
    squared_distances,
)
from ladar_volume.math.array_types import F64, I64
from ladar_volume.math.kernels import inlined, kernel, leaf_kernel

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
#: Neighbours' sets compared by all points: so many, none of them longer than the best by more than
#: this factor on a sample.
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
def sum_of_minima(a: F64, b: F64, n: int) -> Any:
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


@inlined
def greedy_candidates(sample: PointSample, candidates: F64, worth: float, out: F64) -> Any:
    """A few candidates (c, 4), each the one that explains most of what those before it leave, to
    out (k, 4); returns how many. One that lowers the sum of squares by no more than it is ``worth``
    is no other plane, but one of those before as another cell found it.

    What a candidate explains becomes less with every one before it, so it is computed anew only
    where it was the most so far.
    """
    offered, n = len(candidates), sample.n
    square, residual = np.empty((offered, n)), np.full(n, sample.threshold * sample.threshold)
    squared_distances(sample.x, n, candidates, offered, square)
    gain, known, number = np.full(offered, np.inf), np.full(offered, -1), 0
    while number < min(len(out), offered):
        c, left = np.argmax(gain), residual.sum()
        while known[c] < number:
            gain[c], known[c] = left - sum_of_minima(residual, square[c], n), number
            c = np.argmax(gain)
        if gain[c] <= worth:
            break
        out[number], gain[c] = candidates[c], -np.inf
        for i in range(n):
            residual[i] = min(residual[i], square[c, i])
        number += 1
    return number


@kernel
def description_length(
    sample: PointSample, trial: F64, size: int, need: int, most: float, bounds: PieceBounds
) -> Any:
    """Description length of the points that the sample stands for with these planes; infinite where
    one of the planes has less than ``need`` points of the sample, or where it exceeds ``most``.
    """
    x, n, m, sigma = sample.x, sample.n, sample.m, sample.sigma
    support, limit = np.empty(MOST, np.int64), sample.threshold * sample.threshold
    price = 3.0 * size * np.log(m) * sigma * sigma
    if nearest_planes(x, n, trial, size, limit, bounds.label) * m / n + price >= most:
        return np.inf
    bounding_sides(x, n, bounds.label, trial, size, sigma, bounds.side)
    length, _ = pieces_cost(sample, trial, size, bounds.side, (most - price) * n / m, support)
    length = length * m / n + price
    return length if length < most and support[:size].min() >= need else np.inf


@leaf_kernel
def _truncate_squares(square: F64, tried: int, n: int, limit: float, sigma: float) -> Any:
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
                total = sum_of_minima(pair, square[c], n)
                sets[number, 0], sets[number, 1], sets[number, 2] = a, b, c
                least[number] = total * m / n + size * price
                number += 1
    return number


@kernel
def best_small_set(
    sample: PointSample, few: F64, need: int, most: int, planes: F64, bounds: PieceBounds
) -> Any:
    """The best set of up to ``TOGETHER`` of the candidates (c, 4), all sets compared. Returns
    (number of planes, description length).

    The sum over the points of the square to the nearest of the unbounded planes is a lower bound;
    sets come in its order. Where not one is below what clutter leaves, and no plane's own points
    scatter about it less than its slab's width lets them, there is none.
    """
    n, m, sigma, tried = sample.n, sample.m, sample.sigma, len(few)
    limit = sample.threshold * sample.threshold
    square, room = np.empty((tried, n)), tried * (tried * tried + 5) // 6
    squared_distances(sample.x, n, few, tried, square)
    clutter = _truncate_squares(square, tried, n, limit, sigma)
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
        length = description_length(sample, trial, size, need, cost, bounds)
        if length < cost:
            count, cost = size, length
            planes[:size] = trial[:size]
    return count, cost


@inlined
def refit_nearest(
    sample: PointSample, count: int, cost: float, need: int, planes: F64, bounds: PieceBounds
) -> Any:
    """Refit the planes to the points nearest to their pieces, where that shortens the description;
    returns its length.
    """
    x, n, side, label = sample.x, sample.n, bounds.side, bounds.label
    trial, mean, inverse = np.empty((MOST, 4)), np.empty(3), np.empty((3, 3))
    limit = sample.threshold * sample.threshold
    nearest_planes(x, n, planes, count, limit, label)
    bounding_sides(x, n, label, planes, count, sample.sigma, side)
    nearest_pieces(x, n, planes, count, side, limit, label)
    trial[:count] = planes[:count]
    for k in range(count):
        fit_plane(x, n, label, k, trial[k], mean, inverse)
    length = description_length(sample, trial, count, need, cost, bounds)
    if length < cost:
        planes[:count] = trial[:count]
        return length
    return cost


@kernel
def remove_plane(planes: F64, size: int, k: int | np.intp, out: F64) -> Any:
    """All of ``size`` planes but the one numbered k, to out, which may be ``planes``; returns how
    many.
    """
    for a in range(size - 1):
        out[a] = planes[a + (a >= k)]
    return size - 1


@inlined
def _best_move(
    sample: PointSample,
    few: F64,
    need: int,
    most: int,
    state: tuple[int, float],
    planes: F64,
    bounds: PieceBounds,
) -> Any:
    """The one plane added, exchanged or dropped that shortens the description of ``state`` (number
    of planes, length) most, made in ``planes``. Returns (number of planes, length), −1 where none
    does.
    """
    trial, best_set = np.empty((MOST, 4)), np.empty((MOST, 4))
    count, best = state
    best_count = -1
    for c in range(-1, len(few)):
        # move k: plane k exchanged for candidate c, or dropped for c = −1; k = count: added
        for k in range(count + (c >= 0 and count < most)):
            if c >= 0:
                trial[:count] = planes[:count]
                trial[k], size = few[c], max(count, k + 1)
            else:
                size = remove_plane(planes, count, k, trial)
            if size == 0:
                continue
            length = description_length(sample, trial, size, need, best, bounds)
            if length < best:
                best, best_count = length, size
                best_set[:size] = trial[:size]
    if best_count > 0:
        planes[:best_count] = best_set[:best_count]
    return best_count, best


@inlined
def exchange_search(
    sample: PointSample, few: F64, need: int, most: int, planes: F64, bounds: PieceBounds
) -> Any:
    """At most ``most`` planes: the best few, then added, exchanged and dropped one at a time,
    whatever shortens the description most, and refitted after every such move; none for clutter.
    Returns (number of planes, description length).
    """
    count, cost = best_small_set(sample, few, need, most, planes, bounds)
    if count == 0:
        return 0, np.inf
    for _ in range(2 * MOST):
        if count >= SEVERAL and cost > CLUTTER * sample.m * sample.sigma * sample.sigma:
            return 0, np.inf
        cost = refit_nearest(sample, count, cost, need, planes, bounds)
        changed, length = _best_move(sample, few, need, most, (count, cost), planes, bounds)
        if changed < 0:
            break
        count, cost = changed, length
    return count, cost


@kernel
def thin_sample(whole: PointSample, least: int) -> Any:
    """At most ``SEEN`` of the points of a whole neighbourhood, and how many of them a plane
    needs.
    """
    stride = (whole.m + SEEN - 1) // SEEN
    # a copy has the layout of a whole neighbourhood: what takes either is compiled once
    y = whole.x[: whole.m : stride].copy()
    need = max(least // stride, np.int64(CHANCE * len(y)), 1)
    return PointSample(y, len(y), whole.m, whole.sigma, whole.threshold), need


@leaf_kernel
def planes_coincide(a: F64, b: F64, reach: float, limit: float) -> Any:
    """Whether two planes about an origin are nowhere within ``reach`` of it farther apart than the
    limit.
    """
    s = 1.0 if a[0] * b[0] + a[1] * b[1] + a[2] * b[2] > 0.0 else -1.0
    turn = (a[0] - s * b[0]) ** 2 + (a[1] - s * b[1]) ** 2 + (a[2] - s * b[2]) ** 2
    return abs(a[3] - s * b[3]) + reach * np.sqrt(turn) < limit


@kernel
def contains_plane(planes: F64, count: int, plane: F64, reach: float, limit: float) -> Any:
    """Whether one of ``count`` planes (k, 4) coincides with a plane, as :func:`planes_coincide`."""
    for a in range(count):
        if planes_coincide(plane, planes[a], reach, limit):
            return True
    return False


@kernel
def repeats_earlier_set(sets: NeighbourSets, a: int, reach: float, limit: float) -> Any:
    """Whether set ``a`` has the same planes as one before it."""
    planes, sizes = sets
    for b in range(a):
        if sizes[b] == sizes[a]:
            known = 0
            while known < sizes[a] and contains_plane(
                planes[b], sizes[b], planes[a, known], reach, limit
            ):
                known += 1
            if known == sizes[a]:
                return True
    return False


@kernel
def best_neighbour_set(
    whole: PointSample,
    reach: float,
    sets: NeighbourSets,
    least: int,
    planes: F64,
    bounds: PieceBounds,
) -> Any:
    """Of the sets that neighbours chose, the one with the shortest description of all points, of
    the ``TIGHT`` best different ones by a sample. Returns (number of planes, length); a plane that
    a neighbour found needs half as many points here.
    """
    m, limit = whole.m, whole.threshold * whole.threshold
    sample, need = thin_sample(whole, least)
    length, shortest = np.full(len(sets.planes), np.inf), limit * m
    for a in range(len(sets.planes)):
        if not repeats_earlier_set(sets, a, reach, REPEATED * whole.sigma):
            length[a] = description_length(
                sample,
                sets.planes[a],
                sets.sizes[a],
                max(need // 2, 1),
                NEARLY * shortest,
                bounds,
            )
            shortest = min(shortest, length[a])
    count, cost, need = 0, limit * m, max(least // 2, int(0.5 * CHANCE * m))
    for a in np.argsort(length)[:TIGHT]:
        if length[a] < np.inf:
            size = sets.sizes[a]
            total = description_length(whole, sets.planes[a], size, need, cost, bounds)
            if total < cost:
                count, cost = size, total
                planes[:count] = sets.planes[a, :count]
    return count, cost


@kernel
def fit_quality(whole: PointSample, own: F64, planes: F64, count: int, bounds: PieceBounds) -> Any:
    """How well the pieces explain all points, and the cell's ``own`` (k, 3) in particular: 2
    where most lie on them and these scatter no more than the noise, 1 where they need no further
    search, 0 where they leave more than that.
    """
    x, m, sigma, side, label = whole.x, whole.m, whole.sigma, bounds.side, bounds.label
    limit = whole.threshold * whole.threshold
    nearest_planes(x, m, planes, count, limit, label)
    bounding_sides(x, m, label, planes, count, sigma, side)
    q, left, near, square = np.empty(3), 0, 0, 0.0
    for i in range(len(own)):
        left += nearest_piece(own[i], planes, count, side, q)[1] > limit
    for i in range(m):
        d2 = nearest_piece(x[i], planes, count, side, q)[1]
        if d2 <= limit:
            near += 1
            square += d2 / (sigma * sigma)
    if left > CHANCE * len(own):
        return 0
    if near > EXPLAINS * m and square < near * (1.0 + 2.0 / np.sqrt(near)):
        return 2
    return np.int64(square + (m - near) * (whole.threshold / sigma) ** 2 <= ENOUGH * m)


@inlined
def select_planes(
    whole: PointSample,
    candidates: F64,
    least: int,
    most: int,
    planes: F64,
    bounds: PieceBounds,
) -> Any:
    """At most ``most`` planes among the candidates (c, 4) whose pieces together describe all
    points best.

    Returns (their number, length). A plane costs its three parameters (BIC) and needs more support
    than outliers give any slab.
    """
    sample, need = thin_sample(whole, least)
    few = np.empty((TRIED, 4))
    # its price: what is explained by less cannot be added
    worth = 3.0 * np.log(whole.m) * whole.sigma * whole.sigma * sample.n / whole.m
    tried = greedy_candidates(sample, candidates, worth, few)
    return exchange_search(sample, few[:tried], need, most, planes, bounds)
