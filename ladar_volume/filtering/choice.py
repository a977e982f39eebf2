"""Which planes, and how many, a neighbourhood consists of: the shortest description of its points."""

from __future__ import annotations

from typing import Any

import numpy as np

from ladar_volume.filtering.assignment import refine
from ladar_volume.filtering.pieces import MOST, bounds, distance, fit_plane, nearest_on_piece, nearest_pieces, nearest_planes
from ladar_volume.model.kernels import kernel

#: Least share of the points a plane needs: outliers give this much to any slab.
CHANCE = 0.03
#: Most points looked at to choose planes.
SEEN = 250
#: Mean truncated square over sigma² of a choice that need not be searched for again: noise, and outliers of a few per cent.
ENOUGH = 1.25
#: So many planes that still leave this mean truncated square over sigma² do not describe a surface: leaves, grass, cables.
SEVERAL, CLUTTER = 3, 3.0
#: Most candidates tried in all combinations.
TRIED = 10


@kernel
def pieces_cost(x: Any, m: Any, planes: Any, count: Any, side: Any, limit: Any, sigma: Any, most: Any, support: Any) -> Any:
    """Description length of points (m, 3) on the bounded pieces, in squared distances: truncated squares, and what it takes to say to
    which piece a point belongs where its position does not tell. support (k,) gets the number of points nearest to each piece.

    Without the second term a slab of noise is described better by two planes within it than by the one in its middle.
    """
    cost, saying, q = 0.0, 0.0, np.empty(3)
    support[:count] = 0
    for i in range(m):
        nearest, which, several = limit, -1, 0
        for a in range(count):
            on = nearest_on_piece(x[i], a, planes, count, side, q)
            d = (x[i, 0] - q[0]) ** 2 + (x[i, 1] - q[1]) ** 2 + (x[i, 2] - q[2]) ** 2
            several += on == 0 and d < limit
            if d < nearest:
                nearest, which = d, a
        cost += nearest
        if several > 1:
            saying += 2.0 * np.log(several) * sigma * sigma
        if which >= 0:
            support[which] += 1
        if cost + saying > most:
            break
    return cost + saying, cost


@kernel
def distinct(x: Any, m: Any, candidates: Any, offered: Any, limit: Any, out: Any) -> Any:
    """A few candidates, each the one that explains most of what those before it leave, to out (k, 4); returns how many."""
    residual = np.full(m, limit)
    n = 0
    while n < len(out):
        best, which = 0.0, -1
        for c in range(offered):
            gain = 0.0
            for i in range(m):
                d = distance(x[i], candidates[c])
                gain += max(residual[i] - d * d, 0.0)
            if gain > best:
                best, which = gain, c
        if which < 0:
            break
        out[n] = candidates[which]
        for i in range(m):
            d = distance(x[i], out[n])
            residual[i] = min(residual[i], d * d)
        n += 1
    return n


@kernel
def description(
    y: Any, n: Any, trial: Any, size: Any, m: Any, sigma: Any, threshold: Any, need: Any, most: Any, side: Any, label: Any
) -> Any:  # fmt: skip
    """Description length of m points, of which the n points y (n, 3) are a sample, with these planes; infinite where one of the
    planes has less than ``need`` points of the sample, or where it exceeds ``most``."""
    support = np.empty(MOST, np.int64)
    limit = threshold * threshold
    price = 3.0 * size * np.log(m) * sigma * sigma
    if nearest_planes(y, n, trial, size, limit, label) * m / n + price >= most:
        return np.inf
    bounds(y, n, label, trial, size, sigma, side)
    length, _ = pieces_cost(y, n, trial, size, side, limit, sigma, (most - price) * n / m, support)
    length = length * m / n + price
    return length if length < most and support[:size].min() >= need else np.inf


@kernel
def search(
    y: Any, n: Any, few: Any, tried: Any, m: Any, sigma: Any, threshold: Any, need: Any, most: Any, polish: Any, planes: Any, side: Any,
    label: Any,
) -> Any:  # fmt: skip
    """At most ``most`` planes, added, exchanged and dropped one at a time, whatever shortens the description most; ``polish``:
    refitted after every such move; none for clutter. Returns (number of planes, description length)."""
    trial, best_set, mean, inverse = np.empty((MOST, 4)), np.empty((MOST, 4)), np.empty(3), np.empty((3, 3))
    limit = threshold * threshold
    count, cost = 0, limit * m
    for _ in range(2 * MOST):
        best, best_count = cost, -1
        for c in range(-1, tried):
            # move k: plane k exchanged for candidate c, or dropped for c = −1; k = count: added
            for k in range(count + (c >= 0 and count < most)):
                trial[:count] = planes[:count]
                size = max(count, k + 1)
                if c >= 0:
                    trial[k] = few[c]
                else:
                    size = count - 1
                    trial[k:size] = planes[k + 1 : count]
                if size == 0:
                    continue
                length = description(y, n, trial, size, m, sigma, threshold, need, best, side, label)
                if length < best:
                    best, best_count = length, size
                    best_set[:size] = trial[:size]
        if best_count < 0:
            break
        count, cost = best_count, best
        planes[:count] = best_set[:count]
        if count >= SEVERAL and cost > CLUTTER * m * sigma * sigma:
            return 0, np.inf
        if not polish:
            continue
        nearest_planes(y, n, planes, count, limit, label)
        bounds(y, n, label, planes, count, sigma, side)
        nearest_pieces(y, n, planes, count, side, limit, label)
        trial[:count] = planes[:count]
        for k in range(count):
            fit_plane(y, n, label, k, trial[k], mean, inverse)
        length = description(y, n, trial, count, m, sigma, threshold, need, cost, side, label)
        if length < cost:
            cost = length
            planes[:count] = trial[:count]
    return count, cost


@kernel
def choose_planes(
    x: Any, m: Any, candidates: Any, offered: Any, sigma: Any, threshold: Any, least: Any, most: Any, planes: Any, means: Any,
    inverses: Any, used: Any, side: Any, label: Any,
) -> Any:  # fmt: skip
    """The planes, at most ``most``, among the ``offered`` candidates whose pieces together describe the points (m, 3) best, refined.

    Returns their number. A plane costs its three parameters (BIC) and needs more support than outliers give any slab. At most ``SEEN``
    points are looked at. A search ends in a best choice of its neighbourhood only, so there may be two: polishing after every move
    helps one and hinders another.
    """
    stride = (m + SEEN - 1) // SEEN
    y = x[:m:stride]
    n = len(y)
    need = max(least // stride, np.int64(CHANCE * n), 1)
    few, other = np.empty((TRIED, 4)), np.empty((MOST, 4))
    tried = distinct(y, n, candidates, offered, threshold * threshold, few)
    count, cost = search(y, n, few, tried, m, sigma, threshold, need, most, True, planes, side, label)
    # what outliers cost is not known; a choice that leaves hardly more than noise of the rest is not searched for again
    if count > 1 and cost - 3.0 * count * np.log(m) * sigma * sigma > ENOUGH * m * sigma * sigma:
        size, length = search(y, n, few, tried, m, sigma, threshold, need, most, False, other, side, label)
        if length < cost:
            count = size
            planes[:size] = other[:size]
    return refine(x, m, planes, means, inverses, used, count, sigma, threshold, least, side, label)
