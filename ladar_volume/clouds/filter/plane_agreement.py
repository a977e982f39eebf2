"""The planes that neighbourhoods agree in: where more planes come together than any one of them
told apart, together they know them all.

Every cell chooses the planes that describe its own surroundings. Of three within a few widths of
the noise it may miss one and lean the others, but then its neighbours, which see more of one and
less of another, rarely err alike.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ladar_volume.clouds.filter.plane_set_selection import (
    CHANCE,
    among,
    description,
    same,
    sample,
    steady,
    without,
)
from ladar_volume.clouds.filter.sharp_planes import MOST, distance, nearest_planes
from ladar_volume.math.array_types import F64, I64
from ladar_volume.math.kernels import kernel, leaf_kernel

#: Planes agree that are nowhere in half the neighbourhood farther apart than this, in sigma; within
#: the second they are no two.
AGREE, APART = 0.75, 1.5
#: A plane that so many of the sets have, and one set of this many, is agreed in.
VOTES, OF = 3, 4


@kernel
def accepted(planes: F64, count: int, lent: F64, sizes: I64, reach: float, sigma: float) -> Any:
    """Whether the sets (k, MOST, 4) agree in every one of ``count`` planes."""
    for b in range(count):
        votes = 0
        for a in range(len(lent)):
            votes += among(planes[b], lent[a], sizes[a], reach, AGREE * sigma)
        if votes < VOTES or OF * votes < len(lent):
            return False
    return True


@kernel
def agreed(lent: F64, sizes: I64, reach: float, sigma: float, out: F64) -> Any:
    """The planes that most of the sets (k, MOST, 4) agree in, to out (n, 4), the most frequent
    first; returns how many.
    """
    total, n, number = sizes.sum(), 0, 0
    each, votes = np.empty((total, 4)), np.ones(total, np.int64)
    for a in range(len(lent)):
        for k in range(sizes[a]):
            each[n] = lent[a, k]
            n += 1
    for a in range(n):
        for b in range(a):
            if same(each[a], each[b], reach, AGREE * sigma):
                votes[a] += 1
                votes[b] += 1
    while number < len(out):
        best = np.argmax(votes)
        if votes[best] == 0:
            break
        out[number] = each[best]
        for a in range(n):
            if same(each[a], out[number], reach, APART * sigma):
                votes[a] = 0
        number += 1
    return number


@kernel
def populated(y: F64, n: int, planes: F64, size: int, need: int, limit: float, label: I64) -> Any:
    """Drop planes to which fewer than ``need`` of the points (n, 3) are nearest, the one with
    fewest first; returns how many are left.
    """
    support = np.empty(MOST, np.int64)
    while size > 0:
        nearest_planes(y, n, planes, size, limit, label)
        support[:size] = 0
        for i in range(n):
            if label[i] >= 0:
                support[label[i]] += 1
        k = np.argmin(support[:size])
        if support[k] >= need:
            break
        size = without(planes, size, k, planes)
    return size


@leaf_kernel
def without_each(y: F64, n: int, planes: F64, size: int, limit: float, out: F64) -> None:
    """Sum of the squared distances of points (n, 3) to the nearest of the planes but one, each at
    most the limit, to out (size,): for every plane that is left out.
    """
    total = 0.0
    out[:size] = 0.0
    for i in range(n):
        nearest, second, which = limit, limit, 0
        for k in range(size):
            d = distance(y[i], planes[k])
            if d * d < nearest:
                nearest, second, which = d * d, nearest, k
            elif d * d < second:
                second = d * d
        total += nearest
        out[which] += second - nearest
    for k in range(size):
        out[k] += total


@kernel
def thinned(
    y: F64,
    n: int,
    planes: F64,
    size: int,
    m: int,
    sigma: float,
    threshold: float,
    side: I64,
    label: I64,
) -> Any:
    """Drop planes one at a time, whichever shortens the description of m points, of which y (n, 3)
    are a sample, most, as long as one does; returns how many are left. The sum of the squares to
    the unbounded planes is a lower bound; they come in its order.
    """
    other, least, price = np.zeros((MOST, 4)), np.empty(MOST), 3.0 * np.log(m) * sigma * sigma
    length = description(y, n, planes, size, m, sigma, threshold, 0, np.inf, side, label)
    while size > 1:
        best = -1
        without_each(y, n, planes, size, threshold * threshold, least)
        for k in np.argsort(least[:size]):
            if least[k] * m / n + (size - 1) * price >= length:
                break
            left = without(planes, size, k, other)
            shorter = description(y, n, other, left, m, sigma, threshold, 0, length, side, label)
            if shorter < length:
                best, length = k, shorter
        if best < 0:
            break
        size = without(planes, size, best, planes)
    return size


@kernel
def common(
    x: F64,
    m: int,
    own: F64,
    reach: float,
    lent: F64,
    sizes: I64,
    count: int,
    cost: float,
    sigma: float,
    threshold: float,
    least: int,
    planes: F64,
    side: I64,
    label: I64,
) -> Any:
    """The planes that the neighbours' sets (k, MOST, 4) agree in, without those that explain
    nothing here, where they describe the points (m, 3) better than the ``count`` planes of the best
    single set, whose description has the length ``cost``. Returns their number.

    Not asked where the neighbours agree in the planes of that set, and these leave no more than the
    noise.
    """
    if (
        accepted(planes, count, lent, sizes, reach, sigma)
        and steady(x, m, own, planes, count, sigma, threshold, side, label) == 2
    ):
        return count
    y, need = sample(x, m, least)
    trial = np.zeros((MOST, 4))
    size = agreed(lent, sizes, reach, sigma, trial)
    size = populated(y, len(y), trial, size, max(need // 2, 1), threshold * threshold, label)
    known = 0
    for a in range(size):
        known += among(trial[a], planes, count, reach, AGREE * sigma)
    if size == 0 or known == size == count:
        return count
    size = thinned(y, len(y), trial, size, m, sigma, threshold, side, label)
    need = max(least // 2, np.int64(0.5 * CHANCE * m))
    if description(x, m, trial, size, m, sigma, threshold, need, cost, side, label) < cost:
        planes[:size] = trial[:size]
        return size
    return count
